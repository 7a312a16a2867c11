"""Effects that wrap any simulator: at its commands, in its plant, at its outputs. Zero is exactly nothing.

Each kind is one function that makes its effects for a robot and a log; KINDS is the list.
"""

from dataclasses import dataclass, replace
from typing import Callable

import numpy as np
from scipy.signal import lfilter

from ..robot import Parameter

THRESHOLDS = ("rate_limit", "dead_band", "saturation", "backlash")
SIZES = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
WHOLE = 1e9  # stands for a bound that no robot reaches


@dataclass(frozen=True)
class Effect:
    """act(params, action, rows) gives the Action with the effect in it."""

    name: str  # KIND:SIGNAL
    block: str  # command, plant or output
    parameters: tuple[Parameter, ...]
    formula: str
    act: Callable
    begins: tuple = (0.3, 1.0, 3.0)  # usual sizes that a scan begins with; one: the effect is linear in its size
    threshold: bool = False  # no slope tells its size

    @property
    def kind(self):
        return self.name.partition(":")[0]


@dataclass(frozen=True)
class Context:
    """What an effect may ask of the log: time (K,), sampling time, and sizes of its signals."""

    robot: object
    log: object

    @property
    def dt(self):
        return self.log.dt

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


def per_second(unit):
    """m/s -> m/s2."""
    return f"{unit}2" if unit.endswith("/s") else f"{unit}/s"


def _at(j, change):
    """An act() that changes command j: change(u (K,), params) -> (K,)."""

    def act(params, action, context):
        u = action.u.copy()
        for i in j if isinstance(j, (list, tuple, range)) else [j]:
            u[:, i] = change(u[:, i], params, context)
        return replace(action, u=u)

    return act


# ---- at the commands -----------------------------------------------------------------------------------------


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
    """The mean over each row of what goes to the command at a limited rate."""
    most, out, y = params[0] * context.dt, np.empty_like(u), u[0]
    for k, wanted in enumerate(u):
        left = wanted - y
        if abs(left) <= most:
            out[k], y = wanted - left * abs(left) / (2 * most), wanted
        else:
            out[k], y = y + np.copysign(most / 2, left), y + np.copysign(most, left)
    return out


def _play(u, params, context):
    half, out, y = params[0], np.empty_like(u), u[0]
    for k, wanted in enumerate(u):
        y = min(max(y, wanted - half), wanted + half)
        out[k] = y
    return out


def _sagging(u, params, context):
    t = context.log.t - context.log.t[0]
    return u * (1 - params[0] * t / max(t[-1], 1e-12))


def commands(context):
    """Effects of each command by itself, and of lag and delay for all at once.

    In the order in which they act together: what is sent comes late, is amplified, reaches its limits, and moves a gear.
    """
    found, robot, dt = [], context.robot, context.dt
    for j, signal in enumerate(robot.commands):
        name, unit, size, speed = signal.name, signal.unit, context.spread(j), context.speed(j)
        largest = max(np.abs(context.command(j)).max(), 1e-12)

        def add(kind, parameters, formula, change, begins=(0.3, 1.0, 3.0)):
            found.append(Effect(f"{kind}:{name}", "command", parameters, formula, _at(j, change), begins, kind in THRESHOLDS))  # noqa: B023

        add("delay", (Parameter("delay", "s", 0, 60 * dt + 0.5, 2 * dt),), f"{name} at t - delay", _late, SIZES)
        add(
            "dead_band",
            (Parameter("width", unit, 0, largest, 0.15 * size),),
            f"0 where |{name}| < width",
            lambda u, p, c: np.where(np.abs(u) < p[0], 0.0, u),
            SIZES,
        )
        add("gain", (Parameter("a", "1", -0.95, 3, 0.1),), f"{name} (1 + a)", lambda u, p, c: u * (1 + p[0]), (1.0,))
        add("sag", (Parameter("loss_at_end", "1", -1, 1, 0.15),), f"gain of {name} that falls over the log", _sagging, (1.0,))
        for i, other in enumerate(robot.commands):
            if i != j:
                found.append(_cross(context, i, j, other, signal))
        add("bias", (Parameter("d", unit, -largest - size, largest + size, 0.1 * size),), f"{name} + d", lambda u, p, c: u + p[0], (1.0,))
        add(
            "saturation",
            (Parameter("most", unit, 0.02 * largest, largest, 0.7 * largest),),
            f"|{name}| <= most",
            lambda u, p, c: np.clip(u, -p[0], p[0]),
            (0.4, 0.6, 0.8, 1.0, 1.2, 1.35),
        )
        add(
            "rate_limit",
            (Parameter("rate", per_second(unit), 0.01 * speed, np.inf, 0.4 * speed),),
            f"|d {name}/dt| <= rate",
            _limited_rate,
            (0.15, 0.3, 0.6, 1.0, 1.5, 2.0),
        )
        add("lag", (Parameter("tau", "s", 0, 60 * dt + 1, 2 * dt),), f"first-order lag of {name}", _lagged, SIZES)
        add("backlash", (Parameter("half_width", unit, 0, largest, 0.1 * size),), f"play in {name}", _play, SIZES)
    if len(robot.commands) > 1:
        every = range(len(robot.commands))
        found.append(
            Effect(
                "lag:all",
                "command",
                (Parameter("tau", "s", 0, 60 * dt + 1, 2 * dt),),
                "first-order lag of all commands",
                _at(every, _lagged),
                SIZES,
            )
        )
        found.append(
            Effect(
                "delay:all",
                "command",
                (Parameter("delay", "s", 0, 60 * dt + 0.5, 2 * dt),),
                "all commands at t - delay",
                _at(every, _late),
                SIZES,
            )
        )
    return found


def _cross(context, i, j, other, signal):
    scale = context.spread(j) / context.spread(i)

    def act(params, action, context):
        u = action.u.copy()
        u[:, j] += params[0] * action.u[:, i]
        return replace(action, u=u)

    parameter = Parameter("a", f"{signal.unit}/({other.unit})", -3 * scale, 3 * scale, 0.05 * scale)
    return Effect(f"cross:{signal.name}<-{other.name}", "command", (parameter,), f"{signal.name} + a {other.name}", act, (1.0,))


# ---- in the plant --------------------------------------------------------------------------------------------


def parameters(context):
    """Every parameter of the simulator that the user offers."""
    found = []
    for i, inner in enumerate(context.robot.parameters):

        def act(params, action, context, i=i):
            changed = action.params.copy()
            changed[i] += params[0]
            return replace(action, params=changed)

        spec = Parameter("change", inner.unit, inner.low - inner.value, inner.high - inner.value, inner.usual)
        found.append(Effect(f"parameter:{inner.name}", "plant", (spec,), f"{inner.name} {inner.value:g} + change", act, (1.0,)))
    return found


def forces(context, velocities, spread):
    """A constant force and damping on each velocity-like state; velocities: their indices."""
    found, n = [], len(context.robot.states)
    for i in velocities:
        signal, unit = context.robot.states[i], np.eye(n)[i]
        size = spread.x[i]

        def force(params, action, context, unit=unit):
            return action.pushed(lambda x, u: params[0] * unit)

        def damp(params, action, context, unit=unit, i=i):
            return action.pushed(lambda x, u: -params[0] * x[:, i : i + 1] * unit)

        usual = 0.2 * size
        found.append(
            Effect(
                f"force:{signal.name}",
                "plant",
                (Parameter("f", per_second(signal.unit), -WHOLE, WHOLE, usual),),
                f"d {signal.name}/dt + f",
                force,
                (1.0,),
            )
        )
        found.append(
            Effect(
                f"damping:{signal.name}",
                "plant",
                (Parameter("k", "1/s", -5, 50, 0.2),),
                f"d {signal.name}/dt - k {signal.name}",
                damp,
                (1.0,),
            )
        )
    return found


def clock(context):
    def act(params, action, context):
        return replace(action, clock=action.clock * (1 + params[0]))

    return [Effect("clock", "plant", (Parameter("kappa", "1", -0.5, 1, 0.03),), "true time is (1 + kappa) t", act, (1.0,))]


# ---- at the outputs ------------------------------------------------------------------------------------------


def _output(c, change):
    def act(params, action, context):
        def output(Y, rows, dt):
            Y = Y.copy()
            Y[..., c] = change(Y[..., c], params, rows, dt)
            return Y

        return replace(action, outputs=(*action.outputs, output))

    return act


def _before(y, rows):
    """Where a window began, as if it had come there at its first speed: y (W, H + 1), rows before (W,)."""
    return y[:, :1] - (y[:, 1:2] - y[:, :1]) * rows


def _seen_late(y, params, rows, dt):
    back = params[0] / dt
    at = np.arange(y.shape[1]) - back
    low = np.floor(at).astype(int)
    part = at - low
    pick = lambda k: np.where(k >= 0, y[:, np.clip(k, 0, y.shape[1] - 1)], _before(y, np.maximum(-k, 0)))  # noqa: E731
    return (1 - part) * pick(low) + part * pick(low + 1)


def _seen_lagged(y, params, rows, dt):
    tau = max(params[0], 0.0)
    if tau <= 1e-9 * dt:
        return y
    keep, out = np.exp(-dt / tau), np.empty_like(y)
    out[:, 0] = _before(y, tau / dt)[:, 0]
    for k in range(1, y.shape[1]):
        out[:, k] = y[:, k] + (out[:, k - 1] - y[:, k]) * keep
    return out


def outputs(context):
    found = []
    for c, channel in enumerate(context.robot.channels):
        values = context.log.y[:, c]
        size = max(0.5 * (np.nanmax(values) - np.nanmin(values)), 1e-12)
        largest = max(np.nanmax(np.abs(values)), size)

        def add(kind, parameter, formula, change, begins=(1.0,)):
            found.append(Effect(f"{kind}:{channel.name}", "output", (parameter,), formula, _output(c, change), begins))  # noqa: B023

        name, unit, dt = channel.name, channel.unit, context.dt
        add("sensor_bias", Parameter("d", unit, -largest, largest, 0.05 * size), f"{name} + d", lambda y, p, rows, dt: y + p[0])
        if not channel.wraps:
            add("scale", Parameter("a", "1", -0.9, 3, 0.05), f"{name} (1 + a)", lambda y, p, rows, dt: y * (1 + p[0]))
        add("sensor_delay", Parameter("delay", "s", 0, 30 * dt + 0.2, 2 * dt), f"{name} at t - delay", _seen_late, SIZES[:5])
        add("sensor_lag", Parameter("tau", "s", 0, 30 * dt + 0.5, 2 * dt), f"first-order lag of {name}", _seen_lagged, SIZES[:5])
        add(
            "drift",
            Parameter("rate", per_second(unit), -largest, largest, 0.02 * size),
            f"{name} + rate t",
            lambda y, p, rows, dt: y + p[0] * rows * dt,
        )
    return found


def library(context, velocities, spread):
    """{name: Effect} of all kinds that the robot uses."""
    every = [
        *commands(context),
        *parameters(context),
        *forces(context, velocities, spread),
        *clock(context),
        *outputs(context),
        *context.robot.own,
    ]
    use = context.robot.use
    return {e.name: e for e in every if not use or e.kind in use or e.name in use or e in context.robot.own}
