"""The differential-drive robot of host_sim/: pose (px, py, theta), commands (v, omega)."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from .... import bridge
from ...prediction_errors import path, smooth
from ...prediction_errors.fit import Effect
from ...robot import Parameter
from . import features
from .starts import starts

name = "ddr"
CURVES = ("pacejka_slip", "slip_general", "slip_saturating", "stribeck_friction", "friction_general")
THRESHOLDS = ("saturation", "wheel_saturation", "acceleration_limit", "dead_band", "wheel_dead_band", "backlash")
LINEAR = ("speed_gain", "battery_sag", "yaw_gain", "wheel_asymmetry", "yaw_bias", "lateral_skid", "world_drift", "sensor_lever_arm",
          "heading_bias")  # fmt: skip
# Noise is measured, not fitted.
# What together looks like something that is no effect here: then they are never sure.
LOOKALIKES = {
    frozenset(("actuator_lag", "transport_delay")): "actuators of second order",
    frozenset(("second_order_lag",)): "a delay, alone or with a lag",
}
NOT_FITTED = ("measurement_noise",)
# A real robot moves in continuous time: where nothing speaks against it, that is assumed.
VARIANTS = (("exact arc", bridge.ARC), ("Euler steps", bridge.EULER), ("semi-implicit Euler steps", bridge.SEMI_IMPLICIT))
LEAST = np.array([0.1, 0.1, 0.1])  # m/s, m/s, rad/s: the slowest usual motion
MOST, STRETCH = 5000, 500  # rows of a long log that are looked at, in stretches
FEW, COARSE = 3500, 2500  # of more than so many rows, some with which a search begins
MOST_OF_LONG = 5  # effects that such a log can distinguish
SMALLEST, SMALLEST_NOISE = 0.002, 0.5  # shares of the way driven, or turned, and of the noise of a pose: a smaller gap does not matter,
SMALLEST_TURN = 0.003  # rad, nor does a smaller one of heading
TRACKS = (0.25, 2.0)  # m between wheels: wheels that slip at random drive and turn the body in a proportion between those of the two
HALF_TRACK = 0.3  # m, usual half distance of the wheels, whose speeds random slip is in proportion to
SLIPS_FOR, SLIPS_AT_REST = 0.5, 0.1  # s, over which speeds are smoothed, since wheels follow their commands late; share of the usual speed
STEADY = 0.02  # share that commands of one kind vary by
STARTS = 400  # of predictions
CURVE = 25  # commands at which a band of a curve is given, evenly spread over the rows by speed
SETTLE = 50  # rows at the beginning: how actuators stood before it is not known
FINEST = np.array([1e-6, 1e-6, 1e-6])
KEPT = 3.2e7  # bytes of steps that are not worked out again


def effects(u):
    """{name: Effect} in the order of action, for commands u (K, 2)."""
    found, formulas, families = {}, bridge.formulas(), bridge.families()
    for key, (block, rows) in bridge.effects().items():
        spec = tuple(Parameter(*row) for row in rows)
        if key not in NOT_FITTED:
            family, reported = families[key]
            begin = starts(key, spec, u, key in LINEAR)
            marks = {"linear": key in LINEAR, "threshold": key in THRESHOLDS, "curve": key in CURVES}
            found[key] = Effect(key, block, spec, begin, **marks, formula=formulas[key], family=family, form_of=reported)
    return found


def _stretches(K, most):
    """Rows of a log that are looked at: all, or of a long one stretches evenly spread, of so many rows together."""
    if K <= most:
        return np.arange(K)
    firsts = np.linspace(0, K - STRETCH, most // STRETCH).astype(int)
    return (firsts[:, None] + np.arange(STRETCH)).ravel()


class Path(path.Path):
    """The log as the engine takes it. Deviations are in the axes of the measured pose: along, across, heading.

    base: Causes that belong to the simulator, as those of the healthy robot do.
    """

    channels = ("longitudinal", "lateral", "heading")
    sensors = {"position": ("m", 0), "heading": ("rad", 2)}
    pushes = dict(zip(channels, ("m/s", "m/s", "rad/s")))
    alike = np.array([0, 0, 1])
    finest = FINEST
    C = np.eye(3)
    lookalikes = LOOKALIKES
    command_names = ("v", "omega")
    most = MOST
    variants = tuple(title for title, _ in VARIANTS)
    calibrated = weighed = competes = True
    motions = ("at any speed", "in proportion to the commanded speed")

    def __init__(self, log, without=(), variant=0, base=(), most=None):
        self._made_by = log, without, variant, base
        self.log, self.dt, self.variant, self.base, self.asked = log, log.dt, variant, tuple(base), 0
        self.u = log.u if len(log.u) == len(log.x) else np.vstack([log.u, log.u[-1:]])
        self.effects = {key: effect for key, effect in effects(self.u).items() if not {key, effect.reported_as} & set(without)}
        self.rows = _stretches(len(log.x), most or self.most)
        self.t = self.rows * log.dt
        self.most_effects = MOST_OF_LONG if len(log.x) > FEW else path.Path.most_effects
        usable = np.append(log.usable, False)[self.rows]
        self.begins = np.concatenate([[True], (np.diff(self.rows) != 1) | ~usable[:-1]]).astype(np.int32)
        self.breaks = self.begins != 0
        good = self.begins[1:] == 0
        self.whole = good[:-2] & good[1:-1] & good[2:]
        x = log.x[self.rows]
        there = np.isfinite(x).all(1)
        self.measured = np.where(there[:, None], x, 0.0)
        self.measured[there, 2] = np.unwrap(x[there, 2])
        self.settled = SETTLE if len(log.x) > 8 * SETTLE else 0
        there[: self.settled] = False
        self.present = np.where(there[:, None], 1.0, np.inf) * np.ones(3)
        v, w = np.sqrt(np.mean(self.u**2, axis=0))
        self.steady = bool(np.all(np.std(self.u, axis=0) <= STEADY * (np.abs(self.u).max(0) + 1e-9)))
        self.usual = np.maximum([v, v, w], LEAST)
        self.spread = np.ones(3)
        self._wheels = self._relative_speed()
        self._follow(self.measured)

    def coarse(self):
        """Some of the stretches of a log that is looked at in many."""
        return Path(*self._made_by, COARSE) if len(self.rows) > FEW else None

    def _follow(self, X):
        """Takes X (K, 3) as the reference path."""
        K = len(X)
        self.X, self._kept = X, path.Kept(KEPT)
        c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
        self._to_axes = np.zeros((K, 3, 3))
        self._to_axes[:, 0, 0] = self._to_axes[:, 1, 1] = c
        self._to_axes[:, 0, 1], self._to_axes[:, 1, 0] = s, -s
        self._to_axes[:, 2, 2] = 1
        self.E = self._turned(self.measured - X)
        self._roll()
        way = np.diff(X, axis=0)
        world = np.tile(np.eye(3), (K, 1, 1))
        world[:-1, 0, 2], world[:-1, 1, 2] = -way[:, 1], way[:, 0]
        self.A = world.copy()
        self.A[:-1] = self._to_axes[1:] @ world[:-1] @ self._to_axes[:-1].swapaxes(1, 2)
        self._move()

    def _relative_speed(self):
        """Speed of the wheels, over its root mean square (K,), as the commands ask for it."""
        squares = ndimage.uniform_filter1d((self.u**2) @ (1, HALF_TRACK**2), max(round(SLIPS_FOR / self.dt), 1))
        return np.sqrt(squares / max(squares.mean(), 1e-12) + SLIPS_AT_REST**2)[self.rows]

    def _move(self):
        speeds = self._wheels if self.motion else np.ones(len(self.X))
        self.G = self.dt * speeds[:, None, None] * np.eye(3)

    def move_by(self, motion):
        """Takes random motion to be of one size, or to grow with the commanded speed."""
        if motion != self.motion:
            self.motion = motion
            self._move()

    def random(self, noise):
        """Wheels that slip at random do not turn a body without driving it, nor drive it without turning, nor more sideways than along."""
        along, across, turn = noise.process
        along, turn = min(along, turn * TRACKS[1] / 2), min(turn, along * 2 / TRACKS[0])
        return replace(noise, process=np.array([along, min(across, along), turn]))

    exact = np.zeros(3)

    def heeded(self):
        """Variances of readings (K, c) over those of the sensor."""
        return self.present

    def smooth(self, causes, noise):
        """Slopes at headings as measured are not those at the robot's own: their noise would make sizes too large."""
        D = self._beside(causes)
        moved = smooth.better(self, smooth.weights(self, noise), D, self.E)
        self._follow(self.X + (self._to_axes.swapaxes(1, 2) @ moved[..., None])[..., 0])
        return True

    def step_by(self, variant):
        """Takes another of the variants."""
        if variant != self.variant:
            self.variant = variant
            self._roll()

    def _roll(self):
        x = np.zeros((len(self.log.x), 3))
        x[self.rows] = self.X
        on = np.flatnonzero(self.begins[1:] == 0)
        self._steps = bridge.Steps(x, self.u, self.dt, self.rows[on], self.integrator, on, len(self.X))

    @property
    def integrator(self):
        return VARIANTS[self.variant][1]

    def _turned(self, d):
        return (self._to_axes @ d[..., None])[..., 0]

    def steps(self, trials):
        """What one step with each trial's causes ends beside the path (K, 3, trials), and by how much each misses poses (K, 3, 1)."""
        self.asked += len(trials) * len(self.rows)
        return np.stack([self._beside(causes) for causes in trials], -1), self.E[..., None]

    def seen_from(self, starts, ends, deviations):
        """In the axes of the pose in which a prediction starts."""
        return (self._to_axes[starts] @ (self._to_axes[ends].swapaxes(1, 2) @ deviations[..., None]))[..., 0]

    def curve(self, cause):
        if not self.effects[cause.name].curve:
            return None
        acts = np.any([(self.t >= a) & (self.t < b) for a, b in cause.segments], axis=0)
        u = self.u[self.rows[acts]]
        u = u[np.argsort(np.abs(u[:, 0]), kind="stable")[np.linspace(0, len(u) - 1, CURVE).astype(int)]]
        return u, lambda params: self._taken(cause.name, params, u)

    def _taken(self, name, params, u):
        """What an effect takes from the velocities (M, 3) under commands u (M, 2): one Euler step of each shows the velocities."""
        active = [bridge.Effect(name, tuple(params))]
        ends = [bridge.simulate(one[None], self.dt, active=active)[1] for one in u]
        return np.array(ends) / self.dt - u[:, :1] * (1, 0, 0) - u[:, 1:] * (0, 0, 1)

    def pass_over(self, good):
        """Takes as the path what was measured in the rows that are good (K,), and lines between them."""
        rows = np.arange(len(good))
        self._follow(np.stack([np.where(good, x, np.interp(rows, rows[good], x[good])) for x in self.X.T], 1))

    @staticmethod
    def most_starts(horizon):
        """Of predictions so many rows ahead."""
        return STARTS

    def _beside(self, causes):
        """Where one step with causes ends beside the path (K, 3)."""
        return self._kept.get((self.variant, tuple(causes)), lambda: self._steps.beside(self._active(causes)))

    def _active(self, causes):
        return [bridge.Effect(c.name, c.params, max(a, 0.0), b) for c in (*self.base, *causes) for a, b in c.segments]

    def ahead(self, causes, starts, horizons):
        """Measured less predicted (S, H, 3), along, across and in heading, from the measured poses in `starts` of the path's rows.

        NaN beyond what is usable.
        """
        return self.predicted(causes, self.rows[starts], np.minimum(horizons, len(self.log.x) - 1))[1]

    def predicted(self, causes, starts, steps):
        """(poses (S, H, 3), measured less predicted (S, H, 3)) so many steps after rows of the log."""
        rollouts = bridge.Rollouts(self.log.x, self.u, self.dt, starts, steps, self.log.usable, self.integrator)
        return tuple(values.copy() for values in rollouts.predict(self._active(causes)))

    def smallest_of(self, gap, noise, rows=50):
        """A gap that matters, m or rad, that many rows ahead."""
        way = np.hypot(*np.diff(self.log.x[:, :2], axis=0)[self.log.usable].T).mean() * rows
        turn = np.abs(self.u[:, 1]).mean() * rows * self.dt
        if gap == "position":
            return max(SMALLEST * way, SMALLEST_NOISE * noise.sensor[0])
        return max(SMALLEST * turn, SMALLEST_NOISE * noise.sensor[2], SMALLEST_TURN)

    signals, wraps = (("px", "m"), ("py", "m"), ("theta", "rad")), (False, False, True)

    @property
    def readings(self):
        return self.log.x

    @property
    def known(self):
        return np.ones(len(self.log.x), bool)

    def shown(self, causes, starts, steps):
        """Poses as predicted (S, H, 3)."""
        return self.predicted(causes, starts, steps)[0]

    gaps = {"position": ("m", (0, 1)), "heading": ("rad", (2,))}

    dependence = staticmethod(features.dependence)

    def generic(self, left):
        """[((function, channel))], pushes (K, 3, q) by plain functions of command, heading, time and place.

        left (K, 3): innovations, in which wheels that are not round are looked for.
        """
        names, columns = [], []
        for title, (values, on) in features.functions(self.u, self.rows, self.X, self.dt, left).items():
            for channel in on:
                names.append((title, channel))
                columns.append(self.dt * np.eye(3)[channel] * values[:, None])
        return names, np.stack(columns, -1)
