"""The recursive learner of the library as a Python object, with the conventions of scikit-learn where they fit."""

import copy
import inspect
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import bridge, dictionaries
from .bridge.library import raw
from .plumbing import checkout
from .plumbing.errors import UserError
from .plumbing.results import write_bytes

OK, OUTLIER = 0, -9  # KOOP_OK, KOOP_E_OUTLIER
BITS = {"f32": 32, "f64": 64}
CHECKS = {"refuse": bridge.CHECK_REFUSE, "report": bridge.CHECK_REPORT, "diagonal": bridge.CHECK_DIAGONAL}
SUMS = "Sums of its functions at fixed states:"  # in the header of a model whose dictionary is a function
TRUST = {-1: None, 0: "trusted", 1: "doubtful", 2: "refuse"}


class Refused(UserError, ValueError):
    """The library refused a sample, and left the model as it was; ``status`` is one of ``KOOP_E_..`` of tinykoop.h."""

    def __init__(self, status: int, where: str):
        self.status = status
        super().__init__(f"{where}: {raw('tk_status_message', status).decode()}")


@dataclass(frozen=True)
class Health:
    """What one update says of the learner, as ``koopf_health``."""

    status: int  # 0, or -9 if the gate refused the sample as an outlier
    innovation: float  # |psi_next - Theta zeta| before the update, units of psi
    trace: float  # of P
    min_diagonal: float  # smallest diagonal element of P
    frozen: bool  # the regulator left P unchanged
    positive_definite: bool
    short_memory: bool  # fewer than N + m samples are remembered
    winding_up: bool  # the trace of P is above 100 times its first value
    trust: str | None  # trusted, doubtful or refuse, by the gate; None without one


@dataclass(frozen=True)
class Gate:
    """Settings of the gate, which refuses impossible samples; 0 is the library's default. See ``koopf_gate_config``."""

    multiple: float = 0.0  # standard deviations of an innovation, beyond which a sample is an outlier (5)
    floor: float = 0.0  # smallest standard deviation of an innovation, units of psi (0)
    patience: int = 0  # net rejections after which it reopens (5)
    hold: int = 0  # samples until a change is accepted as permanent (1000)


class RLS:
    """Learns psi_next = A psi + B u, Theta = [A B], by recursive least squares with a regulated covariance P.

    Parameters:

    - dictionary: name of a built-in one (``rbf_ddr``, ``poly_ddr``, ``rbf_fwmav``, ``poly_fwmav``), :class:`RBF`,
      :class:`Poly` or another of parts, their sum, or any function from states (K, n) to psi (K, N) that begins with
      the state
    - n_inputs: m, number of inputs
    - regulator: one of ``tinykoop.regulators()``
    - settings: {name: value} of the regulator, such as {"delta": 0.02}; what is not given has its default
    - form: ``sqrt`` or ``plain``, how P is stored
    - precision: ``f32`` or ``f64``, in which the C library works
    - lam: forgetting factor lambda, 0 < lam <= 1
    - p0: first P is p0 times the unit matrix
    - check: ``refuse``, ``report`` or ``diagonal``, what is done about a P that is not positive definite
    - gate: True or a :class:`Gate` refuses outliers; None: no gate

    The recursion is eq. (4) of the paper with the modifications of its section "Robust Covariance-Regulated
    Modifications". Results are those of the C library, bit for bit. A refused sample leaves the model as it was.
    """

    def __init__(self, dictionary: Any, n_inputs: int = 1, *, regulator: str = "dz_cs", settings: dict[str, float] | None = None,
                 form: str = "sqrt", precision: str = "f32", lam: float = 0.98, p0: float = 100.0, check: str = "refuse",
                 gate: Gate | bool | None = None):  # fmt: skip
        self.dictionary, self.n_inputs, self.regulator, self.settings, self.form = dictionary, n_inputs, regulator, settings, form
        self.precision, self.lam, self.p0, self.check, self.gate = precision, lam, p0, check, gate

    # ---- parameters, as scikit-learn has them ------------------------------------------------------

    @classmethod
    def _names(cls):
        return [name for name in inspect.signature(cls.__init__).parameters if name != "self"]

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """{name: value} of what the constructor was given."""
        return {name: getattr(self, name) for name in self._names()}

    def set_params(self, **params: Any) -> "RLS":
        """Changes parameters; they act from the next fit() on. Raises ValueError for a name that there is not."""
        for name, value in params.items():
            if name not in self._names():
                raise ValueError(f"there is no parameter {name!r}; there are {', '.join(self._names())}")
            setattr(self, name, value)
        return self

    def __repr__(self):
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in self.get_params().items())})"

    def __sklearn_is_fitted__(self) -> bool:
        return hasattr(self, "n_features_in_")

    # ---- learning -------------------------------------------------------------------------------------

    def _start(self, n: int):
        """A learner of states of n values that has learned nothing."""
        if self.precision not in BITS or self.check not in CHECKS:
            raise ValueError(f"precision is {self.precision!r} and check {self.check!r}: they must be among {[*BITS]} and {[*CHECKS]}")
        given = dictionaries.of(self.dictionary)
        unknown = set(self.settings or ()) - {s.name for s in bridge.regulators().get(self.regulator, ())}
        if self.regulator in bridge.regulators() and unknown:
            raise ValueError(f"regulator {self.regulator} has no setting {', '.join(sorted(unknown))}")
        gate = self.gate
        gate = (gate.multiple, gate.floor, gate.patience, gate.hold) if isinstance(gate, Gate) else bool(gate)
        core = bridge.Estimator(
            given if isinstance(given, str) else given.own(n), self.regulator, BITS[self.precision], form=self.form,
            n_inputs=self.n_inputs, lam=self.lam, p0=self.p0, check=CHECKS[self.check], gate=gate, **(self.settings or {}),
        )  # fmt: skip
        if core.n != n:
            raise ValueError(f"X has {n} features, but dictionary {given} is expecting {core.n} features as input")
        self._core, self._began = core, (given, self.precision)  # parameters that change later act from the next fit() on
        self._last = None  # state that was lifted last by a function, and its psi
        self.n_features_in_, self.n_refused_, self.health_ = n, 0, None

    def begin(self, n_states: int) -> "RLS":
        """Starts a learner of states of n_states values with Theta = 0, so that `theta` can be set before the first sample."""
        self._start(n_states)
        return self

    def _started(self, n: int | None = None):
        """The core, started for states of n values if it is not."""
        if not hasattr(self, "_core"):
            if n is None:
                given = dictionaries.of(self.dictionary)
                raise _not_fitted(f"{type(self).__name__} of {given} has learned nothing yet: call fit, partial_fit, update or load")
            self._start(n)
        return self._core

    def _one(self, x):
        """What the core takes of one state (n,)."""
        lift = self._core.by_function
        if not lift:
            return x
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, lift(x[None])[0]
        return self._last[1]

    def update(self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray) -> Health:
        """Learns from one transition, from state x (n,) by input u (m,) to x_next (n,).

        Raises Refused if the library refuses the sample, but not for what the gate takes for an outlier: then
        ``status`` is -9.
        """
        return self._told(self._core_update(x, u, x_next))

    def _core_update(self, x, u, x_next, learn=None):
        """What `learn`, by default the core, says of one transition."""
        x, x_next = (np.array(a, np.float64, ndmin=1) for a in (x, x_next))
        u = np.array(u, np.float64, ndmin=1)
        core = self._started(x.size)
        if x.shape != (core.n,) or x_next.shape != (core.n,) or u.shape != (core.m,):
            raise ValueError(f"expected x ({core.n},), u ({core.m},), x_next ({core.n},), got {x.shape}, {u.shape}, {x_next.shape}")
        health = (learn or core.update)(self._one(x), u, self._one(x_next), core.by_function is not None)
        if health.status not in (OK, OUTLIER):
            raise Refused(health.status, "update")
        return health

    def _told(self, health):
        self.n_refused_ += health.status != OK
        flags = (bool(getattr(health, name)) for name in ("frozen", "positive_definite", "short_memory", "winding_up"))
        self.health_ = Health(health.status, health.innovation, health.trace, health.min_diagonal, *flags, TRUST[health.trust])
        return self.health_

    def partial_fit(self, X: np.ndarray, U: np.ndarray, usable: np.ndarray | None = None) -> "RLS":
        """Learns from a series: states X (K+1, n) in the order of time, inputs U (K, m), or (K+1, m) whose last row is not used.

        usable (K,): which transitions to learn from; the others may hold NaN. Where two series follow one another, no
        transition from the one to the other is learned. Raises ValueError for NaN and shapes that do not fit, and
        Refused for the first sample that the library refuses for another reason than the gate.
        """
        X, U, usable = self._series(X, U, usable)
        core = self._started(X.shape[1])
        trace = core.replay(X, U, usable=usable, traces=("status",))["status"]
        bad = np.flatnonzero((trace < 0) & (trace != OUTLIER))
        self.n_refused_ += int((trace < 0).sum())
        if bad.size:
            raise Refused(int(trace[bad[0]]), f"row {bad[0]}, and {bad.size - 1} more" if bad.size > 1 else f"row {bad[0]}")
        return self

    def fit(self, X: np.ndarray, U: np.ndarray, usable: np.ndarray | None = None) -> "RLS":
        """As partial_fit, of a learner that forgets all it has learned before."""
        X, U, usable = self._series(X, U, usable)
        self._start(X.shape[1])
        return self.partial_fit(X, U, usable)

    def _series(self, X, U, usable):
        X = _states(X)
        if len(X) < 2:
            raise ValueError(f"X has {len(X)} sample(s): a transition needs 2 at least")
        if getattr(self, "n_features_in_", X.shape[1]) != X.shape[1] and hasattr(self, "_core"):
            raise ValueError(f"X has {X.shape[1]} features, but {type(self).__name__} is expecting {self.n_features_in_} features as input")
        U = _inputs(U, self.n_inputs, len(X))
        good = np.ones(len(X) - 1, bool) if usable is None else np.asarray(usable, bool)
        if good.shape != (len(X) - 1,):
            raise ValueError(f"usable has shape {good.shape}; there are {len(X) - 1} transitions")
        known = np.isfinite(X).all(1)
        if (good & ~(known[:-1] & known[1:] & np.isfinite(U).all(1))).any():
            raise ValueError("Input X or U contains NaN or infinity in a transition that is usable; mask it by `usable`")
        return X, U, good

    # ---- predictions ---------------------------------------------------------------------------------

    def lift(self, X: np.ndarray) -> np.ndarray:
        """psi (K, N) of states X (K, n), in the precision of the learner."""
        X = self._known(X)
        return self._core.lift(X)

    def predict(self, X: np.ndarray, U: np.ndarray | None = None) -> np.ndarray:
        """States (K, n) one step after X (K, n) under U (K, m), 0 if not given."""
        X = self._known(X)
        U = np.zeros((len(X), self.n_inputs)) if U is None else _inputs(U, self.n_inputs, len(X) + 1)
        lift = self._core.by_function
        return self._core.predict(lift(X) if lift else X, U, lift is not None)[:, : self.n_features_in_]

    def rollout(self, x0: np.ndarray, U: np.ndarray) -> np.ndarray:
        """States (H+1, n) from x0 (n,) on under U (H, m), by the linear model alone: the state is lifted once, as in MPC."""
        x0 = self._known(np.reshape(np.asarray(x0, np.float64), (1, -1)))[0]
        U = np.asarray(U, np.float64)
        U = U.reshape(len(U), -1)
        return self._core.rollout(self._one(x0), U, self._core.by_function is not None)[:, : self.n_features_in_]

    def score(self, X: np.ndarray, U: np.ndarray) -> float:
        """R^2 of predictions one step ahead in a series, as in partial_fit; the mean over the states."""
        self._started()
        X, U, _ = self._series(X, U, None)
        left = ((X[1:] - self.predict(X[:-1], U)) ** 2).sum(0)
        whole = ((X[1:] - X[1:].mean(0)) ** 2).sum(0)
        return float(np.mean(np.where(whole > 0, 1 - left / np.where(whole > 0, whole, 1), np.where(left > 0, 0.0, 1.0))))

    def _known(self, X):
        core, X = self._started(), _states(X)
        if X.shape[1] != core.n:
            raise ValueError(f"X has {X.shape[1]} features, but {type(self).__name__} is expecting {core.n} features as input")
        if not np.isfinite(X).all():
            raise ValueError("Input X contains NaN or infinity")
        return X

    # ---- the model -------------------------------------------------------------------------------------

    @property
    def theta(self) -> np.ndarray:
        """Theta = [A B], (N, N+m)."""
        return self._started().theta

    @theta.setter
    def theta(self, value: np.ndarray):
        self._started().theta = value

    @property
    def P(self) -> np.ndarray:
        """Covariance, (N+m, N+m)."""
        return self._started().covariance

    def reset_covariance(self, p0: float | None = None):
        """P becomes p0 times the unit matrix; Theta stays."""
        self._started().reset_covariance(self.p0 if p0 is None else p0)

    def export(self, path: str | Path, name: str = "koop_model", covariance: bool = False, comment: str = ""):
        """Writes the model for firmware: a C header (.h), with C code of a dictionary of parts, or bytes (.bin).

        In C, ``koopf_model_load`` or ``koopd_model_load`` takes the bytes. With `covariance` also P is in them, and
        learning continues where it was. name: prefix of what the header defines; comment: for its first line.
        """
        path, core = Path(path), self._started()
        if path.suffix not in (".h", ".bin"):
            raise UserError(f"{path}: the model is written as .h (C header) or .bin; choose one of these endings")
        model = core.model(covariance)
        write_bytes(path, self._header(model, name, comment).encode() if path.suffix == ".h" else model)

    def _header(self, model, name, comment):
        given, precision = self._began
        lines = [", ".join(f"0x{byte:02x}" for byte in model[i : i + 16]) for i in range(0, len(model), 16)]
        sizes = f"n = {self._core.n}, N = {self._core.N}, m = {self._core.m}"
        told = dictionaries.comment(f"TinyKoop model: float{BITS[precision]}, {sizes}{comment and f', {comment}'}")
        include, own, body = "", "", ",\n\t".join(lines)
        if isinstance(given, dictionaries.Dictionary):
            include, own = '#include "tinykoop.h"\n', dictionaries.c_code(given, self._core.n, name, precision)
        elif not isinstance(given, str):
            told += "\n" + dictionaries.comment(f'It loads only with the dictionary "{given.own(self._core.n).name}": {given}')
            told += "\n" + dictionaries.comment(f"{SUMS} {' '.join(f'{value:.9g}' for value in self._sums())}")
        return f"{told}\n#include <stdint.h>\n{include}\nstatic const uint8_t {name}[{len(model)}] = {{\n\t{body},\n}};\n{own and chr(10) + own}"

    def load(self, path: str | Path, n_states: int | None = None) -> "RLS":
        """Takes a model that export() or `tinykoop fit` wrote. n_states: needed where the dictionary does not tell it.

        Raises UserError if it has another dictionary, precision or size, or is damaged. A header also tells a function
        from one of the same name that has changed since; bytes (.bin) do not.
        """
        if not hasattr(self, "_core"):
            self._start(_states_of(self.dictionary, n_states))
        self._take(*_stored(Path(path)), path)
        return self

    def _sums(self):
        """What tells the functions of a dictionary from others of the same name; nothing of settings, which its name tells."""
        given, _ = self._began
        return [] if isinstance(given, (str, dictionaries.Dictionary)) else dictionaries.fingerprint(self._core)[0].tolist()

    def _take(self, model, sums, where):
        before = self._core.model(covariance=True)
        self._core.load(model)
        if sums and not dictionaries.is_as(self._core, sums):
            self._core.load(before)
            raise UserError(f"{where}: the functions of dictionary {self._began[0]} have changed since this model was fitted; fit it again")

    # ---- copies ----------------------------------------------------------------------------------------

    def __getstate__(self):
        state = {key: value for key, value in vars(self).items() if key not in ("_core", "_began", "_last")}
        return state | ({"_model": self._core.model(covariance=True), "_sums": self._sums()} if hasattr(self, "_core") else {})

    def __setstate__(self, state):
        state = dict(state)
        model, sums = state.pop("_model", None), state.pop("_sums", [])
        counted = {key: state.get(key) for key in ("n_features_in_", "n_refused_", "health_")}
        vars(self).update(state)
        if model is not None:
            self._start(counted["n_features_in_"])
            self._take(model, sums, "pickle")
            vars(self).update(counted)

    def __deepcopy__(self, memo):
        other = type(self).__new__(type(self))
        other.__setstate__({key: copy.deepcopy(value, memo) for key, value in self.__getstate__().items()})
        return other

    def __sklearn_tags__(self):
        from sklearn.utils import RegressorTags, Tags, TargetTags

        target = TargetTags(required=True, multi_output=True, single_output=True)
        return Tags(estimator_type=None, target_tags=target, regressor_tags=RegressorTags(poor_score=True), non_deterministic=False)


def c_library() -> Path:
    """Folder of the C sources: firmware compiles koopf.c or koopd.c there, with -Iinclude, beside a header of export()."""
    return checkout.data("lib", "_lib/c")


def _states(X):
    """X (K, n) as float64."""
    if hasattr(X, "toarray"):
        raise TypeError("X is a sparse matrix: dense data is required; use X.toarray()")
    X = np.asarray(X)
    if X.dtype.kind == "c":
        raise ValueError("Complex data not supported: states are real numbers")
    X = np.ascontiguousarray(X, np.float64)
    if X.ndim != 2:
        raise ValueError(f"expected X of shape (K, n), got {X.shape}. Reshape your data either using array.reshape(-1, 1) or (1, -1)")
    if 0 in X.shape:
        short = f"{X.shape[0]} sample(s)" if not X.shape[0] else f"{X.shape[1]} feature(s)"
        raise ValueError(f"X has {short} (shape={X.shape}) while a minimum of 1 is required.")
    return X


def _inputs(U, m, rows):
    """U as (rows - 1, m)."""
    if U is None:
        raise ValueError("U is None: the inputs of the series are needed; requires y to be passed, but the target y is None")
    U = np.asarray(U)
    if U.dtype.kind == "c":
        raise ValueError("Complex data not supported: inputs are real numbers")
    U = U.astype(np.float64)
    U = U.reshape(len(U), -1) if U.ndim else U.reshape(1, 1)
    if len(U) not in (rows - 1, rows) or U.shape[1] != m:
        raise ValueError(
            f"U has shape {U.shape}: ({rows - 1}, {m}) or ({rows}, {m}) goes with X; inconsistent numbers of samples or inputs"
        )
    return np.ascontiguousarray(U[: rows - 1])


def _not_fitted(text):
    """scikit-learn's exception where it is installed, which is a ValueError and an AttributeError, too."""
    try:
        from sklearn.exceptions import NotFittedError
    except ImportError:
        return ValueError(text)
    return NotFittedError(text)


def _states_of(dictionary, given):
    """Number of states of a dictionary."""
    if given is not None:
        return given
    if isinstance(dictionary, str):
        return bridge.Estimator(dictionary, "none", 64, n_inputs=1).n
    raise ValueError("this dictionary does not say how many states the model has: give n_states")


def _stored(path):
    """Bytes of a .bin, or of the first array of a header, and the sums of its dictionary, if it has them."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from None
    if path.suffix != ".h":
        return content, []
    found = re.search(rb"uint8_t\s+\w+\[\d+\]\s*=\s*\{([^}]*)\}", content)
    if not found:
        raise UserError(f"{path}: has no array of uint8_t; give a header that export() or `tinykoop fit` wrote")
    sums = re.search(rf"{SUMS}([-+.\w ]*)".encode(), content)
    return bytes(int(byte, 16) for byte in found[1].replace(b",", b" ").split()), [
        float(value) for value in sums[1].split()
    ] if sums else []
