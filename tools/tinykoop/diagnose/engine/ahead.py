"""How far predictions are off, some steps ahead from measured states, on rows that the sizes were not fitted on."""

import numpy as np

from ..prediction_errors.ahead import HORIZONS
from .problem import FINER
from .rollouts import Rollouts

COVERED = 2.0  # times that the longest predictions go over the log, at most
SHOWS = 1.1  # times the noise, from which on a gap is one
DRAWS, BLOCK = 400, 5  # of the bootstrap; predictions in a block


def _states(problem):
    """States (K, n) row by row: measured ones, and hidden ones as the settled windows have them; NaN elsewhere."""
    x = problem.log.x.copy()
    for w, rows in enumerate(problem.rollouts.index):
        missing = ~np.isfinite(x[rows])
        x[rows] = np.where(missing, problem.X[w], x[rows])
    return x


def halves(finder, fit):
    """[causes with sizes of the even windows, of the odd ones]: one linear step from the fit."""
    if not fit.causes:
        return [(), ()]
    J, W = finder.jacobian(fit), len(finder.problem.rollouts.starts)
    z, low, high = finder.vector(fit.causes)
    J, r = J.reshape(W, -1, J.shape[1]), fit.left.reshape(W, -1)
    out = []
    for part in (0, 1):
        A, b = J[part::2].reshape(-1, J.shape[2]), r[part::2].reshape(-1)
        move = np.linalg.lstsq(A, b, rcond=1e-9)[0]
        out.append(finder.split(fit.causes, np.clip(z - np.clip(move, -0.5, 0.5), low, high)))
    return out


class Ahead:
    """Predictions of one log. errors(causes): {gap: (S, horizons)} distances."""

    def __init__(self, problem, horizons=HORIZONS):
        self.problem = problem
        longest = problem.rollouts.rows
        self.horizons = [h for h in horizons if h <= longest]
        self.rollouts = Rollouts(problem.robot, problem.log, self.horizons[-1])
        x, log = _states(problem), problem.log
        run = np.convolve(log.usable, np.ones(self.horizons[-1]), "valid") == self.horizons[-1]
        good = np.flatnonzero(run & np.isfinite(x[: len(run)]).all(1))
        good = good[good >= problem.rollouts.starts[0]]
        self.starts = good[:: max(1, round(self.horizons[-1] / COVERED))]
        self.x = x[self.starts]
        # which half of the windows a prediction begins in
        self.half = np.searchsorted(problem.rollouts.starts, self.starts, side="right") % 2  # 1: in an even one
        self.shift = self._finer()

    def errors(self, causes, some=slice(None)):
        """Of predictions with causes; some: of which ones."""
        missed = self.rollouts.missed(self._predicted(causes, some) + self.shift[some])[:, self.horizons]
        names = [c.name for c in self.problem.robot.channels]
        return {
            gap.name: np.sqrt((missed[..., [names.index(s) for s in gap.states if s in names]] ** 2).sum(-1))
            for gap in self.problem.robot.gaps
        }

    def _finer(self):
        """What the step of time that the log speaks for adds to channels (S, longest + 1, c)."""
        none = np.zeros((len(self.starts), self.horizons[-1] + 1, len(self.problem.robot.channels)))
        if not self.problem.finer:
            return none
        coarse = self._predicted(())
        self.rollouts.substeps = FINER
        shift = self.problem.finer * (self._predicted(()) - coarse)
        self.rollouts.substeps = 1
        return shift

    def _predicted(self, causes, some=slice(None)):
        """Channels (S, longest + 1, c)."""
        self.rollouts.put(self.starts[some])
        self.rollouts.x0 = self.x[some]
        with np.errstate(all="ignore"):
            return self._as_read(self.rollouts.run(self.problem.action(causes))[1])

    def _as_read(self, Y):
        """Channels that begin at what was read, whatever a sensor's effect makes of the state there."""
        measured = len(self.problem.robot.measured)
        Y[..., :measured] += (self.rollouts.measured[:, :1] - Y[:, :1])[..., :measured]
        return Y

    def held_out(self, finder, fit):
        """As errors(), each prediction by the sizes of the other half."""
        out = {gap.name: np.full((len(self.starts), len(self.horizons)), np.nan) for gap in self.problem.robot.gaps}
        for even, causes in zip((1, 0), reversed(halves(finder, fit))):
            there = self.half == even
            for name, values in self.errors(causes, there).items():
                out[name][there] = values
        return out

    def floor(self):
        """{gap: (horizons,)}: what noise of the start and of the reading makes."""
        problem, names = self.problem, [c.name for c in self.problem.robot.channels]
        start = np.zeros(len(problem.robot.states))
        measured = problem.robot.measured
        start[measured] = problem.sigma[: len(measured)]
        S = problem.sensed(problem.slopes.starts())[:, self.horizons] * start
        variance = (S**2).sum(-1).mean(0) + problem.sigma**2  # (horizons, c)
        return {gap.name: np.sqrt(variance[:, [names.index(s) for s in gap.states if s in names]].sum(-1)) for gap in problem.robot.gaps}


def rms(errors):
    """(horizons,) of errors (S, horizons); what was not measured does not count."""
    return np.sqrt(np.nanmean(errors**2, 0))


def summary(before, after, floor, horizons, seed=0):
    """The `gap` of the report for one gap."""
    keys, rng = [str(h) for h in horizons], np.random.default_rng(seed)
    first, last = rms(before), rms(after)
    shows = first > SHOWS * floor  # else the gap is about the noise, and there is no percentage of it
    closed = lambda b, a: np.where(shows, np.clip((b - a) / np.maximum(b - floor, 1e-12), -1, 1), np.nan)  # noqa: E731
    blocks = np.array_split(np.arange(len(before)), max(len(before) // BLOCK, 1))
    draws = []
    for _ in range(DRAWS):
        rows = np.concatenate([blocks[i] for i in rng.integers(len(blocks), size=len(blocks))])
        draws.append(closed(rms(before[rows]), rms(after[rows])))
    ends = np.quantile(draws, [0.025, 0.975], axis=0).T
    put = lambda values: dict(zip(keys, map(float, values)))  # noqa: E731
    return {
        "before": put(first), "after": put(last), "noise_floor": put(floor), "closed_fraction": put(closed(first, last)),
        "ci95": {key: [float(v) for v in pair] for key, pair in zip(keys, ends)},
    }  # fmt: skip
