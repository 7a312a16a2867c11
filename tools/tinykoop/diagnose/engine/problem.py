"""The log as a least-squares problem: whitened residuals of windows, their starts eliminated, and columns of effects.

Columns come from the slopes along the nominal windows and cost no pass of the simulator.
"""

from dataclasses import dataclass, field

import numpy as np

from ...plumbing.errors import UserError
from . import effects as library
from .rollouts import FEWEST, Rollouts, RunsAway, longest_run

# Steps in the place of one, by which it is seen whether the simulator's own are short enough; and what that then takes, if its
# error goes with the step.
FINER, LIMIT = 4, 4 / 3
ROWS = 50  # of a window: the longest horizon that is reported
START = 1e3  # spreads of a measured state, by which its start may be off: it is free
HIDDEN = 3.0  # likewise of a hidden one, of the spread that its starts show
SETTLED, TURNS = 0.5, 4  # share of the misfit that a turn of starts may leave, to be followed by another; turns
NEAR = 10.0  # times the noise, by which a turn moves a measured start without more ado
STUCK = 100.0  # times more damping, where a turn gains nothing
FORETELLS, TRIFLE = 0.1, 10.0  # of what causes do, by which the slopes may be off and still serve; and of the cost, in any case
ELSEWHERE, WORSE = 2.0, 1.01  # times its cost, that a misfit has whose starts are elsewhere; times the cost that was reached before


@dataclass(frozen=True)
class Cause:
    """An effect with its parameters."""

    name: str
    params: tuple


@dataclass(frozen=True)
class Fit:
    """Causes and what they leave; cost is its sum of squares, whitened and without the starts."""

    causes: tuple
    cost: float
    left: np.ndarray = field(repr=False, compare=False)
    missed: np.ndarray | None = field(default=None, repr=False, compare=False)  # before it was whitened

    @property
    def names(self):
        return tuple(c.name for c in self.causes)


class Problem:
    """before: causes that act already and are not looked for: what a healthy robot has. Unless `whole` it has no columns of effects."""

    def __init__(self, robot, log, rows, without=(), sigma=None, before=(), whole=True):
        self.robot, self.log, self.before, self.whole = robot, log, (), whole
        self.rollouts = Rollouts(robot, log, rows)
        self.everything = {}
        self.context = library.Context(robot, log)
        self.sigma = self.noise_of(log, robot) if sigma is None else sigma
        self._try()
        self.rollouts.begin()
        self.prior = np.where([bool(s.column) for s in robot.states], START, HIDDEN) * self.rollouts.spread.x
        self.slopes = None
        self.finer, self.shift = 0.0, 0.0  # share of what a shorter step of time would change, that counts as the simulator's
        self.linearise(())
        self.velocities = getattr(robot.simulator, "velocities", None) or velocity_like(self.slopes, log.dt)
        found = library.library(self.context, self.velocities, self.rollouts.spread)
        self.everything = found
        self.effects = {name: effect for name, effect in found.items() if name not in without}
        if before:
            self.before = tuple(before)
            self.linearise(())

    @classmethod
    def of(cls, robot, log, without=(), before=(), whole=True):
        """In windows as long as the simulator stays near the log, ROWS at most."""
        rows = min(ROWS, longest_run(log.usable))
        while True:
            try:
                return cls(robot, log, rows, without, before=before, whole=whole)
            except RunsAway:
                if rows < 2 * FEWEST:
                    raise
                rows //= 2

    def _try(self):
        """The simulator, once from measured states: finite, and the same when asked again."""
        rollouts, action = self.rollouts, self.rollouts.idle()
        u = self.log.u[rollouts.starts]
        once, again = (rollouts.advance(rollouts.x0, u, action) for _ in range(2))
        if not np.isfinite(once).all():
            row = int(np.argmin(np.isfinite(once).all(1)))
            raise UserError(f"the simulator of {self.robot.name} is not finite one step after row {rollouts.starts[row] + 1} of the log")
        if not np.array_equal(once, again):
            raise UserError(f"the simulator of {self.robot.name} gives another answer to the same question; take its random parts out")

    noise_of = staticmethod(lambda log, robot: _differences(log, robot))

    # ---- simulation --------------------------------------------------------------------------------------

    def action(self, causes):
        """What the simulator is given: effects act in the library's order, whichever was found first."""
        action, order = self.rollouts.idle(), list(self.everything)
        for cause in sorted((*self.before, *causes), key=lambda cause: order.index(cause.name)):
            action = self.everything[cause.name].act(cause.params, action, self.context)
        return action

    def linearise(self, causes):
        """Slopes along the windows with `causes`, from starts that are settled first."""
        self.at = self.action(causes)
        self.X, self.Y = self._followed()
        if not self.rollouts.stays(self.X):
            raise RunsAway(f"the simulator of {self.robot.name} runs away from the log within {self.rollouts.rows} rows")
        if self.slopes is not None:
            self._turn()
        self._slope()
        if self._turn():
            self._slope()
        if self.whole:
            self.slopes = self.rollouts.completed(self.slopes, self.X, self.at)
            self._step_finer()

    def foretells(self, fit):
        """Whether the slopes tell what the causes of a fit do: else they are to be taken anew, about these."""
        does = self.columns([fit.causes])[:, 0]
        off = self.whiten(self.rollouts.missed(self.Y)) - does - fit.left
        return off @ off < max(FORETELLS**2 * (does @ does), TRIFLE)

    def follow(self, causes):
        """The windows with `causes`, from starts that are settled by the slopes as they are."""
        self.at = self.action(causes)
        self.X, self.Y = self._followed()
        self._turn()

    def _turn(self):
        """Settles the starts by the slopes as they are; whether that gained much."""
        damping, turns = np.ones(len(self.X)), 0
        while turns < TURNS and self._settle(damping):
            turns += 1
        self.reached = float(self._least(self.rollouts.missed(self.Y)).sum())
        return turns > 0

    def _followed(self):
        """Runs from the starts: states (W, H + 1, n), channels (W, H + 1, c)."""
        with np.errstate(all="ignore"):
            X, Y = self.rollouts.run(self.at)
            return X, Y + self.finer * self.shift

    def _slope(self):
        self.slopes = self.rollouts.slopes(self.X, self.at)
        self._eliminate()

    def _settle(self, damping):
        """Moves the starts by the slopes, in the windows where that gains; whether it gained much in all. damping: (W,)."""
        missed, x0 = self.rollouts.missed(self.Y), self.rollouts.x0
        before = (self._over_noise(missed) ** 2).sum(1)
        if before.sum() < ELSEWHERE * self._least(missed).sum():
            return False
        self.rollouts.x0 = self._settled(missed, damping)
        X, Y = self._followed()
        with np.errstate(all="ignore"):
            after = (self._over_noise(self.rollouts.missed(Y)) ** 2).sum(1)
        gains = after < before
        self.rollouts.x0[~gains] = x0[~gains]
        self.X[gains], self.Y[gains] = X[gains], Y[gains]
        damping[~gains] *= STUCK
        return after[gains].sum() < SETTLED * before.sum()

    def _settled(self, missed, damping=1.0):
        """Starts (W, n) that leave least by the slopes, near those that are: none shall make up for a simulator that is off."""
        near, left = self.prior.copy(), self._over_noise(missed)
        near[self.robot.measured] = NEAR * self.sigma[: len(self.robot.measured)]
        weight = damping * np.maximum(self._least(missed) / np.maximum((left != 0).sum(1), 1), 1.0)
        S = self._S * (near / self.prior)
        gram = np.swapaxes(S, 1, 2) @ S + weight[:, None, None] * np.eye(len(near))
        return self.rollouts.x0 + np.linalg.solve(gram, np.einsum("wri,wr->wi", S, left)[..., None])[..., 0] * near

    def _over_noise(self, missed):
        """Residuals (W, r) in parts of the noise, 0 where nothing was measured."""
        return np.where(np.isfinite(self.rollouts.measured), missed / self.sigma, 0.0).reshape(len(missed), -1)

    def _least(self, missed):
        """Squares (W,) of windows, without what starts can make."""
        return (self.whiten(missed).reshape(len(missed), -1) ** 2).sum(1)

    def _step_finer(self):
        """What shorter steps of time change of the predictions, as long as these change little."""
        self.rollouts.substeps = FINER
        with np.errstate(all="ignore"):
            coarse = self.rollouts.sense(self.X, self.at)
            self.shift = np.nan_to_num(self.rollouts.run(self.at)[1] - coarse)
        self.rollouts.substeps = 1
        self.Y = coarse + self.finer * self.shift

    def _eliminate(self):
        """What of a window's residual its start can make: directions (W, r, n) and by how much each is held back."""
        S = self.sensed(self.slopes.starts()) / self.sigma[None, None, :, None] * self.prior
        S = np.where(np.isfinite(self.rollouts.measured)[..., None], S, 0.0)
        self._S = S.reshape(len(S), -1, S.shape[-1])
        self._U, size, _ = np.linalg.svd(self._S, full_matrices=False)
        self._keep = 1 - 1 / np.sqrt(1 + size**2)
        self.degrees = int(np.isfinite(self.rollouts.measured).sum()) - float((size**2 / (1 + size**2)).sum())

    def sensed(self, Z):
        """Channels of state changes Z (.., n, q)."""
        return np.moveaxis(self.robot.sense(np.moveaxis(Z, -1, 0), np.zeros((Z.shape[-1], *Z.shape[:-2], len(self.robot.commands)))), 0, -1)

    # ---- residuals -----------------------------------------------------------------------------------------

    def whiten(self, missed):
        """Residuals (W, H + 1, c) or (W, H + 1, c, q) as (n,) or (n, q) of unit variance, without what starts can make."""
        columns = missed if missed.ndim == 4 else missed[..., None]
        scaled = np.where(np.isfinite(self.rollouts.measured)[..., None], columns, 0.0) / self.sigma[:, None]
        flat = scaled.reshape(len(scaled), -1, scaled.shape[-1])
        along = self._keep[..., None] * np.einsum("wri,wrq->wiq", self._U, flat)
        flat = flat - self._U @ along
        return flat.reshape(-1, flat.shape[-1]) if missed.ndim == 4 else flat.reshape(-1)

    def fit_of(self, causes, action=None):
        """The Fit of causes, or of what stands for them, by one pass, or by two where its starts are elsewhere."""
        causes, action = tuple(causes), action or self.action(causes)
        fit = self._fit(causes, action, self.rollouts.x0)
        if WORSE * self.reached < fit.cost < np.inf and np.nansum((fit.missed / self.sigma) ** 2) > ELSEWHERE * fit.cost:
            other = self._fit(causes, action, self._settled(fit.missed))
            fit = other if other.cost < fit.cost else fit
        return fit

    def _fit(self, causes, action, x0):
        """The Fit from starts x0."""
        with np.errstate(all="ignore"):
            try:
                missed = self.rollouts.missed(self.rollouts.run(action, x0)[1] + self.finer * self.shift)
            except RunsAway:
                missed = np.full(self.rollouts.measured.shape, np.inf)
        if not np.isfinite(np.where(np.isfinite(self.rollouts.measured), missed, 0.0)).all():
            return Fit(causes, np.inf, np.full(self.rollouts.measured.size, np.inf), missed)
        return self.whitened(causes, missed)

    def whitened(self, causes, missed):
        """The Fit of causes that miss this much, by the noise as it is known now."""
        left = self.whiten(missed)
        return Fit(causes, float(left @ left), left, missed)

    # ---- noise -----------------------------------------------------------------------------------------------

    def learn_noise(self, left, columns):
        """Scales sigma by what is left of each channel once `columns` (n, q) have taken all that they can."""
        unit = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
        values, vectors = np.linalg.eigh(unit.T @ unit)  # quicker than a decomposition of so many rows
        keep = values > 1e-8 * values[-1]
        basis = unit @ (vectors[:, keep] / np.sqrt(values[keep]))
        rest = (left - basis @ (basis.T @ left)).reshape(self.rollouts.measured.shape)
        seen = np.isfinite(self.rollouts.measured)
        degrees = seen.sum((0, 1)) * (self.degrees - basis.shape[1]) / seen.sum()
        self.sigma = self.sigma * np.sqrt((rest**2).sum((0, 1)) / np.maximum(degrees, 1))
        self._eliminate()

    # ---- columns without a pass ------------------------------------------------------------------------------

    def pushes(self, actions):
        """What actions add to each step of the linearised windows (W, H, n, q)."""
        index = self.rollouts.index[:, :-1]
        x, u = self.X[:, :-1], self.at.u[index]
        W, H, n = x.shape
        out = np.zeros((W, H, n, len(actions)))
        for q, action in enumerate(actions):
            if action.u is not self.at.u:
                out[..., q] += np.einsum("whnm,whm->whn", self.slopes.B, action.u[index] - u)
            if len(action.params):
                out[..., q] += self.slopes.G @ (action.params - self.at.params)
            out[..., q] += self.slopes.C * (action.clock - self.at.clock)
            for push, sign in ((action.push, 1), (self.at.push, -1)):
                if push is not None and action.push is not self.at.push:
                    flat = push(x.reshape(-1, n), u.reshape(W * H, -1))
                    out[..., q] += sign * (self.slopes.F @ np.broadcast_to(flat, (W * H, n)).reshape(W, H, n, 1))[..., 0]
        return out

    def generic(self):
        """What pushes by plain functions of states and commands make of the channels (W, H + 1, c, q); names them."""
        pushed = self.velocities or range(len(self.robot.states))
        u = self.at.u[self.rollouts.index[:, :-1]]
        found = features(self.robot, self.log, self.X[:, :-1], u, self.rollouts.spread)
        W, H, n = self.X[:, :-1].shape
        self.generic_names = [(name, self.robot.states[i].name) for name, _ in found for i in pushed]
        out = np.zeros((W, H, n, len(self.generic_names)))
        for q, (values, i) in enumerate((values, i) for _, values in found for i in pushed):
            out[:, :, i, q] = values * GENERIC * self.rollouts.spread.x[i]
        return self.sensed(self.slopes.carry(self.slopes.F @ out))

    def columns(self, trials):
        """Whitened columns (n, q): how predictions change from the linearised ones to those of each trial's causes."""
        actions = [self.action(causes) for causes in trials]
        Z = self.slopes.carry(self.pushes(actions))
        out = np.empty((*self.Y.shape, len(actions)))
        for q, action in enumerate(actions):
            X = self.X + Z[..., q]
            out[..., q] = self.rollouts.sense(X, action) + self.finer * self.shift - self.Y
        return self.whiten(out)


GENERIC = 2.0  # spreads of a signal in a second, that a generic push makes


def features(robot, log, x, u, spread):
    """[(what it is of, values (W, H))]: plain functions of states and commands, of size one."""
    named = [("constant", np.ones(x.shape[:2]))]
    angles = [i for i, s in enumerate(robot.states) if s.wraps]
    signals = [(s.name, x[..., i] / spread.x[i]) for i, s in enumerate(robot.states) if i not in angles]
    signals += [(s.name, u[..., j] / spread.u[j]) for j, s in enumerate(robot.commands)]
    for i in angles:
        named += [(f"sin {robot.states[i].name}", np.sin(x[..., i])), (f"cos {robot.states[i].name}", np.cos(x[..., i]))]
    for name, v in signals:
        named += [(name, v), (f"{name} |{name}|", v * np.abs(v)), (f"sign of {name}", np.tanh(v / 0.1))]
    for a, (one, v) in enumerate(signals):
        named += [(f"{one} {two}", v * w) for two, w in signals[a + 1 :]]
    return named


def _differences(log, robot):
    """Standard deviation (c,) of each channel's noise: of its third differences where motion is smooth, an upper bound."""
    out = []
    for c, channel in enumerate(robot.channels):
        y = np.unwrap(log.y[:, c]) if channel.wraps else log.y[:, c]
        d = np.diff(y, 3)
        d = d[np.isfinite(d)]
        size = np.median(np.abs(d - np.median(d))) / 0.6745 / np.sqrt(20) if len(d) else 0.0
        out.append(max(size, 1e-6 * np.nanmax(np.abs(y)), 1e-12))
    return np.array(out)


def velocity_like(slopes, dt):
    """States that are the rate of another: one step moves that by dt per unit, whatever the state."""
    n = slopes.A.shape[2]
    moves = np.mean(np.abs(slopes.A / dt - 1) < 0.2, axis=(0, 1)) > 0.8  # (n, n): [moved, by]
    return [i for i in range(n) if moves[[q for q in range(n) if q != i], i].any()]
