"""The diagnosis of your own robot: log and simulator in, where, which and how much out."""

import numpy as np

from ... import where
from ...diagnosis import Diagnosis, check_on_fresh, contributions, report_of
from ...prediction_errors import judge
from ...prediction_errors.answer import answer
from ...prediction_errors.search import Search
from ...robot import RunsAway, check_effects
from ...robots import check, toml
from ...robots.log import joined
from ...robots.log import read as read_log
from . import extras, links, standing
from .path import Path

EVERY = 4  # of the predictions tell what an effect is worth: the simulator may be slow


def read(path, fresh, healthy, robot, sim=None):
    """(the RobotLog, what diagnose() takes beside it).

    robot: a TOML file; sim: a run of the simulator under the log's commands (CSV), instead of the TOML's.
    """
    described, log = toml.read_both(robot, path, sim)
    fresh, *healthy = (read_log(file, described) if file else None for file in (fresh, *healthy))
    return log, {"robot": described, "fresh": fresh, "healthy": healthy}


def _where(found):
    """Shares of the systematic misfit by channel and time, and regions that have more than theirs."""
    path, fitter = found.path, found.search.without_motion(found.state)
    before, after = (fitter.fit_of(causes).left.reshape(path.present.shape) ** 2 for causes in ((), found.fit.causes))
    found.search.at(found.state)
    systematic = before - after if found.fit.causes else np.maximum(before - 1, 0)
    by_row = np.maximum(systematic.sum(1), 0)
    signals = zip((*path.robot.states, *path.robot.commands), (*path.X.T, *path.log.u.T))
    return {
        "channels": where.shares(path.sensors, systematic.sum(0)),
        "segments": where.parts(by_row, path.t, float(path.t[-1])),
        "regions": where.regions(by_row, {f"size of {signal.name}": (np.abs(values), signal.unit) for signal, values in signals}),
    }


def _healthy(logs, robot):
    """Causes that explain logs of the healthy robot, whichever they are."""
    if not logs:
        return ()
    for log in logs:
        check.refuse(check.mistaken(robot, log), log, robot)
    return Search(Path(robot, joined(logs))).run().causes


def _add_fields(effects, robot):
    """Where the model keeps the parameters that are wrong, and the value that they have there."""
    known = {f"parameter:{p.name}": p for p in robot.parameters}
    for effect in effects:
        if effect["name"] in known:
            effect |= {"field": known[effect["name"]].field, "value": known[effect["name"]].value}


def path_of(log, robot, without=(), healthy=()):
    """The Path of a log beside what healthy logs have."""
    given = extras.read(robot, log)
    return _path(given, without, [given.of(other) for other in healthy])


def diagnose(log, robot, fresh=None, without=(), healthy=()):
    """The Diagnosis of a RobotLog; fresh: another one, on which nothing is fitted; healthy: some, from which on a change counts."""
    given = extras.read(robot, log)
    tested, others = standing.EFFECT not in without, [name for name in without if name != standing.EFFECT]
    if tested and given.dead:
        result = standing.of_actuator(given, _where)
    else:
        path = _path(given, others, [given.of(other) for other in healthy])
        check_effects(others, path.everything)
        axes = links.dead(path, given) if tested else None
        result = standing.of_motion(given, axes, _where) if axes else _living(path, given, len(healthy))
        if fresh is not None and not axes:
            _check_on_fresh(result, given.of(fresh))
    result.report["passes"] = round((log.work.rows + given.work.rows) / (len(log.t) - 1))
    if given.ignored:
        result.report["log"]["ignored"] = given.ignored
    return result


def _path(given, without, healthy):
    """The Path of a log; a log that cannot be what the robot's file says may be why there is none."""
    robot, log = given.robot, given.log
    try:
        return Path(robot, log, without=without, before=_healthy(healthy, robot))
    except RunsAway:
        check.refuse(check.mistaken(robot, log), log, robot)
        raise


def _living(path, given, healthy):
    """The Diagnosis of a path whose links are alive; healthy: number of logs."""
    robot, log = given.robot, given.log
    check.refuse([*check.mistaken(robot, log), *check.along(path)], log, robot)
    linked = links.answered(path, given)
    path.hints = links.causes(linked, path.most_effects)
    found = answer(path)
    report = {"platform": robot.name} | report_of(found, _where(found), judge.untestable(found.search, found.fit)) | {
        "healthy": {"logs": healthy, "effects": [{"name": c.name, "params": list(c.params)} for c in path.added]},
        "time_step": {"matters": bool(path.variant), "share": path.share},
        "contributions": contributions(found, EVERY) if len(found.fit.causes) > 1 else {},
    }  # fmt: skip
    if linked:
        told = links.told(linked, found, given)
        report["where"]["links"], report["effects"] = told, links.tagged(report["effects"], told, given)
    _add_fields([*report["effects"], *report["best_fit"]], robot)
    if hasattr(robot.simulator, "surrogate"):
        report["surrogate"] = robot.simulator.surrogate
    return Diagnosis(report, found)


def _check_on_fresh(result, log):
    path = result.path
    other = Path(path.robot, log, before=path.added)
    other.step_by(path.variant)
    check_on_fresh(result, other)
