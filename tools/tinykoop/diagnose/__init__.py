"""The sim-to-real gap of one log: where it lies, which unmodelled effect causes it, how far it shrinks.

Data flow: platforms (a log as the engine takes it) -> prediction_errors (the engine: noise, search, verdict, gap) -> diagnosis (the
report) -> report (what people read: a story, on the terminal and as a page).
"""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

from ..platforms import of_log
from ..plumbing.errors import UserError
from ..plumbing.results import busy, output_folder, printable, replacing, write_bytes
from . import recording
from .report.html import html
from .report.story import Teller
from .report.terminal import say, show
from .robots import is_own, platform_of


def platform(robot):
    """The module of a platform, or that of your own robots: it has read(), diagnose() and Teller."""
    return import_module(f".platforms.{'own' if is_own(robot) else platform_of(robot)}", __package__)


def predicts(robot, option):
    """Refuses an option that needs predictions row by row, of a platform that has averages of the flight instead."""
    if not hasattr(platform(robot), "path_of"):
        raise UserError(f"{option}: not for a {robot}, whose flights are compared by their averages; leave it out")


def _diagnosed(path, fresh, robot, without, healthy, sim):
    """(Diagnosis, its Story, seconds of the log's first row)."""
    if sim and not (robot and is_own(robot)):
        raise UserError("--sim: only for your own robot; add --robot ROBOT.toml, which describes its columns")
    robot = of_log(path) if robot is None else robot
    kind = platform(robot)
    log, options = kind.read(path, fresh, healthy, robot, sim)
    result = kind.diagnose(log, without=without, **options)
    result.report = {"log_file": printable(path), "fresh_file": printable(fresh) if fresh else None, **result.report}
    return result, kind.Teller(result).story(), float(log.t[0])  # seconds of the story count from the first row


def diagnose_log(path, robot=None, fresh=None, without=(), healthy=(), sim=None):
    """Diagnoses a log file and returns what report.json holds, as a dict; writes nothing. For the arguments see run()."""
    result, _, t0 = _diagnosed(path, fresh, robot, without, healthy, sim)
    return in_log_time(result.report, t0)


class _Callable(ModuleType):
    """`tinykoop.diagnose(log, robot)` is diagnose_log(), although the module has this name, too."""

    def __call__(self, log, robot=None, **options):
        return diagnose_log(log, robot, **options)


sys.modules[__name__].__class__ = _Callable


def run(path, out, fresh=None, robot=None, without=(), healthy=(), sim=None, mcap=None):
    """Diagnoses a log file; writes report.json and report.html to `out` and prints the summary.

    robot: a platform, or your own TOML file; without it the columns tell the platform. fresh: another log of the robot, to
    validate the result on. without: names of effects that the robot cannot have. healthy: logs of the healthy or earlier robot. sim:
    with a TOML file, a run of the simulator under the log's commands. mcap: also what was measured
    and predicted, into this file. Returns an object whose `report` is what report.json holds.
    Raises UserError if an input is bad.
    """
    if mcap:
        predicts(robot or of_log(path), "--mcap")
        recording.prepare(mcap)
    with busy(f"diagnosing {Path(path).name}"):
        result, told, t0 = _diagnosed(path, fresh, robot, without, healthy, sim)
        out = output_folder(out)
    with replacing(out / "report.json", in_log_time(result.report, t0)):
        write_bytes(out / "report.html", html(told))
    show(told, out / "report.html")
    if mcap:
        recording.write(result, mcap)
    return result


def exceeds(report, limit, log=""):
    """Whether the simulator's error at the longest horizon is larger than the limit, if there is one; says so."""
    gap, key, unit = report["gap"]["before"], Teller.horizon(report["gap"]), report["gap"]["unit"]
    if limit is None or (key and gap[key] <= limit):
        return False
    of = f"{printable(log)}: " if log else ""
    said = f"The gap is {gap[key]:.3g} {unit} {key} steps ahead, more than {limit:g} {unit}." if key else "The gap could not be measured."
    say(f"{of}{said}")
    return True


def in_log_time(report, t0):
    """The report with segments in the log's own time, which need not begin at zero."""
    shift = lambda segments: [[a + t0, b + t0, *share] for a, b, *share in segments]  # noqa: E731
    kinds = [kind for kind in ("effects", "best_fit", "small") if kind in report]
    moved = lambda effects: [effect | {"segments": shift(effect["segments"])} for effect in effects]  # noqa: E731
    where = report["where"] | {"segments": shift(report["where"]["segments"])}
    if "links" in where:
        where["links"] = [link | {"effects": moved(link["effects"])} for link in where["links"]]
    return report | {kind: moved(report[kind]) for kind in kinds} | {"where": where}
