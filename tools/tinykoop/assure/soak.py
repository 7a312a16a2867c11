"""Every kind of estimator through every kind of fault, bare and behind the gate, each beside a twin that never saw it.

The programs of test/soak do the work, one call for each dictionary, regulator, form and precision; here they are built,
run and judged.
"""

import json
import os
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from itertools import product

from ..plumbing import pages, plots
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, progress, replacing
from ..plumbing.sources import regulators
from . import campaigns

DICTIONARIES = ("poly_ddr", "rbf_ddr", "poly_fwmav", "rbf_fwmav")
REGULATORS = regulators()
FORMS = ("plain", "sqrt")
KINDS = tuple(product(campaigns.PRECISIONS, DICTIONARIES, REGULATORS, FORMS))
RUNS = len(KINDS) * 12 * 2  # faults, bare and gated
SEED = 1
TIMEOUT = 3600  # seconds, of one kind


def rows_of(kind, updates):
    """The rows of one kind of estimator, of at least so many updates each, and at least one fault."""
    precision, *names = kind
    printed = run_command(campaigns.program("soak", precision), *names, updates, SEED, timeout=TIMEOUT)
    return [json.loads(line) for line in printed.splitlines()]


# ---- judging ----------------------------------------------------------------------------------------


def failures(rows):
    """What must hold and does not, a line for each row: nothing is lost or silently not finite, and behind the gate all recover."""
    lines = []
    for row in rows:
        seen = []
        if row["non_finite_without_status"]:
            seen.append(f"{row['non_finite_without_status']} outputs not finite without a status")
        if row["lost"]:
            seen.append(f"{row['lost']} times Theta or P was lost")
        if row["gate"] and row["recovered"] < row["episodes"]:
            seen.append(f"{row['episodes'] - row['recovered']} of {row['episodes']} faults not recovered from in {row['limit']} steps")
        if seen:
            lines.append(f"{name_of(row)}: {', '.join(seen)}")
    return lines


def name_of(row):
    """What a row is of."""
    use = "gated" if row["gate"] else "bare"
    return f"{row['condition']}, {row['dictionary']} {row['regulator']} {row['form']} {row['precision']} {use}"


def refused(rows):
    """Samples refused, by status."""
    return sum((Counter(row["refused"]) for row in rows), Counter())


def total(rows, key):
    """Sum over the rows."""
    return sum(row[key] for row in rows)


def by_condition(rows):
    """{condition: rows} in the order of the rows."""
    groups = {}
    for row in rows:
        groups.setdefault(row["condition"], []).append(row)
    return groups


def cell(rows):
    """Worst steps to recover; with the share of faults recovered from where that is not all."""
    recovered, episodes = total(rows, "recovered"), total(rows, "episodes")
    if recovered < episodes:
        return f"{100 * recovered / episodes:.1f} %"
    return str(max((row["steps_to_recover"] for row in rows), default="-"))


# ---- report -----------------------------------------------------------------------------------------


def report(rows):
    """A table behind the gate and one bare: by fault and regulator."""
    for gate, use in ((1, "behind the gate"), (0, "bare")):
        some = [row for row in rows if row["gate"] == gate]
        lines = []
        for condition, group in by_condition(some).items():
            of = [[row for row in group if row["regulator"] == name] for name in REGULATORS]
            share = 100 * sum(refused(group).values()) / total(group, "updates")
            lines.append([condition, *map(cell, of), f"{share:.1f}", total(group, "restored"), total(group, "lost")])
        limits = sorted({row["limit"] for row in some})
        print_table(
            f"Faults, {use}: {total(some, 'updates'):,} updates, {total(some, 'episodes'):,} faults, "
            f"{total(some, 'recovered'):,} recovered from",
            ["fault", *REGULATORS, "refused %", "restored", "lost"],
            lines,
            "Worst steps until the error is within 10 % of that of a twin which never saw the fault, over dictionaries, forms "
            f"and\nprecisions; in % where not all recovered within the stated steps ({limits[0]} to {limits[-1]}, by regulator and size).",
        )


def draw(out, rows):
    """Share of faults recovered from, bare and behind the gate."""
    groups = by_condition(rows)
    figure, ax = plots.subplots(figsize=(8, 4.5))
    shares = {
        gate: total([r for r in rows if r["gate"] == gate], "recovered") / total([r for r in rows if r["gate"] == gate], "episodes")
        for gate in (0, 1)
    }
    ax.set_title(f"Behind the gate {_percent(shares[1])} of the faults leave no trace within the stated steps, bare {_percent(shares[0])}")
    styles = {1: dict(color="0.25", label="behind the gate"), 0: dict(color="0.85", hatch="////", label="bare")}
    for gate, style in styles.items():
        places = [i + (-0.2 if gate else 0.2) for i in range(len(groups))]
        some = [[row for row in group if row["gate"] == gate] for group in groups.values()]
        values = [100 * total(group, "recovered") / total(group, "episodes") for group in some]
        ax.barh(places, values, height=0.4, edgecolor="k", lw=0.6, **style)
    ax.set_yticks(range(len(groups)), list(groups))
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    ax.set_xlim(0, 100)
    ax.set_xlabel("faults after which the estimator is as good as its twin within the stated steps (%)")
    figure.legend(loc="outside lower center", ncols=2)
    plots.save(figure, out / "soak.png")


def _percent(share):
    """In percent; all only where it is all."""
    return "all" if share == 1 else f"{min(100 * share, 99.9):.1f} %"


def page(rows):
    """The table of docs/assurance.md: learners behind the gate, and the updates of all."""
    gated = [row for row in rows if row["gate"]]
    pairs = [
        ("updates, behind the gate and bare", f"{total(rows, 'updates'):.1e}".replace("e+0", "e")),
        ("faults behind the gate", f"{total(gated, 'episodes'):,}"),
        ("recovered from", f"{total(gated, 'recovered'):,}"),
        ("samples to recover, max", max(row["steps_to_recover"] for row in gated)),
    ]
    return pages.facts("`make soak`", pairs)


def run(out, updates, kinds=KINDS, update=False):
    """Writes soak.json and soak.png into `out`, and with `update` the table of docs/assurance.md; returns the rows. Refuses where what must hold does not."""
    if not updates >= 1:
        raise UserError(f"--updates {updates:g}: at least 1 is needed")
    out = output_folder(out)
    campaigns.build("soak")
    each = int(updates / RUNS)
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        done = [pool.submit(rows_of, kind, each) for kind in kinds]
        rows = [row for job in progress(done, "soak") for row in job.result()]
    with replacing(out / "soak.json", rows):
        draw(out, rows)
    report(rows)
    wrong = failures(rows)
    if wrong:
        raise UserError(f"{len(wrong)} of {len(rows)} runs do not hold: {wrong[0]}")
    if update:
        pages.update("docs/assurance.md", "soak", page(rows))
    return rows
