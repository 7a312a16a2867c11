"""Which effects: ranked by columns that cost no pass, the few that matter fitted by simulation, taken in one by one."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import stats

from .problem import LIMIT, Cause, Fit

MOST = 4  # effects of one explanation
SINGLES, PAIRS = 4, 2  # that are simulated in each round
FITTED = 2  # of these, the best, that are fitted in full
PASSES, ITERATIONS = 4, 8  # of a fit; by the slopes in each of them
BUDGET = 100  # passes, after which no further effect is looked for: to prove those found takes as many again, at most
TRUE_STEP = 1e-2  # of a parameter's usual size, by which columns are differentiated
WALD = 4.0  # robust t that an effect has to reach
# Sizes tried of what has no slope, over the one before.
GRIDS = tuple(np.geomspace(1 / reach, reach, 9) for reach in (2.0, 1.2, 1.04, 1.01))
DOUBTED = 2  # causes, or groups, of which it is simulated whether less does as well
ABSORBED = 0.8  # of what several effects do, from which on one is tried in their place
SMALL = 0.01  # of the misfit, or of the noise: what an effect takes away beyond its price matters only if it is more
OFFSETS = np.geomspace(1e-5, 0.4, 140)
PROFILE = np.concatenate([1 - OFFSETS[::-1], [1.0], 1 + OFFSETS])  # of a size, by which its interval is looked for: fine near it
ALIKE = 0.98  # cosine of columns that are one class


@dataclass(frozen=True)
class Candidate:
    name: str
    params: tuple
    column: np.ndarray


class Near:
    """What causes leave whose sizes are near those of a fit: by the slopes, so at no pass.

    bend: (what the slopes had told wrong of a pass, along which step of the sizes), as in Broyden, "A class of methods for solving
    nonlinear simultaneous equations", Mathematics of Computation 19, 1965.
    """

    def __init__(self, finder, fit, bend=None):
        self.finder, self.fit, self.bend = finder, fit, bend
        self.offset = fit.left + finder.problem.columns([fit.causes])[:, 0]
        self.z = finder.vector(fit.causes)[0]

    def left(self, trials):
        """(n, trials), whitened."""
        out = self.offset[:, None] - self.finder.problem.columns(trials)
        if self.bend is not None:
            wrong, step = self.bend
            out += np.outer(wrong, [step @ (self.finder.vector(causes)[0] - self.z) for causes in trials]) / (step @ step)
        return out

    def jacobian(self, causes):
        J = self.finder.jacobian(Fit(causes, np.nan, self.offset))
        if self.bend is not None:
            wrong, step = self.bend
            J = J + np.outer(wrong, step) / (step @ step)
        return J

    def bend_to(self, trial):
        """The bend that a pass shows."""
        return trial.left - self.left([trial.causes])[:, 0], self.finder.vector(trial.causes)[0] - self.z


class Finder:
    def __init__(self, problem):
        self.problem = problem
        self.price = np.log(problem.degrees) + 2 * np.log(max(len(problem.effects), 2))
        self.base = problem.fit_of(())
        self.heat = 1.0

    # ---- candidates --------------------------------------------------------------------------------------

    def candidates(self, fit):
        """Every effect that is not in `fit`, at its first sizes, as columns beside it."""
        problem, trials, about = self.problem, [], []
        for name, effect in problem.effects.items():
            if name in fit.names:
                continue
            for size in effect.begins:
                params = tuple(float(np.clip(size * p.usual, p.low, p.high)) for p in effect.parameters)
                trials.append((*fit.causes, Cause(name, params)))
                about.append((name, params))
        columns = problem.columns(trials) if trials else np.zeros((len(fit.left), 0))
        beside = problem.columns([fit.causes])[:, :1]
        return [Candidate(name, params, column) for (name, params), column in zip(about, (columns - beside).T)]

    def ranked(self, fit, found):
        """Singles and pairs of candidates by what their columns explain of what `fit` leaves."""
        J = self.jacobian(fit)
        Q = np.linalg.svd(J, full_matrices=False)[0] if J.shape[1] else np.zeros((len(fit.left), 0))
        free = lambda c: c - Q @ (Q.T @ c)  # noqa: E731
        left, columns = free(fit.left), np.stack([free(c.column) for c in found], 1)
        size = np.linalg.norm(columns, axis=0)
        shows = size > 1.0
        unit = columns / np.maximum(size, 1e-12)
        along = unit.T @ left
        allowed = np.array([self._wanted(c, a / max(s, 1e-12)) for c, a, s in zip(found, along, size)]) & shows
        gain = np.where(allowed, along**2, 0.0)
        best = {}
        for i in np.argsort(-gain):
            if gain[i] > 0 and found[i].name not in best:
                best[found[i].name] = i
        order = sorted(best.values(), key=lambda i: -gain[i])
        singles = [(found[i],) for i in order[:SINGLES]]
        gram, pairs = unit.T @ unit, []
        for i, j in combinations(order[:24], 2):
            g = gram[i, j]
            if g * g < 0.99:
                both = (along[i] ** 2 + along[j] ** 2 - 2 * g * along[i] * along[j]) / (1 - g * g)
                pairs.append((both, (found[i], found[j])))
        pairs = [pair for both, pair in sorted(pairs, key=lambda p: -p[0])[:PAIRS] if both > max(gain) + self.price]
        return [*singles, *pairs]

    def _wanted(self, candidate, size):
        """Whether the column helps with a sign that its parameter may have."""
        low = self.problem.effects[candidate.name].parameters[0].low
        return size > 0 or low < 0

    # ---- fitting -------------------------------------------------------------------------------------------

    def jacobian(self, fit):
        """d left / d parameter (n, p), in usual sizes, by the slopes."""
        problem, trials, sizes = self.problem, [], []
        for i, cause in enumerate(fit.causes):
            for k, p in enumerate(problem.effects[cause.name].parameters):
                h = TRUE_STEP * abs(p.usual)
                h = -h if cause.params[k] + h > p.high else h
                params = (*cause.params[:k], cause.params[k] + h, *cause.params[k + 1 :])
                trials.append((*fit.causes[:i], replace(cause, params=params), *fit.causes[i + 1 :]))
                sizes.append(h / abs(p.usual))
        if not trials:
            return np.zeros((len(fit.left), 0))
        columns = problem.columns([fit.causes, *trials])
        return -(columns[:, 1:] - columns[:, :1]) / np.array(sizes)

    def vector(self, causes):
        spec = [p for c in causes for p in self.problem.effects[c.name].parameters]
        z = np.array([v for c in causes for v in c.params]) / [abs(p.usual) for p in spec]
        low, high = (np.array([getattr(p, end) / abs(p.usual) for p in spec]) for end in ("low", "high"))
        return z, low, high

    def split(self, causes, z):
        out, i = [], 0
        for cause in causes:
            spec = self.problem.effects[cause.name].parameters
            params = tuple(float(np.clip(v * abs(p.usual), p.low, p.high)) for v, p in zip(z[i : i + len(spec)], spec))
            out.append(replace(cause, params=params))
            i += len(spec)
        return tuple(out)

    def refine(self, fit, passes=PASSES):
        """The sizes that are best by the slopes, then one pass that says what they really leave; again while that helps."""
        bend = None
        for _ in range(passes):
            if not fit.causes or not np.isfinite(fit.cost):
                break
            near = Near(self, fit, bend)
            causes, hoped = self.best_by_slopes(near)
            if fit.cost - hoped < max(0.3, 1e-4 * fit.cost):
                break
            trial = self.problem.fit_of(causes)
            if not np.isfinite(trial.cost):
                break
            gained, bend = fit.cost - trial.cost, near.bend_to(trial)
            fit = trial if gained > 0 else fit
            if 0 <= gained < max(0.3, 1e-4 * fit.cost):
                break
        return fit

    def best_by_slopes(self, near):
        """(causes, cost) with the sizes of least cost about a fit: no pass."""
        causes, cost, damping = near.fit.causes, near.fit.cost, 1e-3
        for _ in range(ITERATIONS):
            causes, after, damping = self._step(near, *self._thresholds(near, causes, cost), damping)
            if after > cost - max(0.1, 1e-4 * cost):
                break
            cost = after
        return causes, min(cost, after)

    def _step(self, near, causes, cost, damping):
        """One damped Gauss-Newton step of all sizes by the slopes."""
        left, (z, low, high) = near.left([causes])[:, 0], self.vector(causes)
        J = near.jacobian(causes)
        gram, slope = J.T @ J, J.T @ left
        free = ~(((z <= low) & (slope > 0)) | ((z >= high) & (slope < 0)) | (np.diag(gram) < 1e-9))
        for _ in range(4 if free.any() else 0):
            move = np.zeros_like(z)
            A = gram[np.ix_(free, free)]
            move[free] = -np.linalg.solve(A + damping * np.diag(np.diag(A)), slope[free])
            limit = np.maximum(1.0, np.abs(z))
            trial = self.split(causes, z + np.clip(move, -limit, limit))
            after = float((near.left([trial]) ** 2).sum())
            if after < cost:
                return trial, after, damping / 5
            damping = max(damping * 30, 1e-2)
        return causes, cost, damping

    def _thresholds(self, near, causes, cost):
        """Sizes that no slope tells, one by one at the best of many, coarse to fine."""
        for i, cause in enumerate(causes):
            if self.problem.effects[cause.name].threshold:
                (p,) = self.problem.effects[cause.name].parameters
                for grid in GRIDS:
                    sizes = np.clip(causes[i].params[0] * grid, p.low, p.high)
                    trials = [(*causes[:i], Cause(cause.name, (float(v),)), *causes[i + 1 :]) for v in sizes]
                    costs = (near.left(trials) ** 2).sum(0)
                    if costs.min() < cost:
                        causes, cost = trials[int(costs.argmin())], float(costs.min())
        return causes, cost

    def add(self, fit, group):
        """`fit` with the candidates of a group, each first at the best of the sizes seen, at sizes that are best by the slopes."""
        causes = (*fit.causes, *(Cause(c.name, self._first(fit, c)) for c in group))
        left = fit.left - (self.problem.columns([causes]) - self.problem.columns([fit.causes]))[:, 0]
        causes, _ = self.best_by_slopes(Near(self, Fit(causes, float(left @ left), left)))
        return self.problem.fit_of(causes)

    def _first(self, fit, candidate):
        """Parameters scaled by how much of the column the residual holds, where the effect is linear in them."""
        effect = self.problem.effects[candidate.name]
        if len(effect.begins) > 1 or len(effect.parameters) > 1:
            return candidate.params
        scale = float(candidate.column @ fit.left) / max(float(candidate.column @ candidate.column), 1e-12)
        return tuple(float(np.clip(v * scale, p.low, p.high)) for v, p in zip(candidate.params, effect.parameters))

    # ---- what pays -------------------------------------------------------------------------------------------

    def worth(self, fit):
        """Cost over the noise, with a price for each effect."""
        return fit.cost / self.heat + self.price * len(fit.causes)

    def wald(self, fit):
        """Robust t (p,) of each parameter: windows count as one observation each."""
        J = self.jacobian(fit)
        W = len(self.problem.rollouts.starts)
        by_window = (J * fit.left[:, None]).reshape(W, -1, J.shape[1]).sum(1)
        inverse = np.linalg.pinv(J.T @ J, rcond=1e-10)
        spread = inverse @ (by_window.T @ by_window) @ inverse
        return self.vector(fit.causes)[0] / np.sqrt(np.maximum(np.maximum(np.diag(spread), np.diag(inverse) * self.heat), 1e-300))

    def interval(self, fit, i):
        """95 % interval (low, high) of cause i, of which no slope tells the size: where its cost is near the least."""
        cause, problem = fit.causes[i], self.problem
        (p,) = problem.effects[cause.name].parameters
        sizes = np.clip(cause.params[0] * PROFILE, p.low, p.high)
        trials = [(*fit.causes[:i], Cause(cause.name, (float(v),)), *fit.causes[i + 1 :]) for v in sizes]
        good = (Near(self, fit).left(trials) ** 2).sum(0) < fit.cost + stats.chi2.ppf(0.95, 1) * self.heat
        return float(sizes[good].min()), float(sizes[good].max())

    def centred(self, fit):
        """`fit` with each size that no slope tells in the middle of where it may be: a log tells a dead band between two commands."""
        causes = list(fit.causes)
        for i, cause in enumerate(fit.causes):
            if self.problem.effects[cause.name].threshold:
                causes[i] = replace(cause, params=(sum(self.interval(fit, i)) / 2,))
        return self.problem.fit_of(causes) if tuple(causes) != fit.causes else fit

    # ---- the search ------------------------------------------------------------------------------------------

    def learn_noise(self, fit):
        """Noise that all columns together cannot explain. Costs are others then."""
        problem = self.problem
        columns = [self.jacobian(fit), np.stack([c.column for c in self.candidates(fit)], 1), problem.whiten(problem.generic())]
        problem.learn_noise(fit.left, np.concatenate(columns, 1))
        return problem.whitened(fit.causes, fit.missed)

    def settle(self, fit):
        """Step of time and noise anew about `fit`; slopes, too, where they do not foretell it."""
        problem = self.problem
        (problem.follow if problem.foretells(fit) else problem.linearise)(fit.causes)
        fit = self.learn_noise(problem.fit_of(fit.causes))
        if np.linalg.norm(problem.whiten(problem.shift)) > 1:
            fit = self._time_step(fit)
        problem.Y = problem.rollouts.sense(problem.X, problem.at) + problem.finer * problem.shift
        return self.refine(self.learn_noise(fit), 3)

    def _time_step(self, fit):
        """`fit` with the share of a shorter step of time that costs least: none, all that it can be, or what the slopes say."""
        problem, was = self.problem, self.problem.finer
        columns = np.concatenate([-problem.whiten(problem.shift)[:, None], self.jacobian(fit)], 1)
        share = was - np.linalg.lstsq(columns, fit.left, rcond=1e-9)[0][0]
        found = {was: fit}
        for finer in {0.0, float(np.clip(share, 0.0, LIMIT)), LIMIT} - {was}:
            problem.finer = finer
            found[finer] = self.refine(problem.fit_of(fit.causes), 1)
        problem.finer = min(found, key=lambda finer: found[finer].cost + self.price * (finer > 0))
        return found[problem.finer]

    def run(self):
        """The causes that are worth most."""
        fit = self.base = self.settle(self.base)
        seen = {frozenset()}
        while len(fit.causes) < MOST and self.problem.log.passes < BUDGET:
            better = self.widen(fit)
            if self.worth(better) >= self.worth(fit):
                break
            new = self.eliminate(self.settle(better))
            if frozenset(new.names) in seen or self.worth(new) >= self.worth(self.problem.fit_of(fit.causes)):
                fit = self.settle(fit)
                break
            fit = new
            seen.add(frozenset(fit.names))
        return self.simplify(self.eliminate(fit))

    def widen(self, fit):
        """The best fit with one or two causes more."""
        fits = sorted((self.add(fit, group) for group in self.ranked(fit, self.candidates(fit))), key=self.worth)
        return min((self.refine(f) for f in fits[:FITTED]), key=self.worth, default=fit)

    def simplify(self, fit):
        """One effect in the place of several, where it does what they do."""
        found = sorted(self._stand_ins(fit), key=lambda found: -found[0])
        for _, rest, candidate in found[:DOUBTED]:
            trial = self.refine(self.add(self.problem.fit_of(rest), (candidate,)))
            if self.worth(trial) < self.worth(fit):
                return self.simplify(self.settle(trial))
        return fit

    def _stand_ins(self, fit):
        """(share of what several causes do that it does, the causes that are left, candidate): by the slopes."""
        for count in range(len(fit.causes), 1, -1):
            for group in combinations(range(len(fit.causes)), count):
                rest = tuple(c for i, c in enumerate(fit.causes) if i not in group)
                have = self.problem.columns([fit.causes, rest]) @ [1.0, -1.0]
                for c in self.candidates(Fit(rest, np.nan, fit.left)):
                    share = (c.column @ have) ** 2 / max(c.column @ c.column, 1e-9) / (have @ have)
                    if share > ABSORBED and c.name not in fit.names:
                        yield share, rest, c

    def _weakest_first(self, fit):
        """Indices of causes, by what each does that the others cannot do, by the slopes."""
        J, alone = self.jacobian(fit), []
        ends = np.cumsum([0, *(len(c.params) for c in fit.causes)])
        for i in range(len(fit.causes)):
            does = self.problem.columns([fit.causes, fit.causes[:i] + fit.causes[i + 1 :]]) @ [1.0, -1.0]
            others = np.delete(J, np.r_[ends[i] : ends[i + 1]], 1)
            rest = does - others @ np.linalg.lstsq(others, does, rcond=1e-9)[0]
            alone.append(rest @ rest)
        return np.argsort(alone)

    def eliminate(self, fit):
        """Takes out what does not pay, or what only a few windows ask for."""
        while fit.causes:
            weak = np.flatnonzero(np.abs(self.wald(fit)) < WALD) if all(len(c.params) == 1 for c in fit.causes) else []
            weak = [i for i in weak if not self.problem.effects[fit.causes[i].name].threshold]
            if len(weak):
                fit = self.refine(self.problem.fit_of(fit.causes[: weak[0]] + fit.causes[weak[0] + 1 :]), 3)
                continue
            rests = [self.refine(self.problem.fit_of(fit.causes[:i] + fit.causes[i + 1 :]), 2) for i in self._weakest_first(fit)[:DOUBTED]]
            best = min(rests, key=self.worth)
            if best.cost - fit.cost > max(self.price, SMALL * self.problem.degrees, SMALL * (self.base.cost - self.problem.degrees)):
                break
            fit = best
        return fit
