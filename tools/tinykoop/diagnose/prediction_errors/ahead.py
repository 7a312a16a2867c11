"""How far predictions are off, some rows ahead of a measured state, and what noise alone would make."""

import numpy as np

from .noise import CORRELATED, WHITE

HORIZONS = (1, 10, 50)
FOLDS, BLOCK = 4, 4.0  # of the log, in blocks of so many seconds
DRAWS = 400
FAR = 100.0  # times the variance, that an outlier counts for: what is farther off is not noise
SHOWS = 0.15  # of the noise, that a gap must stand out by to have a percentage


def starts_of(path):
    """Rows from which the longest horizon can be predicted, or the longest that the log allows."""
    K = len(path.breaks)
    ends = np.append(np.where(path.breaks[1:], np.arange(K - 1), K - 1), K - 1)
    run = np.minimum.accumulate(ends[::-1])[::-1] - np.arange(K)
    rows = np.flatnonzero((run >= min(HORIZONS[-1], run.max())) & (np.arange(K) >= path.settled))
    return rows[:: max(1, len(rows) // path.most_starts(HORIZONS[-1]))]


def floor(path, noise, starts):
    """{gap: (S, H)}: error of a perfect model, which starts at what was measured and is compared with what was measured."""
    n, r, c = len(path.spread), len(noise.process), len(noise.sensor)
    coloured, shown = noise.sensor_rho > CORRELATED, np.isfinite(path.present)
    outliers = np.where(shown, np.minimum(path.present, FAR), 0).sum(0) / np.maximum(shown.sum(0), 1)
    tint = np.where(coloured, noise.sensor**2, 0.0)
    white = np.where(coloured, WHITE, 1.0) * noise.sensor**2 * outliers
    P = np.zeros((len(starts), n + r + c, n + r + c))
    back = np.linalg.pinv(path.C)
    P[:, :n, :n] = back @ np.diag(tint + white) @ back.T + path.unsure(noise)[starts]
    P[:, n : n + r, n : n + r] = np.eye(r)
    P[:, n + r :, n + r :] = np.diag(tint)
    P[:, :n, n + r :] = -back @ np.diag(tint)
    P[:, n + r :, :n] = P[:, :n, n + r :].swapaxes(1, 2)
    drive = np.diag(np.concatenate([np.zeros(n), 1 - noise.process_rho**2, (1 - noise.sensor_rho**2) * tint]))
    F = np.zeros_like(P)
    F[:, n : n + r, n : n + r] = np.diag(noise.process_rho)
    F[:, n + r :, n + r :] = np.diag(noise.sensor_rho)
    H = np.concatenate([path.C, np.zeros((c, r)), np.eye(c)], 1)
    out = np.empty((len(starts), len(HORIZONS), c))
    for k in range(1, HORIZONS[-1] + 1):
        rows = np.minimum(starts + k - 1, len(path.A) - 1)
        F[:, :n, :n], F[:, :n, n : n + r] = path.A[rows], path.G[rows] * noise.process
        P = F @ P @ F.swapaxes(1, 2) + drive
        if k in HORIZONS:
            out[:, HORIZONS.index(k)] = np.einsum("ij,sjk,ik->si", H, P, H) + white
    return {gap: np.sqrt(out[..., list(axes)].sum(-1)) for gap, (_, axes) in path.gaps.items()}


def _folds(path):
    return (path.t // BLOCK).astype(int) % FOLDS


def held_out(fitter, fit):
    """Causes (FOLDS) with sizes from the other folds: one Gauss-Newton step from the whole, where it helps."""
    if not fit.causes:
        return [()] * FOLDS
    J, c = fitter.jacobian(fit), fitter.path.present.shape[1]
    z = fitter.vector(fit.causes)[0]
    fold, out = np.repeat(_folds(fitter.path), c), []
    for f in range(FOLDS):
        A, b = J[fold != f], fit.left[fold != f]
        gram = A.T @ A
        move = np.linalg.solve(gram + np.diag(1e-6 + 1e-3 * np.diag(gram) + 1.0), A.T @ b)
        causes = fitter.split(fit.causes, z - np.clip(move, -0.5, 0.5))
        left = fitter.lefts([causes])[:, 0]
        out.append(causes if (left[fold != f] ** 2).sum() < (b**2).sum() else fit.causes)
    return out


def sizes(path, residuals):
    """{gap: (S, H)} of residuals (S, H, c)."""
    return {gap: np.sqrt((residuals[..., list(axes)] ** 2).sum(-1)) for gap, (_, axes) in path.gaps.items()}


def errors(path, causes, starts):
    """{gap: (S, H)} of predictions with causes."""
    return sizes(path, path.ahead(causes, starts, HORIZONS))


def after(fitter, fit, starts):
    """{gap: errors (S, H)}, each prediction with the sizes of the other folds."""
    path, fold = fitter.path, _folds(fitter.path)[starts]
    if not fit.causes:
        return errors(path, (), starts)
    out = {gap: np.full((len(starts), len(HORIZONS)), np.nan) for gap in path.gaps}
    for f, causes in enumerate(held_out(fitter, fit)):
        for gap, values in errors(path, causes, starts[fold == f]).items():
            out[gap][fold == f] = values
    return out


def moved(path, causes, others, starts):
    """{gap: (H,)}: RMS by which predictions with causes differ from those with others."""
    return {gap: rms(d) for gap, d in sizes(path, path.ahead(causes, starts, HORIZONS) - path.ahead(others, starts, HORIZONS)).items()}


def rms(values, axis=0):
    """Of what is there; NaN of nothing."""
    there = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.square(np.where(there, values, 0)).sum(axis) / there.sum(axis))


def closed(before, after, least):
    """Share of the reducible gap that is gone; NaN where the gap is about the noise."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(before - least > SHOWS * least, (before - after) / (before - least), np.nan)


def summary(before, after, least, seed=0):
    """The `gap` of the report for one gap: intervals by a paired block bootstrap."""
    series = np.stack([before, after, least])
    series[:, ~np.isfinite(before)] = np.nan
    whole = rms(series, 1)
    whole[2] = np.minimum(whole[2], whole[1])
    S = series.shape[1]
    block, rng = max(1, S // 40), np.random.default_rng(seed)
    first = rng.integers(0, max(S - block, 1), size=(DRAWS, -(-S // block)))
    drawn = rms(series[:, (first[..., None] + np.arange(block)).reshape(DRAWS, -1) % S], 2)
    drawn[2] = np.minimum(drawn[2], drawn[1])
    share, spread = closed(*whole), np.full((2, len(HORIZONS)), np.nan)
    for j in np.flatnonzero(np.isfinite(share)):
        column = closed(*drawn[..., j])
        if np.isfinite(column).any():
            spread[:, j] = np.nanquantile(column, (0.025, 0.975))
    put = lambda row: {str(h): float(v) for h, v in zip(HORIZONS, row)}  # noqa: E731
    return {
        "before": put(whole[0]), "after": put(whole[1]), "noise_floor": put(whole[2]), "closed_fraction": put(share),
        "ci95": {str(h): [float(a), float(b)] for h, a, b in zip(HORIZONS, *spread)},
    }  # fmt: skip
