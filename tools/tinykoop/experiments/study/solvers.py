"""Solvers of the controller's quadratic program, each instead of the library's."""

from dataclasses import replace
from importlib import import_module

import numpy as np

from ... import bridge
from ...bench import qp
from ...plumbing import checkout
from ...plumbing.errors import UserError
from .. import control
from .closed_loop import Stage

# The solver under test decides the first steps, in which runs part; the library's Newton goes on from there.
SOLVER_STEPS = 200


def library(estimator, edit=lambda theta: theta, limit=lambda u: u):
    """The library's solver as a `solver` of Estimator.control, with the model or the input changed on the way."""
    controller = bridge.Controller(control.MPC.settings(), 64, estimator.N)

    def solve(theta, psi, reference):
        solution = controller.solve(edit(theta), psi, reference)
        return limit(solution.plan[0]) if solution.status == 0 else None

    return solve


def peer(name):
    try:
        return import_module(name)
    except ImportError:
        raise UserError(f"the Python package {name} is missing: {checkout.install('test')}")


def daqp_plan(step):
    """(program of qp.Step `step`, plan) by an exact active-set solver; no plan without a usable model."""
    H, f = qp.condense(step)
    low, high = qp.box()
    problem = qp.Problem(H, f, low, high, None, None)
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(f))):
        return problem, None
    u, _, flag, _ = peer("daqp").solve(H, f, np.zeros((0, len(f))), high.copy(), low.copy())
    return problem, u if flag == 1 else None


def daqp_solver():
    """The same as a `solver` of Estimator.control."""

    def solve(theta, psi, reference):
        _, u = daqp_plan(qp.Step(theta, psi, reference))
        return None if u is None else u[:2]

    return solve


def osqp_solver(tolerance=1e-5):
    """An operator-splitting solver at a finite tolerance, as the paper's CVXPY may have called it."""
    osqp, sparse = peer("osqp"), peer("scipy.sparse")  # which osqp needs
    low, high = qp.box()
    box = sparse.eye(len(low), format="csc")

    def solve(theta, psi, reference):
        H, f = qp.condense(qp.Step(theta, psi, reference))
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(f))):
            return None
        problem = osqp.OSQP()
        problem.setup(sparse.csc_matrix(np.triu(H)), f, box, low, high, eps_abs=tolerance, eps_rel=tolerance, verbose=False)
        result = problem.solve(raise_error=False)
        return np.clip(result.x[:2], low[:2], high[:2]) if result.info.status == "solved" else None

    return solve


# name -> the stage that it decides
SOLVERS = {
    "Newton 1e-3": lambda: Stage(SOLVER_STEPS, replace(control.MPC, tolerance=1e-3)),
    "gradient 1e-4": lambda: Stage(SOLVER_STEPS, replace(control.MPC, method=bridge.MPC_GRADIENT, tolerance=1e-4)),
    "DAQP": lambda: Stage(SOLVER_STEPS, solver=daqp_solver()),
    "OSQP 1e-5": lambda: Stage(SOLVER_STEPS, solver=osqp_solver()),
}
NEWTON = "Newton"
