"""The simulator and the estimators of host_sim/, through its one C interface (ctypes).

Arrays are float64 and row-major whatever precision the estimator works in. What the C side
refuses is raised as UserError with its message.
"""

import ctypes as ct
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from .. import platforms
from ..plumbing.errors import UserError
from ..plumbing.results import sweep

# The variable is for a build with sanitizers.
_LIBRARY = Path(os.environ.get("TINYKOOP_SIM", Path(__file__).resolve().parents[3] / "build/host/host_sim/libtinykoop_sim.so"))
_MAX_PARAMETERS = 6

CHECK_REFUSE, CHECK_REPORT, CHECK_DIAGONAL = 0, 1, 2

_DOUBLES = ct.POINTER(ct.c_double)
_INTS = ct.POINTER(ct.c_int32)


class _Active(ct.Structure):
    _fields_ = [
        ("effect", ct.c_char_p),
        ("n_parameters", ct.c_size_t),
        ("parameters", ct.c_double * _MAX_PARAMETERS),
        ("t0", ct.c_double),
        ("t1", ct.c_double),
    ]


class _Flight(ct.Structure):
    _fields_ = [("manoeuvre", ct.c_char_p), ("seed", ct.c_uint64), ("noise", ct.c_double)]


class _Recording(ct.Structure):
    _fields_ = [("rows", ct.c_size_t), ("dt", ct.c_double), ("x", ct.c_void_p), ("u", ct.c_void_p), ("usable", ct.c_void_p), ("warm_up", ct.c_size_t)]


class _Storage(ct.Structure):
    _fields_ = [
        (name, ct.c_size_t)
        for name in ("learner_sqrt", "learner_plain", "gate_sqrt", "gate_plain", "mpc_newton", "mpc_gradient", "mpc_rate", "guard", "model")
    ]


class _Settings(ct.Structure):
    _fields_ = [
        ("dictionary", ct.c_char_p),
        ("regulator", ct.c_char_p),
        ("form", ct.c_char_p),
        ("precision", ct.c_int),
        ("check", ct.c_int),
        ("n_inputs", ct.c_int),
        ("lam", ct.c_double),
        ("p0", ct.c_double),
        ("delta", ct.c_double),
        ("tau0", ct.c_double),
        ("eps_sift", ct.c_double),
        ("gate", ct.c_int),
    ]


class _Trace(ct.Structure):
    _fields_ = [
        ("error", _DOUBLES),
        ("predicted", _DOUBLES),
        ("innovation", _DOUBLES),
        ("status", _INTS),
        ("gated", _INTS),
        ("positive_definite", _INTS),
        ("trust", _INTS),
        ("trace", _DOUBLES),
        ("min_diagonal", _DOUBLES),
        ("norm_a", _DOUBLES),
        ("norm_b", _DOUBLES),
        ("norm_p", _DOUBLES),
        ("every", ct.c_size_t),
        ("theta", _DOUBLES),
        ("covariance", _DOUBLES),
    ]


_SOLVER = ct.CFUNCTYPE(ct.c_int, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES)


class _MpcSettings(ct.Structure):
    _fields_ = [
        ("horizon", ct.c_size_t),
        ("q", ct.c_double * 3),
        ("r", ct.c_double * 2),
        ("u_min", ct.c_double * 2),
        ("u_max", ct.c_double * 2),
        ("tolerance", ct.c_double),
        ("method", ct.c_int),
        ("solver", _SOLVER),
    ]


class _Solution(ct.Structure):
    _fields_ = [
        ("status", ct.c_int),
        ("iterations", ct.c_size_t),
        ("residual", ct.c_double),
        ("microseconds", ct.c_double),
    ]


class _ControlTrace(ct.Structure):
    _fields_ = [
        ("x", _DOUBLES),
        ("u", _DOUBLES),
        ("status", _INTS),
        ("residual", _DOUBLES),
        ("iterations", _INTS),
        ("solve_us", _DOUBLES),
        ("innovation", _DOUBLES),
        ("model", _INTS),
        ("resets", _INTS),
        ("every", ct.c_size_t),
        ("theta", _DOUBLES),
        ("covariance", _DOUBLES),
    ]


class _GuardSettings(ct.Structure):
    _fields_ = [
        ("offline", _DOUBLES),
        ("least_cosine", ct.c_double),
        ("least_gain", ct.c_double),
        ("most_gain", ct.c_double),
        ("most_error", ct.c_double),
        ("most_residual", ct.c_double),
        ("most_tracking", ct.c_double),
        ("patience", ct.c_size_t),
        ("renewal", ct.c_size_t),
    ]


class _Soak(ct.Structure):
    _fields_ = [
        ("updates", ct.c_uint64),
        ("refused", ct.c_uint64),
        ("lost_positive_definite_at", ct.c_int64),
        ("non_finite_at", ct.c_int64),
    ]


def _load():
    if not _LIBRARY.exists():
        raise UserError(f"{_LIBRARY.name} is not built: run `make build` first")
    c = ct.CDLL(str(_LIBRARY))
    for name in ("tk_message", "tk_effect_name"):
        getattr(c, name).restype = ct.c_char_p
    for name in ("tk_effect_parameters", "tk_log_rows"):
        getattr(c, name).restype = ct.c_size_t
    c.tk_log_dt.restype = ct.c_double
    return c


_c = None


def _call(name, *arguments):
    global _c
    if _c is None:
        _c = _load()
    return getattr(_c, name)(*arguments)


def _check(name, *arguments):
    if _call(name, *arguments) != 0:
        raise UserError(_call("tk_message").decode("utf-8", "backslashreplace"))


def _in(array, columns=None):
    array = np.ascontiguousarray(array, dtype=np.float64)
    if columns is not None and (array.ndim != 2 or array.shape[1] != columns):
        raise ValueError(f"expected an array of {columns} columns, got shape {array.shape}")
    return array


def _doubles(array):
    return None if array is None else array.ctypes.data_as(_DOUBLES)


def _ints(array):
    return None if array is None else array.ctypes.data_as(_INTS)


def _address(array):
    """As _doubles(), in a third of the time, for arrays of any type that the caller keeps."""
    return None if array is None else ct.c_void_p(array.ctypes.data)


# ---- plant -----------------------------------------------------------------------------------


EULER, MIDPOINT, ARC, SEMI_IMPLICIT = 0, 1, 2, 3  # integrators; the paper's is Euler


@dataclass(frozen=True)
class Effect:
    """An unmodelled effect acting on [t0, t1), s from the first row."""

    name: str
    parameters: tuple
    t0: float = 0.0
    t1: float = float("inf")


def effects(platform="ddr"):
    """{name: (block, ((parameter, unit, low, high, usual), ..))} of every effect, in the order of action."""
    platforms.check(platform)
    return dict(_effects(platform))


@cache
def _effects(platform):
    table, c_platform = {}, platform.encode()
    while name := _call("tk_effect_name", c_platform, ct.c_size_t(len(table))):
        place = (c_platform, ct.c_size_t(len(table)))
        rows = []
        for p in range(_call("tk_effect_parameters", *place)):
            parameter, unit = ct.c_char_p(), ct.c_char_p()
            low, high, usual = ct.c_double(), ct.c_double(), ct.c_double()
            _check(
                "tk_effect_parameter", *place, ct.c_size_t(p), ct.byref(parameter), ct.byref(unit),
                ct.byref(low), ct.byref(high), ct.byref(usual),
            )  # fmt: skip
            rows.append((parameter.value.decode(), unit.value.decode(), low.value, high.value, usual.value))
        block = ("actuator", "plant", "sensor")[_call("tk_effect_block", *place)]
        table[name.decode()] = (block, tuple(rows))
    return table


def usual_effect(name, t0=0.0, t1=float("inf"), platform="ddr"):
    """The effect with its usual parameters."""
    return Effect(name, tuple(row[4] for row in effects(platform)[name][1]), t0, t1)


def _active_effects(active):
    rows = [(e.name.encode(), len(e.parameters), e.parameters[:_MAX_PARAMETERS], e.t0, e.t1) for e in active]
    return (_Active * max(len(rows), 1))(*rows)


def simulate(u, dt, x0=(0.0, 0.0, 0.0), active=(), integrator=EULER):
    """Measured states (K+1, 3) [m, m, rad] of the DDR under commands u (K, 2) [m/s, rad/s]."""
    u = _in(u, 2)
    x0 = _in(x0)
    x = np.empty((len(u) + 1, 3))
    c_effects = _active_effects(active)
    _check(
        "tk_ddr_simulate", c_effects, ct.c_size_t(len(active)), ct.c_int(integrator), ct.c_double(dt),
        ct.c_size_t(len(u)), _doubles(x0), _doubles(u), _doubles(x),
    )  # fmt: skip
    return x


LONG = 20_000  # rows, of a log that is rolled as a whole
WARM_UP = 30.0  # s: ten time constants of the slowest lag that can be


class Rollouts:
    """A log's measured poses x (K, 3), predicted from its commands u (K or K-1, 2) in windows of their own.

    A window begins at the pose measured in a row of `starts` (S); `steps` (n) says how many steps later
    it is compared. Actuator states are rolled over the whole log, or if it is LONG from WARM_UP before each window, through
    what is not usable (K-1) too.
    Arrays are kept, not copied: they are to stay as they are.
    """

    def __init__(self, x, u, dt, starts, steps, usable=None, integrator=EULER):
        x, u = _in(x, 3), _in(u, 2)
        starts, steps = np.ascontiguousarray(starts, np.int64), np.ascontiguousarray(steps, np.int64)
        usable = None if usable is None else np.ascontiguousarray(usable, np.int32)
        if len(u) not in (len(x), len(x) - 1) or (usable is not None and len(usable) != len(x) - 1):
            raise ValueError(f"{len(u)} commands and usable {np.shape(usable)} do not go with {len(x)} poses")
        self._predicted, self._residual = np.empty((2, len(starts), len(steps), 3))
        self._kept = x, u, usable, starts, steps  # what the addresses are of
        warm_up = max(int(min(WARM_UP / dt, len(x))), 1) if len(x) > LONG and dt > 0 else 0
        log = _Recording(len(x), dt, _address(x), _address(u), _address(usable), warm_up)
        self._arguments = (
            ct.c_int(integrator), ct.byref(log),
            ct.c_size_t(len(starts)), _address(starts), ct.c_size_t(len(steps)), _address(steps),
            _address(self._predicted), _address(self._residual),
        )  # fmt: skip

    def predict(self, active=()):
        """predicted (S, n, 3) [m, m, rad] and residual (S, n, 3), both until the next call.

        The residual is measured less predicted: along, across [m, in the axes of the pose measured at the
        start] and heading [rad, wrapped]; NaN where an unusable transition, or the end of the log, lies between.
        """
        _check("tk_windows", _active_effects(active), ct.c_size_t(len(active)), *self._arguments)
        return self._predicted, self._residual


def windows(x, u, dt, starts, steps, active=(), usable=None, integrator=EULER):
    """What Rollouts predict with one set of effects."""
    return Rollouts(x, u, dt, starts, steps, usable, integrator).predict(active)


# ---- sizes -----------------------------------------------------------------------------------


def storage(n_lifted, n_states, n_inputs, horizon):
    """{what: reals} of the storage that lib/ needs: learner in both forms, controller, guard, stored model."""
    sizes = _Storage()
    counts = [ct.c_size_t(max(k, 0)) for k in (n_lifted, n_states, n_inputs, horizon)]
    _check("tk_sizes", *counts, ct.byref(sizes))
    return {name: getattr(sizes, name) for name, _ in _Storage._fields_}


# The true state of the flapping-wing vehicle, one slice of its columns each.
FWMAV_STATE = {
    "position": slice(0, 3),  # m, world
    "velocity": slice(3, 6),  # m/s, world
    "attitude": slice(6, 10),  # quaternion w, x, y, z, body to world
    "spin": slice(10, 13),  # rad/s, body
    "beat": 13,  # wing-beat frequency, Hz
    "phase": 14,  # of the beat, rad
    "dihedral": 15,  # rad; its rate follows, as with the next two
    "twist": 17,  # rad
    "share": 19,  # of thrust, moved to the left wing
}
_FWMAV_STATES, _FWMAV_HZ = 21, 100


def fwmav(manoeuvre, seconds, seed, active=(), noise=1.0):
    """A flight of the flapping-wing vehicle: hover, pitch (u: dihedral) or yaw (u: wing twist), 100 Hz.

    noise: factor of turbulence, IMU noise and bias. Returns the log as the flight controller writes it, and
    the true states (K, 21), see FWMAV_STATE.
    """
    if not 0.03 <= seconds <= 300:
        raise UserError(f"a flight of {seconds} s cannot be flown: the shortest log is 0.03 s, the battery lasts 300 s")
    if not 0 <= seed < 2**64:
        raise UserError(f"seed is {seed}, it must be between 0 and 2^64 - 1")
    rows = round(seconds * _FWMAV_HZ)
    x, u, states = np.empty((rows, 10)), np.empty((rows, 1)), np.empty((rows, _FWMAV_STATES))
    _check(
        "tk_fwmav_fly", _active_effects(active), ct.c_size_t(len(active)),
        ct.byref(_Flight(manoeuvre.encode(), seed, noise)), ct.c_size_t(rows), _doubles(x), _doubles(u), _doubles(states),
    )  # fmt: skip
    dt = 1 / _FWMAV_HZ
    return Log(np.arange(rows) * dt, x, u, np.ones(rows - 1, bool), dt), states


def fwmav_hover():
    """The true state (21) of the flapping-wing vehicle as it hovers, level and at rest."""
    state = np.zeros(_FWMAV_STATES)
    state[FWMAV_STATE["attitude"]] = 1, 0, 0, 0
    state[FWMAV_STATE["beat"]] = 17
    return state


def fwmav_roll(state, commands, dt, active=(), yaw=False):
    """True states (K+1, 21) of the vehicle without its controller, in still air, from `state`.

    commands (K, 4): wing-beat frequency with a full battery [Hz], dihedral, twist [rad], share; each held for dt.
    yaw: effects on the log's command act on the twist, else on the dihedral.
    """
    state, commands = _in(state), _in(commands, 4)
    if state.shape != (_FWMAV_STATES,):
        raise ValueError(f"expected a state of {_FWMAV_STATES}, got shape {state.shape}")
    states = np.empty((len(commands) + 1, _FWMAV_STATES))
    _check(
        "tk_fwmav_roll", _active_effects(active), ct.c_size_t(len(active)), ct.c_int(yaw), ct.c_double(dt),
        ct.c_size_t(len(commands)), _doubles(state), _doubles(commands), _doubles(states),
    )  # fmt: skip
    return states


class _Flown(ct.Structure):
    _fields_ = [
        ("rows", ct.c_size_t),
        ("dt", ct.c_double),
        ("x", ct.POINTER(ct.c_double)),
        ("u", ct.POINTER(ct.c_double)),
        ("usable", ct.POINTER(ct.c_int32)),
        ("yaw", ct.c_int),
        ("heading", ct.c_double),
        ("gain", ct.POINTER(ct.c_double)),
        ("push", ct.POINTER(ct.c_double)),
    ]


FWMAV_SENSED = 9


def fwmav_follow(log, gain, active=(), yaw=False, heading=0.0, starts=(), steps=(), push=None):
    """An observer of the flapping-wing vehicle along a log: predicted (K, 9), ahead (S, H, 9) or None.

    Predicted are gyro (rad/s), accelerometer (m/s^2), roll, pitch and yaw (rad) of the next row; gain (16, 9) takes what
    was missed to corrections of velocity, tilt, angular velocity, the accelerations by the air and the lift. yaw: u is the
    twist, else the dihedral, and the vehicle holds this heading (rad). ahead: predictions `steps` rows after `starts` (both
    rising) without correction. push (K, 6): further accelerations (m/s^2, rad/s^2). NaN where there is nothing to predict from.
    """
    x, u, gain = _in(log.x, 10), _in(log.u, 1), _in(gain, FWMAV_SENSED)
    push = None if push is None else _in(push, 6)
    usable = np.ascontiguousarray(log.usable, np.int32)
    starts, steps = np.ascontiguousarray(starts, np.int64), np.ascontiguousarray(steps, np.int64)
    predicted = np.empty((len(x), FWMAV_SENSED))
    ahead = np.empty((len(starts), len(steps), FWMAV_SENSED)) if len(starts) else None
    flown = _Flown(len(x), log.dt, _doubles(x), _doubles(u), _ints(usable), yaw, heading, _doubles(gain), _doubles(push))
    address = lambda a: a.ctypes.data_as(ct.POINTER(ct.c_int64))  # noqa: E731
    _check(
        "tk_fwmav_follow", _active_effects(active), ct.c_size_t(len(active)), ct.byref(flown), _doubles(predicted),
        ct.c_size_t(len(starts)), address(starts), ct.c_size_t(len(steps)), address(steps), _doubles(ahead),
    )  # fmt: skip
    return predicted, ahead


# ---- control ---------------------------------------------------------------------------------

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

    def _settings(self, solver=_SOLVER()):
        return _MpcSettings(
            self.horizon, (ct.c_double * 3)(*self.q), (ct.c_double * 2)(*self.r), (ct.c_double * 2)(*self.u_min),
            (ct.c_double * 2)(*self.u_max), self.tolerance, self.method, solver,
        )  # fmt: skip


MODELS = ("online", "last good", "offline", "none")  # what the guard plans on, KOOP_GUARD_...


@dataclass(frozen=True)
class Guard:
    """The guard with its offline model (N, N+2); zeros mean the library's defaults."""

    offline: np.ndarray
    least_cosine: float = 0.0
    least_gain: float = 0.0
    most_gain: float = 0.0
    most_error: float = 0.0
    most_residual: float = 0.0
    most_tracking: float = 0.0
    patience: int = 0
    renewal: int = 0

    def _settings(self, shape):
        offline = _in(self.offline)
        if offline.shape != shape:
            raise ValueError(f"expected an offline model of shape {shape}, got {offline.shape}")
        settings = _GuardSettings(
            _doubles(offline), self.least_cosine, self.least_gain, self.most_gain, self.most_error,
            self.most_residual, self.most_tracking, self.patience, self.renewal,
        )  # fmt: skip
        settings.keep = offline
        return ct.byref(settings)


@dataclass(frozen=True)
class Solution:
    """What one solve gave: status (not 0: no plan, the safe input), plan (horizon, 2) [m/s, rad/s]."""

    status: int
    plan: np.ndarray
    residual: float  # KKT, in units of the inputs
    iterations: int
    microseconds: float  # condensing and solving, wall time


class Controller:
    """The library's Koopman-MPC by itself, for problems that were written down; N lifted states."""

    def __init__(self, mpc, precision, N):
        self._handle = ct.c_void_p()
        self._shapes = ((N, N + 2), (N,), (mpc.horizon, 3))
        settings = mpc._settings()
        _check("tk_controller_new", ct.byref(settings), ct.c_int(precision), ct.c_size_t(N), ct.byref(self._handle))

    def __del__(self):
        if getattr(self, "_handle", None):
            _call("tk_controller_free", self._handle)

    def reset(self):
        """Forgets the plan: the next solve is a cold one."""
        _check("tk_controller_reset", self._handle)

    def solve(self, theta, psi, reference):
        """Plans from psi (N) along reference (horizon, 3) on theta (N, N+2); starts from the last plan, shifted."""
        arrays = [_in(array) for array in (theta, psi, reference)]
        for array, shape in zip(arrays, self._shapes):
            if array.shape != shape:
                raise ValueError(f"expected shape {shape}, got {array.shape}")
        plan, solution = np.empty((self._shapes[2][0], 2)), _Solution()
        _check("tk_controller_solve", self._handle, *map(_doubles, arrays), _doubles(plan), ct.byref(solution))
        return Solution(solution.status, plan, solution.residual, solution.iterations, solution.microseconds)


# ---- estimator -------------------------------------------------------------------------------

# What a replay writes down, with one row for each transition.
FLAGS = ("status", "gated", "positive_definite", "trust")
TRUST = ("trusted", "doubtful", "refuse")  # what `trust` counts
TRACES = ("error", "predicted", "innovation", *FLAGS, "trace", "min_diagonal", "norm_a", "norm_b", "norm_p")


class Estimator:
    """lib/ in float32 or float64.

    dictionary: poly_ddr, rbf_ddr, poly_fwmav, rbf_fwmav, or wide_fwmav (N = 40, for timing); regulator: none, ef,
    dz_cs, dz_ks, ct, sift; form: plain, sqrt, or textbook (the form that diverges, for comparison).
    check: CHECK_REPORT goes on after a loss of positive definiteness, as the paper's recursion does.
    gate: replays learn through the gate, with its defaults.
    """

    def __init__(self, dictionary, regulator, precision, *, form="plain", n_inputs=2, lam=0.98, p0=100.0,
                 delta=0.01, tau0=0.0, eps_sift=0.0, check=CHECK_REPORT, gate=False):  # fmt: skip
        settings = _Settings(
            dictionary.encode(), regulator.encode(), form.encode(), precision, check, n_inputs, lam, p0,
            delta, tau0, eps_sift, gate,
        )  # fmt: skip
        self._handle = ct.c_void_p()
        _check("tk_estimator_new", ct.byref(settings), ct.byref(self._handle))
        n, N, m = ct.c_size_t(), ct.c_size_t(), ct.c_size_t()
        _check("tk_estimator_sizes", self._handle, ct.byref(n), ct.byref(N), ct.byref(m))
        self.n, self.N, self.m = n.value, N.value, m.value
        self.dtype = np.float32 if precision == 32 else np.float64

    def __del__(self):
        if getattr(self, "_handle", None):
            _call("tk_estimator_free", self._handle)

    @property
    def d(self):
        """Number of regressors, N + m."""
        return self.N + self.m

    @property
    def theta(self):
        """Theta = [A B], (N, N+m)."""
        theta = np.empty((self.N, self.d))
        _check("tk_estimator_get_theta", self._handle, _doubles(theta))
        return theta

    @theta.setter
    def theta(self, value):
        value = _in(value, self.d)
        _check("tk_estimator_set_theta", self._handle, _doubles(value))

    @property
    def covariance(self):
        """P, (N+m, N+m)."""
        P = np.empty((self.d, self.d))
        _check("tk_estimator_get_covariance", self._handle, _doubles(P))
        return P

    def reset_covariance(self, p0):
        """Starts P again as p0 I and keeps Theta."""
        _check("tk_estimator_reset_covariance", self._handle, ct.c_double(p0))

    def model(self):
        """The bytes that koopf_model_load() or koopd_model_load() takes."""
        size = ct.c_size_t()
        _check("tk_estimator_model", self._handle, None, ct.byref(size))
        buffer = ct.create_string_buffer(size.value)
        _check("tk_estimator_model", self._handle, buffer, ct.byref(size))
        return buffer.raw

    def lift(self, x):
        """Psi(x), (K, N), of states x (K, n), lifted in this precision."""
        x = _in(x, self.n)
        psi = np.empty((len(x), self.N))
        _check("tk_lift", self._handle, ct.c_size_t(len(x)), _doubles(x), _doubles(psi))
        return psi

    def replay(self, x, u, usable=None, learn=True, every=0, traces=TRACES):
        """Feeds states x (K+1, n) and inputs u (K, m) through the estimator; returns a dict of traces.

        usable (K): which transitions may be learned from and scored. traces: names of TRACES, all by
        default; predicted has n columns. norm_a, norm_b, norm_p and positive_definite cost many times the
        update, so long replays name the others. With every > 0 also theta and covariance before each
        transition k with k % every == 0.
        """
        x, u = _in(x, self.n), _in(u, self.m)
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
            setattr(c_trace, name, _ints(array) if array.dtype == np.int32 else _doubles(array))
        usable = None if usable is None else np.ascontiguousarray(usable, dtype=np.int32)
        _check(
            "tk_replay", self._handle, ct.c_size_t(K), _doubles(x), _doubles(u), _ints(usable),
            ct.c_int(learn), ct.byref(c_trace),
        )  # fmt: skip
        return out

    def control(self, mpc, reference, dt, steps, x0, active=(), learn=True, every=0, solver=None, guard=None):
        """Drives the DDR along `reference` (steps + horizon + 1, 3) with Koopman-MPC on this model.

        solver(theta (N, N+2), psi (N), reference (horizon, 3)) -> u (2) or None: plans in the
        library's place; None is a fallback to the safe input (0, 0).

        guard: a Guard; the traces then have model (index into MODELS) and resets (of the learner, so far).

        Returns a dict of traces, one row for each step: u, status (not 0: the safe input was
        given), residual (KKT), iterations, solve_us, innovation; x has one row more; with every > 0 theta and
        covariance as in replay().
        """
        reference, x0 = _in(reference, 3), _in(x0)
        if len(reference) < steps + mpc.horizon + 1:
            raise ValueError(f"{len(reference)} rows of reference do not cover {steps} steps and the horizon")
        out = {"x": np.empty((steps + 1, 3)), "u": np.empty((steps, 2))}
        out |= {name: np.empty(steps) for name in ("residual", "solve_us", "innovation")}
        out |= {name: np.empty(steps, np.int32) for name in ("status", "iterations")}
        out |= {name: np.empty(steps, np.int32) for name in ("model", "resets") if guard}
        if every:
            count = -(-steps // every)
            out["theta"] = np.empty((count, self.N, self.d))
            out["covariance"] = np.empty((count, self.d, self.d))
        c_trace = _ControlTrace(every=every)
        for name, array in out.items():
            setattr(c_trace, name, _ints(array) if array.dtype == np.int32 else _doubles(array))
        settings = mpc._settings(self._callback(solver, mpc.horizon) if solver else _SOLVER())
        _check(
            "tk_control", self._handle, ct.byref(settings), _active_effects(active), ct.c_size_t(len(active)),
            ct.c_double(dt), ct.c_size_t(steps), _doubles(x0), _doubles(reference), ct.c_int(learn),
            guard._settings((self.N, self.d)) if guard else None, ct.byref(c_trace),
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

        return _SOLVER(call)

    def soak(self, zeta, target, repeats):
        """Learns from rows zeta (K, N+m) -> target (K, N), `repeats` times over; returns counts."""
        zeta, target = _in(zeta, self.d), _in(target, self.N)
        result = _Soak()
        _check(
            "tk_estimator_soak", self._handle, ct.c_size_t(len(zeta)), _doubles(zeta), _doubles(target),
            ct.c_size_t(repeats), ct.byref(result),
        )  # fmt: skip
        at = {name: getattr(result, name) for name in ("lost_positive_definite_at", "non_finite_at")}
        return {
            "updates": result.updates,
            "refused": result.refused,
            **{name: value if value >= 0 else None for name, value in at.items()},
        }


def lowpass(x, cutoff, rate, precision=64, usable=None):
    """lib/'s low-pass of `cutoff` (Hz) over the columns of x (K, n), sampled at `rate` (Hz), from the past alone.

    Begins anew after transitions that are not usable (K - 1).
    """
    x = _in(x)
    if x.ndim != 2:
        raise ValueError(f"expected columns, got shape {x.shape}")
    y = np.empty_like(x)
    usable = None if usable is None else np.ascontiguousarray(usable, np.int32)
    _check(
        "tk_lowpass", ct.c_int(precision), ct.c_double(cutoff), ct.c_double(rate), ct.c_size_t(len(x)),
        ct.c_size_t(x.shape[1]), _doubles(x), _ints(usable), _doubles(y),
    )  # fmt: skip
    return y


def threshold(scores, eta=0.75):
    """Dead-zone threshold calibrated on innovations of a source run: their eta-quantile (paper, remark)."""
    scores = np.array(scores, dtype=np.float64)
    delta = ct.c_double()
    _check("tk_threshold", _doubles(scores), ct.c_size_t(len(scores)), ct.c_double(eta), ct.byref(delta))
    return delta.value


# ---- logs ------------------------------------------------------------------------------------


@dataclass
class Log:
    """A log as the contract has it. usable[k]: transition k -> k + 1 is neither masked nor across a gap."""

    t: np.ndarray  # (K,) s
    x: np.ndarray  # (K, n)
    u: np.ndarray  # (K, m)
    usable: np.ndarray  # (K - 1,) bool
    dt: float  # s


def read_log(path, platform="ddr"):
    """Reads a CSV log; a bad one is refused with file, line and column."""
    handle = ct.c_void_p()
    _check("tk_log_read", os.fsencode(path), platform.encode(), ct.byref(handle))
    try:
        K = _call("tk_log_rows", handle)
        n, m = platforms.sizes(platform)
        t, x, u = np.empty(K), np.empty((K, n)), np.empty((K, m))
        usable = np.empty(K - 1, np.int32)
        _check("tk_log_get", handle, _doubles(t), _doubles(x), _doubles(u), _ints(usable))
        return Log(t, x, u, usable.astype(bool), _call("tk_log_dt", handle))
    finally:
        _call("tk_log_free", handle)


def write_log(path, x, u, dt, platform="ddr"):
    """Writes states x (K, n) and inputs u (K, m), t = k dt."""
    sweep(path)
    n, m = platforms.sizes(platform)
    x, u = _in(x, n), _in(u, m)
    _check(
        "tk_log_write", os.fsencode(path), platform.encode(), ct.c_size_t(len(x)), ct.c_double(dt),
        _doubles(x), _doubles(u),
    )  # fmt: skip
