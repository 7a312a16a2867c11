"""The diagnoser on simulated flapping-wing flights with sealed labels: drawn, sealed, diagnosed, scored.

The vehicle is the simulator's own with effects switched on, so these are the best of conditions: what cannot be told here
cannot be distinguished from a real flight either. Magnitudes are 0.7 to 1.5 times the usual ones, of either sign where an effect has two.

    blind_fwmav/labels.json      the truth, with its SHA-256 in seal.json, written before any diagnosis
    blind_fwmav/logs, reports
    blind_fwmav.json             figures and rows, written last
"""

import numpy as np

from .. import bridge
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import alone, console, output_folder, print_table, remove, replacing, write_json
from ..plumbing.workers import each, workers
from . import DIAGNOSE, Command, _empty, diagnose, page, score

TIERS = {
    "none": "none: healthy",
    "single": "one, throughout",
    "switch": "one, from some time on",
    "pair": "two, throughout",
    "left_out": "one, not in the library",
}
MANOEUVRES = ("hover", "pitch", "yaw")
SECONDS = 40
ALL_ALONG = ("delay", "lag", "gain", "trim_bias", "battery_sag", "asymmetry", "damping", "vibration", "gyro_bias")
FROM_THEN_ON = (*ALL_ALONG, "gust")
LEAST, MOST = 0.7, 1.5  # times the usual
TRIES = 20


def _drawn(random, name, t0=0.0):
    rows = bridge.effects("fwmav")[name][1]
    signed = all(row[2] < 0 < row[3] for row in rows)
    sizes = [row[4] * random.uniform(LEAST, MOST) * (random.choice((-1, 1)) if signed else 1) for row in rows]
    return bridge.Effect(name, tuple(float(np.clip(v, row[2], row[3])) for v, row in zip(sizes, rows)), float(t0), float("inf"))


def draw(tier, seed, k):
    """(label, log) of the k-th flight of a tier; drawn again if the vehicle tumbles."""
    for attempt in range(TRIES):
        random = np.random.default_rng([seed, list(TIERS).index(tier), k, attempt])
        manoeuvre = MANOEUVRES[k % 3]
        names = {"none": (), "pair": random.choice(ALL_ALONG, 2, replace=False), "switch": (FROM_THEN_ON[k % len(FROM_THEN_ON)],)}
        names = names.get(tier, (ALL_ALONG[k % len(ALL_ALONG)],))
        t0 = random.uniform(0.25, 0.6) * SECONDS if tier == "switch" else 0.0
        active = [_drawn(random, str(name), t0) for name in names]
        try:
            log, _ = bridge.fwmav(manoeuvre, SECONDS, int(random.integers(2**31)), active)
        except UserError:
            continue
        if np.abs(log.x[:, 6:8]).max() < 1.0:
            label = {
                "tier": tier,
                "manoeuvre": manoeuvre,
                "effects": [{"name": e.name, "parameters": e.parameters, "t0": e.t0} for e in active],
            }
            return label | {"without": [e.name for e in active] if tier == "left_out" else []}, log
    raise UserError(f"seed {seed}, {tier} {k}: no flight of {TRIES} stays in the air")


def _row(label, run):
    """What the score needs of one label and report."""
    report, truth = run["report"], label["effects"]
    names = [e["name"] for e in truth]
    row = {"tier": label["tier"], "manoeuvre": label["manoeuvre"], "truth": names, "seconds": run["seconds"], "error": run["error"]}
    if report is None:
        return row | {"verdict": "failed", "named": [], "right": False}
    found = {e["name"]: e for e in report["effects"]}
    named = list(found)
    allowed = [{name, *report["ambiguous_with"].get(name, ())} for name in named]
    testable = [name for name in names if name in found or name not in report["not_testable"]]
    fits = len(named) == len(testable) and all(any(name in a for a in allowed) for name in testable)
    row |= {
        "verdict": report["verdict"],
        "named": named,
        "not_testable": report["not_testable"],
        "right": sorted(named) == sorted(names) and report["verdict"] == ("known" if names else "none"),
        "held": fits and len(testable) == len(names),
        "held_but": fits,
        "confidence": {name: e["confidence"] for name, e in found.items()},
    }
    for e in truth:
        if e["name"] in found:
            got = found[e["name"]]
            usual = [abs(r[4]) for r in bridge.effects("fwmav")[e["name"]][1]]
            errors = [abs(a - b) / c for a, b, c in zip(got["params"].values(), e["parameters"], usual)]
            inside = [low <= b <= high for (low, high), b in zip(got["params_ci95"].values(), e["parameters"])]
            row |= {"error_of_usual": max(errors), "inside_ci95": inside, "edge_error": abs(got["segments"][0][0] - e["t0"])}
    return row


def run(out, n, seed, cluster=None, jobs=None, update=False):
    """Writes blind_fwmav.json and its plot, and with `update` the table of docs/flapping-wing.md; returns the rows."""
    if n < 1 or seed < 0:
        raise UserError(f"{n} flights per tier with seed {seed}: at least 1 is needed, and a seed that is not negative")
    out = output_folder(out)
    with alone(out / "blind_fwmav.json"):
        rows = _campaign(out, n, seed, cluster, jobs)
    if update:
        page.flights(rows, n, seed)
    return rows


def _campaign(out, n, seed, cluster, jobs):
    remove(out / "blind_fwmav.json")
    work = _empty(out / "blind_fwmav")
    wanted = [(tier, k) for tier in TIERS for k in range(n)]
    drawn = [draw(tier, seed, k) for tier, k in wanted]
    order = np.random.default_rng(seed).permutation(len(drawn))
    flights = {f"{i:04d}": drawn[j] for i, j in enumerate(order)}
    write_json(work / "labels.json", {name: label for name, (label, _) in flights.items()})
    write_json(work / "seal.json", {"sha256": score.digest(work / "labels.json"), "seed": seed, "n": n})
    console.print(
        f"{len(flights)} flights, seed {seed}. The labels are sealed: SHA-256 {score.digest(work / 'labels.json')}", soft_wrap=True
    )
    logs, reports = output_folder(work / "logs"), output_folder(work / "reports")
    for name, (_, log) in flights.items():
        bridge.write_log(logs / f"{name}.csv", log.x, log.u, log.dt, "fwmav")
    command = Command((*DIAGNOSE, "--platform", "fwmav"))
    runs = {}
    with workers(cluster, jobs):
        calls = [(name, command, (logs / f"{name}.csv").read_bytes(), None, label["without"]) for name, (label, _) in flights.items()]
        for name, result in each(diagnose, calls, "flights"):
            write_json(reports / f"{name}.json", result)
            runs[name] = result
    rows = [{"log": name} | _row(label, runs[name]) for name, (label, _) in flights.items()]
    report(rows)
    with replacing(out / "blind_fwmav.json", rows):
        draw_confusion(out, rows)
    return rows


def report(rows):
    """The table of tiers."""
    lines = []
    for tier, words in TIERS.items():
        some = [row for row in rows if row["tier"] == tier]
        count = lambda key: f"{sum(bool(row.get(key)) for row in some)}/{len(some)}"  # noqa: E731
        verdicts = [row["verdict"] for row in some]
        sure_wrong = sum(any(c > 0.9 and name not in row["truth"] for name, c in row.get("confidence", {}).items()) for row in some)
        lines.append([words, count("right"), count("held"), count("held_but"),
                      *(str(verdicts.count(v)) for v in ("known", "none", "unknown", "failed")), str(sure_wrong)])  # fmt: skip
    headers = [
        "effects",
        "right",
        "or alias",
        "or untestable",
        "known",
        "none",
        "unknown",
        "failed",
        "sure, wrong",
    ]
    note = "or alias: what the report calls ambiguous with it; or untestable: but for what the report calls that"
    print_table("Flapping wing, blind", headers, lines, note)


def draw_confusion(out, rows):
    """True effect against what is named, flights with one effect."""
    some = [row for row in rows if row["tier"] in ("single", "switch", "none")]
    names = [*FROM_THEN_ON, "none"]
    counts = np.zeros((len(names), len(names)))
    totals = np.zeros(len(names))
    for row in some:
        truth = row["truth"][0] if row["truth"] else "none"
        totals[names.index(truth)] += 1
        for name in row["named"] or ["none"]:
            counts[names.index(truth), names.index(name)] += 1
    figure, ax = plots.subplots(figsize=(7, 6))
    ax.imshow(counts / np.maximum(totals, 1)[:, None], cmap="Greys", vmin=0, vmax=1.3, aspect="auto")
    for i, j in zip(*np.nonzero(counts)):
        dark = counts[i, j] > 0.6 * totals[i]
        ax.annotate(f"{counts[i, j]:.0f}", (j, i), ha="center", va="center", color="w" if dark else "k")
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right")
    ax.set_yticks(range(len(names)), [f"{name} ({total:.0f})" for name, total in zip(names, totals)])
    ax.grid(False)
    right = sum(row["right"] for row in some)
    ax.set_title(f"Flapping wing: exactly the true effect named on {right} of {len(some)} flights")
    ax.set_xlabel("named (number of flights)")
    ax.set_ylabel("true effect (flights)")
    plots.save(figure, out / "blind_fwmav.png")
