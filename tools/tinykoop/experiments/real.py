"""Real logs: float32, the gate and the diagnoser on robots that have no simulator here.

Each log is replayed through all methods; drives are diagnosed as well, and with simulated ones beside them settings are
chosen for them. The logs are not part of the project.
"""

import json
from pathlib import Path

import numpy as np

from .. import bridge, diagnose, platforms
from ..blind import drives, plant, tiers
from ..logs import choose, replay
from ..plumbing import pages
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, write_json

SIMULATED, SEED = 10, 2612  # drives of each kind, and the seed of all: not used while `tinykoop choose` was written
ROWS, DT = 2000, 0.05  # of the drives of one robot
ROBOT = plant.Cause("actuator_lag", {"tau": 0.3})


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


def simulated(folder):
    """({name: a drive each of several robots, which have one effect each}, {name: drives of one robot}), written into the folder."""
    kinds = {}, {}
    for k in range(SIMULATED):
        label, (x, u, _), _ = tiers.draw("single", SEED, k)
        random = np.random.default_rng([SEED, k])
        commands, _ = drives.rich(random, ROWS, DT)
        driven = plant.simulate(commands[:-1], DT, [ROBOT]) + plant.noise(random, "white", ROWS, 0.005, 0.005)
        for kind, name, drive in zip(kinds, ("robots", "one"), ((x, u, label["dt"]), (driven, commands, DT))):
            kind[f"{name}_{k}"] = folder / f"{name}_{k}.csv"
            bridge.write_log(kind[f"{name}_{k}"], *drive)
    return kinds


def _series(found):
    """{beginning of the names, up to the first _: logs}, of those that several logs have."""
    kinds = {}
    for path in found:
        kinds.setdefault(path.stem.split("_")[0], []).append(path.stem)
    return {f"`{name}_*`": stems for name, stems in kinds.items() if len(stems) > 1}


def chosen(found, out):
    """Rows of real.json: the regrets of choices of settings for these drives and simulated ones, in groups."""
    robots, one = simulated(output_folder(out / "real"))
    trials = [choose.Trial(path) for path in (*found, *robots.values(), *one.values())]
    errors, names = choose.compared(trials, choose.DICTIONARIES), [trial.name for trial in trials]
    real = [path.stem for path in found]
    groups = {"real drives": real, **_series(found), "drives of several simulated robots": [*robots],
              "all of these": [*real, *robots], "drives of one simulated robot": [*one]}  # fmt: skip
    rows = []
    for group, members in groups.items():
        of = [i for i, name in enumerate(names) if name in members]
        regrets = choose.regrets(choose.picked(errors, lambda i: i in of), [trials[i] for i in of])
        best = choose.best(choose.picked(errors, lambda i: i in of)).label
        rows.append({"group": group, "best": best, "regrets": regrets})
    return rows


def regret_page(rows):
    """The table of docs/learning.md: how much worse choices are than the best setting."""
    kinds, lines = ("others", "single", "own"), []
    for row in rows:
        figures = [[regrets[kind] for regrets in row["regrets"].values()] for kind in kinds]
        cells = [number(100 * float(figure(values))) for values in figures for figure in (np.median, np.max)]
        lines.append([row["group"], len(row["regrets"]), *cells])
    named = ("by the other logs", "one for all", "by its first half")
    headers = ["group", "logs", *(f"{name}: {figure} (%)" for name in named for figure in ("median", "max"))]
    return pages.table("`make real`: regret of a choice against the best setting of each log", headers, lines)


def run(out, data, update=False):
    """Writes real.json into `out`, beside replays and reports, and with `update` tables of docs/; returns (replays, rows)."""
    out, found = output_folder(out), logs(data)
    replays = [replay.run_log(path, out) for path in found]
    driven = [path for path in found if platforms.of_log(path) == "ddr"]
    rows, choices = [diagnosed(path, out) for path in driven], chosen(driven, out) if driven else []
    write_json(out / "real.json", [*rows, *choices])
    if update:
        worst = max(replays, key=lambda rows: _float32(rows)[1])
        pages.update("docs/learning.md", "replay", float32_page(replays) + "\n" + replay_page(worst))
        pages.update("docs/assurance.md", "gate", gate_page(replays))
    if update and driven:
        pages.update("docs/diagnose.md", "real", gap_page(rows))
        pages.update("docs/learning.md", "regret", regret_page(choices))
    return replays, rows
