"""Draws logs of one robot, seals what is in them, has them diagnosed and scores the reports.

blind_NAME/labels.json      the truth, with its SHA-256 in seal.json, written before any diagnosis
blind_NAME/logs, reports
blind_NAME.json             figures and rows, written last
"""

import csv
import random
import sys
from pathlib import Path

import numpy as np

from ...plumbing import plots
from ...plumbing.checkout import ROOT
from ...plumbing.errors import UserError
from ...plumbing.results import alone, console, number, output_folder, print_table, remove, replacing, write_json
from ...plumbing.workers import each, workers
from .. import DIAGNOSE, Command, _empty, diagnose, page, score
from . import ROBOTS
from .plant import drive

EXAMPLES = ROOT / "examples/own_robot"
TIERS = {
    "none": "none: healthy",
    "single": "one",
    "pair": "two",
    "left_out": "one, withheld",
    "unknown": "unknown to all",
}
VERDICTS = "known", "partly", "none", "unknown", "failed"
SURE = 0.9  # confidence


def _drawn(plant, sizes, name, chance):
    size = chance.uniform(*sizes[name])
    signed = name.partition(":")[0] in plant.SIGNED
    return size * chance.choice((-1, 1)) if signed else size


def _pair(plant, chance):
    """Two effects of different kinds, neither of which mimics the other."""
    while True:
        one, two = chance.sample(list(plant.KNOWN), 2)
        if two not in plant.ALIKE.get(one, ()) and one not in plant.ALIKE.get(two, ()):
            return one, two


def draw(plant, tier, seed, k):
    """(label, rows) of log k of a tier; each effect of a kind comes before the first comes again."""
    chance = random.Random(f"{plant.NAME} {tier} {seed} {k}")
    sizes = plant.UNKNOWN if tier == "unknown" else plant.KNOWN
    order = random.Random(f"{plant.NAME} {tier} {seed}").sample(list(sizes), len(sizes))
    names = {"none": (), "pair": _pair(plant, chance)}.get(tier, (order[k % len(order)],))
    effects = {name: _drawn(plant, sizes, name, chance) for name in names}
    without = sorted({a for name in names for a in (name, *plant.ALIKE.get(name, ()))}) if tier == "left_out" else []
    return {"tier": tier, "effects": effects, "without": without}, [plant.columns(row) for row in drive(plant, effects, chance)]


def write(path, plant, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([plant.HEADER, *([f"{v:.9g}" for v in row] for row in rows)])


def row_of(label, run):
    """What the score needs of one label and report."""
    report, truth = run["report"], label["effects"]
    row = {"tier": label["tier"], "truth": list(truth), "seconds": run["seconds"], "error": run["error"], "verdict": "failed"}
    row |= {"first": "", "named": [], "right": False, "sure_wrong": False, "passes": None, "errors": []}
    if report is None:
        return row
    also = report["ambiguous_with"]
    stands_for = lambda name: {name, *also.get(name, ())}  # noqa: E731
    named = {e["name"]: e for e in report["effects"]}
    wrong = [e for name, e in named.items() if not stands_for(name) & set(truth)]
    errors = [abs(next(iter(named[n]["params"].values())) / size - 1) for n, size in truth.items() if n in named]
    first = next(iter(named), report["ranking"][0]["name"] if report["ranking"] else "")
    found = not wrong and all(any(name in stands_for(n) for n in named) for name in truth)
    right = {
        "none": report["verdict"] == "none",
        "single": report["verdict"] != "none" and bool(stands_for(first) & set(truth)),
        "pair": found,
        "left_out": report["verdict"] == "unknown",
        "unknown": report["verdict"] == "unknown",
    }
    return row | {
        "verdict": report["verdict"], "first": first, "named": list(named), "right": right[label["tier"]], "found": found and bool(named),
        "sure_wrong": any(e["confidence"] > SURE for e in wrong), "passes": report["passes"], "errors": errors,
        "inside": [c[0] <= truth[n] <= c[1] for n in truth if n in named for c in list(named[n]["params_ci95"].values())[:1]],
        "sizes": {n: {**e["params"], "confidence": e["confidence"]} for n, e in named.items()}, "drawn": truth,
    }  # fmt: skip


def run(out, name, n, seed, cluster=None, jobs=None, which=None, update=False):
    """Writes blind_NAME.json and its plot, and with `update` the robot's table of docs/own-robot.md; returns the rows."""
    if n < 1 or seed < 0:
        raise UserError(f"{n} logs per tier with seed {seed}: at least 1 is needed, and a seed that is not negative")
    out, plant = output_folder(out), ROBOTS[name]
    with alone(out / f"blind_{name}.json"):
        rows = _campaign(out, plant, n, seed, cluster, jobs, which or TIERS)
    if update:
        page.robot(plant, rows, TIERS, n, seed)
    return rows


def _campaign(out, plant, n, seed, cluster, jobs, tiers):
    remove(out / f"blind_{plant.NAME}.json")
    work = _empty(out / f"blind_{plant.NAME}")
    wanted = [(tier, k) for tier in tiers for k in range(n)]
    order = np.random.default_rng(seed).permutation(len(wanted))
    logs, reports, runs = output_folder(work / "logs"), output_folder(work / "reports"), {}
    with workers(cluster, jobs):
        drawn = dict(each(_numbered, [(plant.NAME, f"{i:04d}", *wanted[j], seed) for i, j in enumerate(order)], "drawing logs"))
        labels = {name: drawn[name][0] for name in sorted(drawn)}
        write_json(work / "labels.json", labels)
        write_json(work / "seal.json", {"sha256": score.digest(work / "labels.json"), "seed": seed, "n": n})
        console.print(
            f"{len(labels)} logs, seed {seed}. The labels are sealed: SHA-256 {score.digest(work / 'labels.json')}", soft_wrap=True
        )
        for name in labels:
            write(logs / f"{name}.csv", plant, drawn[name][1])
        command = Command((*DIAGNOSE, "--robot", EXAMPLES / plant.FILE))
        calls = [(name, command, (logs / f"{name}.csv").read_bytes(), None, label["without"]) for name, label in labels.items()]
        for name, result in each(diagnose, calls, plant.NAME):
            write_json(reports / f"{name}.json", result)
            runs[name] = result
    rows = [{"log": name} | row_of(label, runs[name]) for name, label in labels.items()]
    report(plant, rows)
    with replacing(out / f"blind_{plant.NAME}.json", rows):
        draw_answers(out, plant, rows)
    return rows


def _numbered(robot, number, tier, k, seed):
    return number, draw(ROBOTS[robot], tier, seed, k)


def report(plant, rows):
    """The table of tiers."""
    lines = []
    for tier, words in TIERS.items():
        some = [row for row in rows if row["tier"] == tier]
        if not some:
            continue
        verdicts = [row["verdict"] for row in some]
        count = lambda key: f"{sum(bool(row.get(key)) for row in some)}/{len(some)}"  # noqa: E731
        errors, passes = [e for row in some for e in row["errors"]], [row["passes"] for row in some if row["passes"]]
        inside = [i for row in some for i in row.get("inside", ())]
        lines.append([
            words, count("right"), " ".join(str(verdicts.count(v)) for v in VERDICTS), count("sure_wrong"),
            f"{100 * np.median(errors):.2g} %" if errors else "-", f"{sum(inside)}/{len(inside)}" if inside else "-",
            f"{np.median(passes):.0f}, {max(passes)}" if passes else "-", f"{number(np.median([row['seconds'] for row in some]), 2)} s",
        ])  # fmt: skip
    headers = ["effects", "right", "verdicts", "wrong", "size off", "in 95 %", "passes", "time"]
    note = (
        "right: one, named first; two, both and no other; names that the report calls ambiguous count. withheld: from the library of the"
        f" diagnosis; unknown to all: no library has it. verdicts: {', '.join(VERDICTS)}. wrong: with a confidence over {SURE}. size off:"
        " median. in 95 %: sizes in their intervals. passes: median, max."
    )
    print_table(f"Blind: {plant.NAME}", headers, lines, note)


def draw_answers(out, plant, rows):
    """True effect against what is named first."""
    some = [row for row in rows if row["tier"] in ("none", "single", "unknown")]
    truths = ["none", *plant.KNOWN, *plant.UNKNOWN]
    answers = sorted(
        {_answer(row) for row in some} | {"none", "unknown"}, key=lambda a: (a not in truths, truths.index(a) if a in truths else a)
    )
    counts = np.zeros((len(truths), len(answers)))
    for row in some:
        counts[truths.index((row["truth"] or ["none"])[0]), answers.index(_answer(row))] += 1
    figure, ax = plots.subplots(figsize=(8, 6.5))
    totals = counts.sum(1)
    ax.imshow(counts / np.maximum(totals, 1)[:, None], cmap="Greys", vmin=0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(counts)):
        dark = counts[i, j] > 0.6 * totals[i]
        ax.annotate(f"{counts[i, j]:.0f}", (j, i), ha="center", va="center", fontsize=8, color="w" if dark else "k")
    ax.set_xticks(range(len(answers)), answers, rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(truths)), [f"{t} ({n:.0f})" for t, n in zip(truths, totals)], fontsize=8)
    ax.grid(False)
    ax.set_title(f"{plant.NAME}: right on {sum(row['right'] for row in some)} of {len(some)} logs with one effect or none")
    ax.set_xlabel("answer: what is named first, or the verdict (number of logs)")
    ax.set_ylabel("true effect (logs)")
    plots.save(figure, out / f"blind_{plant.NAME}.png")


def _answer(row):
    return row["named"][0] if row["named"] else row["verdict"]


def again(work):
    """Scores stored reports again: python -m tinykoop.blind.own.campaign build/out/blind_car."""
    import json

    labels = json.loads((work / "labels.json").read_text())
    seal = json.loads((work / "seal.json").read_text())
    if score.digest(work / "labels.json") != seal["sha256"]:
        raise UserError(f"{work / 'labels.json'}: its SHA-256 is not the sealed one; the labels were changed")
    rows = [{"log": name} | row_of(label, json.loads((work / "reports" / f"{name}.json").read_text())) for name, label in labels.items()]
    report(ROBOTS[work.name.removeprefix("blind_")], rows)
    return rows


if __name__ == "__main__":
    again(Path(sys.argv[1]))
