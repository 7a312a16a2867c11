"""How large the gap is, and how far it shrinks: RMS position error H steps ahead of a measured pose."""

from dataclasses import dataclass

import numpy as np

from .fit import active
from .pieces import SETTLE

HORIZONS = (1, 10, 50)
WINDOWS = 400  # at most, spread over the log
FOLDS = 4
RESAMPLED = 400
USUAL = 0.95  # share of the windows that are not among the worst
WORTH_A_PERCENTAGE = 0.15  # of the noise floor that a gap must stand out by


@dataclass(frozen=True)
class Windows:
    """Errors (W, H) of predictions; NaN where a window leaves the usable rows."""

    starts: np.ndarray
    position: np.ndarray  # m
    heading: np.ndarray  # rad
    along: np.ndarray  # (W, H, 2) m
    predicted: np.ndarray  # (W, H, 3)


def starts_of(log, horizons=HORIZONS):
    """Rows from which the longest horizon can be predicted, or the longest that the log allows."""
    rows = np.arange(len(log.x))
    end = np.append(np.where(log.usable, len(rows), rows[:-1]), len(rows) - 1)  # of the usable rows that begin here
    run = np.minimum.accumulate(end[::-1])[::-1] - rows
    rows = np.flatnonzero(run >= min(max(horizons), run.max()))
    if len(rows) > SETTLE * max(horizons):
        rows = rows[rows >= max(horizons)]  # as in pieces.cut()
    return rows[:: max(1, len(rows) // WINDOWS)]


def windows(platform, log, integrator, causes, starts, horizons=HORIZONS):
    """Predictions with these causes from the measured poses in rows `starts`."""
    steps = np.minimum(horizons, len(log.x) - 1)
    predicted, r = platform.rollouts(log.x, log.u, log.dt, starts, steps, log.usable, integrator).predict(active(causes))
    return Windows(starts, np.hypot(r[..., 0], r[..., 1]), r[..., 2], r[..., :2], predicted)


def floor(noise, log, starts, horizons=HORIZONS):
    """What perfect prediction would leave, (W, H, 2), m and rad: noise at both ends, that of the heading times the way."""
    out = np.empty((len(starts), len(horizons), 2))
    for j, H in enumerate(horizons):
        ends = np.minimum(starts + H, len(log.x) - 1)
        way = np.hypot(*(log.x[ends, :2] - log.x[starts, :2]).T)
        out[:, j, 0] = np.sqrt(4 * noise.sp**2 * (1 - noise.rho_p**H) + (noise.st * way) ** 2)
        out[:, j, 1] = np.sqrt(2 * noise.st**2 * (1 - noise.rho_t**H))
    return out


def rms(values, axis=0):
    """Root mean square of what is there, NaN of nothing."""
    there = np.isfinite(values)
    count = there.sum(axis)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.square(np.where(there, values, 0)).sum(axis) / count)


def longest(windows):
    """Index of the longest horizon that the log allows."""
    return int(np.flatnonzero(np.isfinite(windows.position).any(0)).max(initial=0))


def regions(pieces):
    """Fold of every piece: by how fast it drives and turns, so that each fold lies outside what the others cover."""
    u = pieces.platform.commands(pieces.log.u)
    size = np.abs(u) / (np.std(u, axis=0) + np.abs(u).mean(0) + 1e-9)
    drive = np.array([size[start : start + n].mean() for start, n in zip(pieces.starts, pieces.lengths)])
    fold = np.empty(len(drive), int)
    fold[np.argsort(drive, kind="stable")] = np.arange(len(drive)) * FOLDS // len(drive)
    return fold


def held_out(fitter, fit):
    """Causes (FOLDS) as they come out without the pieces of each fold: one Gauss-Newton step from the whole, where it helps.

    It does not where a threshold lies close to a command that was held: that fold is then predicted with the
    parameters of the whole, its own rows among them.
    """
    pieces, fold = fitter.pieces, regions(fitter.pieces)
    if not fit.causes:
        return [fit.causes] * FOLDS
    J = fitter.jacobian(fit)
    z = fitter.vector(fit.causes)
    per_piece = len(fit.left) // len(pieces.starts)
    row_fold = np.repeat(fold, per_piece)
    out = []
    for f in range(FOLDS):
        rest = row_fold != f
        gram = J[rest].T @ J[rest]
        ridge = np.diag(1e-6 + 1e-3 * np.diag(gram) + 1.0)  # a usual value is a weak guess
        step = np.clip(np.linalg.solve(gram + ridge, J[rest].T @ fit.left[rest]), -0.5, 0.5)
        moved = fitter.split(fit.causes, z - step)
        better = np.sum(fitter.left(moved)[rest] ** 2) < np.sum(fit.left[rest] ** 2)
        out.append(moved if better else fit.causes)
    return out


def errors(fitter, fit, starts, noise):
    """(before, after, floor) on rows that were not used: windows are predicted by the fold they are not in."""
    pieces = fitter.pieces
    log, platform, integrator = pieces.log, pieces.platform, pieces.integrator
    before = windows(platform, log, integrator, (), starts)
    fold_of_row = np.zeros(len(log.x), int)
    for start, n, f in zip(pieces.starts, pieces.lengths, regions(pieces)):
        fold_of_row[start : start + n] = f
    parts = [windows(platform, log, integrator, causes, starts) for causes in held_out(fitter, fit)]
    pick = fold_of_row[starts]
    after = Windows(
        starts,
        *(
            np.stack([getattr(p, name) for p in parts])[pick, np.arange(len(starts))]
            for name in ("position", "heading", "along", "predicted")
        ),
    )
    return before, after, floor(noise, log, starts)


def closed(before, after, least):
    """Share of the reducible gap that is gone; NaN where the gap is about the noise."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (before - after) / (before - least)
    return np.where(before - least > WORTH_A_PERCENTAGE * least, share, np.nan)


def gaps(before, after, least, heading=False):
    """RMS error (3, H) of position, m, or heading, rad: before, after, floor."""
    name = "heading" if heading else "position"
    return np.stack([rms(getattr(before, name)), rms(getattr(after, name)), rms(least[..., int(heading)])])


def typical(before, after, least):
    """(RMS position error after, floor), m, at the longest horizon, without the worst windows: outliers prove nothing."""
    j = longest(before)
    errors = after.position[:, j]
    usual = errors <= np.nanquantile(errors, USUAL) if np.isfinite(errors).any() else slice(0)
    return float(rms(errors[usual])), float(rms(least[usual, j, 0]))


def summary(before, after, least, seed=0):
    """The `gap` of the report: position in metres; heading beside it; intervals by a paired block bootstrap."""
    series = np.stack([before.position, after.position, least[..., 0]])  # (3, W, H)
    series[:, ~np.isfinite(before.position)] = np.nan
    whole = rms(series, axis=1)
    whole[2] = np.minimum(whole[2], whole[1])
    W = series.shape[1]
    block = max(1, W // 40)
    rng = np.random.default_rng(seed)
    firsts = rng.integers(0, max(W - block, 1), size=(RESAMPLED, -(-W // block)))
    index = (firsts[..., None] + np.arange(block)).reshape(RESAMPLED, -1) % W
    drawn = rms(series[:, index], axis=2)  # (3, R, H)
    drawn[2] = np.minimum(drawn[2], drawn[1])
    share = closed(*whole)
    spread = np.full((2, len(share)), np.nan)
    for j in np.flatnonzero(np.isfinite(share)):
        column = closed(*drawn[..., j])
        if np.isfinite(column).any():
            spread[:, j] = np.quantile(column[np.isfinite(column)], (0.025, 0.975))
    keys = [str(H) for H in HORIZONS]
    heading = gaps(before, after, least, heading=True)
    table = lambda row: dict(zip(keys, map(float, row)))  # noqa: E731
    return {
        "before": table(whole[0]),
        "after": table(whole[1]),
        "noise_floor": table(whole[2]),
        "closed_fraction": table(share),
        "ci95": {key: [float(lo), float(hi)] for key, lo, hi in zip(keys, *spread)},
        "heading_rad": {
            "before": table(heading[0]),
            "after": table(heading[1]),
            "noise_floor": table(heading[2]),
            "closed_fraction": table(closed(*heading[:2], np.minimum(*heading[1:]))),
        },
        "windows": int(W),
    }
