"""Causes, their sizes, and what they leave of a log."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..robot import Parameter

ALWAYS = ((-np.inf, np.inf),)
STEP = 1e-3  # of a parameter's usual size, by which slopes are taken
GUESS = 0.5  # the parameters of a curve are guessed at their usual values, give or take half
GRIDS = tuple(np.delete(np.geomspace(1 / reach, reach, 7), 3) for reach in (2.0, 1.19, 1.04, 1.01))  # of what has no slope
FINE, TELLS = 2, 1e-6  # of these, from which on the nearest two tell enough; squares, by which a size shows at all
NEAR = 1  # of these, with which a size begins that was found before
HELD = 1e-3  # of its usual size, to which a parameter counts as at its bound
SPREAD = 50  # rows of a block that counts as one observation
SLOPE = 1e-9  # squares, below which there is none


@dataclass(frozen=True)
class Effect:
    """starts: vectors of parameters that a scan begins with. linear: any combination of them scales what it does.

    family: of effects that look alike; form_of: the effect of which this is another form, by whose name it is reported.
    """

    name: str
    block: str
    parameters: tuple[Parameter, ...]
    starts: tuple
    linear: bool = False
    threshold: bool = False  # no slope tells its size
    curve: bool = False  # a log seldom settles its parameters one by one
    steady: bool = True  # half of it does about half of what it does
    formula: str = ""  # what it does, where no words say so
    transient: bool = field(default=False, kw_only=True)  # shows when it sets in, and hardly after
    family: str = field(default="", kw_only=True)  # none: its own
    form_of: str = field(default="", kw_only=True)  # none: of none

    @property
    def reported_as(self):
        return self.form_of or self.name

    @property
    def kin(self):
        return self.family or self.name

    @cached_property
    def scale(self):
        return np.array([abs(p.usual) or 1.0 for p in self.parameters])

    @cached_property
    def bounds(self):
        """(low, high) in usual sizes."""
        return np.array([p.low for p in self.parameters]) / self.scale, np.array([p.high for p in self.parameters]) / self.scale


@dataclass(frozen=True)
class Cause:
    """An effect with its parameters and the times when it acts, s from the first row."""

    name: str
    params: tuple
    segments: tuple = ALWAYS


@dataclass(frozen=True)
class Fit:
    """What causes leave, whitened; cost: its squares, and what guesses are worth."""

    causes: tuple
    cost: float
    left: np.ndarray = field(repr=False, compare=False)

    @property
    def names(self):
        return tuple(c.name for c in self.causes)

    def lacks(self, effects):
        """{name: Effect} of those that are in no form among the causes."""
        taken = {effects[name].reported_as for name in self.names}
        return {name: effect for name, effect in effects.items() if effect.reported_as not in taken}


class Fitter:
    """Fits causes to the steps of a path under a noise."""

    smooth = False  # whether squares have a slope to every size
    guessing = True  # whether curves are guessed to be as usual
    held_at = ()  # indices of sizes that stay as they are
    slopes_by = STEP  # by which slopes are taken

    def __init__(self, path, noise):
        self.path, self.noise, self.effects = path, noise, path.effects
        self.degrees = int(np.isfinite(path.present).sum())

    # ---- parameters as a vector, in usual sizes ----------------------------------------------------------

    def vector(self, causes):
        """(sizes, low, high, 1 where a curve's)."""
        parts = [(np.array(c.params) / self.effects[c.name].scale, *self.effects[c.name].bounds) for c in causes]
        curved = [np.full(len(c.params), float(self.effects[c.name].curve)) for c in causes]
        return tuple(np.concatenate([np.zeros(0), *column]) for column in (*zip(*parts), curved)) if causes else (np.zeros(0),) * 4

    def split(self, causes, z):
        out, i = [], 0
        for cause in causes:
            effect = self.effects[cause.name]
            part = np.clip(z[i : i + len(cause.params)], *effect.bounds) * effect.scale
            out.append(replace(cause, params=tuple(part.tolist())))
            i += len(cause.params)
        return tuple(out)

    def guesses(self, causes):
        """What it costs that curves are not as usual."""
        if not (self.guessing and any(self.effects[c.name].curve for c in causes)):
            return 0.0
        z, _, _, curved = self.vector(causes)
        return float((curved * (z - 1) ** 2).sum()) / GUESS**2

    def held(self, cause):
        """Names of the parameters that a bound keeps from going on; zero is no effect, not a bound."""
        z, low, high, _ = self.vector((cause,))
        at = (z != 0) & ((z - low < HELD) | (high - z < HELD))
        return [p.name for p, there in zip(self.effects[cause.name].parameters, at) if there]

    @property
    def rows(self):
        """Of the path, that residuals (n,) are of."""
        return np.repeat(np.arange(len(self.path.present)), self.path.present.shape[1])

    @property
    def block(self):
        """Residuals that count as one observation."""
        return SPREAD * self.path.present.shape[1]

    # ---- residuals -----------------------------------------------------------------------------------------

    def lefts(self, trials):
        """Whitened residuals (n, trials)."""
        return self.whiten(*self.path.steps(trials))

    def whiten(self, D, E):
        """What steps that end D (K, n, q) beside the path, and readings missed by E (K, c, q), make of the residual (n, q)."""
        return self.path.noises.whitened(self.path, self.noise, D, E).reshape(-1, D.shape[-1])

    def fit_of(self, causes):
        causes = tuple(causes)
        left = self.lefts([causes])[:, 0]
        return Fit(causes, float(left @ left) + self.guesses(causes), left)

    def jacobian(self, fit):
        """d left / d size (n, p)."""
        z, _, high, _ = self.vector(fit.causes)
        if not len(z):
            return np.zeros((len(fit.left), 0))
        steps = np.where(z + self.slopes_by <= high, self.slopes_by, -self.slopes_by)
        trials = [self.split(fit.causes, z + step * unit) for step, unit in zip(steps, np.eye(len(z)))]
        return (self.lefts(trials) - fit.left[:, None]) / steps

    # ---- fitting -------------------------------------------------------------------------------------------

    def refine(self, fit, steps=8):
        """Damped Gauss-Newton steps, then what has no slope, size by size."""
        first = [NEAR * (cause.params not in self.effects[cause.name].starts) for cause in fit.causes]
        if not fit.causes:
            return fit
        found = self._descend(fit, steps)
        return found if self.smooth else self._thresholds(found, first)

    def _descend(self, fit, steps):
        damping = 1e-3
        for _ in range(steps):
            before = fit.cost
            fit, damping = self._step(fit, damping)
            if before - fit.cost < max(1e-4 * before, 0.05):
                break
        return fit

    def _step(self, fit, damping):
        J = self.jacobian(fit)
        z, low, high, curved = self.vector(fit.causes)
        guess = self.guessing * curved / GUESS**2
        gram, slope = J.T @ J + np.diag(guess), J.T @ fit.left + guess * (z - 1)
        free = ~(((z <= low) & (slope > 0)) | ((z >= high) & (slope < 0)) | (np.diag(gram) < SLOPE))
        free[list(self.held_at)] = False
        for _ in range(4 if free.any() else 0):
            move, A = np.zeros_like(z), gram[np.ix_(free, free)]
            move[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), slope[free])
            limit = np.maximum(1.0, np.abs(z))
            trial = self.fit_of(self.split(fit.causes, z + np.clip(move, -limit, limit)))
            if trial.cost < fit.cost:
                return trial, damping / 5
            damping = max(damping * 8, 1e-2)
        return fit, damping

    def _thresholds(self, fit, first):
        """What has no slope, each cause by grids from the first of its own on."""
        for i, cause in enumerate(fit.causes):
            if self.effects[cause.name].threshold:
                for k in range(len(cause.params)):
                    fit = self._best_of(fit, self._begun(fit.causes, i, k))
                at = sum(len(c.params) for c in fit.causes[:i])
                for grid in range(first[i], len(GRIDS)):
                    for k in set(range(len(cause.params))) - {held - at for held in self.held_at}:
                        fit = self._along(fit, i, k, grid)
        return fit

    def _along(self, fit, i, k, grid):
        """The best of a grid for one size; of a fine one its two nearest alone, where both are worse: then it lies between these."""
        tried = self._scaled(fit.causes, i, k, GRIDS[grid])
        if grid < FINE:
            return self._best_of(fit, tried)
        near, far = tried[2:4], tried[:2] + tried[4:]
        lefts, costs = self._costs(near)
        if (costs > fit.cost + TELLS).all():
            return fit
        j = int(costs.argmin())
        best = Fit(near[j], float(costs[j]), lefts[:, j]) if costs[j] < fit.cost - 1e-9 else fit
        return self._best_of(best, far)

    def _begun(self, causes, i, k):
        """Causes with parameter k of cause i at each size that a scan begins with, if it is off."""
        cause = causes[i]
        sizes = {start[k] for start in self.effects[cause.name].starts} - {0.0} if cause.params[k] == 0 else ()
        return [(*causes[:i], replace(cause, params=(*cause.params[:k], v, *cause.params[k + 1 :])), *causes[i + 1 :]) for v in sizes]

    def _scaled(self, causes, i, k, factors):
        """Causes with parameter k of cause i times each of `factors`."""
        cause, p = causes[i], self.effects[causes[i].name].parameters[k]
        values = [float(np.clip(cause.params[k] * f, p.low, p.high)) for f in factors]
        return [(*causes[:i], replace(cause, params=(*cause.params[:k], v, *cause.params[k + 1 :])), *causes[i + 1 :]) for v in values]

    def _costs(self, trials):
        """(whitened residuals (n, trials), costs (trials,))."""
        lefts = self.lefts(trials)
        return lefts, (lefts**2).sum(0) + [self.guesses(t) for t in trials]

    def _best_of(self, fit, trials):
        trials = [t for t in trials if t != fit.causes]
        if not trials:
            return fit
        lefts, costs = self._costs(trials)
        j = int(costs.argmin())
        return Fit(trials[j], float(costs[j]), lefts[:, j]) if costs[j] < fit.cost - 1e-9 else fit
