"""Learners in Python, side by side on one simulated drive: TinyKoop, scikit-learn, pykoop, pysindy, padasip and odmd.

All learn from the same rows. Most have the same features: those of DICTIONARY, which are lifted beforehand for the peers. pykoop and
pysindy are also measured as they come, with polynomials of the same degree that they make of states and inputs together.

A batch learner fits the first rows once. An online learner takes all rows one by one, and predicts before it learns; its errors
are of the same held-out rows. Predictions ten steps ahead propagate the lifted state with [A B], as MPC does; peers that make
their own features lift again in every step. All work in float64.
"""

import statistics
import time
import warnings
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version

import numpy as np

from .. import bridge, dictionaries
from ..experiments import scenario
from ..learner import RLS
from ..plumbing import results
from ..plumbing.errors import UserError

DICTIONARY = dictionaries.Poly(2) + dictionaries.Constant()
SIZE = 10  # N of it
DEGREE = 2  # the same, of peers that make their own features
ROWS, HELD_OUT, FEW_ROWS = 5000, 1000, 600  # of the drive, its last rows, and of a quick run
NOISE = 0.002  # m and rad, standard deviation
HOLD = 20  # rows for which a command is held
LAMBDA, P0, BATCH_P0 = 0.99, 100.0, 1e8
STEPS = (1, 10)  # ahead
STRIDE = 5  # rows between predictions
UPDATES = 300  # rows of a measurement of online learners
REPEATS = 15
SECONDS = 0.2  # asked of 5,000 updates with a dictionary in Python
IN_C = "replay in C"
SAME = 1e-6  # relative difference of Theta, up to which two learners have learned the same


@dataclass
class Drive:
    """States x (K+1, 3), inputs u (K, 2), lifted states psi (K+1, N), and how many rows are fitted."""

    x: np.ndarray
    u: np.ndarray
    psi: np.ndarray
    fitted: int

    @property
    def zeta(self):
        """Regressors (K, N+2)."""
        return np.hstack([self.psi[:-1], self.u])

    @property
    def starts(self):
        """Held-out rows from which predictions start."""
        return np.arange(self.fitted, len(self.u) - max(STEPS), STRIDE)


def drive(rows=ROWS):
    """The drive: commands at random, slip and friction in the paper's phases, noise."""
    random = np.random.default_rng(24)
    u = np.repeat(random.uniform((-1, -1), (1, 1), (-(-rows // HOLD), 2)), HOLD, axis=0)[:rows]
    effects = scenario.effects([rows * k // 5 for k in range(1, 5)])
    x = bridge.simulate(u, scenario.DT, active=effects) + NOISE * random.normal(size=(rows + 1, 3))
    return Drive(x, u, RLS(DICTIONARY, 2, precision="f64").begin(3).lift(x), rows - rows * HELD_OUT // ROWS)


# ---- accuracy --------------------------------------------------------------------------------------


def error(data, predicted, steps):
    """RMS position error (m) of states predicted from the starts."""
    away = predicted - data.x[data.starts + steps]
    return float(np.sqrt(np.mean(np.sum(away[:, :2] ** 2, axis=1))))


def linear(data, theta, steps):
    """States after so many steps from the starts, by Theta (N, N+2) or one for each start (W, N, N+2)."""
    psi = data.psi[data.starts]
    for k in range(steps):
        psi = np.einsum("...ij,...j->...i", theta, np.hstack([psi, data.u[data.starts + k]]))
    return psi[:, :3]


def stepwise(data, step, steps):
    """The same by step(x, u) -> x_next of a peer that makes its own features."""
    x = data.x[data.starts]
    for k in range(steps):
        x = step(x, data.u[data.starts + k])
    return x


# ---- batch ---------------------------------------------------------------------------------------


def _tinykoop_fit(data):
    """Lifts the states by itself."""
    model = RLS(DICTIONARY, 2, regulator="none", lam=1.0, p0=BATCH_P0, precision="f64").fit(
        data.x[: data.fitted + 1], data.u[: data.fitted]
    )
    return model.theta


def _sklearn_fit(data):
    from sklearn.linear_model import LinearRegression

    return LinearRegression(fit_intercept=False).fit(data.zeta[: data.fitted], data.psi[1 : data.fitted + 1]).coef_


def _pykoop_fit(data):
    """EDMD of the lifted states, without lifting functions."""
    import pykoop

    model = pykoop.Edmd(alpha=0).fit(data.zeta[: data.fitted], data.psi[1 : data.fitted + 1])
    return model.coef_.T


def _pykoop_own(data):
    import pykoop

    polynomials = [("polynomials", pykoop.PolynomialLiftingFn(order=DEGREE))]
    model = pykoop.KoopmanPipeline(lifting_functions=polynomials, regressor=pykoop.Edmd(alpha=0))
    model.fit(np.hstack([data.x[: data.fitted], data.u[: data.fitted]]), n_inputs=2, episode_feature=False)
    return lambda x, u: model.predict(np.hstack([x, u]))


def _pysindy_own(data):
    import pysindy

    library = pysindy.PolynomialLibrary(degree=DEGREE)
    model = pysindy.DiscreteSINDy(optimizer=pysindy.STLSQ(threshold=0.0, alpha=0.0), feature_library=library)
    model.fit(data.x[: data.fitted], t=scenario.DT, x_next=data.x[1 : data.fitted + 1], u=data.u[: data.fitted])
    return lambda x, u: np.asarray(model.predict(x, u=u))


OURS = "TinyKoop"
BATCH = {  # name: (package, function of the data that gives Theta or a step)
    OURS: ("tinykoop", _tinykoop_fit),
    "scikit-learn, LinearRegression": ("scikit-learn", _sklearn_fit),
    "pykoop, Edmd": ("pykoop", _pykoop_fit),
    "pykoop, own polynomials": ("pykoop", _pykoop_own),
    "pysindy, own polynomials": ("pysindy", _pysindy_own),
}


# ---- online ------------------------------------------------------------------------------------------


class _Tinykoop:
    """partial_fit() of one transition at a time, which lifts both states."""

    def __init__(self, data):
        self.model = RLS(DICTIONARY, 2, regulator="ef", lam=LAMBDA, p0=P0, precision="f64").begin(3)
        self.x, self.u = data.x, data.u

    def learn(self, k):
        self.model.partial_fit(self.x[k : k + 2], self.u[k : k + 1])

    @property
    def theta(self):
        return self.model.theta


class _Update(_Tinykoop):
    """update() of one transition at a time."""

    def learn(self, k):
        self.model.update(self.x[k], self.u[k], self.x[k + 1])


class _Padasip:
    """A filter for each of the N outputs, since one has a single output."""

    def __init__(self, data):
        from padasip.filters import FilterRLS

        self.zeta, self.psi = data.zeta, data.psi
        self.filters = [FilterRLS(n=self.zeta.shape[1], mu=LAMBDA, eps=1 / P0, w="zeros") for _ in range(self.psi.shape[1])]

    def learn(self, k):
        for i, one in enumerate(self.filters):
            one.adapt(self.psi[k + 1, i], self.zeta[k])

    @property
    def theta(self):
        return np.array([one.w for one in self.filters])


class _Odmd:
    """The inputs are part of its state, so that it learns what they do next, too; it begins with P = 1e15 and a random A."""

    def __init__(self, data):
        from odmd import OnlineDMD

        np.random.seed(24)
        self.zeta, self.N = np.vstack([data.zeta, data.zeta[-1:]]), data.psi.shape[1]
        self.zeta[-1, : self.N] = data.psi[-1]
        self.model = OnlineDMD(self.zeta.shape[1], LAMBDA)

    def learn(self, k):
        self.model.update(self.zeta[k], self.zeta[k + 1])

    @property
    def theta(self):
        return self.model.A[: self.N]


ONLINE = {
    f"{OURS}, partial_fit row by row": ("tinykoop", _Tinykoop),
    f"{OURS}, update row by row": ("tinykoop", _Update),
    "padasip, a FilterRLS per output": ("padasip", _Padasip),
    "odmd, OnlineDMD": ("odmd", _Odmd),
}
AT_ONCE = f"{OURS}, partial_fit in one call"


def models_ahead(data, learner):
    """Theta (W, N, N+2) at the starts, each of which has learned the rows before it."""
    out, at = [], 0
    for start in data.starts:
        for k in range(at, start):
            learner.learn(k)
        at = start
        out.append(np.array(learner.theta))
    return np.array(out)


# ---- times -------------------------------------------------------------------------------------------


def _ns(work):
    """Of the process, which other load on the machine changes little."""
    start = time.process_time_ns()
    work()
    return time.process_time_ns() - start


def _in_turns(work, repeats):
    """{name: [ns, ..]}: everyone has a turn in each repeat, after one that does not count."""
    times = {name: [] for name in work}
    for repeat in range(repeats + 1):
        for name, measure in work.items():
            spent = _ns(measure)
            if repeat:
                times[name].append(spent)
    return times


def _one_by_one(kind, data):
    def work():
        learner = kind(data)
        for k in range(UPDATES):
            learner.learn(k)

    return work


def _at_once(data):
    model = RLS(DICTIONARY, 2, regulator="ef", lam=LAMBDA, p0=P0, precision="f64").begin(3)
    model.partial_fit(data.x[: UPDATES + 1], data.u[:UPDATES])


def fit_times(data, repeats):
    """{name: [ns of a fit, ..]}."""
    return _in_turns({name: lambda fit=fit: fit(data) for name, (_, fit) in BATCH.items()}, repeats)


def update_times(data, repeats):
    """{name: [ns of UPDATES updates, ..]}."""
    return _in_turns({**{name: _one_by_one(kind, data) for name, (_, kind) in ONLINE.items()}, AT_ONCE: lambda: _at_once(data)}, repeats)


# ---- two claims ------------------------------------------------------------------------------------


def with_sines(x):
    """A dictionary in Python: of the same size as rbf_ddr."""
    return np.hstack(
        [x, np.sin(np.outer(x[:, 2], range(1, 10))).reshape(len(x), -1), np.cos(np.outer(x[:, 2], range(1, 11))).reshape(len(x), -1)]
    )


def _row_by_row(dictionary, data):
    model = RLS(dictionary, 2, precision="f32").begin(3)
    for k in range(len(data.u)):
        model.update(data.x[k], data.u[k], data.x[k + 1])


def claims(data, repeats):
    """Rows of bench.json: seconds of an update of every row, with a dictionary in Python and with one of the library."""
    times = _in_turns({
        "fit": lambda: RLS(with_sines, 2).fit(data.x, data.u),
        "update": lambda: _row_by_row(with_sines, data),
        "built in": lambda: RLS("rbf_ddr", 2).fit(data.x, data.u),
        "C": lambda: bridge.Estimator("rbf_ddr", "dz_cs", 32, form="sqrt", check=bridge.CHECK_REFUSE).replay(data.x, data.u, traces=()),
    }, repeats)  # fmt: skip
    seconds = {name: [ns * 1e-9 for ns in values] for name, values in times.items()}
    limit = [SECONDS * len(data.u) / ROWS] * repeats
    return [
        _row("python_fit_function", "s", seconds["fit"], limit, "asked for"),
        _row("python_update_function", "s", seconds["update"], limit, "asked for"),
        _row("python_fit_built_in", "s", seconds["built in"], seconds["C"], IN_C),
    ]


# ---- rows ------------------------------------------------------------------------------------------


def _row(task, unit, ours, peer, peer_name, package=None):
    """A row of bench.json from aligned lists."""
    middle = [float(f"{statistics.median(values):.4g}") for values in (ours, peer)]
    ratio = float(f"{statistics.median(b / a for a, b in zip(ours, peer)):.4g}")
    named = {"peer_name": peer_name, "peer_version": version(package) if package else None}
    return {"task": task, "unit": unit, "ours": middle[0], "peer": middle[1], **named, "ratio": ratio}


def _compared(task, unit, values, ours, packages):
    """A row of each name against that of ours."""
    return [_row(f"{task}, {name}", unit, values[ours], values[name], name, packages[name]) for name in values]


def errors_of(data):
    """{name: {steps: m}} of all learners; refuses a peer that should learn the same as TinyKoop and does not."""
    fits = {name: fit(data) for name, (_, fit) in BATCH.items()}
    learned = {name: models_ahead(data, kind(data)) for name, (_, kind) in ONLINE.items()}
    learned[AT_ONCE] = learned[f"{OURS}, partial_fit row by row"]
    ahead = {
        name: (lambda n, m=m: stepwise(data, m, n)) if callable(m) else (lambda n, m=m: linear(data, m, n))
        for name, m in {**fits, **learned}.items()
    }
    for ours, peer in ((fits[OURS], "scikit-learn, LinearRegression"), (fits[OURS], "pykoop, Edmd")):
        _same(peer, ours, fits[peer], data)
    _same("padasip", learned[AT_ONCE][-1], learned["padasip, a FilterRLS per output"][-1], data)
    return {name: {n: error(data, predict(n), n) for n in STEPS} for name, predict in ahead.items()}


def _same(peer, ours, theirs, data):
    """Refuses models that predict differently."""
    a, b = (data.zeta[: data.fitted] @ theta.T for theta in (ours, theirs))
    difference = np.abs(a - b).max() / np.abs(a).max()
    if not difference <= SAME:
        raise UserError(f"{peer} learns something else than TinyKoop: predictions differ by {difference:.3g} of the largest")


def _imported():
    """Refuses where a peer is missing."""
    for package in ("padasip", "sklearn", "pykoop", "pysindy", "odmd"):
        try:
            import_module(package)
        except ImportError:
            raise UserError(f"bench compares with {package}, which is missing: make bench installs it") from None


def run(repeats=REPEATS, rows=ROWS):
    """Measures everything; returns rows of bench.json."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of peers, about features that they would name
        _imported()
        data = drive(rows)
        errors = errors_of(data)
        packages = {name: package for name, (package, _) in {**BATCH, **ONLINE}.items()} | {AT_ONCE: "tinykoop"}
        out = _compared("python_fit", "ms", {n: [v * 1e-6 for v in ns] for n, ns in fit_times(data, repeats).items()}, OURS, packages)
        updates = {n: [v * 1e-3 / UPDATES for v in ns] for n, ns in update_times(data, repeats).items()}
        out += _compared("python_update", "us", updates, f"{OURS}, partial_fit row by row", packages)
        for n in STEPS:
            values = {name: [each[n]] for name, each in errors.items()}
            for names, ours in ((BATCH, OURS), ((*ONLINE, AT_ONCE), f"{OURS}, partial_fit row by row")):
                out += _compared(f"python_error_{n}", "m", {name: values[name] for name in names}, ours, packages)
        out += claims(data, repeats)
    show(out, rows)
    return out


COLUMNS = {"fit (ms)": "python_fit", "update (us)": "python_update"} | {f"error, {n} ahead (m)": f"python_error_{n}" for n in STEPS}


def table(rows):
    """(headers, lines): figures of each learner, and its time over that of TinyKoop."""
    at = {row["task"]: row for row in rows}
    found = [[at.get(f"{task}, {name}") for task in COLUMNS.values()] for name in (*BATCH, *ONLINE, AT_ONCE)]
    lines = [
        [name, *("-" if row is None else results.number(row["peer"]) for row in line), results.number((line[0] or line[1])["ratio"])]
        for name, line in zip((*BATCH, *ONLINE, AT_ONCE), found)
    ]
    return ["", *COLUMNS, f"time over that of {OURS}"], lines


CLAIMS = {
    "python_fit_function": f"dictionary in Python, one call: seconds, {SECONDS} asked for {ROWS:,}",
    "python_update_function": f"the same, row by row: seconds, {SECONDS} asked for {ROWS:,}",
    "python_fit_built_in": "rbf_ddr, one call: speed over that of a replay in C, 0.5 asked for",
}


def claim_lines(rows):
    """[[claim, figure]] of claims()."""
    at = {row["task"]: row for row in rows}
    return [[text, results.number(at[task]["ratio" if at[task]["peer_name"] == IN_C else "ours"])] for task, text in CLAIMS.items()]


def show(rows, count):
    """Both tables on the terminal; count: updates of the second."""
    results.print_table(
        "Learners in Python",
        *table(rows),
        "errors: RMS position error on held-out rows. time: median of the ratios of neighbouring measurements.",
    )
    results.print_table(f"{count:,} updates", ["", "figure"], claim_lines(rows))
