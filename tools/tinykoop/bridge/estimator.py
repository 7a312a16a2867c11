"""The estimators of lib/, in both precisions: replays, closed loops, calibration."""

import ctypes as ct

import numpy as np

from ..plumbing.errors import UserError
from .control import SOLVER
from .library import DOUBLES, INTS, address, call, doubles, ints, raw, reals
from .regulators import setting_values
from .unmodelled import active_effects

CHECK_REFUSE, CHECK_REPORT, CHECK_DIAGONAL = 0, 1, 2
OVERFLOW = -6  # KOOP_E_OVERFLOW

# What a replay writes down, with one row for each transition.
FLAGS = ("status", "frozen", "positive_definite", "trust")
TRUST = ("trusted", "doubtful", "refuse")  # what `trust` counts
TRACES = ("error", "predicted", "innovation", *FLAGS, "trace", "min_diagonal", "norm_a", "norm_b", "norm_p")


class _GateSettings(ct.Structure):
    _fields_ = [("multiple", ct.c_double), ("floor", ct.c_double), ("patience", ct.c_size_t), ("hold", ct.c_size_t)]


class _Settings(ct.Structure):
    _fields_ = [
        ("own", ct.c_void_p),
        ("dictionary", ct.c_char_p),
        ("regulator", ct.c_char_p),
        ("form", ct.c_char_p),
        ("precision", ct.c_int),
        ("check", ct.c_int),
        ("n_inputs", ct.c_int),
        ("lam", ct.c_double),
        ("p0", ct.c_double),
        ("n_settings", ct.c_size_t),
        ("settings", DOUBLES),
        ("gate", ct.POINTER(_GateSettings)),
    ]


class _Health(ct.Structure):
    _fields_ = [(name, ct.c_int32) for name in ("status", "frozen", "positive_definite", "short_memory", "winding_up", "trust")]
    _fields_ += [(name, ct.c_double) for name in ("innovation", "trace", "min_diagonal")]


class _Trace(ct.Structure):
    _fields_ = [
        ("error", DOUBLES),
        ("predicted", DOUBLES),
        ("innovation", DOUBLES),
        ("status", INTS),
        ("frozen", INTS),
        ("positive_definite", INTS),
        ("trust", INTS),
        ("trace", DOUBLES),
        ("min_diagonal", DOUBLES),
        ("norm_a", DOUBLES),
        ("norm_b", DOUBLES),
        ("norm_p", DOUBLES),
        ("every", ct.c_size_t),
        ("theta", DOUBLES),
        ("covariance", DOUBLES),
    ]


class _ControlTrace(ct.Structure):
    _fields_ = [
        ("x", DOUBLES),
        ("u", DOUBLES),
        ("status", INTS),
        ("residual", DOUBLES),
        ("iterations", INTS),
        ("solve_us", DOUBLES),
        ("innovation", DOUBLES),
        ("model", INTS),
        ("resets", INTS),
        ("every", ct.c_size_t),
        ("theta", DOUBLES),
        ("covariance", DOUBLES),
    ]


class _Soak(ct.Structure):
    _fields_ = [
        ("updates", ct.c_uint64),
        ("refused", ct.c_uint64),
        ("lost_positive_definite_at", ct.c_int64),
        ("non_finite_at", ct.c_int64),
    ]


class Estimator:
    """The estimator of the C library, in float32 or float64 (precision: 32 or 64).

    dictionary: poly_ddr, rbf_ddr, poly_fwmav, rbf_fwmav, wide_fwmav (N = 40, for timing), or an Own; regulator: one of
    regulators(); form: plain, sqrt, or textbook (the form that diverges, for comparison).
    n_inputs, lam, p0: as in koopf_config. check: CHECK_REPORT continues after a loss of positive definiteness, as the
    paper's recursion does.
    gate: learns through a gate: True, with its defaults, or their values (multiple, floor, patience, hold).
    settings: those of regulators(), by name, as delta=0.01. What is not given has its default; what is a setting of
    another regulator only is ignored, so that one call serves all.
    """

    def __init__(self, dictionary, regulator, precision, *, form="plain", n_inputs=2, lam=0.98, p0=100.0,
                 check=CHECK_REPORT, gate=False, **settings):  # fmt: skip
        values = np.array(setting_values(regulator, settings), np.float64)
        gate = ct.pointer(_GateSettings(*(() if gate is True else gate))) if gate else None
        self._own = None if isinstance(dictionary, str) else dictionary
        settings = _Settings(
            self._own.handle if self._own else None, None if self._own else dictionary.encode(), regulator.encode(), form.encode(), precision, check, n_inputs, lam, p0,
            len(values), doubles(values), gate,
        )  # fmt: skip
        self._handle = ct.c_void_p()
        call("tk_estimator_new", ct.byref(settings), ct.byref(self._handle))
        n, N, m = ct.c_size_t(), ct.c_size_t(), ct.c_size_t()
        call("tk_estimator_sizes", self._handle, ct.byref(n), ct.byref(N), ct.byref(m))
        self.n, self.N, self.m = n.value, N.value, m.value
        self.dtype = np.float32 if precision == 32 else np.float64

    def __del__(self):
        if getattr(self, "_handle", None):
            raw("tk_estimator_free", self._handle)

    @property
    def d(self):
        """Number of regressors, N + m."""
        return self.N + self.m

    @property
    def theta(self):
        """Theta = [A B], (N, N+m)."""
        theta = np.empty((self.N, self.d))
        call("tk_estimator_get_theta", self._handle, doubles(theta))
        return theta

    @theta.setter
    def theta(self, value):
        value = reals(value, self.d)
        call("tk_estimator_set_theta", self._handle, doubles(value))

    @property
    def covariance(self):
        """P, (N+m, N+m)."""
        P = np.empty((self.d, self.d))
        call("tk_estimator_get_covariance", self._handle, doubles(P))
        return P

    def reset_covariance(self, p0):
        """Resets P to p0 I and keeps Theta."""
        call("tk_estimator_reset_covariance", self._handle, ct.c_double(p0))

    def model(self, covariance=False):
        """Returns the stored model as bytes, for koopf_model_load() or koopd_model_load(); with P if `covariance`."""
        size, covariance = ct.c_size_t(), ct.c_int(covariance)
        call("tk_estimator_model", self._handle, covariance, None, ct.byref(size))
        buffer = ct.create_string_buffer(size.value)
        call("tk_estimator_model", self._handle, covariance, buffer, ct.byref(size))
        return buffer.raw

    def load(self, model):
        """Takes Theta, and P if it is there, from the bytes of a stored model."""
        call("tk_estimator_load", self._handle, model, ct.c_size_t(len(model)))

    def lift(self, x):
        """Lifts states x (K, n) in this precision; returns Psi(x), (K, N). Raises UserError if it is not finite."""
        x = reals(x, self.n)
        if self.by_function:
            return self._finite(self.by_function(x))
        psi = np.empty((len(x), self.N))
        call("tk_lift", self._handle, ct.c_size_t(len(x)), doubles(x), doubles(psi))
        return psi

    @staticmethod
    def _finite(psi):
        """What a Python function lifted, refused as the library refuses its own."""
        finite = np.isfinite(psi).all(axis=1)
        if not finite.all():
            raise UserError(f"lift, row {np.argmin(finite)}: {raw('tk_status_message', OVERFLOW).decode()}")
        return psi

    @property
    def by_function(self):
        """The Python function that lifts (K, n) to (K, N); None where the library does."""
        return self._own.lift if self._own else None

    @property
    def handle(self):
        """The estimator in C."""
        return self._handle

    def update(self, now, u, to, lifted=False, guard=None):
        """Learns from one transition of states, or of lifted ones; float64 arrays that are contiguous. Returns a _Health.

        guard: handle of a supervisor, that learns by it.
        """
        health, arguments = _Health(), (self._handle, ct.c_int(lifted), address(now), address(u), address(to))
        raw("tk_guard_update", guard, *arguments, ct.byref(health)) if guard else raw("tk_update", *arguments, ct.byref(health))
        return health

    def predict(self, now, u, lifted=False):
        """psi (K, N) one step later than now (K, n), or (K, N) if lifted, under u (K, m)."""
        now, u = reals(now, self.N if lifted else self.n), reals(u, self.m)
        out = np.empty((len(now), self.N))
        call("tk_predict", self._handle, ct.c_int(lifted), ct.c_size_t(len(now)), doubles(now), doubles(u), doubles(out))
        return out

    def rollout(self, start, u, lifted=False):
        """psi (K+1, N) from a state, or a lifted one, under u (K, m), by the linear model alone."""
        start, u = reals(start), reals(u, self.m)
        out = np.empty((len(u) + 1, self.N))
        call("tk_rollout", self._handle, ct.c_int(lifted), ct.c_size_t(len(u)), doubles(start), doubles(u), doubles(out))
        return out

    def replay(self, x, u, usable=None, learn=True, every=0, traces=TRACES):
        """Feeds states x (K+1, n) and inputs u (K, m) through the estimator; returns a dict of traces.

        usable (K): which transitions may be learned from and scored. traces: names of TRACES, all by
        default; predicted has n columns. norm_a, norm_b, norm_p and positive_definite cost many times the
        update, so long replays name the others. With every > 0 also theta and covariance before each
        transition k with k % every == 0.
        """
        x, u = reals(x, self.n), reals(u, self.m)
        psi = reals(self.by_function(np.where(np.isfinite(x), x, 0)), self.N) if self.by_function else None
        K = len(u)
        if len(x) != K + 1:
            raise ValueError(f"{len(x)} states do not go with {K} inputs")
        if unknown := set(traces) - set(TRACES):
            raise ValueError(f"there are no traces named {sorted(unknown)}, only {TRACES}")
        out = {name: np.empty(K, np.int32 if name in FLAGS else np.float64) for name in traces if name != "predicted"}
        if "predicted" in traces:
            out["predicted"] = np.empty((K, self.n))
        if every:
            count = -(-K // every)
            out["theta"] = np.empty((count, self.N, self.d))
            out["covariance"] = np.empty((count, self.d, self.d))
        c_trace = _Trace(every=every)
        for name, array in out.items():
            setattr(c_trace, name, ints(array) if array.dtype == np.int32 else doubles(array))
        usable = None if usable is None else np.ascontiguousarray(usable, dtype=np.int32)
        call(
            "tk_replay", self._handle, ct.c_size_t(K), doubles(x), doubles(psi), doubles(u), ints(usable),
            ct.c_int(learn), ct.byref(c_trace),
        )  # fmt: skip
        return out

    def control(self, mpc, reference, dt, steps, x0, active=(), learn=True, every=0, solver=None, supervisor=None):
        """Drives the DDR along `reference` (steps + horizon + 1, 3) with Koopman-MPC on this model.

        solver(theta (N, N+2), psi (N), reference (horizon, 3)) -> u (2) or None: plans in the
        library's place; None is a fallback to the safe input (0, 0).

        A dictionary by a Python function is refused: the loop runs in C.

        supervisor: a Supervisor; the traces then have model (index into MODELS) and resets (of the learner, so far).

        Returns a dict of traces, one row for each step: u, status (not 0: the safe input was
        given), residual (KKT), iterations, solve_us, innovation; x has one row more; with every > 0 theta and
        covariance as in replay().
        """
        if self.by_function:
            raise UserError("control: the closed loop runs in C and cannot call a Python function; make the dictionary of parts")
        reference, x0 = reals(reference, 3), reals(x0)
        if len(reference) < steps + mpc.horizon + 1:
            raise ValueError(f"{len(reference)} rows of reference do not cover {steps} steps and the horizon")
        out = {"x": np.empty((steps + 1, 3)), "u": np.empty((steps, 2))}
        out |= {name: np.empty(steps) for name in ("residual", "solve_us", "innovation")}
        out |= {name: np.empty(steps, np.int32) for name in ("status", "iterations")}
        out |= {name: np.empty(steps, np.int32) for name in ("model", "resets") if supervisor}
        if every:
            count = -(-steps // every)
            out["theta"] = np.empty((count, self.N, self.d))
            out["covariance"] = np.empty((count, self.d, self.d))
        c_trace = _ControlTrace(every=every)
        for name, array in out.items():
            setattr(c_trace, name, ints(array) if array.dtype == np.int32 else doubles(array))
        settings = mpc.settings(self._callback(solver, mpc.horizon) if solver else SOLVER())
        call(
            "tk_control", self._handle, ct.byref(settings), active_effects(active), ct.c_size_t(len(active)),
            ct.c_double(dt), ct.c_size_t(steps), doubles(x0), doubles(reference), ct.c_int(learn),
            supervisor.settings((self.N, self.d)) if supervisor else None, ct.byref(c_trace),
        )  # fmt: skip
        return out

    def _callback(self, solver, horizon):
        shapes = ((self.N, self.d), (self.N,), (horizon, 3))

        def call(theta, psi, reference, u):
            arrays = (theta, psi, reference)
            result = solver(*(np.ctypeslib.as_array(a, shape) for a, shape in zip(arrays, shapes)))
            if result is None:
                return 1
            u[0], u[1] = result
            return 0

        return SOLVER(call)

    def soak(self, zeta, target, repeats):
        """Learns from rows zeta (K, N+m) -> target (K, N), `repeats` times over; returns counts."""
        zeta, target = reals(zeta, self.d), reals(target, self.N)
        result = _Soak()
        call(
            "tk_estimator_soak", self._handle, ct.c_size_t(len(zeta)), doubles(zeta), doubles(target),
            ct.c_size_t(repeats), ct.byref(result),
        )  # fmt: skip
        at = {name: getattr(result, name) for name in ("lost_positive_definite_at", "non_finite_at")}
        return {
            "updates": result.updates,
            "refused": result.refused,
            **{name: value if value >= 0 else None for name, value in at.items()},
        }


def lowpass(x, cutoff, rate, precision=64, usable=None):
    """Filters the columns of x (K, n), sampled at `rate` (Hz), by the C library's causal low-pass of `cutoff` (Hz).

    The filter restarts after each transition that is not usable (K - 1).
    """
    x = reals(x)
    if x.ndim != 2:
        raise ValueError(f"expected columns, got shape {x.shape}")
    y = np.empty_like(x)
    usable = None if usable is None else np.ascontiguousarray(usable, np.int32)
    call(
        "tk_lowpass", ct.c_int(precision), ct.c_double(cutoff), ct.c_double(rate), ct.c_size_t(len(x)),
        ct.c_size_t(x.shape[1]), doubles(x), ints(usable), doubles(y),
    )  # fmt: skip
    return y


def threshold(scores, eta=0.75):
    """Dead-zone threshold delta from the norms of calibration innovations: their eta-quantile.

    Paper, remark "Dead-Zone Threshold Selection".
    """
    scores = np.array(scores, dtype=np.float64)
    delta = ct.c_double()
    call("tk_threshold", doubles(scores), ct.c_size_t(len(scores)), ct.c_double(eta), ct.byref(delta))
    return delta.value
