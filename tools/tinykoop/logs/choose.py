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
from ..bridge.control import Controller
from ..experiments.scenario import LABELS
from ..firmware import size
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, printable, progress, replacing
from . import fly, replay

STEPS = 10  # ahead
DICTIONARIES = (*dictionaries.BUILT_IN, dictionaries.AFFINE)
LAMBDAS = (0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
ETAS = (0.5, 0.75, 0.9)  # quantiles of the innovations of the calibration, which the threshold of a dead zone is
DRIVEN = 400  # steps at most in closed loop
SETTLES = 0.1  # of the log, while P comes down from p0: learned, and not scored
AVERAGE = "average"  # of the models of the MEMBERS, with one dictionary
MEMBERS = (("ef", 0.99), ("ct", 0.999), ("sift", 0.8))  # regulators that forget in different ways, and err differently
WINDOWS = 250  # predictions over a log
WORST = 10.0  # a relative error counts as no more: a model that has run away is of no use, however far it is
DRAWS, BLOCKS = 1000, 25  # of a bootstrap over blocks of windows
TARGET = "cortex-m4f"


@dataclass(frozen=True)
class Setting:
    """What is chosen. eta: quantile that is the threshold of a dead zone, None without one; lam: None of an average."""

    dictionary: str
    regulator: str
    lam: float | None
    eta: float | None = None

    @property
    def members(self):
        """The learners whose models are averaged: one, or those of MEMBERS."""
        return tuple(Setting(self.dictionary, *member) for member in MEMBERS) if self.regulator == AVERAGE else (self,)

    @property
    def label(self):
        name = self.dictionary.rpartition(":")[2]
        if self.regulator == AVERAGE:
            return f"{name}, average of {', '.join(f'{LABELS[r]} {lam:g}' for r, lam in MEMBERS)}"
        zone = "" if self.eta is None else f", eta {self.eta:g}"
        return f"{name}, {LABELS[self.regulator]}, lambda {self.lam:g}{zone}"


def settings(names):
    """Every setting that is tried with dictionaries of these names. Without forgetting, lambda is 1."""
    gates = bridge.dead_zones()
    for dictionary in names:
        for regulator in bridge.regulator_names():
            for lam in (1.0,) if regulator == "none" else LAMBDAS:
                yield from (Setting(dictionary, regulator, lam, eta) for eta in (ETAS if regulator in gates else (None,)))
        yield Setting(dictionary, AVERAGE, None)


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
            lifting = replay.lifting(self.log, self.platform, name)
            theta = replay.offline_fit(self.log, self.platform, name, usable=self.fit).theta
            probe = bridge.Estimator(lifting, "ef", 64, n_inputs=self.log.u.shape[1])
            probe.theta = theta
            psi = probe.lift(np.where(np.isfinite(self.log.x), self.log.x, 0))
            left = psi[1:] - np.concatenate([psi[:-1], self.log.u[:-1]], axis=1) @ theta.T
            self._known[name] = lifting, theta, np.linalg.norm(left, axis=1)[self.calibrate], psi
        return self._known[name]

    def learner(self, setting):
        """The estimator of one member, with the offline model."""
        lifting, theta, innovations, _ = self.offline(setting.dictionary)
        delta = {} if setting.eta is None else {"delta": bridge.threshold(innovations, setting.eta)}
        learner = bridge.Estimator(
            lifting, setting.regulator, 32, form="sqrt", n_inputs=self.log.u.shape[1], lam=setting.lam, check=bridge.CHECK_REFUSE, **delta
        )
        learner.theta = theta
        return learner

    def learn(self, learner):
        """Theta (.., N, N+m) every so many rows of the part that is learned."""
        return learner.replay(self.log.x, self.log.u[:-1], usable=self.learned, every=self.every, traces=())["theta"]

    def errors(self, setting):
        """Relative error of each window (W,), at most WORST."""
        models = np.mean([self.learn(self.learner(member)) for member in setting.members], axis=0)
        psi = self.offline(setting.dictionary)[3]
        A, B = np.split(models[self.rows // self.every], [psi.shape[1]], axis=2)
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


def rms(errors):
    """{Setting: RMS error (logs,)}."""
    return {setting: np.array([np.sqrt(np.mean(e**2)) for e in parts]) for setting, parts in errors.items()}


def scores(errors):
    """{Setting: max over the logs of its RMS error over the smallest of that log}: 1 is best everywhere.

    The max, since the mean chose worse for simulated robots that it had not seen.
    """
    sizes = rms(errors)
    least = np.min(list(sizes.values()), axis=0)
    return {setting: float(np.max(values / least)) for setting, values in sizes.items()}


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
    wins = Counter(np.max(drawn, axis=0).argmin(0).tolist())
    return {key: wins[i] / DRAWS for i, key in enumerate(keys)}


def picked(errors, keep):
    """The errors of those logs, by number, for which keep(number) holds."""
    return {setting: [e for i, e in enumerate(parts) if keep(i)] for setting, parts in errors.items()}


def regret(errors, chosen):
    """By how much a Setting is worse than the best one on a single log, relative."""
    sizes = rms(errors)
    return float(sizes[chosen][0] / min(values[0] for values in sizes.values()) - 1)


def regrets(errors, trials):
    """{log: {"others", "single", "own"}}: by how much a choice is worse than the best setting of that log, relative.

    others: the choice of the other logs, None where there are none; single: the choice of all logs, this one included, which
    no choice of one setting for all beats in the worst log; own: the choice of the first half of the log, judged on the second half.
    """
    out, single = {}, best(errors)
    for i, trial in enumerate(trials):
        alone = picked(errors, lambda j: j == i)
        halves = [{s: [np.array_split(e, 2)[part] for e in parts] for s, parts in alone.items()} for part in (0, 1)]
        out[trial.name] = {
            "others": regret(alone, best(picked(errors, lambda j: j != i))) if len(trials) > 1 else None,
            "single": regret(alone, single),
            "own": regret(halves[1], best(halves[0])),
        }
    return out


# ---- closed loop ---------------------------------------------------------------------------------


def averaging(learners, controller):
    """What Estimator.control() calls to plan: on the mean of the models. learners: the first is that of the loop; the others learn here."""
    before = []

    def plan(theta, psi, reference):
        for learner in learners[1:]:
            if before:
                learner.update(*before, np.ascontiguousarray(psi), lifted=True)
        found = controller.solve(np.mean([theta, *(learner.theta for learner in learners[1:])], axis=0), psi, reference)
        before[:] = psi.copy(), found.u if found.status == 0 else np.zeros(len(found.u))
        return found.u if found.status == 0 else None

    return plan


def tracking(trial, setting, active):
    """Mean distance (m) from the path that the simulator with these effects drives under the last commands of the log.

    The learners have learned the log before, and go on. The limits of the commands are those of the log. None for a dictionary
    by a Python function, and for a log that is too short.
    """
    u, dt = np.nan_to_num(trial.log.u), trial.log.dt
    mpc = bridge.Mpc(horizon=STEPS, u_min=tuple(u.min(0, initial=0)), u_max=tuple(u.max(0, initial=0)))  # 0, the safe input, is within
    steps = min(DRIVEN, len(u) - mpc.horizon)
    learners = [trial.learner(member) for member in setting.members]
    if learners[0].by_function or steps < mpc.horizon:
        return None
    for learner in learners:
        trial.learn(learner)
    last = trial.log.x[np.isfinite(trial.log.x).all(1)][-1]
    path = bridge.simulate(u[len(u) - steps - mpc.horizon :], dt, last, active)
    controller = Controller(mpc.settings(), 32, learners[0].N)
    x = learners[0].control(mpc, path, dt, steps, path[0], active, solver=averaging(learners, controller))["x"]
    return float(np.linalg.norm((x - path[: len(x)])[:, :2], axis=1).mean())


def cost(setting, trial):
    """Instructions of an update in float32, square-root form, on TARGET; None for a regulator that was not measured."""
    learners = [(member.regulator, trial.learner(member)) for member in setting.members]
    counts = [size.update(TARGET, regulator, learner.N, learner.m) for regulator, learner in learners]
    return None if None in counts else sum(counts)


def shortlist(order):
    """The best setting of each dictionary and regulator, best first."""
    first = {}
    for setting in order:
        first.setdefault((setting.dictionary, setting.regulator), setting)
    return list(first.values())


def run(paths, out, platform=None, dictionary=None, effects=None):
    """Writes choose.json and choose.png into `out`, prints the choice; returns the rows, best first.

    effects: texts as NAME=V,V, with which the DDR of the short list is then simulated in closed loop; None: no closed loop.
    """
    out = output_folder(out)
    active = None if effects is None else [fly.effect(text, bridge.effects("ddr"), "--closed-loop") for text in effects]
    trials = [Trial(path, platform) for path in paths]
    if len({trial.platform for trial in trials}) > 1:
        raise UserError("the logs are of different platforms: choose for one platform at a time")
    if active is not None and trials[0].platform != "ddr":
        raise UserError("--closed-loop: only the ddr has a simulator with a controller; leave it out")
    errors = compared(trials, (*DICTIONARIES, *([dictionary] if dictionary else [])))
    found, sure = scores(errors), how_sure(errors)
    order = sorted(errors, key=found.get)
    rows = [
        asdict(s) | {"score": found[s], "error": [float(np.sqrt(np.mean(e**2))) for e in errors[s]], "best_in": sure[s], "instructions": cost(s, trials[0])}
        for s in order
    ]  # fmt: skip
    if active is not None:
        for setting in progress(shortlist(order), "closed loop"):
            rows[order.index(setting)]["tracking"] = tracking(trials[0], setting, active)
    result = {"logs": [trial.name for trial in trials], "steps": STEPS, "regret": regrets(errors, trials), "settings": rows}
    with replacing(out / "choose.json", result):
        draw(out / "choose.png", order, found, sure)
    report(result, order)
    return rows


def report(result, order):
    """The choice, and the best setting of every regulator."""
    rows = dict(zip(order, result["settings"]))
    driven = any("tracking" in row for row in rows.values())
    lines = [
        [
            setting.label,
            number(row["score"]),
            number(float(np.mean(row["error"]))),
            f"{100 * row['best_in']:.0f}",
            number(row["instructions"]),
            *([number(row["tracking"])] if driven else []),
        ]
        for setting, row in ((setting, rows[setting]) for setting in shortlist(order))
    ]
    print_table(
        f"{order[0].label}: best {STEPS} steps ahead on {', '.join(result['logs'])}",
        ["best of each regulator", "score", "error", "best in %", "instructions", *(["tracking (m)"] if driven else [])], lines,
        f"score: error over that of the best setting, max over the logs. error: relative, 1 is that of predicting that nothing moves. best in: of"
        f" {DRAWS} draws of a bootstrap. instructions: of an update on {TARGET}, square-root form, float32."
        + (" tracking: mean distance from the path, in the simulator with Koopman-MPC, after learning the first log." if driven else ""),
    )  # fmt: skip
    percent = {name: [number(None if v is None else 100 * v) for v in values.values()] for name, values in result["regret"].items()}
    print_table(
        "Regret: how much worse a choice is than the best setting of each log (%)",
        ["log", "by the other logs", "by all logs", "by its first half"], [[name, *values] for name, values in percent.items()],
        "by its first half: judged on the second half.",
    )  # fmt: skip


def draw(path, order, found, sure):
    """Score of the best setting of each dictionary and regulator."""
    shown = shortlist(order)
    figure, ax = plots.subplots(1, 1, figsize=(9, 0.34 * len(shown) + 1.6))
    for i, setting in enumerate(shown):
        ax.barh(
            i, found[setting], color="0.85", edgecolor="k", hatch="" if setting.regulator == AVERAGE else plots.HATCHES[setting.regulator]
        )
        ax.text(found[setting], i, f" {found[setting]:.2f}", va="center")
    ax.set_yticks(range(len(shown)), [setting.label for setting in shown])
    ax.invert_yaxis()
    ax.set_xlim(0, 1.15 * max(found[s] for s in shown))
    ax.set_xlabel(f"error {STEPS} steps ahead over that of the best setting (ratio, max over the logs)")
    ax.set_title(f"{order[0].label} predicts best (in {100 * sure[order[0]]:.0f} % of bootstrap draws)", loc="right")
    ax.grid(axis="y", visible=False)
    plots.save(figure, path)
