"""A recorded run of the user's simulator instead of that: rates as polynomials of few signals, fitted to the run's steps.

A run shows what the simulator does from the states that it came to. What it would do from others, which a diagnosis has to know,
is what the polynomials say: they are tried on parts of the run that they have not seen, and refused where they are off.
"""

from dataclasses import replace
from itertools import combinations, combinations_with_replacement
from math import comb

import numpy as np

from ...plumbing.errors import UserError
from ...plumbing.results import printable
from ..robots.actions import Stepper, idle
from ..robots.log import noise as noise_of
from ..robots.log import read, windows

DEGREE, TERMS, STEPS = 4, 200, 4000  # of a polynomial; steps of the run that are looked at; all at most
BETTER = 0.9  # of the error, that a further signal may leave
SPARE = 0.05  # of the log's noise: what a rate makes in a window may be off by this, and no better one is looked for
OFF = 0.3  # of the log's noise, that predictions of a window may be off by
BEYOND, FEW = 0.2, 0.05  # of a signal's range, that the log may go beyond it; share of its rows that may go farther
FEWEST = 4  # windows of the run
ROWS = 50  # of a window


def signals(robot, x, u):
    """Columns (B, k) of each state and command: of an angle its sine and cosine, and itself unless it wraps."""
    found = []
    for i, state in enumerate(robot.states):
        turned = [np.sin(x[:, i]), np.cos(x[:, i])] if state.unit == "rad" else []
        found.append(np.stack([*turned, *([] if state.wraps else [x[:, i]])], 1))
    return [*found, *(u[:, j : j + 1] for j in range(len(robot.commands)))]


class Polynomial:
    """Of some signals, by their numbers; fitted to values (B,)."""

    def __init__(self, of, degree, columns, values):
        self.of, chosen = of, self._chosen(of, columns)
        self.size = np.maximum(np.abs(chosen).max(0), 1e-12)
        self.products = np.array(list(combinations_with_replacement(range(chosen.shape[1]), degree)), int)
        self.weights = np.linalg.lstsq(self._terms(chosen), values, rcond=None)[0]

    @staticmethod
    def _chosen(of, columns):
        return np.hstack([np.ones((len(columns[0]), 1)), *(columns[i] for i in of)])

    def _terms(self, chosen):
        return (chosen / self.size)[:, self.products].prod(-1)

    def __call__(self, columns):
        return self._terms(self._chosen(self.of, columns)) @ self.weights


class Recorded:
    """A simulator by polynomials of its rates."""

    def __init__(self, robot, rates):
        self.robot, self.rates = robot, rates

    def step(self, x, u, dt, params):
        columns = signals(self.robot, x, u)
        return x + dt * np.stack([rate(columns) for rate in self.rates], 1)


class Run:
    """A run in windows; every other one is tried by what the rest says, and the reverse."""

    def __init__(self, robot, log, path):
        self.robot, self.log = robot, log
        run = max((len(part) for part in "".join("x" if good else " " for good in log.usable).split()), default=0)
        self.rows = max(min(ROWS, run), 1)
        starts = windows(log.usable, self.rows)
        index = starts[:, None] + np.arange(self.rows + 1)
        starts = starts[np.isfinite(log.x[index]).all((1, 2))]
        self.starts = starts[:: max(1, len(starts) * self.rows // STEPS)]
        if len(self.starts) < FEWEST:
            raise UserError(f"{path}: {len(self.starts)} whole windows of {self.rows} rows are too few; record {FEWEST} at least")
        self.index = index = self.starts[:, None] + np.arange(self.rows + 1)
        before, after = (log.x[rows].reshape(-1, len(robot.states)) for rows in (index[:, :-1], index[:, 1:]))
        self.rates = self._short(after - before) / log.dt
        self.columns = signals(robot, before, log.u[index[:, :-1]].reshape(len(before), -1))
        self.odd = np.repeat(np.arange(len(index)) % 2 == 1, self.rows)

    def _short(self, change):
        """A change of states, angles by the short way."""
        return np.where([s.wraps for s in self.robot.states], (change + np.pi) % (2 * np.pi) - np.pi, change)

    def fitted(self, i, of, degree, used=slice(None)):
        """The Polynomial of state i's rate by the steps used."""
        return Polynomial(of, degree, [c[used] for c in self.columns], self.rates[used, i])

    def error(self, i, of, degree):
        """RMS of state i's rate on each half, by the polynomial of the other."""
        left = [self.rates[~used, i] - self.fitted(i, of, degree, used)([c[~used] for c in self.columns]) for used in (self.odd, ~self.odd)]
        return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))

    def _degree(self, i, of, enough):
        """(error, signals, degree) of the lowest degree that is good enough, else of the best."""
        count, found = sum(self.columns[j].shape[1] for j in of), []
        for degree in range(1, DEGREE + 1):
            if degree == 1 or comb(count + degree, degree) <= min(TERMS, self.odd.sum() // 4):
                found.append((self.error(i, of, degree), of, degree))
            if found[-1][0] < enough:
                break
        return min(found)

    def choose(self, i, enough):
        """(signals, degree) for state i's rate: signals one by one, the first two together."""
        best, every = self._degree(i, (), enough), range(len(self.columns))
        while best[0] >= enough:
            trials = [(*best[1], j) for j in every if j not in best[1]] + (list(combinations(every, 2)) if not best[1] else [])
            trial = min((self._degree(i, of, enough) for of in trials), default=best)
            if trial[0] > BETTER * best[0] or trial is best:
                break
            best = trial
        return best[1:]

    def off(self, chosen):
        """RMS (n,) of predictions of a window, by polynomials of the other half."""
        missed = []
        for half, used in ((0, self.odd), (1, ~self.odd)):
            robot, rows = replace(self.robot, simulator=self.model(chosen, used)), self.index[half::2]
            predicted = Stepper(robot, self.log).run(self.log.x[rows[:, 0]], rows, idle(robot, self.log))
            missed.append(self._short(self.log.x[rows] - predicted))
        return np.nan_to_num(np.sqrt(np.mean(np.concatenate(missed) ** 2, (0, 1))), nan=np.inf)

    def model(self, chosen, used=slice(None)):
        """The simulator by the steps used."""
        return Recorded(self.robot, [self.fitted(i, *what, used) for i, what in enumerate(chosen)])


def _same_ground(robot, run, log, chosen, path):
    """Refuses a run that does not go where the log goes, in a signal that a rate depends on."""
    names = [s.name for s in (*robot.states, *robot.commands)]
    for i in sorted({j for of, _ in chosen for j in of}, reverse=True):  # commands first: they are what the user can mend
        here, there = run.columns[i], signals(robot, log.x, log.u)[i]
        low, high = here.min(0), here.max(0)
        room = BEYOND * (high - low) + 1e-9
        if ((there < low - room) | (there > high + room)).any(1).mean() > FEW:
            raise UserError(f"{path}: does not follow the log in {names[i]}; record the simulator under the log's commands")


def of(robot, path, log):
    """The robot with a recorded run instead of its simulator, for the diagnosis of a log."""
    robot, whole = replace(robot, outputs=(), parameters=()), robot  # a run needs no column of a further sensor
    recorded = read(path, robot)
    if abs(recorded.dt / log.dt - 1) > 0.01:
        raise UserError(f"{path}: has rows every {recorded.dt:.4g} s, the log every {log.dt:.4g} s; record both at equal steps")
    run, noise = Run(robot, recorded, path), noise_of(log, robot)
    seconds = run.rows * log.dt
    chosen = [run.choose(i, SPARE * noise[i] / seconds) for i in range(len(robot.states))]
    off = run.off(chosen) / noise
    worst = int(np.argmax(off))
    if not off[worst] < OFF:
        raise UserError(
            f"{path}: no surrogate fitted to this run does what the simulator does: {run.rows} steps ahead the best is off by"
            f" {off[worst]:.2g} times the log's noise in {robot.channels[worst].name}; add columns for what is missing of the state,"
            " take noise out of the run, or name the simulator itself in [simulator]"
        )
    _same_ground(robot, run, log, chosen, path)
    model = run.model(chosen)
    names = [s.name for s in (*robot.states, *robot.commands)]
    model.surrogate = {
        "file": printable(path),
        "rows": run.rows,
        "off": {channel.name: float(o) for channel, o in zip(robot.channels, off)},
        "depends_on": {state.name: [names[j] for j in what] for state, (what, _) in zip(robot.states, chosen)},
    }
    return replace(whole, simulator=model, parameters=())
