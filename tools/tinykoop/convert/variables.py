"""Crazyflie log variables, the same in every kind of its logs: which make which column, their units and signs."""

import math
import re

from .log import Log, Series

DEG = math.pi / 180
G = 9.80665
FULL = 65535  # of motor.m1 ..: the thrust that is asked for, before the firmware makes up for the voltage
_POSE = {"px": ("stateEstimate.x", "stateEstimateZ.x"), "py": ("stateEstimate.y", "stateEstimateZ.y")}
_ANGLES = {name: (f"stateEstimate.{name}", f"stabilizer.{name}", "stateEstimate.q") for name in ("pitch", "roll", "yaw")}
_IMU = {kind[0] + axis: (f"{kind}.{axis}",) for kind in ("gyro", "acc") for axis in "xyz"}
USUAL = _POSE | _ANGLES | _IMU | {
    "theta": _ANGLES["yaw"],
    "v": ("ctrltarget.vx",),
    "omega": ("ctrltarget.yaw",),
    "u": ("ctrltarget.pitch", "controller.cmd_pitch"),
}  # fmt: skip
QUADROTOR = {
    **{f"{kind}{axis}": (f"stateEstimate.{kind}{axis}", f"stateEstimateZ.{kind}{axis}") for kind in "va" for axis in "xyz"},
    "pz": ("stateEstimate.z", "stateEstimateZ.z"),
    "az": ("stateEstimate.az",),  # that of stateEstimateZ includes gravity
    **{f"m{i}": (f"motor.m{i}",) for i in range(1, 5)},
    "vbat": ("pm.vbat", "pm.vbatMV"),
}

# The firmware's pitch angle is positive nose up, against its own gyro: right-handed about y (left) it is nose down.
UNITS = (
    (r"gyro(Sec)?\.[xyz]", DEG),
    (r"acc(Sec)?\.[xyz]|stateEstimate\.a[xyz]", G),
    (r"(stateEstimate|stabilizer|ctrltarget|controller)\.(roll|yaw)", DEG),
    (r"(stateEstimate|stabilizer|ctrltarget|controller)\.pitch", -DEG),
    (r"controller\.(roll|yaw)Rate", DEG),
    (r"controller\.pitchRate", -DEG),
    (r"controller\.r_pitch", -1.0),
    (r"stateEstimateZ\.(rate(Roll|Yaw)|[va]?[xyz])", 1e-3),
    (r"stateEstimateZ\.ratePitch", -1e-3),
    (r"ctrltargetZ\.[va]?[xyz]|pm\.vbatMV", 1e-3),
)


def si(name):
    """What a log variable is multiplied with; others are taken as they are."""
    return next((factor for pattern, factor in UNITS if re.fullmatch(pattern, name)), 1.0)


class CrazyflieLog(Log):
    """Variables GROUP.NAME, each with times and values."""

    quaternion = ("w", "x", "y", "z")  # stateEstimate.qw ..

    def __init__(self, path, samples, mend):
        """samples: {GROUP.NAME: (t in seconds, values)}."""
        super().__init__(path)
        self.samples, self.usual, self.mend = samples, USUAL, mend
        for name in samples:
            group, _, field = name.partition(".")
            self.topics.setdefault(group, []).append(field)

    def quadrotor(self):
        return QUADROTOR

    def names(self):
        return list(self.samples)

    def read(self, names, commands):
        return {name: Series(self.samples[name][0], self.samples[name][1] * si(name)) for name in names}

    def thrust(self, name, series):
        return series.x / FULL if re.fullmatch(r"motor\.m[1-4]", name) else series.x
