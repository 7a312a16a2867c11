"""What stands between commands and motion, and between motion and log, in steps much shorter than a row of the log."""

import math
from bisect import bisect_right

FINE = 10  # steps in a row


class Actuator:
    """One command on its way into the motion. effects: {kind: size}; of a lag, delay or limit as in `tinykoop effects`."""

    def __init__(self, effects, dt, seconds):
        self.effects, self.dt, self.seconds = effects, dt, seconds
        self.limited = self.lagged = self.played = None

    def act(self, asked, t, h):
        """What acts at time t for h seconds, of the commands asked for in each row so far."""
        e = self.effects
        u = self._late(asked, t - e.get("delay", 0.0), h)
        u = 0.0 if abs(u) < e.get("dead_band", 0.0) else u
        u = u * (1 + e.get("gain", 0.0)) * (1 - e.get("sag", 0.0) * t / self.seconds) + e.get("bias", 0.0)
        most = e.get("saturation", math.inf)
        return self._play(self._lag(self._limit(min(max(u, -most), most), h), h))

    def _late(self, asked, t, h):
        """The mean, from t for h seconds, of the commands asked for in each row."""
        first, last = math.floor(t / self.dt + 1e-9), math.floor((t + h) / self.dt - 1e-9)
        part = ((t + h) - last * self.dt) / h if last > first else 0.0
        row = lambda k: asked[min(max(k, 0), len(asked) - 1)]  # noqa: E731
        return (1 - part) * row(first) + part * row(last) if part else row(first)

    def _limit(self, u, h):
        """The mean of what goes to u at a limited rate, for h seconds."""
        most = self.effects.get("rate_limit", math.inf) * h
        before = u if self.limited is None else self.limited
        self.limited = min(max(u, before - most), before + most)
        return u if self.limited == u else (before + self.limited) / 2

    def _lag(self, u, h):
        tau = self.effects.get("lag", 0.0)
        before = u if self.lagged is None or tau == 0 else self.lagged
        self.lagged = u + (before - u) * (math.exp(-h / tau) if tau else 0.0)
        return (before + self.lagged) / 2

    def _play(self, u):
        half = self.effects.get("backlash", 0.0)
        before = u if self.played is None else self.played
        self.played = min(max(before, u - half), u + half)
        return self.played


def actuators(names, effects, dt, seconds):
    """An Actuator for each command, of effects {KIND:COMMAND or KIND:all: size}."""
    made = []
    for name in names:
        mine = {}
        for effect, size in effects.items():
            kind, _, signal = effect.partition(":")
            if signal in (name, "all"):
                mine[kind] = mine.get(kind, 0.0) + size
        made.append(Actuator(mine, dt, seconds))
    return made


def rk4(rate, x, u, h):
    """The state (list) h seconds on by the classical Runge-Kutta method."""
    move = lambda slope, part: [v + part * s for v, s in zip(x, slope)]  # noqa: E731
    a = rate(x, u)
    b = rate(move(a, h / 2), u)
    c = rate(move(b, h / 2), u)
    d = rate(move(c, h), u)
    return [v + h / 6 * (p + 2 * q + 2 * r + s) for v, p, q, r, s in zip(x, a, b, c, d)]


class Sensor:
    """A channel of the log: where it was `sensor_delay` ago, times 1 + `scale`, with noise."""

    def __init__(self, name, index, sd, effects):
        self.index, self.sd = index, sd
        self.late = effects.get(f"sensor_delay:{name}", 0.0)
        self.factor = 1 + effects.get(f"scale:{name}", 0.0)

    def read(self, times, states, chance):
        then = times[-1] - self.late
        at = max(bisect_right(times, then + 1e-9) - 1, 0)
        value = states[at][self.index]
        if at + 1 < len(times):
            value += max(then - times[at], 0.0) / (times[at + 1] - times[at]) * (states[at + 1][self.index] - value)
        return value * self.factor + chance.gauss(0, self.sd)


def drive(plant, effects, chance):
    """Rows [t, measured .., asked ..] of a plant: a module or object with NAME, DT, ROWS, COMMANDS, SENSORS [(name, index, sd)],
    start(chance), advance(effects) -> function (x, u, h) -> x, and commands(chance) -> function (t, seen) -> u."""
    h, clock = plant.DT / FINE, 1 + effects.get("clock", 0.0)
    ways = actuators(plant.COMMANDS, effects, plant.DT, plant.DT * plant.ROWS)
    sensors = [Sensor(*about, effects) for about in plant.SENSORS]
    move, wish = plant.advance(effects), plant.commands(chance)
    times, states, asked, rows = [0.0], [plant.start(chance)], [[] for _ in plant.COMMANDS], []
    for k in range(plant.ROWS):
        seen = [sensor.read(times, states, chance) for sensor in sensors]
        u = wish(k * plant.DT, seen)
        for history, value in zip(asked, u):
            history.append(value)
        rows.append([k * plant.DT, *seen, *u])
        for i in range(FINE):
            t = k * plant.DT + i * h
            acting = [way.act(history, t, h) for way, history in zip(ways, asked)]
            states.append(move(states[-1], acting, h * clock))
            times.append(t + h)
    return rows
