"""The paper's DDR case study: commands, phases, methods, settings, and its published figures."""

from dataclasses import dataclass

import numpy as np

from .. import bridge, dictionaries
from ..plumbing.errors import UserError

DT = 0.05  # s
STEPS = 5000
PHASES = ("nominal", "slip", "friction", "slip + friction", "nominal")

P0 = 100.0  # paper, section "Comparison Protocol", times the identity

# Regularisation of the offline fit: P0 = 1 / ridge. The paper gives none; 1e-8 is the power of
# ten that gives its |A|.
OFFLINE_P0 = 1e8

REGULATORS = tuple(name for name in bridge.regulator_names() if name != "none")  # the paper's, then others that lib/ lists


class _Labels(dict):
    """A regulator that the paper does not have is called by its name."""

    def __missing__(self, name):
        return name


LABELS = _Labels({
    "offline": "Offline",
    "none": "no forgetting",
    "ef": "vanilla",
    "dz_cs": "DZ-CS",
    "dz_ks": "DZ-KS",
    "ct": "CT",
    "sift": "SIFt",
})  # fmt: skip

# Paper, table "Learning Performance of a DDR under Unmodeled Dynamics":
# mean error, final |P|_F, final |A|_F, skip rate
PAPER = {
    ("rbf", "offline"): (1.30e-2, None, 76.2, None),
    ("poly", "ef"): (1.96e-3, 1.94e4, 53.2, None),
    ("poly", "dz_cs"): (1.95e-3, 1.95e4, 53.1, 0.0324),
    ("poly", "dz_ks"): (1.98e-3, 1.94e4, 52.9, 0.0302),
    ("poly", "ct"): (4.47e-3, 9.00e2, 637.0, None),
    ("poly", "sift"): (4.24e-3, 64.5, 88.7, None),
    ("rbf", "ef"): (1.95, 2.51e46, 3.93e4, None),
    ("rbf", "dz_cs"): (1.08e-3, 3.47e3, 2.93, 0.9774),
    ("rbf", "dz_ks"): (4.64e-3, 2.39e4, 2.97, 0.958),
    ("rbf", "ct"): (5.57e-3, 664.0, 2.98, None),
    ("rbf", "sift"): (4.19e-3, 348.0, 2.92, None),
}


def title(dictionary):
    """Name of a dictionary in tables and figures; of a file's, NAME."""
    return {"poly": "Poly", "rbf": "RBF"}.get(dictionary, dictionary.rpartition(":")[2])


@dataclass(frozen=True)
class Method:
    """A dictionary and a regulator, or the offline baseline: the paper's eleven, and one for each other regulator of lib/."""

    dictionary: str
    regulator: str

    @property
    def label(self):
        name = title(self.dictionary)
        if self.regulator == "offline":
            return f"Offline {name}"
        return name if self.regulator == "ef" else f"{name} ({LABELS[self.regulator]})"


_OTHERS = tuple((dictionary, name) for dictionary in ("poly", "rbf") for name in REGULATORS if (dictionary, name) not in PAPER)
METHODS = tuple(Method(*key) for key in (*PAPER, *_OTHERS))


def methods_of(dictionary):
    """The offline baseline and every regulator, with one dictionary."""
    return tuple(Method(dictionary, regulator) for regulator in ("offline", *REGULATORS))


def beside(dictionary, x):
    """(dictionaries, METHODS) and what --dictionary adds, which must be finite on the run x; None adds nothing."""
    if dictionary is None:
        return dictionaries.BUILT_IN, METHODS
    if dictionary in dictionaries.BUILT_IN:
        raise UserError(f"--dictionary {dictionary}: it is among those that run in any case; give one of your own")
    estimator = bridge.Estimator(dictionaries.named(dictionary, "ddr", x.shape[1]), "none", 64)
    dictionaries.check(estimator, x, np.ones(len(x), bool), dictionary)
    return (*dictionaries.BUILT_IN, dictionary), METHODS + methods_of(dictionary)


def finding(text, names):
    """The title of a figure: a finding on the built-in dictionaries, and said to be one where another stands beside them."""
    return text if len(names) == len(dictionaries.BUILT_IN) else f"Poly, RBF: {text}"


def built_in(found):
    """Of {method: ..}, the part with the built-in dictionaries, of which a finding speaks."""
    return {method: one for method, one in found.items() if method.dictionary in dictionaries.BUILT_IN}


def families(found):
    """{end of a plot's name: its part of {method: ..}}: a plot of the paper's regulators, and one of the regulators of other papers."""
    names = {regulator for _, regulator in PAPER}
    paper = {method: one for method, one in found.items() if method.regulator in names}
    others = {method: one for method, one in found.items() if method not in paper or method.regulator == "offline"}
    return {"": paper, "_others": others}


def labels(methods):
    """Names of methods in the title of a plot."""
    return ", ".join(method.label for method in methods) or "none"


def wound_up(norms):
    """Of {method: |P| over time}, the methods whose |P| ends more than 100 times as large as it begins."""
    return [method for method, norm in norms.items() if not norm[-1] <= 100 * norm[0]]


def commands(steps=STEPS):
    """Open-loop commands [v (m/s), omega (rad/s)], (steps, 2)."""
    k = np.arange(steps)
    return np.stack([1.5 + 0.3 * np.sin(0.1 * k), 0.6 * np.cos(0.08 * k)], axis=1)


def effects(edges=(1000, 2000, 3000, 4000), dt=DT):
    """Slip and friction as they come and go at the given steps."""
    t = [edge * dt for edge in edges]
    return [
        bridge.usual_effect("pacejka_slip", t[0], t[1]),
        bridge.usual_effect("stribeck_friction", t[1], t[2]),
        bridge.usual_effect("pacejka_slip", t[2], t[3]),
        bridge.usual_effect("stribeck_friction", t[2], t[3]),
    ]


def drive(steps=STEPS):
    """States (steps + 1, 3) and commands (steps, 2) of the five-phase run."""
    u = commands(steps)
    return bridge.simulate(u, DT, active=effects()), u


def offline_theta(dictionary, steps=STEPS):
    """Theta of the offline baseline: the same recursion with lambda = 1 over the nominal robot's run.

    Fitted on the host, so always in float64; a float32 estimator starts from it rounded.
    """
    u = commands(steps)
    estimator = bridge.Estimator(dictionaries.named(dictionary, "ddr", 3), "none", 64, p0=OFFLINE_P0)
    estimator.replay(bridge.simulate(u, DT), u)
    return estimator.theta


def start(method, precision, form="plain", **settings):
    """The estimator of one method as it begins; the offline one has its model."""
    offline = method.regulator == "offline"
    lifting = dictionaries.named(method.dictionary, "ddr", 3)
    estimator = bridge.Estimator(lifting, "none" if offline else method.regulator, precision, form=form, **settings)
    if offline:
        estimator.theta = offline_theta(method.dictionary)
    return estimator


def run(method, precision, x, u, *, every=0, **settings):
    """Replays a run through one method; returns (estimator, trace)."""
    estimator = start(method, precision, **settings)
    return estimator, estimator.replay(x, u, learn=method.regulator != "offline", every=every)


def by_precision(rows):
    """[(method, its float64 row, its float32 row)] of a list of results."""
    table = {}
    for row in rows:
        table.setdefault(Method(row["dictionary"], row["regulator"]), {})[row["precision"]] = row
    return [(method, pair["f64"], pair["f32"]) for method, pair in table.items()]


ROLLOUT_START, ROLLOUT_STRIDE = 200, 25
HORIZONS = (1, 2, 5, 10, 20, 50)


def rollout_errors(estimator, trace, x, u):
    """Mean |x - predicted| at each of HORIZONS, from windows started every ROLLOUT_STRIDE steps.

    Theta is frozen at the start of a window and the lifted state is propagated, never lifted again.
    `trace` must hold theta every ROLLOUT_STRIDE steps.
    """
    starts = np.arange(ROLLOUT_START, len(u) - max(HORIZONS), ROLLOUT_STRIDE)
    theta = trace["theta"][starts // ROLLOUT_STRIDE].astype(estimator.dtype)
    z, inputs, errors = estimator.lift(x[starts]).astype(estimator.dtype), u.astype(estimator.dtype), {}
    with np.errstate(over="ignore", invalid="ignore"):
        for h in range(1, max(HORIZONS) + 1):
            z = (theta @ np.concatenate([z, inputs[starts + h - 1]], axis=1)[..., None])[..., 0]
            if h in HORIZONS:
                errors[h] = np.mean(np.linalg.norm(x[starts + h] - z[:, : estimator.n], axis=1))
    return errors


def spectrum(covariances):
    """(largest eigenvalue, condition number over the positive ones) of each P, (count, d, d)."""
    largest, condition = [], []
    for P in covariances:
        if not np.all(np.isfinite(P)):
            largest.append(np.nan)
            condition.append(np.nan)
            continue
        w = np.linalg.eigvalsh((P + P.T) / 2)
        largest.append(w[-1])
        condition.append(w[-1] / np.min(w[w > 0], initial=np.inf))
    return np.array(largest), np.array(condition)


def first(condition):
    """Index of the first true element, None if there is none."""
    hits = np.flatnonzero(condition)
    return int(hits[0]) if len(hits) else None


def across(poses, path):
    """How far positions (K, 2 or more) lie to the left of the poses (K, 3) of a path, m."""
    (dx, dy), heading = (poses[:, :2] - path[:, :2]).T, path[:, 2]
    return np.cos(heading) * dy - np.sin(heading) * dx


def mark_phases(axes, steps=STEPS, names=True):
    """Vertical lines where the paper's five phases begin, in seconds."""
    edges = np.arange(5) * steps // 5
    for edge, name in zip(edges, PHASES):
        if edge:
            axes.axvline(edge * DT, color="0.5", lw=0.8, ls=(0, (2, 2)))
        if names:
            axes.annotate(
                name, ((edge + steps / 10) * DT, 1), xycoords=("data", "axes fraction"), ha="center",
                va="bottom", fontsize=7, color="0.35",
            )  # fmt: skip
