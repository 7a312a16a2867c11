"""What a diagnosis costs where there are many: generated drives of all kinds, diagnosed as `tinykoop diagnose FOLDER` does.

fleet/logs, fleet/reports    drives, and what is said of each
fleet.json                   rows and processor time of each drive, written last
"""

from pathlib import Path

import numpy as np

from ..diagnose import several
from ..plumbing import pages
from ..plumbing.errors import UserError
from ..plumbing.results import alone, number, output_folder, print_table, remove, replacing
from ..plumbing.workers import each, workers
from . import _write, tiers

N, SEED, ROWS = 1000, 2026, 2000  # drives; of all draws; rows of a drive at most
WANTED = 10_000  # diagnoses per hour, for which cores are counted
HEADERS = ("", "value")


def _drawn(folder, k, seed, most):
    """The file of drive k: kinds take turns."""
    tier, turn = list(tiers.TIERS)[k % len(tiers.TIERS)], k // len(tiers.TIERS)
    label, recording, _ = tiers.draw(tier, seed, turn, most)
    path = Path(folder) / f"{k:05d}_{tier}.csv"
    _write(path, *recording, label["dt"])
    return str(path)


def rows_of(diagnoses):
    """[{log, rows, seconds}] of those in diagnoses.json that succeeded."""
    return [
        {"log": Path(one["log"]).stem, "rows": one["report"]["log"]["rows"], "seconds": one["seconds"]}
        for one in diagnoses
        if one["report"]
    ]


def lines(rows, n):
    """Of the table: what is counted, and its value."""
    seconds = np.array([row["seconds"] for row in rows])
    return [
        ("drives diagnosed", len(rows)),
        ("drives that failed", n - len(rows)),
        ("rows per drive, mean", round(np.mean([row["rows"] for row in rows]))),
        ("processor time per drive, mean (s)", number(float(seconds.mean()), 2)),
        ("the same, median (s)", number(float(np.median(seconds)), 2)),
        ("the same, 95 % of the drives take at most (s)", number(float(np.quantile(seconds, 0.95)), 2)),
        ("the same, max (s)", number(float(seconds.max()), 2)),
        ("drives per hour and core", round(3600 / seconds.mean())),
        (f"cores for {WANTED} drives per hour", number(float(WANTED * seconds.mean() / 3600), 2)),
    ]


def run(out, n=N, seed=SEED, cluster=None, jobs=None, update=False):
    """Writes fleet.json into `out`, and with `update` the table of docs/diagnose.md; returns the rows."""
    if n < 1 or seed < 0:
        raise UserError(f"{n} drives with seed {seed}: at least 1 is needed, and a seed that is not negative")
    out = output_folder(out)
    with alone(out / "fleet.json"):
        remove(out / "fleet.json")
        work = output_folder(out / "fleet")
        logs = output_folder(work / "logs")
        for old in logs.glob("*.csv"):
            old.unlink()
        with workers(None, jobs):
            files = sorted(each(_drawn, [(logs, k, seed, ROWS) for k in range(n)], "drawing drives"))
        rows = rows_of(several.diagnosed(files, work / "reports", {}, jobs, cluster))
        with replacing(out / "fleet.json", rows):
            pass
    title = f"`make fleet N={n} SEED={seed}`"
    print_table(title, HEADERS, [(name, str(value)) for name, value in lines(rows, n)])
    if update:
        pages.update("docs/diagnose.md", "fleet", pages.table(title, HEADERS, lines(rows, n)))
    return rows
