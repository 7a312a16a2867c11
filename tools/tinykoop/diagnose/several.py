"""Several logs of one robot, each diagnosed by itself in one of some processes, and one table of all."""

import io
import json
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import chdir, redirect_stderr, redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from threading import Lock
from time import process_time

from .. import diagnose
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, write_json
from ..plumbing.workers import each, workers
from .report import words
from .report.story import Teller

_one_at_a_time = Lock()  # a Dask worker may have threads, which share a folder and a terminal


def files(paths):
    """Logs: a folder stands for the CSV files in it, in the order of their names."""
    found = []
    for path in map(Path, paths):
        inside = sorted(path.glob("*.csv")) if path.is_dir() else [path]
        if not inside:
            raise UserError(f"{path}: no CSV file is in this folder; give the folder of the logs")
        found += inside
    return found


def _diagnosed(log, out, folder, options):
    """(log, report or None, what was said, s of processor time) of one log, wherever the process is. Nothing is raised.

    folder: where paths begin; the time is without that of loading the packages, which a process does once.
    """
    said, report, start = io.StringIO(), None, process_time()
    with _one_at_a_time, chdir(folder), redirect_stdout(io.StringIO()), redirect_stderr(said):
        try:
            diagnose.run(log, out, **options)
            report = json.loads((Path(out) / "report.json").read_text())
        except UserError as error:
            said.write(str(error))
        except Exception as error:  # of whatever kind: the other logs go on
            said.write(f"{log}: {type(error).__name__}: {error}")
    return log, report, said.getvalue().strip(), process_time() - start


def _all(calls):
    """Results of _diagnosed(), as they come. A process that dies takes others with it: what is missing then has a process of its own."""
    missing = {str(call[0]): call for call in calls}
    try:
        for found in each(_diagnosed, calls, "logs"):
            del missing[str(found[0])]
            yield found
    except Exception:  # the workers' own: _diagnosed() raises nothing
        for call in missing.values():
            yield _by_itself(call)


def _by_itself(call):
    with ProcessPoolExecutor(1, get_context("spawn")) as process:
        try:
            return process.submit(_diagnosed, *call).result()
        except BrokenProcessPool:
            return call[0], None, f"{call[0]}: its process was ended, as by the system when memory is short; diagnose this log alone", None


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


def diagnosed(logs, out, options, jobs=None, cluster=None):
    """[{"log", "report", "error", "seconds" of processor time}] of each log, in diagnoses.json too; options: as diagnose.run() takes them."""
    out, found = output_folder(out), {}
    with workers(cluster, jobs):
        for log, *rest in _all([(log, out / name, Path.cwd(), options) for log, name in zip(logs, names(logs))]):
            found[str(log)] = dict(zip(("report", "error", "seconds"), rest))
    entries = [{"log": str(log)} | found[str(log)] for log in logs]
    write_json(out / "diagnoses.json", entries)
    return entries


def run(logs, out, options, jobs=None, cluster=None):
    """[(log, its report)], each also under `out`, and a table of all; for the arguments see diagnosed()."""
    entries = diagnosed(logs, out, options, jobs, cluster)
    good = [(log, entry["report"]) for log, entry in zip(logs, entries) if entry["report"]]
    print_table(
        f"{len(good)} of {len(logs)} logs; errors at the longest horizon",
        ("log", "verdict", "effects", "before", "after", "closed"), [_line(*pair) for pair in good],
    )  # fmt: skip
    if len(good) < len(logs):
        raise UserError("\n".join(entry["error"] or f"{entry['log']}: failed" for entry in entries if not entry["report"]))
    return good
