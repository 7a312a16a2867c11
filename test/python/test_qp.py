"""The controller on steps recorded in closed loop, against the program written out densely in NumPy."""

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.bench import qp
from tinykoop.experiments import control, scenario

METHODS = [scenario.Method("rbf", name) for name in ("offline", "dz_cs", "dz_ks", "ct", "sift")]


@pytest.fixture(scope="module")
def instances():
    """Each method on the path, and off it, where the bounds are active."""
    found = []
    for method in METHODS:
        found += qp.instances(method, tracking=range(100, 1000, 200), starts=qp.STARTS[::3], recovery=range(1, 20, 4))
    return found


def controller(precision):
    return bridge.Controller(bridge.Mpc().settings(), precision, 22)


def solve(controller, step):
    """A cold solve: (Solution, u)."""
    controller.reset()
    solution = controller.solve(step.theta, step.psi, step.reference)
    assert solution.status == 0
    return solution, solution.plan.ravel()


def test_bounds_are_active(instances):
    """Else the comparisons below would say nothing about the box."""
    active = [np.count_nonzero(i.problem.multipliers) for i in instances if i.kind == "recovery"]
    assert min(active) < 5 and max(active) > 95 and len(set(active)) > 10


def test_reference_solution_is_the_minimum(instances):
    """No feasible point near it or far from it costs less, whatever its multipliers say."""
    rng = np.random.default_rng(1)
    for instance in instances[::7]:
        p = instance.problem
        for size in (1e-4, 1e-2, 1):
            step = np.clip(p.u + size * rng.standard_normal((50, len(p.u))), p.low, p.high) - p.u
            rise = step @ (p.H @ p.u + p.f) + np.sum(step @ p.H * step, axis=1) / 2
            assert np.all(rise >= 0)


def test_dense_program_is_the_cost_of_the_simulated_model(instances):
    """1/2 u' H u + f' u against the paper's sum along the model's own trajectory."""
    rng, mpc = np.random.default_rng(2), control.MPC
    for instance in instances[::7]:
        step, p = instance.step, instance.problem

        def cost(u):
            psi, total = step.psi, 0.0
            for k, inputs in enumerate(u.reshape(mpc.horizon, 2)):
                psi = step.theta @ np.concatenate([psi, inputs])
                total += np.array(mpc.q) @ (psi[:3] - step.reference[k]) ** 2 + np.array(mpc.r) @ inputs**2
            return total

        u = rng.uniform(p.low, p.high)
        dense = u @ p.H @ u + 2 * p.f @ u
        assert np.isclose(dense, cost(u) - cost(np.zeros(len(u))), rtol=1e-8)


@pytest.mark.parametrize("start", ["cold", "warm"])
def test_newton_agrees_with_the_reference(instances, start):
    c = controller(64)
    for instance in instances:
        if start == "warm":
            solve(c, instance.step_before)
            plan = c.solve(instance.step.theta, instance.step.psi, instance.step.reference).plan.ravel()
        else:
            plan = solve(c, instance.step)[1]
        error = np.max(np.abs(plan - instance.problem.u))
        assert error < 1e-8


def test_gradient_agrees_with_the_reference(instances):
    """At a tolerance below the library's own: cond(H) turns what is left of the residual into an error of u."""
    c = bridge.Controller(bridge.Mpc(method=bridge.MPC_GRADIENT, tolerance=1e-11).settings(), 64, 22)
    for instance in instances:
        error = np.max(np.abs(solve(c, instance.step)[1] - instance.problem.u))
        assert error < 1e-8


@pytest.mark.parametrize("method", [bridge.MPC_NEWTON, bridge.MPC_GRADIENT])
def test_reported_residual_is_that_of_the_dense_program(instances, method):
    """Also where a solve stops early."""
    for tolerance in (0.0, 1e-3, 1e-1):
        c = bridge.Controller(bridge.Mpc(method=method, tolerance=tolerance).settings(), 64, 22)
        for instance in instances[::6]:
            solution, plan = solve(c, instance.step)
            assert np.isclose(solution.residual, qp.residual(instance.problem, plan), rtol=1e-6, atol=1e-10)


def test_float32(instances):
    """Without the steps of the offline model off the path: it is lost there, and predicts figures that float32
    holds so badly that rounding the data alone costs 2e-3."""
    c = controller(32)
    for instance in instances:
        if (instance.method.regulator, instance.kind) != ("offline", "recovery"):
            error = np.max(np.abs(solve(c, instance.step)[1] - instance.problem.u))
            assert error <= 1e-3
