"""Which effects, and when: stepwise search by what each is worth, and for every effect the stretch in which it acts.

Innovations are nearly linear in all of these effects, so each is tried from a single place, and the response to an
effect, piece by piece, tells in which stretch it would be worth most without another flight of the observer.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from .fit import ALWAYS, Cause, Fitter, active
from .forward import Search

FIRST = 0.3  # of the usual size, from which each effect is tried
TRIED = 3  # stretches that are fitted in full
ROUNDS = 3
FEWEST = 2  # pieces of a stretch
LOOKED_FOR, MARKED = 1.0, 0.5  # prices, on top, of an edge; of an effect that shows for a moment only
MARK = 1.5  # s, of what shows when an effect sets in
KEPT = 6.4e7  # bytes of residuals that are not worked out again
STRIDES = (1.0, 0.4, 0.15, 0.06, 0.02)  # s, by which the edges of a stretch are moved


class FlightFitter(Fitter):
    """A Fitter of effects without thresholds: no scan. Its pieces stay as they are, so what was left once is left again."""

    def __init__(self, pieces, without=()):
        super().__init__(pieces, without)
        self._left = lru_cache(maxsize=int(KEPT / (8 * max(pieces.degrees, 1))))(super().left)

    def left(self, causes):
        """Whitened residual (n)."""
        return self._left(tuple(causes))

    def rays(self, name):
        """The effect with nothing set, and the one vector to begin with, in usual values."""
        spec = self.effects[name][1]
        start = FIRST * np.array([np.sign(p.usual) or 1.0 for p in spec])
        return Cause(name, (0.0,) * len(spec)), [start]

    def coordinates(self, fit, index=-1):
        """The fit: there is nothing to scan."""
        return fit


class FlightSearch(Search):
    """A Search over whole flights, and over stretches of them."""

    fitter_type = FlightFitter

    def worth(self, fit):
        """As that of drives, but an edge costs more: here it is looked for in every row."""
        switches = sum(np.isfinite(s).sum() for c in fit.causes for s in c.segments)
        marks = sum(c.name in self.pieces.platform.transient for c in fit.causes)
        return super().worth(fit) + self.price * (LOOKED_FOR * switches + MARKED * marks)

    def feigned(self):
        """{effect: (its parameters by themselves, in usual values (p,), their variances)}, to first order."""
        out = {}
        for name in self.fitter.effects:
            J = self._response(name, (), self.base.left)
            inverse = np.linalg.pinv(J.T @ J, rcond=1e-9)
            out[name] = -inverse @ (J.T @ self.base.left), np.diag(inverse)
        return out

    def explain(self):
        """The best fit, of effects that act all along or in a stretch."""
        whole = self.run()
        starts = [whole] if not whole.causes else [whole, self.base]
        return min((self._with_stretches(fit) for fit in starts), key=self.worth)

    def _with_stretches(self, fit):
        """`fit` with such stretches as pay."""
        for _ in range(ROUNDS):
            trial = min((self._stretched(fit, *s) for s in self._stretches(fit)), key=self.worth, default=fit)
            trial = self._fewer(trial)
            if self.worth(trial) >= self.worth(fit) - 1e-9:
                break
            fit = trial
        return fit

    def _fewer(self, fit):
        """Takes out what does not pay, be it a cause or an edge."""
        for i, cause in enumerate(fit.causes):
            rest = fit.causes[:i] + fit.causes[i + 1 :]
            others = [rest]
            if cause.segments != ALWAYS:
                (t0, t1) = cause.segments[0]
                spans = {(-np.inf, np.inf), (t0, np.inf), (-np.inf, t1)} - {(t0, t1)}
                others += [(*rest, replace(cause, segments=(span,))) for span in sorted(spans)]
            for causes in others:
                trial = self.fitter.refine(self.fitter.fit_of(causes), steps=3)
                if self.worth(trial) <= self.worth(fit):
                    return self._fewer(trial)
        return fit

    def _stretches(self, fit):
        """[(name, t0, t1)] of the stretches worth most by the linear response of each effect, beside the rest of `fit`."""
        found = []
        for name in self.fitter.effects:
            rest = tuple(c for c in fit.causes if c.name != name)
            own = next((c for c in fit.causes if c.name == name), None)
            left = self.fitter.left(rest) if own else fit.left
            for gain, t0, t1 in self._best_stretches(name, rest, left):
                found.append((gain, name, t0, t1))
        found.sort(key=lambda f: -f[0])
        return [f[1:] for f in found[:TRIED]]

    def _moments(self, name, rest):
        """[(gain, t0, inf)] of an effect that shows when it sets in: where its mark fits best, of any size."""
        pieces, spec = self.pieces, self.fitter.effects[name][1]
        cause, middle = Cause(name, (0.0,) * len(spec)), len(pieces.log.x) // 2
        rows = slice(middle, min(middle + round(MARK / pieces.log.dt), len(pieces.log.x)))
        plain = pieces.white(pieces.residual(active(rest)))
        marks = []
        for i in range(len(spec)):
            z = np.zeros(len(spec))
            z[i] = FIRST
            one = replace(self.fitter.at(cause, z), segments=((middle * pieces.log.dt, np.inf),))
            marks.append((pieces.white(pieces.residual(active((*rest, one)))) - plain)[rows] / FIRST)
        slopes = np.stack([sum(np.correlate(plain[:, c], mark[:, c], "valid") for c in range(plain.shape[1])) for mark in marks], 1)
        gram = np.einsum("ptc,qtc->pq", marks, marks) + 1e-12 * np.eye(len(spec))
        gains = np.einsum("kp,kp->k", slopes, np.linalg.solve(gram, slopes.T).T)
        k = int(np.argmax(gains))
        return [(gains[k], k * pieces.log.dt, np.inf)]

    def _best_stretches(self, name, rest, left):
        """[(gain, t0, t1)] of an effect that acts between two pieces: one that steps in and stays, one that goes again."""
        if name in self.pieces.platform.transient:
            return self._moments(name, rest)
        J = self._response(name, rest, left)
        per_piece = left.reshape(len(self.pieces.starts), -1)
        J = J.reshape(len(per_piece), per_piece.shape[1], -1)
        gram = np.concatenate([[np.zeros((J.shape[2],) * 2)], np.cumsum(np.einsum("snp,snq->spq", J, J), axis=0)])
        slope = np.concatenate([[np.zeros(J.shape[2])], np.cumsum(np.einsum("snp,sn->sp", J, per_piece), axis=0)])
        S, ridge = len(per_piece), 1e-9 * np.trace(gram[-1]) * np.eye(J.shape[2]) + 1e-12 * np.eye(J.shape[2])
        starts = np.append(self.pieces.starts, self.pieces.starts[-1] + self.pieces.L) * self.pieces.log.dt
        best = {}
        for i in range(S):
            ends = np.arange(min(i + FEWEST, S), S + 1)
            G, b = gram[ends] - gram[i] + ridge, slope[ends] - slope[i]
            gains = np.einsum("sp,sp->s", b, np.linalg.solve(G, b[..., None])[..., 0])
            for kind, k in (("stays", len(ends) - 1), ("goes", int(np.argmax(gains)))):
                if kind not in best or gains[k] > best[kind][0]:
                    best[kind] = gains[k], i, ends[k]
        inner = lambda k: -np.inf if k == 0 else np.inf if k == S else starts[k]  # noqa: E731
        return [(gain, inner(i), inner(j)) for gain, i, j in best.values() if (i, j) != (0, S)]

    def _response(self, name, rest, left):
        """d left / d parameter (n, p) of an effect that acts all along, in usual values."""
        spec = self.fitter.effects[name][1]
        cause = Cause(name, (0.0,) * len(spec))
        columns = []
        for i in range(len(spec)):
            z = np.zeros(len(spec))
            z[i] = FIRST
            columns.append((self.fitter.left((*rest, self.fitter.at(cause, z))) - left) / FIRST)
        return np.stack(columns, 1)

    def _stretched(self, fit, name, t0, t1):
        """`fit` with this effect, which acts from t0 to t1, in the place of the same one that acts all along."""
        rest = tuple(c for c in fit.causes if c.name != name)
        cause, (start,) = self.fitter.rays(name)
        cause = replace(self.fitter.at(cause, start), segments=((t0, t1),))
        trial = self.fitter.refine(self.fitter.fit_of((*rest, cause)), steps=4)
        return self.fitter.refine(self._edges(trial), steps=4)

    def _edges(self, fit):
        """Moves the edges of the last cause to where they fit best."""
        for stride in STRIDES:
            moved = True
            while moved:
                moved = False
                for k in (0, 1):
                    for by in (-stride, stride):
                        trial = self._shifted(fit, k, by)
                        if trial and trial.cost < fit.cost - 1e-9:
                            fit, moved = trial, True
        return fit

    def _shifted(self, fit, k, by):
        cause = fit.causes[-1]
        span = list(cause.segments[0])
        if not np.isfinite(span[k]):
            return None
        span[k] += by
        if not max(span[0], 0) < span[1] - 2 * self.pieces.log.dt:
            return None
        return self.fitter.fit_of((*fit.causes[:-1], replace(cause, segments=(tuple(span),))))
