"""The precision study: where float32, float64 and the forms of P part ways, and what that means.

Four questions, one plot each:
- at which step does a dictionary and regulator lose positive definiteness, stop being finite, or
  leave the result of float64 in square-root form (windup_lanes.png);
- how does |P| compare with the closed form P0 lambda^-k of a direction that is never excited
  (windup_growth.png);
- does a form survive two million well-excited updates (windup_soak.png);
- what becomes of the covariance ellipsoid with and without forgetting, the paper's figure (windup_ellipsoids.png).
"""

import numpy as np

from .. import bridge, dictionaries
from ..plumbing import pages, plots
from ..plumbing.results import number, output_folder, print_table, progress, replacing, write_json
from . import scenario

FORMS = ("plain", "sqrt", "textbook")
REGULATORS = bridge.regulator_names()
PRECISIONS = (64, 32)

# A prediction has left the reference when it differs by more than this: half of what the
# one-step error of a working method is (m, rad).
LEFT = 2.5e-3

GROWTH_STEPS = 40_000  # float64 overflows after 34,900 steps of 0.98^-k from 100

SOAK_UPDATES = 2_000_000

ELLIPSES = {"ef": (0, 50, 100, 150, 200), "none": (0, 100, 150, 200, 1000)}  # steps
V, OMEGA, IDLE = -2, -1, 3  # columns of zeta: the inputs, and the first radial basis function, far from the path


def first_departure(trace, reference):
    """First step whose prediction differs from the reference's by more than LEFT."""
    apart = np.linalg.norm(trace["predicted"] - reference["predicted"], axis=1)
    return scenario.first(~(apart <= LEFT))


def study(x, u, names):
    """Rows of windup.json for the paper's run, and the traces."""
    rows, traces = [], {}
    jobs = [
        (dictionary, regulator, form, precision)
        for dictionary in names
        for regulator in REGULATORS
        for precision in PRECISIONS
        for form in ("sqrt", "plain", "textbook")
    ]
    for job in progress(jobs, "precision and form"):
        dictionary, regulator, form, precision = job
        method = scenario.Method(dictionary, regulator)
        estimator, trace = scenario.run(method, precision, x, u, form=form)
        traces[job] = trace
        reference = traces[dictionary, regulator, "sqrt", 64]
        rows.append(
            {
                "dictionary": dictionary,
                "regulator": regulator,
                "precision": f"f{precision}",
                "form": form,
                "steps": len(u),
                "lost_positive_definite_at": scenario.first(trace["positive_definite"] == 0),
                "non_finite_at": scenario.first(trace["status"] < 0),
                "left_float64_at": first_departure(trace, reference),
                "final_P_fro": float(trace["norm_p"][-1]),
                "final_P_inputs": [float(estimator.covariance[i, i]) for i in (V, OMEGA)],
                "mean_error": float(np.mean(trace["error"])),
            }
        )
    return rows


def growth():
    """{(form, precision): |P|} over GROWTH_STEPS of vanilla RBF, and for each the first refusal."""
    x, u = scenario.drive(GROWTH_STEPS)
    curves = {}
    jobs = [(form, precision) for form in FORMS for precision in PRECISIONS]
    for form, precision in progress(jobs, "windup to overflow"):
        _, trace = scenario.run(scenario.Method("rbf", "ef"), precision, x, u, form=form)
        refused = scenario.first(trace["status"] < 0)
        norm = trace["norm_p"].copy()
        if refused is not None:
            norm[refused:] = np.nan
        curves[form, precision] = norm, refused
    return curves


def ellipsoids():
    """{regulator: P before each of ELLIPSES} of RBF in square-root form, with forgetting (ef) and without (none)."""
    found = {}
    for regulator, steps in ELLIPSES.items():
        _, trace = scenario.run(scenario.Method("rbf", regulator), 64, *scenario.drive(max(steps) + 1), form="sqrt", every=1)
        found[regulator] = trace["covariance"][list(steps)]
    return found


def soak_data(steps=997, seed=1):
    """Regressors (steps, 24), persistently exciting, and targets (steps, 22) of a known Theta."""
    rng = np.random.default_rng(seed)
    theta = rng.standard_normal((22, 24)).astype(np.float32).astype(float)
    zeta = rng.standard_normal((steps, 24)).astype(np.float32).astype(float)
    return theta, zeta, zeta @ theta.T


def soak():
    """Rows on 2,000,000 updates of exponential forgetting with persistent excitation."""
    theta, zeta, target = soak_data()
    rows = []
    jobs = [(form, precision) for form in FORMS for precision in PRECISIONS]
    for form, precision in progress(jobs, "soak, 2 million updates"):
        # the textbook form is left to itself, ours refuse what would break them
        check = bridge.CHECK_REPORT if form == "textbook" else bridge.CHECK_DIAGONAL
        estimator = bridge.Estimator("rbf_ddr", "ef", precision, form=form, check=check)
        repeats = -(-SOAK_UPDATES // len(zeta))
        result = estimator.soak(zeta, target, repeats)
        error = float(np.linalg.norm(estimator.theta - theta) / np.linalg.norm(theta))
        rows.append({"study": "soak", "precision": f"f{precision}", "form": form, **result, "theta_error": error})
    return rows


def run(out, update=False, dictionary=None):
    """Writes windup.json, windup_soak.json and the plots into `out`, and with `update` the table of docs/learning.md; returns the rows.

    dictionary: FILE:NAME, beside poly and rbf in the paper's run.
    """
    out = output_folder(out)
    x, u = scenario.drive()
    names, _ = scenario.beside(dictionary, x)
    rows = study(x, u, names)
    curves = growth()
    soaks = soak()
    with replacing(out / "windup.json", rows):
        write_json(out / "windup_soak.json", soaks)
        paper = [name for name in REGULATORS if name in {"none"} | {name for _, name in scenario.PAPER}]
        for end, some in {"": paper, "_others": [name for name in REGULATORS if name not in paper]}.items():
            draw_lanes(out / f"windup_lanes{end}.png", rows, some, names)
        draw_growth(out, curves)
        draw_soak(out, soaks)
        draw_ellipsoids(out, ellipsoids())
    report(rows, curves, soaks)
    if update:
        first = pages.table("Runs of 5,000 steps in which P loses positive definiteness", *lost(rows))
        pages.update("docs/learning.md", "windup", first + "\n" + pages.table("Where each form ends", *ends(rows, curves, soaks)))
        pages.picture(out / "windup_ellipsoids.png")
    return rows


def lost(rows):
    """(headers, lines): in how many runs of each form P loses positive definiteness, by precision."""
    lines = []
    for form in FORMS:
        some = {name: [row for row in rows if (row["form"], row["precision"]) == (form, name)] for name in ("f32", "f64")}
        counts = [f"{sum(row['lost_positive_definite_at'] is not None for row in part)} of {len(part)}" for part in some.values()]
        lines.append([form, *counts])
    return ["form", "float32", "float64"], lines


def ends(rows, curves, soaks):
    """(headers, lines): vanilla RBF's first steps without definiteness and without a finite P, and what the soak leaves, by form."""
    lines = []
    for form in FORMS:
        for precision in (32, 64):
            name = f"f{precision}"
            vanilla = {"dictionary": "rbf", "regulator": "ef", "precision": name, "form": form}
            (row,) = [row for row in rows if vanilla.items() <= row.items()]
            (soaked,) = [s for s in soaks if (s["precision"], s["form"]) == (name, form)]
            steps = [row["lost_positive_definite_at"], curves[form, precision][1], soaked["non_finite_at"]]
            gone = soaked["non_finite_at"] is not None
            lines.append(
                [
                    f"{form}, float{precision}",
                    *["-" if k is None else f"{k:,}" for k in steps],
                    "-" if gone else number(soaked["theta_error"], 1),
                ]
            )
    headers = ["", "vanilla RBF: not positive definite", "not finite", "2,000,000 excited updates: not finite", "relative error of Theta"]
    return headers, lines


def _event(row, name):
    return "-" if row[name] is None else str(row[name])


def report(rows, curves, soaks):
    """The events of every run in which something happened, and the soak."""
    eventful = [r for r in rows if any(r[k] is not None for k in EVENTS)]
    print_table(
        f"Precision and form over 5,000 steps: {len(rows) - len(eventful)} of {len(rows)} runs see no event, these do",
        ["run", "P indefinite at", "non-finite at", "left float64 at", "mean error", "final |P|"],
        [
            [
                f"{scenario.title(r['dictionary'])} {r['regulator']}, {r['precision']} {r['form']}",
                *[_event(r, k) for k in EVENTS],
                number(r["mean_error"]),
                number(r["final_P_fro"]),
            ]
            for r in eventful
        ],
        f"Left float64: a prediction more than {LEFT:g} from that of float64 in square-root form.",
    )
    print_table(
        "Vanilla RBF: first step at which P does not fit",
        ["form", "float32", "float64"],
        [[form, number(curves[form, 32][1]), number(curves[form, 64][1])] for form in FORMS],
        f"Closed form 100 * 0.98^-k: {overflow(np.float32)} and {overflow(np.float64)} steps; its root: "
        f"{overflow(np.float32, 2)} and {overflow(np.float64, 2)}.",
    )
    print_table(
        "Soak: 2,000,000 updates with persistent excitation, lambda 0.98, d = 24",
        ["form", "P indefinite at", "non-finite at", "refused", "|Theta - true| / |true|"],
        [
            [
                f"{r['precision']} {r['form']}",
                _event(r, "lost_positive_definite_at"),
                _event(r, "non_finite_at"),
                r["refused"],
                number(r["theta_error"]),
            ]
            for r in soaks
        ],
    )


EVENTS = ("lost_positive_definite_at", "non_finite_at", "left_float64_at")


def overflow(dtype, root=1):
    """First k for which 100 * 0.98^-k, or its root, is beyond the range of dtype."""
    return int(np.ceil((root * np.log(float(np.finfo(dtype).max)) - np.log(100)) / -np.log(0.98)))


# ---- plots -----------------------------------------------------------------------------------


def draw_lanes(path, rows, regulators, names):
    """One lane for each run: how long it stayed sound."""
    figure, axes = plots.subplots(1, len(names), figsize=(5.5 * len(names), 7), sharey=True)
    lost = [r for r in rows if r["dictionary"] in dictionaries.BUILT_IN and r["lost_positive_definite_at"] is not None]
    counts = {form: len({r["regulator"] for r in lost if r["form"] == form}.intersection(regulators)) for form in FORMS}
    finding = (
        f"The covariance P loses positive definiteness in the textbook form with {counts['textbook']} of {len(regulators)} regulators, "
        f"in the square-root form (sqrt) with {counts['sqrt']}"
    )
    figure.suptitle(scenario.finding(finding, names), x=0.01, ha="left")
    lanes = [(regulator, form, precision) for regulator in regulators for precision in (32, 64) for form in FORMS]
    for ax, dictionary in zip(axes, names):
        for i, (regulator, form, precision) in enumerate(lanes):
            row = next(
                r for r in rows
                if (r["dictionary"], r["regulator"], r["form"], r["precision"]) == (dictionary, regulator, form, f"f{precision}")
            )  # fmt: skip
            y = i + regulators.index(regulator)  # a gap after each regulator
            end = row["steps"]
            left, lost, non_finite = (row[k] for k in ("left_float64_at", "lost_positive_definite_at", "non_finite_at"))
            ax.barh(y, end, color="0.9", height=0.8)
            if left is not None:
                ax.barh(y, end - left, left=left, color="0.65", height=0.8)
            if lost is not None:
                ax.barh(y, end - lost, left=lost, color="none", edgecolor="k", hatch="////", height=0.8, lw=0.6)
            if non_finite is not None:
                ax.barh(y, end - non_finite, left=non_finite, color="k", height=0.8)
        ax.set_title(scenario.title(dictionary))
        ax.set_xlabel("step, 50 ms each")
        ax.set_xlim(0, 5000)
        ax.grid(axis="y", visible=False)
    places = [i + regulators.index(lane[0]) for i, lane in enumerate(lanes)]
    axes[0].set_yticks(places, [f"{form} f{precision}" for _, form, precision in lanes], fontsize=7)
    for g, regulator in enumerate(regulators):
        axes[-1].annotate(scenario.LABELS[regulator], (1.02, 7 * g + 2.5), xycoords=("axes fraction", "data"), va="center", fontsize=9)
    axes[0].invert_yaxis()
    patch = plots.patches().Patch
    keys = [
        patch(facecolor="0.9", label="sound"),
        patch(facecolor="0.65", label=f"prediction over {1000 * LEFT:g} mm from that of sqrt f64"),
        patch(facecolor="w", edgecolor="k", hatch="////", label="P not positive definite"),
        patch(facecolor="k", label="updates refused: P would overflow"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=4)
    plots.save(figure, path)


def draw_growth(out, curves):
    """|P| of vanilla RBF against the closed form and the ranges of the formats."""
    figure, ax = plots.subplots(figsize=(9, 4.5))
    ax.set_title("Windup of vanilla RBF follows $P_0\\,\\lambda^{-k}$ until the number format ends")
    k = np.arange(GROWTH_STEPS)
    closed = 2 - k * np.log10(0.98)
    ax.plot(k, closed, color="0.8", lw=6, label="closed form $100 \\cdot 0.98^{-k}$")
    styles = {
        ("plain", 32): dict(color="#d62728", ls="-"), ("textbook", 32): dict(color="#e6a000", ls="--"),
        ("sqrt", 32): dict(color="#1b7837", ls=":", lw=2.2), ("plain", 64): dict(color="#08306b", ls="-"),
        ("textbook", 64): dict(color="#4292c6", ls="--"), ("sqrt", 64): dict(color="k", ls=":", lw=2.2),
    }  # fmt: skip
    for (form, precision), (norm, refused) in curves.items():
        with np.errstate(divide="ignore", invalid="ignore"):
            y = np.log10(norm)
        ax.plot(k, y, label=f"{form} f{precision}", **styles[form, precision])
        if refused:
            ax.plot(refused - 1, y[refused - 1], "k|", ms=14, mew=2)
    for limit, name in ((38.5, "largest float32"), (77, "its square: range of the root form"), (308.3, "largest float64")):
        ax.axhline(limit, color="k", lw=0.7, ls=(0, (4, 3)))
        ax.annotate(name, (GROWTH_STEPS, limit), ha="right", va="bottom", fontsize=8)
    ax.set_xlabel("step, 50 ms each; bars mark where samples start to be refused")
    ax.set_ylabel("$\\log_{10} \\|P\\|_F$")
    ax.set_ylim(0, 360)
    plots.legend(figure)
    plots.save(figure, out / "windup_growth.png")


def _ellipse(P, i, j):
    """Points (2, n) of the section z' P^-1 z = 1 of coordinates i and j, others free."""
    angle = np.linspace(0, 2 * np.pi, 200)
    return np.linalg.cholesky(P[np.ix_((i, j), (i, j))]) @ np.stack([np.cos(angle), np.sin(angle)])


def draw_ellipsoids(out, found):
    """The paper's illustration, from runs: P over two coordinates of zeta, with forgetting and without."""
    figure, axes = plots.subplots(1, 2, figsize=(10, 4.6))
    figure.suptitle(
        "Covariance ellipsoids of RBF: with forgetting the idle axis grows, without it the excited axes vanish", x=0.01, ha="left"
    )
    panels = (("ef", IDLE, "first radial basis function (1)", "$\\lambda$ = 0.98: idle axis"),
              ("none", OMEGA, "turn rate $\\omega$ (s/rad)", "$\\lambda$ = 1: excited axis"))  # fmt: skip
    for ax, (regulator, other, label, title) in zip(axes, panels):
        steps, P = ELLIPSES[regulator], found[regulator]
        for i, (k, one) in enumerate(zip(steps, P)):
            style = dict(color=str(0.75 - 0.75 * i / (len(steps) - 1)), lw=1 + 0.3 * i, ls=("-", "--", "-.", ":", "-")[i])
            ax.plot(*_ellipse(one, V % len(one), other % len(one)), label=f"step {k:,}", **style)
        size = [number(float(np.sqrt(one[other, other])), 2) for one in (P[0], P[-1])]
        ax.set_title(f"{title}, {size[0]} to {size[1]} in {steps[-1]:,} steps")
        ax.set_xlabel("semi-axis along speed $v$ (s/m)")
        ax.set_ylabel(f"semi-axis along {label}")
        ax.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    plots.save(figure, out / "windup_ellipsoids.png")


def draw_soak(out, rows):
    """Error of Theta after the soak."""
    figure, ax = plots.subplots(figsize=(8, 3.6))
    ax.set_title("After two million well-excited updates ours is at round-off, the textbook form long gone")
    ceiling = 1e2
    for i, row in enumerate(rows):
        failed = row["non_finite_at"] is not None
        value = ceiling if failed or not np.isfinite(row["theta_error"]) else row["theta_error"]
        ax.barh(i, value, left=1e-18, color={"f32": "0.8", "f64": "0.5"}[row["precision"]], edgecolor="k", hatch="xx" if failed else "")
        text = f" not finite from update {row['non_finite_at']:,} " if failed else f" {row['theta_error']:.1e}"
        ax.annotate(text, (min(value, 1e-3), i), va="center", ha="right" if failed else "left",
                    bbox=dict(fc="w", ec="none", pad=1) if failed else None, fontsize=8)  # fmt: skip
    ax.set_xscale("log")
    ax.set_xlim(1e-17, ceiling)
    ax.set_yticks(range(len(rows)), [f"{r['form']} {r['precision']}" for r in rows])
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    ax.set_xlabel("relative error of the learned $\\Theta$")
    plots.save(figure, out / "windup_soak.png")
