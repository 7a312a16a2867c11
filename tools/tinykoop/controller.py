"""The model predictive controller of the library as a Python object."""

import numpy as np

from . import bridge
from .bridge.control import Controller, mpc_settings
from .bridge.library import raw
from .learner import BITS, OK, RLS, Health

METHODS = {"newton": bridge.MPC_NEWTON, "gradient": bridge.MPC_GRADIENT}


def _weights(given, size, name):
    """A matrix (size, size) from a matrix, its diagonal, or one number."""
    given = np.asarray(given, np.float64)
    matrix = given if given.ndim == 2 else np.diag(np.broadcast_to(given, size))
    if matrix.shape != (size, size):
        raise ValueError(f"{name} has shape {matrix.shape}, it must be ({size}, {size}) or its diagonal ({size},)")
    return matrix


class MPC:
    """Koopman-MPC on a learned model: tracks a reference over a horizon within limits of the inputs.

    Parameters:

    - horizon: H, steps, 1 to 1000
    - Q: weight of the tracking error, (n, n) or its diagonal; of the first n states
    - R: weight of the inputs, (m, m) or its diagonal
    - u_min, u_max: limits (m,), units of the inputs; -inf and inf: none
    - S: weight of the input rates, (m, m) or its diagonal; None: none
    - u_safe: (m,), the input if there is no plan; None: 0
    - method: ``newton`` (fastest) or ``gradient`` (smallest memory)
    - tolerance: of the KKT residual, units of the inputs; 0: the library's

    Source: paper, section "Koopman-MPC with Online Learning for DDR". The limits may be changed between two solves, which
    keeps the warm start.
    After a solve: ``status_`` (0, or why there was no plan), ``message_``, ``plan_`` (H, m), ``residual_``, ``iterations_``.
    """

    def __init__(self, horizon, Q, R, u_min, u_max, *, S=None, u_safe=None, method="newton", tolerance=0.0):
        self.horizon, self.Q, self.R, self.u_min, self.u_max = horizon, Q, R, u_min, u_max
        self.S, self.u_safe, self.method, self.tolerance = S, u_safe, method, tolerance
        self._made = None

    def _controller(self, model):
        """The controller of the library for such a model, with the limits of now, and the number of tracked states."""
        m, N = model.n_inputs, model.theta.shape[0]
        n = np.size(self.Q) if np.ndim(self.Q) == 1 else model.n_features_in_ if np.ndim(self.Q) == 0 else len(self.Q)
        low, high = (np.broadcast_to(np.asarray(a, np.float64), m) for a in (self.u_min, self.u_max))
        rates = None if self.S is None else _weights(self.S, m, "S")
        safe = None if self.u_safe is None else np.broadcast_to(np.asarray(self.u_safe, np.float64), m)
        if self.method not in METHODS:
            raise ValueError(f"method is {self.method!r}; it must be one of {', '.join(METHODS)}")
        weights = _weights(self.Q, n, "Q"), _weights(self.R, m, "R"), rates
        fixed = N, n, model.precision, self.horizon, self.method, self.tolerance
        key = (*fixed, *(None if a is None else a.tobytes() for a in (*weights, safe)))
        if self._made is None or self._made[0] != key:
            settings = mpc_settings(self.horizon, *weights, low, high, safe, self.tolerance, METHODS[self.method])
            self._made = key, Controller(settings, BITS[model.precision], N)
        self._made[1].limit(low, high)
        return self._made[1], n

    def __getstate__(self):
        return vars(self) | {"_made": None}  # a copy starts cold

    def solve(self, model: RLS, x: np.ndarray, reference: np.ndarray, u_before: np.ndarray | None = None) -> np.ndarray:
        """The input (m,) to give in state x (n,): the first of the plan along reference (H, n), or (n,) that is held.

        Starts from the last plan. If there is no plan, the safe input is returned and ``status_`` is not 0. u_before
        (m,): the input applied last, needed with S.
        """
        controller, n = self._controller(model)
        reference = np.broadcast_to(np.asarray(reference, np.float64), (self.horizon, n))
        psi = model.lift(np.reshape(np.asarray(x, np.float64), (1, -1)))[0]
        if self.S is not None and u_before is None:
            raise ValueError("u_before is needed: the weight S is of the change from the input applied last")
        return self._take(controller.solve(model.theta, psi, reference, u_before))

    def _take(self, found):
        """Keeps what a solve gave; returns the input."""
        self.status_, self.message_ = found.status, "" if found.status == OK else raw("tk_status_message", found.status).decode()
        self.plan_, self.residual_, self.iterations_ = found.plan, found.residual, found.iterations
        return found.u

    def reset(self):
        """Discards the plan: the next solve starts cold."""
        self._made = None


class Guard:
    """The supervisor: learns and plans with the learned model only while that can be trusted, else with the offline model.

    Parameters:

    - model: RLS that has begun, with its gate if it has one
    - mpc: MPC; its parameters are those of now, later changes of it are not seen
    - offline: Theta (N, N+m) of an offline model, such as ``RLS(..).fit(..).theta``
    - min_cosine, .., renewal: as in ``koopf_supervisor_config``; 0 is the library's default

    Call solve() and update() instead of those of the MPC and the RLS. ``model_`` is what the last input was planned on:
    online, last good, offline or none. ``resets_`` counts how often the learner was started again.
    """

    def __init__(self, model: RLS, mpc: MPC, offline: np.ndarray, *, min_cosine=0.0, min_gain=0.0, max_gain=0.0, max_error_ratio=0.0,
                 max_residual=0.0, max_tracking_ratio=0.0, patience=0, renewal=0):  # fmt: skip
        self.model, self.mpc = model, mpc
        self._core = model._started()
        settings = min_cosine, min_gain, max_gain, max_error_ratio, max_residual, max_tracking_ratio, patience, renewal
        mpc.reset()
        self._controller, self._n = mpc._controller(model)
        mpc.reset()  # the controller is the guard's alone
        self._controller.guard(bridge.Supervisor(np.asarray(offline, np.float64), *settings), self._core)

    def update(self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> Health:
        """As RLS.update()."""
        self._same()
        return self.model._told(self.model._core_update(x, u, x_next, self._controller.guarded_update))

    def solve(self, x: np.ndarray, reference: np.ndarray, u_before: np.ndarray | None = None) -> np.ndarray:
        """As MPC.solve(), whose ``status_``, ``plan_``, .. are set."""
        self._same()
        reference = np.broadcast_to(np.asarray(reference, np.float64), (self.mpc.horizon, self._n))
        psi = self.model.lift(np.reshape(np.asarray(x, np.float64), (1, -1)))[0]
        u = self.mpc._take(self._controller.guarded_solve(psi, reference, u_before))
        model, self.resets_ = self._controller.guarded_model
        self.model_ = bridge.MODELS[model]
        return u

    def _same(self):
        """Refuses a learner that was started again since: the supervisor knows the former one."""
        if self.model._core is not self._core:
            raise ValueError("the model was fitted again after this Guard was made: make another Guard for it")
