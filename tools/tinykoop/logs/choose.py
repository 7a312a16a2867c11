"""Which dictionary, regulator, forgetting factor and dead zone predict a log best, several steps ahead.

Each setting learns the log from its offline model on. Every few rows the model that it has then predicts the rows that
follow, which it has not learned from. The error is relative: each state's is divided by how far that state moves in so
many steps, so 1 is as bad as predicting that nothing moves.
"""

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from .. import bridge, dictionaries
from ..experiments.scenario import LABELS
from ..firmware import size
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, printable, progress, replacing
from . import replay

STEPS = 10  # ahead
LAMBDAS = (0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
ETAS = (0.5, 0.75, 0.9)  # quantiles of the innovations of the calibration, which the threshold of a dead zone is
SETTLES = 0.1  # of the log, while P comes down from p0: learned, and not scored
WINDOWS = 250  # predictions over a log
WORST = 10.0  # a relative error counts as no more: a model that has run away is of no use, however far it is
DRAWS, BLOCKS = 1000, 25  # of a bootstrap over blocks of windows
TARGET = "cortex-m4f"


@dataclass(frozen=True)
class Setting:
    """What is chosen. eta: quantile that is the threshold of a dead zone, None without one."""

    dictionary: str
    regulator: str
    lam: float
    eta: float | None = None

    @property
    def label(self):
        zone = "" if self.eta is None else f", eta {self.eta:g}"
        return f"{self.dictionary.rpartition(':')[2]}, {LABELS[self.regulator]}, lambda {self.lam:g}{zone}"


def settings(names):
    """Every setting that is tried with dictionaries of these names. Without forgetting, lambda is 1."""
    gates = bridge.dead_zones()
    for dictionary in names:
        for regulator in bridge.regulator_names():
            for lam in (1.0,) if regulator == "none" else LAMBDAS:
                yield from (Setting(dictionary, regulator, lam, eta) for eta in (ETAS if regulator in gates else (None,)))


class Trial:
    """One log: its parts, its windows, and the offline model and innovations of each dictionary."""

    def __init__(self, path, platform=None):
        self.name = printable(Path(path).stem)
        self.log, self.platform = replay.load(path, platform)
        K, index = len(self.log.usable), np.arange(len(self.log.usable))
        edges = (replay.FIT, replay.FIT + replay.CALIBRATE)
        self.fit, self.calibrate = (
            self.log.usable & (index < edges[0] * K),
            self.log.usable & (index >= edges[0] * K) & (index < edges[1] * K),
        )
        self.learned = self.log.usable & (index >= edges[1] * K)
        self.every = max(1, int((1 - edges[1] - SETTLES) * K) // WINDOWS)
        gone = np.concatenate([[0], np.cumsum(~self.log.usable)])
        starts = np.arange(0, K - STEPS, self.every)
        whole = (gone[starts + STEPS] == gone[starts]) & (starts >= (edges[1] + SETTLES) * K) if len(starts) else np.zeros(0, bool)
        self.rows = starts[whole]
        if min(self.fit.sum(), self.calibrate.sum()) < 10 or len(self.rows) < BLOCKS:
            raise UserError(f"{path}: too few runs of {STEPS} usable steps to compare settings on; record a longer log")
        moved = self.log.x[self.rows + STEPS] - self.log.x[self.rows]
        self.scale = np.maximum(np.sqrt(np.mean(moved**2, axis=0)), 1e-9)
        self._known = {}

    def offline(self, name):
        """(lifting, Theta of the first part, norms of innovations of the second) of a dictionary."""
        if name not in self._known:
            lifting = dictionaries.named(name, self.platform, self.log.x.shape[1])
            theta = replay.offline_fit(self.log, self.platform, name, usable=self.fit).theta
            probe = bridge.Estimator(lifting, "ef", 64, n_inputs=self.log.u.shape[1])
            probe.theta = theta
            psi = probe.lift(np.where(np.isfinite(self.log.x), self.log.x, 0))
            left = psi[1:] - np.concatenate([psi[:-1], self.log.u[:-1]], axis=1) @ theta.T
            self._known[name] = lifting, theta, np.linalg.norm(left, axis=1)[self.calibrate], psi
        return self._known[name]

    def errors(self, setting):
        """Relative error of each window (W,), at most WORST."""
        lifting, theta, innovations, psi = self.offline(setting.dictionary)
        delta = {} if setting.eta is None else {"delta": bridge.threshold(innovations, setting.eta)}
        learner = bridge.Estimator(
            lifting, setting.regulator, 32, form="sqrt", n_inputs=self.log.u.shape[1], lam=setting.lam, check=bridge.CHECK_REFUSE, **delta
        )
        learner.theta = theta
        models = learner.replay(self.log.x, self.log.u[:-1], usable=self.learned, every=self.every, traces=())["theta"]
        A, B = np.split(models[self.rows // self.every], [learner.N], axis=2)
        state = psi[self.rows]
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(STEPS):
                state = np.einsum("wij,wj->wi", A, state) + np.einsum("wij,wj->wi", B, self.log.u[self.rows + k])
            away = (state[:, : len(self.scale)] - self.log.x[self.rows + STEPS]) / self.scale
            error = np.sqrt(np.mean(away**2, axis=1))
        return np.minimum(np.nan_to_num(error, nan=WORST), WORST)


def compared(trials, names):
    """{Setting: [errors (W,) of each log]}."""
    tried = list(settings(names))
    return {setting: [trial.errors(setting) for trial in trials] for setting in progress(tried, "settings")}


def scores(errors):
    """{Setting: mean over the logs of its RMS error over the smallest of that log}: 1 is best everywhere."""
    sizes = {setting: np.array([np.sqrt(np.mean(e**2)) for e in parts]) for setting, parts in errors.items()}
    least = np.min(list(sizes.values()), axis=0)
    return {setting: float(np.mean(values / least)) for setting, values in sizes.items()}


def best(errors):
    """The Setting of the smallest score."""
    found = scores(errors)
    return min(found, key=found.get)


def how_sure(errors, seed=0):
    """{Setting: share of the draws in which it is the best}, of a bootstrap over blocks of windows, the same for all settings."""
    rng, keys = np.random.default_rng(seed), list(errors)
    squares = [
        np.array([[block.sum() for block in np.array_split(errors[key][i] ** 2, BLOCKS)] for key in keys])
        for i in range(len(errors[keys[0]]))
    ]
    drawn = []
    for part in squares:
        rows = rng.integers(0, BLOCKS, (DRAWS, BLOCKS))
        total = np.sqrt(part[:, rows].sum(2))
        drawn.append(total / total.min(0))
    wins = Counter(np.mean(drawn, axis=0).argmin(0).tolist())
    return {key: wins[i] / DRAWS for i, key in enumerate(keys)}


def regrets(errors, trials):
    """{log: by how much the setting that the other logs choose is worse there than the best one, relative}."""
    out = {}
    for i, trial in enumerate(trials):
        chosen = best({key: [e for j, e in enumerate(parts) if j != i] for key, parts in errors.items()})
        sizes = {key: float(np.sqrt(np.mean(parts[i] ** 2))) for key, parts in errors.items()}
        out[trial.name] = sizes[chosen] / min(sizes.values()) - 1
    return out


def cost(setting, trial):
    """Instructions of an update in float32, square-root form, on TARGET; None for a regulator that was not measured."""
    lifting = bridge.Estimator(trial.offline(setting.dictionary)[0], "none", 32, n_inputs=trial.log.u.shape[1])
    return size.update(TARGET, setting.regulator, lifting.N, lifting.m)


def run(paths, out, platform=None, dictionary=None):
    """Writes choose.json and choose.png into `out`, prints the choice; returns the rows, best first."""
    out = output_folder(out)
    trials = [Trial(path, platform) for path in paths]
    if len({trial.platform for trial in trials}) > 1:
        raise UserError("the logs are of different platforms: choose for one platform at a time")
    errors = compared(trials, (*dictionaries.BUILT_IN, *([dictionary] if dictionary else [])))
    found, sure = scores(errors), how_sure(errors)
    order = sorted(errors, key=found.get)
    rows = [
        asdict(s) | {"score": found[s], "error": [float(np.sqrt(np.mean(e**2))) for e in errors[s]], "best_in": sure[s], "instructions": cost(s, trials[0])}
        for s in order
    ]  # fmt: skip
    result = {
        "logs": [trial.name for trial in trials],
        "steps": STEPS,
        "regret": regrets(errors, trials) if len(trials) > 1 else None,
        "settings": rows,
    }
    with replacing(out / "choose.json", result):
        draw(out / "choose.png", order, found, sure)
    report(result, order)
    return rows


def report(result, order):
    """The choice, and the best setting of every regulator."""
    rows, seen, lines = dict(zip(order, result["settings"])), set(), []
    for setting, row in rows.items():
        if (setting.dictionary, setting.regulator) in seen:
            continue
        seen.add((setting.dictionary, setting.regulator))
        lines.append(
            [
                setting.label,
                number(row["score"]),
                number(float(np.mean(row["error"]))),
                f"{100 * row['best_in']:.0f}",
                number(row["instructions"]),
            ]
        )
    print_table(
        f"{order[0].label}: best {STEPS} steps ahead on {', '.join(result['logs'])}",
        ["best of each regulator", "score", "error", "best in %", "instructions"], lines,
        f"score: error over that of the best setting, mean over the logs. error: relative, 1 is that of predicting that nothing moves. best in: of"
        f" {DRAWS} draws of a bootstrap. instructions: of an update on {TARGET}, square-root form, float32.",
    )  # fmt: skip
    if result["regret"]:
        print_table(
            "Regret: the setting that the other logs choose, against the best one of each log",
            ["log", "worse by %"], [[name, number(100 * value)] for name, value in result["regret"].items()],
        )  # fmt: skip


def draw(path, order, found, sure):
    """Score of the best setting of each dictionary and regulator."""
    first = {}
    for setting in order:
        first.setdefault((setting.dictionary, setting.regulator), setting)
    shown = list(first.values())
    figure, ax = plots.subplots(1, 1, figsize=(9, 0.34 * len(shown) + 1.6))
    for i, setting in enumerate(shown):
        ax.barh(i, found[setting], color="0.85", edgecolor="k", hatch=plots.HATCHES.get(setting.regulator, ""))
        ax.text(found[setting], i, f" {found[setting]:.2f}", va="center")
    ax.set_yticks(range(len(shown)), [setting.label for setting in shown])
    ax.invert_yaxis()
    ax.set_xlim(0, 1.15 * max(found[s] for s in shown))
    ax.set_xlabel(f"error {STEPS} steps ahead over that of the best setting (ratio)")
    ax.set_title(f"{order[0].label} predicts best (in {100 * sure[order[0]]:.0f} % of bootstrap draws)", loc="right")
    ax.grid(axis="y", visible=False)
    plots.save(figure, path)
