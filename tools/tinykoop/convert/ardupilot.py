"""ArduPilot dataflash log (.BIN), read by pymavlink. Body FRD to x forward, y left, z up; NED to north, west, up.

What the messages are: https://ardupilot.org/rover/docs/logmessages.html and https://ardupilot.org/copter/docs/logmessages.html
"""

import contextlib
import io
import math
import os
import re
from functools import cached_property

import numpy as np

from ..plumbing.asked import package
from ..plumbing.errors import UserError
from . import motors
from .choose import listed
from .log import Log, Series
from .motors import MOTORS

MAGIC = b"\xa3\x95"
HEADER = 3  # bytes before the fields of a message
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
QUADROTOR = {
    "pz": ("XKF1.PD", "NKF1.PD", "POS.RelHomeAlt"),
    **{f"v{axis}": (f"XKF1.V{end}", f"NKF1.V{end}") for axis, end in zip("xyz", "NED")},
    **dict.fromkeys(("ax", "ay", "az"), ()),  # the filter does not log them
    **{motor: (f"RCOU.C{k}",) for motor, k in zip(MOTORS, motors.X)},
    "vbat": ("BAT.Volt", "CURR.Volt"),
}
# Motors that are M1 .. M4, by FRAME_TYPE: X, V and H; Betaflight's X; DJI's; clockwise.
ORDERS = {**dict.fromkeys((1, 2, 3), motors.X), **dict.fromkeys((12, 18), (2, 1, 3, 4)), 13: (1, 4, 3, 2), 14: (1, 2, 3, 4)}
QUAD = 1  # FRAME_CLASS
MOTOR_1 = 33  # in SERVO1_FUNCTION ..
COMPENSATED = ("MOT_BAT_V_MAX", "MOT_BAT_VOLT_MAX")  # above 0 if the firmware makes up for the voltage; the second is the older name
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
    os.environ["PYMAVLINK_FAST_INDEX"] = "0"  # the fast one prints of damaged bytes where nothing can keep it from
    dataflash = package("pymavlink.DFReader", "logs")
    with readable(path):
        reader = dataflash.DFReader_binary(str(path))
    if not damaged and not whole(reader, data):
        raise UserError(f"{path}: truncated or damaged (power failure while logging?); --damaged reads what is intact")
    return Dataflash(path, data, reader, dataflash.FORMAT_TO_STRUCT)


@contextlib.contextmanager
def readable(path):
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
    """(a message's name, with the instance of its sensor from the second on; the instance)."""
    instance = getattr(message, message.fmt.instance_field) if message.fmt.instance_field else 0
    return f"{message.fmt.name}_{instance}" if instance else message.fmt.name, instance


def si(topic, field):
    """What a field is multiplied with; others are taken as they are."""
    name = f"{topic.partition('_')[0]}.{field}"
    return next((factor for pattern, factor in UNITS if re.fullmatch(pattern, name)), 1.0)


class Dataflash(Log):
    mend = "log it (LOG_BITMASK)"

    def __init__(self, path, data, reader, structs):
        """structs: {kind of a field: its letter of Python's struct}."""
        super().__init__(path)
        self.data, self.reader, self.structs, self.usual = data, reader, structs, USUAL
        self.where = {}
        for message in reader.messages.values():
            if "TimeUS" in getattr(message, "_fieldnames", ()):
                name, instance = topic(message)
                self.where[name] = message.fmt, instance
                kinds = zip(message.fmt.columns, message.fmt.format)
                self.topics[name] = [field for field, kind in kinds if kind not in TEXT and field != "TimeUS"]

    def read(self, names, commands):
        with readable(self.path):
            topics = {name.partition(".")[0] for name in names}
            tables = {topic: self.table(*self.where[topic]) for topic in topics}
            return {name: series(*name.split("."), tables[name.partition(".")[0]]) for name in names}

    @cached_property
    def parameters(self):
        """{name: value}, as last set."""
        with readable(self.path):
            rows = self.rows(self.where["PARM"][0]) if "PARM" in self.where else {"Name": [], "Value": []}
            return {name.decode("ascii", "replace"): float(value) for name, value in zip(rows["Name"], rows["Value"])}

    def quadrotor(self):
        """With the motors where the parameters say that they are."""
        given = self.parameters.get
        order = ORDERS.get(given("FRAME_TYPE", 1)) if given("FRAME_CLASS", QUAD) == QUAD else None
        if not order:
            self.mend = "the frame (FRAME_CLASS, FRAME_TYPE) is no quadrotor in X, of which the order of the motors is known"
            return QUADROTOR | dict.fromkeys(MOTORS, ())
        if "MOTB" not in self.where and any(given(name, 0) > 0 for name in COMPENSATED):
            self.notes.append(
                "The motors include the compensation of the battery voltage: log MOTB (LOG_BITMASK) so that it can be undone."
            )
        functions = {given(f"SERVO{channel}_FUNCTION"): channel for channel in range(16, 0, -1)}
        return QUADROTOR | {motor: (f"RCOU.C{functions.get(MOTOR_1 + k - 1, k)}",) for motor, k in zip(MOTORS, order)}

    def thrust(self, name, series):
        """Undoes what the firmware makes of it: compensation of the voltage, thrust curve, range of the motors and of the pulses."""
        if not re.fullmatch(r"RCOU\.C\d+", name):
            return series.x
        given = self.parameters.get
        actuator = motors.share(series.x, *self.limits(name))
        speed = motors.share(actuator, given("MOT_SPIN_MIN", 0), given("MOT_SPIN_MAX", 1))
        voltage, expo = self.voltage(series.t), np.clip(given("MOT_THST_EXPO", 0), -1, 1)
        return np.clip(motors.curve(speed * voltage, expo) / motors.curve(voltage, expo), 0, 1)

    def limits(self, name):
        """Pulse widths of no and of full output."""
        given = self.parameters.get
        low, high = (given(f"MOT_PWM_{end}", 0) or given(f"RC3_{end}", 0) for end in ("MIN", "MAX"))
        if not 0 < low < high:
            raise UserError(f"{self.path}: {name} cannot be scaled, for MOT_PWM_MIN and MOT_PWM_MAX are not in the log; log the parameters")
        return low, high

    def voltage(self, t):
        """Of the battery's highest voltage, as the firmware compensated it; 1 where it did not."""
        if "MOTB" not in self.where:
            return np.ones(len(t))
        with readable(self.path):
            table = self.table(*self.where["MOTB"])
        known = table["BatVolt"] > 0
        return np.interp(t, table["TimeUS"][known] * 1e-6, table["BatVolt"][known]) if known.any() else np.ones(len(t))

    def table(self, fmt, instance):
        """{field: values} of a topic."""
        rows = self.rows(fmt)
        rows = rows[rows[fmt.instance_field] == instance] if fmt.instance_field else rows
        return {name: rows[name] * (times or 1) for name, times in zip(fmt.columns, fmt.msg_mults) if rows[name].dtype.kind != "S"}

    def rows(self, fmt):
        """Messages of a kind; pymavlink's own, one by one, take ten times as long."""
        letters = [self.structs[kind][0] for kind in fmt.format]
        fields = [(name, f"S{s[:-1]}" if s.endswith("s") else f"<{s}") for name, s in zip(fmt.columns, letters)]
        dtype, at = np.dtype(fields), np.array(self.reader.offsets[fmt.type]) + HEADER
        at = at[at + dtype.itemsize <= len(self.data)]
        raw = np.frombuffer(self.data, np.uint8)[at[:, None] + np.arange(dtype.itemsize)]
        return np.ascontiguousarray(raw).view(dtype)[:, 0]


def series(topic, field, table):
    """Series of one field of a topic."""
    x = table[field].astype(float)
    if topic == "POS" and field in ("Lat", "Lng"):
        x = metres(field, x, table["Lat"])
    return Series(table["TimeUS"] * 1e-6, si(topic, field) * x)


def metres(field, degrees, latitude):
    """North or west of the first position, on the plane that touches the Earth there."""
    away = (degrees - degrees[:1]) * METRES
    return away if field == "Lat" else -away * np.cos(DEG * latitude[:1])
