"""How large the gap is and how far it shrinks: RMS error of the attitude H rows ahead of what the observer knows."""

import numpy as np

from ..prediction_errors.ahead import DRAWS, HORIZONS, closed, rms
from .fit import active
from .innovations import settled
from .vehicle import ANGLES, CHANNELS, wrapped

WINDOWS = 400  # at most, spread over the log
FOLDS, BLOCK = 4, 4.0  # s: rows of a fold, in turn


def predictable(log):
    """Rows that the observer knows and from which the longest horizon can be predicted."""
    run = np.zeros(len(log.x), int)
    for k in range(len(log.usable) - 1, -1, -1):
        run[k] = run[k + 1] + 1 if log.usable[k] else 0
    return np.flatnonzero(settled(log) & (run >= max(HORIZONS)))


def starts_of(pieces):
    """Some of the predictable rows, spread over the log."""
    rows = predictable(pieces.log)
    return rows[:: max(1, len(rows) // WINDOWS)]


def ahead(pieces, causes, starts):
    """What is missed (W, H, 9), HORIZONS rows ahead."""
    return pieces.follow([*pieces.base, *active(causes)], starts=starts, steps=HORIZONS)[1]


def folds(rows, dt):
    """Fold of each row."""
    return (np.asarray(rows) * dt / BLOCK).astype(int) % FOLDS


def held_out(fitter, fit):
    """Causes (FOLDS) as they come out without the pieces of each fold: one Gauss-Newton step from the whole."""
    pieces = fitter.pieces
    if not fit.causes:
        return [fit.causes] * FOLDS
    J, z = fitter.jacobian(fit), fitter.vector(fit.causes)
    fold = np.repeat(folds(pieces.starts, pieces.log.dt), len(fit.left) // len(pieces.starts))
    out = []
    for f in range(FOLDS):
        rest = fold != f
        step = np.linalg.lstsq(J[rest], fit.left[rest], rcond=1e-9)[0]
        out.append(fitter.split(fit.causes, z - np.clip(step, -0.5, 0.5)))
    return out


def errors(fitter, fit, starts):
    """(before, after) (W, H, 9), each window predicted with parameters that were fitted without its rows."""
    pieces = fitter.pieces
    before = ahead(pieces, (), starts)
    parts = np.stack([ahead(pieces, causes, starts) for causes in held_out(fitter, fit)])
    return before, parts[folds(starts, pieces.log.dt), np.arange(len(starts))]


def attitude(missed):
    """Angle (W, H), rad, between predicted and logged attitude, to first order."""
    return np.sqrt(np.sum(missed[..., ANGLES] ** 2, axis=-1))


def contributions(pieces, causes, starts):
    """{effect: {H: RMS change, rad, of the attitude predicted H rows ahead, with it}}: what it moves, free of noise."""
    whole, out = ahead(pieces, causes, starts), {}
    for i, cause in enumerate(causes):
        rest = ahead(pieces, causes[:i] + causes[i + 1 :], starts)
        moved = rms(attitude(wrapped(rest - whole)))
        out[cause.name] = {str(H): float(m) for H, m in zip(HORIZONS, moved)}
    return out


def summary(before, after, floor, seed=0):
    """The `gap` of the report, in rad; floor (H, 9): RMS that perfect prediction would leave."""
    least = np.sqrt(np.sum(floor[:, ANGLES] ** 2, axis=-1))
    series = np.stack([attitude(before), attitude(after)])
    W = series.shape[1]
    block = max(1, W // 40)
    rng = np.random.default_rng(seed)
    firsts = rng.integers(0, max(W - block, 1), size=(DRAWS, -(-W // block)))
    index = (firsts[..., None] + np.arange(block)).reshape(DRAWS, -1) % W

    def table(a, b):
        low = np.minimum(least, b)  # a floor above what is left is not one
        return a, b, low, closed(a, b, low)

    whole = table(*rms(series, axis=1))
    drawn = table(*rms(series[:, index], axis=2))[3]
    keys = [str(H) for H in HORIZONS]
    named = lambda row: dict(zip(keys, map(float, row)))  # noqa: E731
    spread = {}
    for j, key in enumerate(keys):
        good = drawn[np.isfinite(drawn[:, j]), j] if np.isfinite(whole[3][j]) else []
        spread[key] = [float(v) for v in np.quantile(good, (0.025, 0.975))] if len(good) else [None, None]
    channels = {
        name: {"before": named(rms(before[..., c])), "after": named(rms(after[..., c])), "noise_floor": named(floor[:, c])}
        for c, name in enumerate(CHANNELS)
    }
    return {
        "unit": "rad",
        "before": named(whole[0]),
        "after": named(whole[1]),
        "noise_floor": named(whole[2]),
        "closed_fraction": named(whole[3]),
        "ci95": spread,
        "channels": channels,
        "windows": int(W),
    }
