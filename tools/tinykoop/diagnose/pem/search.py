"""Which effects, and when: taken in one by one while the likelihood, less a price, rises."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import ndimage

from . import noise as noises
from . import spans
from .fit import ALWAYS, Cause, Fit, Fitter
from .noise import QUIET

MOST = 4  # effects of one explanation
LIKELY, HIDDEN = 4, 3  # candidates by the noise as it is, and by what the sensor alone makes
TRIED = 2  # of these, for which noise is estimated anew
ABSORBED = 0.5  # of what several causes do, from which on one is tried in their place
TURNS = 3
OUTLIERS, OUT, USUAL, AROUND = 3, 4.0, 1.5, 11  # turns; standard deviations that stand out, and that they become; rows
CLOSE = 0.6  # of the best candidate's gain, from which on another is tried, too
MOVES = 5.0  # times what counts as none, from which on random motion may hide that a cause explains all
MARGIN = 4.0  # of -2 log likelihood
SHOWS = 1.0  # norm of what a candidate does beside the others
LOUDER = 3.0  # times what third differences show, that the sensor's noise may be
LIMIT = 0.3  # share of a range in which a linear effect begins


@dataclass(frozen=True)
class State:
    """Causes and noise; surprise: -2 log likelihood."""

    surprise: float
    fit: Fit
    noise: noises.Noise
    variant: int


def _between(X, good):
    """X (K, n) with rows that are not good in a line between those about them."""
    rows = np.arange(len(X))
    return np.stack([np.where(good, x, np.interp(rows, rows[good], x[good])) for x in X.T], 1)


class Search:
    def __init__(self, path):
        self.path = path
        self.fitter = Fitter(path, noises.first(path))
        self.sensor = self.fitter.noise
        self.price = np.log(self.fitter.degrees) + 2 * np.log(max(len(path.effects), 2))

    # ---- states --------------------------------------------------------------------------------------------

    def worth(self, state):
        return state.surprise + self.costs(state.fit.causes)

    def costs(self, causes):
        """Price of causes: of each, of each parameter beyond the first, of each edge in time."""
        each, digit = self.price, np.log(self.fitter.degrees)
        edges = sum(np.isfinite(edge) for c in causes for span in c.segments for edge in span)
        return each * len(causes) + 0.5 * digit * sum(len(c.params) - 1 for c in causes) + digit * edges

    def at(self, state):
        """The fitter with the noise of a state."""
        self.fitter.noise = state.noise
        self.path._set_variant(state.variant)
        return self.fitter

    def likeliest(self, fit, rounds=noises.ROUNDS, coloured=None):
        """The State of a fit's causes with the noise that suits them."""
        D, E = self.path.steps([fit.causes]), self.path.E[..., None]
        self.fitter.noise, surprise = noises.likeliest(self.path, self.fitter.noise, D, E, rounds, coloured)
        fit = self.fitter.fit_of(fit.causes)
        return State(surprise + self.fitter.guesses(fit.causes), fit, self.fitter.noise, self.path.variant)

    def settled(self, fit):
        """Sizes and noise in turn; once more from no random motion, which a cause that explains it all would never reach."""
        found = self._in_turn(fit)
        if (found.noise.process > MOVES * QUIET * self.path.usual).any():
            self.without_motion(found)
            found = min(found, self._in_turn(found.fit), key=self.worth)
        self.at(found)
        return found

    def _in_turn(self, fit):
        state = self.likeliest(self.fitter.refine(self.fitter.fit_of(fit.causes)))
        better = spans.edges(self.fitter, self.fitter.refine(state.fit, 3))
        return self.likeliest(better, 6) if state.fit.cost - better.cost > 1 else replace(state, fit=better)

    def begun_anew(self, state):
        """With curves that begin at their usual sizes again: they have more than one hollow."""
        for i, cause in enumerate(state.fit.causes):
            if self.path.effects[cause.name].curve:
                fitter = self.at(state)
                starts = [replace(cause, params=p) for p in self.path.effects[cause.name].starts]
                fits = [fitter.refine(fitter.fit_of((*state.fit.causes[:i], c, *state.fit.causes[i + 1 :])), 15) for c in starts]
                best = min(fits, key=lambda f: f.cost)
                if best.cost < state.fit.cost - MARGIN:
                    state = min(state, self.settled(best), key=self.worth)
        self.at(state)
        return state

    # ---- candidates ----------------------------------------------------------------------------------------

    def candidates(self, fit, segments=None):
        """[(promise, Cause)] of every effect that is not in `fit`, best first; segments: when they act, if that is not asked, too."""
        fitter = self.fitter
        J = fitter.jacobian(fit)
        Q = np.linalg.qr(J)[0] if J.shape[1] else np.zeros((len(fit.left), 0))
        free = lambda c: c - Q @ (Q.T @ c)  # noqa: E731
        trials = [(*fit.causes, Cause(n, start, segments or ALWAYS)) for n, e in fitter.effects.items() if n not in fit.names for start in e.starts]
        if not trials:
            return []
        columns = free(fitter.whiten(self.path.steps(trials) - self.path.steps([fit.causes])))
        left = free(fit.left)
        found = []
        for name in dict.fromkeys(t[-1].name for t in trials):
            mine = [i for i, t in enumerate(trials) if t[-1].name == name]
            promise = self._promise(self.path.effects[name], columns[:, mine], left, [trials[i][-1] for i in mine])
            if promise:
                found.append(promise)
        found += self._in_time(fit, free, left, found) if segments is None else []
        return sorted(found, key=lambda f: -f[0])

    def _promise(self, effect, columns, left, causes):
        """(gain, Cause) of one effect; None if it does nothing or the wrong way."""
        size = np.linalg.norm(columns, axis=0)
        if not (size > SHOWS).any():
            return None
        if effect.linear:
            weights = np.linalg.lstsq(columns, -left, rcond=1e-9)[0]
            params = np.array([c.params for c in causes]).T @ weights
            params = np.clip(params, *(LIMIT * np.array([[p.low, p.high] for p in effect.parameters]).T))
            return float(left @ left - ((left + columns @ weights) ** 2).sum()), replace(causes[0], params=tuple(params.tolist()))
        gain = left @ left - ((left[:, None] + columns) ** 2).sum(0)
        along = -(left @ columns) / np.maximum(size, 1e-9)
        promise = np.where(size > SHOWS, np.maximum(gain, np.where(along > 0, 0.5 * along**2, 0)), 0)
        i = int(promise.argmax())
        return (float(promise[i]), causes[i]) if promise[i] > 0 else None

    def _in_time(self, fit, free, left, found):
        """The candidates, each in the stretch of time that suits it best, where that promises more."""
        out = []
        blocks = spans.blocks(self.path)
        edge_price = 2 * np.log(self.fitter.degrees)
        for gain, cause in found:
            columns = free(self.fitter.whiten(spans.parts(self.path, fit.causes, cause, blocks)))
            best, span, scale = spans.best_stretch(columns, left, blocks)
            if best > gain + edge_price + MARGIN:
                cause = replace(cause, segments=(spans.seconds(span, blocks, self.path),))
                if self.path.effects[cause.name].linear:
                    cause = replace(cause, params=tuple(np.clip(np.array(cause.params) * scale, *np.array([[p.low, p.high] for p in self.path.effects[cause.name].parameters]).T).tolist()))
                out.append((best - edge_price, cause))
        return out

    # ---- the search ----------------------------------------------------------------------------------------

    def run(self):
        """The State that is worth most."""
        state = self.base = self.tinted(self.robust(self.likeliest(self.fitter.fit_of(()))))
        for _ in range(TURNS):
            wide = self.forward(state)
            state = self.discretised(self.simplified(self.opened(self.begun_anew(wide))))
            if state is wide or len(state.fit.causes) == MOST:
                break
        return self.tinted(self.robust(state))

    def forward(self, state):
        """Causes taken in one by one."""
        while len(state.fit.causes) < MOST:
            better = self.widened(state)
            if better is None or self.worth(better) > self.worth(state) - MARGIN:
                break
            state = self.reduced(self.stepped(self.timed(better)))
        self.at(state)
        return state

    def robust(self, state):
        """With rows that stand alone counted as noisier: a reading that is off, after which the next are not."""
        for _ in range(OUTLIERS):
            size = np.abs(self.at(state).fit_of(state.fit.causes).left.reshape(self.path.present.shape))
            usual = np.maximum(ndimage.median_filter(size, (AROUND, 1)) / 0.6745, 1.0)
            if not (size > OUT * usual).any():
                break
            self.path.present = self.path.present * np.where(size > OUT * usual, (size / USUAL / usual) ** 2, 1.0)
            self.path.follow(_between(self.path.X, (self.path.present == 1).all(1)))
            state = self.likeliest(self.fitter.fit_of(state.fit.causes))
        return state

    def tinted(self, state):
        """With coloured sensor noise if that is likelier."""
        if not (state.noise.sensor_rho > 0).any():
            fit = self.at(state).fit_of(state.fit.causes)
            coloured = self.likeliest(fit, 2 * noises.ROUNDS, coloured=True)
            state = coloured if coloured.surprise < state.surprise - MARGIN else state
        self.at(state)
        return state

    def without_motion(self, state):
        """The fitter with what the sensor alone makes: what random motion would hide shows."""
        self.at(state)
        self.fitter.noise = replace(state.noise.quiet(self.path), sensor=np.minimum(state.noise.sensor, LOUDER * self.sensor.sensor))
        return self.fitter

    def widened(self, state):
        """The best state with one cause more."""
        likely = [c for _, c in self.candidates(self.at(state).fit_of(state.fit.causes))[:LIKELY]]
        likely += [c for _, c in self.candidates(self.without_motion(state).fit_of(state.fit.causes))[:HIDDEN]]
        fitter = self.at(state)
        likely = {(c.name, c.segments): c for c in reversed(likely)}.values()
        fits = sorted((fitter.refine(fitter.fit_of((*state.fit.causes, c)), 5) for c in likely), key=lambda f: f.cost + self.costs(f.causes))
        gains = [state.fit.cost - f.cost for f in fits]
        states = []
        for fit, gain in list(zip(fits, gains))[:TRIED]:
            if gain > CLOSE * gains[0]:
                self.at(state)
                states.append(self.settled(fit))
        return min(states, key=self.worth, default=None)

    def timed(self, state):
        """With stretches of time in which causes act, or do not, while that is worth it."""
        better = True
        while better:
            better = self._toggled(state, self.at(state)) or self._toggled(state, self.without_motion(state))
            state = better or state
        self.at(state)
        return state

    def _toggled(self, state, fitter):
        fit = spans.toggled(fitter, fitter.fit_of(state.fit.causes), 2 * np.log(fitter.degrees) + MARGIN)
        if fit is None:
            return None
        self.at(state)
        better = self.settled(self.fitter.fit_of(fit.causes))
        return better if self.worth(better) < self.worth(state) - MARGIN else None

    def stepped(self, state):
        """With the variant of the simulator that suits it best."""
        best = state
        for variant in range(len(self.path.variants)):
            if variant != state.variant:
                self.at(replace(state, variant=variant))
                fit = self.fitter.refine(self.fitter.fit_of(state.fit.causes), 3)
                if fit.cost < state.fit.cost - MARGIN:
                    best = min(best, self.likeliest(fit), key=self.worth)
        self.at(best)
        return best

    def simplified(self, state):
        """One cause in the place of several, where it is worth more."""
        causes = state.fit.causes
        for count in range(len(causes), 1, -1):
            for group in combinations(causes, count):
                better = self._one_for(state, group)
                if better:
                    return self.simplified(better)
        self.at(state)
        return state

    def _one_for(self, state, group):
        """The state with one cause in the place of a group, if that is worth more."""
        fitter = self.at(state)
        base = fitter.fit_of(tuple(c for c in state.fit.causes if c not in group))
        likely = [max(found, key=lambda f: f[0]) for g in {ALWAYS, *(c.segments for c in group)} if (found := self.candidates(base, g))]
        likely = [cause for gain, cause in likely if gain > ABSORBED * (base.cost - state.fit.cost)]
        wider = tuple(replace(c, segments=ALWAYS) for c in base.causes)
        for causes in dict.fromkeys((*rest, cause) for cause in likely for rest in (base.causes, wider)):
            better = self.settled(self.at(state).refine(self.fitter.fit_of(causes), 5))
            if self.worth(better) < self.worth(state):
                return better
        return None

    def opened(self, state):
        """With causes that act all along in the place of those that come and go, where it is worth more."""
        causes = state.fit.causes
        timed = [i for i, c in enumerate(causes) if c.segments != ALWAYS]
        for some in [timed, *([i] for i in timed)] if len(timed) > 1 else [timed] if timed else []:
            fitter = self.at(state)
            wider = tuple(replace(c, segments=ALWAYS) if i in some else c for i, c in enumerate(causes))
            better = self.settled(fitter.refine(fitter.fit_of(wider)))
            if self.worth(better) < self.worth(state):
                return self.opened(better)
        self.at(state)
        return state

    def discretised(self, state):
        """With the variant of the simulator that suits it best, a cause less if that makes up for one."""
        best = state
        for variant in range(len(self.path.variants)):
            for i in range(len(state.fit.causes)) if variant != state.variant else ():
                fitter = self.at(replace(state, variant=variant))
                fit = fitter.refine(fitter.fit_of(state.fit.causes[:i] + state.fit.causes[i + 1 :]), 3)
                if fit.cost + self.costs(fit.causes) < state.fit.cost + self.costs(state.fit.causes):
                    best = min(best, self.likeliest(fit), key=self.worth)
        self.at(best)
        return best

    def reduced(self, state):
        """Without causes that do not pay."""
        while len(state.fit.causes) > 1:
            fitter = self.at(state)
            rests = [fitter.refine(fitter.fit_of(state.fit.causes[:i] + state.fit.causes[i + 1 :]), 3) for i in range(len(state.fit.causes))]
            less = self.settled(min(rests, key=lambda f: f.cost + self.costs(f.causes)))
            if self.worth(less) > self.worth(state) + MARGIN:
                break
            state = less
        self.at(state)
        return state
