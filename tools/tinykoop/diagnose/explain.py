"""From pieces to an explanation: noise, effects, phases, and noise again until all stand still."""

from dataclasses import dataclass, replace

from . import features, noise, phases, verdict
from .fit import ALWAYS, Fit, active
from .search import Search

ROUNDS = 3
STILL = 0.05  # change of the noise that calls for another round


@dataclass
class Explanation:
    """The best fit, the search that found it, and the rows where the log changes."""

    fit: Fit
    search: Search
    edges: list
    nu: float  # Student's degrees of freedom of the noise


def _moved(old, new):
    size = abs(new.sp / old.sp - 1) + abs(new.st / old.st - 1)
    return size + abs(new.rho_p - old.rho_p) + abs(new.rho_t - old.rho_t) > STILL


def _something_left(pieces, fit):
    return features.Generic(pieces, active(fit.causes)).significance() < verdict.SIGNIFICANT


def _joined(fit):
    """Fits' causes with two neighbouring segments of one joined, or one that acts all along."""
    for i, cause in enumerate(fit.causes):
        spans = cause.segments
        wider = [ALWAYS] if spans != ALWAYS else []
        wider += [(*spans[:j], (spans[j][0], spans[j + 1][1]), *spans[j + 2 :]) for j in range(len(spans) - 1)]
        for segments in wider:
            yield (*fit.causes[:i], replace(cause, segments=segments), *fit.causes[i + 1 :])


def prune(search, fit):
    """Takes causes, and switches, out of a fit with segments while that is worth it."""
    for causes in list(_joined(fit)):
        simpler = search.fitter.refine(search.fitter.fit_of(causes), steps=2)
        if search.worth(simpler) < search.worth(fit):
            return prune(search, simpler)
    fitter = search.fitter
    while len(fit.causes) > 1:
        rests = [fit.causes[:i] + fit.causes[i + 1 :] for i in range(len(fit.causes))]
        fewer = [fitter.refine(fitter.fit_of(rest), steps=2) for rest in rests]
        best = phases.settle(fitter, min(fewer, key=search.worth))
        if search.worth(best) > search.worth(fit):
            break
        fit = best
    return fit


def _phased(pieces, first, without, seed, price):
    """(edges, fit with segments or None, its search)."""
    edges = phases.parts(pieces, first.causes) or phases.parts(pieces)
    if not edges:
        return edges, None, None
    search = Search(pieces, without, seed)
    search.price = price
    fit, again = phases.merge(search, edges, without), None
    for _ in range(ROUNDS):
        if fit is None:
            break
        before = pieces.noise
        noise.estimate(pieces, active(fit.causes))
        search.rebase()
        fit = prune(search, phases.settle(search.fitter, search.fitter.fit_of(fit.causes)))
        # a change that a larger one hid shows once that is explained
        always = search.fitter.fit_of(first.causes).cost
        large = always - fit.cost > phases.MOSTLY * (always - pieces.degrees)
        hidden = phases.parts(pieces, fit.causes) if large and _something_left(pieces, fit) else []
        more = sorted({*edges, *(row for row in hidden if min(abs(row - edge) for edge in edges) > phases.APART)})
        if more != edges and again is None:
            edges = more
            again = phases.merge(search, edges, without, fit.causes)
            fit = search.fitter.fit_of(fit.causes)  # the noise is another now
            if again and search.worth(again) < search.worth(fit):
                fit = again
                continue
        if not _moved(before, pieces.noise):
            break
    return edges, fit, search


def begin(pieces, without=(), seed=0):
    """A first noise, and the Search that has tried every effect by itself."""
    pieces.set_noise(noise.third_differences(pieces.log))
    noise.estimate(pieces, weigh=False)
    search = Search(pieces, without, seed)
    search.singles()
    return search


def explain(search, without=(), seed=0):
    """The Explanation of a log, from begin(); leaves noise and starts settled in the pieces."""
    pieces, best = search.pieces, search.best(1)
    nu = noise.estimate(pieces, active(best.causes))
    edges, phased = [], None
    if _something_left(pieces, search.fitter.fit_of(best.causes)):
        edges, phased, phased_search = _phased(pieces, best, without, seed, search.price)
        if phased and not _something_left(pieces, phased):
            return Explanation(phased, phased_search, edges, nu)
    for turn in range(ROUNDS):
        seeds = [best] + sorted(search.fits.values(), key=search.worth)[:3]
        search = Search(pieces, without, seed)
        best = search.run(seeds)
        before = pieces.noise
        nu = noise.estimate(pieces, active(best.causes))
        if not _moved(before, pieces.noise):
            break
    search.rebase()
    best = search.fitter.refine(search.fitter.fit_of(best.causes))
    if phased:
        phased = search.fitter.fit_of(phased.causes)
        if search.worth(phased) < search.worth(best):
            best = phased
            nu = noise.estimate(pieces, active(best.causes))
            search.rebase()
            best = search.fitter.fit_of(best.causes)
    return Explanation(best, search, edges, nu)
