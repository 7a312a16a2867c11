"""What one effect more promises beside a fit, in the whole log and in the stretch of time that suits it."""

from dataclasses import replace

import numpy as np

from . import spans
from .fit import ALWAYS, Cause

SHOWS = 1.0  # norm of what a candidate does beside the others
LIMIT = 0.3  # share of a range in which a linear effect begins
ALONG = 0.5  # of what a candidate would gain at another size, that is promised
MARK = 1.5  # s, of what shows when an effect sets in
PROMISING = 0.05  # of what the best effect promises, from which on the other forms of a family are scanned, too


class _Beside:
    """Whitened columns and what is left, free of what the sizes of the fit can make."""

    def __init__(self, fitter, fit):
        self.fitter, self.fit = fitter, fit
        J = fitter.jacobian(fit)
        self._basis = np.linalg.qr(J)[0] if J.shape[1] else np.zeros((len(fit.left), 0))
        self.left = self._free(fit.left)

    def _free(self, columns):
        return columns - self._basis @ (self._basis.T @ columns)

    def columns(self, pushes):
        return self._free(self.fitter.whiten(*pushes))


def _sized(cause, effect, params, share=1.0):
    """The cause with parameters inside a share of their ranges."""
    limits = share * np.array([[p.low, p.high] for p in effect.parameters]).T
    return replace(cause, params=tuple(np.clip(params, *limits).tolist()))


def _linear(effect, causes, columns, left):
    """(gain, Cause) at the best combination of its parameters."""
    weights = np.linalg.lstsq(columns, -left, rcond=1e-9)[0]
    gain = left @ left - ((left + columns @ weights) ** 2).sum()
    return float(gain), _sized(causes[0], effect, np.array([c.params for c in causes]).T @ weights, LIMIT)


def _best_start(effect, causes, columns, left):
    """(gain, Cause) at the best of the sizes tried; what a size between would gain counts in part."""
    size = np.linalg.norm(columns, axis=0)
    gain = left @ left - ((left[:, None] + columns) ** 2).sum(0)
    along = -(left @ columns) / np.maximum(size, 1e-9)
    promise = np.where(size > SHOWS, np.maximum(gain, np.where(effect.steady & (along > 0), ALONG * along**2, 0)), 0)
    i = int(promise.argmax())
    return float(promise[i]), causes[i]


def _whole(beside, effects, segments):
    """[(gain, Cause)] of those of some effects that do something."""
    fit, found = beside.fit, []
    names = [n for n, e in effects.items() if not e.transient]
    trials = [Cause(n, start, segments) for n in names for start in effects[n].starts]
    if not trials:
        return []
    path = beside.fitter.path
    columns = beside.columns(spans.beside(path, fit.causes, [(*fit.causes, c) for c in trials]))
    for name in dict.fromkeys(c.name for c in trials):
        mine = [i for i, c in enumerate(trials) if c.name == name]
        causes, some = [trials[i] for i in mine], columns[:, mine]
        if (np.linalg.norm(some, axis=0) > SHOWS).any():
            best = _linear if effects[name].linear else _best_start
            found.append(best(effects[name], causes, some, beside.left))
    return [(gain, cause) for gain, cause in found if gain > 0]


def _families(beside, segments):
    """[(gain, Cause)] of effects that are not in the fit, and of their other forms where a family promises something.

    An effect is no stand-in for another of its family: a lag of both axes promises nothing where one of them lags.
    """
    effects = beside.fit.lacks(beside.fitter.effects)
    found = _whole(beside, {name: e for name, e in effects.items() if e.reported_as == name}, segments)
    most = max((gain for gain, _ in found), default=0.0)
    likely = {effects[cause.name].kin for gain, cause in found if gain >= PROMISING * most}
    forms = {name: e for name, e in effects.items() if e.reported_as != name and e.kin in likely}
    return found + _whole(beside, forms, segments)


def _in_time(beside, gain, cause, margin):
    """(gain less the price of edges, Cause) in the stretch that suits it best; None if the whole log promises as much."""
    path, effect = beside.fitter.path, beside.fitter.effects[cause.name]
    blocks = spans.blocks(path)
    columns = beside.columns(spans.parts(path, beside.fit.causes, cause, blocks))
    best, span, scale = spans.best_stretch(columns, beside.left, blocks)
    price = 2 * np.log(beside.fitter.degrees)
    if best <= gain + price + margin:
        return None
    cause = replace(cause, segments=(spans.seconds(span, blocks, path),))
    return best - price, _sized(cause, effect, np.array(cause.params) * scale) if effect.linear else cause


def _onset(beside, effect, price):
    """(gain less the price, Cause) of what shows when it sets in: from where on its mark fits best, at any size."""
    path, fit = beside.fitter.path, beside.fit
    K = len(path.t)
    middle, last = K // 2, K - 1 - spans.SHORT
    rows = slice(middle, min(middle + round(MARK / path.dt), last))
    trials = [Cause(effect.name, start, ((float(path.t[middle]), np.inf),)) for start in effect.starts]
    marks = beside.fitter.whiten(*spans.beside(path, fit.causes, [(*fit.causes, c) for c in trials])).reshape(K, -1, len(trials))[rows]
    left = beside.left.reshape(K, -1)
    slopes = np.stack(
        [sum(np.correlate(left[:, c], mark[:, c], "valid") for c in range(left.shape[1])) for mark in np.moveaxis(marks, 2, 0)], 1
    )
    weights = -np.linalg.solve(np.einsum("kcp,kcq->pq", marks, marks) + 1e-12 * np.eye(len(trials)), slopes.T).T
    gains = -(weights * slopes).sum(1)
    k = int(gains.argmax())
    cause = replace(trials[0], segments=((float(path.t[k]), np.inf),))
    return float(gains[k]) - price, _sized(cause, effect, np.array([c.params for c in trials]).T @ weights[k])


def candidates(fitter, fit, segments=None, margin=0.0):
    """[(promise, Cause)], best first. segments: when they act, if that is not asked, too."""
    beside = _Beside(fitter, fit)
    found = _families(beside, segments or ALWAYS)
    if segments is None:
        sudden = [effect for effect in fit.lacks(fitter.effects).values() if effect.transient]
        found += [_onset(beside, effect, 2 * np.log(fitter.degrees)) for effect in sudden]
        own = [(gain, cause) for gain, cause in found if fitter.effects[cause.name].reported_as == cause.name]
        found += [timed for gain, cause in own if cause.segments == ALWAYS and (timed := _in_time(beside, gain, cause, margin))]
    return sorted(found, key=lambda f: -f[0])


def first_forms(effects, found, count):
    """Causes of the first of so many effects, each in the form that promises most."""
    seen = {}
    for _, cause in found:
        seen.setdefault(effects[cause.name].reported_as, cause)
    return list(seen.values())[:count]
