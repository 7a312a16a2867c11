"""The controller of lib/ and its supervisor."""

import ctypes as ct
from dataclasses import dataclass

import numpy as np

from .library import DOUBLES, call, doubles, raw, reals

SOLVER = ct.CFUNCTYPE(ct.c_int, DOUBLES, DOUBLES, DOUBLES, DOUBLES)


class _MpcSettings(ct.Structure):
    _fields_ = [
        *((name, ct.c_size_t) for name in ("n_states", "n_inputs", "horizon")),
        *((name, DOUBLES) for name in ("Q", "R", "S", "u_min", "u_max", "u_safe")),
        ("tolerance", ct.c_double),
        ("method", ct.c_int),
        ("solver", SOLVER),
    ]


class _Solution(ct.Structure):
    _fields_ = [
        ("status", ct.c_int),
        ("iterations", ct.c_size_t),
        ("residual", ct.c_double),
        ("microseconds", ct.c_double),
    ]


class _SupervisorSettings(ct.Structure):
    _fields_ = [
        ("offline", DOUBLES),
        ("min_cosine", ct.c_double),
        ("min_gain", ct.c_double),
        ("max_gain", ct.c_double),
        ("max_error_ratio", ct.c_double),
        ("max_residual", ct.c_double),
        ("max_tracking_ratio", ct.c_double),
        ("patience", ct.c_size_t),
        ("renewal", ct.c_size_t),
    ]


MPC_NEWTON, MPC_GRADIENT = 0, 1


@dataclass(frozen=True)
class Mpc:
    """Koopman-MPC of the DDR; the defaults are the paper's."""

    horizon: int = 50
    q: tuple = (20.0, 20.0, 3.0)  # diagonal of Q
    r: tuple = (0.05, 0.08)  # diagonal of R
    u_min: tuple = (0.0, -1.2)  # m/s, rad/s
    u_max: tuple = (3.5, 1.2)
    tolerance: float = 0.0  # of the KKT residual; 0: the library's
    method: int = MPC_NEWTON

    def settings(self, solver=SOLVER()):
        return mpc_settings(
            self.horizon, np.diag(self.q), np.diag(self.r), None, self.u_min, self.u_max, None, self.tolerance, self.method, solver
        )


def mpc_settings(horizon, Q, R, S, u_min, u_max, u_safe, tolerance, method, solver=SOLVER()):
    """Settings as C takes them, for Q (n, n), R and S (m, m), limits and the safe input (m); S and u_safe may be None."""
    kept = [None if a is None else reals(a) for a in (Q, R, S, u_min, u_max, u_safe)]
    settings = _MpcSettings(len(kept[0]), len(kept[1]), horizon, *map(doubles, kept), tolerance, method, solver)
    settings.kept = kept
    return settings


MODELS = ("online", "last good", "offline", "none")  # what the supervisor plans on, KOOP_SUPERVISOR_...


@dataclass(frozen=True)
class Supervisor:
    """The supervisor with its offline model (N, N+2); zeros mean the library's defaults."""

    offline: np.ndarray
    min_cosine: float = 0.0
    min_gain: float = 0.0
    max_gain: float = 0.0
    max_error_ratio: float = 0.0
    max_residual: float = 0.0
    max_tracking_ratio: float = 0.0
    patience: int = 0
    renewal: int = 0

    def settings(self, shape):
        offline = reals(self.offline)
        if offline.shape != shape:
            raise ValueError(f"expected an offline model of shape {shape}, got {offline.shape}")
        settings = _SupervisorSettings(
            doubles(offline), self.min_cosine, self.min_gain, self.max_gain, self.max_error_ratio,
            self.max_residual, self.max_tracking_ratio, self.patience, self.renewal,
        )  # fmt: skip
        settings.keep = offline
        return ct.byref(settings)


@dataclass(frozen=True)
class Solution:
    """What one solve gave: status (not 0: no plan, the safe input), input (m), plan (horizon, m), in units of the inputs."""

    status: int
    u: np.ndarray
    plan: np.ndarray
    residual: float  # KKT, in units of the inputs
    iterations: int
    microseconds: float  # condensing and solving, wall time


class Controller:
    """The library's Koopman-MPC by itself, for N lifted states; settings: of mpc_settings()."""

    def __init__(self, settings, precision, N):
        self._handle = ct.c_void_p()
        n, m, H = settings.n_states, settings.n_inputs, settings.horizon
        self._shapes = ((N, N + m), (N,), (H, n))
        self._inputs, self._plan = m, (H, m)
        call("tk_controller_new", ct.byref(settings), ct.c_int(precision), ct.c_size_t(N), ct.byref(self._handle))

    def __del__(self):
        if getattr(self, "_handle", None):
            raw("tk_controller_free", self._handle)

    def reset(self):
        """Forgets the plan: the next solve is a cold one."""
        call("tk_controller_reset", self._handle)

    def limit(self, u_min, u_max):
        """Limits (m,) from the next solve on, which keeps its warm start."""
        limits = self._checked(zip((u_min, u_max), [(self._inputs,)] * 2))
        call("tk_controller_limits", self._handle, *map(doubles, limits))

    def solve(self, theta, psi, reference, u_before=None):
        """Plans from psi (N) along reference (horizon, n) on theta (N, N+m); starts from the last plan, shifted."""
        arrays = self._checked(zip((theta, psi, reference), self._shapes))
        return self._solution("tk_controller_solve", (self._handle, *map(doubles, arrays)), u_before)

    def _checked(self, pairs):
        arrays = []
        for array, shape in pairs:
            arrays.append(reals(array))
            if arrays[-1].shape != shape:
                raise ValueError(f"expected shape {shape}, got {arrays[-1].shape}")
        return arrays

    def _solution(self, function, arguments, u_before):
        u, plan, solution = np.empty(self._inputs), np.empty(self._plan), _Solution()
        before = None if u_before is None else reals(np.reshape(u_before, self._inputs))
        call(function, *arguments, doubles(before), doubles(u), doubles(plan), ct.byref(solution))
        return Solution(solution.status, u, plan, solution.residual, solution.iterations, solution.microseconds)

    # ---- under a supervisor

    def guard(self, supervisor, estimator):
        """Puts a Supervisor over this controller and an Estimator of the same precision; later calls take that one."""
        self._guard, self._learner = _Guard(), estimator
        settings = supervisor.settings(self._shapes[0])
        call("tk_guard_new", settings, estimator.handle, self._handle, ct.byref(self._guard.handle))

    def guarded_solve(self, psi, reference, u_before=None):
        """As solve(), on the model that the supervisor trusts."""
        arrays = self._checked(zip((psi, reference), self._shapes[1:]))
        return self._solution("tk_guard_solve", (self._guard.handle, self._learner.handle, self._handle, *map(doubles, arrays)), u_before)

    def guarded_update(self, now, u, to, lifted=False):
        """As Estimator.update(), by the supervisor."""
        return self._learner.update(now, u, to, lifted, self._guard.handle)

    @property
    def guarded_model(self):
        """(index into MODELS of what the last input was planned on, how often the learner was started again)."""
        model, resets = ct.c_int(), ct.c_size_t()
        call("tk_guard_model", self._guard.handle, ct.byref(model), ct.byref(resets))
        return model.value, resets.value


class _Guard:
    def __init__(self):
        self.handle = ct.c_void_p()

    def __del__(self):
        if self.handle:
            raw("tk_guard_free", self.handle)
