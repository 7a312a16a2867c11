"""Drives: commands (rows, 2) [v (m/s), omega (rad/s)] drawn at random, at most 2 m/s and 1 rad/s."""

import numpy as np

V, W = 2.0, 1.0


def _held(random, t, draw, shortest, longest):
    """Values that `draw` gives, each held for a random time."""
    out, begin = np.empty(len(t)), t[0]
    while begin <= t[-1]:
        end = begin + random.uniform(shortest, longest)
        out[(t >= begin) & (t < end)] = draw()
        begin = end
    return out


def _size(random, most):
    """Small and large ones equally often."""
    return most * 10 ** random.uniform(-1.5, 0)


def steps(random, t):
    v = _held(random, t, lambda: random.choice((1, 1, -1)) * _size(random, V), 0.5, 2.5)
    return v, _held(random, t, lambda: random.choice((1, -1)) * _size(random, W), 0.5, 2.5)


def sinusoids(random, t):
    def wave(most, offset):
        pace = random.uniform(0.3, 1.5, 2)
        phase = random.uniform(0, 2 * np.pi, 2)
        waves = np.sin(pace[0] * t + phase[0]) + 0.4 * np.sin(2.7 * pace[1] * t + phase[1])
        return most * (offset + random.uniform(0.6, 1) * waves)

    return wave(0.5 * V, random.uniform(0, 0.6)), wave(0.7 * W, random.uniform(-0.2, 0.2))


def chirps(random, t):
    s = t - t[0]
    pace = random.uniform(0.2, 0.5) + random.uniform(1, 4) * s / s[-1] / 2
    turn = random.uniform(0.5, 1) * W * np.cos(random.uniform(0.6, 1.4) * pace * s)
    return random.uniform(0.2, 0.5) * V * (1 + 1.2 * np.sin(pace * s)), turn


def reversals(random, t):
    """Forth and back, each way with a turn of its own, ramped or at once."""
    period, sharp = random.uniform(3, 8), random.choice((2.0, 20.0))
    v = random.uniform(0.4, 0.9) * V * np.tanh(sharp * np.sin(2 * np.pi * t / period))
    return v, random.uniform(0.3, 0.9) * W * np.tanh(sharp * np.sin(2 * np.pi * t / (1.7 * period)))


def stop_and_go(random, t):
    period = random.uniform(4, 8)
    rise = np.clip(2 * np.sin(2 * np.pi * t / period), 0, 1)
    v = rise * _held(random, t, lambda: random.uniform(0.1, 0.9) * V, period, period)
    return v, _held(random, t, lambda: random.choice((0, 1, -1)) * _size(random, W), 1, 4)


def square(random, t):
    """Straight on and a quarter turn, to the left on even laps and to the right on odd ones."""
    speed, rate, side = random.uniform(0.3, 0.9) * V, random.uniform(0.4, 0.9) * W, random.uniform(2, 4)
    corner = np.pi / 2 / rate
    lap, phase = np.divmod(t - t[0], 4 * (side + corner))
    turning = phase % (side + corner) > side
    return np.where(turning, 0.3 * speed, speed), np.where(turning, rate * (1 - 2 * (lap % 2)), 0.0)


FAMILIES = {f.__name__: f for f in (steps, sinusoids, chirps, reversals, stop_and_go, square)}


def rich(random, rows, dt):
    """Stretches of 12 to 25 s of one family after another; commands cross zero, small and large. Names too."""
    t, parts, names, at = np.arange(rows) * dt, [], [], 0
    while at < rows:
        end = min(rows, at + round(random.uniform(12, 25) / dt))
        end = rows if rows - end < 5 / dt else end
        # the first stretch reaches small and large commands whatever comes after
        names.append(str(random.choice(("steps", "sinusoids") if at == 0 else list(FAMILIES))))
        parts.append(np.stack(FAMILIES[names[-1]](random, t[at:end]), axis=1))
        at = end
    return np.clip(np.concatenate(parts), (-V, -W), (V, W)), names


def poor(random, rows, dt):
    """One speed in one direction; the turn is constant, or swings without changing sign."""
    t = np.arange(rows) * dt
    rate = random.choice((1, -1)) * random.uniform(0.15, 0.6) * W
    swing = random.choice((0, 0.5)) * np.sin(random.uniform(0.1, 0.5) * t)
    return np.stack([np.full(rows, random.uniform(0.25, 0.75) * V), rate * (1 + swing)], axis=1), ["poor"]
