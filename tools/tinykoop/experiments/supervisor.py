"""Randomised closed-loop runs under the supervisor and without it.

Every run draws a reference, a start, a schedule of phases, a form of P and what the learner knows at the start;
dictionary, regulator and precision take turns. The supervisor works with its defaults and with an offline model fitted on
drives of the nominal robot. A run is lost where its mean error (m, rad, over the full state, as in `control`) is
above 0.15.

References keep within 0.4 rad of the heading 0 (the paper's drive reaches 0.38): a linear lift knows sin(theta) at a
mean speed only, and no model of this class follows a circle.
"""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import product

import numpy as np

from .. import bridge
from ..plumbing import pages, plots
from ..plumbing.results import number, output_folder, print_table, progress, replacing
from . import control, scenario

RUNS = 200
SEED = 20000  # the defaults of the supervisor were chosen on seeds below 10000
STEPS = 2000
LOST = 0.15
MPC = bridge.Mpc()
KINDS = ("paper", "line", "sine", "S-curves")
STARTS = ("carried over", "offline", "zero")
REGULATORS = bridge.regulator_names()
COMBINATIONS = tuple(product(("rbf", "poly"), REGULATORS, (64, 32)))
WORKS = [("rbf", name) for name in ("dz_cs", "dz_ks", "ct", "sift")] + [("poly", "ct"), ("poly", "sift")]
HEADING = 0.4  # rad, of references
TURN = 0.7  # rad/s, of references


# ---- offline model ---------------------------------------------------------------------------


@cache
def theta_of_many_drives(dictionary, drives=12, steps=2500, heading=0.85):
    """Offline model from drives of the nominal robot at many headings and speeds, each with its mirror image.

    scenario.offline_theta() has seen one drive, within 0.38 rad: there theta and sin(theta) cannot be distinguished, and
    what it makes of them does not hold elsewhere.
    """
    random = np.random.default_rng(5)
    k = np.arange(steps + 1)
    estimator = bridge.Estimator(f"{dictionary}_ddr", "none", 64, form="sqrt", p0=1e4)
    for _ in range(drives):
        theta = np.full(steps + 1, heading * random.uniform(-1, 1) * (random.random() < 0.5))
        for _ in range(3):
            theta += heading * random.uniform(0, 0.6) * np.sin(random.uniform(0.005, 0.12) * k + random.uniform(0, 6.3))
        theta = np.clip(theta, -heading, heading)
        v = random.uniform(0.5, 2.5) + random.uniform(0, 0.6) * np.sin(random.uniform(0.02, 0.2) * k[:-1])
        turn = np.clip(np.diff(theta) / scenario.DT, MPC.u_min[1], MPC.u_max[1])
        u = np.stack([np.clip(v, 0, MPC.u_max[0]), turn], axis=1)
        x = bridge.simulate(u, scenario.DT, x0=(0, 0, theta[0]))
        estimator.replay(x, u)
        estimator.replay(x * (1, -1, -1), u * (1, -1))
    return estimator.theta


# ---- one run -----------------------------------------------------------------------------------


def headings(random, kind, k):
    """Heading (rad) over the steps k of one kind of reference."""
    if kind == "line":
        return np.full(len(k), random.uniform(-HEADING, HEADING))
    if kind == "S-curves":
        theta, now, at = np.full(len(k), random.uniform(-HEADING, HEADING)), 0.0, 0
        now = theta[0]
        while (at := at + int(random.integers(100, 400))) < len(k):
            then = random.uniform(-HEADING, HEADING)
            least = abs(then - now) * np.pi / 2 / scenario.DT / TURN
            rise = np.clip((k - at) / max(int(random.integers(20, 80)), least + 1), 0, 1)
            theta += (then - now) * (0.5 - 0.5 * np.cos(np.pi * rise))
            now = then
        return theta
    pace = random.uniform(0.05, 0.12) if kind == "paper" else random.uniform(0.01, 0.06)
    size = min(random.uniform(0.3, 1) * HEADING, TURN * scenario.DT / pace)
    return size * np.sin(pace * k + (0 if kind == "paper" else random.uniform(0, 2 * np.pi)))


def reference_path(random, kind):
    """Nominal states (STEPS + horizon + 1, 3) at 0.9 to 1.9 m/s: with slip and friction still within the box."""
    k = np.arange(STEPS + MPC.horizon + 1)
    mean = random.uniform(0.9, 1.7)
    swing = random.uniform(0, min(0.3, 1.9 - mean))
    v = mean + swing * np.sin(random.uniform(0.05, 0.15) * k + random.uniform(0, 2 * np.pi))
    theta = headings(random, kind, k)
    u = np.stack([v[:-1], np.diff(theta) / scenario.DT], axis=1)
    return bridge.simulate(u, scenario.DT, x0=(0, 0, theta[0]))


def phases(random):
    """Slip and friction in three to six phases of random length and order, constants within 30 % of the usual ones."""
    count = int(random.integers(3, 7))
    edges = np.sort(random.choice(np.arange(100, STEPS - 50), count - 1, replace=False)) * scenario.DT
    active, last = [], None
    for begin, end in zip((0, *edges), (*edges, np.inf)):
        last = random.choice([phase for phase in range(4) if phase != last])
        for bit, name in enumerate(("pacejka_slip", "stribeck_friction")):
            if last >> bit & 1:
                usual = np.array(bridge.usual_effect(name).parameters)
                active.append(bridge.Effect(name, tuple(usual * random.uniform(0.7, 1.3, len(usual))), begin, end))
    return active


@cache
def _first_drive():
    return scenario.drive()


def start(dictionary, regulator, precision, form, knows):
    """The estimator as the run begins."""
    estimator = bridge.Estimator(f"{dictionary}_ddr", regulator, precision, form=form)
    if knows == "carried over":
        estimator.replay(*_first_drive())
    elif knows == "offline":
        estimator.theta = theta_of_many_drives(dictionary)
    return estimator


def draw(number, seed):
    """Run `number` of a campaign: a dict of what it is made of."""
    random = np.random.default_rng(seed + number)
    dictionary, regulator, precision = COMBINATIONS[number % len(COMBINATIONS)]
    run = {"dictionary": dictionary, "regulator": regulator, "precision": precision}
    run["kind"] = str(random.choice(KINDS))
    run["start"] = str(random.choice(STARTS))
    run["form"] = str(random.choice(("plain", "sqrt")))
    run["reference"] = reference_path(random, run["kind"])
    run["effects"] = phases(random)
    run["x0"] = run["reference"][0] + random.normal(0, random.uniform(0.1, 0.3), 3)
    return run


def drive(run, model, **settings):
    """Trace of one run: `model` is supervised, without_supervisor, or offline (the offline model alone)."""
    theta = theta_of_many_drives(run["dictionary"])
    if model == "offline":
        estimator = bridge.Estimator(f"{run['dictionary']}_ddr", "none", run["precision"])
        estimator.theta = theta
    else:
        estimator = start(run["dictionary"], run["regulator"], run["precision"], run["form"], run["start"])
    trace = estimator.control(
        MPC, run["reference"], scenario.DT, STEPS, run["x0"], run["effects"], learn=model != "offline",
        supervisor=bridge.Supervisor(theta, **settings) if model == "supervised" else None,
    )  # fmt: skip
    trace["error"] = np.linalg.norm(trace["x"][1:] - run["reference"][1 : STEPS + 1], axis=1)
    return trace


def score(job):
    """One row of supervisor.json."""
    number, seed = job
    run = draw(number, seed)
    row = {key: run[key] for key in ("dictionary", "regulator", "kind", "start", "form")}
    row |= {"run": number, "seed": seed, "precision": f"f{run['precision']}", "steps": STEPS}
    for model in ("offline", "without_supervisor", "supervised"):
        trace = drive(run, model)
        row[f"mean_error_{model}"] = float(trace["error"].mean())
    row |= {f"share_{name.replace(' ', '_')}": float(np.mean(trace["model"] == i)) for i, name in enumerate(bridge.MODELS)}
    row["changes"] = int(np.count_nonzero(np.diff(trace["model"])))
    row["resets"] = int(trace["resets"][-1])
    return row


# ---- where the method works without the supervisor ----------------------------------------------


def price(method):
    """Mean errors of one row of `make control`, with and without the supervisor."""
    dictionary, regulator = method
    row = {"dictionary": dictionary, "regulator": regulator}
    path = control.reference_path()
    for name, supervisor in (("without_supervisor", None), ("supervised", bridge.Supervisor(theta_of_many_drives(dictionary)))):
        estimator = start(dictionary, regulator, 64, "plain", "carried over")
        trace = estimator.control(MPC, path, scenario.DT, STEPS, path[0], scenario.effects(control.EDGES), supervisor=supervisor)
        row[f"mean_error_{name}"] = float(np.linalg.norm(trace["x"][1:] - path[1 : STEPS + 1], axis=1).mean())
        row[f"solve_us_{name}"] = float(np.median(trace["solve_us"]))
    row["share_online"] = float(np.mean(trace["model"] == 0))
    return row


# ---- all ------------------------------------------------------------------------------------------


def run(out, update=False, runs=RUNS, seed=SEED):
    """Writes supervisor.json and its plots into `out`, and with `update` the table of docs/control.md; returns the rows."""
    out = output_folder(out)
    with ProcessPoolExecutor() as pool:
        rows = list(progress(_counted(pool.map(score, [(i, seed) for i in range(runs)]), runs), "supervisor"))
        prices = list(progress(_counted(pool.map(price, WORKS), len(WORKS)), "supervisor, price"))
    with replacing(out / "supervisor.json", {"campaign": rows, "price": prices}):
        draw_campaign(out, rows)
        draw_timeline(out)
    report(rows, prices)
    if update:
        pages.update("docs/control.md", "supervisor", page(rows, prices))
    return rows, prices


class _counted:
    """An iterator that knows its length, for the progress bar."""

    def __init__(self, items, count):
        self._items, self._count = items, count

    def __iter__(self):
        return iter(self._items)

    def __len__(self):
        return self._count


def _errors(rows, model):
    """Mean errors, infinite where there is none."""
    values = np.array([row[f"mean_error_{model}"] for row in rows], dtype=float)
    return np.where(np.isfinite(values), values, np.inf)


def page(rows, prices):
    """The table of docs/control.md."""
    lost = {model: int(np.sum(_errors(rows, model) > LOST)) for model in ("without_supervisor", "supervised")}
    price = max(row["mean_error_supervised"] / row["mean_error_without_supervisor"] for row in prices)
    pairs = [
        (f"runs: starts, phases, paths, both dictionaries, {len(REGULATORS)} regulators, both precisions", len(rows)),
        (f"lost without the supervisor (mean error above {LOST:g})", lost["without_supervisor"]),
        ("lost with the supervisor", lost["supervised"]),
        ("largest mean error with the supervisor (m, rad)", number(float(_errors(rows, "supervised").max()), 2)),
        ("largest error with the supervisor over that without, where the method works by itself", f"{price:.3f}"),
    ]
    return pages.facts("`make supervisor`", pairs)


def report(rows, prices):
    """Tables on the terminal."""
    lines = []
    keys = {"dictionary": ("rbf", "poly"), "regulator": REGULATORS, "precision": ("f64", "f32"), "start": STARTS}
    keys |= {"form": ("plain", "sqrt"), "kind": KINDS}
    groups = [(f"{key} {name}", {key: name}) for key, names in keys.items() for name in names]
    for label, wanted in [("all", {}), *groups]:
        some = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
        if some:
            cells = []
            for model in ("without_supervisor", "offline", "supervised"):
                error = _errors(some, model)
                cells += [int(np.sum(error > LOST)), number(float(np.median(error)))]
            lines.append([label, len(some), *cells, number(float(_errors(some, "supervised").max())),
                          f"{100 * np.mean([row['share_online'] for row in some]):.0f}"])  # fmt: skip
    print_table(
        f"Randomised closed-loop runs: lost (mean error above {LOST}) and median error",
        ["runs", "count", "without", "median", "offline", "median", "with", "median", "worst", "online %"],
        lines,
    )
    print_table(
        "What the supervisor costs where the method works without it (`make control`, float64)",
        ["method", "without", "with", "ratio", "online %"],
        [[scenario.Method(row["dictionary"], row["regulator"]).label, number(row["mean_error_without_supervisor"]),
          number(row["mean_error_supervised"]), f"{row['mean_error_supervised'] / row['mean_error_without_supervisor']:.3f}",
          f"{100 * row['share_online']:.1f}"] for row in prices],
    )  # fmt: skip


# ---- plots ------------------------------------------------------------------------------------------


def draw_campaign(out, rows):
    """Mean error of every run, in order of size."""
    figure, ax = plots.subplots(figsize=(8, 4))
    lost = {model: int(np.sum(_errors(rows, model) > LOST)) for model in ("without_supervisor", "supervised")}
    ax.set_title(f"Of {len(rows)} random runs {lost['without_supervisor']} are lost without the supervisor, {lost['supervised']} with it")
    styles = {"without_supervisor": dict(color="#d62728", marker="x"), "offline": dict(color="#999999", marker="."),
              "supervised": dict(color="#08306b", marker="o", mfc="none")}  # fmt: skip
    labels = {"without_supervisor": "online model, no supervisor", "offline": "offline model alone", "supervised": "with supervisor"}
    for model, style in styles.items():
        error = np.sort(np.minimum(_errors(rows, model), 1e3))
        ax.semilogy(np.arange(1, len(rows) + 1), error, ls="", ms=4, label=labels[model], **style)
    ax.axhline(LOST, color="k", lw=0.9, ls="--")
    ax.annotate("lost", (1, LOST), textcoords="offset points", xytext=(0, 3), fontsize=8)
    ax.set_xlabel("run, each curve in order of its error")
    ax.set_ylabel("mean error (m, rad)")
    ax.legend()
    plots.save(figure, out / "supervisor_campaign.png")


def draw_timeline(out):
    """Vanilla RBF on the path of `make control`: model in use, error, innovation."""
    path = control.reference_path()
    traces = {}
    for name, supervisor in (("no supervisor", None), ("supervised", bridge.Supervisor(theta_of_many_drives("rbf")))):
        estimator = start("rbf", "ef", 64, "plain", "carried over")
        traces[name] = estimator.control(MPC, path, scenario.DT, STEPS, path[0], scenario.effects(control.EDGES), supervisor=supervisor)
    t = np.arange(STEPS) * scenario.DT
    figure, axes = plots.subplots(3, 1, figsize=(9, 6), sharex=True, height_ratios=(1.2, 2, 2))
    model = traces["supervised"]["model"]
    mean = np.linalg.norm(traces["supervised"]["x"][1:] - path[1 : STEPS + 1], axis=1).mean()
    figure.suptitle(f"Vanilla RBF, ruined before the start: the supervisor keeps to the path (mean error {mean:.3f})", x=0.01, ha="left")
    axes[0].step(t, model, where="post", color="#08306b", lw=1)
    axes[0].set_yticks(range(3), bridge.MODELS[:3])
    axes[0].set_ylim(3.9, -0.4)
    axes[0].set_ylabel("model in use")
    resets = np.flatnonzero(np.diff(traces["supervised"]["resets"], prepend=0))
    axes[0].plot(t[resets], np.full(len(resets), 3), "k^", ms=4, label="learner started again")
    axes[0].legend(loc="lower center")
    for (name, trace), style in zip(traces.items(), (plots.STYLES["ef"], plots.STYLES["dz_cs"])):
        error = np.linalg.norm(trace["x"][1:] - path[1 : STEPS + 1], axis=1)
        axes[1].semilogy(t, np.maximum(error, 1e-4), lw=1, label=name, **style)
        axes[2].semilogy(t, np.clip(trace["innovation"], 1e-5, 1e5), lw=0.8, label=name, **style)
    axes[1].set_ylabel("tracking error\n(m, rad)")
    axes[1].legend(loc="center right", bbox_to_anchor=(1, 0.55))
    axes[2].set_ylabel("innovation, all\nlifted states (cut at $10^{\\pm 5}$)")
    axes[2].set_xlabel("time (s)")
    for i, ax in enumerate(axes):
        scenario.mark_phases(ax, STEPS, names=i == 0)
    plots.save(figure, out / "supervisor_timeline.png")
