"""The controller's quadratic program written out in NumPy, on steps recorded in closed loop.

    minimise 1/2 u' H u + f' u   over   low <= u <= high

u holds the inputs over the horizon, first input first. Nothing here is shared with the library: H and f
come from simulated unit inputs, and a solution counts only with its optimality conditions verified.
"""

from dataclasses import dataclass

import numpy as np

from .. import bridge
from ..experiments import control, scenario
from ..plumbing.errors import UserError

# Steps that are kept of each run, and where the runs begin. On the path hardly a bound is ever active, so
# most steps come from runs that start 1 m off it.
TRACKING = range(50, control.STEPS, 100)
RECOVERY = range(1, 21, 2)
STARTS = ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))  # off the path (m, m, rad)


@dataclass(frozen=True)
class Step:
    """What the controller is given at one step: theta (N, N+2), psi (N), reference (horizon, 3)."""

    theta: np.ndarray
    psi: np.ndarray
    reference: np.ndarray


@dataclass(frozen=True)
class Problem:
    """The dense program of one step and its solution."""

    H: np.ndarray
    f: np.ndarray
    low: np.ndarray
    high: np.ndarray
    u: np.ndarray
    multipliers: np.ndarray  # gradient of the cost where a bound is active: >= 0 at low, <= 0 at high


@dataclass(frozen=True)
class Instance:
    """A recorded step and the one before it, each with its program."""

    method: scenario.Method
    kind: str  # "tracking" or "recovery"
    step_before: Step
    step: Step
    before: Problem
    problem: Problem


def record(method, steps, start=(0.0, 0.0, 0.0), active=()):
    """[(step k - 1, step k) for k in steps] of a float64 run of `method` that begins `start` off the reference."""
    estimator, _ = scenario.run(method, 64, *scenario.drive())
    controller = bridge.Controller(control.MPC.settings(), 64, estimator.N)
    seen = []

    def solver(theta, psi, reference):
        seen.append(Step(theta.copy(), psi.copy(), reference.copy()))
        solution = controller.solve(theta, psi, reference)
        return solution.plan[0] if solution.status == 0 else None

    path = control.reference_path()
    estimator.control(
        control.MPC, path, scenario.DT, max(steps) + 1, path[0] + start, active,
        learn=method.regulator != "offline", solver=solver,
    )  # fmt: skip
    return [(seen[k - 1], seen[k]) for k in steps]


def instances(method, tracking=TRACKING, starts=STARTS, recovery=RECOVERY):
    """Instances of one method: steps of the paper's run, and of runs that start off the path."""
    pairs = [("tracking", pair) for pair in record(method, tracking, active=scenario.effects(control.EDGES))]
    pairs += [("recovery", pair) for start in starts for pair in record(method, recovery, start)]
    return [Instance(method, kind, *pair, *map(write_out, pair)) for kind, pair in pairs]


def condense(step, mpc=control.MPC):
    """H (2 h, 2 h) and f (2 h): the model is run forward from psi, and from 0 under each unit input."""
    h, N = mpc.horizon, len(step.psi)
    A, B = step.theta[:, :N], step.theta[:, N:]
    Q, R = np.diag(mpc.q), np.diag(mpc.r)
    free, forced = step.psi, np.zeros((N, 2 * h))
    H, f = np.kron(np.eye(h), R), np.zeros(2 * h)
    for k in range(h):
        free, forced = A @ free, A @ forced
        forced[:, 2 * k : 2 * k + 2] += B
        H += forced[:3].T @ Q @ forced[:3]
        f += forced[:3].T @ Q @ (free[:3] - step.reference[k])
    return (H + H.T) / 2, f


def box(mpc=control.MPC):
    """low (2 h) and high (2 h)."""
    return np.tile(mpc.u_min, mpc.horizon), np.tile(mpc.u_max, mpc.horizon)


def write_out(step, mpc=control.MPC):
    """The Problem of one step."""
    H, f = condense(step, mpc)
    low, high = box(mpc)
    return Problem(H, f, low, high, *solve(H, f, low, high))


def solve(H, f, low, high):
    """u and multipliers, to the last digits of float64.

    DAQP proposes which bounds are active; the free inputs then solve their linear system, refined in
    long double, and the sign of every multiplier and the box are verified. H is positive definite, so
    what passes is the only solution, whoever proposed it.
    """
    import daqp

    guess = daqp.solve(H, f, np.zeros((0, len(f))), high.copy(), low.copy())[0]
    H, f, u = H.astype(np.longdouble), f.astype(np.longdouble), guess.astype(np.longdouble)
    wanted = u - (H @ u + f) / np.diag(H)
    u = np.where(wanted <= low, low, np.where(wanted >= high, high, u))
    free = (wanted > low) & (wanted < high)
    inverse = np.linalg.inv(H[np.ix_(free, free)].astype(float))
    for _ in range(10):
        u[free] -= inverse @ (H[free] @ u + f[free]).astype(float)
    gradient = H @ u + f
    multipliers = np.where(free, 0, gradient)
    optimal = [
        np.all(np.abs(gradient[free]) <= 1e-12 * np.max(np.abs(f))),
        np.all((u >= low) & (u <= high)),
        np.all(multipliers[u <= low] >= 0) and np.all(multipliers[u >= high] <= 0),
    ]
    if not all(optimal):
        raise UserError("the reference solution of a recorded step does not meet its optimality conditions")
    return u.astype(float), multipliers.astype(float)


def residual(problem, u):
    """KKT residual as tinykoop_api.h defines it: the largest step of a gradient step scaled by H's diagonal."""
    step = np.clip(u - (problem.H @ u + problem.f) / np.diag(problem.H), problem.low, problem.high)
    return np.max(np.abs(u - step))


def shift(values):
    """Inputs or multipliers one step on; the last stands for two."""
    return np.concatenate([values[2:], values[-2:]])
