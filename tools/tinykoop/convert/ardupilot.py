"""ArduPilot dataflash log (.BIN), read by pymavlink. Body FRD to x forward, y left, z up; NED to north, west, up.

What the messages are: https://ardupilot.org/rover/docs/logmessages.html and https://ardupilot.org/copter/docs/logmessages.html
"""

import contextlib
import io
import math
import os
import re

import numpy as np

from ..plumbing.asked import package
from ..plumbing.errors import UserError
from .choose import listed
from .log import Log, Series

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

    def table(self, fmt, instance):
        """{field: values} of a topic; pymavlink's own messages, one by one, take ten times as long."""
        letters = [self.structs[kind][0] for kind in fmt.format]
        fields = [(name, f"S{s[:-1]}" if s.endswith("s") else f"<{s}") for name, s in zip(fmt.columns, letters)]
        dtype, at = np.dtype(fields), np.array(self.reader.offsets[fmt.type]) + HEADER
        at = at[at + dtype.itemsize <= len(self.data)]
        raw = np.frombuffer(self.data, np.uint8)[at[:, None] + np.arange(dtype.itemsize)]
        rows = np.ascontiguousarray(raw).view(dtype)[:, 0]
        rows = rows[rows[fmt.instance_field] == instance] if fmt.instance_field else rows
        return {name: rows[name] * (times or 1) for name, times in zip(fmt.columns, fmt.msg_mults) if rows[name].dtype.kind != "S"}


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
