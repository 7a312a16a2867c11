"""How often runs fail, by method, start, solver, precision and form of P."""

from dataclasses import dataclass

import numpy as np

from ...plumbing.results import progress
from .. import control, scenario
from . import solvers
from .closed_loop import FAILED, SIGMA, Stage, count, starts
from .solvers import NEWTON, SOLVERS

SIGMAS = (1e-6, 1e-4, 1e-2, 1e-1)  # of the start offset (m, m, rad)
BISTABLE = ("ef", "dz_cs", "dz_ks")
STEADY = ("ct", "sift")
RESET_P0 = 100.0


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
        return scene.track(estimator, offset, (SOLVERS[self.solver](), Stage(control.STEPS - solvers.SOLVER_STEPS)))


def design():
    """One factor at a time around Newton, float64, plain, carried over; fewer cells for those that never fail, and for other papers'."""
    bistable = [scenario.Method("poly", regulator) for regulator in BISTABLE]
    steady = [scenario.Method("poly", regulator) for regulator in STEADY]
    others = [scenario.Method("poly", regulator) for regulator in scenario.REGULATORS if regulator not in BISTABLE + STEADY]
    controls = [scenario.Method("rbf", regulator) for regulator in ("dz_cs", "dz_ks", "ct", "sift")]
    cells = [Setting(m, sigma) for m in bistable for sigma in (0.0, *SIGMAS)]
    cells += [Setting(m, solver=solver) for m in bistable for solver in SOLVERS]
    cells += [Setting(m, precision=p, form=f) for m in bistable for p, f in ((32, "plain"), (64, "sqrt"), (32, "sqrt"))]
    for m in steady:
        cells += [Setting(m, sigma) for sigma in (0.0, SIGMA, 1e-1)]
        cells += [Setting(m, solver="DAQP"), Setting(m, precision=32)]
    cells += [Setting(m) for m in others]
    cells += [Setting(m, start="P reset") for m in bistable + steady + others]
    cells += [Setting(m, sigma) for m in controls for sigma in (SIGMA, 1e-1)]
    return cells + [Setting(m, start="P reset") for m in controls]


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
