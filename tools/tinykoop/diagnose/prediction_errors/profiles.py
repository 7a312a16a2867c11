"""Intervals by profiles of the likelihood: squares rise by a price for one size while all others are fitted again.

The ends are looked for along the path of the others' best sizes (Venzon and Moolgavkar, "A method for computing
profile-likelihood-based confidence intervals", Applied Statistics 37, 1988). Sizes of a curve make up for one another: squares have
a valley that is narrow and bends, in which Gauss-Newton steps get stuck. What a fit leaves there is taken for the rise, and the
interval comes out too narrow. So each step follows the curvature of the valley (Transtrum and Sethna, "Geometry of nonlinear least squares with
applications to sloppy models and optimization", Physical Review E 83, 2011: geodesic acceleration).
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .fit import SLOPE, Fit

PRICE = 3.84  # squares, by which 95 % intervals of one size end: chi-square of one degree of freedom
ENDS, NEAR = 8, 0.03  # trials of an end; of the rise of the root of squares, by which it may be off
FARTHER, INWARD = (1.3, 4.0), (0.1, 0.9)  # times the last step, if squares have not risen enough; of the way between two, if they have
STEPS, ENOUGH, EXACT = 20, 0.02, 1e-3  # steps of a fit at most; squares, below which it is at its end; the same of the best one
DAMPED = (1e-6, 1e-3, 1.0, 1e2, 1e4, 1e6)  # squares by a usual size: dampings of a first step, of which the one that is best is made
AROUND = (0.03, 1.0, 30.0)  # times the last one's damping: those of a further step
BEND = 0.1  # of a step, at which its curvature is measured
SLOPES_BY = 1e-5  # of a usual size, by which slopes of curves are taken: those of larger steps lead out of the valley
ROUGH = 3  # steps of a fit with thresholds, which have no slope to follow
RESTARTS, LOWER = 2, 0.1  # of a profile that comes upon a better fit; squares, by which it must be better


@dataclass(frozen=True)
class Point:
    """A fit, its sizes, and the slopes (n, p) of what it leaves."""

    fit: Fit
    sizes: np.ndarray
    J: np.ndarray

    @cached_property
    def gram(self):
        return self.J.T @ self.J


class Profile:
    """Of all causes of a fit. What is guessed of curves is left out: it is no measurement."""

    def __init__(self, fitter, fit):
        self.fitter = copy(fitter)
        self.fitter.guessing = False
        _, self.low, self.high, _ = fitter.vector(fit.causes)
        self.rough = not fitter.smooth and any(fitter.effects[c.name].threshold for c in fit.causes)
        self.fitter.slopes_by = fitter.slopes_by if self.rough else SLOPES_BY
        self.best = self._least(self.fitter.fit_of(fit.causes), enough=EXACT)

    def interval(self, index, spread=1.0, begin=0.0):
        """(low, high) of one size, all others fitted again.

        spread: times the noise, that blocks of rows differ by; begin: the first step, where it is more than that by slopes.
        """
        rise = np.sqrt(PRICE) * max(spread, 1.0)
        for _ in range(RESTARTS):
            (low, *found), (high, *others) = (self._end(index, sign, rise, begin) for sign in (-1, 1))
            lowest = min((*found, *others), key=lambda point: point.fit.cost)
            if lowest.fit.cost > self.best.fit.cost - LOWER:
                break
            self.best = self._least(lowest.fit, enough=EXACT)
        return low, high

    # ---- the end on one side -----------------------------------------------------------------------------

    def _end(self, index, sign, rise, first):
        """(the size where the root of squares has risen so far, the Point of least squares on the way)."""
        begin = self.best.sizes[index]
        most = (self.high if sign > 0 else self.low)[index] - begin
        inside, outside, step, least = (0.0, 0.0, self.best), None, sign * max(self._half(index) * rise, first), self.best
        for _ in range(ENDS):
            step = step if abs(step) < abs(most) else most
            point = self._at(inside, outside, index, step)
            least = min(least, point, key=lambda point: point.fit.cost)
            risen = np.sqrt(max(point.fit.cost - self.best.fit.cost, 0.0))
            if abs(risen - rise) < NEAR * rise or (risen < rise and step == most):
                return begin + step, least
            if risen > rise:
                outside = step, risen, point
            else:
                inside = step, risen, point
            step = _between(inside, outside, rise)
        return begin + (outside or inside)[0], least

    def _half(self, index):
        """Of one size, by which the root of squares rises by 1 if all is linear."""
        gram = self.best.gram
        others = np.flatnonzero((np.arange(len(gram)) != index) & (np.diag(gram) > SLOPE))
        across = gram[others, index]
        alone = gram[index, index] - across @ np.linalg.lstsq(gram[np.ix_(others, others)], across, rcond=None)[0]
        return 1 / np.sqrt(max(alone, SLOPE))

    # ---- fits --------------------------------------------------------------------------------------------

    def _at(self, inside, outside, index, step):
        """The Point of least squares with one size held a step from the best: begun as slopes have it, or between two that are known."""
        (begin, _, point), size = inside, self.best.sizes[index] + step
        if self.rough:
            return self._least(
                self.fitter.fit_of(self._trials(point, [(size - point.sizes) * (np.arange(len(self.low)) == index)])[0]), index
            )
        fit = self._step(point, index, DAMPED, size - point.sizes[index])[0]
        if outside is not None:
            way = (step - begin) / (outside[0] - begin) * (outside[2].sizes - point.sizes)
            fit = min(fit, self.fitter.fit_of(self._trials(point, [way])[0]), key=lambda fit: fit.cost)
        return self._least(fit, index)

    def _point(self, fit):
        return Point(fit, self.fitter.vector(fit.causes)[0], self.fitter.jacobian(fit))

    def _least(self, fit, held=None, enough=ENOUGH):
        """The Point of least squares from a fit on, one size held if any."""
        if self.rough:
            some = copy(self.fitter)
            some.held_at = () if held is None else (held,)
            return self._point(some.refine(fit, ROUGH))
        point, dampings = self._point(fit), DAMPED
        for _ in range(STEPS):
            fit, damping = self._step(point, held, dampings)
            if point.fit.cost - fit.cost < enough:
                break
            point, dampings = self._point(fit), damping * np.array(AROUND)
        return point

    def _step(self, point, held, dampings, by=0.0):
        """(the best fit a step on, its damping), the held size moving by so much: Gauss-Newton steps of several dampings, with acceleration."""
        left, J = point.fit.left[:, None], point.J
        moves = [self._move(point, J.T @ left[:, 0], held, by, damping) for damping in dampings]
        ahead = self.fitter.lefts(self._trials(point, [BEND * move for move in moves]))
        bends = left + (ahead - left - BEND * J @ np.transpose(moves)) / BEND**2
        trials = self._trials(point, [self._move(point, J.T @ ends, held, by, damping) for ends, damping in zip(bends.T, dampings)])
        lefts = self.fitter.lefts(trials)
        costs = (lefts**2).sum(0)
        best = int(costs.argmin())
        return Fit(trials[best], float(costs[best]), lefts[:, best]), dampings[best]

    def _trials(self, point, moves):
        return [self.fitter.split(point.fit.causes, point.sizes + move) for move in moves]

    def _move(self, point, slope, held, by, damping):
        """The move (p,) to where slopes have the least squares, one size moving by so much; what comes to a bound first stays there."""
        z, move, stays = point.sizes, np.zeros_like(point.sizes), np.diag(point.gram) < SLOPE
        if held is not None:
            move[held], stays[held] = by, True
        gram = point.gram + damping * np.eye(len(z))
        while not stays.all():
            free = ~stays
            move[free] = -np.linalg.solve(gram[np.ix_(free, free)], slope[free] + gram[np.ix_(free, stays)] @ move[stays])
            room = np.where(move < 0, self.low - z, self.high - z)
            share = np.where(free & (np.abs(move) > np.abs(room)), np.abs(room) / np.maximum(np.abs(move), 1e-300), 1.0)
            first = int(share.argmin())
            if share[first] == 1:
                break
            move[first], stays[first] = room[first], True
        return move


def _between(inside, outside, rise):
    """The next step to where the root of squares has risen so far: on from what is inside, or between that and what is outside."""
    if outside is None:
        return inside[0] * np.clip(rise / max(inside[1], 1e-9), *FARTHER)
    share = (rise - inside[1]) / (outside[1] - inside[1])
    return inside[0] + np.clip(share, *INWARD) * (outside[0] - inside[0])
