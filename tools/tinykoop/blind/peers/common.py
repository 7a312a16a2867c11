"""What the peers share: rows kept back, a noise estimate, least squares on windows, the gap, the report."""

from dataclasses import dataclass
from functools import wraps
from itertools import product

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm

from ... import bridge
from .. import plant

HORIZONS = (1, 10, 50)
WINDOW = 20  # steps that a fit predicts ahead
_STRETCH = 100  # rows; two such stretches are fitted, the third is kept back
# Robust scale of what a model leaves, in units of the noise: above it the log is `unknown`. The true model stays
# below on 97 % of 450 logs of host_sim: healthy or one effect; white, coloured or heavy-tailed noise.
MOST_LEFT = 1.3


@dataclass
class Data:
    """A log, with its transitions for fitting and those kept back."""

    x: np.ndarray  # (K, 3)
    u: np.ndarray  # (K, 2)
    dt: float
    span: tuple  # s, first and last row
    usable: np.ndarray  # (K - 1,)
    fit: np.ndarray  # (K - 1,), a part of usable; the rest is kept back

    @classmethod
    def read(cls, path):
        log = bridge.read_log(path)
        return cls.of(log.x, log.u, log.dt, log.usable, (log.t[0], log.t[-1]))

    @classmethod
    def of(cls, x, u, dt, usable=None, span=None):
        usable = np.ones(len(x) - 1, bool) if usable is None else usable
        stretch = max(1, min(_STRETCH, len(x) // 3))
        kept = np.arange(len(x) - 1) // stretch % 3 == 2
        return cls(x, u[: len(x)], dt, span or (0.0, dt * (len(x) - 1)), usable, usable & ~kept)

    @property
    def kept(self):
        return self.usable & ~self.fit

    @property
    def peak(self):
        return np.maximum(np.max(np.abs(self.u[:-1]), axis=0), 1e-6)

    def starts(self, mask, steps, stride=1):
        """Rows from which `steps` transitions are all in `mask`."""
        count = np.concatenate([[0], np.cumsum(mask)])
        return np.flatnonzero(count[steps:] - count[:-steps] == steps)[::stride] if steps < len(count) else []

    def residual(self, starts, steps, active=()):
        """(S, 3), what the simulator with these effects leaves."""
        return bridge.windows(self.x, self.u, self.dt, starts, [steps], active, integrator=bridge.ARC)[1][:, 0]

    def moved(self, starts, steps):
        """(S, 2), how far the measured position moved, in the axes of the pose at the start [m]."""
        d = (self.x[starts + steps, :2] - self.x[starts, :2]) @ (1, 1j) * np.exp(-1j * self.x[starts, 2])
        return np.stack([d.real, d.imag], axis=1)


# ---- noise -----------------------------------------------------------------------------------


def scale(values):
    """Robust standard deviation about zero."""
    values = values[np.isfinite(values)]
    return float(np.median(np.abs(values)) / norm.ppf(0.75)) if len(values) else 0.0


@dataclass
class Noise:
    """Noise of positions and heading: robust standard deviations, AR(1) coefficient per step, weight of the tails."""

    sp: float  # m
    st: float  # rad
    rho: float = 0.0
    tails: float = 1.0  # standard deviation over the robust one

    @classmethod
    def of(cls, data, model=None):
        """From third differences, which know no model. Colour and tails need one: what it leaves in a step.

        An error of the model looks like colour, so the channel with the least of it counts.
        """
        d = np.diff(data.x, axis=0)
        d[:, 2] = np.angle(np.exp(1j * d[:, 2]))
        d = np.diff(d, n=2, axis=0)[data.usable[:-2] & data.usable[1:-1] & data.usable[2:]]
        rho, tails = 0.0, 1.0
        starts = data.starts(data.usable, 1)
        if model and len(starts) > 20:
            e = np.full((len(data.usable), 3), np.nan)
            e[starts] = model(data, starts, 1)
            e -= np.nanmedian(e, axis=0)
            e /= np.array([scale(column) for column in e.T]) + 1e-12
            tails = float(np.clip(np.median(np.nanstd(np.clip(e, -10, 10), axis=0)), 1, 1.5))
            e = np.clip(e, -3, 3)
            rho = float(np.clip(np.min(1 + 2 * np.nansum(e[1:] * e[:-1], axis=0) / np.nansum(e * e, axis=0)), 0, 0.95))
        third = np.sqrt(20 - 30 * rho + 12 * rho**2 - 2 * rho**3)
        return cls(scale(d[:, :2].ravel()) / third + 1e-6, scale(d[:, 2]) / third + 1e-6, rho, tails)

    def covariance(self, moved, steps):
        """(S, 3, 3) of a window's residual: noise of its last pose less that of its first, carried along."""
        S = np.diag([self.sp**2, self.sp**2, self.st**2])
        J = np.tile(np.eye(3), (len(moved), 1, 1))
        J[:, 0, 2], J[:, 1, 2] = -moved[:, 1], moved[:, 0]
        JS = J @ S
        return S + JS @ J.transpose(0, 2, 1) - self.rho**steps * (JS + JS.transpose(0, 2, 1))

    def whitener(self, data, starts, steps):
        return np.linalg.inv(np.linalg.cholesky(self.covariance(data.moved(starts, steps), steps)))


def left(data, model):
    """The largest robust scale over the channels of what a model leaves in windows kept back, 1 being noise.

    model(data, starts, steps) -> (S, 3), residuals.
    """
    noise = Noise.of(data, model)
    starts = data.starts(data.kept, WINDOW, 2)
    if len(starts) < 10:
        starts = data.starts(data.usable, WINDOW, 2)
    white = np.einsum("sij,sj->si", noise.whitener(data, starts, WINDOW), model(data, starts, WINDOW))
    return max(scale(column) for column in white.T)


# ---- least squares on windows ------------------------------------------------------------------

# Where a fit of the effect may begin: the best of a grid. What is not here begins at zero. Shares are of the
# largest command: thresholds have no slope at zero.
_BEGIN = {
    "actuator_lag": [(0.05, 0.15, 0.4, 0.8)],
    "transport_delay": [(0.05, 0.15, 0.3, 0.6)],
    "battery_sag": [(0.05, 0.15, 0.4)],
    "backlash": [(0.02, 0.05, 0.1, 0.2)],
    "pacejka_slip": [(10.0,), (1.6,), (0.02, 0.06, 0.15, 0.4), (0.3,), (0.0, 0.45)],
    "stribeck_friction": [(0.02, 0.1, 0.4), (0.02, 0.1), (0.0, 0.08), (0.5, 1.0)],
    "speed_lag": [(0.05, 0.15, 0.4, 0.8)],
    "yaw_lag": [(0.05, 0.15, 0.4, 0.8)],
    "acceleration_limit": [(0.3, 0.8, 2.0, 6.0), (0.3, 0.8, 2.0, 6.0)],
    "wheel_dead_band": [(0.02, 0.05, 0.1, 0.2), (0.5,)],
    "wheel_saturation": [(0.5, 0.9, 1.4), (0.5,)],
}
_BEGIN_SHARES = {
    "dead_band": [(0.01, 0.03, 0.05, 0.08, 0.12, 0.18, 0.25, 0.35)] * 2,
    "saturation": [(0.0, 0.1, 0.25, 0.4, 0.6)] * 2,
}
_FIXED = {"pacejka_slip": ("C", "E")}  # hardly distinguishable from B and D: kept at their usual values
_SHAPE = {"pacejka_slip": ("B", "lat"), "stribeck_friction": ("vs",)}  # nothing without the other parameters


class Fit:
    """Bounded least squares of some effects' parameters on windows of a log, robust to outliers.

    Coordinates are parameters over their usual values, and zero is no effect; for `saturation`, which does
    nothing when large, the share of the largest command that is clipped.
    """

    def __init__(self, data, noise, names, steps=WINDOW, stride=4, prior=None, begin=None):
        """prior: standard deviation of the coordinates about zero (None: none); begin: {name: coordinates}."""
        table = bridge.effects()
        self.data, self.names, self.steps, self.prior = data, tuple(names), steps, prior
        self.rows = {name: list(table[name][1]) for name in self.names}
        self.places = [(n, i) for n in self.names for i, r in enumerate(self.rows[n]) if r[0] not in _FIXED.get(n, ())]
        self.amplitude = np.array([self.rows[n][i][0] not in _SHAPE.get(n, ()) for n, i in self.places], bool)
        self.starts = data.starts(data.fit, steps, stride)
        self.white = noise.whitener(data, self.starts, steps)
        # overlapping windows tell less than their number when the noise is coloured
        shared = noise.rho**stride
        self.repeats = (1 + shared) / (1 - shared)
        z = self._begin(begin or {})
        if len(z):
            low, high = self._bounds()
            z = least_squares(
                self._cost, np.clip(z, low + 1e-9, high - 1e-9), self._jacobian, (low, high), loss="soft_l1",
                f_scale=3.0, max_nfev=25, xtol=1e-4, ftol=1e-5,
            ).x  # fmt: skip
        self._finish(z)

    def _unit(self, name, i):
        return self.data.peak[i] if name == "saturation" else abs(self.rows[name][i][4])

    def _bounds(self):
        low, high = [], []
        for name, i in self.places:
            row, unit = self.rows[name][i], self._unit(name, i)
            low.append(0 if name == "saturation" else row[2] / unit)
            high.append(0.95 if name == "saturation" else row[3] / unit)
            if name == "dead_band":
                high[-1] = self.data.peak[i] / unit
        return np.array(low, float), np.array(high, float)

    def _grid(self, name):
        places = [i for n, i in self.places if n == name]
        if len(_BEGIN.get(name, ())) == len(self.rows[name]):
            grid = [[value / self._unit(name, i) for value in _BEGIN[name][i]] for i in places]
        elif name == "saturation":
            grid = _BEGIN_SHARES[name]
        elif name == "dead_band":
            grid = [[s * self.data.peak[i] / self._unit(name, i) for s in _BEGIN_SHARES[name][i]] for i in places]
        else:
            grid = [(0.0,)] * len(places)
        return [np.array(point) for point in product(*grid)]

    def _begin(self, begin):
        """What is not in `begin` starts at its best grid point: the one that explains most first, the others on top."""
        points = {name: begin[name] for name in self.names if name in begin}
        active = [effect for name, z in points.items() for effect in self._effects(name, z)]

        def best(name):
            grid = self._grid(name)
            if len(grid) == 1:
                return np.inf, grid[0]
            costs = [np.sum(np.minimum(self._white(active + self._effects(name, z)) ** 2, 9)) for z in grid]
            return min(costs), grid[int(np.argmin(costs))]

        alone = {name: best(name) for name in self.names if name not in points}
        for rank, name in enumerate(sorted(alone, key=lambda name: alone[name][0])):
            points[name] = best(name)[1] if rank else alone[name][1]
            active += self._effects(name, points[name])
        return np.concatenate([points[name] for name in self.names] or [[]])

    def _effects(self, name, z):
        values = [row[4] for row in self.rows[name]]
        for value, i in zip(z, (i for n, i in self.places if n == name)):
            values[i] = (1 - value if name == "saturation" else value) * self._unit(name, i)
        low, high = ([row[k] for row in self.rows[name]] for k in (2, 3))
        return [bridge.Effect(name, tuple(np.clip(values, low, high)))]

    def active(self, z=None):
        """The effects as fitted."""
        z = self.z if z is None else z
        owners = np.array([n for n, _ in self.places])
        return [effect for name in self.names for effect in self._effects(name, z[owners == name])]

    def fitted(self):
        """For another fit to begin with."""
        owners = np.array([n for n, _ in self.places])
        return {name: self.z[owners == name] for name in self.names}

    def cost_at(self, z):
        """Chi-square at these coordinates with outliers cut back: twice soft_l1's cost."""
        return 18 * np.sum(np.sqrt(1 + self._white(self.active(z)) ** 2 / 9) - 1)

    def _white(self, active):
        residual = self.data.residual(self.starts, self.steps, active)
        return np.einsum("sij,sj->si", self.white, residual).ravel()

    def _cost(self, z):
        white = self._white(self.active(z))
        return white if self.prior is None else np.concatenate([white, z / self.prior])

    def _jacobian(self, z, *_):
        low, high = self._bounds()
        here, columns = self._cost(z), []
        for j, (name, _) in enumerate(self.places):
            step = 0.05 if name == "dead_band" else 1e-3  # a dead band's slope shows only over some commands
            step = -step if z[j] + step > high[j] else step
            moved = z.copy()
            moved[j] += step
            columns.append((self._cost(moved) - here) / step)
        return np.stack(columns, axis=1)

    def _finish(self, z):
        self.z = z
        white = self._white(self.active())
        self.spread = max(scale(white), 1) ** 2 * self.repeats
        self.information = np.zeros((0, 0))
        if len(z):
            J = self._jacobian(z)
            self.information = J.T @ J / self.spread

    def effects(self, confidence):
        """Entries of the report; confidence: {name: in 0 to 1}."""
        error = np.sqrt(np.diag(np.linalg.pinv(self.information)))
        found = []
        for effect in self.active():
            name, entry = effect.name, {}
            params = dict(zip((row[0] for row in self.rows[name]), map(float, effect.parameters)))
            for (n, i), e in zip(self.places, error):
                if n == name:
                    half, value = 1.96 * float(e) * self._unit(n, i), float(effect.parameters[i])
                    entry[self.rows[n][i][0]] = [value - half, value + half]
            found.append(
                {"name": name, "confidence": float(confidence[name]), "params": params, "params_ci95": entry,
                 "segments": [list(map(float, self.data.span))]}
            )  # fmt: skip
        return found


def simulator(active):
    """A model as left() and gap() take it: the simulator with these effects."""
    return lambda data, starts, steps: data.residual(starts, steps, active)


def candidates(without=()):
    """The effects that the logs have, less what may not be named; their other forms are not the peers' concern."""
    return [name for name in plant.PLAIN if name in bridge.effects() and name not in without]


def on_one_core(peer):
    """Many logs run side by side: threads of one would only wait for another's."""

    @wraps(peer)
    def call(*arguments, **keywords):
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):
            return peer(*arguments, **keywords)

    return call


# ---- report ----------------------------------------------------------------------------------


def gap(data, noise, model, mask):
    """RMS position errors in windows of transitions in `mask`, of the nominal simulator and of the model."""
    found = {"before": {}, "after": {}, "noise_floor": {}, "closed_fraction": {}}
    for steps in HORIZONS:
        starts = data.starts(mask, steps)
        if len(starts) == 0:
            for entry in found.values():
                entry[str(steps)] = None
            continue
        C = noise.covariance(data.moved(starts, steps), steps)
        floor = noise.tails * np.sqrt(np.mean(C[:, 0, 0] + C[:, 1, 1]))
        errors = [simulator(())(data, starts, steps), model(data, starts, steps)]
        before, after = (np.sqrt(np.mean(np.sum(e[:, :2] ** 2, axis=1))) for e in errors)
        room = before - floor
        values = (before, after, floor, (before - after) / room if room > 0.05 * floor else None)
        for entry, value in zip(found.values(), values):
            entry[str(steps)] = None if value is None else float(value)
    return found


def report(data, model, fresh_path, verdict, effects, ranking):
    """ranking: {name: score}, any order."""
    ranked = sorted(ranking.items(), key=lambda item: -item[1])
    result = {
        "verdict": verdict,
        "effects": effects,
        "ranking": [{"name": name, "score": float(score)} for name, score in ranked],
        "ambiguous_with": {},
        "gap": gap(data, Noise.of(data, model), model, data.kept),
    }
    if fresh_path is not None:
        fresh = Data.read(fresh_path)
        result["fresh"] = {"gap": gap(fresh, Noise.of(fresh, model), model, fresh.usable)}
    return result
