"""Which effects: forward, backward, swap and the likeliest pairs, judged by what each one is worth.

An effect is taken in when it pays more than the best of the whole library would on noise alone.
"""

import numpy as np

from .fit import Fitter

MOST = 4  # effects in one explanation
REFINED = 4  # candidates of a scan that are fitted in full
PAIRS = 4  # pairs that are fitted in full
DRAWS = 400
FALSE_ALARMS = 0.005
EDGE = 0.25  # of a misfit is charged to an effect with a parameter at its bound


def price(directions, seed):
    """What the best of a scan gains on white noise, but for one log in 1 / FALSE_ALARMS.

    directions (n, D): what each step of the scan changed, whitened.
    """
    size = np.linalg.norm(directions, axis=0)
    D = directions[:, size > 1e-9] / size[size > 1e-9]
    # the columns span few dimensions: draw there
    values, vectors = np.linalg.eigh(D.T @ D)
    keep = values > 1e-9 * values[-1]
    root = vectors[:, keep] * np.sqrt(values[keep])
    gains = (root @ np.random.default_rng(seed).normal(size=(keep.sum(), DRAWS))) ** 2
    return float(np.quantile(gains.max(0), 1 - FALSE_ALARMS))


class Search:
    """The search on one set of pieces.

    fits: the best fit seen for every set of names; added: what extend() made of a fit.
    """

    fitter_type = Fitter

    def __init__(self, pieces, without=(), seed=0):
        self.fitter = self.fitter_type(pieces, without)
        self.pieces, self.seed = pieces, seed
        self.rebase()

    def rebase(self):
        """Forgets costs after the noise has changed; the price of an effect stays."""
        self.fits, self.added = {}, {}
        self.base = self.keep(self.fitter.fit_of(()))

    def keep(self, fit):
        """Remembers a fit; returns the best one of its set."""
        key = frozenset(fit.names)
        if key not in self.fits or fit.cost < self.fits[key].cost:
            self.fits[key] = fit
        return self.fits[key]

    def singles(self):
        """Every effect by itself; sets the price of an effect."""
        self.seen, self.price = {}, np.inf
        if not self.fitter.effects:
            return self.base
        for name in self.fitter.effects:
            best, seen = self.fitter.scan(name, self.base)
            fit = self.keep(self.fitter.polish(best))
            self.seen[name] = [s.left - self.base.left for s in (*seen, fit)]
        directions = np.stack([g for group in self.seen.values() for g in group], 1)
        self.price = price(directions, self.seed)
        return self.best(1)

    def single(self, name):
        """The best fit of one effect."""
        return self.fits[frozenset([name])]

    def heat(self, fit):
        """Cost per degree of freedom, at least 1: what a misfit feigns is to be divided by."""
        return max(fit.cost / max(self.pieces.degrees, 1), 1.0)

    def worth(self, fit):
        """Cost with the price of its effects: a further parameter costs what it gains on noise.

        Cost beyond noise counts by its logarithm, as that of noise of unknown size does: beside a large misfit
        a small gain is nobody's (overdispersion; Burnham and Anderson 2002, 2.5). An effect that would have to be
        stronger than is possible, and leaves a misfit all the same, has to answer for part of that.
        """
        cost = fit.cost / self.heat(fit) * (1 + np.log(self.heat(fit)))
        if not fit.causes:
            return cost
        parameters = sum(len(c.params) - 1 for c in fit.causes)
        switches = sum(np.isfinite(s).sum() for c in fit.causes for s in c.segments)
        edges = sum(bool(self.fitter.held(c)) for c in fit.causes)
        cost += EDGE * edges * min(self.heat(fit) - 1, 1) * self.pieces.degrees
        return cost + self.price * len(fit.causes) + 2.0 * parameters + 0.5 * self.price * switches

    def best(self, count=None):
        """The best fit of `count` effects, or of all."""
        fits = [f for k, f in self.fits.items() if count is None or len(k) == count]
        return min(fits, key=self.worth, default=self.base)

    def pairs(self):
        """Pairs that explain the log together, by their linear parts; fits the likeliest in full."""
        G = np.stack([g for group in self.seen.values() for g in group], 1)
        size = np.linalg.norm(G, axis=0)
        ok = size > 1e-6
        names = [name for name, keep in zip((n for n in self.seen for _ in self.seen[n]), ok) if keep]
        G = G[:, ok] / size[ok]
        c, gram = -(G.T @ self.base.left), G.T @ G
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = (c[:, None] ** 2 + c[None] ** 2 - 2 * gram * np.outer(c, c)) / (1 - gram**2)
        gain[~(gram**2 < 0.999)] = 0
        order = []
        for i, j in zip(*np.unravel_index(np.argsort(-gain, axis=None)[:4000], gain.shape)):
            key = frozenset((names[i], names[j]))
            if len(key) == 2 and key not in order:
                order.append(key)
        for key in order[:PAIRS]:
            first = min(key, key=lambda name: self.single(name).cost)
            (second,) = key - {first}
            self.extend(self.single(first), [second])

    def extend(self, fit, names):
        """Fits `fit` with each of `names` on top; returns the best."""
        out = []
        for name in names:
            key = name, fit.causes
            if key not in self.added:
                self.added[key] = self.fitter.add(name, fit)
            out.append(self.keep(self.added[key]))
        return min(out, key=lambda f: f.cost) if out else None

    def likely(self, fit, count=REFINED):
        """Effects that promise most on top of `fit`, by their linear parts beside those of what it has."""
        J = self.fitter.jacobian(fit) if fit.causes else np.zeros((len(fit.left), 0))
        q = np.linalg.svd(J, full_matrices=False)[0] if J.size else J
        promise = {}
        for name, directions in self.seen.items():
            if name not in fit.names:
                D = np.stack(directions, 1)
                size = (D**2).sum(0) + 1e-9
                own = np.maximum(size - ((q.T @ D) ** 2).sum(0), 1e-3 * size)
                promise[name] = ((D.T @ fit.left) ** 2 / own).max()
        return sorted(promise, key=promise.get, reverse=True)[:count]

    def reduce(self, fit):
        """Takes out what does not pay."""
        while len(fit.causes) > 1:
            fewer = [self.drop(fit, name) for name in fit.names]
            best = min(fewer, key=self.worth)
            if self.worth(best) > self.worth(fit):
                break
            fit = best
        return fit

    def drop(self, fit, name):
        """The best fit without `name`."""
        key = frozenset(fit.names) - {name}
        if key not in self.fits:
            rest = tuple(c for c in fit.causes if c.name != name)
            self.keep(self.fitter.refine(self.fitter.fit_of(rest)))
        return self.fits[key]

    def swap(self, fit):
        """Tries others in the place of each effect; the rest stays as it is, lest it make up for what is gone."""
        for name in fit.names:
            rest = self.fitter.fit_of(tuple(c for c in fit.causes if c.name != name))
            others = [n for n in self.likely(rest, 2) if n not in fit.names]
            better = self.extend(rest, others)
            if better and self.worth(better) < self.worth(fit):
                return better
        return fit

    def run(self, seeds=(), most=MOST):
        """The explanation that is worth most; begins also from fits `seeds` found on other terms."""
        self.singles()
        for seed in seeds:
            self.keep(self.fitter.refine(self.fitter.fit_of(seed.causes), steps=3))
        fit = self.best()
        while fit.causes and len(fit.causes) < most:
            if len(fit.causes) == 1:
                self.pairs()
            self.extend(fit, self.likely(fit))
            better = self.swap(self.reduce(self.best()))
            if self.worth(better) >= self.worth(fit) - 1e-9:
                break
            fit = better
        return self.reduce(self.best())
