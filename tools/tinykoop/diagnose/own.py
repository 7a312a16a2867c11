"""The diagnosis of a robot of one's own: log and simulator in, where, which and how much out."""

from dataclasses import dataclass
from pathlib import Path as File

import numpy as np

from ..plumbing.results import busy, output_folder, printable, replacing, write_bytes
from . import elsewhere
from .platforms.own import Path
from .prediction_errors import ahead, judge, openset
from .prediction_errors.answer import Answer, answer
from .prediction_errors.search import Search
from .report.html import html
from .report.story import story
from .report.terminal import show
from .robot import check_effects
from .robots import check, toml
from .robots.log import joined, read

BLOCKS, BINS = 8, 4  # of the time and of a signal's range
SHOWN = 1.3  # times the average, from which on a region is named


@dataclass
class Diagnosis:
    """The report, and what a page may draw."""

    report: dict
    answer: Answer

    @property
    def path(self):
        return self.answer.path


def _effects(found):
    path, out, at = found.path, [], 0
    limits, end = judge.intervals(found.fitter, found.fit), float(path.t[-1])
    for i, (cause, proof) in enumerate(zip(found.fit.causes, found.proofs)):
        effect = path.everything[cause.name]
        ends = {p.name: judge.limits(found.fitter, found.fit, i, k, at + k, limits[at + k]) for k, p in enumerate(effect.parameters)}
        at += len(effect.parameters)
        out.append(_told(effect, cause, end) | {"evidence": proof.worth, "confidence": proof.confidence, "params_ci95": ends})
    return out


def _told(effect, cause, end):
    spec = effect.parameters
    return {
        "name": cause.name, "params": {p.name: float(v) for p, v in zip(spec, cause.params)}, "units": {p.name: p.unit for p in spec},
        "segments": [[float(max(a, 0.0)), float(min(b, end))] for a, b in cause.segments], "formula": effect.formula,
    }  # fmt: skip


def _where(found):
    """Shares of the systematic misfit by channel and time, and regions that have more than theirs."""
    path, fitter = found.path, found.search.without_motion(found.state)
    shape, robot = path.present.shape, path.robot
    before, after = (fitter.fit_of(causes).left.reshape(shape) ** 2 for causes in ((), found.fit.causes))
    found.search.at(found.state)
    systematic = before - after if found.fit.causes else np.maximum(before - 1, 0)
    by_channel, by_row = np.maximum(systematic.sum(0), 0), np.maximum(systematic.sum(1), 0)
    edges = np.linspace(0, path.t[-1], BLOCKS + 1)
    part = np.clip(np.searchsorted(edges, path.t, side="right") - 1, 0, BLOCKS - 1)
    by_time = np.bincount(part, by_row, BLOCKS)
    return {
        "channels": {c.name: float(v) for c, v in zip(robot.channels, by_channel / (by_channel.sum() or 1.0))},
        "segments": [[float(a), float(b), float(s)] for a, b, s in zip(edges, edges[1:], by_time / (by_time.sum() or 1.0))],
        "regions": _regions(path, by_row),
    }


def _regions(path, size):
    regions, mean = [], size.mean() or 1.0
    signals = [*zip(path.robot.states, path.X.T), *zip(path.robot.commands, path.log.u.T)]
    for signal, values in signals:
        typical = np.abs(values)
        edges = np.unique(np.quantile(typical, np.linspace(0, 1, BINS + 1)))
        for low, high in zip(edges, edges[1:]):
            inside = (typical >= low) & (typical <= high)
            if inside.mean() > 0.02 and size[inside].mean() > SHOWN * mean:
                about = {"variable": f"size of {signal.name}", "unit": signal.unit, "from": float(low), "to": float(high)}
                regions.append(about | {"times_average": float(size[inside].mean() / mean)})
    return sorted(regions, key=lambda r: -r["times_average"])[:5]


def _noise(path, noise):
    """The `noise` of the report."""
    sensor = {
        c.name: {"sd": float(sd), "unit": c.unit, "correlation": float(rho)}
        for c, sd, rho in zip(path.robot.channels, noise.sensor, noise.sensor_rho)
    }
    process = {
        path.channels[i]: {"sd": float(sd), "unit": f"{path.robot.states[i].unit}/s", "share": float(sd / usual)}
        for i, sd, usual in zip(path.pushed, noise.process, path.usual)
    }
    outliers = ((path.present > 1) & np.isfinite(path.present)).any(1).sum()
    return {"sensor": sensor, "process": process, "outliers": int(outliers)}


def _gaps(path, before, after, floor, seed=0):
    """{gap: what the report says of it}; horizons that no row reaches are left out."""
    out = {}
    for name, (unit, _) in path.gaps.items():
        gap = ahead.summary(before[name], after[name], floor[name], seed)
        seen = [h for h, value in gap["before"].items() if np.isfinite(value)]
        out[name] = {part: {h: values[h] for h in seen} for part, values in gap.items()} | {"unit": unit}
    return out


def _healthy(logs, robot):
    """Causes that explain logs of the healthy robot, whichever they are."""
    if not logs:
        return ()
    for log in logs:
        check.refuse(check.mistaken(robot, log), log, robot)
    search = Search(Path(robot, joined(logs)))
    return search.run().causes


def _checked(robot, log, **options):
    """The Path of a log that can be what it says."""
    check.refuse(check.mistaken(robot, log), log, robot)
    path = Path(robot, log, **options)
    check.refuse(check.along(path), log, robot)
    return path


def diagnose(log, robot, fresh=None, without=(), healthy=()):
    """The Diagnosis of a RobotLog; fresh: another one, on which nothing is fitted; healthy: some, from which on a change counts."""
    before = _healthy(healthy, robot)
    path = _checked(robot, log, without=without, before=before)
    check_effects(without, path.everything)
    found = answer(path)
    effects, left, end = _effects(found), found.left, float(path.t[-1])
    gaps = _gaps(path, found.before, found.after, found.floor)
    report = {
        "platform": robot.name,
        "verdict": found.verdict,
        "effects": effects if found.verdict != "unknown" else [],
        "best_fit": effects if found.verdict == "unknown" else [],
        "small": [_told(path.everything[c.name], c, end) for c in found.small],
        "healthy": {"logs": len(healthy), "effects": [{"name": c.name, "params": list(c.params)} for c in before]},
        "ranking": [{"name": n, "score": float(s)} for n, s in judge.ranking(found.search, found.fitter.fit_of(()), found.fit, found.proofs)],
        "ambiguous_with": {c.name: list(p.others) for c, p in zip(found.fit.causes, found.proofs) if p.others},
        "suggested_excitation": "",
        "where": _where(found),
        "gap": next(iter(gaps.values())),
        "gaps": gaps,
        "not_testable": judge.untestable(found.search, found.fit),
        "unexplained": {
            "share": left.share, "gap": left.gap, "of_gap": left.of, "unit": left.unit, "matters": bool(left.matters),
            "depends_on": openset.depends(openset.gains(found.search, found.state)) if left.matters else [],
        },
        "noise": _noise(path, found.state.noise),
        "time_step": {"matters": bool(path.variant), "share": path.share},
        "passes": round(log.passes),
        "log": {"rows": len(log.t), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": end},
    }  # fmt: skip
    if hasattr(robot.simulator, "surrogate"):
        report["surrogate"] = robot.simulator.surrogate
    result = Diagnosis(report, found)
    if fresh is not None:
        _add_fresh(result, robot, fresh)
    return result


def _add_fresh(result, robot, fresh):
    """The same causes on another log: only its noise is looked for there, and whether that acts which came or went."""
    path = Path(robot, fresh, before=result.path.before)
    path.step_by(result.path.variant)
    search, parameters = Search(path), {name: effect.parameters for name, effect in path.everything.items()}
    logs = (result.path.log, fresh)
    carried = elsewhere.carry(result.answer.fit.causes, parameters, logs, lambda causes: search.fitter.fit_of(causes).cost)
    causes = elsewhere.acting(carried)
    path.about(causes)
    state = search.referred(search.likeliest(search.fitter.fit_of(causes)))
    starts = ahead.starts_of(path)
    errors = [ahead.errors(path, some, starts) for some in ((), causes)]
    gaps = _gaps(path, *errors, ahead.floor(path, state.noise.quiet(path), starts))
    result.report["fresh"] = {"gap": next(iter(gaps.values())), "gaps": gaps, "effects": elsewhere.told(carried, parameters)}


def run(path, robot_file, out, fresh=None, without=(), healthy=(), sim=None):
    """Diagnoses a log file with the robot of a TOML file; writes report.json and report.html, prints the summary.

    sim: a run of the simulator under the log's commands (CSV), in the place of the TOML's.
    """
    robot, log = toml.read_both(robot_file, path, sim)
    fresh_log, *healthy_logs = (read(file, robot) if file else None for file in (fresh, *healthy))
    with busy(f"diagnosing {File(path).name}"):
        result = diagnose(log, robot, fresh_log, without, healthy_logs)
        out = output_folder(out)
    result.report = {"log_file": printable(path), "fresh_file": printable(fresh) if fresh else None, **result.report}
    told = story(result)
    with replacing(out / "report.json", result.report):
        write_bytes(out / "report.html", html(told, result.report))
    show(told, out / "report.html")
    return result
