"""Effects with parameters, fitted to the pieces of a log.

Parameters are counted in their usual values. A scan finds where to begin, since thresholds have no
gradient at zero; damped Gauss-Newton steps and, for what has no gradient at all, a pattern search follow.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ...bridge import Effect

RAY = (0.12, 0.3, 0.6, 1.0, 1.6, 3.0, 6.0)  # all parameters of an effect together
COORDINATE = (0.0, 0.25, 0.5, 0.75, 1.4, 2.0, 4.0)  # then each by itself,
FINE = (0.15, 0.2, 0.3, 0.35, 0.4, 0.6, 0.9, 1.15, 2.8)  # and these too where there are few
PATTERN = (0.5, 0.2, 0.08, 0.03, 0.01)
ALWAYS = ((-np.inf, np.inf),)
HELD = 1e-3  # of its usual value, to which a parameter counts as at its bound
GUESS = 0.5  # the parameters of a curve are guessed at their usual values, give or take half


@dataclass(frozen=True)
class Cause:
    """An effect with its parameters and the times when it acts, s from the first row."""

    name: str
    params: tuple
    segments: tuple = ALWAYS

    def active(self):
        """As the simulator takes it."""
        return [Effect(self.name, self.params, max(t0, 0.0), t1) for t0, t1 in self.segments]


@dataclass(frozen=True)
class Fit:
    """Causes that explain a log as well as they can; cost is the sum of squares of what is left, whitened."""

    causes: tuple
    cost: float
    left: np.ndarray = field(repr=False, compare=False)  # (n) whitened

    @property
    def names(self):
        return tuple(cause.name for cause in self.causes)


def active(causes):
    """All causes as the simulator takes them."""
    return [effect for cause in causes for effect in cause.active()]


@lru_cache(maxsize=256)
def _rays(usual, low, high):
    """Vectors along `usual` and, if it may be, against it; what the bounds make the same is there once."""
    signs = (1, -1) if min(low) < 0 else (1,)
    inside = (np.clip(sign * r * np.array(usual), low, high) for sign in signs for r in RAY)
    return [np.array(z) for z in dict.fromkeys(map(tuple, inside))]


class Fitter:
    """Fits causes, parameters of effects, to pieces. without: effects that it may not use."""

    def __init__(self, pieces, without=()):
        self.pieces = pieces
        self.effects = {name: spec for name, spec in pieces.platform.effects().items() if name not in without}
        self._scale, self._bounds = {}, {}
        for name, (_, spec) in self.effects.items():
            scale = np.array([abs(p.usual) or 1.0 for p in spec])
            self._scale[name] = scale
            self._bounds[name] = np.array([p.low for p in spec]) / scale, np.array([p.high for p in spec]) / scale

    def left(self, causes):
        """Whitened residual (n)."""
        return self.pieces.whiten(self.pieces.residual(active(causes))).ravel()

    def fit_of(self, causes):
        """The Fit at the given parameters."""
        left = self.left(causes)
        return Fit(tuple(causes), float(left @ left), left)

    # ---- parameters as a vector, in usual values ------------------------------

    def scale(self, cause):
        """Usual size of each parameter."""
        return self._scale[cause.name]

    def bounds(self, cause):
        """Lowest and highest, in usual values."""
        return self._bounds[cause.name]

    def held(self, cause):
        """Names of the parameters that a bound keeps from going on; zero is no effect, not a bound."""
        z, (low, high) = self.vector((cause,)), self.bounds(cause)
        at = (z != 0) & ((z - low < HELD) | (high - z < HELD))
        return [p.name for p, there in zip(self.effects[cause.name][1], at) if there]

    def at(self, cause, z):
        """The cause with parameters z, in usual values, brought inside the bounds."""
        low, high = self.bounds(cause)
        params = np.minimum(np.maximum(z, low), high) * self.scale(cause)
        return Cause(cause.name, tuple(params.tolist()), cause.segments)

    def vector(self, causes):
        """Parameters of all causes, in usual values."""
        return np.concatenate([np.array(c.params) / self.scale(c) for c in causes])

    def split(self, causes, z):
        """Causes with the parameters of one vector."""
        out, i = [], 0
        for cause in causes:
            out.append(self.at(cause, z[i : i + len(cause.params)]))
            i += len(cause.params)
        return tuple(out)

    def jacobian(self, fit, step=1e-3):
        """d left / d parameter, in usual values, (n, p); inwards at bounds."""
        z = self.vector(fit.causes)
        high = np.concatenate([self.bounds(c)[1] for c in fit.causes])
        J = np.empty((len(fit.left), len(z)))
        for i in range(len(z)):
            h = step if z[i] + step <= high[i] else -step
            moved = z.copy()
            moved[i] += h
            J[:, i] = (self.left(self.split(fit.causes, moved)) - fit.left) / h
        return J

    def curved(self, cause):
        """Whether its parameters are those of a curve, which a log seldom settles one by one."""
        return cause.name in self.pieces.platform.curves

    def guess(self, causes):
        """Weights (p) of the guess that a parameter of a curve has its usual value: cost per square, in usual values."""
        curved = [np.full(len(c.params), float(self.curved(c))) for c in causes]
        return np.concatenate(curved) / GUESS**2

    def objective(self, fit):
        """What refine() makes small: the cost and what the guesses are worth."""
        curves = [c for c in fit.causes if self.curved(c)]
        return fit.cost + (float(((self.vector(curves) - 1) ** 2).sum()) / GUESS**2 if curves else 0.0)

    # ---- fitting ---------------------------------------------------------------

    def refine(self, fit, steps=8):
        """Damped Gauss-Newton from where `fit` is, then a pattern search for what has no gradient."""
        return self.pattern(*self.descend(fit, steps)) if fit.causes else fit

    def descend(self, fit, steps):
        """(fit after damped Gauss-Newton steps, indices of parameters without a gradient)."""
        damping, rough = 1e-3, np.zeros(len(self.vector(fit.causes)), bool)
        low = np.concatenate([self.bounds(c)[0] for c in fit.causes])
        high = np.concatenate([self.bounds(c)[1] for c in fit.causes])
        for _ in range(steps):
            J = self.jacobian(fit)
            z, guess = self.vector(fit.causes), self.guess(fit.causes)
            gram, slope = J.T @ J + np.diag(guess), J.T @ fit.left + guess * (z - 1)
            rough |= (J**2).sum(0) < 1e-9
            held = ((z <= low) & (slope > 0)) | ((z >= high) & (slope < 0)) | (np.diag(gram) < 1e-9)
            free = ~held
            if not free.any():
                break
            before = self.objective(fit)
            for _ in range(4):
                A = gram[np.ix_(free, free)]
                move = np.zeros_like(z)
                move[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), slope[free])
                move = np.clip(move, -np.maximum(1.0, np.abs(z)), np.maximum(1.0, np.abs(z)))
                trial = self.fit_of(self.split(fit.causes, z + move))
                if self.objective(trial) < before:
                    fit, damping = trial, damping / 5
                    break
                damping *= 8
            else:  # a kink: no step along the slope helps, though there is one
                rough |= np.abs(slope * move) > 1
            if before - self.objective(fit) < max(1e-4 * before, 0.02):
                break
        return fit, np.flatnonzero(rough)

    def pattern(self, fit, which, sizes=PATTERN):
        """Tries each parameter of `which` a little larger and smaller, in ever smaller steps."""
        for size in sizes:
            for i in which:
                for factor in (1 + size, 1 / (1 + size)):
                    moved = self.vector(fit.causes)
                    moved[i] = moved[i] * factor
                    causes = self.split(fit.causes, moved)
                    if causes == fit.causes:  # at zero, or at a bound
                        continue
                    trial = self.fit_of(causes)
                    if self.objective(trial) < self.objective(fit) - 1e-9:
                        fit = trial
        return fit

    def restart(self, fit):
        """Begins curves again at their usual values: they have more than one hollow."""
        for i, cause in enumerate(fit.causes):
            if self.curved(cause):
                usual = self.at(cause, np.ones(len(cause.params)))
                trial = self.refine(self.fit_of((*fit.causes[:i], usual, *fit.causes[i + 1 :])), steps=15)
                fit = min(fit, trial, key=self.objective)
        return fit

    def rays(self, name):
        """The effect with nothing set, and the vectors to begin a scan with, in usual values."""
        spec = self.effects[name][1]
        cause = Cause(name, (0.0,) * len(spec))
        return cause, _rays(tuple(np.sign(p.usual) or 1.0 for p in spec), *map(tuple, self.bounds(cause)))

    def scan(self, name, base, segments=ALWAYS):
        """The best of the rays of one effect on top of `base`, not refined; and all fits seen."""
        cause, starts = self.rays(name)
        cause = replace(cause, segments=segments)
        seen = [self.fit_of((*base.causes, self.at(cause, z))) for z in starts]
        return min(seen, key=lambda fit: fit.cost), seen

    def coordinates(self, fit, index=-1):
        """Scans every parameter of one cause by itself."""
        if len(fit.causes[index].params) == 1:
            return fit
        low, _ = self.bounds(fit.causes[index])
        scale = self.scale(fit.causes[index])
        factors = COORDINATE if self.curved(fit.causes[index]) else (*COORDINATE, *FINE)
        seen = {fit.causes[index].params}
        for i in range(len(scale)):
            at = fit.causes[index].params[i] / scale[i] or 1.0
            for factor in (*factors, *((-1.0,) if low[i] < 0 else ())):
                z = self.vector((fit.causes[index],))
                z[i] = at * factor
                causes = list(fit.causes)
                causes[index] = self.at(causes[index], z)
                if causes[index].params in seen:  # bounds make many the same
                    continue
                seen.add(causes[index].params)
                trial = self.fit_of(causes)
                if trial.cost < fit.cost:
                    fit = trial
        return fit

    def awake(self, fit):
        """Scans causes with a parameter at zero: a threshold that is off has no slope to come back by."""
        for i, cause in enumerate(fit.causes):
            if 0.0 in cause.params:
                fit = self.coordinates(fit, i)
        return fit

    def add(self, name, base, segments=ALWAYS):
        """The best fit of `base` and one more effect."""
        return self.polish(self.scan(name, base, segments)[0])

    def polish(self, fit):
        """A fit from a scan with its last effect fitted in full."""
        return self.refine(self.coordinates(fit))
