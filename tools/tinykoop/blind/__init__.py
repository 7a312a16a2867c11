"""The diagnoser on generated logs with sealed labels.

Logs come from a plant of their own (`plant`, `drives`, `tiers`). The labels are written and sealed first; then every
log is diagnosed in a process that sees nothing but the log and a fresh log, and `score` compares report and label.

    blind/labels.json      the truth
    blind/seal.json        SHA-256 of the labels, seed, logs per tier, who diagnoses
    blind/logs, fresh      contract CSVs under shuffled numbers
    blind/reports/WHO      one file per log: report, exit status, seconds of processor time
    blind.json             the figures, written last: a run that was killed leaves none
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from .. import bridge
from ..plumbing.errors import UserError
from ..plumbing.results import alone, console, output_folder, remove, write_json
from ..plumbing.workers import each, workers

N, SEED = 20, 1
SHORT = 900  # rows at most, with one log per tier: that shows that all of it runs, and takes little time
TIMEOUT = 600  # s, of one diagnosis
TOOLS = Path(__file__).resolve().parents[2]
DIAGNOSE = (sys.executable, "-m", "tinykoop.cli", "diagnose")


# ---- who diagnoses -------------------------------------------------------------------------------


class Command:
    """diagnoser(log, fresh, without=(..)) -> report, by a command line in a process of its own."""

    def __init__(self, command=DIAGNOSE):
        self.command = [str(part) for part in command]

    def __call__(self, log, fresh, without=()):
        out = Path(log).parent / "out"
        taken = [part for name in without for part in ("--without", name)]
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(TOOLS)}
        done = subprocess.run(
            [*self.command, str(log), *(("--fresh", str(fresh)) if fresh else ()), "--out", str(out), *taken], env=environment,
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=TIMEOUT,
        )  # fmt: skip
        if done.returncode != 0:
            raise RuntimeError(f"exit status {done.returncode}: {done.stderr.strip()[-2000:]}")
        return json.loads((out / "report.json").read_text())


def others():
    """{name: callable(log, fresh, without=()) -> what report.json holds} of the methods compared with; {} without any."""
    try:
        from .peers import PEERS
    except ImportError as error:
        console.print(f"No peers are compared with: {error}")
        return {}
    return PEERS


def _processor():
    """Seconds of processor time of this process and those that it has waited for: other work on the machine does not count."""
    return sum(os.times()[:4])


def diagnose(key, diagnoser, log, fresh, without):
    """(key, run) of one log, given as bytes so that a cluster needs no shared folder. fresh may be None. Nothing is raised."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name if data else None for name, data in (("log.csv", log), ("fresh.csv", fresh))]
        for path, data in zip(paths, (log, fresh)):
            if path:
                path.write_bytes(data)
        report, error, start = None, None, _processor()
        try:
            report = diagnoser(*paths, without=tuple(without))
        except Exception as reason:  # of whatever kind: it is counted and listed
            error = f"{type(reason).__name__}: {reason}"
        return key, {"report": report, "error": error, "seconds": _processor() - start}


def _draw(tier, seed, k, most):
    from . import tiers

    return (tier, k), tiers.draw(tier, seed, k, most)


def _write(path, x, u, columns, dt):
    from . import odometry

    bridge.write_log(path, x, u, dt)
    if columns:
        odometry.append(path, columns)


# ---- a campaign ----------------------------------------------------------------------------------


def _empty(work):
    """The folder of the campaign, made empty; only what an earlier one left is removed."""
    if work.exists() and any(work.iterdir()) and not (work / "labels.json").exists():
        raise UserError(f"{work}: is not the folder of a blind evaluation; move it or choose another --out")
    shutil.rmtree(work, ignore_errors=True)
    return output_folder(work)


def generate(out, n, seed, diagnosers, which=None):
    """Draws the logs, writes and seals the labels, then writes the logs; returns {log: label}."""
    from . import score, tiers

    remove(out / "blind.json")
    work = _empty(out / "blind")
    most = SHORT if n == 1 else 10**6
    wanted = [(tier, seed, k, most) for tier in which or tiers.TIERS for k in range(n)]
    drawn = dict(each(_draw, wanted, "drawing logs"))
    numbers = np.random.default_rng(seed).permutation(len(wanted))
    logs = {f"{number:04d}": drawn[tier, k] for number, (tier, _, k, _) in sorted(zip(numbers, wanted))}
    write_json(work / "labels.json", {name: label for name, (label, _, _) in logs.items()})
    seal = {"sha256": score.digest(work / "labels.json"), "seed": seed, "n": n, "diagnosers": list(diagnosers)}
    write_json(work / "seal.json", seal)
    console.print(f"{len(logs)} logs, seed {seed}. The labels are sealed: SHA-256 {seal['sha256']}", soft_wrap=True)
    for name, (label, *recordings) in logs.items():
        for folder, recording in zip(("logs", "fresh"), recordings):
            _write(output_folder(work / folder) / f"{name}.csv", *recording, label["dt"])
    return {name: label for name, (label, _, _) in logs.items()}


def _known(which, there):
    strange = [tier for tier in which or () if tier not in there]
    if strange:
        raise UserError(f"--tier {strange[0]}: no such tier; there are {', '.join(there)}")


def run(out, n=N, seed=SEED, cluster=None, jobs=None, which=None, diagnosers=None, update=False, peers=True):
    """Writes blind.json and its plots into `out`, and with `update` docs/diagnose.md; returns the results.

    which: tiers, all if None; peers: whether other methods are asked, too.
    """
    from . import draw, page, score, tiers

    if n < 1 or seed < 0:
        raise UserError(f"{n} logs per tier with seed {seed}: at least 1 is needed, and a seed that is not negative")
    if which and update:
        raise UserError("--update: the table needs every tier; leave out --tier")
    out = output_folder(out)
    _known(which, tiers.TIERS)
    diagnosers = {score.OURS: Command()} | (others() if peers else {}) if diagnosers is None else diagnosers
    work = out / "blind"
    with alone(out / "blind.json"), workers(cluster, jobs):
        labels = generate(out, n, seed, diagnosers, which)
        for who, diagnoser in diagnosers.items():
            calls = [
                (name, diagnoser, *((work / folder / f"{name}.csv").read_bytes() for folder in ("logs", "fresh")),
                 label["without"])
                for name, label in labels.items()
            ]  # fmt: skip
            folder = output_folder(work / "reports" / who)
            # the first one alone: what a diagnoser prepares and keeps is then there for the others
            for first in (calls[:1], calls[1:]):
                for name, result in each(diagnose, first, who):
                    write_json(folder / f"{name}.json", result)
        results = score.run(out, draw.run)
    if update:
        page.drives(results)
    return results
