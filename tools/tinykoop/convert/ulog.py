"""PX4 ULog, read by pyulog. Body FRD to x forward, y left, z up; local NED to north, west, up."""

import contextlib
import io
import re
import struct

import numpy as np
import rich.progress
from rich.markup import escape

from ..plumbing.errors import UserError
from ..plumbing.results import console
from . import motors
from .choose import listed
from .log import Log, Series
from .motors import MOTORS

MAGIC = b"ULog\x01\x12\x35"
HEADER = 16
USUAL = {
    "px": ("vehicle_local_position.x",),
    "py": ("vehicle_local_position.y",),
    "theta": ("vehicle_local_position.heading", "vehicle_local_position.yaw", "vehicle_attitude.q"),
    "v": (
        "rover_speed_setpoint.speed_body_x", "rover_velocity_setpoint.speed",
        "rover_differential_setpoint.forward_speed_setpoint", "differential_drive_setpoint.speed",
    ),
    "omega": (
        "rover_rate_setpoint.yaw_rate_setpoint", "rover_differential_setpoint.yaw_rate_setpoint",
        "differential_drive_setpoint.yaw_rate",
    ),
    **{f"g{axis}": (f"sensor_combined.gyro_rad[{i}]",) for i, axis in enumerate("xyz")},
    **{f"a{axis}": (f"sensor_combined.accelerometer_m_s2[{i}]",) for i, axis in enumerate("xyz")},
    **dict.fromkeys(("pitch", "roll", "yaw"), ("vehicle_attitude.q",)),
    "u": (
        "vehicle_torque_setpoint.xyz[1]", "actuator_controls_0.control[1]", "vehicle_rates_setpoint.pitch",
        "actuator_motors.control[0]",
    ),
}  # fmt: skip
_POSITION = "vehicle_local_position"
QUADROTOR = {
    "pz": (f"{_POSITION}.z",),
    **{f"{kind}{axis}": (f"{_POSITION}.{kind}{axis}",) for kind in "va" for axis in "xyz"},
    **{f"g{axis}": (f"vehicle_angular_velocity.xyz[{i}]", f"sensor_combined.gyro_rad[{i}]") for i, axis in enumerate("xyz")},
    **{motor: (f"actuator_motors.control[{k - 1}]", f"actuator_outputs.output[{k - 1}]") for motor, k in zip(MOTORS, motors.X)},
    "vbat": ("battery_status.voltage_v",),
}
PLACES = ((1, 1), (-1, 1), (-1, -1), (1, -1))  # of M1 .. M4: signs of forward and right
OUTPUT = re.compile(r"actuator_outputs(_\d)?\.output\[(?P<index>\d+)\]")
MOTOR_1 = 101  # in PWM_MAIN_FUNC1 ..
# A half turn about x leads from FRD to FLU and from NED to NWU: what points along y and z changes its sign.
TURNED = re.compile(
    r"(sensor_combined\.(gyro_rad|accelerometer_m_s2)"
    r"|(vehicle_angular_velocity|vehicle_acceleration|vehicle_torque_setpoint|vehicle_thrust_setpoint)(_\d)?\.xyz"
    r"|(vehicle_rates_setpoint|vehicle_attitude_setpoint)\.thrust_body"
    r"|actuator_controls_\d\.control"
    r"|(vehicle|vehicle_mocap|vehicle_visual|estimator)_odometry(_\d)?\.(position|velocity|angular_velocity))\[[12]\]"
    r"|(vehicle|estimator)_local_position(_groundtruth)?(_\d)?\.(y|z|vy|vz|ay|az|heading|yaw)"
    r"|(vehicle_attitude|estimator_attitude|vehicle_(mocap_|visual_)?odometry|estimator_odometry)(_groundtruth)?(_\d)?"
    r"\.q\[[23]\]"
    r"|vehicle_attitude_setpoint\.(q_d\[[23]\]|pitch_body|yaw_body|yaw_sp_move_rate)"
    r"|vehicle_rates_setpoint\.(pitch|yaw)"
    r"|(rover_rate|rover_differential)_setpoint\.yaw_rate_setpoint|differential_drive_setpoint\.yaw_rate"
)
# What says that a field is not to be trusted, and what counts where its estimate was set again.
FLAGS = ("xy_valid", "xy_reset_counter", "heading_reset_counter", "quat_reset_counter", "reset_counter")
FLAGS_OF = {
    "z": ("z_valid", "z_reset_counter"),
    **dict.fromkeys(("vx", "vy"), ("v_xy_valid", "vxy_reset_counter")),
    "vz": ("v_z_valid", "vz_reset_counter"),
    **dict.fromkeys(("ax", "ay"), ("v_xy_valid",)),
    "az": ("v_z_valid",),
}
TICK = 1 << 14  # reads between two looks at the progress
CIRCLES = 200_000  # reads that lead nowhere new; going back over one message, byte by byte, takes 131,072


def is_mine(path, head):
    return head.startswith(MAGIC)


def open_log(path, damaged):
    """What was logged; the data is read once it is known what is needed."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); name one .ulg file")
    if not data.startswith(MAGIC):
        raise UserError(f"{path}: not a ULog: it does not begin as one")
    return ULogLog(path, data, damaged)


class ULogLog(Log):
    mend = "log it (SDLOG_PROFILE, or logger_topics.txt)"
    quaternion = ("[0]", "[1]", "[2]", "[3]")

    def __init__(self, path, data, damaged):
        super().__init__(path)
        self.data, self.damaged, self.usual = data, damaged, USUAL
        subscriptions, whole = survey(data)
        if not whole and not damaged:
            raise UserError(f"{path}: truncated or damaged (power failure while logging?); --damaged reads what is intact")
        head = self.parse([], header_only=True)
        formats = head.message_formats
        self.parameters = {name: value for name, value in head.initial_parameters.items() if isinstance(value, (int, float))}
        self.where = {}
        for name, instance in subscriptions:
            topic = f"{name}_{instance}" if instance else name
            self.where[topic] = name, instance
            self.topics[topic] = list(fields(formats, name))

    def parse(self, topics, header_only=False):
        """pyulog's reading of these topics."""
        from pyulog import ULog

        said = io.StringIO()
        try:
            with contextlib.redirect_stdout(said), Watched(self.data, "" if header_only else self.path.name) as file:
                log = ULog(file, topics, parse_header_only=header_only)
        except Exception as error:  # whatever a damaged file makes of pyulog
            raise UserError(f"{self.path}: damaged beyond reading ({listed([error])}); copy it from the vehicle again")
        if log.file_corruption and not self.damaged:
            what = said.getvalue().strip() or "unknown messages"
            raise UserError(f"{self.path}: damaged ({listed([what])}); --damaged reads what is intact")
        return log

    def read(self, names, commands):
        topics = {name: self.where[name.partition(".")[0]] for name in names}
        log = self.parse(sorted({topic for topic, _ in topics.values()}))
        data = {(d.name, d.multi_id): d.data for d in log.data_list}
        return {name: series(name, data.get(topics[name], {}), name in commands) for name in names}

    def quadrotor(self):
        """With the motors where the parameters say that they are."""
        _, channels = outputs(self.parameters)
        order = places(self.parameters)
        if not order:
            self.mend = "the rotors (CA_ROTOR0_PX ..) are not one at each corner: a quadrotor in X is needed"
            return QUADROTOR | dict.fromkeys(MOTORS, ())
        fields = [(f"actuator_motors.control[{k - 1}]", f"actuator_outputs.output[{channels[k - 1] - 1}]") for k in order]
        return QUADROTOR | dict(zip(MOTORS, fields))

    def thrust(self, name, series):
        if name.startswith("actuator_motors"):
            return np.nan_to_num(series.x)  # of a motor that is off, it is NaN
        if output := OUTPUT.fullmatch(name):
            low, high = self.limits(name, int(output["index"]) + 1)
            return motors.curve(motors.share(series.x, low, high), self.parameters.get("THR_MDL_FAC", 0))
        return series.x

    def limits(self, name, channel):
        """Pulse widths of no and of full thrust."""
        group, _ = outputs(self.parameters)
        both = []
        for end in ("MIN", "MAX"):
            names = (f"PWM_{group}_{end}{channel}", f"PWM_{group}_{end}", f"PWM_{end}")
            both.append(next((self.parameters[n] for n in names if self.parameters.get(n, 0) > 0), np.nan))
        if not both[0] < both[1]:
            raise UserError(
                f"{self.path}: {name} cannot be scaled, for PWM_{group}_MIN{channel} and PWM_{group}_MAX{channel} are not in the log; "
                "log actuator_motors (SDLOG_PROFILE)"
            )
        return both


def series(name, table, command):
    """Series of one field of a topic's table."""
    field = name.partition(".")[2]
    if field not in table or "timestamp" not in table:
        return Series(np.empty(0), np.empty(0))
    # A state is of when it was measured, a command of when it was given.
    clock = "timestamp" if command or not table.get("timestamp_sample", np.zeros(1)).all() else "timestamp_sample"
    sign = -1.0 if TURNED.fullmatch(name) else 1.0
    valid, *counters = FLAGS_OF.get(field, FLAGS)
    trusted = table[valid] != 0 if valid in table else None
    resets = [table[counter] for counter in counters if counter in table]
    epoch = np.cumsum([np.diff(r, prepend=r[:1]) != 0 for r in resets], axis=1).sum(axis=0) if resets else None
    return Series(table[clock] * 1e-6, sign * table[field].astype(float), trusted, epoch)


def places(parameters):
    """Motors of PX4 that are M1 .. M4, by the places of the rotors, else as in its usual X; none for what is no quadrotor in X."""
    count = parameters.get("CA_ROTOR_COUNT", 0)
    if count == 0:
        return motors.X
    rotors = [tuple(np.sign(parameters.get(f"CA_ROTOR{i}_P{axis}", 0)) for axis in "XY") for i in range(len(PLACES))]
    return [rotors.index(place) + 1 for place in PLACES] if count == len(PLACES) and set(rotors) == set(PLACES) else None


def outputs(parameters):
    """(MAIN or AUX, the channels of PX4's motors 1 .. 4): as PWM_MAIN_FUNC1 .. assign them, else the first four."""
    for group in ("MAIN", "AUX"):
        functions = [parameters.get(f"PWM_{group}_FUNC{channel}") for channel in range(1, 17)]
        wanted = range(MOTOR_1, MOTOR_1 + len(MOTORS))
        if all(function in functions for function in wanted):
            return group, [functions.index(function) + 1 for function in wanted]
    return "MAIN", [1, 2, 3, 4]


def survey(data):
    """([(topic, instance)] that there is data of, whether the file ends with a whole message)."""
    at, names, with_data, step = HEADER, {}, set(), struct.Struct("<HB").unpack_from
    while at + 3 <= len(data):
        size, kind = step(data, at)
        if at + 3 + size > len(data):
            break
        if kind == ord("D"):
            with_data.add(data[at + 3 : at + 5])
        elif kind == ord("A") and size > 3:
            names[data[at + 4 : at + 6]] = data[at + 6 : at + 3 + size].decode("utf-8", "replace"), data[at + 3]
        at += 3 + size
    return sorted({name for key, name in names.items() if key in with_data}), at == len(data)


def fields(formats, name, prefix="", depth=4):
    """Names of the numbers in a message, as pyulog has them."""
    for kind, count, field in formats[name].fields if name in formats and depth else ():
        for label in [f"{prefix}{field}[{i}]" for i in range(count)] if count else [f"{prefix}{field}"]:
            if kind in formats:
                yield from fields(formats, kind, f"{label}.", depth - 1)
            elif kind != "char" and not field.startswith("_padding"):
                yield label


class Watched(io.BytesIO):
    """Bytes that show how far they are read, and stop a reader that goes in circles: pyulog does in damaged definitions."""

    def __init__(self, data, description):
        super().__init__(data)
        self.reads = self.farthest = self.circles = 0
        self.bar = rich.progress.Progress(console=console, transient=True, disable=not (description and console.is_terminal))
        self.task = self.bar.add_task(escape(description), total=len(data))

    def __enter__(self):
        self.bar.start()
        return self

    def __exit__(self, *error):
        self.bar.stop()

    def read(self, size=-1):
        out = super().read(size)
        at = self.tell()
        if at > self.farthest:
            self.farthest, self.circles = at, 0
        else:
            self.circles += 1
        if self.circles > CIRCLES:
            raise ValueError(f"no valid message after byte {self.farthest}")
        self.reads += 1
        if self.reads % TICK == 0:
            self.bar.update(self.task, completed=at)
        return out
