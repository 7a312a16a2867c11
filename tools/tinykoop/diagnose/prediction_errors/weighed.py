"""Sizes and forms that serve predictions many steps ahead, of a robot that also moves at random.

Where the robot moves at random, one step tells little of a cause, and what a step tells of it hangs on the form of the noise. So sizes
are fitted once more, to predictions 10, 20 and 50 steps ahead, each over the error that a perfect model would have: a composite
likelihood (Varin, Reid and Firth, "An overview of composite likelihood methods", Statistica Sinica 21, 2011). They are taken if
they predict rows better that they were not fitted on.
"""

import numpy as np

from . import ahead, forms, judge
from .fit import Fitter
from .noise import QUIET
from .states import MOVES

STEPS = (10, 20, 50)  # that predictions are compared after
OUT = 4.0  # times the error of a perfect model, that a prediction counts for at most
BETTER = 0.02  # of the error at the longest horizon, that must go for the sizes to be taken
NEAR = 0.08  # of what a cause is worth, by which another form of it, or none, may be worth less and serve predictions better
ERRORS = 2.0  # standard errors, by which a simpler set may be worse
LIKELY, TURNS = 2, 3  # effects that are tried instead of one; turns of other forms
BLOCK, FEWEST = 100, 4  # rows that count as one observation, twice the longest horizon; of these, to compare by


class Ahead(Fitter):
    """Fits causes to predictions from rows `starts` of the path."""

    smooth = True  # over so many steps, each threshold is passed by some

    def __init__(self, path, noise, starts):
        super().__init__(path, noise)
        self.starts = starts
        variance = path.noises.ahead(path, noise, starts, STEPS)
        self._weights = 1 / np.sqrt(np.mean(variance, axis=0))
        self._each = variance[0].size

    def lefts(self, trials):
        """Errors over those of a perfect model (n, trials)."""
        return np.stack([self._left(causes) for causes in trials], 1)

    def _left(self, causes):
        missed = self.path.ahead(causes, self.starts, STEPS) * self._weights
        return np.clip(np.where(np.isfinite(missed), missed, 0.0), -OUT, OUT).ravel()

    @property
    def rows(self):
        return np.repeat(self.starts, self._each)

    @property
    def block(self):
        apart = np.median(np.diff(self.starts)) if len(self.starts) > 1 else BLOCK
        return self._each * max(round(BLOCK / max(apart, 1)), 1)


def moves(path, noise, starts):
    """Whether the robot moves at random, so much that sizes are weighed, in a log that is long enough to do so."""
    long = len(starts) > 1 and starts[-1] - starts[0] >= FEWEST * BLOCK
    return path.weighed and long and bool((noise.process > MOVES * QUIET * path.usual).any())


def sized(search, state, starts):
    """(the fitter by which sizes are found, its Fit of the state's causes)."""
    fitter = search.at(state)
    if not (state.causes and moves(search.path, state.noise, starts)):
        return fitter, state.fit
    whole = Ahead(search.path, state.noise, starts)
    by_steps, by_ahead = (_squares(whole, state.fit, how) for how in (False, True))
    if np.sqrt(by_ahead[:, -1].mean()) > (1 - BETTER) * np.sqrt(by_steps[:, -1].mean()):
        return fitter, state.fit
    return whole, whole.refine(whole.fit_of(state.causes))


def _squares(whole, fit, weighed=True):
    """Squared errors (S, H) of each prediction of an Ahead over those of a perfect model, with sizes from the other folds."""
    fold = ahead.folds(whole.path)[whole.starts]
    fit = whole.refine(whole.fit_of(fit.causes)) if weighed else fit
    fits = ahead.held_out(whole if weighed else Fitter(whole.path, whole.noise), fit)
    lefts = whole.lefts(fits).reshape(len(whole.starts), len(STEPS), -1, ahead.FOLDS)
    return (np.take_along_axis(lefts, fold[:, None, None, None], 3)[..., 0] ** 2).sum(2)


def chosen(search, state, starts):
    """The state with the forms of its causes that serve predictions best, of those that steps hardly tell from each other.

    The simplest of those that are not clearly worse than the best.
    """
    for _ in range(TURNS if state.causes and moves(search.path, state.noise, starts) else 0):
        trials = [state.fit, *_others(search, state)]
        whole = Ahead(search.path, state.noise, starts)
        squares = [_squares(whole, fit).mean(1) for fit in trials]
        best = squares[int(np.argmin([s.mean() for s in squares]))]
        fine = [i for i, s in enumerate(squares) if s.mean() - best.mean() <= ERRORS * _error(s - best, starts)]
        first = min(fine, key=lambda i: (_sizes(trials[i]), squares[i].mean()))
        if first == 0:
            break
        state = search.settled(state, trials[first])
    return state


def _error(difference, starts):
    """Standard error of a mean (S,), by blocks."""
    parts = np.array_split(difference, max(int((starts[-1] - starts[0]) / BLOCK), 2))
    means = np.array([part.mean() for part in parts if len(part)])
    return means.std(ddof=1) / np.sqrt(len(means))


def _sizes(fit):
    return sum(len(cause.params) for cause in fit.causes)


def _others(search, state):
    """Fits with one cause in another form, without it or with another cause instead, that steps hardly tell from that of the state."""
    rests, out = judge.dropped(search.at(state), state.fit), []
    worths = [rest.cost - state.fit.cost for rest in rests]
    for i, (rest, worth) in enumerate(zip(rests, worths)):
        fits = [search.refined(state, trial) for trial in forms.begun(search, state, i)]
        fits += judge.rivals(search, state.fit, rest, i, LIKELY)
        small = worth < NEAR * max(worths)
        out += [fit for fit in (*fits, rest) if small or fit.cost < state.fit.cost + NEAR * worth]
    return out
