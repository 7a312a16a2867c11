"""Healthy flights to compare with: those of the vehicle itself, or of the simulated one."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from .... import bridge
from . import features
from .features import NAMES, REQUESTS

SECONDS, FIRST, EACH = 30, 1001, 8  # of simulated flights: s, first seed, of each kind
KINDS = ("hover", "legs", "mixed")
# Standard deviation by which a flight differs from a healthy one of another day; thrust, roll, pitch, yaw and drift in 1 of the mean
# request. The first four are of two sessions of healthy flights of one Crazyflie, which lie 1, 2, 1.6 and 1.3 % apart, yaw being wider
# in the flights of its other vehicle. The others are chosen: more than simulated flights differ
SPREAD = {
    "thrust": 0.012, "roll": 0.02, "pitch": 0.016, "yaw": 0.02, "drift": 0.03, "roll drift": 0.015,
    "pitch drift": 0.015, "yaw drift": 0.02, "swing": 0.3, "push x": 0.12, "push y": 0.12, "drag": 0.15,
    "gyro x": 0.02, "gyro y": 0.02, "gyro z": 0.02, "acceleration x": 0.15, "acceleration y": 0.15, "acceleration z": 0.15, "lag": 0.015,
    "delay": 0.006, "vibration": 0.35,
}  # fmt: skip
# Features of the simulated vehicle that differ alike
ALIKE = (("roll", "pitch", "yaw"), ("roll drift", "pitch drift", "yaw drift"), ("push x", "push y"), ("gyro x", "gyro y", "gyro z"),
         ("acceleration x", "acceleration y", "acceleration z"))  # fmt: skip
# Of the mean request, that it falls per volt less, and by how much vehicles differ in that; of a simulated one
VOLTS, VOLTS_SD, SIMULATED_SD = 0.08, 0.05, 0.01
# That flights differ by at least: these follow what is flown, and lag and delay how often and how hard the controller acts between rows
LEAST = {"vibration": 0.03, "lag": 0.012, "delay": 0.001}


@dataclass(frozen=True)
class Baseline:
    """flights: Features of healthy flights; spread (F,): by how much they differ; own: whether of the vehicle itself; volts: (of the
    mean request, that it falls per volt less, its standard deviation)."""

    flights: tuple
    spread: np.ndarray
    own: bool
    volts: tuple


def of_vehicle(flights):
    """The Baseline of the Features of healthy flights of the vehicle."""
    mean = np.mean([one.asked[0] for one in flights])
    return Baseline(
        tuple(flights), np.array([SPREAD[name] * (mean if name in REQUESTS else 1.0) for name in NAMES]), True, (VOLTS, VOLTS_SD)
    )


def mean_of(values):
    """Mean (F,) of what is there of values (n, F); NaN of nothing."""
    there = np.isfinite(values)
    count = there.sum(0)
    return np.where(count > 0, np.where(there, values, 0.0).sum(0) / np.maximum(count, 1), np.nan)


@lru_cache(maxsize=4)
def simulated(vehicle="crazyflie"):
    """The Baseline of a vehicle of host_sim/: the mean of its healthy flights, and by how much they differ from that."""
    flown = [(kind, FIRST + EACH * i + k) for i, kind in enumerate(KINDS) for k in range(EACH)]
    found = [features.of(bridge.quadrotor(kind, SECONDS, seed, vehicle=vehicle)[0]) for kind, seed in flown]
    volts = float(np.mean([one.volts for one in found]))
    values = np.array([one.values for one in found])
    slope = -bridge.quadrotor_vehicle(vehicle)["voltage_slope"]
    values[:, 0] *= 1 - slope * (np.array([one.volts for one in found]) - volts)
    mean, count = mean_of(values), np.isfinite(values).sum(0)
    variances = np.nanvar(values, axis=0, ddof=1) * (1 + 1 / count)
    for names in ALIKE:
        columns = [NAMES.index(name) for name in names]
        variances[columns] = variances[columns].mean()
    for name, least in LEAST.items():
        variances[NAMES.index(name)] = max(variances[NAMES.index(name)], least**2)
    return Baseline(
        (replace(found[0], values=mean, errors=np.zeros(len(mean)), volts=volts),), np.sqrt(variances), False, (slope, SIMULATED_SD)
    )
