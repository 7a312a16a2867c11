"""One-step learning of the DDR: the paper's table "Learning Performance of a DDR"."""

import time

import numpy as np

from .. import bridge, dictionaries
from ..plumbing import pages, plots
from ..plumbing.results import number, output_folder, print_table, progress, replacing
from . import scenario

PRECISIONS = (64, 32)
EVERY = scenario.ROLLOUT_STRIDE
OFFLINE = scenario.Method("rbf", "offline")  # of the paper, for Poly, too
TIMED = 100  # steps per measurement of time: a clock read at every step would cost as much as a step


def update_us(method, precision, x, u):
    """{"median", "p95"} of the microseconds of one lift and update."""
    estimator, spent = scenario.start(method, precision), []
    for k in range(0, len(u), TIMED):
        begin = time.perf_counter()
        estimator.replay(x[k : k + TIMED + 1], u[k : k + TIMED], learn=method.regulator != "offline", traces=())
        spent.append(1e6 * (time.perf_counter() - begin) / TIMED)
    return {"median": float(np.median(spent)), "p95": float(np.percentile(spent, 95))}


def row_of(method, precision, x, u):
    """(row of learn.json, trace) of one method in one precision."""
    estimator, trace = scenario.run(method, precision, x, u, every=EVERY)
    online = method.regulator != "offline"
    gates = method.regulator in bridge.dead_zones()
    rollout = scenario.rollout_errors(estimator, trace, x, u)
    row = {
        "dictionary": method.dictionary,
        "regulator": method.regulator,
        "precision": f"f{precision}",
        "steps": len(u),
        "mean_error": float(np.mean(trace["error"])),
        "final_P_fro": float(trace["norm_p"][-1]) if online else None,
        "final_A_fro": float(trace["norm_a"][-1]),
        "skip_rate": float(np.mean(trace["frozen"])) if gates else None,
        "lost_positive_definite_at": scenario.first(trace["positive_definite"] == 0) if online else None,
        "non_finite_at": scenario.first(trace["status"] < 0),
        "rollout_error": {str(h): float(rollout[h]) for h in (1, 10, 50)},
        "update_us": update_us(method, precision, x, u),
    }
    return row, trace


def run(out, update=False, dictionary=None):
    """Writes learn.json and its plots into `out`, and with `update` the table of docs/paper.md; returns the rows.

    dictionary: FILE:NAME, beside poly and rbf.
    """
    out = output_folder(out)
    x, u = scenario.drive()
    names, methods = scenario.beside(dictionary, x)
    rows, traces = [], {}
    jobs = [(method, precision) for precision in PRECISIONS for method in methods]
    for method, precision in progress(jobs, "learning"):
        row, trace = row_of(method, precision, x, u)
        rows.append(row)
        traces[method, precision] = trace
    with replacing(out / "learn.json", rows):
        draw(out, x, traces, rows, names)
    lines = table(rows)
    print_table(f"{TITLE}, the paper in brackets", HEADERS, lines, NOTE)
    if update:
        pages.update("docs/paper.md", "learn", pages.table(TITLE, HEADERS, lines))
    return rows


TITLE = "One-step learning of the DDR, 5,000 steps, float64, plain form"
HEADERS = ["method", "mean error", "final |P|", "final |A|", "skipped %", "f32/f64", "P lost"]
NOTE = (
    "f32/f64: mean error; P lost: first step at which P is not positive definite, f64 / f32.\n"
    "Vanilla RBF: error and |A| are round-off; its |P| is the closed form 100 lambda^-5000 per idle direction."
)


def table(rows):
    """Lines of the table beside the paper's, float64, with what float32 makes of it."""
    lines = []
    for method, row, narrow in scenario.by_precision(rows):
        error, P, A, skip = scenario.PAPER.get((method.dictionary, method.regulator), (None,) * 4)
        ratio = narrow["mean_error"] / row["mean_error"]
        lost = [r["lost_positive_definite_at"] for r in (row, narrow)]
        lines.append(
            [
                method.label,
                f"{number(row['mean_error'])} ({number(error)})",
                f"{number(row['final_P_fro'])} ({number(P)})",
                f"{number(row['final_A_fro'])} ({number(A)})",
                f"{100 * row['skip_rate']:.2f} ({100 * skip:.2f})" if skip else "",
                f"{ratio:.3f}",
                f"{number(lost[0])} / {number(lost[1])}",
            ]
        )
    return lines


# ---- plots -----------------------------------------------------------------------------------


def draw(out, x, traces, rows, names):
    """All plots of this experiment."""
    t = np.arange(len(x) - 1) * scenario.DT
    f64 = {method: trace for (method, precision), trace in traces.items() if precision == 64}
    draw_adaptation(out, t, x, f64)
    draw_paths(out, x, f64)
    for end, some in scenario.families(f64).items():
        draw_error(out / f"learn_error{end}.png", t, some, names)
        draw_operator(out / f"learn_operator{end}.png", t, some, names)
        draw_covariance(out / f"learn_covariance{end}.png", t, some, names)
    draw_precision(out, rows, names)


def _panels(finding, names, rows, height, **kwargs):
    """The figure, and {dictionary: its column of axes}."""
    figure, axes = plots.subplots(rows, len(names), figsize=(5 * len(names), height), squeeze=False, **kwargs)
    figure.suptitle(scenario.finding(finding, names), x=0.01, ha="left")
    return figure, dict(zip(names, axes.T))


def _phased(axes, name):
    """Title above the names of the phases."""
    axes.set_title(name, pad=16)
    scenario.mark_phases(axes)


def draw_adaptation(out, t, x, traces):
    """What learning is for, in two lines: the position that one model expects one step ahead, and where the robot was."""
    shown = {"offline": "fixed model, fitted to the nominal robot", "dz_cs": "TinyKoop, learning during the drive"}
    errors = {
        name: 1000 * plots.smooth(np.linalg.norm((traces[scenario.Method("rbf", name)]["predicted"] - x[1:])[:, :2], axis=1))
        for name in shown
    }
    slid = (t >= 110) & (t < 200)  # friction acts from 100 s to 200 s, and 10 s are left for learning
    fixed, learned = (np.median(errors[name][slid]) for name in shown)
    figure, ax = plots.subplots(figsize=(7, 3.6))
    figure.suptitle(
        f"Error of the position 50 ms ahead, under friction: fixed model {fixed:.0f} mm, learned {learned:.1f} mm", x=0.01, ha="left"
    )
    _phased(ax, "")
    for name, label in shown.items():
        ax.semilogy(t, errors[name], lw=1.4, label=label, **plots.STYLES[name])
    ax.set_xlabel("time (s); a simulated differential drive")
    ax.set_ylabel("error of the predicted position (mm)")
    ax.set_ylim(0.1, 100)
    plots.legend(figure)
    plots.save(figure, out / "learn_adaptation.png")


def draw_paths(out, x, traces):
    """(a) of the paper's figure, across the path: on its own scale of 320 m nothing of it would be seen."""
    shown = [scenario.Method("rbf", regulator) for regulator in ("offline", "ef", "sift")]
    aside = {method: plots.smooth(scenario.across(traces[method]["predicted"], x[1:])) for method in shown}
    worst = {method.regulator: values.max() for method, values in aside.items()}
    figure, ax = plots.subplots(figsize=(10, 3.8))
    figure.suptitle(
        f"One-step predictions across the path: vanilla RBF is up to {100 * worst['ef']:.1f} cm off, "
        f"the others {100 * max(worst['offline'], worst['sift']):.1f} cm",
        x=0.01, ha="left",
    )  # fmt: skip
    for method, values in aside.items():
        ax.semilogy(np.arange(len(values)) * scenario.DT, values, lw=1.2, label=method.label, **plots.STYLES[method.regulator])
    _phased(ax, "")
    ax.set_ylabel("error across the path, RMS over 2.5 s (m)")
    ax.set_xlabel("time (s)")
    plots.legend(figure)
    plots.save(figure, out / "learn_paths.png")


def draw_error(path, t, traces, names):
    """(b): one-step error over time."""
    friction = (t >= 100) & (t < 200)
    error = {method: np.mean(trace["error"][friction]) for method, trace in scenario.built_in(traces).items()}
    ratio = error[OFFLINE] / max(one for method, one in error.items() if method.regulator not in ("offline", "ef"))
    finding = f"While friction acts, the offline model errs at least {ratio:.1f} times as much as any regulated one"
    figure, columns = _panels(finding, names, 1, 3.8, sharex=True, sharey=True)
    for method, trace in traces.items():
        for name in dictionaries.BUILT_IN if method == OFFLINE else (method.dictionary,):
            style = plots.STYLES[method.regulator]
            columns[name][0].semilogy(t, plots.smooth(trace["error"]), lw=1.2, label=short_label(method), **style)
    for name, (ax,) in columns.items():
        _phased(ax, scenario.title(name))
        ax.set_xlabel("time (s)")
        ax.set_ylim(1e-4, 1)
    columns["poly"][0].set_ylabel("one-step error, RMS over 2.5 s (m, rad)")
    plots.legend(figure)
    plots.save(figure, path)


def draw_operator(path, t, traces, names):
    """(c): norms of A (solid) and B (dotted)."""
    stays = max(trace["norm_a"][-1] for m, trace in traces.items() if m.dictionary == "rbf" and m.regulator not in ("offline", "ef"))
    finding = f"Norms of the learned operator: that of A of regulated RBF ends at {number(stays)} or less"
    figure, columns = _panels(finding, names, 2, 6, sharex=True)
    for method, trace in traces.items():
        if method.regulator == "offline":
            continue
        for ax, norm in zip(columns[method.dictionary], ("norm_a", "norm_b")):
            ax.semilogy(t, np.maximum(trace[norm], 1e-6), lw=1.2, label=short_label(method), **plots.STYLES[method.regulator])
    for name, (top, bottom) in columns.items():
        _phased(top, scenario.title(name))
        scenario.mark_phases(bottom, names=False)
        bottom.set_xlabel("time (s)")
        top.set_ylabel("$\\|A\\|_F$")
        bottom.set_ylabel("$\\|B\\|_F$")
    plots.legend(figure)
    plots.save(figure, path)


def short_label(method):
    """Short name within a panel of one dictionary."""
    return scenario.LABELS[method.regulator]


def draw_covariance(path, t, traces, names):
    """(d) and its spectrum: norm, largest eigenvalue and condition number of P."""
    norms = {m: trace["norm_p"] for m, trace in scenario.built_in(traces).items() if m.regulator != "offline"}
    finding = f"The adaptation matrix P ends over 100 times as large as it began with: {scenario.labels(scenario.wound_up(norms))}"
    figure, columns = _panels(finding, names, 3, 8, sharex=True)
    for method, trace in traces.items():
        if method.regulator == "offline":
            continue
        style = dict(lw=1.2, label=short_label(method), **plots.STYLES[method.regulator])
        top, middle, bottom = columns[method.dictionary]
        largest, condition = scenario.spectrum(trace["covariance"])
        top.semilogy(t, trace["norm_p"], **style)
        middle.semilogy(t[::EVERY], largest, **style)
        bottom.semilogy(t[::EVERY], condition, **style)
    for name, (top, middle, bottom) in columns.items():
        _phased(top, scenario.title(name))
        for ax, label in ((top, "$\\|P\\|_F$"), (middle, "$\\lambda_{max}(P)$"), (bottom, "condition number of $P$")):
            ax.set_ylabel(label)
        for ax in (middle, bottom):
            scenario.mark_phases(ax, names=False)
        bottom.axhline(1 / np.finfo(np.float32).eps, color="k", lw=0.8)
        bottom.annotate("1 / epsilon of float32", (t[-1], 1 / np.finfo(np.float32).eps), ha="right", va="bottom", fontsize=7)
        bottom.set_xlabel("time (s)")
    plots.legend(figure)
    plots.save(figure, path)


def draw_precision(out, rows, names):
    """float32 against float64, one bar for each method."""
    table = scenario.by_precision(rows)
    costs = {method: 100 * (narrow["mean_error"] / row["mean_error"] - 1) for method, row, narrow in table}
    figure, ax = plots.subplots(figsize=(8, 1.2 + 0.19 * len(table)))
    apart = scenario.labels(method for method, value in scenario.built_in(costs).items() if not value <= 3)
    finding = f"float32 in the plain form costs 3 % of one-step error at most, except with: {apart}"
    ax.set_title(scenario.finding(finding, names), loc="right")
    for i, (method, value) in enumerate(costs.items()):
        shown = float(np.clip(value, -10, 10))
        ax.barh(i, shown, color="0.75", edgecolor="k", hatch=plots.HATCHES[method.regulator])
        side = "left" if shown >= 0 else "right"
        ax.annotate(f" {value:+.2f} % ", (shown, i), ha=side, va="center", fontsize=8)
    ax.axvspan(-3, 3, color="0.93", zorder=0)
    ax.set_yticks(range(len(table)), [method.label for method, _, _ in table])
    ax.invert_yaxis()
    ax.set_xlim(-14, 14)
    ax.set_xlabel("mean error of float32 relative to float64 (%), band: 3 %, clipped at 10 %")
    ax.grid(axis="y", visible=False)
    plots.save(figure, out / "learn_precision.png")
