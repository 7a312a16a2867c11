"""How far predictions are off, some rows ahead of a measured state, and what noise alone would make."""

import numpy as np

HORIZONS = (1, 10, 50)  # steps, that predictions are compared after
FOLDS, BLOCK = 4, 4.0  # of the log; s, of the blocks that they are made of
DRAWS = 400  # of a bootstrap
FLOORS, LEFT = 1.5, 0.1  # times the noise floor, and share of the gap, that effects leave if they are others
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
    variance = path.noises.ahead(path, noise, starts, HORIZONS)
    return {gap: np.sqrt(variance[..., list(axes)].sum(-1)) for gap, (_, axes) in path.gaps.items()}


def folds(path):
    """Which part of the log each row (K,) is of."""
    return (path.t // BLOCK).astype(int) % FOLDS


def held_out(fitter, fit):
    """Causes (FOLDS) with sizes from the other folds: one Gauss-Newton step from the whole, where it helps."""
    if not fit.causes:
        return [()] * FOLDS
    J = fitter.jacobian(fit)
    z = fitter.vector(fit.causes)[0]
    fold, out = folds(fitter.path)[fitter.rows], []
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


def missed(fitter, fit, starts):
    """Measured less predicted (S, H, c), each prediction with the sizes of the other folds."""
    return missed_by(fitter.path, held_out(fitter, fit), starts)


def missed_by(path, causes, starts):
    """missed(), causes (FOLDS) being those for each fold."""
    if not any(causes):
        return path.ahead((), starts, HORIZONS)
    fold = folds(path)[starts]
    parts = {f: path.ahead(some, starts[fold == f], HORIZONS) for f, some in enumerate(causes) if (fold == f).any()}
    out = np.empty((len(starts), *next(iter(parts.values())).shape[1:]))
    for f, part in parts.items():
        out[fold == f] = part
    return out


def pushed(path, pushes, starts):
    """By how much pushes (K, n) in every step move predictions (S, H, c)."""
    e, out = np.zeros((len(starts), path.A.shape[1])), []
    for k in range(max(HORIZONS)):
        rows = np.minimum(starts + k, len(path.A) - 1)
        e = (path.A[rows] @ e[..., None])[..., 0] + pushes[rows]
        if k + 1 in HORIZONS:
            out.append(path.seen_from(starts, np.minimum(starts + k + 1, len(path.A) - 1), e))
    return np.stack(out, 1)


def after(fitter, fit, starts):
    """{gap: errors (S, H)} of missed()."""
    return sizes(fitter.path, missed(fitter, fit, starts))


def moved(path, missed, others, starts):
    """{gap: (H,)}: RMS by which predictions that miss so much (S, H, c) differ from those with other causes."""
    return {gap: rms(d) for gap, d in sizes(path, missed - path.ahead(others, starts, HORIZONS)).items()}


def rms(values, axis=0):
    """Of what is there; NaN of nothing."""
    return _root_mean(*_squares(values), axis)


def _squares(values):
    """(squares, 0 where nothing is; whether something is)."""
    there = np.isfinite(values)
    return np.square(np.where(there, values, 0)), there


def _root_mean(squares, there, axis):
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(squares.sum(axis) / there.sum(axis))


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
    rows = (first[..., None] + np.arange(block)).reshape(DRAWS, -1) % S
    drawn = _root_mean(*(part[:, rows] for part in _squares(series)), 2)
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


def misses(gap):
    """Whether predictions with causes miss clearly more than noise makes, and a part of the gap (as of a report) that matters."""
    before, after, floor = (np.array([*gap[part].values()])[1:] for part in ("before", "after", "noise_floor"))
    with np.errstate(invalid="ignore"):
        return bool(((after > FLOORS * floor) & (after**2 - floor**2 > LEFT**2 * (before**2 - floor**2))).any())


def opens(gap):
    """Whether causes make predictions stand out of a gap (as of a report) that is about the noise without them, at the longest horizon."""
    last = next((key for key, size in reversed(gap["after"].items()) if np.isfinite(size)), None)
    if last is None or np.isfinite(gap["closed_fraction"][last]):
        return False
    return gap["after"][last] > (1 + SHOWS) * max(gap["before"][last], gap["noise_floor"][last])
