"""The figures of the study."""

import numpy as np

from ...plumbing import plots
from ...plumbing.results import number
from .. import control, scenario
from .causes import RADIUS, TWIN_STEPS
from .closed_loop import FAILED, SIGMA
from .horizons import FAR, HORIZONS
from .sensitivities import WATCHED
from .tables import setting

MARKERS = {"ef": "s", "dz_cs": "o", "dz_ks": "^", "ct": "D", "sift": "v"}


def draw_bistability(out, cells):
    """Mean errors of all runs, and the probability of failure in each setting."""
    poly = [row for row in cells if row["dictionary"] == "poly"]
    figure, (left, right) = plots.subplots(1, 2, figsize=(11, 6), width_ratios=(1, 1.5))
    figure.suptitle(
        "A centimetre at the start, hardly the solver, decides whether vanilla and dead-zone Poly keep the path",
        x=0.01, ha="left",
    )  # fmt: skip
    groups = {scenario.Method("poly", r).label: (r, "carried over") for r in scenario.REGULATORS}
    groups |= {f"Poly ({scenario.LABELS[r]}), P reset": (r, "P reset") for r in ("ct", "sift")}
    spread = np.random.default_rng(0)
    for y, (regulator, start) in enumerate(groups.values()):
        errors = [e for r in poly if (r["regulator"], r["start"]) == (regulator, start) for e in r["mean_errors"]]
        left.scatter(
            errors, y + spread.uniform(-0.3, 0.3, len(errors)), s=9, marker=MARKERS.get(regulator, "P"),
            color=plots.STYLES[regulator]["color"], alpha=0.6, lw=0,
        )  # fmt: skip
    errors = [e for r in cells if r["dictionary"] == "rbf" for e in r["mean_errors"]]
    left.scatter(errors, len(groups) + spread.uniform(-0.3, 0.3, len(errors)), s=9, marker="x", color="0.3", lw=0.8)
    left.axvline(FAILED, color="k", lw=0.8, ls="--")
    left.annotate("failed", (FAILED, 1), (4, -2), xycoords=("data", "axes fraction"), textcoords="offset points", va="top")
    left.set_xscale("log")
    left.set_yticks(range(len(groups) + 1), [*groups, "RBF, regulated"])
    left.invert_yaxis()
    left.set_xlabel("mean tracking error (m, rad)")
    left.set_title("every run")

    names = list(dict.fromkeys(setting(row) for row in poly if row["sigma"] > 0))
    for row in poly:
        if row["sigma"] == 0:
            continue
        place = names.index(setting(row)) + 0.75 * ((scenario.REGULATORS.index(row["regulator"]) + 0.5) / len(scenario.REGULATORS) - 0.5)
        low, high = row["ci95"]
        right.plot([low, high], [place, place], color=plots.STYLES[row["regulator"]]["color"], lw=1.2)
        right.plot(
            row["probability"], place, MARKERS.get(row["regulator"], "P"), ms=5, color=plots.STYLES[row["regulator"]]["color"],
            label=scenario.Method("poly", row["regulator"]).label,
        )  # fmt: skip
    for y in range(1, len(names)):
        right.axhline(y - 0.5, color="0.85", lw=0.6)
    right.set_yticks(range(len(names)), names)
    right.set_ylim(len(names) - 0.5, -0.5)
    right.grid(axis="y", visible=False)
    right.set_xlim(-0.02, 1.02)
    right.set_xlabel("probability of failure, 95 % interval")
    right.set_title(f"by setting (offset {number(SIGMA)} where none is named)")
    handles = {label: handle for handle, label in zip(*right.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=5)
    plots.save(figure, out / "study_bistability.png")


def draw_horizons(out, ahead):
    """Error of the runs that track, and runs that are lost, for each method and horizon, from starts that are far apart."""
    of = {(row["dictionary"], row["regulator"], row["horizon"]): row for row in ahead if row["sigma"] == FAR}
    lost = {steps: sum(row["failures"] for row in of.values() if row["horizon"] == steps) for steps in HORIZONS}
    figure, (left, right) = plots.subplots(1, 2, figsize=(11, 1.5 + 0.32 * len(scenario.METHODS)), sharey=True)
    title = f"From starts {FAR:g} m apart, runs lost with a horizon of " + ", ".join(f"{steps} steps: {n}" for steps, n in lost.items())
    figure.suptitle(title, x=0.01, ha="left")
    for y, method in enumerate(scenario.METHODS):
        for shift, marker, steps in zip((-0.2, 0, 0.2), "o^s", HORIZONS):
            row = of[method.dictionary, method.regulator, steps]
            style = dict(marker=marker, color="k", mfc="none", ls="", label=f"{steps} steps")
            left.plot(row["median_error_tracking"], y + shift, **style)
            right.plot(row["ci95"], [y + shift] * 2, color="0.6", lw=1)
            right.plot(row["probability"], y + shift, **style)
    left.set_yticks(range(len(scenario.METHODS)), [method.label for method in scenario.METHODS])
    left.invert_yaxis()
    left.set_xscale("log")
    left.set_xlabel("mean tracking error, median of the runs that track (m, rad)")
    right.set_xlabel("probability that a run is lost, 95 % interval")
    handles = {label: handle for handle, label in zip(*left.get_legend_handles_labels())}
    figure.legend(handles.values(), handles.keys(), loc="outside lower right", ncols=3)
    plots.save(figure, out / "study_horizons.png")


def draw_mechanism(out, parts, changed):
    """The twins, and what the interventions do."""
    figure, axes = plots.subplots(2, 2, figsize=(11, 6.4))
    figure.suptitle(
        "Vanilla Poly fails where a few samples make A unstable over the horizon: with its radius capped none fails",
        x=0.01, ha="left",
    )  # fmt: skip
    t = np.arange(TWIN_STEPS) * scenario.DT
    *parts, bounded = parts
    looks = (dict(color="0.6", lw=2.6), dict(color="k", lw=1, ls="--"))
    names = ("survives", "fails, from a start 1e-6 beside it")
    (error, fate), (radius, slope) = axes
    for part, look, name in zip(parts, looks, names):
        error.semilogy(t, part["error"][:TWIN_STEPS], label=name, **look)
        radius.plot(t, part["radius"], label=name, **look)
        slope.plot(t, part["learned"], label=f"{name}: learned", **look)
    slope.plot(t, parts[1]["true"], color="#08306b", lw=1.4, ls=":", label="the robot's own")
    error.set_ylabel("tracking error (m, rad)")
    error.set_title("twin runs")
    error.legend()
    radius.plot(t, bounded["radius"], color="#e6a000", lw=1.6, ls=":", label="CT, same start")
    radius.axhline(RADIUS, color="#d62728", lw=1, ls="-.", label="cap")
    radius.set_ylabel("spectral radius of A")
    radius.set_title("the model is unstable")
    radius.legend()
    slope.set_yscale("symlog", linthresh=0.1)
    slope.set_ylim(-1e3, 5)
    slope.set_ylabel("$\\partial p_x[k+50] / \\partial v[k]$ (s)")
    slope.set_title("what speed does to the position 2.5 s later, it believes")
    slope.legend(loc="lower left")
    for ax in (error, radius, slope):
        ax.set_xlabel("time (s)")
    for y, row in enumerate(changed):
        fate.barh(y, row["probability"], color="0.8", edgecolor="k", lw=0.6, hatch="//" if y == 0 else "")
        low, high = row["ci95"]
        fate.plot([low, high], [y, y], color="k", lw=1.4)
        fate.plot(row["probability"], y, "ko", ms=4, clip_on=False)
    fate.set_yticks(range(len(changed)), [row["changed"] for row in changed])
    fate.invert_yaxis()
    fate.grid(axis="y", visible=False)
    fate.set_xlim(0, 1)
    fate.set_xlabel("probability of failure, 95 % interval")
    fate.set_title(f"what is changed, {changed[0]['runs']} runs each")
    plots.save(figure, out / "study_mechanism.png")


def draw_sensitivities(out, compared):
    """Learned against true over time, over the whole horizon."""
    figure, axes = plots.subplots(2, 2, figsize=(11, 6.2), sharex=True, sharey="row")
    figure.suptitle(
        "What control believes an input does 2.5 s later: vanilla and dead-zone Poly leave the robot, even in sign",
        x=0.01, ha="left",
    )  # fmt: skip
    shown = (
        ("dpx_dv", "$\\partial p_x / \\partial v$ (s)"),
        ("dpy_domega", "$\\partial p_y / \\partial \\omega$ (m s)"),
    )
    for column, (dictionary, name) in zip(axes.T, (("poly", "Poly"), ("rbf", "RBF"))):
        for ax, (key, _) in zip(column, shown):
            state, of, _ = WATCHED[key]
            methods = [m for m in compared if m.dictionary == dictionary and m != scenario.Method("rbf", "ef")]
            steady = compared[scenario.Method(dictionary, "sift")][1]
            ax.plot(steady["t"], steady["true"][:, -1, state, of], color="0.8", lw=4, label="robot (run of SIFt)")
            for method in methods:
                found = compared[method][1]
                ax.plot(
                    found["t"], found["learned"][:, -1, state, of], lw=1, label=scenario.LABELS[method.regulator],
                    **plots.STYLES[method.regulator],
                )  # fmt: skip
            ax.set_yscale("symlog", linthresh=0.1)
            ax.axhline(0, color="k", lw=0.6)
            scenario.mark_phases(ax, control.STEPS, names=ax is column[0])
            column[0].set_title(name, pad=16)
        column[1].set_xlabel("time (s)")
    for ax, (_, label) in zip(axes[:, 0], shown):
        ax.set_ylabel(label)
    axes[0, 0].legend(ncols=3, loc="lower right")
    axes[0, 1].legend(ncols=3, loc="lower right")
    plots.save(figure, out / "study_sensitivities.png")
