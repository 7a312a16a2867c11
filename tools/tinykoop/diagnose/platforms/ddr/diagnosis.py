"""One drive in, one answer out."""

import numpy as np

from .... import bridge
from ....plumbing.errors import UserError
from ...diagnosis import Diagnosis, check_on_fresh, contributions, open_questions, report_of, told
from ...elsewhere import as_fast, joined, seconds
from ...links import tagged
from ...prediction_errors.answer import answer
from ...prediction_errors.fit import ALWAYS
from ...prediction_errors.search import Search
from ...robot import check_effects
from . import advise, links, odometry, standing, where
from .path import Path, name
from .path import effects as library

FEWEST_ROWS, FEWEST = 60, 6  # usable transitions of a log, and in a row
SAME_RATE = 0.02  # by which logs of one robot may differ in their step of time


def load(path):
    """A log that is long enough to say something about."""
    log = bridge.read_log(path, name)
    log.extra = bridge.read_columns(path, odometry.COLUMNS)
    if log.usable.sum() < FEWEST_ROWS:
        raise UserError(f"{path}: {int(log.usable.sum())} usable transitions are too few for a diagnosis; record {FEWEST_ROWS} at least")
    if _longest(log.usable) < FEWEST:
        raise UserError(f"{path}: nowhere are {FEWEST} rows in a row usable; record it with fewer gaps")
    if not np.any(np.abs(np.diff(log.x, axis=0)) > 0):
        raise UserError(f"{path}: the pose never changes; record a drive in which the robot moves")
    return log


def read(path, fresh=None, healthy=(), robot=name, sim=None):
    """(the log, what diagnose() takes beside it)."""
    return load(path), {"fresh": load(fresh) if fresh else None, "healthy": [load(file) for file in healthy]}


def _longest(usable):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]]))).reshape(-1, 2)
    return int((edges[:, 1] - edges[:, 0]).max(initial=0))


def _healthy(logs, log):
    """Causes that explain logs of the healthy robot, as they act on another log: what came or went there is none of them."""
    if not logs:
        return ()
    if max(abs(other.dt / log.dt - 1) for other in logs) > SAME_RATE:
        raise UserError(f"--healthy: rows come every {logs[0].dt:.4g} s there and every {log.dt:.4g} s in the log; give logs of one rate")
    (x, u), usable = joined(logs, "xu")
    whole = bridge.Log(np.arange(len(x)) * log.dt, x, u, usable, log.dt)
    path = Path(whole)
    causes = [cause for cause in Search(path).run().causes if cause.segments == ALWAYS]
    return tuple(as_fast(c, path.effects[c.name].parameters, *map(seconds, (whole, log))) for c in causes)


def path_of(log, without=(), healthy=()):
    """The Path of a log beside what healthy logs have."""
    return Path(log, without, base=_healthy(healthy, log))


def diagnose(log, fresh=None, without=(), healthy=(), seed=0):
    """The Diagnosis of a log (bridge.Log).

    fresh: another log of the robot, on which nothing is fitted; healthy: logs of the healthy robot, from which on a change counts.
    """
    speeds, ignored = odometry.read(log)
    check_effects(without, (*library(log.u), standing.EFFECT))
    dead = None if standing.EFFECT in without else links.dead(log, speeds)
    if dead:
        return standing.diagnosis(log, dead, speeds, fresh)
    path = path_of(log, without, healthy)
    found = answer(path)
    pairs, hidden = open_questions(found)
    advice = advise.advise(path, found.fitter, pairs, hidden)
    report = {"platform": name} | report_of(found, where.located(found), hidden, seed=seed) | {
        "healthy": {"logs": len(healthy), "effects": [told(path, cause) for cause in path.base]},
        "contributions": contributions(found),
        "integrator": path.variants[path.variant],
        "suggested_excitation": f"{advice[0]}: {advice[1]}" if advice else "",
        "advice": {"drive": advice[0], "words": advice[1], "separation": advice[3]} if advice else None,
    }  # fmt: skip
    if found.verdict == "none":
        report["ranking"].insert(0, {"name": "measurement_noise", "score": 1.0})
    if len(path.rows) < len(log.x):
        report["log"]["searched_rows"] = len(path.rows)
    if speeds:
        report["where"]["links"] = links.diagnosed(found, speeds)
        report["effects"] = tagged(report["effects"], report["where"]["links"])
    if ignored:
        report["log"]["ignored"] = ignored
    result = Diagnosis(report, found, {"drive": advice[2] if advice else None})
    if fresh is not None:
        check_on_fresh(result, Path(fresh, variant=path.variant, base=path.base))
    return result
