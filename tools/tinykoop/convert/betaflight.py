"""Betaflight Blackbox, as the CSV that its own blackbox_decode writes. Betaflight has x forward, y left, z up.

Header and units: https://github.com/betaflight/blackbox-tools; what is logged: src/main/blackbox/blackbox.c of the firmware.
"""

import math
import re

import numpy as np

from .. import units
from ..plumbing.errors import UserError
from . import table
from .log import FlatLog, Series

BINARY = b"H Product:Blackbox"
TIME = "time"
LABEL = re.compile(r"(?P<name>.+?)(?: \((?P<unit>[^)]*)\))?")
QUATERNION = tuple(f"imuQuaternion[{i}]" for i in range(3))  # x, y, z; w is positive
ONE = 0x7FFF  # what 1 is in it
USUAL = {
    **{f"g{axis}": (f"gyroADC[{i}]",) for i, axis in enumerate("xyz")},
    **{f"a{axis}": (f"accSmooth[{i}]",) for i, axis in enumerate("xyz")},
    "pitch": ("imuQuaternion", "pitch"),
    "roll": ("imuQuaternion", "roll"),
    "yaw": ("imuQuaternion", "heading"),
    "u": ("setpoint[1]",),
}
# Of columns whose header has no unit. A heading turns clockwise, against the gyro.
UNITS = (
    (r"gyro(ADC|Unfilt)\[\d\]|setpoint\[[012]\]", math.pi / 180),
    (r"pitch|roll", math.pi / 180),
    (r"heading", -math.pi / 180),
)
DECODE = "blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2 --simulate-imu LOG"


def is_mine(path, head):
    return head.startswith((BINARY, b"loopIteration,"))


def open_log(path, damaged):
    names, _ = table.header(path)
    if names[0].startswith(BINARY.decode()):
        raise UserError(f"{path}: decode it first, with Betaflight's own {DECODE}, and convert the CSV that it writes")
    if names[0] != "loopIteration":
        raise UserError(f"{path}:1: loopIteration was expected as first column, as blackbox_decode writes")
    return Blackbox(path, names, damaged)


class Blackbox(FlatLog):
    mend = f"have it logged, decode by {DECODE}"
    quaternion = (".w", ".x", ".y", ".z")

    def __init__(self, path, names, damaged):
        labels = {name: LABEL.fullmatch(name) for name in names if name}
        self.columns = {label["name"]: (name, label["unit"]) for name, label in labels.items()}
        parts = [f"imuQuaternion{part}" for part in self.quaternion] if all(q in self.columns for q in QUATERNION) else []
        raw = [name for name in self.columns if name.startswith("accSmooth") and not self.columns[name][1]]
        super().__init__(path, [name for name in self.columns if name not in raw] + parts)
        self.usual, self.damaged = USUAL, damaged
        if TIME not in self.columns:
            raise UserError(f"{path}:1: has no column time; decode the log without --raw")

    def read(self, names, commands):
        wanted = {column for name in names for column in (QUATERNION if name.startswith("imuQuaternion.") else [name])}
        labels = {name: self.columns[name][0] for name in (TIME, *wanted)}
        data = table.read(self.path, set(labels.values()), self.damaged)
        values = {name: data[label] * self.si(name) for name, label in labels.items()}
        values |= attitude(*(values[q] for q in QUATERNION)) if set(QUATERNION) <= wanted else {}
        return {name: Series(values[TIME], values[name]) for name in names}

    def si(self, name):
        """What a column is multiplied with, by the unit in its header."""
        unit = self.columns[name][1]
        if unit is not None:
            return units.base(unit)[1]
        return next((factor for pattern, factor in UNITS if re.fullmatch(pattern, name)), 1.0)


def attitude(x, y, z):
    """The quaternion's four parts, of the three that are logged."""
    x, y, z = x / ONE, y / ONE, z / ONE
    w = np.sqrt(np.maximum(1 - x * x - y * y - z * z, 0))
    return {f"imuQuaternion{part}": values for part, values in zip(Blackbox.quaternion, (w, x, y, z))}
