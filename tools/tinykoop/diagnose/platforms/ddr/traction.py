"""Whether what goes into a link of the drive moves what comes out of it at all.

A fit of effects cannot answer that: to a robot that does not move, every effect that slows it down fits.
"""

import numpy as np
from scipy import special

from ...prediction_errors.noise import white

WINDOW = 1.0  # s, over which motion is summed
LAGS = 5  # windows: the answer may come that many seconds late
FAR_LESS = 0.1  # of the motion that goes in: what comes out is far less
TRIFLE = 0.02  # of it, that comes out in step with it: shaking and drift of the pose, no drive
MOST, BEYOND = 0.5, 5.0  # of the motion that comes out, and times its noise: so small an answer is one nevertheless, as of commands in mm/s
CHANCE = 1e-3  # probability, from which on an answer is no chance
CLEAR = 0.07  # of the motion that goes in, that noise may be
FEWEST = 12  # windows


def short(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def dead(log, u):
    """Whether the pose of a log does not answer speeds u (K, 2): along the robot or in heading, wherever these move it enough to see."""
    axes = answer(log, u)
    return any(axis["clear"] for axis in axes) and not any(axis["answers"] for axis in axes)


def answer(log, u):
    """What is known of each axis, along the robot and heading: RMS motion in a window that goes in and that comes out, and so on."""
    moved, noise = steps(log), _noise(log)
    n = max(round(WINDOW / log.dt), 2)
    whole = np.convolve(log.usable, np.ones(n), "valid") > n - 0.5
    starts = _apart(np.flatnonzero(whole), n)
    return [_axis(_sums(u[:-1, i] * log.dt, starts, n, LAGS), _sums(moved[:, i], starts, n, 1)[:, 0], noise[i]) for i in (0, 1)]


def _axis(into, out, noise):
    """into (W, LAGS): motion of a window and of those before it; out (W,)."""
    rms = lambda values: float(np.sqrt(np.mean(values**2))) if len(values) else 0.0  # noqa: E731
    given, seen = rms(into[:, 0]), np.sqrt(max(rms(out) ** 2 - 2 * noise**2, 0.0))
    enough = len(out) >= FEWEST and given > 0
    clear = enough and np.sqrt(2) * noise < CLEAR * given
    chance, explained = _explained(into, out) if enough else (1.0, 0.0)
    follows = explained >= TRIFLE * given or (explained >= MOST * rms(out) and seen > BEYOND * noise)
    answers = (clear and seen >= FAR_LESS * given) or (chance < CHANCE and follows)
    return {"into": given, "out": rms(out), "clear": bool(clear), "answers": bool(answers)}


def _explained(into, out):
    """(probability that this is chance, RMS) of what a linear filter makes of the motion that goes in."""
    into = into[:, (into**2).sum(0) > 0]
    weights, _, rank, _ = np.linalg.lstsq(into, out, rcond=1e-6)
    made = into @ weights
    left, free = ((out - made) ** 2).sum(), len(out) - rank
    ratio = (made**2).sum() / rank / max(left / free, 1e-300)
    return float(special.fdtrc(rank, free, ratio)), float(np.sqrt(np.mean(made**2)))


def steps(log):
    """(K - 1, 2): way along the robot and turn from row to row; zero where it is not known."""
    turn = short(np.diff(log.x[:, 2]))
    middle, way = log.x[:-1, 2] + turn / 2, np.diff(log.x[:, :2], axis=0)
    along = way[:, 0] * np.cos(middle) + way[:, 1] * np.sin(middle)
    return np.where(log.usable[:, None], np.stack([along, turn], 1), 0.0)


def _noise(log):
    """Standard deviations (2,) of position and heading, in white noise."""
    x, good = np.nan_to_num(log.x), log.usable
    x = np.column_stack([x[:, :2], np.unwrap(x[:, 2])])
    whole = good[:-2] & good[1:-1] & good[2:]
    sd = white(x, whole) if whole.any() else np.zeros(3)
    return np.array([np.hypot(*sd[:2]) / np.sqrt(2), sd[2]])


def _apart(rows, n):
    """Of rows in order, those that are n apart or more, from the first on."""
    out, free = [], 0
    for row in rows.tolist():
        if row >= free:
            out.append(row)
            free = row + n
    return np.array(out, int)


def _sums(steps, starts, n, lags):
    """(W, lags): sums over n steps from each start, and over the n before these, and so on; none before the log."""
    total = np.concatenate([np.zeros(1), np.cumsum(steps)])
    at = lambda rows: total[np.clip(rows, 0, len(steps))]  # noqa: E731
    return np.stack([at(starts - lag * n + n) - at(starts - lag * n) for lag in range(lags)], 1).reshape(len(starts), lags)
