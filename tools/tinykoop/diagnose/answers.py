"""Whether what goes into a link of a robot moves what comes out of it at all.

A fit of effects cannot answer that: to a robot that does not move, every effect that slows it down fits.
"""

import numpy as np
from scipy import special

LAGS = 5  # windows: the answer may come that many windows late
FAR_LESS = 0.1  # of the motion that goes in: what comes out is far less
TRIFLE = 0.02  # of it, that comes out in step with it: shaking and drift of a sensor, no answer
MOST, BEYOND = 0.5, 5.0  # of the motion that comes out, and times its noise: so small an answer is one nevertheless, as of commands in mm/s
CHANCE = 1e-3  # probability, from which on an answer is no chance
CLEAR = 0.07  # of the motion that goes in, that noise may be
FEWEST, USUAL = 12, 0.9  # windows; share of them that are not the worst


def dead(axes):
    """Whether nothing arrives, wherever enough goes in to see it; axes: as axis() gives them."""
    return any(axis["clear"] for axis in axes) and not any(axis["answers"] for axis in axes)


def axis(into, out, noise):
    """RMS of what goes in and comes out of one axis in a window, and whether that is clear and an answer.

    into (W, LAGS): of a window and of those before it; out (W,); noise: sd of the readings whose difference an `out` is.
    """
    rms = lambda values: float(np.sqrt(np.mean(values**2))) if len(values) else 0.0  # noqa: E731
    usual = np.abs(out) <= np.quantile(np.abs(out), USUAL) if len(out) else slice(0)  # a reading that is off is no answer
    given, seen = rms(into[:, 0]), np.sqrt(max(rms(out[usual]) ** 2 - 2 * noise**2, 0.0))
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


def windows(usable, n):
    """First rows of windows of n usable transitions, none of which overlap."""
    whole = np.convolve(usable, np.ones(n), "valid") > n - 0.5
    return _apart(np.flatnonzero(whole), n)


def _apart(rows, n):
    """Of rows in order, those that are n apart or more, from the first on."""
    out, free = [], 0
    for row in rows.tolist():
        if row >= free:
            out.append(row)
            free = row + n
    return np.array(out, int)


def sums(steps, starts, n, lags):
    """(W, lags): sums over n steps from each start, and over the n before these, and so on; none before the log."""
    total = np.concatenate([np.zeros(1), np.cumsum(steps)])
    at = lambda rows: total[np.clip(rows, 0, len(steps))]  # noqa: E731
    return np.stack([at(starts - lag * n + n) - at(starts - lag * n) for lag in range(lags)], 1).reshape(len(starts), lags)
