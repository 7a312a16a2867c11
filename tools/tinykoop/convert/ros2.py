"""ROS 2 bag, SQLite or MCAP, read by rosbags. ROS has x forward, y left, z up already (REP 103)."""

import re
from operator import attrgetter

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from ..plumbing.errors import UserError
from ..plumbing.results import progress
from .choose import listed
from .log import Log, Series

_POSE = {
    "nav_msgs/Odometry": "pose.pose",
    "geometry_msgs/PoseStamped": "pose",
    "geometry_msgs/PoseWithCovarianceStamped": "pose.pose",
}
_TWIST = {"geometry_msgs/Twist": "", "geometry_msgs/TwistStamped": "twist."}
_ATTITUDE = tuple(f"{kind}.{at}.orientation" for kind, at in _POSE.items())
USUAL = {
    "px": tuple(f"{kind}.{at}.position.x" for kind, at in _POSE.items()),
    "py": tuple(f"{kind}.{at}.position.y" for kind, at in _POSE.items()),
    "theta": _ATTITUDE,
    "v": tuple(f"{kind}.{at}linear.x" for kind, at in _TWIST.items()),
    "omega": tuple(f"{kind}.{at}angular.z" for kind, at in _TWIST.items()),
    **{f"g{axis}": (f"sensor_msgs/Imu.angular_velocity.{axis}",) for axis in "xyz"},
    **{f"a{axis}": (f"sensor_msgs/Imu.linear_acceleration.{axis}",) for axis in "xyz"},
    **dict.fromkeys(("pitch", "roll", "yaw"), (*_ATTITUDE, "sensor_msgs/Imu.orientation")),
    "u": ("std_msgs/Float64.data", "std_msgs/Float32.data"),
}
NUMBERS = re.compile(r"(u?int|float)\d+|bool|byte|char")
RECOVER = "`mcap recover` or `ros2 bag reindex` may mend it"
UNRELATED = 1.0  # s: a header's time that is further off is of another clock (a simulator's) than the recorder's


def is_mine(path, head):
    if path.is_dir():
        return (path / "metadata.yaml").exists() or any(parts(path))
    return head.startswith((b"\x89MCAP0\r\n", b"SQLite format 3\0"))


def parts(path):
    """Storage files in a folder."""
    return [file for kind in ("*.mcap", "*.db3") for file in sorted(path.glob(kind))]


def open_log(path, damaged):
    """A bag's folder or one storage file; a folder that lost its metadata.yaml does with its one file.

    `damaged` is of no use here: rosbags reads a bag whole or not at all.
    """
    file = path
    if path.is_dir() and not (path / "metadata.yaml").exists():
        files = parts(path)
        if len(files) != 1:
            raise UserError(f"{path}: {len(files)} storage files and no metadata.yaml; `ros2 bag reindex` makes it again")
        file = files[0]
    try:
        reader = AnyReader([file], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except Exception as error:  # whatever a damaged file makes of rosbags
        raise UserError(f"{path}: not a ROS 2 bag, truncated or damaged ({listed([error])}); {RECOVER}")
    return Bag(path, reader)


class Bag(Log):
    mend = "record it"

    def __init__(self, path, reader):
        super().__init__(path)
        self.reader, self.usual = reader, USUAL
        self.kinds = {}
        for connection in reader.connections:
            if connection.msgcount:
                self.kinds[connection.topic] = connection.msgtype
                self.topics[connection.topic] = list(fields(reader.typestore.fielddefs, connection.msgtype))

    def find(self, candidate):
        kind, _, field = candidate.partition(".")
        return [(topic, field) for topic, name in self.kinds.items() if short(name) == kind]

    def words(self, candidate):
        return candidate.partition(".")[0]

    def names(self):
        return [f"{topic} ({short(kind)})" for topic, kind in self.kinds.items()]

    def read(self, names, commands):
        wanted = {}
        for name in names:
            topic, _, field = name.partition(".")
            wanted.setdefault(topic, []).append(field)
        getters = {topic: [getter(field) for field in found] for topic, found in wanted.items()}
        stamped = {topic: "header.stamp.sec" in self.topics[topic] for topic in wanted}
        rows = {topic: [] for topic in wanted}
        for topic, received, message in self.messages(wanted):
            stamp = message.header.stamp if stamped[topic] else None
            said = stamp.sec * 10**9 + stamp.nanosec if stamp else 0
            rows[topic].append((received, said, [get(message) for get in getters[topic]], knows_orientation(message)))
        clock = clocks(rows, stamped)
        return {
            f"{topic}.{field}": Series(
                clock[topic],
                np.array([row[2][i] for row in rows[topic]], float),
                np.array([row[3] or not field.startswith("orientation.") for row in rows[topic]], bool),
            )
            for topic, found in wanted.items()
            for i, field in enumerate(found)
        }

    def messages(self, topics):
        """(topic, time received in ns, message) of these topics, in the order of the bag."""
        connections = [c for c in self.reader.connections if c.topic in topics]
        items = Counted(self.reader.messages(connections), sum(c.msgcount for c in connections))
        try:
            for connection, received, raw in progress(items, self.path.name):
                yield connection.topic, received, self.reader.deserialize(raw, connection.msgtype)
            self.reader.close()
        except Exception as error:  # whatever a damaged file makes of rosbags
            raise UserError(f"{self.path}: truncated or damaged ({listed([error])}); {RECOVER}")


class Counted:
    """An iterator of known length, for the progress bar."""

    def __init__(self, items, count):
        self.items, self.count = items, count

    def __iter__(self):
        return iter(self.items)

    def __len__(self):
        return self.count


def short(kind):
    """nav_msgs/msg/Odometry as people say it."""
    return kind.replace("/msg/", "/")


def knows_orientation(message):
    """REP 145: an IMU that knows none says so by a covariance that begins with -1."""
    return getattr(message, "orientation_covariance", (0,))[0] != -1


def getter(field):
    """The number in a message that a.b[2] names."""
    name, bracket, index = field.partition("[")
    get = attrgetter(name)
    return (lambda message: get(message)[int(index[:-1])]) if bracket else get


def fields(definitions, kind, prefix="", depth=6):
    """Names of the numbers in a message."""
    for name, (node, detail) in definitions[kind][1] if kind in definitions and depth else ():
        label = prefix + name
        if node == Nodetype.NAME:
            yield from fields(definitions, detail, f"{label}.", depth - 1)
        elif node == Nodetype.BASE and NUMBERS.fullmatch(detail[0]):
            yield label
        elif node == Nodetype.ARRAY and detail[0][0] == Nodetype.BASE and NUMBERS.fullmatch(detail[0][1][0]):
            yield from (f"{label}[{i}]" for i in range(detail[1]))


def clocks(rows, stamped):
    """{topic: seconds}: by header where there is one, unless it is of another clock and some topic has none."""
    received = {topic: np.array([row[0] for row in found], np.int64) for topic, found in rows.items()}
    said = {topic: np.array([row[1] for row in found], np.int64) for topic, found in rows.items()}
    by_header = {topic for topic in rows if stamped[topic] and len(said[topic]) and said[topic].all()}
    far = any(abs(np.median(said[topic] - received[topic])) > UNRELATED * 1e9 for topic in by_header)
    if far and by_header != set(rows):
        by_header = set()
    times = {topic: said[topic] if topic in by_header else received[topic] for topic in rows}
    zero = min((int(t.min()) for t in times.values() if len(t)), default=0)
    return {topic: (t - zero) * 1e-9 for topic, t in times.items()}
