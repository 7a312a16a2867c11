"""Several logs of one robot, each diagnosed by itself in one of some processes, and one table of all."""

import io
import json
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import chdir, redirect_stderr, redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from threading import Lock

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
    """(log, report or None, what was said) of one log; folder: where paths begin, wherever the process is. Nothing is raised."""
    said, report = io.StringIO(), None
    with _one_at_a_time, chdir(folder), redirect_stdout(io.StringIO()), redirect_stderr(said):
        try:
            diagnose.run(log, out, **options)
            report = json.loads((Path(out) / "report.json").read_text())
        except UserError as error:
            said.write(str(error))
        except Exception as error:  # of whatever kind: the other logs go on
            said.write(f"{log}: {type(error).__name__}: {error}")
    return log, report, said.getvalue().strip()


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
            return call[0], None, f"{call[0]}: its process was ended, as by the system when memory is short; diagnose this log alone"


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
    """[(log, its report)], each also under `out`, and all in diagnoses.json; options: the other arguments of diagnose.run()."""
    out, found = output_folder(out), {}
    with workers(cluster, jobs):
        for log, report, said in _all([(log, out / name, Path.cwd(), options) for log, name in zip(logs, names(logs))]):
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
