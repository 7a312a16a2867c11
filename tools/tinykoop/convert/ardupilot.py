"""ArduPilot dataflash log (.BIN), read by pymavlink. Body FRD to x forward, y left, z up; NED to north, west, up.

What the messages are: https://ardupilot.org/rover/docs/logmessages.html and https://ardupilot.org/copter/docs/logmessages.html
"""

import contextlib
import io
import math
import re

import numpy as np

from ..plumbing.asked import package
from ..plumbing.errors import UserError
from .choose import listed
from .log import Log, Series

MAGIC = b"\xa3\x95"
DEG = math.pi / 180
METRES = 111318.845  # per degree of latitude, as ArduPilot has it (LATLON_TO_M)
TEXT = "aZnN"  # kinds of fields that hold no number
USUAL = {
    "px": ("XKF1.PN", "NKF1.PN", "POS.Lat"),
    "py": ("XKF1.PE", "NKF1.PE", "POS.Lng"),
    "theta": ("ATT.Yaw",),
    "v": ("THR.DesSpeed",),
    "omega": ("STER.DesTurnRate",),
    **{f"g{axis}": (f"IMU.Gyr{axis.upper()}",) for axis in "xyz"},
    **{f"a{axis}": (f"IMU.Acc{axis.upper()}",) for axis in "xyz"},
    **{name: (f"ATT.{name.capitalize()}",) for name in ("pitch", "roll", "yaw")},
    "u": ("RATE.POut",),
}
UNITS = (
    (r"(ATT|AHR2|[XN]KF1)\.(Des)?Roll", DEG),
    (r"(ATT|AHR2|[XN]KF1)\.(Des)?(Pitch|Yaw)", -DEG),
    (r"[XN]KF1\.[PV][ED]", -1.0),
    (r"(IMU\d?|GYR|ACC)\.(Gyr|Acc)[YZ]", -1.0),
    (r"STER\.(Des)?TurnRate", -DEG),
    (r"RATE\.R(Des)?", DEG),
    (r"RATE\.[PY](Des)?", -DEG),
    (r"RATE\.[PY]Out", -1.0),
)


def is_mine(path, head):
    return head.startswith(MAGIC)


def open_log(path, damaged):
    """What was logged; the messages are read once it is known which are needed."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); name one .BIN file")
    if not data.startswith(MAGIC):
        raise UserError(f"{path}: not a dataflash log: it does not begin with the bytes A3 95")
    dataflash = package("pymavlink.DFReader", "logs")
    with guarded(path):
        reader = dataflash.DFReader_binary(str(path))
    if not damaged and not whole(reader, data):
        raise UserError(f"{path}: cut off or damaged (power gone while logging?); --damaged takes what can be read")
    return Dataflash(path, reader)


@contextlib.contextmanager
def guarded(path):
    """Damaged bytes make pymavlink raise errors of any kind, and print; the user gets one line."""
    try:
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            yield
    except Exception as error:
        raise UserError(f"{path}: damaged beyond reading ({listed([error])}); copy it from the vehicle again")


def whole(reader, data):
    """Whether messages fill the file, but for what logging by blocks leaves empty at its end."""
    sizes = {kind: reader.formats[kind].len for kind, at in enumerate(reader.offsets) if len(at) and kind in reader.formats}
    filled = sum(size * len(reader.offsets[kind]) for kind, size in sizes.items())
    end = max((size + reader.offsets[kind][-1] for kind, size in sizes.items()), default=0)
    return filled == end <= len(data) and not data[end:].startswith(MAGIC[:1])


def topic(message):
    """A message's name, with the instance of its sensor from the second on."""
    instance = getattr(message, message.fmt.instance_field) if message.fmt.instance_field else 0
    return f"{message.fmt.name}_{instance}" if instance else message.fmt.name


def si(topic, field):
    """What a field is multiplied with; others are taken as they are."""
    name = f"{topic.partition('_')[0]}.{field}"
    return next((factor for pattern, factor in UNITS if re.fullmatch(pattern, name)), 1.0)


class Dataflash(Log):
    mend = "log it (LOG_BITMASK)"

    def __init__(self, path, reader):
        super().__init__(path)
        self.reader, self.usual = reader, USUAL
        for message in reader.messages.values():
            if "TimeUS" in getattr(message, "_fieldnames", ()):
                kinds = zip(message.fmt.columns, message.fmt.format)
                self.topics[topic(message)] = [name for name, kind in kinds if kind not in TEXT and name != "TimeUS"]

    def read(self, names, commands):
        rows = {}
        for name in names:
            rows.setdefault(name.partition(".")[0], [])
        with guarded(self.path):
            self.collect(rows)
            return {name: series(*name.split("."), rows[name.partition(".")[0]]) for name in names}

    def collect(self, rows):
        """Fills {topic: its messages}."""
        types = sorted({name.partition("_")[0] for name in rows})
        self.reader.rewind()
        while (message := self.reader.recv_match(type=types, strict=True)) is not None:
            if (name := topic(message)) in rows:
                rows[name].append(message)


def series(topic, field, messages):
    """Series of one field of a topic's messages."""
    t, x = (np.array([getattr(message, name) for message in messages], float) for name in ("TimeUS", field))
    if topic == "POS" and field in ("Lat", "Lng"):
        x = metres(field, x, messages)
    return Series(t * 1e-6, si(topic, field) * x)


def metres(field, degrees, messages):
    """North or west of the first position, on the plane that touches the Earth there."""
    away = (degrees - degrees[:1]) * METRES
    return away if field == "Lat" else -away * np.cos(DEG * np.array([message.Lat for message in messages[:1]]))
