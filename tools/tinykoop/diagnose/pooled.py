"""Several logs of one robot fitted together, after each was diagnosed by itself: pooled.json, and the same on the terminal."""

from pathlib import Path

from ..platforms import of_log
from ..plumbing.errors import UserError
from ..plumbing.results import busy, output_folder, print_table, write_json
from . import platform, predicts, several, standing
from .diagnosis import called, gaps, inside, limits
from .elsewhere import seconds
from .prediction_errors import judge
from .prediction_errors.fit import ALWAYS, Cause
from .prediction_errors.joint import answer
from .report import words
from .report.story import Teller
from .report.terminal import say


def check(logs, groups, robot=None):
    """Refuses logs that cannot be pooled, before the work."""
    if len(logs) < 2:
        raise UserError("--pool: one log has nothing to share; give several logs of one robot")
    if groups and len(groups) != len(logs):
        raise UserError(f"--groups: {len(groups)} labels for {len(logs)} logs; give one label for each log, in their order")
    if Path(logs[0]).exists():  # each log says by itself that it does not
        predicts(robot or of_log(logs[0]), "--pool")


def run(reports, out, groups=None, robot=None, without=(), healthy=()):
    """The content of pooled.json, which is written to `out`.

    reports: [(log file, its report)]; groups: a label for each; without it, each log is a group. Others: as diagnose.run() takes them.
    Raises UserError if the logs are not of one platform, or in one the robot does not answer.
    """
    logs, labels = [log for log, _ in reports], groups or several.names([log for log, _ in reports])
    robot = of_log(logs[0]) if robot is None else robot
    for log, report in reports:
        if report["platform"] != reports[0][1]["platform"]:
            raise UserError(f"{log}: a log of {report['platform']}, not of {reports[0][1]['platform']}; pool logs of one robot")
        if any(effect["name"] in standing.FAULTS for effect in report["effects"]):
            raise UserError(f"{log}: the robot does not answer there; leave this log out")
    members = {label: tuple(k for k, other in enumerate(labels) if other == label) for label in dict.fromkeys(labels)}
    with busy(f"fitting {len(logs)} logs together"):
        paths = [_path(log, robot, without, healthy) for log in logs]
        known = [_causes(report, path) for (_, report), path in zip(reports, paths)]
        found = answer(paths, list(members.values()), known, _alike(report for _, report in reports))
    report = {"platform": reports[0][1]["platform"], "groups": {label: [str(logs[k]) for k in some] for label, some in members.items()}}
    report |= _report(found, members, logs)
    write_json(output_folder(out) / "pooled.json", report)
    _show(report)
    return report


def _path(log, robot, without, healthy):
    kind = platform(robot)
    read, options = kind.read(log, None, healthy, robot, None)
    options.pop("fresh")
    return kind.path_of(read, without=without, **options)


def _causes(report, path):
    """Causes that a log by itself shows, or may show."""
    t0, end = float(path.log.t[0]), seconds(path.log)
    found = []
    for effect in report["best_fit"] or report["effects"]:
        segments = tuple((a - t0, b - t0) for a, b in effect["segments"])
        whole = len(segments) == 1 and segments[0][0] <= 0 and segments[0][1] >= end * (1 - 1e-9)
        name = effect.get("form", effect["name"])
        if name in path.effects:
            found.append(Cause(name, tuple(effect["params"].values()), ALWAYS if whole else segments))
    return tuple(found)


def _alike(reports):
    """{effect: names of what may be it}, in any of the logs."""
    pairs = [(name, other) for report in reports for name, others in report["ambiguous_with"].items() for other in others]
    pairs += [(other, name) for name, other in pairs]
    return {name: tuple(dict.fromkeys(other for one, other in pairs if one == name)) for name, _ in pairs}


# ---- what is reported ------------------------------------------------------------------------------------


def _report(found, members, logs):
    pool, state = found.pool, found.state
    fitter = pool.at(state)
    sizes = {
        cause: {"params": {p.name: float(v) for p, v in zip(fitter.effects[cause.name].parameters, cause.params)}, "params_ci95": interval}
        for cause, interval in zip(state.causes, limits(fitter, state.fit))
    }
    every = [_effect(joint, fitter, sizes, members, logs) for joint in found.joints]
    named = [found.verdict != "unknown" and judge.established(pool.path, joint) for joint in found.joints]
    effects = [effect for effect, sure in zip(every, named) if sure]
    told = [(effect["name"], joint, sure) for effect, joint, sure in zip(every, found.joints, named)]
    parts = zip(pool.path.paths, found.before, found.after, found.floor)
    return {
        "verdict": found.verdict,
        "effects": effects,
        "best_fit": every if len(effects) < len(every) else [],
        "ambiguous_with": {name: list(joint.others) for name, joint, _ in told if joint.others},
        "settled": {name: list(joint.settled) for name, joint, sure in told if sure and joint.settled},
        "gap": {str(log): gaps(path, *errors)["gap"] for log, (path, *errors) in zip(logs, parts)},
    }


def _effect(joint, fitter, sizes, members, logs):
    """An effect as pooled.json has it."""
    first = joint.causes[0]
    effect = fitter.effects[first.name]
    common = len(joint.causes) == 1 and len(first.logs) == len(logs)
    out = called(effect) | {
        "common": common, "evidence": joint.worth, "confidence": joint.confidence,
        "units": {p.name: p.unit for p in effect.parameters}, "formula": effect.formula,
    }  # fmt: skip
    if common:
        return out | sizes[first]
    if first.segments != ALWAYS:
        log = fitter.path.paths[first.logs[0]].log
        times = [[a + float(log.t[0]), b + float(log.t[0])] for a, b in inside(first.segments, seconds(log))]
        return out | sizes[first] | {"log": str(logs[first.logs[0]]), "segments": times}
    of = {label: next((c for c in joint.causes if set(c.logs) & set(some)), None) for label, some in members.items()}
    return out | {"per_group": {label: sizes[cause] if cause else None for label, cause in of.items()}}


# ---- what is said ----------------------------------------------------------------------------------------


def _show(report):
    logs, groups = sum(map(len, report["groups"].values())), len(report["groups"])
    effects = report["best_fit"] or report["effects"]
    say(f"\n{logs} logs in {groups} group{'s' * (groups > 1)}, fitted together: {report['verdict']}.", "bold")
    for sentence in _sentences(report):
        say(f"  {sentence}")
    if effects:
        best = "" if not report["best_fit"] else "; this is the best fit, and not all of them are established"
        print_table(f"Effects{best}", ("effect", "size", "evidence", "confidence"), [_line(effect) for effect in effects])
        headers = ("effect", "group", "parameter", "value", "95 % interval")
        print_table("Sizes", headers, [row for effect in effects for row in _rows(effect)])
    print_table(
        "Errors at the longest horizon", ("log", "before", "after", "floor", "closed"), [_gap(*pair) for pair in report["gap"].items()]
    )


def _line(effect):
    size = "common" if effect["common"] else "in a part of one log" if "log" in effect else "per group"
    return words.title(effect["name"]), size, words.plain(effect["evidence"], 3), words.plain(effect["confidence"])


def _rows(effect):
    """Of the table of sizes: a line for each parameter in each group, or in several that share it."""
    sizes = effect.get("per_group") or {Path(effect["log"]).stem if "log" in effect else "all": effect}
    alike = {}
    for group, size in sizes.items():
        alike.setdefault(str(size), ([], size))[0].append(group)
    for groups, size in alike.values():
        for name, value, interval, _ in words.parameters(effect | size) if size else [("", "absent", "", ())]:
            yield words.title(effect["name"]), ", ".join(groups), name, value, interval


def _gap(log, gap):
    last = Teller.horizon(gap)
    size = words.size_of(gap["unit"])
    sizes = (size(gap[part][last]) if last else "-" for part in ("before", "after", "noise_floor"))
    return Path(log).name, *sizes, words.percent(gap["closed_fraction"][last] if last else None)


def _sentences(report):
    """What the logs settle together, and what they leave open."""
    for name, others in report["settled"].items():
        rest = words.listed(map(words.title, others), "or")
        yield f"Together the logs show {words.title(name)}. One of them by itself could not distinguish it from {rest}."
    for name, others in report["ambiguous_with"].items():
        yield f"Even together the logs cannot distinguish {words.title(name)} from {words.listed(map(words.title, others), 'or')}."
