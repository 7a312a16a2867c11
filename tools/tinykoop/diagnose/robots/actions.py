"""What effects do to a simulator, and one step of it with that, from any rows of a log at once."""

from dataclasses import dataclass, replace

import numpy as np

from ...plumbing.errors import UserError
from ..robot import RunsAway


@dataclass(frozen=True)
class Action:
    """Row by row: commands (K, m) instead of the log's, parameters (K, p), how fast time goes (K,), and functions.

    pushes: (x (B, n), u (B, m), rows (B,)) -> what is added to rates (B, n). readings: (library.Reading, rows (K,) in which it acts).
    """

    u: np.ndarray
    params: np.ndarray
    clock: np.ndarray
    pushes: tuple = ()
    readings: tuple = ()

    def pushed(self, push):
        """With a push (x, u) -> (B, n) more."""
        return replace(self, pushes=(*self.pushes, lambda x, u, rows: push(x, u)))

    def sensed(self, reading):
        """With a sensor that reads otherwise."""
        return replace(self, readings=(*self.readings, (reading, np.ones(len(self.u), bool))))

    def within(self, on, after):
        """As `after`, an action made of this one, in the rows `on` (K,); as this one elsewhere."""
        some = lambda a, b: np.where(on.reshape(-1, *[1] * (a.ndim - 1)), b, a)  # noqa: E731
        pushes = tuple(lambda x, u, rows, f=f: on[rows, None] * f(x, u, rows) for f in after.pushes[len(self.pushes) :])
        readings = tuple((reading, on & before) for reading, before in after.readings[len(self.readings) :])
        return Action(
            some(self.u, after.u), some(self.params, after.params), some(self.clock, after.clock),
            self.pushes + pushes, self.readings + readings,
        )  # fmt: skip


def idle(robot, log):
    """Nothing acts."""
    K = len(log.t)
    return Action(log.u, np.tile(robot.nominal, (K, 1)), np.ones(K))


class Stepper:
    """One robot's simulator along one log."""

    def __init__(self, robot, log):
        self.robot, self.log = robot, log

    def push(self, x, rows, action):
        """What is added to rates (B, n), or None."""
        u = action.u[rows]
        return sum(np.broadcast_to(push(x, u, rows), x.shape) for push in action.pushes) if action.pushes else None

    def step(self, x, rows, action, parts=1):
        """States (B, n) one row after x (B, n) in these rows (B,) of the log, in so many parts."""
        if not len(rows):
            return x
        kinds, which = _alike(action, rows)
        if len(kinds) == 1:
            return self._step(x, rows, action, parts)
        out = np.empty_like(x)
        for k in range(len(kinds)):
            out[which == k] = self._step(x[which == k], rows[which == k], action, parts)
        return out

    def _step(self, x, rows, action, parts):
        simulator, u, params = self.robot.simulator, action.u[rows], action.params[rows[0]]
        dt = self.log.dt * float(action.clock[rows[0]]) / parts
        simulator = simulator.finer(parts) if parts > 1 and hasattr(simulator, "finer") else simulator
        self.log.work.rows += parts * len(x)
        for _ in range(parts):
            push = self.push(x, rows, action)
            if hasattr(simulator, "velocities"):  # its own forces answer a push
                x = simulator.step(x, u, dt, params, push)
            else:
                after = simulator.step(x, u, dt, params)
                x = after if push is None else after + dt * push
        return x

    def run(self, x, rows, action, parts=1):
        """States (B, H + 1, n) from x (B, n) along these rows (B, H + 1) of the log."""
        out = np.empty((*rows.shape, x.shape[1]))
        out[:, 0] = x
        with np.errstate(all="ignore"):
            for k in range(rows.shape[1] - 1):
                try:
                    out[:, k + 1] = self.step(out[:, k], rows[:, k], action, parts)
                except RunsAway:
                    out[:, k + 1 :] = np.nan
                    break
        return out

    def tried(self, x, rows, action):
        """One step, which must be finite and the same when asked again."""
        with np.errstate(all="ignore"):
            once, again = (self.step(x, rows, action) for _ in range(2))
        if not np.isfinite(once).all():
            row = int(rows[np.argmin(np.isfinite(once).all(1))])
            raise UserError(f"the simulator of {self.robot.name} is not finite one step after row {row + 1} of the log")
        if not np.array_equal(once, again):
            raise UserError(
                f"the simulator of {self.robot.name} is not deterministic: two calls with the same arguments differ; remove its random parts"
            )
        return once


def _alike(action, rows):
    """(kinds, which (B,)): rows with other parameters, or another clock, are other questions to a simulator."""
    values = np.column_stack([action.clock[rows], action.params[rows]])
    if not len(values) or (values == values[0]).all():
        return [0], np.zeros(len(rows), int)
    kinds, which = np.unique(values, axis=0, return_inverse=True)
    return kinds, which.reshape(-1)
