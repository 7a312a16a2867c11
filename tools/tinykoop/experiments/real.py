"""Real logs: float32, the gate and the diagnoser on robots that have no simulator here.

Each log is replayed through the eleven methods; drives are diagnosed as well. The logs are not part of the project.
"""

import json
from pathlib import Path

import numpy as np

from .. import diagnose, platforms
from ..logs import replay
from ..plumbing import pages
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, write_json


def logs(places):
    """The logs that are named and those in the folders that are named, without the files that go with a log."""
    found = [path for place in map(Path, places) for path in (sorted(place.glob("*.csv")) if place.is_dir() else [place])]
    found = [path for path in found if not path.stem.endswith("_aux")]
    if not found:
        raise UserError(f"{', '.join(map(str, places))}: no log there; name .csv files or folders that hold them")
    return found


def diagnosed(path, out):
    """A row of real.json: the verdict on one drive, and what the best fit does."""
    folder = output_folder(out / "real" / path.stem)
    diagnose.run(str(path), folder, robot="ddr")
    report = json.loads((folder / "report.json").read_text())
    fit = report["effects"] or report.get("best_fit") or []
    return {"log": path.stem, "verdict": report["verdict"], "fit": [effect["name"] for effect in fit], "gap": report["gap"]}


def ratios(rows):
    """[error behind the gate / without it] of the methods of one replay, square-root form in float32."""
    found = []
    for _, variants in replay.by_method(rows):
        plain, gated = (variants.get(("sqrt", 32, gate)) for gate in (False, True))
        found += [gated["mean_error"] / plain["mean_error"]] if gated else []
    return found


def replay_page(rows):
    """The table of docs/learning.md: one log, every method."""
    lines, steps = [], next(row["steps"] for row in rows if "steps" in row)
    for name, variants in replay.by_method(rows):
        reference = variants.get(("sqrt", 64, False)) or variants[None]
        plain, root = (variants.get((form, 32, False)) for form in ("plain", "sqrt"))
        apart = [number(v["mean_error"] / reference["mean_error"]) if v else "-" for v in (plain, root)]
        lost = [number(plain["lost_positive_definite_at"]), f"{plain['refused']:,}"] if plain else ["-", "-"]
        lines.append([name, number(reference["mean_error"]), *apart, *lost])
    headers = ["method", "error, float64", "plain float32 / float64", "square-root float32 / float64", "plain: P lost at row", "refused"]
    return pages.table(f"Replay of `{rows[0]['source']}`, {steps:,} steps scored: mean one-step error", headers, lines)


def _float32(rows):
    """(methods in all, those whose error grows in plain float32, those whose P is lost there, largest growth in square-root form)."""
    methods = [variants for _, variants in replay.by_method(rows) if ("plain", 32, False) in variants]
    reference, plain, root = ([v[key] for v in methods] for key in (("sqrt", 64, False), ("plain", 32, False), ("sqrt", 32, False)))
    grown = sum(not p["mean_error"] <= replay.DIVERGED * r["mean_error"] for p, r in zip(plain, reference))
    lost = sum(p["lost_positive_definite_at"] is not None for p in plain)
    return len(methods), grown, lost, max(q["mean_error"] / r["mean_error"] for q, r in zip(root, reference))


def float32_page(replays):
    """The table of docs/learning.md: what float32 does on every log."""
    lines = []
    for rows in replays:
        methods, grown, lost, worst = _float32(rows)
        steps = next(row["steps"] for row in rows if "steps" in row)
        lines.append([f"`{rows[0]['source']}`", f"{steps:,}", methods, grown, lost, f"{worst:.3f}"])
    headers = [
        "log",
        "steps scored",
        "methods",
        f"plain: error over {replay.DIVERGED} times as large",
        "plain: P lost",
        "square root: error, max ratio",
    ]
    return pages.table("`make real`: float32 against float64", headers, lines)


def gate_page(replays):
    """The table of docs/assurance.md: the gate on all logs."""
    trust = [row["trust"] for rows in replays for row in rows if row.get("trust")]
    grown = np.array([ratio for rows in replays for ratio in ratios(rows)])
    pairs = [("logs", len(replays)), ("logs times methods", len(grown))]
    for name in ("doubtful", "refuse"):
        share = 100 * np.array([t[name] for t in trust])
        pairs += [
            (f"samples called {name}, median (%)", number(float(np.median(share)), 2)),
            ("the same, max (%)", number(float(share.max()), 2)),
        ]
    pairs += [
        ("one-step error with the gate over that without, median", f"{np.median(grown):.3f}"),
        ("at most 1.1 times as large, of these", int(np.sum(grown <= 1.1))),
        ("the same, max", f"{grown.max():.2f}"),
    ]
    return pages.facts("`make real`: the gate on real logs", pairs)


def gap_page(rows):
    """The table of docs/diagnose.md: real drives."""
    lines = []
    for row in rows:
        before, closed = row["gap"]["before"]["50"], row["gap"]["closed_fraction"]["50"]
        lines.append(
            [
                f"`{row['log']}`",
                row["verdict"],
                ", ".join(row["fit"]) or "-",
                number(before, 2),
                number(None if closed is None else round(100 * closed)),
            ]
        )
    headers = ["log", "verdict", "effects, or the best fit", "error 50 steps ahead (m)", "closed (%)"]
    return pages.table("`make real`: drives of others", headers, lines)


def run(out, data, update=False):
    """Writes real.json into `out`, beside replays and reports, and with `update` tables of docs/; returns (replays, rows)."""
    out, found = output_folder(out), logs(data)
    replays = [replay.run_log(path, out) for path in found]
    rows = [diagnosed(path, out) for path in found if platforms.of_log(path) == "ddr"]
    write_json(out / "real.json", rows)
    if update:
        worst = max(replays, key=lambda rows: _float32(rows)[1])
        pages.update("docs/learning.md", "replay", float32_page(replays) + "\n" + replay_page(worst))
        pages.update("docs/assurance.md", "gate", gate_page(replays))
        pages.update("docs/diagnose.md", "real", gap_page(rows))
    return replays, rows
