"""Draws flights of the second vehicle, seals what is in them, has them diagnosed and scores the reports.

blind_quadrotor/labels.json      the truth, with its SHA-256 in seal.json, written before any diagnosis
blind_quadrotor/logs, reports
blind_quadrotor.json             figures and rows, written last
"""

import json
import sys
from pathlib import Path

import numpy as np

from ... import bridge
from ...plumbing import pages
from ...plumbing.errors import UserError
from ...plumbing.results import alone, console, output_folder, print_table, remove, replacing, write_json
from ...plumbing.workers import each, workers
from .. import DIAGNOSE, Command, _empty, diagnose, score
from .draw import TIERS, draw, effects, wanted
from .vehicle import mujoco

SURE = 0.9  # confidence
VERDICTS = ("known", "partly", "none", "unknown", "failed")


# ---- score -----------------------------------------------------------------------------------------


def row_of(label, run):
    """What the score needs of one label and report."""
    report, truth = run["report"], label["effects"]
    row = {key: label[key] for key in ("tier", "kind", "lacks", "acts")} | {"truth": list(truth), "drawn": truth, "seconds": run["seconds"]}
    row |= {"error": run["error"], "verdict": "failed", "first": "", "named": {}, "strict": False, "right": False, "inside": {}}
    if report is None:
        return row
    named = {e["name"]: e for e in report["effects"]}
    first = next(iter(named), report["ranking"][0]["name"] if report["ranking"] else "")
    also = report["ambiguous_with"].get(first, ())
    changed, hidden = report["verdict"] != "none", [name for name in truth if name in report["not_testable"]]
    found = changed and bool({first, *also} & set(truth))
    right = {
        "none": not changed,
        "single": found,
        "left_out": report["verdict"] == "unknown",
        "unknown": report["verdict"] == "unknown",
        "lacking": found or (bool(hidden) and not named),
    }
    inside = {
        f"{name} {p}": bool(low <= truth[name][p] <= high)
        for name, e in named.items()
        for p, (low, high) in (e["params_ci95"].items() if name in truth else ())
    }
    return row | {
        "verdict": report["verdict"], "first": first, "also": list(also), "named": {n: e["confidence"] for n, e in named.items()},
        "strict": changed and first in truth, "right": right[label["tier"]], "hidden": hidden, "inside": inside,
        "sizes": {n: e["params"] for n, e in named.items()},
    }  # fmt: skip


def statements(rows):
    """[(confidence, whether the effect acts, on average over the flight)] of every effect that is named."""
    return [(c, name in row["acts"]) for row in rows for name, c in row["named"].items()]


def _count(rows, key):
    return sum(bool(row[key]) for row in rows)


def figures(rows):
    """{what: (how many, of how many)}."""
    of = lambda tier: [row for row in rows if row["tier"] == tier]  # noqa: E731
    said = statements(rows)
    wrong = [row for row in rows if any(c > SURE and not acts for c, acts in statements([row]))]
    inside = [i for row in rows for i in row["inside"].values()]
    return {
        "one effect: named first, or declared ambiguous with what is": (_count(of("single"), "right"), len(of("single"))),
        "one effect: itself named first": (_count(of("single"), "strict"), len(of("single"))),
        "healthy recognised as healthy": (_count(of("none"), "right"), len(of("none"))),
        "effect taken out of the library: `unknown`": (_count(of("left_out"), "right"), len(of("left_out"))),
        "effect that was never in it: `unknown`": (_count(of("unknown"), "right"), len(of("unknown"))),
        "log that lacks columns: as with one effect, or said not to be testable": (_count(of("lacking"), "right"), len(of("lacking"))),
        "statements with confidence over 0.9 that are wrong": (sum(c > SURE and not acts for c, acts in said), sum(c > SURE for c, _ in said)),
        "reports with such a statement": (len(wrong), len(rows)),
        "sizes inside their 95 % interval": (sum(inside), len(inside)),
        "diagnoses that failed": (sum(row["verdict"] == "failed" for row in rows), len(rows)),
    }  # fmt: skip


def by_effect(rows):
    """Lines of [effect, flights, right, itself first, none, unknown, sizes, inside, left out, unknown then]."""
    lines = []
    for name in effects():
        one, out = ([row for row in rows if row["tier"] == tier and name in row["truth"]] for tier in ("single", "left_out"))
        inside = [i for row in one for i in row["inside"].values()]
        verdicts = [row["verdict"] for row in one]
        counts = verdicts.count("none"), verdicts.count("unknown"), len(inside), sum(inside)
        lines.append([f"`{name}`", len(one), _count(one, "right"), _count(one, "strict"), *counts, len(out), _count(out, "right")])
    return lines


HEADERS = ["effect", "flights", "right", "itself first", "`none`", "`unknown`", "sizes", "inside", "withheld", "then `unknown`"]


def report(rows):
    print_table("Quadrotor, blind", ["", "found", "of"], [[words, *pair] for words, pair in figures(rows).items()])
    print_table("By effect", HEADERS, by_effect(rows))
    never = [[r["log"], *r["truth"], r["verdict"], ", ".join(f"{n} {c:.2f}" for n, c in r["named"].items())]
             for r in rows if r["tier"] == "unknown"]  # fmt: skip
    print_table("Never in the library", ["flight", "effect", "verdict", "named"], never)


def page(rows, n, seed):
    """Writes the tables of docs/quadrotor-blind.md."""
    if all(row["error"] for row in rows):
        raise UserError(f"docs/quadrotor-blind.md stays as it is: every diagnosis failed, the first with {rows[0]['error']}")
    command = f"`make blind PLATFORM=quadrotor N={n} SEED={seed}`"
    lines = []
    for words, (found, of) in figures(rows).items():
        low, high = score.wilson(found, of) if of else (np.nan, np.nan)
        lines.append([words, found, of, f"{low:.2f}", f"{high:.2f}"] if of else [words, "-", "-", "-", "-"])
    tables = [
        pages.table(command, ["", "found", "of", "95 % interval from", "to"], lines),
        pages.table("By effect", HEADERS, by_effect(rows)),
    ]
    pages.update("docs/quadrotor-blind.md", "blind-quadrotor", "\n".join(tables))


# ---- campaign --------------------------------------------------------------------------------------


def run(out, n, seed, cluster=None, jobs=None, which=None, update=False):
    """Writes blind_quadrotor.json, and with `update` the tables of docs/quadrotor-blind.md; returns the rows."""
    if n < 1 or seed < 0:
        raise UserError(f"{n} flights per effect with seed {seed}: at least 1 is needed, and a seed that is not negative")
    strange = [tier for tier in which or () if tier not in TIERS]
    if strange:
        raise UserError(f"--tier {strange[0]}: no such tier; there are {', '.join(TIERS)}")
    if which and update:
        raise UserError("--update: the tables need every tier; leave out --tier")
    mujoco()
    out = output_folder(out)
    with alone(out / "blind_quadrotor.json"), workers(cluster, jobs):
        rows = _campaign(out, n, seed, which or TIERS)
    if update:
        page(rows, n, seed)
    return rows


def _numbered(number, tier, seed, k):
    return number, draw(tier, seed, k)


def _campaign(out, n, seed, which):
    remove(out / "blind_quadrotor.json")
    work = _empty(out / "blind_quadrotor")
    logs, reports, runs = output_folder(work / "logs"), output_folder(work / "reports"), {}
    some = [(tier, k) for tier, k in wanted(n) if tier in which]
    order = np.random.default_rng(seed).permutation(len(some))
    drawn = dict(each(_numbered, [(f"{i:04d}", some[j][0], seed, some[j][1]) for i, j in enumerate(order)], "drawing flights"))
    labels = {name: drawn[name][0] for name in sorted(drawn)}
    write_json(work / "labels.json", labels)
    digest = score.digest(work / "labels.json")
    write_json(work / "seal.json", {"sha256": digest, "seed": seed, "n": n})
    console.print(f"{len(labels)} flights, seed {seed}. The labels are sealed: SHA-256 {digest}", soft_wrap=True)
    for name in labels:
        log = drawn[name][1]
        bridge.write_log(logs / f"{name}.csv", log.x, log.u, log.dt, "quadrotor")
    command = Command((*DIAGNOSE, "--platform", "quadrotor"))
    calls = [(name, command, (logs / f"{name}.csv").read_bytes(), None, label["without"]) for name, label in labels.items()]
    for name, result in each(diagnose, calls, "flights"):
        write_json(reports / f"{name}.json", result)
        runs[name] = result
    rows = [{"log": name} | row_of(label, runs[name]) for name, label in labels.items()]
    report(rows)
    with replacing(out / "blind_quadrotor.json", rows):
        pass
    return rows


def again(work):
    """Scores stored reports again: python -m tinykoop.blind.quadrotor.campaign build/out/blind_quadrotor."""
    labels, seal = (json.loads((work / name).read_text()) for name in ("labels.json", "seal.json"))
    if score.digest(work / "labels.json") != seal["sha256"]:
        raise UserError(f"{work / 'labels.json'}: its SHA-256 is not the sealed one; the labels were changed")
    rows = [{"log": name} | row_of(label, json.loads((work / "reports" / f"{name}.json").read_text())) for name, label in labels.items()]
    report(rows)
    return rows


if __name__ == "__main__":
    again(Path(sys.argv[1]))
