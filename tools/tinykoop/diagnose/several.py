"""Several logs of one robot, each diagnosed in a process of its own, and one table of all."""

import json
import subprocess
import sys
from pathlib import Path

from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, write_json
from ..plumbing.workers import each, workers
from .report import words
from .report.story import Teller


def _diagnosed(command, log, out, folder):
    """(log, report or None, what was said) of one log; folder: where paths begin, wherever the process is."""
    done = subprocess.run([*command, str(log), "--out", str(out)], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    report = json.loads((folder / out / "report.json").read_text()) if done.returncode == 0 else None
    return log, report, done.stderr.strip()


def names(logs):
    """What each log is called: different from the others."""
    stems = [Path(log).stem for log in logs]
    return [stem if stems.count(stem) == 1 else f"{i + 1}-{stem}" for i, stem in enumerate(stems)]


def _line(log, report):
    effects = "; ".join(f"{e['name']} {', '.join(f'{k} {v:.3g}' for k, v in e['params'].items())}" for e in report["effects"])
    gap = report["gap"]
    last = Teller.horizon(gap)
    before, after, closed = (gap[part][last] if last else None for part in ("before", "after", "closed_fraction"))
    sizes = (words.plain(words.real(value), 3) for value in (before, after))
    return Path(log).name, report["verdict"], effects or "-", *sizes, words.percent(closed)


def run(logs, out, options, jobs=None, cluster=None):
    """[(log, its report)], each also under `out`, and all in diagnoses.json; options: the other arguments of `tinykoop diagnose`."""
    out = output_folder(out)
    command = (sys.executable, "-m", "tinykoop.cli", "diagnose", *options)
    with workers(cluster, jobs):
        found = {}
        for log, report, said in each(_diagnosed, [(command, log, out / name, Path.cwd()) for log, name in zip(logs, names(logs))], "logs"):
            found[str(log)] = (report, said)
    write_json(out / "diagnoses.json", [{"log": str(log), "report": found[str(log)][0], "error": found[str(log)][1]} for log in logs])
    good = [(log, found[str(log)][0]) for log in logs if found[str(log)][0]]
    print_table(
        f"{len(good)} of {len(logs)} logs; errors at the longest horizon",
        ("log", "verdict", "effects", "before", "after", "closed"), [_line(*pair) for pair in good],
    )  # fmt: skip
    if len(good) < len(logs):
        raise UserError("\n".join(found[str(log)][1] or f"{log}: failed" for log in logs if not found[str(log)][0]))
    return good
