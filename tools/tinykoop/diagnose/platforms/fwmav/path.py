"""The flapping-wing vehicle of host_sim/: what an observer of the simulated one misses of a logged flight."""

from dataclasses import replace

import numpy as np

from .... import bridge
from ...prediction_errors import path
from ...prediction_errors.fit import Effect
from ...prediction_errors.healthy import Healthy
from ...robot import Parameter
from .vehicle import ANGLES, CHANNELS, UNITS, follower, measured, observer_gain, settled, turns_yaw

name = "fwmav"
NOT_FITTED = ("vibration",)  # measured: it is noise
TRANSIENT = ("gust",)
FIRST = (0.3, 1.0)  # of the usual size, from which what has one sign only is tried
BIASES = (0.005,) * 3 + (0.1,) * 3  # of gyro and accelerometer, rad/s and m/s^2: what calibration leaves (host_sim/fwmav_flight.c)
WINDOWS = 400  # predictions at most, spread over the log
SMALLEST = 0.1  # of what predictions of healthy flights miss: a smaller gap does not matter
SMOOTH = 0.08  # s
PUSH = (0.3, 0.3, 0.3, 4.0, 4.0, 4.0)  # m/s^2 and rad/s^2, of a generic acceleration
LATE = 1.0  # of what noise makes of lag and delay, that they are off beside it: on 24 healthy flights, 0.8 to 1.4 by manoeuvre
KEPT = 6.4e7  # bytes of innovations that are not worked out again
AXES = ("x", "y", "z")
ANGLE = (7, 6, 8)  # columns of a log: roll, pitch, yaw


def _starts(spec):
    usual = np.array([p.usual for p in spec])
    if all(p.low < 0 < p.high for p in spec):
        return tuple(map(tuple, np.diag(usual)))
    return tuple(tuple(share * usual) for share in FIRST)


def effects():
    """{name: Effect} in the order of action: innovations are nearly linear in all of them."""
    found = {}
    for key, (block, rows) in bridge.effects(name).items():
        spec = tuple(Parameter(*row) for row in rows)
        if key not in NOT_FITTED:
            linear = all(p.low < 0 < p.high for p in spec)
            found[key] = Effect(key, block, spec, _starts(spec), linear, transient=key in TRANSIENT, formula=bridge.formulas(name)[key])
    return found


class Path(path.Path):
    """A flight as the engine takes it: what is told of a step is the observer's innovation, measured less predicted.

    base: effects that a healthy vehicle has too. parts, missed: as Healthy takes them. differ: {effect: variances of its parameters,
    in usual sizes} by which healthy flights differ.
    """

    channels = tuple(f"{how} {axis}" for how in ("along", "about") for axis in AXES)  # generic accelerations
    gaps = {"attitude": ("rad", tuple(range(*ANGLES.indices(len(CHANNELS)))))}
    sensors, pushes = {channel: (unit, c) for c, (channel, unit) in enumerate(zip(CHANNELS, UNITS))}, {}
    wraps = tuple(unit == "rad" for unit in UNITS)
    command_names, steered = ("u",), True
    usual = np.zeros(0)  # random motion is in the noise of healthy flights
    variants, variant = ("as it flies",), 0
    alike_rows = 50  # that tell about as much as one: a manoeuvre lasts half a second
    alias = 0.9  # share of what an effect does, from which on another that does it may be it: the simulator is not that exact
    stray = False  # rows that stand alone are the air's, as when a gust sets in
    matters_ahead = False  # wing beat and turbulence hide much of what an effect does to predictions, and innovations show it

    def __init__(self, log, parts, missed, base=(), differ=None, without=()):
        self.log, self.dt, self.base = log, log.dt, tuple(base)
        self.gain = observer_gain(log)
        self.follow = follower(log, self.gain)
        self.rows, self.t = np.arange(len(log.x)), np.arange(len(log.x)) * log.dt
        self.known = settled(log) & np.any([rows for rows, _ in parts], axis=0)
        self.breaks = np.concatenate([[True], ~log.usable]) | ~settled(log)
        self.begins = self.breaks.astype(np.int32)
        self.settled = int(self.known.argmax())
        self.present = np.where(self.known, 1.0, np.inf)[:, None] * np.ones(len(CHANNELS))
        self.effects = {key: effect for key, effect in effects().items() if key not in without}
        self._kept = path.Kept(KEPT)
        self.noises, self.sensor_scale = Healthy(parts, missed), missed[0]
        self._mean = self.noises.mean(self)
        self.noises.allow(self, np.stack([*self._biases(), *self._differ(differ or {})], -1))

    @property
    def readings(self):
        return measured(self.log)

    # ---- what healthy flights have in common and what not --------------------------------------------------

    def _biases(self):
        plain = self.innovations(())
        for channel, size in enumerate(BIASES):
            shifted = replace(self.log, x=self.log.x + size * np.eye(self.log.x.shape[1])[channel])
            yield np.nan_to_num(follower(shifted, self.gain)(self.base)[0] - self._mean) - plain

    def _differ(self, differ):
        for key, variances in differ.items():
            for i in np.flatnonzero(variances > 0):
                yield self.response(key, i, np.sqrt(variances[i]))

    def response(self, key, i, size):
        """What parameter i of an effect, of so many usual sizes, changes of the innovations (K, 9)."""
        spec = effects()[key].parameters
        params = [float(np.clip(size * (abs(p.usual) or 1.0) * (k == i), p.low, p.high)) for k, p in enumerate(spec)]
        return self._missed([bridge.Effect(key, tuple(params))]) - self.innovations(())

    # ---- what the engine asks ------------------------------------------------------------------------------

    def _missed(self, active, push=None):
        return np.nan_to_num(self.follow([*self.base, *active], push)[0] - self._mean)

    def innovations(self, causes):
        """Less the mean of healthy ones (K, 9), with causes; 0 where there are none."""
        return self._kept.get(tuple(causes), lambda: self._missed(acting(causes)))

    def steps(self, trials):
        """Innovations (K, 9, trials), and nothing that readings miss beside."""
        D = np.stack([self.innovations(causes) for causes in trials], -1)
        return D, np.zeros_like(D)

    @staticmethod
    def doubt(causes):
        """Turbulence that the controller answers looks like a servo that is late; a few healthy flights do not tell by how much."""
        return LATE if any(c.name in ("lag", "delay") for c in causes) else 0.0

    def step_by(self, variant):
        """There is but one."""

    @staticmethod
    def most_starts(horizon):
        return WINDOWS

    def ahead(self, causes, starts, horizons):
        """Measured less predicted (S, H, 9), from what the observer made of the rows before."""
        return self.follow([*self.base, *acting(causes)], starts=starts, steps=horizons)[1]

    def smallest_of(self, gap, noise, rows=50):
        """A gap that matters, rad."""
        return SMALLEST * float(np.sqrt((self.noises.missed[-1, list(self.gaps[gap][1])] ** 2).sum()))

    def generic(self, left):
        """[((function, acceleration))], what accelerations of the body by plain functions of command, motion and time change (K, 9, q)."""
        names, columns, plain = [], [], self.innovations(())
        for title, (values, accelerations) in functions(self.log).items():
            for j in accelerations:
                push = np.zeros((len(values), 6))
                push[:, j] = PUSH[j] * values
                columns.append(self._missed((), push) - plain)
                names.append((title, j))
        return names, np.stack(columns, -1)


def acting(causes):
    """Causes as the simulator takes them."""
    return [bridge.Effect(c.name, c.params, max(a, 0.0), b) for c in causes for a, b in c.segments]


def functions(log):
    """{name: (values (K,), accelerations it drives)}; accelerations along x, y, z: 0 to 2, about them: 3 to 5."""
    rows = max(round(SMOOTH / log.dt), 1)
    # of the past alone: what was yet to come would give away the noise that the innovations are
    smooth = lambda v: np.convolve(np.nan_to_num(v), np.full(rows, 1 / rows))[: len(v)]  # noqa: E731
    scaled = lambda v: v / (np.std(v) + 1e-9)  # noqa: E731
    u, t = log.u[:, 0] - log.u[:, 0].mean(), np.linspace(-1, 1, len(log.x))
    axis = 5 if turns_yaw(log) else 4
    table = {"always": (np.ones(len(t)), (0, 1, 3, 4, 5)), "time": (t, (3, 4, 5))}
    table["command"] = scaled(smooth(u)), (axis,)
    table["changes of the command"] = scaled(np.diff(smooth(u), prepend=u[0])), (axis,)
    table["command, more with time"] = scaled(smooth(u) * t), (axis,)
    table["command, by its size"] = scaled(smooth(u) * np.abs(smooth(u))), (axis,)
    for i, name in enumerate(("roll", "pitch", "yaw")):
        angle, rate = np.unwrap(np.nan_to_num(log.x[:, ANGLE[i]])), smooth(log.x[:, i])
        table[name] = scaled(smooth(angle) - angle.mean()), (3 + i, *({"roll": (1,), "pitch": (0,)}.get(name, ())))
        table[f"{name} rate"] = scaled(rate), (3 + i,)
    return table
