"""The tables of the study on the terminal."""

import numpy as np

from ...plumbing import pages
from ...plumbing.results import number, print_table
from .. import scenario
from .bistability import BISTABLE
from .causes import RADIUS, SETTLED
from .closed_loop import FAILED, SIGMA
from .horizons import FAR, HORIZONS
from .sensitivities import AHEAD, WATCHED
from .solvers import NEWTON


def chance(row):
    """A count with the interval of its probability in percent, for a table."""
    low, high = row["ci95"]
    return f"{row['failures']}/{row['runs']} ({100 * low:.0f}-{100 * high:.0f})"


def setting(row):
    """What distinguishes a cell of the design, in words."""
    if row["start"] != "carried over":
        return "P reset to 100 I"
    if row["solver"] != NEWTON:
        return row["solver"]
    if (row["precision"], row["form"]) != ("f64", "plain"):
        return f"float{row['precision'][1:]}, {'root' if row['form'] == 'sqrt' else 'plain'}"
    return f"offset {number(row['sigma'])}"


SHOWN = {
    "Theta and P carried over": {"sigma": SIGMA, "solver": NEWTON, "precision": "f64", "form": "plain", "start": "carried over"},
    "the same, planned by DAQP": {"sigma": SIGMA, "solver": "DAQP", "start": "carried over"},
    "Theta kept, P reset to 100 I": {"start": "P reset"},
}


def _counted(row):
    return row["runs"], row["failures"], *(f"{100 * edge:.0f}" for edge in row["ci95"])


def page(cells, changed):
    """The tables of docs/control.md: runs of Poly that are lost, and those of vanilla Poly with something changed."""
    poly = [(name, row) for name, wanted in SHOWN.items() for row in cells if row["dictionary"] == "poly" and wanted.items() <= row.items()]
    lost = [[f"{name}: {scenario.LABELS[row['regulator']]}", *_counted(row)] for name, row in poly]
    ends = [[row["changed"].translate({ord("$"): "", ord("\\"): ""}), *_counted(row)] for row in changed]
    headers = ["runs", "lost", "95 % from", "to (%)"]
    first = pages.table("Poly under control, from starts a centimetre apart", ["setting: regulator", *headers], lost)
    return first + "\n" + pages.table("Vanilla Poly with something changed, from the same starts", ["changed", *headers], ends)


def by_horizon(ahead):
    """[(title, headers, lines)], near and far: for each method and horizon the error of the runs that track, and how many are lost."""
    return [_by_horizon([row for row in ahead if row["sigma"] == sigma], where) for sigma, where in STARTS.items()]


STARTS = {SIGMA: "a centimetre apart", FAR: f"{FAR:g} m apart"}


def _by_horizon(rows, where):
    of = {(row["dictionary"], row["regulator"], row["horizon"]): row for row in rows}
    headers = ["method", *(f"{what}: {steps}" for what in ("error", "lost") for steps in HORIZONS)]
    lines = []
    for method in scenario.METHODS:
        some = [of[method.dictionary, method.regulator, steps] for steps in HORIZONS]
        lines.append([method.label, *(number(row["median_error_tracking"]) for row in some), *(row["failures"] for row in some)])
    lost = [sum(row["failures"] for row in rows if row["horizon"] == steps) for steps in HORIZONS]
    lines.append(["all", *[""] * len(HORIZONS), *lost])
    return f"Horizons of 10, 20 and 50 steps, {rows[0]['runs']} runs of each method from starts {where}", headers, lines


def report(cells, ahead, changed, rescued, parted, seen):
    """The tables on the terminal."""
    table = {}
    for row in cells:
        if row["dictionary"] != "poly":
            continue
        name = scenario.LABELS[row["regulator"]]
        line = table.setdefault(setting(row), {"as": []})
        line[name] = chance(row)
        if row["regulator"] in BISTABLE and row["as_newton"] is not None:
            line["as"].append(100 * row["as_newton"])
    names = [scenario.LABELS[regulator] for regulator in scenario.REGULATORS]
    print_table(
        f"Failures (mean error above {FAILED:g}) of Poly: count, 95 % interval of the probability in %",
        ["setting", *names, "same"],
        [[key, *[line.get(name, "") for name in names], number(np.mean(line["as"])) if line["as"] else ""] for key, line in table.items()],
        "Same: % of the runs of the first three that end as they do with Newton from the same start. "
        f"Offset {number(SIGMA)}, Newton, float64, plain, Theta and P carried over, unless the setting says otherwise.",
    )
    errors = np.array([error for row in cells for error in row["mean_errors"]])
    middle = int(np.sum((errors > FAILED / 2) & (errors <= 3 * FAILED)))
    rbf = [row for row in cells if row["dictionary"] == "rbf"]
    ends = [sum(row[end] for row in cells) for end in ("stands", "turned", "lost")]
    print_table(
        "All runs",
        ["", "runs"],
        [
            ["all", len(errors)],
            [f"mean error between {FAILED / 2:g} and {3 * FAILED:g}: where the threshold would matter", middle],
            ["failed: stands still", ends[0]],
            ["failed: keeps the path, heading off by whole turns", ends[1]],
            ["failed: lost otherwise", ends[2]],
            ["RBF", sum(row["runs"] for row in rbf)],
            ["RBF, failed", sum(row["failures"] for row in rbf)],
        ],
    )
    for table in by_horizon(ahead):
        print_table(*table)
    print_table(
        "Vanilla Poly with something changed, from the same starts",
        ["changed", "failures (%)", "median error of those that track"],
        [[row["changed"].replace("$", ""), chance(row), number(row["median_error_tracking"])] for row in changed]
        + [[f"{r['standing']} stand at step {SETTLED}: {r['done']}", f"{r['rescued']} rescued", ""] for r in rescued],
    )
    for row in parted:
        print_table(
            f"Two runs {number(row['distance'], 1)} apart, mean errors {number(row['mean_errors'][0], 2)} and "
            f"{number(row['mean_errors'][1])}: when each suspect shows in the one that fails",
            ["", "step"],
            [
                [f"spectral radius of A above {RADIUS:g}", row["radius_above_cap_at"]],
                ["dpx/dv over 50 steps of the wrong sign", row["wrong_sign_at"]],
                ["condition of the Hessian ten times what it was", row["condition_tenfold_at"]],
                ["KKT residual of a solve above 1e-6", row["residual_above_1e-6_at"]],
                ["inputs of the two 1 % apart", row["inputs_part_at"]],
            ],
        )
    lines = []
    for row in seen:
        wrong = row["wrong_sign"]
        lines.append(
            [
                scenario.Method(row["dictionary"], row["regulator"]).label,
                f"{number(row['mean_error'])}",
                number(row["one_step_error"]),
                *[number(row["relative_error"][str(j)], 2) for j in AHEAD],
                number(row["relative_error_p95"]["49"], 2),
                *[number(None if wrong[w]["49"] is None else 100 * wrong[w]["49"], 2) for w in WATCHED],
            ]
        )
    print_table(
        "Sensitivities in closed loop: relative error (median over time), % of time with the wrong sign over 50 steps",
        ["method", "tracking", "one-step", "j = 0", "j = 9", "j = 49", "p95", *[w.replace("_", "/") for w in WATCHED]],
        lines,
    )
