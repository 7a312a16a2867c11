"""What healthy flights leave: the simulator's own, or one of the vehicle's, to which the simulator is fitted first."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from .... import bridge
from ...prediction_errors.ahead import HORIZONS
from ...prediction_errors.fit import Fitter
from ...prediction_errors.healthy import Whitener
from .path import FIRST, Path, effects
from .vehicle import SHAKEN, follower, measured, observer_gain, predictable, settled, turns_yaw

SECONDS, SEEDS = 40, {"hover": (1001, 1002), "pitch": (1003, 1004), "yaw": (1005, 1006)}  # of the simulated flights
WINDOW = 10  # rows between predictions
PART = 6.0  # s, of a healthy flight's parts, at least
LEAST_BETWEEN = 0.01  # by which no two flights shake alike


@dataclass(frozen=True, eq=False)
class Baseline:
    """Effects (base) that the healthy vehicle has beside the nominal simulator, and the flights that show its noise.

    flights: [(log, innovations (K, 9))]; shaking (6,): RMS of what gyro and accelerometer change from row to row.
    """

    base: tuple
    flights: tuple
    shaking: np.ndarray
    spread: float  # standard deviation of log(shaking) over a second,
    between: float  # and between flights

    @cached_property
    def whitener(self):
        """What takes the noise of these flights for white."""
        return Whitener.fitted([missed for _, missed in self.flights])

    def on(self, yaw):
        """Logs on this axis, or all if there are none."""
        logs = [log for log, _ in self.flights]
        return [log for log in logs if turns_yaw(log) == yaw] or logs

    @lru_cache(maxsize=2)
    def missed(self, yaw):
        """RMS (H, 9) of what predictions miss on flights on this axis."""
        ahead = [follower(log, observer_gain(log))(self.base, starts=predictable(log)[::WINDOW], steps=HORIZONS)[1] for log in self.on(yaw)]
        return np.sqrt(np.mean(np.concatenate(ahead) ** 2, axis=0))

    @lru_cache(maxsize=2)
    def differ(self, yaw):
        """{effect: variances (p,)}: by how much healthy flights on this axis differ as if it acted, beyond noise."""
        found = [_feigned(self.path(log, differ={})) for log in self.on(yaw)]
        if len(found) < 2:
            return {}
        return {
            name: np.maximum(np.mean([f[name][0] ** 2 - f[name][1] for f in found], axis=0), 0.0) * (usual_shows(found, name))
            for name in effects()
        }

    def path(self, log, parts=None, without=(), differ=None):
        """The Path of a log beside these flights; parts: other noise than theirs."""
        yaw = turns_yaw(log)
        parts = parts or [(np.ones(len(log.x), bool), self.whitener)]
        return Path(log, parts, self.missed(yaw), self.base, self.differ(yaw) if differ is None else differ, without)


def _feigned(path):
    """{effect: (its parameters by themselves, in usual sizes (p,), their variances)}, to first order."""
    fitter, out = Fitter(path, path.noises.first(path)), {}
    left = fitter.fit_of(()).left
    for name, effect in path.effects.items():
        changes = np.stack([path.response(name, i, FIRST[0]) for i in range(len(effect.parameters))], -1)
        J = fitter.whiten(changes, np.zeros_like(changes)) / FIRST[0]
        inverse = np.linalg.pinv(J.T @ J, rcond=1e-9)
        out[name] = -inverse @ (J.T @ left), np.diag(inverse)
    return out


def usual_shows(found, name):
    """Whether an effect of usual size shows in these flights at all."""
    return np.mean([f[name][1] for f in found], axis=0) < 1


def shaking(log):
    """Mean square (K - 1, 6) change of gyro and accelerometer; NaN where a transition is not usable."""
    change = np.diff(measured(log)[:, SHAKEN], axis=0) ** 2
    change[~log.usable] = np.nan
    return change


def levels(change, healthy, dt):
    """log of the shaking over a healthy one, for every second (T,)."""
    rows = round(1 / dt)
    blocks = change[: len(change) // rows * rows].reshape(-1, rows, change.shape[1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return 0.5 * np.log(np.nanmean(blocks, axis=1) / healthy**2).mean(axis=1)


def _of(base, flights):
    change = np.concatenate([shaking(log) for log, _ in flights])
    healthy = np.sqrt(np.nanmean(change, axis=0))
    each = [levels(shaking(log), healthy, log.dt) for log, _ in flights]
    within = np.sqrt(np.mean([np.nanvar(level) for level in each]))
    return Baseline(
        tuple(base), tuple(flights), healthy, float(within), max(float(np.std([np.nanmean(level) for level in each])), LEAST_BETWEEN)
    )


@lru_cache(maxsize=4)
def simulated(vibration=0.0):
    """The Baseline of the simulated vehicle, which shakes this share more than usual."""
    active = [bridge.Effect("vibration", (vibration,), 0.0, np.inf)] if vibration else []
    flights = []
    for manoeuvre, seeds in SEEDS.items():
        for seed in seeds:
            log, _ = bridge.fwmav(manoeuvre, SECONDS, seed, active)
            flights.append((log, followed(log, active)))
    return _of((), flights)


def followed(log, active):
    """Innovations (K, 9) of a log with these effects; NaN where the observer does not know the vehicle yet."""
    missed, _ = follower(log, observer_gain(log))(active)
    missed[~settled(log)] = np.nan
    return missed


def of_vehicle(logs, base):
    """The Baseline of healthy flights of the vehicle, which the simulator follows with the effects `base`.

    Parts of a flight count as flights: by as much as they differ, other flights will.
    """
    parts = [part for log in logs for part in _parts(log)]
    return _of(base, [(part, followed(part, base)) for part in parts])


def _parts(log):
    """A log cut into parts, each of which can be predicted; the whole one where there are none."""
    count = max(2, int((len(log.x) - 1) * log.dt / PART))
    edges = np.arange(count + 1) * (len(log.x) - 1) // count
    return [part for part in (_part(log, a, b + 1) for a, b in zip(edges, edges[1:])) if len(predictable(part))] or [log]


def _part(log, first, last):
    """Rows first to last of a log."""
    return bridge.Log(log.t[first:last] - log.t[first], log.x[first:last], log.u[first:last], log.usable[first : last - 1], log.dt)
