"""Windows of a log, each followed by the simulator from a start of its own, and the simulator's slopes along them."""

from dataclasses import dataclass, replace

import numpy as np

from ...plumbing.errors import UserError

FEWEST = 8  # rows of a window
ENOUGH = 8  # windows, of which a further one may be left out
STEP = 1e-4  # of a signal's spread, by which slopes are taken
STILL = 1e-6  # of slopes: what is less is none
AWAY = 1e3  # spreads of a signal, beyond which a run has left the log


class RunsAway(UserError):
    """The simulator does not stay near the log for a whole window."""


@dataclass(frozen=True)
class Action:
    """What effects do to a simulator: commands (K, m) instead of the log's, parameters (p,), a push and the clock.

    push(x, u) gives what is added to the derivative of the states (B, n), or is None.
    """

    u: np.ndarray
    params: np.ndarray
    push: object = None
    clock: float = 1.0
    outputs: tuple = ()  # functions of (channels (W, H + 1, c), rows (W, H + 1), dt) applied in turn

    def pushed(self, more):
        """With one push more."""
        before = self.push
        return replace(self, push=more if before is None else lambda x, u: before(x, u) + more(x, u))


def cut(usable, rows):
    """First rows (W,) of windows of `rows` usable transitions in a row.

    Nobody knows what the actuators did before a run of rows began: its first window is left out where enough others are there.
    """
    starts, first, run = [], [], 0
    for k, good in enumerate(usable):
        run = run + 1 if good else 0
        if run and run % rows == 0:
            starts.append(k + 1 - rows)
            first.append(run == rows)
    starts, later = np.array(starts, int), ~np.array(first, bool)
    return starts[later] if later.sum() >= ENOUGH else starts


def longest_run(usable):
    """Usable transitions in a row."""
    run, longest = 0, 0
    for good in usable:
        run = run + 1 if good else 0
        longest = max(longest, run)
    return longest


class Rollouts:
    """The windows of one log."""

    def __init__(self, robot, log, rows):
        self.robot, self.log, self.rows = robot, log, rows
        self.substeps = 1
        self.still = ()  # states whose change stays as it is and moves no other, as a place on a floor: seen by the first slopes
        self.spread = _spread(log)
        self.put(cut(log.usable, rows))

    def put(self, starts):
        """Windows that begin in these rows (W,)."""
        self.starts = starts
        self.index = starts[:, None] + np.arange(self.rows + 1)  # (W, H + 1)
        self.measured = self.log.y[self.index]  # (W, H + 1, c)
        self.x0 = np.nan_to_num(self.log.x[starts])

    def begin(self):
        """Hidden states start as a run leaves them in the window before, at its end, and have the spread of such ends."""
        hidden = [i for i, signal in enumerate(self.robot.states) if not signal.column]
        if not hidden:
            return
        with np.errstate(all="ignore"):
            ends = self.run(self.idle())[0][:, -1, hidden]
        if not np.isfinite(ends).all():
            return
        self.x0[:, hidden] = ends.mean(0)
        follows = np.flatnonzero(np.diff(self.starts) == self.rows) + 1
        self.x0[np.ix_(follows, hidden)] = ends[follows - 1]
        self.spread.x[hidden] = [_reach(end) or 1.0 for end in ends.T]

    def idle(self):
        """Nothing acts."""
        return Action(self.log.u, self.robot.nominal)

    def advance(self, x, u, action):
        """One row of time, in `substeps` steps."""
        dt, simulator = self.log.dt * action.clock / self.substeps, self.robot.simulator
        if self.substeps > 1 and hasattr(simulator, "finer"):  # else it takes its own steps in each of ours
            simulator = simulator.finer(self.substeps)
        self.log.work.rows += self.substeps * len(x)
        for _ in range(self.substeps):
            push = None if action.push is None else np.broadcast_to(action.push(x, u), x.shape)
            if hasattr(simulator, "velocities"):  # its own forces answer a push
                x = simulator.step(x, u, dt, action.params, push)
            else:
                after = simulator.step(x, u, dt, action.params)
                x = after if push is None else after + dt * push
        return x

    def run(self, action, x0=None):
        """(states (W, H + 1, n), channels (W, H + 1, c)) from the starts."""
        U = action.u[self.index]
        X = np.empty((*self.index.shape, self.x0.shape[1]))
        X[:, 0] = self.x0 if x0 is None else x0
        for k in range(self.rows):
            X[:, k + 1] = self.advance(X[:, k], U[:, k], action)
        return X, self.sense(X, action)

    def stays(self, X):
        """Whether runs X (W, H + 1, n) stay in the reach of the log."""
        seen = self.robot.measured
        return bool(np.isfinite(X).all() and (np.abs(X - self.x0[:, None]) < AWAY * self.spread.x)[..., seen].all())

    def sense(self, X, action):
        Y = self.robot.sense(X, action.u[self.index])
        for output in action.outputs:
            Y = output(Y, self.index, self.log.dt)
        return Y

    def missed(self, Y):
        """Measured less predicted (W, H + 1, c), angles by the short way; NaN where nothing was measured."""
        left = self.measured - Y
        for c, channel in enumerate(self.robot.channels):
            if channel.wraps:
                left[..., c] = (left[..., c] + np.pi) % (2 * np.pi) - np.pi
        return left

    def slopes(self, X, action):
        """The Slopes of one step along the runs X (W, H + 1, n): to states only."""
        n, still = X.shape[2], self.still if action.push is None else ()
        unit = np.broadcast_to(np.eye(n), (len(self.starts), self.rows, n, n))
        A = np.stack([unit[..., i] if i in still else self._slope(X, action, "x", i) for i in range(n)], -1)
        self.still = self.still or tuple(np.flatnonzero(np.abs(A - unit).max((0, 1, 2)) < STILL))
        return Slopes(A)

    def completed(self, slopes, X, action):
        """Slopes to commands, parameters, clock and pushes, too."""
        B = np.stack([self._slope(X, action, "u", j) for j in range(action.u.shape[1])], -1)
        G = [self._slope(X, action, "p", i) for i in range(len(action.params))]
        G = np.stack(G, -1) if G else np.zeros((*B.shape[:3], 0))
        F = self.log.dt * np.broadcast_to(np.eye(X.shape[2]), slopes.A.shape)
        for i in getattr(self.robot.simulator, "velocities", ()):
            F = np.where(np.arange(X.shape[2]) == i, self._slope(X, action, "push", i)[..., None], F)
        return Slopes(slopes.A, B, G, self._slope(X, action, "clock", 0), F)

    def _slope(self, X, action, what, i):
        """d step / d element i of x, u, parameters, clock or push along the runs X, (W, H, n), by one pass."""
        x, u = X[:, :-1].reshape(-1, X.shape[2]).copy(), action.u[self.index[:, :-1]].reshape(-1, action.u.shape[1])
        params, clock = action.params.copy(), action.clock
        if what == "x":
            h = STEP * self.spread.x[i]
            x[:, i] += h
        elif what == "u":
            h = STEP * self.spread.u[i]
            u[:, i] += h
        elif what == "p":
            h = STEP * abs(self.robot.parameters[i].usual)
            params[i] += h
        elif what == "clock":
            h = STEP
            clock += h
        else:
            h = STEP * self.spread.x[i] / self.log.dt
            unit = np.eye(X.shape[2])[i]
            action = action.pushed(lambda x, u: h * unit)
        moved = self.advance(x, u, Action(action.u, params, action.push, clock))
        return (moved.reshape(X[:, 1:].shape) - X[:, 1:]) / h


@dataclass(frozen=True)
class Slopes:
    """Of one step: to states A (W, H, n, n), commands B (.., m), parameters G (.., p), clock C (W, H, n), pushes F (.., n)."""

    A: np.ndarray
    B: np.ndarray | None = None
    G: np.ndarray | None = None
    C: np.ndarray | None = None
    F: np.ndarray | None = None

    def carry(self, pushes):
        """What pushes (W, H, n, q), added to each step, make of the states (W, H + 1, n, q)."""
        W, H, n, q = pushes.shape
        Z = np.zeros((W, H + 1, n, q))
        for k in range(H):
            Z[:, k + 1] = self.A[:, k] @ Z[:, k] + pushes[:, k]
        return Z

    def starts(self):
        """What the start makes of the states (W, H + 1, n, n)."""
        W, H, n, _ = self.A.shape
        S = np.empty((W, H + 1, n, n))
        S[:, 0] = np.eye(n)
        for k in range(H):
            S[:, k + 1] = self.A[:, k] @ S[:, k]
        return S


@dataclass(frozen=True)
class Spread:
    x: np.ndarray  # (n,)
    u: np.ndarray  # (m,)


def _spread(log):
    """How far signals reach: never 0, as steps are taken in parts of it; 1 where nothing measures a state."""
    x, u = (np.array([_reach(column) for column in signals.T]) for signals in (log.x, log.u))
    return Spread(np.where(np.isfinite(x) & (x > 0), x, 1.0), np.where(u > 0, u, 1.0))


def _reach(values):
    seen = values[np.isfinite(values)]
    return np.abs(seen - seen.mean()).max() if len(seen) else np.nan
