"""A second plant, written apart from host_sim/: continuous time, Runge-Kutta, commands that are held.

Every step is cut into SUB parts. What drives the robot is an array over the parts, its mean within each; an effect
changes these arrays in place, over its own span of time. Three tables of effects:

PLAIN: the vocabulary, as the contract words it, in continuous time (`plain`).
OTHER: the same causes in forms of their own, several for each (`forms`).
NEVER: causes that no library of ours holds (`never`).

FAMILIES says which causes count as one another: the scorer asks for the family first.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from scipy.signal import lfilter

from . import forms, never, plain
from . import motion as random_motion
from .forms import SUB


@dataclass(frozen=True)
class Cause:
    """An effect acting on [t0, t1), s from the first row. form: which of the other forms; the first if empty."""

    name: str
    parameters: dict = field(default_factory=dict)
    shape: str = "plain"  # plain, other or never
    t0: float = 0.0
    t1: float = float("inf")
    form: str = ""


# ---- tables, in the order of action --------------------------------------------------------------

_ACTUATOR = {
    "saturation": (
        forms.soft_saturation,
        forms.tanh_saturation,
        forms.curvature_keeping_saturation,
        forms.one_sided_saturation,
    ),
    "wheel_saturation": (forms.soft_wheel_saturation, forms.curvature_keeping_wheel_saturation, forms.weak_wheel_saturation),
    "command_quantisation": never.command_quantisation,
    "transport_delay": (forms.jittery_delay, forms.axis_delay, forms.polled_delay),
    "dead_band": (forms.smooth_dead_band, forms.offset_dead_band, forms.hysteresis_dead_band, forms.moving_dead_band),
    "wheel_dead_band": (forms.smooth_wheel_dead_band, forms.offset_wheel_dead_band, forms.hysteresis_wheel_dead_band),
    "backlash": (forms.spread_backlash, forms.angle_backlash, forms.wheel_angle_backlash, forms.wheel_speed_backlash),
    "acceleration_limit": (forms.wheel_acceleration_limit, forms.braking_acceleration_limit, forms.fading_acceleration_limit),
    "actuator_lag": (forms.second_order_lag, forms.swinging_lag, forms.uneven_lag, forms.axis_lag, forms.wheel_lag),
    "speed_lag": (forms.second_order_speed_lag, forms.swinging_speed_lag, forms.uneven_speed_lag),
    "yaw_lag": (forms.second_order_yaw_lag, forms.swinging_yaw_lag, forms.uneven_yaw_lag),
    "speed_gain": (forms.speed_gain_with_speed, forms.speed_gain_with_turn, forms.speed_gain_by_direction),
    "battery_sag": (forms.early_sag, forms.late_sag, forms.energy_sag),
    "warm_up": never.warm_up,
    "heat": never.heat,
    "payload_swing": never.payload_swing,
    "yaw_gain": (forms.yaw_gain_with_rate, forms.yaw_gain_with_speed),
    "wheel_asymmetry": (forms.asymmetry_with_speed, forms.radius_asymmetry),
    "yaw_bias": (forms.wandering_bias, forms.moving_bias),
    "clock_scale": (forms.wandering_clock, forms.drifting_clock),
}
_PLANT = {
    "pacejka_slip": (
        forms.exponential_slip,
        forms.hill_slip,
        forms.threshold_slip,
        forms.understeer,
        forms.wheel_slip,
        forms.skid_steer,
    ),
    "lateral_skid": (forms.saturating_skid, forms.threshold_skid, forms.lagging_skid),
    "turn_asymmetry": never.turn_asymmetry,
    "wheel_eccentricity": never.wheel_eccentricity,
    "stribeck_friction": (
        forms.smooth_friction,
        forms.lost_speed_friction,
        forms.quadratic_friction,
        forms.wheel_friction,
        forms.presliding_friction,
    ),
    "caster_kick": never.caster_kick,
    "camber": never.camber,
    "slope": never.slope,
    "terrain": never.terrain,
    "tether": never.tether,
    "no_traction": (),
    "world_drift": (forms.wandering_drift, forms.growing_drift),
}
_SENSOR = {
    "sensor_lever_arm": (forms.swaying_arm, forms.yielding_arm),
    "heading_scale": never.heading_scale,
    "heading_bias": (forms.compass_bias, forms.soft_iron_bias),
}
_ALL = _ACTUATOR | _PLANT | _SENSOR
PLAIN = {name: getattr(plain, name) for name, entry in _ALL.items() if isinstance(entry, tuple)}
OTHER = {name: {form.__name__: form for form in entry} for name, entry in _ALL.items() if isinstance(entry, tuple) and entry}
NEVER = {name: entry for name, entry in _ALL.items() if callable(entry)}

FAMILIES = dict.fromkeys(_ALL, "") | {
    "pacejka_slip": "slip",
    "lateral_skid": "slip",
    "stribeck_friction": "friction",
    "actuator_lag": "lag",
    "speed_lag": "lag",
    "yaw_lag": "lag",
    "transport_delay": "delay",
    "dead_band": "dead_band",
    "wheel_dead_band": "dead_band",
    "saturation": "saturation",
    "wheel_saturation": "saturation",
}
FAMILIES = {name: kind or name for name, kind in FAMILIES.items()}

LINKS = {"command-wheel": _ACTUATOR, "wheel-ground": _PLANT, "gyro-heading": _SENSOR}


def family(name, said=None):
    """The family of an effect by its name, and by what a report says of one that the table lacks."""
    known = {kind: kind for kind in FAMILIES.values()} | FAMILIES
    return known.get(name) or known.get(said) or said or name


def link(name):
    """Between which two measurements of a log with odometry the effect acts; a clock that is slow acts between none."""
    return None if name == "clock_scale" else next(key for key, block in LINKS.items() if name in block)


def function(cause):
    if cause.shape == "other":
        choice = OTHER[cause.name]
        return choice[cause.form or next(iter(choice))]
    return {"plain": PLAIN, "never": NEVER}[cause.shape][cause.name]


# ---- the robot -----------------------------------------------------------------------------------


def _pass(block, causes, signal, end):
    """Lets the causes of one block change what flows through it, each in its own span of time."""
    for name in block:
        for cause in (c for c in causes if c.name == name):
            first, last = np.searchsorted(signal.t, np.array([cause.t0, cause.t1]) - 1e-6 * signal.dt)
            if first == last:
                continue
            views = {k: a[first:last] for k, a in vars(signal).items() if isinstance(a, np.ndarray)}
            span = SimpleNamespace(**{**vars(signal), **views})
            span.passed = (span.t - cause.t0) / (min(cause.t1, end) - cause.t0)
            function(cause)(span, **cause.parameters)


def _body(u, dt, causes, x0, random, motion):
    """What drives the robot, an array over the parts for each signal."""
    parts, end = len(u) * SUB, len(u) * dt
    v, w = (np.repeat(np.asarray(column, float), SUB) for column in np.transpose(u))
    m = SimpleNamespace(
        t=np.arange(parts) * dt / SUB, v=v, w=w, h=np.full(parts, dt / SUB), dt=dt, part=dt / SUB, ground=[],
        heading=x0[2], begin=complex(*x0[:2]), random=random,
    )  # fmt: skip
    _pass(_ACTUATOR, causes, m, end)
    m.forward, m.left, m.turn, m.wind = m.v.copy(), np.zeros(parts), m.w.copy(), np.zeros(parts, complex)
    _pass(_PLANT, causes, m, end)
    if motion:
        random_motion.shake(m, **motion)
    return m


def _arc(theta, forward, left, turn, h):
    """Runge-Kutta's step of z' = (forward + i left) exp(i theta), theta' = turn."""
    return (forward + 1j * left) * h / 6 * (
        np.exp(1j * theta) + 4 * np.exp(1j * (theta + turn * h / 2)) + np.exp(1j * (theta + turn * h))
    )  # fmt: skip


def _positions(m, steps):
    """Positions after every part from steps of the body; the ground slows the robot down and does not turn it."""
    wind = m.wind * m.h
    if not m.ground:
        return m.begin + np.concatenate([[0], np.cumsum(steps + wind)])
    z = [m.begin]
    for step, blown in zip(steps.tolist(), wind.tolist()):
        z.append(z[-1] + step * m.ground[0](z[-1]) + blown)
    return np.array(z)


def drive(u, dt, causes=(), x0=(0.0, 0.0, 0.0), random=None, motion=None):
    """One drive under commands u (K, 2): poses (K+1, 3) as measured without noise, and what an observer would see.

    `random` draws jitter and, with `motion`, the random slip of the wheels. Beside the poses: heading before the sensor,
    position that the wind alone gives, means over each step of the wheels' speed and turn and of the robot's turn.
    """
    m = _body(u, dt, causes, x0, random, motion)
    theta = x0[2] + np.concatenate([[0], np.cumsum(m.turn * m.h)])
    z = _positions(m, _arc(theta[:-1], m.forward, m.left, m.turn, m.h))
    s = SimpleNamespace(t=np.arange(len(u) + 1) * dt, z=z[::SUB].copy(), theta=theta[::SUB].copy(), dt=dt)
    _pass(_SENSOR, causes, s, len(u) * dt)
    blown = np.concatenate([[0], np.cumsum(m.wind * m.h)])[::SUB]
    means = {key: a.reshape(-1, SUB).mean(axis=1) for key, a in (("v", m.v), ("w", m.w), ("turn", m.turn))}
    poses = np.stack([s.z.real, s.z.imag, s.theta], axis=1)
    return SimpleNamespace(poses=poses, heading=theta[::SUB], blown=blown, **means)


def simulate(u, dt, causes=(), x0=(0.0, 0.0, 0.0), random=None, motion=None):
    """The poses of `drive`."""
    return drive(u, dt, causes, x0, random, motion).poses


def noise(random, kind, rows, sp, st, rho=0.0):
    """Noise (rows, 3) of standard deviation sp (m) and st (rad): white, coloured (AR(1)) or heavy.

    Heavy is Student's t with four degrees of freedom, and one row in 200 is ten times as far out.
    """
    if kind == "heavy":
        e = random.standard_t(4, (rows, 3)) / np.sqrt(2)
        e[random.random(rows) < 0.005] *= 10
    else:
        e = random.normal(size=(rows, 3))
    if kind == "coloured":
        e[1:] *= np.sqrt(1 - rho**2)
        e = lfilter([1], [1, -rho], e, axis=0)
    return e * (sp, sp, st)
