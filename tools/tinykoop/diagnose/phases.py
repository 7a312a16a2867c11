"""Effects that come and go: where the log changes, what acts in each part, and when exactly.

A change is told without naming effects: parts of the log that a few generic velocity errors explain
each by itself much better than together (optimal partitioning, Jackson et al. 2005). Each part is then
searched, the findings are merged, and the edges moved to the row that fits best.
"""

from dataclasses import replace

import numpy as np
import ruptures

from ..plumbing.errors import UserError
from . import features, noise
from .fit import ALWAYS, active
from .pieces import Pieces
from .search import Search

SHORT = 20  # rows of the pieces that changes are looked for in
FEWEST = 4  # of them in a part
MOST_PARTS = 7
STRICTNESS = 1.6  # cost of an edge, in generic errors of a part
MOSTLY = 0.9  # of what effects that act all along leave must go, before further changes are looked for
APART = 30  # rows between two edges that are not the same
FAR, NEAR = 120, 12  # rows, by which an edge is moved,
FAR_SECONDS = 8.0  # or as long as that
TOGETHER, STRIDE = 6, 2  # steps of edges and parameters at once; rows that tell the slope at an edge
FEW = {"constant", "v", "omega", "v omega", "v |omega|", "sign of v", "sign of omega"} | {
    "heading, sine", "heading, cosine",
}  # fmt: skip
HOPELESS = 2.0  # times the cost of a fit: parameters alone do not mend that
CHANGES = "change of"


class _Cost(ruptures.base.BaseCost):
    """Sum of squares that generic errors of one part leave, from sums over its pieces."""

    model, min_size = "generic", FEWEST

    def __init__(self, gram, slope, total):
        sums = [np.concatenate([np.zeros_like(a[:1]), np.cumsum(a, axis=0)]) for a in (gram, slope, total)]
        self.gram, self.slope, self.total = sums
        self.ridge = 1e-6 * np.trace(self.gram[-1]) / len(gram[0]) * np.eye(len(gram[0]))

    def fit(self, signal):
        self.signal = signal
        return self

    def error(self, start, end):
        gram, slope, total = (s[end] - s[start] for s in (self.gram, self.slope, self.total))
        return total - slope @ np.linalg.solve(gram + self.ridge, slope)


def parts(pieces, causes=()):
    """Edges (rows) between parts of the log that differ; none if it is of one piece."""
    if len(pieces.starts) < 2:
        return []
    short = Pieces(pieces.platform, pieces.log, pieces.integrator, SHORT)
    if len(short.starts) < 3 * FEWEST:
        return []
    short.set_noise(pieces.noise)
    short.settle_starts(features.Generic(short, active(causes)).left)
    names, raw = features.raw_columns(short)
    keep = [i for i, (name, _) in enumerate(names) if name in FEW or name.startswith(CHANGES)]
    F = np.moveaxis(short.whiten(raw[keep]), 0, -1)
    w = short.whiten(short.residual(active(causes)))
    cost = _Cost(np.einsum("snf,sng->sfg", F, F), np.einsum("snf,sn->sf", F, w), np.einsum("sn,sn->s", w, w))
    penalty = STRICTNESS * len(keep) * max(1.0, features.Generic(short, active(causes)).scale)
    search = ruptures.Pelt(custom_cost=cost, min_size=FEWEST, jump=1).fit(np.arange(len(w))[:, None])
    ends = search.predict(pen=penalty)[:-1]
    while len(ends) >= MOST_PARTS:
        penalty *= 1.6
        ends = search.predict(pen=penalty)[:-1]
    return [int(short.starts[i]) for i in ends]


def _part(pieces, first, last):
    """The pieces that lie in rows first..last."""
    return pieces.only((pieces.starts >= first) & (pieces.starts + pieces.lengths // 2 < last))


def _spans(on, times):
    """Times of the runs of true parts."""
    out = []
    for i, acts in enumerate(on):
        if acts and out and out[-1][1] == times[i]:
            out[-1] = (out[-1][0], times[i + 1])
        elif acts:
            out.append((times[i], times[i + 1]))
    ends = {times[0]: -np.inf, times[-1]: np.inf}
    return tuple((ends.get(a, a), ends.get(b, b)) for a, b in out)


def merge(search, edges, without, causes=()):
    """The best fit whose effects act in some of the parts only; None if no part has an effect.

    Tells the search's pieces the noise as it is away from the edges, beside what is known to act so far (`causes`).
    """
    pieces, fitter = search.pieces, search.fitter
    bounds = [0, *edges, len(pieces.log.x)]
    # what happens at an edge, a jump of the measured pose for one, is nobody's noise
    try:
        calm = Pieces(pieces.platform, pieces.log, pieces.integrator, avoid=edges)
    except UserError:  # nothing lies between the edges
        return None
    if len(calm.starts) < len(bounds):
        return None
    calm.set_noise(pieces.noise)
    noise.estimate(calm, active(causes), weigh=False)
    pieces.set_noise(calm.noise, 1.0)
    within = Search(calm, without, search.seed)
    within.price = search.price
    found = {}
    for first, last in zip(bounds[:-1], bounds[1:]):
        own = _part(calm, first, last)
        if own is None or len(own.starts) < 2:
            continue
        mine = Search(own, without, search.seed)
        best = mine.run(most=2)
        for cause in best.causes:
            worth = mine.drop(best, cause.name).cost - best.cost
            if worth > found.get(cause.name, (0,))[0]:
                found[cause.name] = worth, cause
    causes = [cause for _, cause in sorted(found.values(), key=lambda f: -f[0])][:4]
    if not causes:
        return None
    times = [row * pieces.log.dt for row in bounds]
    times[-1] = len(pieces.log.x) * pieces.log.dt
    fit = _assign(within, causes, bounds, times)
    for _ in range(2):
        fit = within.fitter.awake(within.fitter.refine(fit, steps=4))
        fit = _assign(within, fit.causes, bounds, times)
    fit = within.fitter.restart(within.fitter.refine(fit, steps=4))
    fit = _toggle(within, fit, times)
    return edge_search(fitter, settle(fitter, fitter.fit_of(fit.causes)), NEAR)


def _assign(search, causes, bounds, times):
    """Lets every part choose among all subsets of the causes; a subset costs as in search.worth()."""
    pieces, fitter = search.pieces, search.fitter
    middle = pieces.starts + pieces.lengths // 2
    part = np.searchsorted(bounds, middle, side="right") - 1
    costs = []
    subsets = [[i for i in range(len(causes)) if mask >> i & 1] for mask in range(1 << len(causes))]
    for subset in subsets:
        left = fitter.left([replace(causes[i], segments=ALWAYS) for i in subset])
        per_piece = (left.reshape(len(pieces.starts), -1) ** 2).sum(1)
        price = search.price * len(subset)
        costs.append(np.bincount(part, per_piece, minlength=len(bounds) - 1) + price)
    best = np.argmin(costs, axis=0)
    out = []
    for i, cause in enumerate(causes):
        spans = _spans([i in subsets[b] for b in best], times)
        if spans:
            out.append(replace(cause, segments=spans))
    return fitter.fit_of(out)


def edge_search(fitter, fit, far=FAR):
    """Moves every edge of the causes' segments to the row near it that fits best, in ever shorter strides."""
    pieces, causes = fitter.pieces, fit.causes
    dt, middle = pieces.log.dt, pieces.starts + pieces.lengths // 2
    far = max(far, round(far / FAR * FAR_SECONDS / dt))
    for reach, stride in ((far, far // 12), (far // 12, far // 48), (far // 24, 1)):
        for i, j, k in _edges(causes):
            first, last = (edge / dt for edge in causes[i].segments[j])
            around = reach + pieces.L
            near = pieces.only((middle > first - around) & (middle < last + around)) or pieces
            trials = [_moved(causes, i, j, k, rows * dt) for rows in range(-reach, reach + 1, max(stride, 1)) if rows]
            costs = {t: near.cost(active(t)) for t in (causes, *trials) if t}
            causes = min(costs, key=costs.get)
    return fitter.fit_of(causes)


def _edges(causes):
    """(cause, segment, end) of every edge inside the log."""
    every = [(i, j, k) for i, c in enumerate(causes) for j in range(len(c.segments)) for k in (0, 1)]
    return [(i, j, k) for i, j, k in every if np.isfinite(causes[i].segments[j][k])]


def settle(fitter, fit):
    """Fits parameters and edges: each by itself, then together, since they make up for one another."""
    fit = edge_search(fitter, fitter.refine(fit, steps=3))
    for _ in range(TOGETHER if _edges(fit.causes) else 0):
        better = _together(fitter, fit)
        if better.cost > fit.cost - max(1e-3 * fit.cost, 1.0):
            break
        fit = better
    return fitter.refine(fit, steps=3)


def _together(fitter, fit):
    """One Gauss-Newton step of parameters and edges at once, shortened until it helps."""
    edges, dt = _edges(fit.causes), fitter.pieces.log.dt

    def slope(edge):
        for rows in (STRIDE, -STRIDE):
            moved = _moved(fit.causes, *edge, rows * dt)
            if moved:
                return (fitter.left(moved) - fit.left) / rows
        return np.zeros_like(fit.left)

    J = np.column_stack([fitter.jacobian(fit), *map(slope, edges)])
    size = np.linalg.norm(J, axis=0) + 1e-9
    step = -np.linalg.lstsq(J / size, fit.left, rcond=1e-6)[0] / size
    z = fitter.vector(fit.causes)
    for share in (1.0, 0.5, 0.25):
        causes = fitter.split(fit.causes, z + share * step[: len(z)])
        for edge, rows in zip(edges, step[len(z) :]):
            causes = _moved(causes, *edge, round(share * float(np.clip(rows, -FAR, FAR))) * dt) or causes
        trial = fitter.fit_of(causes)
        if trial.cost < fit.cost:
            return trial
    return fit


def _moved(causes, i, j, k, by):
    """Causes with one edge moved; None if that would make no sense."""
    cause = causes[i]
    flat = [edge for segment in cause.segments for edge in segment]
    flat[2 * j + k] += by
    if any(b <= a for a, b in zip(flat, flat[1:])) or not flat[2 * j + k] > 0:
        return None
    segments = tuple(zip(flat[::2], flat[1::2]))
    return (*causes[:i], replace(cause, segments=segments), *causes[i + 1 :])


def _toggle(search, fit, times):
    """Switches each cause on or off in each part, one at a time, while that is worth it."""
    names = [c.name for c in fit.causes]
    for i in range(len(names)):
        for first, last in zip(times, times[1:]):
            on = [any(a < 0.5 * (t0 + t1) < b for a, b in fit.causes[i].segments) for t0, t1 in zip(times, times[1:])]
            at = times.index(first)
            on[at] = not on[at]
            spans = _spans(on, times)
            if not spans:
                continue
            trial = (*fit.causes[:i], replace(fit.causes[i], segments=spans), *fit.causes[i + 1 :])
            trial = search.fitter.fit_of(trial)
            if trial.cost < HOPELESS * fit.cost:
                trial, _ = search.fitter.descend(trial, steps=2)
                fit = min(fit, trial, key=search.worth)
    return fit
