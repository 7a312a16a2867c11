"""The diagnosis of a robot of one's own: log and simulator in, where, which and how much out."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..plumbing.results import busy, output_folder, printable, replacing, write_bytes
from .elsewhere import AT_END
from .engine import ahead, judge
from .engine.finder import Finder
from .engine.problem import Problem
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
    problem: Problem
    fit: object
    ahead: ahead.Ahead
    before: dict
    after: dict


def _intervals(finder, fit):
    """95 % intervals (p, 2) in usual sizes."""
    if not fit.causes:
        return np.zeros((0, 2))
    z, t = finder.vector(fit.causes)[0], finder.wald(fit)
    out = z[:, None] + 1.96 * np.abs(z / np.where(t == 0, 1e-12, t))[:, None] * np.array([-1, 1])
    at = 0
    for i, cause in enumerate(fit.causes):
        spec = finder.problem.effects[cause.name].parameters
        if finder.problem.effects[cause.name].threshold:
            out[at] = np.array(finder.interval(fit, i)) / abs(spec[0].usual)
        at += len(spec)
    return out


def _effects(finder, fit, proofs, end):
    out, at, intervals = [], 0, _intervals(finder, fit)
    for cause, proof in zip(fit.causes, proofs):
        spec = finder.problem.effects[cause.name].parameters
        limits = {p.name: [float(np.clip(v * p.usual, p.low, p.high)) for v in intervals[at + k]] for k, p in enumerate(spec)}
        at += len(spec)
        out.append({
            "name": cause.name, "evidence": proof.gain, "confidence": proof.confidence,
            "params": dict(zip((p.name for p in spec), cause.params)), "params_ci95": limits, "units": {p.name: p.unit for p in spec},
            "segments": [[0.0, end]], "formula": finder.problem.effects[cause.name].formula, "established": proof.established,
        })  # fmt: skip
    return out


def _ranking(finder, fit, proofs):
    whole = max(finder.base.cost - fit.cost, 1e-9)
    score = {c.name: 1 + p.gain / whole for c, p in zip(fit.causes, proofs)}
    have = finder.problem.columns([fit.causes, ()]) @ [1.0, -1.0] if fit.causes else finder.base.left
    best = {}
    for c in finder.candidates(finder.problem.fit_of(())):
        if c.name not in score:
            rival = (c.column @ have) ** 2 / max(c.column @ c.column, 1.0) / max(have @ have, 1e-9)
            best[c.name] = max(best.get(c.name, 0.0), float(rival) if fit.causes else 0.0)
    score |= best
    return [{"name": name, "score": float(s)} for name, s in sorted(score.items(), key=lambda item: -item[1])]


def _where(problem, finder, fit):
    """Shares of the systematic misfit by channel and time, and regions that have more than theirs."""
    shape = problem.rollouts.measured.shape
    before, after = (f.left.reshape(shape) ** 2 for f in (finder.base, fit))
    systematic = before - after if fit.causes else np.maximum(before - 1, 0)
    by_channel = np.maximum(systematic.sum((0, 1)), 0)
    per_window = np.maximum(systematic.sum((1, 2)), 0)
    t = problem.log.t[problem.rollouts.starts] - problem.log.t[0]
    edges = np.linspace(0, problem.log.t[-1] - problem.log.t[0], BLOCKS + 1)
    part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, BLOCKS - 1)
    by_time = np.bincount(part, per_window, BLOCKS)
    return {
        "channels": {c.name: float(v) for c, v in zip(problem.robot.channels, by_channel / (by_channel.sum() or 1.0))},
        "segments": [[float(a), float(b), float(s)] for a, b, s in zip(edges, edges[1:], by_time / (by_time.sum() or 1.0))],
        "regions": _regions(problem, per_window),
    }


def _regions(problem, size):
    found, mean = [], size.mean() or 1.0
    signals = [(s, problem.X[..., i]) for i, s in enumerate(problem.robot.states)]
    signals += [(s, problem.log.u[problem.rollouts.index][..., j]) for j, s in enumerate(problem.robot.commands)]
    for signal, values in signals:
        typical = np.abs(values).mean(1)
        edges = np.unique(np.quantile(typical, np.linspace(0, 1, BINS + 1)))
        for low, high in zip(edges, edges[1:]):
            inside = (typical >= low) & (typical <= high)
            if inside.sum() >= 4 and size[inside].mean() > SHOWN * mean:
                found.append(
                    {
                        "variable": f"size of {signal.name}",
                        "unit": signal.unit,
                        "from": float(low),
                        "to": float(high),
                        "times_average": float(size[inside].mean() / mean),
                    }
                )
    return sorted(found, key=lambda r: -r["times_average"])[:5]


def _hidden(problem, finder, fit):
    """Effects of usual size that this log would not show."""
    strongest = {}
    for c in finder.candidates(fit):
        strongest[c.name] = max(strongest.get(c.name, 0.0), float(np.linalg.norm(c.column)))
    return [name for name, size in strongest.items() if size < np.sqrt(finder.price)]


def _healthy(logs, robot):
    """Causes that explain logs of the healthy robot, whichever they are."""
    if not logs:
        return ()
    return Finder(_problem(robot, joined(logs), logs)).run().causes


def _problem(robot, log, parts, **options):
    """The Problem of a log, which is made of parts that can be what they say."""
    for part in parts:
        check.refuse(check.mistaken(robot, part), part, robot)
    problem = Problem.of(robot, log, **options)
    check.refuse(check.along(problem), log, robot)
    return problem


def diagnose(log, robot, fresh=None, without=(), healthy=()):
    """The Diagnosis of a RobotLog; fresh: another one, on which nothing is fitted; healthy: some, from which on a change counts."""
    before = _healthy(healthy, robot)
    problem = _problem(robot, log, [log], without=without, before=before)
    check_effects(without, problem.everything)
    finder = Finder(problem)
    fit, proofs, left = judge.judge(finder, finder.run())
    order = sorted(range(len(proofs)), key=lambda i: -proofs[i].gain)
    fit, proofs = finder.centred(problem.fit_of([fit.causes[i] for i in order])), [proofs[i] for i in order]
    looked = ahead.Ahead(problem)
    errors, after, floor = looked.errors(()), looked.held_out(finder, fit), looked.floor()
    gaps = {g.name: ahead.summary(errors[g.name], after[g.name], floor[g.name], looked.horizons) | {"unit": g.unit} for g in robot.gaps}
    named = _effects(finder, fit, proofs, float(log.t[-1] - log.t[0]))
    small = [e for e, c in zip(named, fit.causes) if judge.is_small(finder, c)]
    effects = [e for e in named if e not in small]
    word = judge.verdict([p for p, e in zip(proofs, named) if e not in small], left)
    report = {
        "platform": robot.name,
        "verdict": word,
        "effects": [] if word in ("none", "unknown") else effects,
        "best_fit": effects if word == "unknown" else [],
        "small": small,
        "healthy": {"logs": len(healthy), "effects": [{"name": c.name, "params": list(c.params)} for c in before]},
        "ranking": _ranking(finder, fit, proofs),
        "ambiguous_with": {c.name: list(p.others) for c, p in zip(fit.causes, proofs) if p.others},
        "suggested_excitation": "",
        "where": _where(problem, finder, fit),
        "gap": next(iter(gaps.values())),
        "gaps": gaps,
        "not_testable": _hidden(problem, finder, fit),
        "unexplained": {
            "share": left.share,
            "times_noise": left.times,
            "matters": left.matters,
            "depends_on": [{"on": a, "acts_on": b} for a, b in left.on if left.matters],
        },
        "noise": {"sensor": {c.name: {"sd": float(s), "unit": c.unit} for c, s in zip(robot.channels, problem.sigma)}},
        "time_step": {"matters": bool(problem.finer), "share": problem.finer},
        "window": {"rows": problem.rollouts.rows, "seconds": problem.rollouts.rows * log.dt},
        "passes": round(log.passes),
        "log": {"rows": len(log.t), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": float(log.t[-1] - log.t[0])},
    }  # fmt: skip
    if hasattr(robot.simulator, "surrogate"):
        report["surrogate"] = robot.simulator.surrogate
    result = Diagnosis(report, problem, fit, looked, errors, after)
    if fresh is not None:
        _add_fresh(result, robot, fresh, fit)
    return result


def _as_fast(causes, effects, ratio):
    """Causes on a log that lasts `ratio` times as long: what is lost by the end is lost at the same rate."""
    scaled = lambda c: tuple(v * ratio if p.name == AT_END else v for v, p in zip(c.params, effects[c.name].parameters))  # noqa: E731
    return tuple(replace(c, params=scaled(c)) for c in causes)


def _add_fresh(result, robot, fresh, fit):
    """The same causes on another log: only its starts are looked for there."""
    other = Problem.of(robot, fresh, before=result.problem.before)
    other.sigma = result.problem.sigma
    causes = _as_fast(fit.causes, other.everything, np.ptp(fresh.t) / np.ptp(result.problem.log.t))
    other.linearise(causes)
    looked = ahead.Ahead(other)
    before, after, floor = looked.errors(()), looked.errors(causes), looked.floor()
    gaps = {g.name: ahead.summary(before[g.name], after[g.name], floor[g.name], looked.horizons) | {"unit": g.unit} for g in robot.gaps}
    result.report["fresh"] = {"gap": next(iter(gaps.values())), "gaps": gaps}


def run(path, robot_file, out, fresh=None, without=(), healthy=(), sim=None):
    """Diagnoses a log file with the robot of a TOML file; writes report.json and report.html, prints the summary.

    sim: a run of the simulator under the log's commands (CSV), in the place of the TOML's.
    """
    robot, log = toml.read_both(robot_file, path, sim)
    fresh_log, *healthy_logs = (read(file, robot) if file else None for file in (fresh, *healthy))
    with busy(f"diagnosing {Path(path).name}"):
        result = diagnose(log, robot, fresh_log, without, healthy_logs)
        out = output_folder(out)
    result.report = {"log_file": printable(path), "fresh_file": printable(fresh) if fresh else None, **result.report}
    told = story(result)
    with replacing(out / "report.json", result.report):
        write_bytes(out / "report.html", html(told, result.report))
    show(told, out / "report.html")
    return result
