"""Converters: an analytic motion is written in each source format, with its units, frames and clocks, and must come back.

The files are made here: CSV and uSD log as the Crazyflie's client and firmware write them, ULog by its documented
format, bags with rosbags. The motion is rigid-body: body rates follow from the Euler angles, so a wrong sign or
frame anywhere shows as a yaw rate that is not the derivative of yaw.
"""

import bisect
import sqlite3
import struct
import zlib
from pathlib import Path

import numpy as np
import processes
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from tinykoop import bridge, convert, units
from tinykoop.convert import COLUMNS, FORMATS, ardupilot, betaflight, crazyflie, ros2, ulog, usd, variables
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
G = 9.80665
DEG = np.pi / 180
T = np.arange(400) / 100  # where nothing depends on it
TURN = np.diag([1.0, -1.0, -1.0])  # FRD to FLU, NED to NWU

# ---- the motion ------------------------------------------------------------------------------------


def wrap(a):
    return np.arctan2(np.sin(a), np.cos(a))


def drive(t):
    """A robot's pose: several turns, through the seam in both directions. Command: steps every 0.37 s."""
    n = np.floor(t / 0.37 + 0.0137)
    return {
        "px": 2 * np.sin(0.5 * t) + 0.1 * t,
        "py": np.cos(0.4 * t),
        "theta": 7 * np.sin(0.3 * t) + 1.0,
        "v": 1 + 0.5 * np.sin(3.7 * n),
        "omega": np.cos(2.3 * n),
    }


def flight(t):
    """A flight: yaw goes round, roll and pitch swing; gyro and accelerometer as the kinematics have them."""
    roll, pitch, yaw = 0.4 * np.sin(1.3 * t), 0.5 * np.sin(0.9 * t) - 0.1, 0.7 * t + 0.3 * np.sin(t)
    droll, dpitch, dyaw = 0.52 * np.cos(1.3 * t), 0.45 * np.cos(0.9 * t), 0.7 + 0.3 * np.cos(t)
    force = np.stack([0.3 * np.sin(t), 0.2 * np.cos(t), G + 0 * t], axis=1)  # in the world
    body = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1)).inv().apply(force)
    return {
        "gx": droll - dyaw * np.sin(pitch),
        "gy": dpitch * np.cos(roll) + dyaw * np.cos(pitch) * np.sin(roll),
        "gz": dyaw * np.cos(pitch) * np.cos(roll) - dpitch * np.sin(roll),
        "ax": body[:, 0], "ay": body[:, 1], "az": body[:, 2],
        "pitch": pitch, "roll": roll, "yaw": yaw, "yaw_rate": dyaw,
        "u": 0.2 * np.sin(2.9 * np.floor(t / 0.25 + 0.0137)),
    }  # fmt: skip


def attitude(m, frame=None):
    """Quaternions (w, x, y, z) of a flight or a drive; frame TURN gives those of FRD in NED."""
    zero = np.zeros_like(m["yaw"] if "yaw" in m else m["theta"])
    angles = np.stack([m.get("yaw", m.get("theta")), m.get("pitch", zero), m.get("roll", zero)], axis=1)
    matrix = Rotation.from_euler("ZYX", angles).as_matrix()
    return Rotation.from_matrix(matrix if frame is None else frame @ matrix @ frame).as_quat(scalar_first=True)


# ---- the writers -----------------------------------------------------------------------------------


def crazyflie_variables(m):
    """Log variables of the Crazyflie for a motion: deg, deg/s, g, and pitch positive nose up."""
    if "px" in m:
        return {
            "stateEstimate.x": m["px"], "stateEstimate.y": m["py"], "stateEstimate.yaw": wrap(m["theta"]) / DEG,
            "ctrltarget.vx": m["v"], "ctrltarget.yaw": m["omega"] / DEG,
        }  # fmt: skip
    return {
        **{f"gyro.{a}": m[f"g{a}"] / DEG for a in "xyz"},
        **{f"acc.{a}": m[f"a{a}"] / G for a in "xyz"},
        "stabilizer.pitch": -m["pitch"] / DEG, "stabilizer.roll": m["roll"] / DEG,
        "stabilizer.yaw": wrap(m["yaw"]) / DEG, "ctrltarget.pitch": -m["u"] / DEG,
    }  # fmt: skip


def write_crazyflie(path, ms, columns, time="Timestamp"):
    """As cfclient: a time in whole ms, then the variables."""
    lines = [f"{time}," + ",".join(columns)]
    lines += [f"{int(t)}," + ",".join(repr(float(c[i])) for c in columns.values()) for i, t in enumerate(ms)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_usd(path, events, version=2):
    """events: [(id, name, {variable: type}, [(t in s, values)])], written in the order of time."""
    out = struct.pack("<BHH", 0xBC, version, len(events))
    records = []
    for event, name, kinds, rows in events:
        out += struct.pack("<H", event) + name.encode() + b"\0" + struct.pack("<H", len(kinds))
        out += b"".join(f"{variable}({kind})".encode() + b"\0" for variable, kind in kinds.items())
        for t, values in rows:
            stamp = struct.pack("<HI", event, round(t * 1e3)) if version == 1 else struct.pack("<HQ", event, round(t * 1e6))
            records.append((t, stamp + struct.pack("<" + "".join(kinds.values()), *values)))
    out += b"".join(record for _, record in sorted(records, key=lambda r: r[0]))
    path.write_bytes(out + struct.pack("<I", zlib.crc32(out)))
    return path


def usd_event(t, columns, event=0xFFFF, name="fixedFrequency", kind="f"):
    return event, name, dict.fromkeys(columns, kind), [(s, [float(c[i]) for c in columns.values()]) for i, s in enumerate(t)]


ULOG_TYPES = {"uint64_t": "Q", "float": "f", "uint8_t": "B", "bool": "?"}


def write_ulog(path, topics, parameters=None):
    """topics: [(name, instance, {"float[3] gyro_rad": rows, ..})], by the ULog specification; times in us first."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    formats = {name: "".join(f"{field};" for field in fields) for name, _, fields in topics}
    for name, text in formats.items():
        out += message("F", f"{name}:{text}".encode())
    for name, value in (parameters or {}).items():
        key = f"{'int32_t' if isinstance(value, int) else 'float'} {name}".encode()
        out += message("P", bytes([len(key)]) + key + struct.pack("<i" if isinstance(value, int) else "<f", value))
    records = []
    for number, (name, instance, fields) in enumerate(topics):
        out += message("A", struct.pack("<BH", instance, number) + name.encode())
        kinds = ""
        for field in fields:
            kind, _, count = field.split()[0].partition("[")
            kinds += (count.rstrip("]") or "1") + ULOG_TYPES[kind]
        for row in zip(*fields.values()):
            values = [v for cell in row for v in np.ravel(cell).tolist()]
            records.append((int(values[0]), message("D", struct.pack("<H" + kinds, number, *values))))
    path.write_bytes(out + b"".join(record for _, record in sorted(records, key=lambda r: r[0])))
    return path


def us(t):
    return np.round(np.asarray(t) * 1e6).astype(np.int64)


def ulog_flight(t, without=""):
    """sensor_combined at all t, vehicle_attitude at every second, the command at every fifth."""
    a, b, c = flight(t), flight(t[::2]), flight(t[::5])
    torque = np.outer(c["u"], [0, -1, 0])
    gyro, acc = (np.stack([a[k + axis] for axis in "xyz"], axis=1) @ TURN for k in "ga")
    topics = [
        ("sensor_combined", 0, {"uint64_t timestamp": us(t), "float[3] gyro_rad": gyro, "float[3] accelerometer_m_s2": acc}),
        ("vehicle_attitude", 0, {"uint64_t timestamp": us(t[::2]), "float[4] q": attitude(b, TURN)}),
        ("vehicle_torque_setpoint", 0, {
            "uint64_t timestamp": us(t[::5]), "uint64_t timestamp_sample": np.maximum(us(t[::5]) - 10000, 1), "float[3] xyz": torque,
        }),
    ]  # fmt: skip
    return [topic for topic in topics if topic[0] != without]


def ulog_drive(t, valid=None, resets=None, given=0.0):
    """NED: x north as it is, y east and heading turned round. Poses are published 4 ms late, commands `given` late."""
    m, count = drive(t), len(t)
    return [
        ("vehicle_local_position", 0, {
            "uint64_t timestamp": us(t + 0.004), "uint64_t timestamp_sample": us(t), "float x": m["px"], "float y": -m["py"],
            "float heading": wrap(-m["theta"]), "bool xy_valid": np.ones(count, bool) if valid is None else valid,
            "uint8_t xy_reset_counter": np.zeros(count, int) if resets is None else resets,
        }),
        ("rover_speed_setpoint", 0, {"uint64_t timestamp": us(t + given), "float speed_body_x": m["v"]}),
        ("rover_rate_setpoint", 0, {"uint64_t timestamp": us(t + given), "float yaw_rate_setpoint": -m["omega"]}),
    ]  # fmt: skip


ROS = get_typestore(Stores.ROS2_HUMBLE)
EPOCH = 1_760_000_000 * 10**9


def ros(kind, **fields):
    """A message; what is not given is zero."""
    make = lambda name, **f: ROS.types[f"{name.split('/')[0]}/msg/{name.split('/')[1]}"](**f)  # noqa: E731
    zero = np.zeros(36)
    vector = lambda v: make("geometry_msgs/Vector3", x=float(v[0]), y=float(v[1]), z=float(v[2]))  # noqa: E731
    both = lambda: {"linear": vector((fields["v"], 0, 0)), "angular": vector((0, 0, fields["omega"]))}  # noqa: E731
    twist = lambda: make("geometry_msgs/Twist", **both())  # noqa: E731
    quaternion = lambda: make("geometry_msgs/Quaternion", **dict(zip("wxyz", map(float, fields["q"]))))  # noqa: E731
    if kind == "Twist":
        return twist()
    if kind == "Float64":
        return make("std_msgs/Float64", data=float(fields["data"]))
    ns = fields["stamp"]
    stamp = make("builtin_interfaces/Time", sec=int(ns // 10**9), nanosec=int(ns % 10**9))
    header = make("std_msgs/Header", stamp=stamp, frame_id="")
    if kind == "TwistStamped":
        return make("geometry_msgs/TwistStamped", header=header, twist=twist())
    if kind == "Imu":
        orientation = np.zeros(9)
        orientation[0] = fields.get("knows", 0)
        return make(
            "sensor_msgs/Imu", header=header, orientation=quaternion(), orientation_covariance=orientation,
            angular_velocity=vector(fields["g"]), angular_velocity_covariance=zero[:9],
            linear_acceleration=vector(fields["a"]), linear_acceleration_covariance=zero[:9],
        )  # fmt: skip
    point = make("geometry_msgs/Point", x=float(fields["p"][0]), y=float(fields["p"][1]), z=0.0)
    pose = make("geometry_msgs/Pose", position=point, orientation=quaternion())
    if kind == "PoseStamped":
        return make("geometry_msgs/PoseStamped", header=header, pose=pose)
    fields |= {"v": 0, "omega": 0}
    still = make("geometry_msgs/TwistWithCovariance", twist=twist(), covariance=zero)
    known = make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=zero)
    return make("nav_msgs/Odometry", header=header, child_frame_id="", pose=known, twist=still)


def write_bag(path, topics, plugin=StoragePlugin.SQLITE3):
    """topics: {name: (type, [(time received in ns, message)])}."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        rows = []
        for name, (kind, messages) in topics.items():
            connection = writer.add_connection(name, kind.replace("/", "/msg/"), typestore=ROS)
            rows += [(t, connection, message) for t, message in messages]
        for t, connection, message in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, t, ROS.serialize_cdr(message, connection.msgtype))
    return path


def ns(t):
    return [EPOCH + round(s * 1e9) for s in np.asarray(t).tolist()]


def odometry(t, late=0.0, kind="Odometry"):
    """Poses stamped when measured, received `late` s after."""
    m = drive(t)
    package = "nav_msgs" if kind == "Odometry" else "geometry_msgs"
    rows = zip(ns(t), m["px"], m["py"], attitude(m))
    return f"{package}/{kind}", [(s + round(late * 1e9), ros(kind, stamp=s, p=(x, y), q=q)) for s, x, y, q in rows]


def twists(t, kind="Twist"):
    m = drive(t)
    return f"geometry_msgs/{kind}", [(s, ros(kind, stamp=s, v=v, omega=w)) for s, v, w in zip(ns(t), m["v"], m["omega"])]


def imus(t, knows=0):
    m = flight(t)
    gyro, force = (np.stack([m[kind + axis] for axis in "xyz"], axis=1) for kind in "ga")
    rows = zip(ns(t), gyro, force, attitude(m))
    return "sensor_msgs/Imu", [(s, ros("Imu", stamp=s, g=g, a=a, q=q, knows=knows)) for s, g, a, q in rows]


def floats(t):
    return "std_msgs/Float64", [(s, ros("Float64", data=u)) for s, u in zip(ns(t), flight(t)["u"])]


# ---- the judges ------------------------------------------------------------------------------------


class Result:
    """A converted file: by the project's reader, and seg and pose_ok by NumPy's."""

    def __init__(self, path, platform):
        self.log = bridge.read_log(path, platform)
        table = np.genfromtxt(path, delimiter=",", names=True)
        assert table.dtype.names == ("t", *COLUMNS[platform], "seg", "pose_ok")
        self.t, self.seg, self.ok = table["t"], table["seg"].astype(int), table["pose_ok"] == 1
        self.columns = {name: table[name] for name in COLUMNS[platform]}
        assert self.t[0] == 0 and self.seg[0] == 0 and set(np.diff(self.seg)) <= {0, 1}


def run(source, platform, **options):
    out = source.parent / "out.csv"
    convert.run(source, out, platform, **options)
    return Result(out, platform)


def check(result, begin, truth, tolerance=1e-6, but=("v", "omega", "u")):
    """Columns are the motion at the times of their rows; angles but for whole turns, and without any jump."""
    expected = truth(begin + result.t)
    for name, values in result.columns.items():
        if name in but:
            continue
        error = values - expected[name]
        if name in ("theta", "pitch", "roll", "yaw"):
            error = wrap(error)
            inside = (np.diff(result.seg) == 0) & (np.diff(result.t) < 2 * np.median(np.diff(result.t)))
            assert np.abs(np.diff(values)[inside]).max() < 1, name
        assert np.abs(error[result.ok]).max() < tolerance, name


def check_held(result, begin, column, times, values):
    """Each row has the last command that was given by then: Python's bisect is the judge."""
    times, values = list(times), list(values)
    for t, got in zip(result.t + begin, result.columns[column]):
        assert got == pytest.approx(values[bisect.bisect_right(times, t + 1e-7) - 1], abs=1e-6), t


def refused(source, platform, match, **options):
    with pytest.raises(UserError, match=match) as refusal:
        convert.run(source, source.parent / "out.csv", platform, **options)
    message = str(refusal.value)
    assert message.isprintable() and len(message) < 4000
    return message


# ---- Crazyflie -------------------------------------------------------------------------------------


def test_crazyflie_drive_as_one_file(tmp_path):
    ms = np.arange(5000, 35000, 20)
    result = run(write_crazyflie(tmp_path / "log.csv", ms, crazyflie_variables(drive(ms / 1e3))), "ddr")
    check(result, 5.0, drive, but=())
    assert len(result.t) == len(ms) and result.log.dt == pytest.approx(0.02) and result.log.usable.all() and result.ok.all()


def test_crazyflie_flight_as_the_folder_of_a_session(tmp_path):
    """Log blocks start at different times; rows are there where all are."""
    folder = tmp_path / "20260101T12-00-00"
    folder.mkdir()
    for i, group in enumerate(("gyro", "acc", "stabilizer", "ctrltarget")):
        ms = np.arange(1000 + 37 * i, 21000, 10)
        columns = {n: c for n, c in crazyflie_variables(flight(ms / 1e3)).items() if n.startswith(group)}
        write_crazyflie(folder / f"{group}-20260101T12-00-01.csv", ms, columns)
    result = run(folder, "fwmav")
    check(result, 1.12, flight, 5e-4)  # on the gyro's samples, between the others
    times = np.arange(1111, 21000, 10) / 1e3
    check_held(result, 1.12, "u", times, flight(times)["u"])
    assert result.columns["az"].mean() > 8 and result.log.dt == pytest.approx(0.01)


def test_crazyflie_clock_of_24_bits_goes_on(tmp_path):
    ms = np.arange(10000, 20000, 20)
    stamps = (ms + (1 << 24) - 15000) % (1 << 24)
    result = run(write_crazyflie(tmp_path / "log.csv", stamps, crazyflie_variables(drive(ms / 1e3))), "ddr")
    check(result, 10.0, drive, but=())
    assert len(result.t) == len(ms) and result.seg.max() == 0


@pytest.mark.parametrize("version", (1, 2))
def test_usd_flight(tmp_path, version):
    """Two fixed rates in one file: events beside the fixed-frequency ones are in it too, and do not disturb."""
    t = 3 + np.arange(2000) / 200
    noise = usd_event(t[::3], {"gyro.x": 99 + 0 * t[::3], "distance": 1 + 0 * t[::3]}, 4, "estGyroscope")
    events = [noise, usd_event(t, crazyflie_variables(flight(t)))]
    result = run(write_usd(tmp_path / "log00", events, version), "fwmav")
    check(result, 3.0, flight, 2e-6, but=())  # float32 has 24 bits
    assert len(result.t) == 2000 and result.ok.all()


def test_usd_compressed_variables_and_quaternion(tmp_path):
    """stateEstimateZ in mm and mrad/s as int16, and an attitude that is there as a quaternion only."""
    t = np.arange(1000) / 100
    m = drive(t)
    whole = usd_event(t, {"stateEstimateZ.x": np.round(m["px"] * 1e3), "stateEstimateZ.y": np.round(m["py"] * 1e3)}, 7, "a")
    whole = (*whole[:2], dict.fromkeys(whole[2], "h"), [(s, [int(v) for v in row]) for s, row in whole[3]])
    q = dict(zip(("stateEstimate.qw", "stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz"), attitude(m).T))
    rest = usd_event(t, q | {"ctrltarget.vx": m["v"], "ctrltarget.yaw": m["omega"] / DEG})
    half = usd_event(t, {"range.half": t}, 9, "b", "e")
    result = run(write_usd(tmp_path / "log00", [whole, half, rest]), "ddr")
    check(result, 0.0, drive, 6e-4, but=())


def test_quaternion_that_is_spread_over_blocks(tmp_path):
    parts = dict(zip(("stateEstimate.qw", "stateEstimate.qx", "stateEstimate.qy", "stateEstimate.qz"), attitude(drive(T)).T))
    rest = {name: c for name, c in crazyflie_variables(drive(T)).items() if name != "stateEstimate.yaw"}
    folder = tmp_path / "session"
    folder.mkdir()
    write_crazyflie(folder / "a.csv", T * 1e3, {"stateEstimate.qw": parts.pop("stateEstimate.qw")} | rest)
    write_crazyflie(folder / "b.csv", T * 1e3 + 3, parts)
    refused(folder, "ddr", r"four parts of stateEstimate\.q were not logged together")


# ---- PX4 -------------------------------------------------------------------------------------------


def test_ulog_flight(tmp_path):
    t = 100 + np.arange(4000) / 200  # the command's own time of measurement is no matter
    result = run(write_ulog(tmp_path / "log.ulg", ulog_flight(t)), "fwmav")
    check(result, 100.0, flight, 2e-6)
    check_held(result, 100.0, "u", t[::5], flight(t[::5])["u"])
    assert result.log.dt == pytest.approx(0.01) and result.columns["az"].mean() > 8


def test_ulog_drive_takes_the_time_of_measurement(tmp_path):
    t = 7 + np.arange(1500) / 50
    result = run(write_ulog(tmp_path / "log.ulg", ulog_drive(t, given=0.002)), "ddr")
    check(result, 7.02, drive)
    check_held(result, 7.02, "v", t + 0.002, drive(t)["v"])
    assert len(result.t) == 1499


def test_ulog_untrusted_pose_is_masked_and_a_reset_is_a_new_segment(tmp_path):
    t = np.arange(1500) / 50
    valid = (t < 5) | (t >= 6)
    resets = (t >= 10).astype(int) + (t >= 20)
    topics = ulog_drive(t, valid, resets)
    topics[0][2]["float x"] = topics[0][2]["float x"] + 3.0 * resets  # the estimate jumps
    topics[0][2]["float y"] = np.where(valid, topics[0][2]["float y"], np.nan)
    result = run(write_ulog(tmp_path / "log.ulg", topics), "ddr")
    assert np.array_equal(result.ok, valid) and np.array_equal(result.seg, resets)
    jumps = lambda s: 3.0 * ((s >= 10 - 1e-9) + 1.0 * (s >= 20 - 1e-9))  # noqa: E731
    check(result, 0.0, lambda s: drive(s) | {"px": drive(s)["px"] + jumps(s)}, but=())
    steps = np.flatnonzero(~result.log.usable)
    assert {499, 999} <= set(steps.tolist()) and len(steps) == 2 + 51


def test_ulog_rows_inside_a_jump_are_masked(tmp_path):
    t = np.arange(300) / 50
    result = run(write_ulog(tmp_path / "log.ulg", ulog_drive(t, resets=(t >= 3).astype(int))), "ddr", rate=200)
    inside = (result.t > 2.98 + 1e-9) & (result.t < 3 - 1e-9)
    assert inside.sum() == 3 and np.array_equal(~result.ok, inside)


def test_ulog_rows_beside_an_untrusted_pose_are_masked(tmp_path):
    t = np.arange(300) / 50
    valid = (t < 2.99) | (t > 3.05)  # not at 3.00, 3.02, 3.04
    result = run(write_ulog(tmp_path / "log.ulg", ulog_drive(t, valid)), "ddr", rate=200)
    beside = (result.t > 2.98 + 1e-9) & (result.t < 3.06 - 1e-9)
    assert beside.sum() == 15 and np.array_equal(~result.ok, beside)
    check(result, 0.0, drive, 1e-3)


def test_ulog_second_instance_and_command_by_name(tmp_path):
    t = np.arange(1000) / 100
    motors = np.outer(flight(t)["u"], np.arange(1, 5))
    other = ("actuator_motors", 1, {"uint64_t timestamp": us(t), "float[4] control": motors})
    first = ("actuator_motors", 0, {"uint64_t timestamp": us(t), "float[4] control": 0 * motors})
    path = write_ulog(tmp_path / "log.ulg", [*ulog_flight(t, "vehicle_torque_setpoint"), first, other])
    result = run(path, "fwmav", maps=["u=actuator_motors_1.control[2]*0.5"])
    check_held(result, 0.0, "u", t, 1.5 * flight(t)["u"])
    assert not run(path, "fwmav").columns["u"].any()


def test_ulog_rates_setpoint_is_turned_to_z_up(tmp_path):
    t = np.arange(1000) / 100
    rates = ("vehicle_rates_setpoint", 0, {"uint64_t timestamp": us(t), "float pitch": -flight(t)["u"], "float yaw": 2 - t})
    path = write_ulog(tmp_path / "log.ulg", [*ulog_flight(t, "vehicle_torque_setpoint"), rates])
    check_held(run(path, "fwmav"), 0.0, "u", t, flight(t)["u"])
    check_held(run(path, "fwmav", maps=["u=vehicle_rates_setpoint.yaw"]), 0.0, "u", t, t - 2)


# ---- ROS 2 -----------------------------------------------------------------------------------------

PLUGINS = (StoragePlugin.SQLITE3, StoragePlugin.MCAP)


@pytest.mark.parametrize("plugin", PLUGINS, ids=("sqlite3", "mcap"))
@pytest.mark.parametrize("pose", ("Odometry", "PoseStamped"))
def test_ros_drive(tmp_path, plugin, pose):
    """Poses late by 30 ms of their stamps, commands without stamps at random times."""
    t = np.arange(1000) / 50
    given = np.sort(np.random.default_rng(1).uniform(0.1, 20, 400))
    topics = {"/pose": odometry(t, 0.03, pose), "/cmd_vel": twists(given)}
    bag = write_bag(tmp_path / "bag", topics, plugin)
    result = run(bag, "ddr")
    begin = t[np.searchsorted(t, given[0])]
    check(result, begin, drive, 1e-5)
    for column in ("v", "omega"):
        check_held(result, begin, column, given, drive(given)[column])
    assert result.log.dt == pytest.approx(0.02, rel=1e-4) and result.log.usable.all()
    single = run(next(p for p in bag.iterdir() if p.suffix in (".db3", ".mcap")), "ddr")
    assert np.array_equal(single.columns["px"], result.columns["px"])
    (bag / "metadata.yaml").unlink()
    assert np.array_equal(run(bag, "ddr").columns["v"], result.columns["v"])


def test_ros_flight(tmp_path):
    t = np.arange(2000) / 100
    bag = write_bag(tmp_path / "bag", {"/imu": imus(t), "/dihedral": floats(t[::4])})
    result = run(bag, "fwmav")
    check(result, 0.0, flight)
    check_held(result, 0.0, "u", t[::4], flight(t[::4])["u"])


def test_ros_imu_without_orientation_is_not_believed(tmp_path):
    t = np.arange(500) / 100
    topics = {"/imu": imus(t, knows=-1), "/dihedral": floats(t)}
    refused(write_bag(tmp_path / "a", topics), "fwmav", "/imu.orientation for pitch has 0 samples to be trusted; .*--map pitch=")
    m = flight(t)
    poses = [(s, ros("PoseStamped", stamp=s, p=(0, 0), q=q)) for s, q in zip(ns(t), attitude(m))]
    result = run(write_bag(tmp_path / "b", topics | {"/mocap": ("geometry_msgs/PoseStamped", poses)}), "fwmav")
    check(result, 0.0, flight, but=("u",))


@pytest.mark.parametrize("kind", ("Twist", "TwistStamped"))
def test_ros_simulator_clock(tmp_path, kind):
    """Headers in a simulator's time that runs at half speed: used if all have it, not mixed with the recorder's."""
    t = np.arange(600) / 50
    slow = EPOCH  # received: twice as late, and at another epoch
    topics = {"/odom": odometry(t), "/cmd_vel": twists(t, kind)}
    topics = {name: (k, [(slow + 10**12 + 2 * (s - EPOCH), m) for s, m in rows]) for name, (k, rows) in topics.items()}
    result = run(write_bag(tmp_path / "bag", topics), "ddr")
    speed = 1 if kind == "TwistStamped" else 2
    assert result.log.dt == pytest.approx(0.02 * speed) and len(result.t) == 600
    check(result, 0.0, lambda s: drive(s / speed), but=())


def test_ros_bag_without_message_definitions(tmp_path):
    """As `ros2 bag` of older distributions writes SQLite."""
    bag = write_bag(tmp_path / "bag", {"/odom": odometry(T), "/cmd_vel": twists(T)})
    with sqlite3.connect(next(bag.glob("*.db3"))) as base:
        assert base.execute("DELETE FROM message_definitions").rowcount > 0
    base.close()
    check(run(bag, "ddr"), 0.0, drive, but=())


def test_ros_several_topics_want_a_choice(tmp_path):
    t = np.arange(300) / 50
    late = t + 0.5
    bag = write_bag(tmp_path / "bag", {"/odom": odometry(t), "/cmd_vel": twists(t), "/cmd_vel_nav": twists(late)})
    refused(bag, "ddr", r"v, omega could be from /cmd_vel or /cmd_vel_nav: choose with --map v,omega=/cmd_vel")
    result = run(bag, "ddr", maps=["v,omega=/cmd_vel_nav"])
    check_held(result, late[0], "v", late, drive(late)["v"])
    mixed = run(bag, "ddr", maps=["v=/cmd_vel.linear.x*-2", "omega=/cmd_vel"])
    check_held(mixed, 0.0, "v", t, -2 * drive(t)["v"])


# ---- time ------------------------------------------------------------------------------------------


def crazyflie_log(tmp_path, ms, stamps=None, change=None):
    columns = crazyflie_variables(drive(np.asarray(ms) / 1e3))
    if change:
        change(columns)
    return write_crazyflie(tmp_path / "log.csv", ms if stamps is None else stamps, columns)


def test_gap_is_a_new_segment_and_a_few_lost_samples_are_not(tmp_path):
    ms = np.arange(0, 20000, 20)
    lost = (ms > 4000) & (ms < 4060) | (ms > 10000) & (ms < 11000)
    result = run(crazyflie_log(tmp_path, ms[~lost]), "ddr")
    check(result, 0.0, drive, 5e-4)  # two rows are interpolated over 60 ms
    gone = (ms > 10000) & (ms < 11000)
    assert np.allclose(result.t, ms[~gone] / 1e3) and np.array_equal(result.seg, (ms[~gone] >= 11000).astype(int))
    assert (~result.log.usable).sum() == 1 and result.ok.all()


def test_after_a_gap_no_command_is_known_until_the_next(tmp_path):
    """Pose and command both silent for a second; the command comes back later than the pose."""
    t = np.arange(1000) / 50
    pose, given = t[(t < 5) | (t > 6)], t[(t < 5) | (t > 6.3)]
    result = run(write_bag(tmp_path / "bag", {"/odom": odometry(pose), "/cmd_vel": twists(given)}), "ddr")
    assert not ((result.t > 4.99) & (result.t < 6.31)).any() and result.seg.max() == 1
    check_held(result, 0.0, "v", given, drive(given)["v"])


def test_command_given_in_a_gap_of_the_pose_counts(tmp_path):
    t = np.arange(1000) / 50
    pose = t[(t < 5) | (t > 6)]
    result = run(write_bag(tmp_path / "bag", {"/odom": odometry(pose), "/cmd_vel": twists(t)}), "ddr")
    assert len(result.t) == len(pose) and result.seg.max() == 1
    check_held(result, 0.0, "omega", t, drive(t)["omega"])


def test_silent_command_is_held_and_said(tmp_path, capsys):
    t = np.arange(1000) / 50
    given = t[(t < 5) | (t > 9)]
    result = run(write_bag(tmp_path / "bag", {"/odom": odometry(t), "/cmd_vel": twists(given)}), "ddr")
    check_held(result, 0.0, "v", given, drive(given)["v"])
    assert len(result.t) == 1000 and "silent for up to 4.0 s" in " ".join(capsys.readouterr().out.split())


def test_command_that_is_slow_by_nature_is_not_remarked_upon(tmp_path, capsys):
    t = np.arange(1000) / 50
    bag = write_bag(tmp_path / "bag", {"/odom": odometry(t), "/cmd_vel": twists(t[::125])})
    check_held(run(bag, "ddr"), 0.0, "v", t[::125], drive(t[::125])["v"])
    assert "silent" not in capsys.readouterr().out


def test_jitter_disorder_and_repeated_stamps(tmp_path):
    """Rows are uniform whatever the stamps do: jitter, eight back to front, one twice with rubbish first."""
    random = np.random.default_rng(3)
    t = np.arange(2000) / 100 + random.uniform(-0.003, 0.003, 2000)
    t[0] = 0
    kind, rows = odometry(t)
    rows[100:108] = rows[100:108][::-1]
    stamps = ns(t)
    rubbish = ros("Odometry", stamp=stamps[500], p=(77, 77), q=(1, 0, 0, 0))
    rows = rows[:500] + [(stamps[500], rubbish)] + rows[500:]
    rows = [(EPOCH + 10**7 * i, message) for i, (_, message) in enumerate(rows)]  # received in this order
    result = run(write_bag(tmp_path / "bag", {"/odom": (kind, rows), "/cmd_vel": twists(t)}), "ddr")
    assert np.allclose(np.diff(result.t), result.t[1])
    check(result, 0.0, drive, 1e-3)
    check_held(result, 0.0, "v", t, drive(t)["v"])


def test_clock_set_back_is_two_recordings(tmp_path):
    ms = np.arange(0, 4000, 20)
    refused(crazyflie_log(tmp_path, ms, ms % 2000), "ddr", r"goes back by 1\.980 s at its sample 101: .*split")


def test_clock_that_jumps_ahead_is_a_gap(tmp_path):
    ms = np.arange(0, 4000, 20)
    stamps = ms + 60_000 * (ms >= 2000)
    result = run(crazyflie_log(tmp_path, ms, stamps), "ddr")
    assert np.allclose(result.t * 1e3, stamps) and np.array_equal(result.seg, (ms >= 2000).astype(int))


def test_time_that_makes_absurdly_many_rows(tmp_path):
    ms = np.append(np.arange(0, 4000, 20), 1e14)
    write_crazyflie(tmp_path / "log.csv", ms, crazyflie_variables(drive(np.arange(len(ms)) / 50)))
    refused(tmp_path / "log.csv", "ddr", "too many.*time stamps")


@pytest.mark.parametrize("rate", (10.0, 30.0, 200.0))
def test_rate(tmp_path, rate):
    ms = np.arange(0, 20000, 20)
    result = run(crazyflie_log(tmp_path, ms), "ddr", rate=rate)
    assert result.log.dt == pytest.approx(1 / rate, rel=1e-6)
    check(result, 0.0, drive, 2e-4)
    check_held(result, 0.0, "v", ms / 1e3, drive(ms / 1e3)["v"])


def test_default_rate_is_that_of_the_slowest_part_of_the_state(tmp_path):
    t = np.arange(4000) / 200
    result = run(write_ulog(tmp_path / "log.ulg", ulog_flight(t)), "fwmav")
    assert result.log.dt == pytest.approx(0.01)  # attitude, not gyro nor command


def test_state_and_command_that_never_meet(tmp_path):
    t = np.arange(200) / 50
    bag = write_bag(tmp_path / "bag", {"/odom": odometry(t), "/cmd_vel": twists(t + 10)})
    refused(bag, "ddr", r"never there at the same time: .*px 0\.000 to 3\.980 s.*v 10\.000 to")


# ---- what is missing -------------------------------------------------------------------------------


@pytest.mark.parametrize("platform, motion", [("ddr", drive), ("fwmav", flight)])
@pytest.mark.parametrize("form", ("crazyflie", "usd"))
def test_each_missing_variable_of_a_crazyflie(tmp_path, form, platform, motion):
    every = crazyflie_variables(motion(T))
    for name in every:
        some = {n: c for n, c in every.items() if n != name}
        if form == "crazyflie":
            path = write_crazyflie(tmp_path / "log.csv", T * 1e3, some)
        else:
            path = write_usd(tmp_path / "log00", [usd_event(T, some)])
        column = next(c for c in COLUMNS[platform] if name in variables.USUAL.get(c, ()))
        message = refused(path, platform, rf"nothing for {column} \(usually .*--map COLUMN=TOPIC\.FIELD; the file has")
        assert name in message and (crazyflie.MEND if form == "crazyflie" else usd.MEND) in message
        assert all(other in message for other in some)


@pytest.mark.parametrize("platform", ["ddr", "fwmav"])
def test_each_missing_field_of_a_ulog(tmp_path, platform):
    topics = ulog_flight(T) if platform == "fwmav" else ulog_drive(T)
    wanted = {name for c in COLUMNS[platform] for name in ulog.USUAL.get(c, ())}
    cases = 0
    for i, (topic, instance, fields) in enumerate(topics):
        for field in fields:
            name = f"{topic}.{field.split()[1]}"
            if not any(w.startswith(name) for w in wanted):
                continue
            cut = [*topics[:i], (topic, instance, {f: v for f, v in fields.items() if f != field}), *topics[i + 1 :]]
            path = write_ulog(tmp_path / "log.ulg", cut)
            message = refused(path, platform, r"nothing for .*SDLOG_PROFILE.*--map.*the file has .*")
            assert name in message and topics[0][0] in message.split("the file has")[1]
            cases += 1
        cut = topics[:i] + topics[i + 1 :]
        assert topic in refused(write_ulog(tmp_path / "log.ulg", cut), platform, "nothing for")
    assert cases == (4 if platform == "fwmav" else 5)


def test_ulog_topic_that_is_logged_but_never_published(tmp_path):
    silent = ("vehicle_torque_setpoint", 0, {"uint64_t timestamp": [], "float[3] xyz": []})
    path = write_ulog(tmp_path / "log.ulg", [*ulog_flight(T, "vehicle_torque_setpoint"), silent])
    message = refused(path, "fwmav", "nothing for u ")
    assert "vehicle_torque" not in message.split("the file has")[1]


def test_each_missing_topic_of_a_bag(tmp_path):
    drives = {"/odom": odometry(T), "/cmd_vel": twists(T)}
    flights = {"/imu": imus(T), "/u": floats(T)}
    attitude = r"pitch, roll, yaw \(usually nav_msgs/Odometry or .*sensor_msgs/Imu\)"
    cases = [
        ("ddr", drives, "/odom", r"px, py, theta \(usually nav_msgs/Odometry or .*has /cmd_vel \(geometry_msgs/Twist\)"),
        ("ddr", drives, "/cmd_vel", r"v, omega \(usually geometry_msgs/Twist or geometry_msgs/TwistStamped\): record it"),
        ("fwmav", flights, "/imu", r"gx, gy, gz, ax, ay, az \(usually sensor_msgs/Imu\); " + attitude),
        ("fwmav", flights, "/u", r"u \(usually std_msgs/Float64 or std_msgs/Float32\).*--map.*has /imu"),
    ]
    for i, (platform, topics, without, match) in enumerate(cases):
        refused(write_bag(tmp_path / str(i), {n: x for n, x in topics.items() if n != without}), platform, match)
    silent = {**drives, "/odom": ("nav_msgs/Odometry", [])}
    refused(write_bag(tmp_path / "silent", silent), "ddr", "nothing for px, py, theta")


@pytest.mark.parametrize(
    "text, match",
    [
        ("nonsense", r"write COLUMN=TOPIC\.FIELD, as in px=stateEstimate\.x"),
        ("=stateEstimate.x", "write COLUMN"),
        ("gx=gyro.x", "no column 'gx' here; there are px, py, theta, v, omega"),
        ("v=motor.m1", "no topic for 'motor.m1'; it has stateEstimate.x, "),
        ("v=ctrltarget.vy", "no such field; ctrltarget has vx, yaw"),
        ("v=stateEstimate", "no such field; stateEstimate has x, y, yaw"),
        ("v=ctrltarget.vx*two", "factor 'two' is not a number"),
    ],
)
def test_bad_map(tmp_path, text, match):
    refused(crazyflie_log(tmp_path, np.arange(0, 2000, 20)), "ddr", match, maps=[text])


def test_field_without_a_number(tmp_path):
    def spoil(columns):
        columns["ctrltarget.vx"] = np.full(100, np.nan)

    refused(crazyflie_log(tmp_path, np.arange(0, 2000, 20), change=spoil), "ddr", "ctrltarget.vx for v has 0 samples.*--map v=")


def test_pose_that_is_not_a_number_is_masked(tmp_path):
    def spoil(columns):
        columns["stateEstimate.x"] = np.where(np.arange(100) == 40, np.nan, columns["stateEstimate.x"])

    result = run(crazyflie_log(tmp_path, np.arange(0, 2000, 20), change=spoil), "ddr")
    assert np.flatnonzero(~result.ok).tolist() == [40] and (~result.log.usable).sum() == 2


# ---- what is broken --------------------------------------------------------------------------------


def good(tmp_path, form):
    """(file, platform) of a good log."""
    if form == "crazyflie":
        return crazyflie_log(tmp_path, np.arange(0, 4000, 20)), "ddr"
    if form == "usd":
        return write_usd(tmp_path / "log00", [usd_event(T, crazyflie_variables(drive(T)))]), "ddr"
    if form == "ulog":
        return write_ulog(tmp_path / "log.ulg", ulog_flight(T)), "fwmav"
    if form == "csv":
        return write_crazyflie(tmp_path / "mine.csv", T * 1e3, drive(T), "t"), "ddr"
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    bag = write_bag(tmp_path / "bag", {"/odom": odometry(T), "/cmd_vel": twists(T)}, plugin)
    return next(p for p in bag.iterdir() if p.suffix in (".db3", ".mcap")), "ddr"


KINDS = ("crazyflie", "csv", "usd", "ulog", "sqlite3", "mcap")


@pytest.mark.parametrize("form", KINDS)
@pytest.mark.parametrize("share", (0.02, 0.3, 0.7, 0.98))
def test_cut_off_file_is_refused(tmp_path, form, share):
    path, platform = good(tmp_path, form)
    data = path.read_bytes()
    cut = int(share * len(data))
    if form in ("crazyflie", "csv"):
        cut = data.index(b",", cut) + 1  # in the midst of a line
    path.write_bytes(data[:cut])
    refused(path, platform, "truncated|damaged|empty")


def test_usd_with_a_wrong_check_sum(tmp_path):
    """A bit turned in a number: nothing but the check sum shows it."""
    path, platform = good(tmp_path, "usd")
    data = bytearray(path.read_bytes())
    data[-10] ^= 1
    path.write_bytes(data)
    refused(path, platform, "check sum is wrong.*--damaged")
    assert len(run(path, platform, damaged=True).t) == len(T)


def test_times_that_are_no_numbers_or_all_the_same(tmp_path):
    ms = np.arange(0, 4000, 20)
    path = crazyflie_log(tmp_path, ms)
    text = path.read_text().replace("\n1000,", "\nnan,")
    path.write_text(text)
    result = run(path, "ddr")
    check(result, 0.0, drive, 1e-3)
    assert len(result.t) == 200
    refused(crazyflie_log(tmp_path, ms, 0 * ms), "ddr", "samples to be trusted|has 1 samples")


@pytest.mark.parametrize("form", ("crazyflie", "csv", "usd", "ulog"))
def test_damaged_takes_what_there_is(tmp_path, form):
    path, platform = good(tmp_path, form)
    whole = run(path, platform)
    data = path.read_bytes()
    cut = data.index(b",", int(0.6 * len(data))) + 1 if form in ("crazyflie", "csv") else int(0.6 * len(data)) + 1
    path.write_bytes(data[:cut])
    refused(path, platform, "--damaged")
    part = run(path, platform, damaged=True)
    assert 0.4 * len(whole.t) < len(part.t) < 0.7 * len(whole.t)
    for name, values in part.columns.items():
        assert np.array_equal(values, whole.columns[name][: len(values)]), name


@pytest.mark.parametrize("form", KINDS)
def test_altered_bytes_are_read_or_refused(tmp_path, form):
    """Mutations of a good file: a UserError of one line, or an output that the project's own reader takes."""
    path, platform = good(tmp_path, form)
    data, random, out = path.read_bytes(), np.random.default_rng(5), tmp_path / "out.csv"
    refusals = 0
    for i in range(40):
        text = bytearray(data)
        where = len(text) if i % 2 else min(len(text), 600)  # headers are short, and matter
        for _ in range(random.integers(1, 4)):
            at = int(random.integers(where))
            if random.integers(3):
                text[at] = random.integers(256)
            else:
                del text[at : at + int(random.integers(1, 40))]
        path.write_bytes(text)
        try:
            convert.run(path, out, platform, damaged=bool(i % 3))
            bridge.read_log(out, platform)
        except UserError as error:
            assert str(error).isprintable() and len(str(error)) < 4000
            refusals += 1
    assert refusals > 5


@pytest.mark.parametrize("form", FORMATS)
def test_foreign_file_whatever_format_it_is_said_to_be(tmp_path, form):
    foreign = (b"\x89PNG\r\n\x1a\n" + bytes(3000), b"a,b\n1,2\n", b"t,px,py\n0,1,2\n", bytes(50), b"\xbc", ulog.MAGIC)
    for i, data in enumerate(foreign):
        path = tmp_path / f"{i}.bin"
        path.write_bytes(data)
        refused(path, "ddr", str(path), form=form)
    refused(tmp_path, "ddr", str(tmp_path), form=form)


def test_format_is_told_from_what_is_in_it(tmp_path):
    for form in KINDS:
        path, _ = good(tmp_path, form)
        other = path.rename(tmp_path / "anything") if form in ("crazyflie", "csv", "usd", "ulog") else path
        assert convert.detect(other) == {"sqlite3": "ros2", "mcap": "ros2"}.get(form, form)
        if form in ("sqlite3", "mcap"):
            assert convert.detect(other.parent) == "ros2"
            other.parent.rename(tmp_path / form)
    path = tmp_path / "notes.txt"
    path.write_text("hello, world\n")
    message = refused(path, "ddr", "unknown format")
    assert all(form in message for form in FORMATS)
    path.write_text("")
    refused(path, "ddr", "empty")
    (tmp_path / "nothing").mkdir()
    refused(tmp_path / "nothing", "ddr", "unknown format")


def test_bad_line_of_a_csv_is_named(tmp_path):
    path = crazyflie_log(tmp_path, np.arange(0, 2000, 20))
    lines = path.read_text().split("\n")
    for bad, word in (("1,2", "2 fields under 6 columns"), ("60,a,1,1,1,1", "'a'")):
        path.write_text("\n".join([*lines[:4], bad, *lines[5:]]))
        assert word in refused(path, "ddr", r"log\.csv:5: ")
    path.write_text(lines[0] + "\n")
    refused(path, "ddr", "0 rows")


# ---- the command -----------------------------------------------------------------------------------


def command(*arguments):
    done = processes.tinykoop("convert", *arguments)
    return done.returncode, done.stdout, done.stderr


def test_command_line(tmp_path):
    path, out = crazyflie_log(tmp_path, np.arange(0, 4000, 20)), tmp_path / "out.csv"
    maps = "v=ctrltarget.vx*2", "omega=ctrltarget"
    status, said, error = command(path, out, "--platform", "ddr", "--rate", "25", "--map", *maps)
    assert status == 0 and not error and "ctrltarget.vx * 2" in said and "100 rows at 25 Hz" in said
    t = np.arange(100) / 25
    assert np.allclose(Result(out, "ddr").columns["v"], 2 * drive(t)["v"])


@pytest.mark.parametrize(
    "arguments",
    [("nowhere.ulg",), ("{log}", "--rate", "0"), ("{log}", "--rate", "nan"), ("{log}", "--map", "px"), ("{log}", "--format", "ulog")],
)
def test_what_the_user_can_mend_is_one_line_and_status_2(tmp_path, arguments):
    log = crazyflie_log(tmp_path, np.arange(0, 2000, 20))
    source, *rest = (a.format(log=log) for a in arguments)
    status, said, error = command(source, tmp_path / "out.csv", "--platform", "ddr", *rest)
    assert status == 2 and not said.strip() and error.startswith("tinykoop: ") and error.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()


def test_source_is_never_written_over(tmp_path):
    log = crazyflie_log(tmp_path, np.arange(0, 2000, 20))
    before = log.read_bytes()
    with pytest.raises(UserError, match="is the source; name another"):
        convert.run(log, tmp_path / "." / "log.csv", "ddr")
    with pytest.raises(UserError, match="no_folder"):
        convert.run(log, tmp_path / "no_folder/out.csv", "ddr")
    assert log.read_bytes() == before


def test_docs_name_the_usual_fields():
    """docs/convert.md has every usual source, and no other."""
    text = (ROOT / "docs/convert.md").read_text()
    quadrotors = variables.QUADROTOR, ulog.QUADROTOR, ardupilot.QUADROTOR
    for table in (variables.USUAL, ulog.USUAL, ardupilot.USUAL, betaflight.USUAL, *quadrotors):
        for name in {name for names in table.values() for name in names}:
            assert f"`{name}`" in text or f"`{name.split('[')[0]}`" in text, name
    assert all(f"`{form}`" in text for form in FORMATS) and all(f"`{unit}`" in text for unit in units.UNITS)
    for kind in {name.partition(".")[0] for names in ros2.USUAL.values() for name in names}:
        assert f"`{kind}`" in text, kind
