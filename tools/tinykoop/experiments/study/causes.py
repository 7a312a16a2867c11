"""Why vanilla Poly fails: interventions on each suspect, rescues, and two runs that part."""

import numpy as np

from ... import bridge
from ...bench import qp
from ...plumbing.results import progress
from .. import control, scenario
from . import solvers
from .bistability import RESET_P0
from .closed_loop import FAILED, SIGMA, Stage, count, outcome, shifted, starts
from .sensitivities import AHEAD, plant_sensitivities, sensitivities
from .solvers import daqp_plan, daqp_solver, library

RADIUS = 1.02  # of A, at most, where it is capped: 1.02^50 = 2.7; that of the robot is 1
LAMBDA = 0.98
TWIN_DISTANCE = 1e-6  # (m, m, rad)
TWIN_STEPS = 120
SETTLED = 400  # a run that has failed is rescued from here on


def capped(theta):
    """Theta with every eigenvalue of A at most RADIUS in size."""
    N = len(theta)
    w, V = np.linalg.eig(theta[:, :N])
    if np.max(np.abs(w)) <= RADIUS:
        return theta
    A = (V * (w * np.minimum(1, RADIUS / np.abs(w)))) @ np.linalg.inv(V)
    return np.hstack([A.real, theta[:, N:]])


def pushed(u):
    """At least 0.5 m/s: the robot is never without excitation."""
    return np.array([max(u[0], 0.5), u[1]])


VANILLA = scenario.Method("poly", "ef")
BOUNDED = scenario.Method("poly", "ct")


def _whole(scene, offset, prepare=lambda estimator: None, **changes):
    estimator = scene.learned(VANILLA)
    prepare(estimator)
    return scene.track(estimator, offset, (Stage(control.STEPS, solver=library(estimator, **changes)),))


def relearned(estimator, covariance, unit=1.0):
    """A `solver` that learns on its own: vanilla forgetting in NumPy from this P, with px^2 measured in `unit`."""
    controller = bridge.Controller(control.MPC.settings(), 64, estimator.N)
    theta, P, last = estimator.theta, covariance.copy(), None
    scale = np.ones(estimator.d)
    scale[3] = 1 / unit

    def solve(_, psi, reference):
        nonlocal theta, P, last
        if last is not None:
            zeta = last * scale
            gain = P @ zeta
            share = LAMBDA + zeta @ gain
            theta = theta + np.outer(psi - theta @ last, gain / share * scale)
            P = (P - np.outer(gain, gain) / share) / LAMBDA
        solution = controller.solve(theta, psi, reference)
        u = solution.plan[0] if solution.status == 0 else np.zeros(2)
        last = np.concatenate([psi, u])
        return u

    return solve


def _relearn(scene, offset, reset=False, **unit):
    estimator = scene.learned(VANILLA)
    P = RESET_P0 * np.eye(estimator.d) if reset else estimator.covariance
    return scene.track(estimator, offset, (Stage(control.STEPS, solver=relearned(estimator, P, **unit), learn=False),))


def _begin(scene, offset, first, method=VANILLA):
    return scene.track(scene.learned(method), offset, (first, Stage(control.STEPS - first.steps)))


def _paper_commands(steps):
    commands = iter(scenario.commands(steps))
    return Stage(steps, solver=lambda theta, psi, reference: next(commands))


def _crossed(scene, offset, model, covariance):
    estimator = scene.learned(covariance)
    estimator.theta = scene.learned(model).theta
    return scene.track(estimator, offset)


def _far(scene, offset):
    return scene.track(scene.learned(VANILLA), offset, origin=(*scene.x[-1, :2], 0))


# What is changed about vanilla Poly, from equal starts. An innocent suspect leaves the count as it is.
INTERVENTIONS = {
    "nothing": lambda s, o: s.track(s.learned(VANILLA), o),
    "nothing, learner in NumPy": lambda s, o: _relearn(s, o),
    "exact solver (DAQP)": lambda s, o: _begin(s, o, Stage(solvers.SOLVER_STEPS, solver=daqp_solver())),
    "v at least 0.5 m/s": lambda s, o: _whole(s, o, limit=pushed),
    "continued at $p_x$ = 320 m": _far,
    "model held, 10 steps": lambda s, o: _begin(s, o, Stage(10, learn=False)),
    "paper's commands, 20 steps": lambda s, o: _begin(s, o, _paper_commands(20)),
    "P of CT": lambda s, o: _crossed(s, o, VANILLA, BOUNDED),
    "$\\Theta$ of CT": lambda s, o: _crossed(s, o, BOUNDED, VANILLA),
    "radius of A capped": lambda s, o: _whole(s, o, edit=capped),
    "P reset": lambda s, o: _whole(s, o, lambda e: e.reset_covariance(RESET_P0)),
    "P reset, radius capped": lambda s, o: _whole(s, o, lambda e: e.reset_covariance(RESET_P0), edit=capped),
    "P reset, $p_x^2$ in (100 m)$^2$": lambda s, o: _relearn(s, o, reset=True, unit=1e4),
}


def interventions(scene, runs):
    """Rows of the study "intervention", vanilla Poly."""
    rows = []
    for name, run in progress(list(INTERVENTIONS.items()), "interventions"):
        figures = count([run(scene, offset) for offset in starts(SIGMA, runs)])
        rows.append({"study": "intervention", "changed": name, **figures})
    return rows


def rescue(scene, runs):
    """Rows of the study "rescue": what is done at SETTLED to runs that stand still by then."""
    standing = []
    for offset in starts(SIGMA, runs):
        trace = scene.track(scene.learned(VANILLA), offset, (Stage(SETTLED),))
        if np.all(trace["u"][-100:, 0] < 1e-9):
            standing.append(offset)
    rows = []
    for name, steps, changes in (
        ("nothing", 0, {}),
        ("radius of A capped", control.STEPS - SETTLED, {"edit": capped}),
        ("v at least 0.5 m/s for 5 s", 100, {"limit": pushed}),
    ):
        rescued = 0
        for offset in standing:
            estimator = scene.learned(VANILLA)
            middle = Stage(steps, solver=library(estimator, **changes))
            stages = (Stage(SETTLED), middle, Stage(control.STEPS - SETTLED - steps))
            stages = [stage for stage in stages if stage.steps]
            rescued += bool(scene.track(estimator, offset, stages)["error"][-500:].mean() < FAILED)
        rows.append({"study": "rescue", "done": name, "standing": len(standing), "rescued": rescued})
    return rows


def exactly(scene, method, offset):
    """A run whose first steps an exact solver decides, with every=1."""
    first = Stage(solvers.SOLVER_STEPS, solver=daqp_solver())
    return scene.track(scene.learned(method), offset, (first, Stage(control.STEPS - solvers.SOLVER_STEPS)), every=1)


def twins(scene, runs):
    """(surviving, failing, CT from the first start): runs of vanilla Poly TWIN_DISTANCE apart; None if none fails."""
    found = {}
    for offset in starts(SIGMA, max(runs, 50)):
        found.setdefault(outcome(exactly(scene, VANILLA, offset)) == "tracks", offset)
        if len(found) == 2:
            break
    else:
        return None
    alive, failed = found[True], found[False]
    while np.linalg.norm(alive - failed) > TWIN_DISTANCE:
        middle = (alive + failed) / 2
        if outcome(exactly(scene, VANILLA, middle)) == "tracks":
            alive = middle
        else:
            failed = middle
    return exactly(scene, VANILLA, alive), exactly(scene, VANILLA, failed), exactly(scene, BOUNDED, alive)


def anatomy(scene, trace):
    """What the first steps of a Poly run with every=1 were made of, one value a step: dict of arrays."""
    psi = bridge.Estimator("poly_ddr", "ef", 64).lift(trace["x"])
    effects, ahead = scenario.effects(control.EDGES), max(AHEAD) + 1
    parts = {name: [] for name in ("share", "radius", "learned", "true", "condition", "residual")}
    for k in range(TWIN_STEPS):
        theta, zeta = trace["theta"][k], np.concatenate([psi[k], trace["u"][k]])
        form = zeta @ trace["covariance"][k] @ zeta
        parts["share"].append(form / (LAMBDA + form))  # of its own innovation that a sample corrects
        parts["radius"].append(np.max(np.abs(np.linalg.eigvals(theta[:, : len(theta)]))))
        parts["learned"].append(sensitivities(theta)[-1, 0, 0])
        own = plant_sensitivities(trace["x"][k], trace["u"][k : k + ahead], shifted(effects, k))
        parts["true"].append(own[-1, 0, 0])
        problem, u = daqp_plan(qp.Step(theta, psi[k], trace["reference"][k : k + control.MPC.horizon]))
        parts["condition"].append(np.linalg.cond(problem.H))
        parts["residual"].append(qp.residual(problem, u))
    return {name: np.array(values) for name, values in parts.items()} | {name: trace[name] for name in ("error", "u")}


def twin_row(traces, parts):
    """Row of the study "twins": at which step each suspect first shows, in the run that fails."""
    (alive, failing, bounded), span = parts, np.subtract(control.MPC.u_max, control.MPC.u_min)
    return {
        "study": "twins",
        "distance": float(np.linalg.norm(traces[0]["x"][0] - traces[1]["x"][0])),
        "mean_errors": [float(trace["error"].mean()) for trace in traces[:2]],
        "outcomes": [outcome(trace) for trace in traces[:2]],
        "share_first_steps": failing["share"][:3].tolist(),
        "share_first_steps_ct": bounded["share"][:3].tolist(),
        "radius_max": float(np.max(failing["radius"])),
        "radius_max_ct": float(np.max(bounded["radius"])),
        "radius_above_cap_at": scenario.first(failing["radius"] > RADIUS),
        "wrong_sign_at": scenario.first(failing["learned"] * failing["true"] < 0),
        "condition_tenfold_at": scenario.first(failing["condition"] > 10 * failing["condition"][0]),
        "residual_above_1e-6_at": scenario.first(failing["residual"] > 1e-6),
        "inputs_part_at": scenario.first(np.max(np.abs(alive["u"] - failing["u"]) / span, axis=1) > 0.01),
    }
