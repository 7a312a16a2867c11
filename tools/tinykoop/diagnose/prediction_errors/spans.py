"""When causes act: stretches of time, told by how much each part of the log gains."""

from copy import copy
from dataclasses import replace

import numpy as np

from .fit import ALWAYS, SLOPE

BLOCKS, FEWEST = 30, 15  # parts of a log; rows of one, at least
REACH, STRIDE, NEAR = 120, 12, 14  # rows by which an edge is moved, in strides; then row by row
TURNS = 3  # of edges and sizes
NUDGES = 6  # of an edge, of a row or two each
JUMP, JUMPS = 6.0, 6  # standard deviations of an innovation that may be an edge; so many of these
OFF = 1, 2, 4, 8  # rows that an edge may be off
OPEN, SURE = 1.0, 8.0  # squares, by which a move of an edge shows; by which an edge is sure, if a row costs as much
SHORT = 8  # rows at the ends of a log, where nothing comes or goes
LEAST = 0.05  # of a log, that anything comes or goes for


def blocks(path):
    """First rows of parts (B + 1)."""
    K = len(path.begins)
    return np.unique(np.linspace(0, K, max(min(BLOCKS, K // FEWEST), 1) + 1).round().astype(int))


def _span(first, last, path):
    """Rows as times; ends of the log are open."""
    K = len(path.begins)
    return -np.inf if first <= path.settled + SHORT else float(path.t[first]), np.inf if last >= K - SHORT else float(path.t[last])


def masked(push, edges):
    """A push (K, n) in each part by itself (K, n, B)."""
    out = np.zeros((*push.shape, len(edges) - 1))
    for b, (first, last) in enumerate(zip(edges, edges[1:])):
        out[first:last, :, b] = push[first:last]
    return out


def beside(path, causes, trials):
    """What trials change of steps and readings with causes: (K, n, trials), (K, c, trials or 1 for all)."""
    return tuple(trial - base for trial, base in zip(path.steps(trials), path.steps([causes])))


def best_stretch(columns, left, edges, free=True):
    """(gain, (first, last) part, scale) of the run of columns (n, B) that takes most of `left`; free: at any positive scale."""
    gram, slope = columns.T @ columns, -(columns.T @ left)
    total = np.concatenate([[0], np.cumsum(slope)])
    area = np.zeros((len(slope) + 1,) * 2)
    area[1:, 1:] = gram.cumsum(0).cumsum(1)
    i, j = np.triu_indices(len(total), 1)
    long = edges[j] - edges[i] >= LEAST * (edges[-1] - edges[0])
    i, j = i[long], j[long]
    s = total[j] - total[i]
    g = np.maximum(area[j, j] - area[i, j] - area[j, i] + area[i, i], 1e-9)
    scale = np.clip(s / g, -4, 4) if free else np.ones_like(s)
    gain = 2 * scale * s - scale**2 * g
    k = int(gain.argmax())
    return float(gain[k]), (int(i[k]), int(j[k])), float(scale[k])


def seconds(span, edges, path):
    """A stretch of parts as times."""
    return _span(edges[span[0]], edges[span[1]], path)


def parts(path, others, cause, edges):
    """What a cause changes in each part by itself, (K, n, B) and (K, c, B) or (K, c, 1) for all, beside others.

    A sensor's effect jumps where it comes and goes, so it is asked part by part; the others act row by row.
    """
    if path.effects[cause.name].block == "sensor":
        times = np.append(path.t, np.inf)[edges]
        some = [replace(cause, segments=((a, b),)) for a, b in zip(times, times[1:])]
        return beside(path, others, [(*others, c) for c in some])
    along = (*others, replace(cause, segments=ALWAYS))
    D, E = beside(path, others, [along])
    return masked(D[..., 0], edges), masked(E[..., 0], edges) if E.any() else E


def _acts(cause, path):
    """Rows (K,) in which it does."""
    t = path.t + 0.5 * path.dt
    return np.any([(t >= a) & (t < b) for a, b in cause.segments], axis=0)


def _changes(fitter, fit, i, edges):
    """Columns (n, B) of cause i coming, or going, in each part."""
    path, cause = fitter.path, fit.causes[i]
    rest = fit.causes[:i] + fit.causes[i + 1 :]
    acts = _acts(cause, path)
    signs = np.where(acts[np.minimum((edges[:-1] + edges[1:]) // 2, len(acts) - 1)], -1.0, 1.0)
    return fitter.whiten(*parts(path, rest, cause, edges)) * signs


def _with(fit, i, acts, path):
    """Causes with cause i in the rows `acts` (K,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], acts, [False]]).astype(int))).reshape(-1, 2)
    spans = tuple(_span(a, b, path) for a, b in edges if b - a >= LEAST * len(acts))
    return (*fit.causes[:i], replace(fit.causes[i], segments=spans), *fit.causes[i + 1 :]) if spans else None


def _jumps(path, left):
    """Rows where what is measured jumps."""
    size = np.abs(left.reshape(len(path.begins), -1)).max(1)
    largest = np.argsort(-size)[:JUMPS]
    return [int(k) for k in largest if size[k] > JUMP and SHORT < k < len(size) - SHORT]


def toggled(fitter, fit, price):
    """The fit with one stretch of one cause on instead of off, or off instead of on; None if none gains more than `price`."""
    even, jumps, best = blocks(fitter.path), _jumps(fitter.path, fit.left), None
    for i in range(len(fit.causes)):
        acts = _acts(fit.causes[i], fitter.path)
        edges = np.unique([*even, *jumps, *(row for j, row in _rows(fit, fitter.path) if j == i)])
        gain, (a, b), _ = best_stretch(_changes(fitter, fit, i, edges), fit.left, edges, free=False)
        if best is None or gain > best[0]:
            rows = acts.copy()
            rows[edges[a] : edges[b]] = ~rows[edges[a] : edges[b]]
            best = gain, _with(fit, i, _mended(rows), fitter.path)
    if best is None or best[0] < price or best[1] is None:
        return None
    return edges_settled(fitter, fitter.refine(fitter.fit_of(best[1]), 4))


def _mended(acts):
    """Without stretches, on or off, that are too short, the shortest first."""
    acts = acts.copy()
    while True:
        ends = np.concatenate([[0], np.flatnonzero(np.diff(acts)) + 1, [len(acts)]])
        length = np.diff(ends)
        k = int(length.argmin())
        if len(length) == 1 or length[k] >= LEAST * len(acts):
            return acts
        acts[ends[k] : ends[k + 1]] = ~acts[ends[k] : ends[k + 1]]


def _rows(fit, path):
    """(cause, edge row) of every edge inside the log."""
    at = lambda e: int(np.searchsorted(path.t, e - 0.5 * path.dt))  # noqa: E731
    return [(i, at(e)) for i, c in enumerate(fit.causes) for span in c.segments for e in span if np.isfinite(e)]


def _moved(fitter, fit, i, row, first, last, stride):
    """The fit with one edge moved to where it costs least between rows first and last."""
    acts = _acts(fit.causes[i], fitter.path)
    K = len(acts)
    stops = np.unique(np.clip(np.r_[np.arange(first, row, stride), row, np.arange(row + stride, last + 1, stride)], 1, K - 1))
    columns = _changes(fitter, fit, i, stops)
    here = int(np.searchsorted(stops, row))
    left = fit.left[:, None] + np.concatenate(
        [np.cumsum(columns[:, :here][:, ::-1], 1)[:, ::-1], np.zeros((len(columns), 1)), np.cumsum(columns[:, here:], 1)], 1
    )
    best = int((left**2).sum(0).argmin())
    if best == here:
        return fit
    rows = acts.copy()
    a, b = sorted((stops[best], row))
    rows[a:b] = ~rows[a:b]
    causes = _with(fit, i, rows, fitter.path)
    trial = fitter.fit_of(causes) if causes else fit
    return trial if trial.cost < fit.cost else fit


def edges(fitter, fit):
    """Every edge at the row where it fits best, strides first."""
    for stride, reach in ((STRIDE, REACH), (1, NEAR)):
        for k in range(len(_rows(fit, fitter.path))):
            every = _rows(fit, fitter.path)
            if k < len(every):
                i, row = every[k]
                fit = _moved(fitter, fit, i, row, row - reach, row + reach, stride)
    return _nudged(fitter, fit)


def _nudged(fitter, fit):
    """Edges a row or two on while that helps: what an effect does may depend on when it began."""
    for k in range(len(_rows(fit, fitter.path))):
        for _ in range(NUDGES):
            i, row = _rows(fit, fitter.path)[k]
            acts = _acts(fit.causes[i], fitter.path)
            trials = []
            for by in (-2, -1, 1, 2):
                rows = acts.copy()
                rows[min(row, row + by) : max(row, row + by)] = acts[row] if by < 0 else acts[row - 1]
                trials.append(_with(fit, i, rows, fitter.path))
            best = min((fitter.fit_of(t) for t in trials if t), key=lambda f: f.cost, default=fit)
            if best.cost >= fit.cost or len(_rows(best, fitter.path)) != len(_rows(fit, fitter.path)):
                break
            fit = best
    return fit


def edges_settled(fitter, fit):
    """Edges and sizes in turn."""
    for _ in range(TURNS):
        better = fitter.refine(edges(fitter, fit), 3)
        if better.cost > fit.cost - 1:
            return min(better, fit, key=lambda f: f.cost)
        fit = better
    return fit


def freed(fitter, fit):
    """The fitter for intervals of a fit: what edges do that are rows off as chance has it is no part of its residuals.

    Sizes are less certain for it, as they are for other sizes. An edge that would cost much a row off is certain.
    """
    columns = _unsure(fitter, fit)
    if not columns.shape[1]:
        return fitter
    free = copy(fitter)

    def lefts(trials):
        found = fitter.lefts(trials)
        return found - columns @ (columns.T @ found)

    free.lefts = lefts
    return free


def _unsure(fitter, fit):
    """Orthonormal columns (n, q): what edges do that are not certain, by as many rows as show."""
    columns, rows = np.zeros((len(fit.left), 0)), _rows(fit, fitter.path)
    J = fitter.jacobian(fit) if rows else columns
    others = np.linalg.qr(J[:, (J**2).sum(0) > SLOPE])[0]
    for i, row in rows:
        moves = [_either_way(fitter, fit, i, row, by) for by in OFF]
        shown = [0.0 if move is None else ((move - others @ (others.T @ move)) ** 2).sum() for move in moves]
        if 0 < shown[0] < SURE:
            columns = np.column_stack([columns, next((m for m, s in zip(moves, shown) if s > OPEN), moves[0])])
    return np.linalg.qr(columns)[0]


def _either_way(fitter, fit, i, row, by):
    """Half of what differs (n,) between an edge so many rows later and earlier; None where there is no room."""
    acts = _acts(fit.causes[i], fitter.path)
    if not by < row < len(acts) - by:
        return None
    later, earlier = acts.copy(), acts.copy()
    later[row : row + by], earlier[row - by : row] = acts[row - 1], acts[row]
    trials = [_with(fit, i, rows, fitter.path) for rows in (later, earlier)]
    if None in trials:
        return None
    lefts = fitter.lefts(trials)
    return (lefts[:, 0] - lefts[:, 1]) / 2
