"""What the settings do: dead-zone threshold, the 27 constant-trace settings, multi-step rollouts."""

import itertools

import numpy as np

from ..plumbing import plots
from ..plumbing.results import number, output_folder, print_table, progress, replacing
from . import scenario

DELTAS = (0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1)
LAMBDAS = (0.95, 0.98, 0.995)
P0S = (1.0, 100.0, 1e4)
TRACES = (0.1, 1.0, 10.0)  # target trace over tr(P0)

# Paper, remark "Hyperparameter Discussion": RBF, delta -> (skip rate, mean error)
PAPER_DELTA = {0.003: (0.6990, 1.52e-3), 0.01: (0.9773, 1.07e-3), 0.03: (0.9950, 5.58e-3)}


def threshold_sweep(x, u, names):
    """Rows of the study "delta": DZ-CS over the threshold, each dictionary, float64."""
    rows = []
    jobs = list(itertools.product(names, DELTAS))
    for dictionary, delta in progress(jobs, "dead-zone threshold"):
        _, trace = scenario.run(scenario.Method(dictionary, "dz_cs"), 64, x, u, delta=delta)
        rows.append(
            {
                "study": "delta",
                "dictionary": dictionary,
                "regulator": "dz_cs",
                "delta": delta,
                "mean_error": float(np.mean(trace["error"])),
                "skip_rate": float(np.mean(trace["frozen"])),
                "final_P_fro": float(trace["norm_p"][-1]),
            }
        )
    return rows


def constant_trace(estimator, trace, x, u, lam, tau0):
    """{"gain_over_bound", "norm_over_trace"}: the largest |K_k| over tau0 |zeta_k| / lambda, and |P_k|_F over tau0.

    `trace` holds P before every step. The first step is left out: its P is P0, which nothing has normalised yet.
    """
    P = trace["covariance"][1:]
    zeta = np.concatenate([estimator.lift(x[1:-1]), u[1:]], axis=1)
    g = np.einsum("kij,kj->ki", P, zeta)
    gain = np.linalg.norm(g, axis=1) / (lam + np.einsum("ki,ki->k", zeta, g))
    bound = tau0 * np.linalg.norm(zeta, axis=1) / lam
    return {"gain_over_bound": float(np.max(gain / bound)), "norm_over_trace": float(np.max(np.linalg.norm(P, axis=(1, 2))) / tau0)}


def trace_settings(x, u, names):
    """Rows of the study "ct": 27 constant-trace settings for each dictionary, float64."""
    rows = []
    jobs = list(itertools.product(names, LAMBDAS, P0S, TRACES))
    for dictionary, lam, p0, multiple in progress(jobs, "constant trace"):
        method = scenario.Method(dictionary, "ct")
        tau0 = multiple * p0 * scenario.start(method, 64).d
        estimator, trace = scenario.run(method, 64, x, u, every=1, lam=lam, p0=p0, tau0=tau0)
        _, condition = scenario.spectrum([estimator.covariance])
        rows.append(
            {
                "study": "ct",
                "dictionary": dictionary,
                "regulator": "ct",
                "lambda": lam,
                "p0": p0,
                "trace_multiple": multiple,
                "mean_error": float(np.mean(trace["error"])),
                "final_condition": float(condition[0]),
                **constant_trace(estimator, trace, x, u, lam, tau0),
            }
        )
    return rows


def rollouts(x, u, methods):
    """Rows of the study "rollout": error over the horizon for each method, float64."""
    rows = []
    for method in progress(methods, "rollouts"):
        estimator, trace = scenario.run(method, 64, x, u, every=scenario.ROLLOUT_STRIDE)
        errors = scenario.rollout_errors(estimator, trace, x, u)
        rows.append(
            {
                "study": "rollout",
                "dictionary": method.dictionary,
                "regulator": method.regulator,
                "rollout_error": {str(h): float(e) for h, e in errors.items()},
            }
        )
    return rows


def run(out, dictionary=None):
    """Writes ablate.json and its plots into `out`; returns the rows. dictionary: FILE:NAME, beside poly and rbf."""
    out = output_folder(out)
    x, u = scenario.drive()
    names, methods = scenario.beside(dictionary, x)
    delta, ct, rollout = threshold_sweep(x, u, names), trace_settings(x, u, names), rollouts(x, u, methods)
    with replacing(out / "ablate.json", delta + ct + rollout):
        draw_threshold(out, delta, names)
        draw_trace(out, ct, names)
        errors = {scenario.Method(row["dictionary"], row["regulator"]): list(row["rollout_error"].values()) for row in rollout}
        for end, some in scenario.families(errors).items():
            draw_rollout(out / f"ablate_rollout{end}.png", some, names)
    report(delta, rollout)
    return delta + ct + rollout


def report(delta, rollout):
    """Threshold sweep and rollouts on the terminal."""
    lines = []
    for row in delta:
        skip, error = PAPER_DELTA.get(row["delta"], (None, None)) if row["dictionary"] == "rbf" else (None, None)
        lines.append(
            [
                f"{scenario.title(row['dictionary'])}, delta {row['delta']:g}",
                f"{100 * row['skip_rate']:.2f}" + (f" ({100 * skip:.2f})" if skip else ""),
                number(row["mean_error"]) + (f" ({number(error)})" if error else ""),
                number(row["final_P_fro"]),
            ]
        )
    print_table(
        "Dead-zone threshold, DZ-CS: the paper in brackets",
        ["setting", "skipped %", "mean error", "final |P|"],
        lines,
        "At delta 0.003 the gate does not bound P with RBF, so that row is sensitive to round-off.",
    )
    print_table(
        "Rollouts of a frozen model: mean state error (m, rad) after h steps",
        ["method", *[f"h = {h}" for h in scenario.HORIZONS]],
        [[scenario.Method(r["dictionary"], r["regulator"]).label, *[number(v) for v in r["rollout_error"].values()]] for r in rollout],
        "Paper at 1 and 50 steps: RBF (DZ-CS) 8.84e-4, 0.321; RBF (SIFt) 3.94e-3, 0.171; Poly (SIFt) -, 0.180.",
    )


# ---- plots -----------------------------------------------------------------------------------


def draw_threshold(out, rows, names):
    """Error and skip rate over delta."""
    figure, (top, bottom) = plots.subplots(2, 1, figsize=(7, 5.5), sharex=True)
    figure.suptitle(scenario.finding("A raw dead-zone threshold does not carry over between dictionaries", names), x=0.01, ha="left")
    styles = dict(color="0.55", ls="--", marker="s"), dict(color="k", marker="o"), dict(color="#1b7837", ls=":", marker="^")
    for dictionary, style in zip(names, styles):
        mine = [r for r in rows if r["dictionary"] == dictionary]
        delta = [r["delta"] for r in mine]
        label = scenario.Method(dictionary, "dz_cs").label
        top.loglog(delta, [r["mean_error"] for r in mine], ms=4, label=label, **style)
        bottom.semilogx(delta, [100 * r["skip_rate"] for r in mine], ms=4, **style)
    top.plot(list(PAPER_DELTA), [e for _, e in PAPER_DELTA.values()], "x", color="#d62728", ms=8, mew=2, label="paper, RBF")
    bottom.plot(list(PAPER_DELTA), [100 * s for s, _ in PAPER_DELTA.values()], "x", color="#d62728", ms=8, mew=2)
    top.legend()
    top.set_ylabel("mean one-step error (m, rad)")
    bottom.set_ylabel("samples with P frozen (%)")
    bottom.set_xlabel("dead-zone threshold $\\delta$ (lifted units)")
    plots.save(figure, out / "ablate_threshold.png")


def draw_trace(out, rows, names):
    """27 bars a panel: error above, condition number below."""
    shades = dict(zip(LAMBDAS, ("0.9", "0.6", "0.25")))
    hatches = dict(zip(P0S, ("", "///", "xxx")))
    figure, axes = plots.subplots(2, len(names), figsize=(5.5 * len(names), 6), sharex=True)
    finding = "Constant trace: a larger target lowers the error and worsens the conditioning"
    figure.suptitle(scenario.finding(finding, names), x=0.01, ha="left")
    for column, dictionary in zip(axes.T, names):
        mine = [r for r in rows if r["dictionary"] == dictionary]
        for ax, value in zip(column, ("mean_error", "final_condition")):
            for row in mine:
                group = TRACES.index(row["trace_multiple"])
                place = LAMBDAS.index(row["lambda"]) + 3 * P0S.index(row["p0"])
                ax.bar(
                    10.5 * group + place, row[value], width=0.9, color=shades[row["lambda"]],
                    hatch=hatches[row["p0"]], edgecolor="k", lw=0.5,
                )  # fmt: skip
            ax.set_yscale("log")
            ax.grid(axis="x", visible=False)
        column[0].set_title(scenario.title(dictionary))
        column[1].set_xticks([10.5 * g + 4 for g in range(3)], [f"{t:g} tr($P_0$)" for t in TRACES])
        column[1].set_xlabel("target trace $\\tau_0$")
    axes[0, 0].set_ylabel("mean one-step error (m, rad)")
    axes[1, 0].set_ylabel("final condition number of P")
    patch = plots.patches().Patch
    keys = [patch(facecolor=shades[lam], edgecolor="k", label=f"$\\lambda$ = {lam:g}") for lam in LAMBDAS]
    keys += [patch(facecolor="w", edgecolor="k", hatch=hatches[p0], label=f"$P_0$ = {p0:g} I") for p0 in P0S]
    figure.legend(handles=keys, loc="outside lower center", ncols=6)
    plots.save(figure, out / "ablate_constant_trace.png")


def draw_rollout(path, errors, names):
    """Error over the horizon, {method: errors at the horizons}."""
    figure, axes = plots.subplots(1, len(names), figsize=(5 * len(names), 4), sharey=True)
    best = [min((m for m in errors if m.dictionary == name), key=lambda m: errors[m][-1]) for name in names]
    figure.suptitle(f"Prediction error over the horizon: after 50 steps the best are {scenario.labels(best)}", x=0.01, ha="left")
    for method, values in errors.items():
        for name, ax in zip(names, axes):
            if name == method.dictionary:
                ax.loglog(
                    scenario.HORIZONS, values, marker="o", ms=3,
                    label=scenario.LABELS[method.regulator], **plots.STYLES[method.regulator],
                )  # fmt: skip
    for name, ax in zip(names, axes):
        ax.set_title(scenario.title(name))
        ax.set_xticks(scenario.HORIZONS, [str(h) for h in scenario.HORIZONS])
        ax.set_xlabel("prediction horizon (steps of 50 ms)")
        ax.set_ylim(5e-4, 10)
    axes[0].set_ylabel("mean state error (m, rad)")
    plots.legend(figure)
    plots.save(figure, path)
