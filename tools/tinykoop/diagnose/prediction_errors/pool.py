"""Several logs of one robot: which effects they share in size, which have a size per group of logs, and which act in some groups only.

Every log has its own path and noise. Causes know in which logs they act, so that one fit has sizes that all logs share and sizes that
some do not.
"""

from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from .. import elsewhere
from . import simpler
from .candidates import candidates
from .fit import ALWAYS, Cause, Fit, Fitter
from .noise import ROUNDS
from .states import State, States

KEPT = 6.4e7  # bytes of residuals of one log that are not worked out again
FULLY = 4  # sets of effects that are simplified
LIKELY = 2  # effects of all, that are tried instead of one or beside all
TRIED = 3  # simpler sets that are fitted in full
GRID = np.linspace(0, 1, 5)  # from the smallest of several thresholds to the largest
FEW = 3  # steps, that compare sets of effects: what has no slope stays as it is
NOTHING = 1e-9  # of what is told of a size: what is less is round-off
TURNS = 2  # of sizes and noise


@dataclass(frozen=True)
class Shared(Cause):
    """A cause with one size for the logs of these numbers."""

    logs: tuple = ()

    @property
    def alone(self):
        """As a log by itself has it."""
        return Cause(self.name, self.params, self.segments)


class Paths:
    """The paths of several logs, as far as they are asked for together; what is not here is the same of all."""

    def __init__(self, paths):
        self.paths, self.changes = paths, 0
        self.t, self.present = (np.concatenate([getattr(path, name) for path in paths]) for name in ("t", "present"))
        common = [name for name in paths[0].effects if all(name in path.effects for path in paths)]
        self.effects = {name: _widest([path.effects[name] for path in paths]) for name in common}
        self.steady = all(path.steady for path in paths)
        self.seconds = [elsewhere.seconds(path.log) for path in paths]

    def __getattr__(self, name):
        return getattr(self.paths[0], name)

    def of(self, causes, k):
        """Causes as they act in log k. A loss is as fast as in the first log that has it."""
        mine = [c for c in causes if k in c.logs]
        spec = [self.effects[c.name].parameters for c in mine]
        return tuple(elsewhere.as_fast(c.alone, p, self.seconds[c.logs[0]], self.seconds[k]) for c, p in zip(mine, spec))

    def about(self, causes):
        moved = [path.about(self.of(causes, k)) for k, path in enumerate(self.paths)]
        self.changes += any(moved)
        return any(moved)

    def bends(self, causes):
        return any(path.bends(self.of(causes, k)) for k, path in enumerate(self.paths))


def _widest(effects):
    """One effect for all logs: limits of a parameter may be those of what a log shows."""
    spec = [replace(p[0], low=min(q.low for q in p), high=max(q.high for q in p)) for p in zip(*(e.parameters for e in effects))]
    return replace(effects[0], parameters=tuple(spec), starts=tuple(dict.fromkeys(s for e in effects for s in e.starts)))


class PooledFitter(Fitter):
    """Fits Shared causes to several logs, each by its own Fitter: residuals are one log's behind the other's."""

    def __init__(self, fitters):
        self.fitters, self.path = fitters, Paths([fitter.path for fitter in fitters])
        self.noise, self.effects = tuple(fitter.noise for fitter in fitters), self.path.effects
        self.degrees = sum(fitter.degrees for fitter in fitters)
        self._kept, self._of = [{} for _ in fitters], None

    def refine(self, fit, steps=8):
        return super().refine(fit, steps) if steps > FEW else self._descend(fit, steps)

    def lefts(self, trials):
        if self._of != self.path.changes:
            self._kept, self._of = [{} for _ in self.fitters], self.path.changes
        return np.concatenate([self._lefts(k, [self.path.of(causes, k) for causes in trials]) for k in range(len(self.fitters))])

    def _lefts(self, k, trials):
        """Of log k; most trials change another one's causes."""
        kept, fresh = self._kept[k], [causes for causes in dict.fromkeys(trials) if causes not in self._kept[k]]
        found = dict(zip(fresh, self.fitters[k].lefts(fresh).T)) if fresh else {}
        left = np.stack([found[causes] if causes in found else kept[causes] for causes in trials], 1)
        if len(kept) * left.shape[0] * left.itemsize > KEPT:
            kept.clear()
        kept.update(found)
        return left


class Pool(States):
    """The states of several logs. Their noise is a tuple, one of each log; variant and motion are common.

    logs: [States]; groups: [numbers of the logs of a group]; known: [(Cause, ..)] of each log by itself.
    """

    def __init__(self, logs, groups, known):
        self.logs, self.groups = logs, [tuple(group) for group in groups]
        fitter = PooledFitter([log.fitter for log in logs])
        super().__init__(fitter.path, fitter)
        self.known = [[c for c in causes if c.name in self.path.effects] for causes in known]
        self.timed = tuple(
            Shared(c.name, c.params, c.segments, (k,)) for k, some in enumerate(self.known) for c in some if c.segments != ALWAYS
        )

    # ---- what States asks --------------------------------------------------------------------------------

    def costs(self, causes):
        """An effect is chosen once: in further groups it costs its sizes."""
        return super().costs(causes) - (self.price - self.digit) * (len(causes) - len({c.name for c in causes}))

    def at(self, state):
        before = self.fitter.noise, self.path.variant, self.path.motion
        self.path.about(state.causes)
        for k, log in enumerate(self.logs):
            log.at(replace(state, noise=state.noise[k], fit=replace(state.fit, causes=self.path.of(state.causes, k))))
        self.fitter.noise = state.noise
        self.path.changes += any(a is not b for a, b in zip(before, (state.noise, state.variant, state.motion)))
        return self.fitter

    def split(self, state):
        """[State] of each log."""
        rows = np.cumsum([len(log.fitter.path.present) for log in self.logs])[:-1] * self.path.present.shape[1]
        lefts = np.split(state.fit.left, rows)
        causes = [self.path.of(state.causes, k) for k in range(len(self.logs))]
        return [
            State(state.deviance, Fit(own, float(left @ left), left), noise, state.variant, state.motion)
            for own, left, noise in zip(causes, lefts, state.noise)
        ]

    def likeliest(self, fit, rounds=ROUNDS, coloured=None):
        found = [log.likeliest(replace(fit, causes=self.path.of(fit.causes, k)), rounds, coloured) for k, log in enumerate(self.logs)]
        deviance = sum(own.deviance - log.fitter.guesses(own.causes) for own, log in zip(found, self.logs))
        self.fitter.noise = tuple(own.noise for own in found)
        self.path.changes += 1
        fit = self.fitter.fit_of(fit.causes)
        return State(deviance + self.fitter.guesses(fit.causes), fit, self.fitter.noise, self.path.variant, self.path.motion)

    def _settled(self, state, fit):
        self.at(state)
        for _ in range(TURNS):
            state = self.likeliest(self.exact(self.fitter.refine(self.fitter.fit_of(fit.causes))))
            fit = state.fit
        return state

    def begun_at(self, coarse):
        """The state of these paths from that of the same logs with fewer rows."""
        state = replace(coarse, noise=self.fitter.noise)
        return self.simplified(self.settled(state, self.at(state).fit_of(coarse.causes)))

    # ---- sets of effects -----------------------------------------------------------------------------------

    def run(self, alike):
        """The State that is worth most. alike: {effect: names of what may be it} by the logs one by one."""
        begin = self.likeliest(self.fitter.fit_of(self.begun(self.timed, self._names())))
        begin = self.moving_alike(simpler.stepped(self, self.settled(begin, begin.fit)))
        sets = [self.begun(timed, names) for timed in dict.fromkeys((self.timed, ())) for names in self._sets(alike)]
        fits = sorted((self.refined(begin, causes) for causes in sets), key=self.priced)
        return min((self.simplified(self.settled(begin, fit)) for fit in fits[:FULLY]), key=self.worth)

    def _names(self):
        """Of the effects of all logs, each in the form that the first log with it has."""
        found = {}
        for cause in (c for causes in self.known for c in causes):
            found.setdefault(self.path.effects[cause.name].reported_as, cause.name)
        return tuple(found.values())

    def _sets(self, alike):
        """Names of effects that may be all there is: of each log, of all, and of all with others instead of one."""
        every = self._names()
        found = [tuple(c.name for c in causes) for causes in self.known] + [every]
        found += [(*(n for n in every if n != name), *others) for name in every for others in self.instead(every, name, alike)]
        found += [tuple(form if self._same(n, form) else n for n in every) for causes in self.known for form in (c.name for c in causes)]
        return list({frozenset(names): names for names in found}.values())

    def _same(self, name, other):
        return self.path.effects[name].reported_as == self.path.effects[other].reported_as

    def instead(self, names, name, alike):
        """[names] that may be an effect, one by one and together."""
        others = [n for n in alike.get(self.path.effects[name].reported_as, ()) if n in self.path.effects]
        others = [n for n in others if not any(self._same(n, known) for known in names)]
        return [(n,) for n in others] + [tuple(others)] * (len(others) > 1)

    def promising(self, state, causes):
        """Names of the effects that promise most beside causes, by what they promise in each log."""
        fit, promise = self.refined(state, causes, FEW), {}
        for k, log in enumerate(self.logs):
            own = log.fitter.fit_of(self.path.of(fit.causes, k))
            for gain, cause in candidates(log.fitter, own, ALWAYS):
                promise[cause.name] = promise.get(cause.name, 0.0) + gain
        free = [n for n in promise if n in fit.lacks(self.path.effects)]
        return sorted(free, key=lambda name: -promise[name])[:LIKELY]

    def begun(self, causes, names):
        """Causes and these effects in all groups, each of the size known there, or the best of those that a scan begins with."""
        for name in names:
            for group in self.groups:
                logs = tuple(k for k in group if not any(k in c.logs and self._same(c.name, name) for c in causes))
                known = [c.params for k in group for c in self.known[k] if c.name == name and c.segments == ALWAYS]
                starts = known or [*(c.params for some in self.known for c in some if c.name == name), *self.path.effects[name].starts]
                causes = self._best([(*causes, Shared(name, params, ALWAYS, logs)) for params in starts]) if logs else causes
        return causes

    def _best(self, trials):
        costs = (self.fitter.lefts(trials) ** 2).sum(0) + [self.fitter.guesses(trial) for trial in trials]
        return trials[int(costs.argmin())]

    # ---- what is common ------------------------------------------------------------------------------------

    def simplified(self, state):
        """With one size for several groups, and without causes, while that is worth it."""
        fit = self.plainer(state)
        while fit.causes != state.causes and (better := self.settled(state, fit)) and self.worth(better) < self.worth(state):
            state, fit = better, self.plainer(better)
        return state

    def plainer(self, state, fit=None):
        """The fit that simplified() comes to under the noise of a state."""
        better = fit = fit or state.fit
        while better:
            fit = better
            likely = (self.refined(state, causes, FEW) for causes in self._likely(self.at(state).fit_of(fit.causes)))
            better = next((found for found in likely if self.priced(found) < self.priced(fit)), None)
        return fit

    def _likely(self, fit):
        """[causes] simpler than those of a fit, that pay by its slopes if the others make up for what they can."""
        J, ends = self.fitter.jacobian(fit), np.cumsum([0, *(len(c.params) for c in fit.causes)])
        unit, gram, trials = np.eye(ends[-1]), J.T @ J, list(self._fewer(fit.causes))
        prices = []
        for (causes, were), left in zip(trials, self.fitter.lefts([causes for causes, _ in trials]).T if trials else ()):
            T = np.concatenate([unit[:, :0], *(sum(unit[:, ends[i] : ends[i + 1]] for i in some) for some in were)], 1)
            slope = T.T @ (J.T @ left)
            gain = slope @ np.linalg.pinv(T.T @ gram @ T, NOTHING, hermitian=True) @ slope
            prices.append(left @ left - gain + self.fitter.guesses(causes) + self.costs(causes))
        best = {}
        for i in np.argsort(prices):
            if prices[i] < self.priced(fit):
                best.setdefault(tuple(trials[i][1]), trials[i][0])
        return list(best.values())[:TRIED]

    @staticmethod
    def _between(sizes, threshold):
        """Sizes with which one for several begins; where no slope leads on, all that lie between."""
        return product(*np.quantile(sizes, GRID, axis=0).T.tolist()) if threshold else [*sizes, np.mean(sizes, axis=0).tolist()]

    def _fewer(self, causes):
        """(causes, which of the former each of them was) without some of an effect, or with one size for several."""
        every = range(len(causes))
        names = dict.fromkeys(c.name for c in causes if c.segments == ALWAYS)
        alike = [tuple(i for i in every if causes[i].name == name and causes[i].segments == ALWAYS) for name in names]
        for part in dict.fromkeys([*((i,) for i in every), *alike]):
            yield tuple(causes[i] for i in every if i not in part), [(i,) for i in every if i not in part]
        for part in dict.fromkeys(part for some in alike for part in (*combinations(some, 2), some) if len(part) > 1):
            rest, logs = [i for i in every if i not in part[1:]], tuple(sorted(k for i in part for k in causes[i].logs))
            for params in self._between([causes[i].params for i in part], self.path.effects[causes[part[0]].name].threshold):
                one = replace(causes[part[0]], params=tuple(params), logs=logs)
                yield tuple(one if i == part[0] else causes[i] for i in rest), [part if i == part[0] else (i,) for i in rest]
