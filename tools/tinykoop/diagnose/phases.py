"""Effects that come and go: where the log changes, what acts in each part, and when exactly.

A change is told without naming effects: parts of the log that a few generic velocity errors explain
each by itself much better than together (optimal partitioning, Jackson et al. 2005). Each part is then
searched, the findings are merged, and the edges moved to the row that fits best.
"""

from dataclasses import replace

import numpy as np
import ruptures

from ..errors import UserError
from . import features, noise
from .fit import ALWAYS, active
from .pieces import Pieces
from .search import Search

SHORT = 20  # rows of the pieces that changes are looked for in
FEWEST = 4  # of them in a part
MOST_PARTS = 7
STRICTNESS = 1.6  # cost of an edge, in generic errors of a part
MOSTLY = 0.5  # of what effects that act all along leave must go, before further changes are looked for
APART = 30  # rows between two edges that are not the same
FAR, NEAR = 120, 12  # rows, by which an edge is moved
FEW = {"constant", "v", "omega", "v omega", "v |omega|", "sign of v", "sign of omega"} | {
    "heading, sine", "heading, cosine",
}  # fmt: skip
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


def merge(search, edges, without):
    """The best fit whose effects act in some of the parts only; None if no part has an effect.

    Tells the search's pieces the noise as it is away from the edges.
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
    noise.estimate(calm, weigh=False)
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
        fit = within.fitter.refine(fit, steps=4)
        fit = _assign(within, fit.causes, bounds, times)
    fit = within.fitter.restart(within.fitter.refine(fit, steps=4))
    fit = _toggle(within, fit, times)
    fit = fitter.refine(edge_search(fitter, fitter.fit_of(fit.causes)), steps=4)
    return edge_search(fitter, fit, NEAR)


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
    """Moves every edge of the causes' segments to the row near it that fits best: first in strides, then row by row."""
    dt = fitter.pieces.log.dt
    for reach, stride in ((far, max(far // 30, 1)), (max(far // 30, 3), 1)):
        for i, j, k in [(i, j, k) for i, c in enumerate(fit.causes) for j in range(len(c.segments)) for k in (0, 1)]:
            if np.isfinite(fit.causes[i].segments[j][k]):
                trials = [_moved(fit, i, j, k, rows * dt) for rows in range(-reach, reach + 1, stride) if rows]
                fit = min([fit, *(fitter.fit_of(t) for t in trials if t)], key=lambda f: f.cost)
    return fit


def _moved(fit, i, j, k, by):
    """Causes with one edge moved; None if that would make no sense."""
    cause = fit.causes[i]
    flat = [edge for segment in cause.segments for edge in segment]
    flat[2 * j + k] += by
    if any(b <= a for a, b in zip(flat, flat[1:])) or not flat[2 * j + k] > 0:
        return None
    segments = tuple(zip(flat[::2], flat[1::2]))
    return (*fit.causes[:i], replace(cause, segments=segments), *fit.causes[i + 1 :])


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
            trial = search.fitter.refine(search.fitter.fit_of(trial), steps=2)
            if search.worth(trial) < search.worth(fit):
                fit = trial
    return fit
