"""Effects that wrap any simulator: at its commands, in its plant, at its outputs. Zero is exactly nothing.

Each function makes the effects of one place for a robot and its log; library() is the list.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ...bridge import followers
from ...plumbing.errors import UserError
from ..prediction_errors.fit import ALWAYS, Effect
from ..robot import Parameter

SIZES = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # usual sizes that a scan begins with
LATE = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5)
OWN = (0.3, 1.0, 3.0)
LINEAR = (1.0,)
THRESHOLDS = {
    "rate_limit": (0.15, 0.3, 0.6, 1.0, 1.5, 2.0), "dead_band": SIZES, "saturation": (0.4, 0.6, 0.8, 1.0, 1.2, 1.35), "backlash": SIZES,
}  # fmt: skip
# The user's own parameters first, then what is simplest at the commands; outputs and the clock last.
PREFERENCE = (
    "parameter",
    "gain",
    "bias",
    "lag",
    "delay",
    "saturation",
    "dead_band",
    "rate_limit",
    "backlash",
    "damping",
    "force",
    "sag",
    "cross",
)
WHOLE = 1e9  # stands for a bound that no robot reaches


@dataclass(frozen=True)
class Wrap(Effect):
    """act(params, action, context) gives the Action with the effect in it. The name is KIND:SIGNAL."""

    act: Callable = None

    @property
    def kind(self):
        return self.name.partition(":")[0]

    def on(self, cause, action, context):
        """The action with a cause of this effect, while that acts."""
        after = self.act(cause.params, action, context)
        return after if cause.segments == ALWAYS else action.within(context.acts(cause.segments), after)


def _effect(name, block, parameters, formula, act, sizes=LINEAR):
    starts = tuple(dict.fromkeys(tuple(float(np.clip(s * p.usual, p.low, p.high)) for p in parameters) for s in sizes))
    kind = name.partition(":")[0]
    shifted = kind == "sensor_delay"  # by whole rows: noise of another row is not half of anything
    return Wrap(name, block, tuple(parameters), starts, sizes is LINEAR, kind in THRESHOLDS, False, not shifted, formula, act)


@dataclass(frozen=True)
class Context:
    """What an effect may ask of the log."""

    robot: object
    log: object

    @property
    def dt(self):
        return self.log.dt

    @property
    def t(self):
        """Seconds from the first row (K,)."""
        return self.log.t - self.log.t[0]

    def acts(self, segments):
        """Rows (K,) in one of the segments."""
        middle = self.t + 0.5 * self.dt
        return np.any([(middle >= a) & (middle < b) for a, b in segments], axis=0)

    def command(self, j):
        return self.log.u[:, j]

    def spread(self, j):
        """Of a command: half its range, at least a tiny part of its size."""
        u = self.command(j)
        return max(0.5 * np.ptp(u), 1e-6 * np.abs(u).max(), 1e-12)

    def speed(self, j):
        """Of a command: how fast it changes where it does, per second."""
        change = np.abs(np.diff(self.command(j)))
        return max(np.quantile(change[change > 0], 0.9) if (change > 0).any() else 0.0, 1e-12) / self.dt


def preference(name):
    """Of the names that one effect may have, the first is said."""
    kind = name.partition(":")[0]
    return PREFERENCE.index(kind) if kind in PREFERENCE else len(PREFERENCE)


def per_second(unit):
    """m/s -> m/s2."""
    return f"{unit}2" if unit.endswith("/s") else f"{unit}/s"


# ---- at the commands -----------------------------------------------------------------------------------------


def _at(commands, change):
    """An act() that changes some commands: change(u (K,), params, context) -> (K,)."""

    def act(params, action, context):
        u = action.u.copy()
        for j in commands:
            u[:, j] = change(u[:, j], params, context)
        return replace(action, u=u)

    return act


def _late(u, params, context):
    """The mean over each row of the command as it was `delay` before."""
    whole, part = divmod(params[0] / context.dt, 1.0)
    whole = int(whole)
    back = lambda rows: np.concatenate([np.full(min(rows, len(u)), u[0]), u[: max(len(u) - rows, 0)]])  # noqa: E731
    return (1 - part) * back(whole) + part * back(whole + 1)


def _lagged(u, params, context):
    """The mean over each row of the command behind a first-order lag, which begins at rest."""
    tau, dt = max(params[0], 0.0), context.dt
    if tau <= 1e-9 * dt:
        return u
    keep = np.exp(-dt / tau)
    behind = u - u[0]
    lagged = lfilter([1 - keep], [1, -keep], np.concatenate([[0.0], behind[:-1]]))  # at the start of each row
    return u[0] + behind + (lagged - behind) * tau / dt * (1 - keep)


def _limited_rate(u, params, context):
    return followers.limited_rate(u, params[0] * context.dt)


def _play(u, params, context):
    return followers.play(u, params[0])


def _sagging(u, params, context):
    return u * (1 - params[0] * context.t / max(context.t[-1], 1e-12))


def _dead(u, params, context):
    return np.where(np.abs(u) < params[0], 0.0, u)


def _cut(u, params, context):
    return np.clip(u, -params[0], params[0])


def _crossed(params, action, context, i, j):
    u = action.u.copy()
    u[:, j] += params[0] * action.u[:, i]
    return replace(action, u=u)


def _of_command(context, j):
    """In the order in which they act together: what is sent comes late, is amplified, reaches its limits, and moves a gear."""
    signal, size, dt = context.robot.commands[j], context.spread(j), context.dt
    name, unit, largest = signal.name, signal.unit, max(np.abs(context.command(j)).max(), 1e-12)
    gain, bias = (lambda u, p, c: u * (1 + p[0])), (lambda u, p, c: u + p[0])
    speed = context.speed(j)

    def made(kind, parameter, formula, change, sizes=LINEAR):
        return _effect(f"{kind}:{name}", "command", (parameter,), formula, _at((j,), change), THRESHOLDS.get(kind, sizes))

    yield made("delay", Parameter("delay", "s", 0, 60 * dt + 0.5, 2 * dt), f"{name} at t - delay", _late, SIZES)
    yield made("dead_band", Parameter("width", unit, 0, largest, 0.15 * size), f"0 where |{name}| < width", _dead)
    yield made("gain", Parameter("a", "1", -0.95, 3, 0.1), f"{name} (1 + a)", gain)
    yield made("sag", Parameter("loss_at_end", "1", -1, 1, 0.15), f"gain of {name} that falls over the log", _sagging)
    for i, other in enumerate(context.robot.commands):
        if i != j:
            scale = size / context.spread(i)
            parameter = Parameter("a", f"{unit}/({other.unit})", -3 * scale, 3 * scale, 0.05 * scale)
            act = lambda params, action, context, i=i: _crossed(params, action, context, i, j)  # noqa: E731
            yield _effect(f"cross:{name}<-{other.name}", "command", (parameter,), f"{name} + a {other.name}", act)
    yield made("bias", Parameter("d", unit, -largest - size, largest + size, 0.1 * size), f"{name} + d", bias)
    yield made("saturation", Parameter("most", unit, 0.02 * largest, largest, 0.7 * largest), f"|{name}| <= most", _cut)
    rate = Parameter("rate", per_second(unit), 0.01 * speed, np.inf, 0.4 * speed)
    yield made("rate_limit", rate, f"|d {name}/dt| <= rate", _limited_rate)
    yield made("lag", Parameter("tau", "s", 0, 60 * dt + 1, 2 * dt), f"first-order lag of {name}", _lagged, SIZES)
    yield made("backlash", Parameter("half_width", unit, 0, largest, 0.1 * size), f"play in {name}", _play)


def commands(context):
    """Effects of each command by itself, and of lag and delay for all at once."""
    every, dt = range(len(context.robot.commands)), context.dt
    for j in every:
        yield from _of_command(context, j)
    if len(every) > 1:
        tau, delay = Parameter("tau", "s", 0, 60 * dt + 1, 2 * dt), Parameter("delay", "s", 0, 60 * dt + 0.5, 2 * dt)
        yield _effect("lag:all", "command", (tau,), "first-order lag of all commands", _at(every, _lagged), SIZES)
        yield _effect("delay:all", "command", (delay,), "all commands at t - delay", _at(every, _late), SIZES)


# ---- in the plant --------------------------------------------------------------------------------------------


def parameters(context):
    """Every parameter of the simulator that the user offers."""
    for i, inner in enumerate(context.robot.parameters):

        def act(params, action, context, i=i):
            changed = action.params.copy()
            changed[:, i] += params[0]
            return replace(action, params=changed)

        spec = Parameter("change", inner.unit, inner.low - inner.value, inner.high - inner.value, inner.usual)
        yield _effect(f"parameter:{inner.name}", "plant", (spec,), f"{inner.name} {inner.value:g} + change", act)


def forces(context, velocities, spread):
    """A constant force and damping on each velocity-like state; velocities: their indices; spread: of states (n,)."""
    n = len(context.robot.states)
    for i in velocities:
        signal, unit = context.robot.states[i], np.eye(n)[i]

        def force(params, action, context, unit=unit):
            return action.pushed(lambda x, u: params[0] * unit)

        def damp(params, action, context, unit=unit, i=i):
            return action.pushed(lambda x, u: -params[0] * x[:, i : i + 1] * unit)

        name, strength = signal.name, Parameter("f", per_second(signal.unit), -WHOLE, WHOLE, 0.2 * spread[i])
        yield _effect(f"force:{name}", "plant", (strength,), f"d {name}/dt + f", force)
        yield _effect(f"damping:{name}", "plant", (Parameter("k", "1/s", -5, 50, 0.2),), f"d {name}/dt - k {name}", damp)


def clock():
    def act(params, action, context):
        return replace(action, clock=action.clock * (1 + params[0]))

    yield _effect("clock", "plant", (Parameter("kappa", "1", -0.5, 1, 0.03),), "true time is (1 + kappa) t", act)


def own(function):
    """An effect of the user's: function(x (B, n), u (B, m), NAME: (unit, low, high, usual), ..) gives what is added to rates (B, n)."""
    spec = inspect.signature(function, eval_str=True).parameters
    parameters = [Parameter(name, *about.annotation) for name, about in list(spec.items())[2:] if isinstance(about.annotation, tuple)]
    if not parameters or len(parameters) != len(spec) - 2:
        raise UserError(
            f'{function.__name__}: write def {function.__name__}(x, u, k: ("unit", low, high, usual)): a range for each parameter'
        )

    def act(params, action, context):
        return action.pushed(lambda x, u: np.asarray(function(x, u, *params), float))

    sizes = OWN + tuple(-size for size in OWN) * (min(p.low for p in parameters) < 0)
    return _effect(function.__name__, "plant", parameters, " ".join((function.__doc__ or "of the user's own").split()), act, sizes)


# ---- at the outputs ------------------------------------------------------------------------------------------


def _later(y, seconds, context):
    """As it is so many seconds later, and as fast beyond its ends as there: by a spline, since a line between rows would smooth it."""
    rows, last = np.arange(len(y)) + seconds / context.dt, len(y) - 1
    beyond = np.where(rows < 0, (y[1] - y[0]) * rows, np.where(rows > last, (y[-1] - y[-2]) * (rows - last), 0.0))
    return CubicSpline(np.arange(len(y)), y)(np.clip(rows, 0, last)) + beyond


def _seen_lagged(y, params, context):
    tau = max(params[0], 0.0)
    if tau <= 1e-9 * context.dt:
        return y
    keep = np.exp(-context.dt / tau)
    begins = y[0] - (y[1] - y[0]) * tau / context.dt
    return lfilter([1 - keep], [1, -keep], y, zi=[keep * begins])[0]


@dataclass(frozen=True)
class Reading:
    """What a sensor makes of channel c: read(y (K,)) -> (K,), and back."""

    c: int
    read: Callable
    back: Callable
    grows: bool = False  # whether it is another gain
    late: int = 0  # rows


def _of_output(context, c):
    channel, values, dt = context.robot.channels[c], context.log.y[:, c], context.dt
    size = max(0.5 * (np.nanmax(values) - np.nanmin(values)), 1e-12)
    largest, name, unit = max(np.nanmax(np.abs(values)), size), channel.name, channel.unit

    def made(kind, parameter, formula, read, back, sizes=LINEAR):
        """read, back: (y (K,), the parameter, context) -> (K,)."""

        def act(params, action, context):
            made = (lambda y, f=f: f(y, params[0], context) for f in (read, back))
            late = round(params[0] / dt) if kind == "sensor_delay" else 0
            return action.sensed(Reading(c, *made, kind == "scale", late))

        return _effect(f"{kind}:{name}", "output", (parameter,), formula, act, sizes)

    d, a = Parameter("d", unit, -largest, largest, 0.05 * size), Parameter("a", "1", -0.5, 1, 0.05)
    yield made("sensor_bias", d, f"{name} + d", lambda y, d, _: y + d, lambda y, d, _: y - d)
    if not channel.wraps:
        yield made("scale", a, f"{name} (1 + a)", lambda y, a, _: y * (1 + a), lambda y, a, _: y / (1 + a))
    late, lag = Parameter("delay", "s", 0, 30 * dt + 0.2, 2 * dt), Parameter("tau", "s", 0, 30 * dt + 0.5, 2 * dt)
    ahead = lambda y, tau, context: y + tau / context.dt * CubicSpline(np.arange(len(y)), y)(np.arange(len(y)), 1)  # noqa: E731
    yield made("sensor_delay", late, f"{name} at t - delay", lambda y, d, of: _later(y, -d, of), _later, LATE)
    yield made("sensor_lag", lag, f"first-order lag of {name}", lambda y, tau, of: _seen_lagged(y, (tau,), of), ahead, SIZES[:5])
    rate = Parameter("rate", per_second(unit), -largest, largest, 0.02 * size)
    yield made("drift", rate, f"{name} + rate t", lambda y, r, of: y + r * of.t, lambda y, r, of: y - r * of.t)


def outputs(context):
    for c in range(len(context.robot.channels)):
        yield from _of_output(context, c)


def library(context, velocities, spread):
    """{name: Wrap} of all kinds that the robot uses, in the order of action."""
    mine = [own(function) for function in context.robot.own]
    found = [*commands(context), *parameters(context), *forces(context, velocities, spread), *clock(), *mine, *outputs(context)]
    use = context.robot.use
    return {e.name: e for e in found if not use or e.kind in use or e.name in use or e in mine}
