"""The solvers that the controller is compared with, each through one interface, in the layout it wants.

`prepare` lays a problem out and is not timed: H is copied there last, as if it had just been made, so that
it is in the caches. `solve` is timed: it takes H and f that are new, and solves. A workspace is kept from
call to call wherever that is faster. `read` gives u and what the solver's own timer says.
"""

from importlib.metadata import version

import numpy as np

from ..experiments import control
from ..plumbing.errors import UserError

_TIGHTER = tuple(10.0**-k for k in range(2, 15))  # tolerances, loosest first


class Peer:
    """A solver. variants: {name: tolerances, loosest first}; every: it gets each `every`-th step, being slow."""

    package = None
    label = None
    variants = {"": (None,)}
    warm_variants = None  # None: there is no way to hand it a warm start
    every = 1

    def __init__(self, problem):
        """problem: any one of those to come, for its size and its box."""
        self.low, self.high = problem.low.copy(), problem.high.copy()
        self.size = len(problem.f)

    @property
    def version(self):
        return version(self.package)

    def prepare(self, variant, tolerance, instance, problem, start):
        """start: None, or (u, multipliers) to begin from."""
        raise NotImplementedError

    def solve(self):
        raise NotImplementedError

    def read(self):
        """u, and us by its own timer (None: it has none)."""
        raise NotImplementedError


class Daqp(Peer):
    package, label = "daqp", "DAQP"
    warm_variants = {"": (None,)}

    def __init__(self, problem):
        super().__init__(problem)
        import daqp

        self.call = daqp.solve
        self.H, self.A = np.empty((self.size, self.size)), np.zeros((0, self.size))

    def prepare(self, variant, tolerance, instance, problem, start):
        self.sense = np.zeros(self.size, np.intc)
        if start:  # its flags for "active, at the lower bound" and "active, at the upper"
            self.sense[start[1] > 0] = 3
            self.sense[start[1] < 0] = 1
        self.f = problem.f.copy()
        np.copyto(self.H, problem.H)

    def solve(self):
        self.result = self.call(self.H, self.f, self.A, self.high, self.low, self.sense)

    def read(self):
        u, _, _, info = self.result
        return u, 1e6 * (info["setup_time"] + info["solve_time"])


class Piqp(Peer):
    package, label = "piqp", "PIQP"
    variants = {"scaled": _TIGHTER, "unscaled": _TIGHTER}

    def __init__(self, problem):
        super().__init__(problem)
        import piqp

        self.H = np.array(problem.H, order="F")
        self.solver = piqp.DenseSolver()
        self.solver.settings.compute_timings = True
        self.solver.settings.check_duality_gap = False
        self.solver.settings.eps_rel = 0
        self.solver.settings.max_iter = 25  # 14 suffice wherever it converges at all
        self.solver.setup(self.H, problem.f, x_l=self.low, x_u=self.high)

    def prepare(self, variant, tolerance, instance, problem, start):
        self.solver.settings.preconditioner_iter = 10 if variant == "scaled" else 0
        self.solver.settings.eps_abs = tolerance
        self.f = problem.f.copy()
        np.copyto(self.H, problem.H)

    def solve(self):
        self.solver.update(P=self.H, c=self.f)
        self.solver.solve()

    def read(self):
        return self.solver.result.x.copy(), 1e6 * self.solver.result.info.run_time


class Proxqp(Peer):
    package, label = "proxsuite", "ProxQP"
    variants = dict.fromkeys(("PrimalDualLDLT", "PrimalLDLT"), _TIGHTER)  # scaling H never paid
    # its warm start takes no multipliers of a box: they can only be written where its last result stands
    warm_variants = {f"{backend}, {what}": _TIGHTER for backend in variants for what in ("from u", "from u, z")}

    def __init__(self, problem):
        super().__init__(problem)
        from proxsuite import proxqp

        self.guess = proxqp.InitialGuess
        self.H = np.empty((self.size, self.size))
        self.solvers = {}
        for backend in self.variants:
            qp = proxqp.dense.QP(self.size, 0, 0, True, proxqp.dense.HessianType.Dense, getattr(proxqp.dense.DenseBackend, backend))
            qp.settings.eps_rel = 0
            qp.settings.compute_timings = True
            qp.init(H=problem.H, g=problem.f, l_box=self.low, u_box=self.high)
            qp.solve()
            self.solvers[backend] = qp

    def prepare(self, variant, tolerance, instance, problem, start):
        backend, _, given = variant.partition(", ")
        self.qp, self.start = self.solvers[backend], None
        settings = self.qp.settings
        settings.eps_abs = tolerance
        settings.initial_guess = self.guess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        if start and given == "from u":
            settings.initial_guess = self.guess.WARM_START
            self.start = start[0]
        elif start:
            settings.initial_guess = self.guess.WARM_START_WITH_PREVIOUS_RESULT
            self.start = (start[0], -start[1])
        self.f = problem.f.copy()
        np.copyto(self.H, problem.H)

    def solve(self):
        qp, start = self.qp, self.start
        if isinstance(start, tuple):
            qp.results.x, qp.results.z = start
            qp.update(H=self.H, g=self.f, update_preconditioner=False)
            qp.solve()
            return
        qp.init(H=self.H, g=self.f, l_box=self.low, u_box=self.high, compute_preconditioner=False)
        if start is None:
            qp.solve()
        else:
            qp.solve(start, None, None)

    def read(self):
        return self.qp.results.x.copy(), self.qp.results.info.run_time


class Quadprog(Peer):
    package, label = "quadprog", "quadprog"

    def __init__(self, problem):
        super().__init__(problem)
        import quadprog

        self.call = quadprog.solve_qp
        self.H = np.empty((self.size, self.size))
        self.C = np.hstack([np.eye(self.size), -np.eye(self.size)])
        self.b = np.concatenate([self.low, -self.high])

    def prepare(self, variant, tolerance, instance, problem, start):
        self.a = -problem.f
        np.copyto(self.H, problem.H)

    def solve(self):
        self.result = self.call(self.H, self.a, self.C, self.b)

    def read(self):
        return self.result[0], None


class Highs(Peer):
    package, label = "highspy", "HiGHS"
    variants = {"as it comes": (None,), "not regularised": (None,)}

    def __init__(self, problem):
        super().__init__(problem)
        import highspy

        self.highs = highspy.Highs()
        self.highs.setOptionValue("output_flag", False)
        self.highs.setOptionValue("threads", 1)
        self.regularisation = self.highs.getOptionValue("qp_regularization_value")[1]
        self.model = highspy.HighsModel()
        lp, hessian = self.model.lp_, self.model.hessian_
        lp.num_col_, lp.num_row_ = self.size, 0
        lp.col_lower_, lp.col_upper_ = self.low, self.high
        lp.a_matrix_.start_ = np.zeros(self.size + 1, np.int32)
        rows, starts = _triangle(self.size, lower=True)
        self.rows, self.columns = rows, np.repeat(np.arange(self.size), np.diff(starts))
        hessian.dim_, hessian.format_ = self.size, highspy.HessianFormat.kTriangular
        hessian.start_, hessian.index_ = starts, rows

    def prepare(self, variant, tolerance, instance, problem, start):
        value = 0.0 if variant == "not regularised" else self.regularisation
        self.highs.setOptionValue("qp_regularization_value", value)
        self.model.lp_.col_cost_ = problem.f
        self.model.hessian_.value_ = problem.H[self.rows, self.columns]

    def solve(self):
        before = self.highs.getRunTime()
        self.highs.passModel(self.model)
        self.highs.run()
        self.own = self.highs.getRunTime() - before

    def read(self):
        return np.array(self.highs.getSolution().col_value), 1e6 * self.own


class Osqp(Peer):
    package, label, every = "osqp", "OSQP", 10
    variants = {name: tuple(10.0**-k for k in range(2, 11)) for name in ("scaled", "unscaled")}
    warm_variants = variants

    def __init__(self, problem):
        super().__init__(problem)
        import osqp
        from scipy import sparse

        rows, starts = _triangle(self.size)
        self.rows, self.columns = rows, np.repeat(np.arange(self.size), np.diff(starts))
        P = sparse.csc_matrix((problem.H[rows, self.columns], rows, starts), (self.size, self.size))
        self.solvers = {}
        for variant in self.variants:
            solver = osqp.OSQP()
            solver.setup(
                P, problem.f, sparse.eye(self.size, format="csc"), self.low, self.high, verbose=False, eps_rel=0,
                max_iter=20000, scaling=10 if variant == "scaled" else 0,
            )  # fmt: skip
            self.solvers[variant] = solver

    def prepare(self, variant, tolerance, instance, problem, start):
        self.solver = self.solvers[variant]
        self.solver.update_settings(eps_abs=tolerance)
        zero = np.zeros(self.size)
        self.start = (start[0], -start[1]) if start else (zero, zero)
        self.f, self.values = problem.f.copy(), problem.H[self.rows, self.columns]

    def solve(self):
        self.solver.update(Px=self.values, q=self.f)
        self.solver.warm_start(x=self.start[0], y=self.start[1])
        self.result = self.solver.solve()

    def read(self):
        return self.result.x, 1e6 * (self.result.info.update_time + self.result.info.solve_time)


class Clarabel(Peer):
    package, label, every = "clarabel", "Clarabel", 10
    variants = {"scaled": _TIGHTER, "unscaled": _TIGHTER}

    def __init__(self, problem):
        super().__init__(problem)
        import clarabel
        from scipy import sparse

        rows, starts = _triangle(self.size)
        self.rows, self.columns = rows, np.repeat(np.arange(self.size), np.diff(starts))
        self.P = sparse.csc_matrix((problem.H[rows, self.columns], rows, starts), (self.size, self.size))
        self.A = sparse.vstack([sparse.eye(self.size), -sparse.eye(self.size)]).tocsc()
        self.b = np.concatenate([self.high, -self.low])
        self.cones = [clarabel.NonnegativeConeT(2 * self.size)]
        self.make = clarabel.DefaultSolver
        self.settings = clarabel.DefaultSettings()
        self.settings.verbose = False
        self.settings.presolve_enable = False
        self.settings.direct_solve_method = "qdldl"
        self.settings.max_threads = 1

    def prepare(self, variant, tolerance, instance, problem, start):
        s = self.settings
        s.equilibrate_enable = variant == "scaled"
        s.tol_gap_abs = s.tol_gap_rel = s.tol_feas = tolerance
        self.f, self.P.data = problem.f.copy(), problem.H[self.rows, self.columns]

    def solve(self):
        self.result = self.make(self.P, self.f, self.A, self.b, self.cones, self.settings).solve()

    def read(self):
        return np.array(self.result.x), 1e6 * self.result.solve_time


class CvxpyDense(Peer):
    """The dense program, rebuilt at every step, with the fastest solver that CVXPY hands it to."""

    package, label, every = "cvxpy", "CVXPY, dense", 30

    def __init__(self, problem):
        super().__init__(problem)
        import cvxpy

        self.cvxpy = cvxpy

    def prepare(self, variant, tolerance, instance, problem, start):
        self.H, self.f = problem.H.copy(), problem.f.copy()

    def solve(self):
        cp = self.cvxpy
        self.u = cp.Variable(self.size)
        cost = cp.quad_form(self.u, self.H, assume_PSD=True) / 2 + self.f @ self.u
        self.program = cp.Problem(cp.Minimize(cost), [self.u >= self.low, self.u <= self.high])
        self.program.solve(solver="DAQP")

    def read(self):
        stats = self.program.solver_stats
        return self.u.value, 1e6 * ((stats.setup_time or 0) + (stats.solve_time or 0))


class CvxpyPaper(Peer):
    """The paper's program as it is written there, with the lifted states as variables, rebuilt at every step."""

    package, label, every = "cvxpy", "CVXPY, paper's form", 50
    variants = {"OSQP": (None,), "CLARABEL": (None, 1e-10, 1e-12)}

    def __init__(self, problem):
        super().__init__(problem)
        import cvxpy

        self.cvxpy, self.mpc = cvxpy, control.MPC

    def prepare(self, variant, tolerance, instance, problem, start):
        self.step = instance.step if problem is instance.problem else instance.step_before
        self.options = {"solver": variant}
        if tolerance:
            self.options |= dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)

    def solve(self):
        cp, mpc, step = self.cvxpy, self.mpc, self.step
        N = len(step.psi)
        A, B = step.theta[:, :N], step.theta[:, N:]
        self.u, z = cp.Variable((mpc.horizon, 2)), cp.Variable((mpc.horizon + 1, N))
        cost = cp.sum_squares((z[1:, :3] - step.reference) @ np.diag(np.sqrt(mpc.q)))
        cost += cp.sum_squares(self.u @ np.diag(np.sqrt(mpc.r)))
        rules = [z[0] == step.psi, z[1:] == z[:-1] @ A.T + self.u @ B.T]
        rules += [self.u >= np.array([mpc.u_min]), self.u <= np.array([mpc.u_max])]
        self.program = cp.Problem(cp.Minimize(cost), rules)
        try:
            self.program.solve(**self.options)
        except cp.error.SolverError:
            pass  # there is no u then

    def read(self):
        u, stats = self.u.value, self.program.solver_stats
        own = 1e6 * ((stats.setup_time or 0) + (stats.solve_time or 0)) if stats else None
        return np.full(self.size, np.nan) if u is None else u.ravel(), own


def _triangle(size, lower=False):
    """Row indices and column starts of a dense triangle in compressed columns."""
    columns = [np.arange(j, size) if lower else np.arange(j + 1) for j in range(size)]
    starts = np.concatenate([[0], np.cumsum([len(c) for c in columns])])
    return np.concatenate(columns).astype(np.int32), starts.astype(np.int32)


PEERS = (Daqp, Proxqp, Piqp, Quadprog, Highs, Osqp, Clarabel, CvxpyDense, CvxpyPaper)


def open_all(problem, peers=PEERS):
    """An object of each, ready for problems of the size of this one."""
    try:
        return [peer(problem) for peer in peers]
    except ImportError as error:
        raise UserError(f"bench compares with {error.name}, which is missing: `make bench` installs it") from None
