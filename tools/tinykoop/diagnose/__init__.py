"""The sim-to-real gap of one log: where it lies, which unmodelled effect causes it, how far it shrinks.

Data flow: platforms (a log as the engine takes it) -> prediction_errors (the engine: noise, search, verdict, gap) -> where, advise ->
diagnosis (the report) -> page (what people read).
"""

import sys
from pathlib import Path

from ..platforms import of_log
from ..plumbing.errors import UserError
from ..plumbing.results import busy, output_folder, printable, replacing, write_bytes
from . import page, words
from .diagnosis import diagnose, in_log_time, load
from .platforms import ddr
from .robots import is_own

__all__ = ["diagnose", "in_log_time", "load", "page", "run", "words"]


def _arguments(path, fresh, platform, without, healthy):
    """(module for this kind of log, what its diagnose() takes)."""
    if platform == "fwmav":
        from . import flight as kind

        if len(healthy) > 1:
            raise UserError("--healthy: the flapping wing is fitted to one healthy log; give the longest")
        log, fresh_log, own = (kind.load(file) if file else None for file in (path, fresh, *healthy, None)[:3])
        return kind, (log, fresh_log, without, own)
    if healthy:
        raise UserError("--healthy: only the flapping wing is fitted to a healthy log; leave it out, or add --platform fwmav")
    log, fresh_log = (load(file) if file else None for file in (path, fresh))
    return sys.modules[__name__], (log, ddr, fresh_log, without)


def run(path, out, fresh=None, robot=None, without=(), healthy=(), sim=None):
    """Diagnoses a log file; writes report.json and report.html to `out` and prints the summary.

    robot: a platform, or the TOML file of one's own; without it the columns tell the platform. sim: with a TOML file, a run of the
    simulator under the log's commands.
    """
    if sim and not (robot and is_own(robot)):
        raise UserError("--sim: only for a robot of one's own; add --robot ROBOT.toml, which says what its columns are")
    robot = of_log(path) if robot is None else robot
    if is_own(robot):
        from . import own  # scipy.signal, which it needs, takes most of a second

        return own.run(path, robot, out, fresh, without, healthy, sim)
    with busy(f"diagnosing {Path(path).name}"):
        kind, arguments = _arguments(path, fresh, robot, without, healthy)
        out = output_folder(out)
        result = kind.diagnose(*arguments)
    # page and summary count seconds from the first row
    result.report = {"log_file": printable(path), "fresh_file": printable(fresh) if fresh else None, **result.report}
    page = kind.page.html(result)
    with replacing(out / "report.json", in_log_time(result.report, float(arguments[0].t[0]))):
        write_bytes(out / "report.html", page)
    kind.words.print_summary(result.report, out / "report.html")
    return result
