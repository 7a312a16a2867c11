"""What the paper's control table leaves open: which Poly runs fail and why, and the sensitivities that control sees.

Bistability: each method tracks from many starts around the reference, with several solvers, precisions,
forms of P and ways to begin. A run has failed when its mean error is above FAILED; failures are counted, with
Wilson's 95 % interval. The k-th run of every setting begins at the k-th offset of one sequence, so settings
differ by nothing else.

Mechanism: two runs of vanilla Poly that begin TWIN_DISTANCE apart, of which one fails; and interventions
on each suspect, of which only the causes can change the count.

Sensitivities: C A^j B, what the learned model says that an input does to the states j + 1 steps later, against
finite differences of the simulated robot under the inputs it was given afterwards.
"""

from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np

from ..bench import qp
from .. import bridge
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, progress, replacing
from . import control, scenario

FAILED = 1.0  # mean error (m, rad); about 1 % of the runs found are within a factor of three of it
RUNS = 10
SEED = 20260
SIGMAS = (1e-6, 1e-4, 1e-2, 1e-1)  # of the start offset (m, m, rad)
SIGMA = 1e-2  # where one setting is compared with another
BISTABLE = ("ef", "dz_cs", "dz_ks")
RESET_P0 = 100.0

# The solver under test decides the first steps, in which runs part; the library's Newton goes on from there.
SOLVER_STEPS = 200

RADIUS = 1.02  # of A, at most, where it is capped: 1.02^50 = 2.7; that of the robot is 1
LAMBDA = 0.98
TWIN_DISTANCE = 1e-6  # (m, m, rad)
TWIN_STEPS = 120
SETTLED = 400  # a run that has failed is rescued from here on

AHEAD = (0, 9, 49)  # j
STRIDE = 10  # steps between two looks at the sensitivities
SHIFT = 1e-6  # of an input, for finite differences


# ---- statistics ------------------------------------------------------------------------------


def wilson(successes, n):
    """Wilson's 95 % interval of a probability."""
    z = 1.959963984540054
    p, scale = successes / n, 1 + z**2 / n
    centre = (p + z**2 / (2 * n)) / scale
    half = z / scale * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return max(0.0, centre - half), min(1.0, centre + half)


def starts(sigma, runs):
    """Offsets (runs, 3) of the start, N(0, sigma^2 I); those of another sigma are the same, scaled."""
    return sigma * np.random.default_rng(SEED).standard_normal((runs, 3))


def outcome(trace):
    """How a run ended: "tracks", "stands", "turned" (on the path with whole turns too many), or "lost"."""
    if trace["error"].mean() <= FAILED:
        return "tracks"
    if np.mean(trace["u"][:, 0] < 1e-9) > 0.5:
        return "stands"
    miss = trace["x"][1:] - trace["reference"]
    position = np.linalg.norm(miss[-500:, :2], axis=1)
    return "turned" if np.median(position) < FAILED and np.median(np.abs(miss[-500:, 2])) > np.pi else "lost"


# ---- closed loop -----------------------------------------------------------------------------


def shifted(effects, step):
    """The effects on a clock that begins at `step`."""
    return [replace(e, t0=e.t0 - step * scenario.DT, t1=e.t1 - step * scenario.DT) for e in effects]


@dataclass(frozen=True)
class Stage:
    """Some steps of a run: what the controller is, and whether the model learns."""

    steps: int
    mpc: bridge.Mpc = control.MPC
    solver: object = None
    learn: bool = True


@dataclass(frozen=True)
class Scene:
    """The run that methods learn on, and the reference they then track."""

    x: np.ndarray
    u: np.ndarray
    reference: np.ndarray

    def learned(self, method, precision=64, form="plain"):
        """A new estimator at the end of the one-step run."""
        return scenario.run(method, precision, self.x, self.u, form=form)[0]

    def track(self, estimator, offset, stages=(Stage(control.STEPS),), every=0, origin=(0, 0, 0)):
        """Trace of the stages one after the other, from `offset` off the reference, which is moved to `origin`."""
        reference = self.reference + np.asarray(origin, float)
        x0, step, parts = reference[0] + offset, 0, []
        for stage in stages:
            trace = estimator.control(
                stage.mpc, reference[step:], scenario.DT, stage.steps, x0,
                shifted(scenario.effects(control.EDGES), step), learn=stage.learn, every=every, solver=stage.solver,
            )  # fmt: skip
            x0, step = trace["x"][-1], step + stage.steps
            trace["x"] = trace["x"] if not parts else trace["x"][1:]
            parts.append(trace)
        whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        whole["reference"] = reference[1 : step + 1]
        whole["error"] = np.linalg.norm(whole["x"][1:] - whole["reference"], axis=1)
        return whole


def scene():
    """The paper's."""
    return Scene(*scenario.drive(), control.reference_path())


# ---- solvers ---------------------------------------------------------------------------------


def library(estimator, edit=lambda theta: theta, limit=lambda u: u):
    """The library's solver as a `solver` of Estimator.control, with the model or the input changed on the way."""
    controller = bridge.Controller(control.MPC, 64, estimator.N)

    def solve(theta, psi, reference):
        solution = controller.solve(edit(theta), psi, reference)
        return limit(solution.plan[0]) if solution.status == 0 else None

    return solve


def _peer(name):
    try:
        return import_module(name)
    except ImportError:
        raise UserError(f"the Python package {name} is missing: run `make build` first")


def daqp_plan(step):
    """(program of qp.Step `step`, plan) by an exact active-set solver; no plan without a usable model."""
    H, f = qp.condense(step)
    low, high = qp.box()
    problem = qp.Problem(H, f, low, high, None, None)
    if not (np.all(np.isfinite(H)) and np.all(np.isfinite(f))):
        return problem, None
    u, _, flag, _ = _peer("daqp").solve(H, f, np.zeros((0, len(f))), high.copy(), low.copy())
    return problem, u if flag == 1 else None


def daqp_solver():
    """The same as a `solver` of Estimator.control."""

    def solve(theta, psi, reference):
        _, u = daqp_plan(qp.Step(theta, psi, reference))
        return None if u is None else u[:2]

    return solve


def osqp_solver(tolerance=1e-5):
    """An operator-splitting solver at a finite tolerance, as the paper's CVXPY may have called it."""
    osqp, sparse = _peer("osqp"), _peer("scipy.sparse")  # which osqp needs
    low, high = qp.box()
    box = sparse.eye(len(low), format="csc")

    def solve(theta, psi, reference):
        H, f = qp.condense(qp.Step(theta, psi, reference))
        if not (np.all(np.isfinite(H)) and np.all(np.isfinite(f))):
            return None
        problem = osqp.OSQP()
        problem.setup(
            sparse.csc_matrix(np.triu(H)), f, box, low, high, eps_abs=tolerance, eps_rel=tolerance, verbose=False
        )
        result = problem.solve(raise_error=False)
        return np.clip(result.x[:2], low[:2], high[:2]) if result.info.status == "solved" else None

    return solve


# name -> the stage that it decides
SOLVERS = {
    "Newton 1e-3": lambda: Stage(SOLVER_STEPS, replace(control.MPC, tolerance=1e-3)),
    "gradient 1e-4": lambda: Stage(
        SOLVER_STEPS, replace(control.MPC, method=bridge.MPC_GRADIENT, tolerance=1e-4)
    ),
    "DAQP": lambda: Stage(SOLVER_STEPS, solver=daqp_solver()),
    "OSQP 1e-5": lambda: Stage(SOLVER_STEPS, solver=osqp_solver()),
}
NEWTON = "Newton"


# ---- (a) how often ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """One cell of the design."""

    method: scenario.Method
    sigma: float = SIGMA
    solver: str = NEWTON
    precision: int = 64
    form: str = "plain"
    start: str = "carried over"  # or "P reset": Theta kept, P = RESET_P0 I

    def run(self, scene, offset):
        """Trace of one run of this cell."""
        estimator = scene.learned(self.method, self.precision, self.form)
        if self.start == "P reset":
            estimator.reset_covariance(RESET_P0)
        if self.solver == NEWTON:
            return scene.track(estimator, offset)
        return scene.track(estimator, offset, (SOLVERS[self.solver](), Stage(control.STEPS - SOLVER_STEPS)))


def design():
    """One factor at a time around Newton, float64, plain, carried over; fewer cells for those that never fail."""
    bistable = [scenario.Method("poly", regulator) for regulator in BISTABLE]
    steady = [scenario.Method("poly", regulator) for regulator in ("ct", "sift")]
    controls = [scenario.Method("rbf", regulator) for regulator in ("dz_cs", "dz_ks", "ct", "sift")]
    cells = [Setting(m, sigma) for m in bistable for sigma in (0.0, *SIGMAS)]
    cells += [Setting(m, solver=solver) for m in bistable for solver in SOLVERS]
    cells += [Setting(m, precision=p, form=f) for m in bistable for p, f in ((32, "plain"), (64, "sqrt"), (32, "sqrt"))]
    for m in steady:
        cells += [Setting(m, sigma) for sigma in (0.0, SIGMA, 1e-1)]
        cells += [Setting(m, solver="DAQP"), Setting(m, precision=32)]
    cells += [Setting(m, start="P reset") for m in bistable + steady]
    cells += [Setting(m, sigma) for m in controls for sigma in (SIGMA, 1e-1)]
    return cells + [Setting(m, start="P reset") for m in controls]


def count(traces):
    """The figures of a cell or an intervention."""
    errors = [float(trace["error"].mean()) for trace in traces]
    failures, n = sum(error > FAILED for error in errors), len(errors)
    ends = [outcome(trace) for trace in traces]
    return {
        "runs": n,
        "failures": failures,
        "probability": failures / n,
        "ci95": list(wilson(failures, n)),
        "mean_errors": errors,
        "median_error_tracking": float(np.median([e for e in errors if e <= FAILED] or [np.nan])),
        "stands": ends.count("stands"),
        "turned": ends.count("turned"),
        "lost": ends.count("lost"),
        "fallback_rate": float(np.mean([np.mean(trace["status"] != 0) for trace in traces])),
    }


def bistability(scene, runs):
    """Rows of the study "bistability", one a cell of the design."""
    rows = []
    for cell in progress(design(), "which runs fail"):
        n = 1 if cell.sigma == 0 else max(1, runs // 3) if cell.method.dictionary == "rbf" else runs
        rows.append(
            {
                "study": "bistability",
                "dictionary": cell.method.dictionary,
                "regulator": cell.method.regulator,
                "sigma": cell.sigma,
                "solver": cell.solver,
                "precision": f"f{cell.precision}",
                "form": cell.form,
                "start": cell.start,
                **count([cell.run(scene, offset) for offset in starts(cell.sigma, n)]),
            }
        )
    for row in rows:
        row["as_newton"] = same_verdicts(row, rows)
    return rows


def same_verdicts(row, rows):
    """Share of the runs that end as those of Newton, float64, plain, carried over do from the same starts."""
    if row["sigma"] != SIGMA:
        return None
    same = {"sigma": SIGMA, "solver": NEWTON, "precision": "f64", "form": "plain", "start": "carried over"}
    same |= {key: row[key] for key in ("dictionary", "regulator")}
    base = next(other for other in rows if same.items() <= {k: other[k] for k in same}.items())
    pairs = zip(row["mean_errors"], base["mean_errors"])
    return float(np.mean([(a > FAILED) == (b > FAILED) for a, b in pairs]))


# ---- (a) why ---------------------------------------------------------------------------------


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
    controller = bridge.Controller(control.MPC, 64, estimator.N)
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
    "exact solver (DAQP)": lambda s, o: _begin(s, o, Stage(SOLVER_STEPS, solver=daqp_solver())),
    "v at least 0.5 m/s": lambda s, o: _whole(s, o, limit=pushed),
    "goes on at $p_x$ = 320 m": _far,
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
    first = Stage(SOLVER_STEPS, solver=daqp_solver())
    return scene.track(scene.learned(method), offset, (first, Stage(control.STEPS - SOLVER_STEPS)), every=1)


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


# ---- (b) what control sees -------------------------------------------------------------------


def sensitivities(theta, ahead=AHEAD):
    """d x[k+j+1] / d u[k] as the model has it: C A^j B, (len(ahead), 3, 2)."""
    N = len(theta)
    rows, out = np.eye(3, N), []
    for j in range(max(ahead) + 1):
        if j in ahead:
            out.append(rows @ theta[:, N:])
        rows = rows @ theta[:, :N]
    return np.array(out)


def plant_sensitivities(x, u, active=(), ahead=AHEAD):
    """The same of the simulated robot at x, if u (at least max(ahead) + 1 rows) is what it is given from here on."""
    u = u[: max(ahead) + 1]
    base = bridge.simulate(u, scenario.DT, x, active)
    out = np.empty((len(ahead), 3, 2))
    for i in range(2):
        moved = u.copy()
        moved[0, i] += SHIFT
        out[:, :, i] = ((bridge.simulate(moved, scenario.DT, x, active) - base) / SHIFT)[np.array(ahead) + 1]
    return out


# name -> (state, input, whose j are asked for their sign): one step is too early for omega to move the robot sideways
WATCHED = {"dpx_dv": (0, 0, (0, 9, 49)), "dtheta_domega": (2, 1, (0, 9, 49)), "dpy_domega": (1, 1, (9, 49))}


def compare(scene, method):
    """(row of the study "sensitivities", what it comes from) for one method in closed loop, no offset."""
    learn = method.regulator != "offline"
    estimator = scene.learned(method)
    trace = scene.track(estimator, np.zeros(3), (Stage(control.STEPS, learn=learn),), every=1)
    steps = np.arange(0, control.STEPS - max(AHEAD) - 1, STRIDE)
    effects = scenario.effects(control.EDGES)
    with np.errstate(all="ignore"):
        learned = np.array([sensitivities(trace["theta"][k]) for k in steps])
        true = np.array([plant_sensitivities(trace["x"][k], trace["u"][k:], shifted(effects, k)) for k in steps])
        relative = np.linalg.norm(learned - true, axis=(2, 3)) / np.linalg.norm(true, axis=(2, 3))
        psi = estimator.lift(trace["x"])
        predicted = np.einsum("kij,kj->ki", trace["theta"], np.hstack([psi[:-1], trace["u"]]))[:, :3]
        one_step = np.linalg.norm(trace["x"][1:] - predicted, axis=1)
    row = {
        "study": "sensitivities",
        "dictionary": method.dictionary,
        "regulator": method.regulator,
        "mean_error": float(trace["error"].mean()),
        "outcome": outcome(trace),
        "one_step_error": float(one_step.mean()),
        "relative_error": {str(j): float(np.median(relative[:, i])) for i, j in enumerate(AHEAD)},
        "relative_error_p95": {str(j): float(np.percentile(relative[:, i], 95)) for i, j in enumerate(AHEAD)},
        "wrong_sign": {},
    }
    for name, (state, of, ahead) in WATCHED.items():
        row["wrong_sign"][name] = {}
        for j in ahead:
            says, is_ = (values[:, AHEAD.index(j), state, of] for values in (learned, true))
            # a robot that stands does not turn its yaw into lateral motion: no sign to get right
            counted = np.abs(is_) > 0.05 * scenario.DT
            share = float(np.mean(~(says[counted] * is_[counted] > 0))) if counted.any() else None
            row["wrong_sign"][name][str(j)] = share
    return row, {"t": steps * scenario.DT, "learned": learned, "true": true, "relative": relative}


# ---- the study -------------------------------------------------------------------------------


def run(out, runs=RUNS):
    """Writes study.json and its plots into `out`; returns the rows."""
    if runs < 1:
        raise UserError(f"--runs is {runs}, it must be at least 1")
    for name in ("daqp", "osqp"):
        _peer(name)
    out = output_folder(out)
    paper = scene()
    compared = {method: compare(paper, method) for method in progress(scenario.METHODS, "sensitivities")}
    seen = [row for row, _ in compared.values()]
    changed = interventions(paper, runs)
    rescued = rescue(paper, runs)
    traced = twins(paper, runs)
    parts = [anatomy(paper, trace) for trace in traced] if traced else None
    parted = [twin_row(traced, parts)] if traced else []
    cells = bistability(paper, runs)
    rows = cells + changed + rescued + parted + seen
    with replacing(out / "study.json", rows):
        draw_bistability(out, cells)
        if traced:
            draw_mechanism(out, parts, changed)
        draw_sensitivities(out, compared)
    report(cells, changed, rescued, parted, seen)
    return rows


def chance(row):
    """A count with the interval of its probability in percent, for a table."""
    low, high = row["ci95"]
    return f"{row['failures']}/{row['runs']} ({100 * low:.0f}-{100 * high:.0f})"


def setting(row):
    """What distinguishes a cell of the design, in words."""
    if row["start"] != "carried over":
        return "P reset to 100 I"
    if row["solver"] != NEWTON:
        return row["solver"]
    if (row["precision"], row["form"]) != ("f64", "plain"):
        return f"float{row['precision'][1:]}, {'root' if row['form'] == 'sqrt' else 'plain'}"
    return f"offset {number(row['sigma'])}"


def report(cells, changed, rescued, parted, seen):
    """The tables on the terminal."""
    table = {}
    for row in cells:
        if row["dictionary"] != "poly":
            continue
        name = scenario.LABELS[row["regulator"]]
        line = table.setdefault(setting(row), {"as": []})
        line[name] = chance(row)
        if row["regulator"] in BISTABLE and row["as_newton"] is not None:
            line["as"].append(100 * row["as_newton"])
    names = [scenario.LABELS[regulator] for regulator in scenario.REGULATORS]
    print_table(
        f"Failures (mean error above {FAILED:g}) of Poly: count, 95 % interval of the probability in %",
        ["setting", *names, "same"],
        [
            [key, *[line.get(name, "") for name in names], number(np.mean(line["as"])) if line["as"] else ""]
            for key, line in table.items()
        ],
        "Same: % of the runs of the first three that end as they do with Newton from the same start. "
        f"Offset {number(SIGMA)}, Newton, float64, plain, Theta and P carried over, unless the setting says otherwise.",
    )
    errors = np.array([error for row in cells for error in row["mean_errors"]])
    middle = int(np.sum((errors > FAILED / 2) & (errors <= 3 * FAILED)))
    rbf = [row for row in cells if row["dictionary"] == "rbf"]
    ends = [sum(row[end] for row in cells) for end in ("stands", "turned", "lost")]
    print_table(
        "All runs",
        ["", "runs"],
        [
            ["all", len(errors)],
            [f"mean error between {FAILED / 2:g} and {3 * FAILED:g}: where the threshold would matter", middle],
            ["failed: stands still", ends[0]],
            ["failed: keeps the path, heading off by whole turns", ends[1]],
            ["failed: lost otherwise", ends[2]],
            ["RBF", sum(row["runs"] for row in rbf)],
            ["RBF, failed", sum(row["failures"] for row in rbf)],
        ],
    )
    print_table(
        "Vanilla Poly with something changed, from the same starts",
        ["changed", "failures (%)", "median error of those that track"],
        [[row["changed"].replace("$", ""), chance(row), number(row["median_error_tracking"])] for row in changed]
        + [[f"{r['standing']} stand at step {SETTLED}: {r['done']}", f"{r['rescued']} rescued", ""] for r in rescued],
    )
    for row in parted:
        print_table(
            f"Two runs {number(row['distance'], 1)} apart, mean errors {number(row['mean_errors'][0], 2)} and "
            f"{number(row['mean_errors'][1])}: when each suspect shows in the one that fails",
            ["", "step"],
            [
                [f"spectral radius of A above {RADIUS:g}", row["radius_above_cap_at"]],
                ["dpx/dv over 50 steps of the wrong sign", row["wrong_sign_at"]],
                ["condition of the Hessian ten times what it was", row["condition_tenfold_at"]],
                ["KKT residual of a solve above 1e-6", row["residual_above_1e-6_at"]],
                ["inputs of the two 1 % apart", row["inputs_part_at"]],
            ],
        )
    lines = []
    for row in seen:
        wrong = row["wrong_sign"]
        lines.append(
            [
                scenario.Method(row["dictionary"], row["regulator"]).label,
                f"{number(row['mean_error'])}",
                number(row["one_step_error"]),
                *[number(row["relative_error"][str(j)], 2) for j in AHEAD],
                number(row["relative_error_p95"]["49"], 2),
                *[number(None if wrong[w]["49"] is None else 100 * wrong[w]["49"], 2) for w in WATCHED],
            ]
        )
    print_table(
        "Sensitivities in closed loop: relative error (median over time), % of time with the wrong sign over 50 steps",
        ["method", "tracking", "one-step", "j = 0", "j = 9", "j = 49", "p95", *[w.replace("_", "/") for w in WATCHED]],
        lines,
    )


# ---- plots -----------------------------------------------------------------------------------

MARKERS = {"ef": "s", "dz_cs": "o", "dz_ks": "^", "ct": "D", "sift": "v"}


def draw_bistability(out, cells):
    """Mean errors of all runs, and the probability of failure in each setting."""
    poly = [row for row in cells if row["dictionary"] == "poly"]
    figure, (left, right) = plots.subplots(1, 2, figsize=(11, 6), width_ratios=(1, 1.5))
    figure.suptitle(
        "A centimetre at the start, hardly the solver, decides whether vanilla and dead-zone Poly keep the path",
        x=0.01, ha="left",
    )  # fmt: skip
    groups = {scenario.Method("poly", r).label: (r, "carried over") for r in scenario.REGULATORS}
    groups |= {f"Poly ({scenario.LABELS[r]}), P reset": (r, "P reset") for r in ("ct", "sift")}
    spread = np.random.default_rng(0)
    for y, (regulator, start) in enumerate(groups.values()):
        errors = [e for r in poly if (r["regulator"], r["start"]) == (regulator, start) for e in r["mean_errors"]]
        left.scatter(
            errors, y + spread.uniform(-0.3, 0.3, len(errors)), s=9, marker=MARKERS[regulator],
            color=plots.STYLES[regulator]["color"], alpha=0.6, lw=0,
        )  # fmt: skip
    errors = [e for r in cells if r["dictionary"] == "rbf" for e in r["mean_errors"]]
    left.scatter(errors, len(groups) + spread.uniform(-0.3, 0.3, len(errors)), s=9, marker="x", color="0.3", lw=0.8)
    left.axvline(FAILED, color="k", lw=0.8, ls="--")
    left.annotate(
        "failed", (FAILED, 1), (4, -2), xycoords=("data", "axes fraction"), textcoords="offset points", va="top"
    )
    left.set_xscale("log")
    left.set_yticks(range(len(groups) + 1), [*groups, "RBF, regulated"])
    left.invert_yaxis()
    left.set_xlabel("mean tracking error (m, rad)")
    left.set_title("every run")

    names = list(dict.fromkeys(setting(row) for row in poly if row["sigma"] > 0))
    for row in poly:
        if row["sigma"] == 0:
            continue
        place = names.index(setting(row)) + 0.15 * (scenario.REGULATORS.index(row["regulator"]) - 2)
        low, high = row["ci95"]
        right.plot([low, high], [place, place], color=plots.STYLES[row["regulator"]]["color"], lw=1.2)
        right.plot(
            row["probability"], place, MARKERS[row["regulator"]], ms=5, color=plots.STYLES[row["regulator"]]["color"],
            label=scenario.Method("poly", row["regulator"]).label,
        )  # fmt: skip
    for y in range(1, len(names)):
        right.axhline(y - 0.5, color="0.85", lw=0.6)
    right.set_yticks(range(len(names)), names)
    right.set_ylim(len(names) - 0.5, -0.5)
    right.grid(axis="y", visible=False)
    right.set_xlim(-0.02, 1.02)
    right.set_xlabel("probability of failure, 95 % interval")
    right.set_title(f"by setting (offset {number(SIGMA)} where none is named)")
    handles = {label: handle for handle, label in zip(*right.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=5)
    plots.save(figure, out / "study_bistability.png")


def draw_mechanism(out, parts, changed):
    """The twins, and what the interventions do."""
    figure, axes = plots.subplots(2, 2, figsize=(11, 6.4))
    figure.suptitle(
        "Vanilla Poly fails where a few samples make A unstable over the horizon: with its radius capped none fails",
        x=0.01, ha="left",
    )  # fmt: skip
    t = np.arange(TWIN_STEPS) * scenario.DT
    *parts, bounded = parts
    looks = (dict(color="0.6", lw=2.6), dict(color="k", lw=1, ls="--"))
    names = ("survives", "fails, from a start 1e-6 beside it")
    (error, fate), (radius, slope) = axes
    for part, look, name in zip(parts, looks, names):
        error.semilogy(t, part["error"][:TWIN_STEPS], label=name, **look)
        radius.plot(t, part["radius"], label=name, **look)
        slope.plot(t, part["learned"], label=f"{name}: learned", **look)
    slope.plot(t, parts[1]["true"], color="#08306b", lw=1.4, ls=":", label="the robot's own")
    error.set_ylabel("tracking error (m, rad)")
    error.set_title("twin runs")
    error.legend()
    radius.plot(t, bounded["radius"], color="#e6a000", lw=1.6, ls=":", label="CT, same start")
    radius.axhline(RADIUS, color="#d62728", lw=1, ls="-.", label="cap")
    radius.set_ylabel("spectral radius of A")
    radius.set_title("the model is unstable")
    radius.legend()
    slope.set_yscale("symlog", linthresh=0.1)
    slope.set_ylim(-1e3, 5)
    slope.set_ylabel("$\\partial p_x[k+50] / \\partial v[k]$ (s)")
    slope.set_title("what speed does to the position 2.5 s later, it believes")
    slope.legend(loc="lower left")
    for ax in (error, radius, slope):
        ax.set_xlabel("time (s)")
    for y, row in enumerate(changed):
        fate.barh(y, row["probability"], color="0.8", edgecolor="k", lw=0.6, hatch="//" if y == 0 else "")
        low, high = row["ci95"]
        fate.plot([low, high], [y, y], color="k", lw=1.4)
        fate.plot(row["probability"], y, "ko", ms=4, clip_on=False)
    fate.set_yticks(range(len(changed)), [row["changed"] for row in changed])
    fate.invert_yaxis()
    fate.grid(axis="y", visible=False)
    fate.set_xlim(0, 1)
    fate.set_xlabel("probability of failure, 95 % interval")
    fate.set_title(f"what is changed, {changed[0]['runs']} runs each")
    plots.save(figure, out / "study_mechanism.png")


def draw_sensitivities(out, compared):
    """Learned against true over time, over the whole horizon."""
    figure, axes = plots.subplots(2, 2, figsize=(11, 6.2), sharex=True, sharey="row")
    figure.suptitle(
        "What control believes an input does 2.5 s later: vanilla and dead-zone Poly leave the robot, even in sign",
        x=0.01, ha="left",
    )  # fmt: skip
    shown = (
        ("dpx_dv", "$\\partial p_x / \\partial v$ (s)"),
        ("dpy_domega", "$\\partial p_y / \\partial \\omega$ (m s)"),
    )
    for column, (dictionary, name) in zip(axes.T, (("poly", "Poly"), ("rbf", "RBF"))):
        for ax, (key, _) in zip(column, shown):
            state, of, _ = WATCHED[key]
            methods = [m for m in compared if m.dictionary == dictionary and m != scenario.Method("rbf", "ef")]
            steady = compared[scenario.Method(dictionary, "sift")][1]
            ax.plot(steady["t"], steady["true"][:, -1, state, of], color="0.8", lw=4, label="robot (run of SIFt)")
            for method in methods:
                found = compared[method][1]
                ax.plot(
                    found["t"], found["learned"][:, -1, state, of], lw=1, label=scenario.LABELS[method.regulator],
                    **plots.STYLES[method.regulator],
                )  # fmt: skip
            ax.set_yscale("symlog", linthresh=0.1)
            ax.axhline(0, color="k", lw=0.6)
            plots.mark_phases(ax, control.STEPS, names=ax is column[0])
            column[0].set_title(name, pad=16)
        column[1].set_xlabel("time (s)")
    for ax, (_, label) in zip(axes[:, 0], shown):
        ax.set_ylabel(label)
    axes[0, 0].legend(ncols=3, loc="lower right")
    axes[0, 1].legend(ncols=3, loc="lower right")
    plots.save(figure, out / "study_sensitivities.png")
