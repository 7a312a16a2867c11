"""The report of the contract: what all platforms say of the answer to one log."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from . import cautions, elsewhere
from .prediction_errors import ahead, judge, openset, spans
from .prediction_errors.answer import Answer
from .prediction_errors.profiles import Profile
from .prediction_errors.search import Search


@dataclass
class Diagnosis:
    """The report, and what was computed on the way that a page may draw; more: what only one platform has."""

    report: dict
    found: Answer
    more: dict = field(default_factory=dict)

    @property
    def path(self):
        return self.found.path

    @property
    def log(self):
        return self.found.path.log

    @property
    def fit(self):
        return self.found.fit


def told(path, cause):
    """A Cause as the report has it."""
    effect, end = path.effects[cause.name], elsewhere.seconds(path.log)
    return called(effect) | {
        "params": {p.name: float(v) for p, v in zip(effect.parameters, cause.params)},
        "units": {p.name: p.unit for p in effect.parameters}, "segments": inside(cause.segments, end), "formula": effect.formula,
    }  # fmt: skip


def called(effect):
    """The name of an effect in a report, and its form if that is another."""
    return {"name": effect.reported_as} | ({"form": effect.name} if effect.name != effect.reported_as else {})


def inside(segments, end):
    """Stretches of time that end with the log."""
    return [[float(max(a, 0.0)), float(min(b, end))] for a, b in segments]


def limits(fitter, fit, profiled=None):
    """[{parameter: its 95 % interval}] of the causes of a fit; profiled: gives its Profile."""
    out, at, intervals, profiled = [], 0, judge.intervals(fitter, fit), profiled or cache(lambda: Profile(fitter, fit))
    for i, cause in enumerate(fit.causes):
        spec = fitter.effects[cause.name].parameters
        out.append({p.name: judge.limits(fitter, fit, i, k, at + k, intervals[at + k], profiled) for k, p in enumerate(spec)})
        at += len(spec)
    return out


def bands(fit, path, profiled):
    """[{"curve": what the report has of a curve}] of the causes of a fit, of other causes {}: commands, what it takes there, its band."""
    out = []
    for i, cause in enumerate(fit.causes):
        band = judge.band(profiled(), fit, i) if path.effects[cause.name].curve else None
        out.append({"curve": dict(zip(("commands", "takes", "takes_ci95"), (values.tolist() for values in band)))} if band else {})
    return out


def effects(found):
    """The `effects` of the report."""
    out, fitter = [], spans.freed(found.sizes, found.sizes.fit_of(found.fit.causes))
    fit = fitter.fit_of(found.fit.causes)
    profiled = cache(lambda: Profile(fitter, fit))
    for cause, proof, interval, band in zip(fit.causes, found.proofs, limits(fitter, fit, profiled), bands(fit, found.path, profiled)):
        proved = {"evidence": proof.worth, "confidence": proof.confidence, "params_ci95": interval, "at_bound": fitter.held(cause)}
        out.append(told(found.path, cause) | proved | band)
    return out


def gaps(path, before, after, floor, seed=0):
    """The `gaps` of the report, and `gap`, the first of them."""
    found = {
        name: {"unit": unit, "windows": len(before[name])} | ahead.summary(before[name], after[name], floor[name], seed)
        for name, (unit, _) in path.gaps.items()
    }
    return {"gap": next(iter(found.values())), "gaps": found}


def shares(found):
    """Shares of the squared error beyond the sensor's noise, at the longest horizon: {"explained", "predictable", "random"}.

    Explained by the causes; predictable from commands and motion by plain functions, and by no effect; random. Measured on rows that
    neither was fitted on.
    """
    gap, h = next(iter(found.path.gaps)), -1
    sensor = ahead.floor(found.path, found.state.noise.quiet(found.path), found.starts)[gap]
    before, after, boxed, least = (ahead.rms(e[gap])[h] ** 2 for e in (found.before, found.after, found.boxed, {gap: sensor}))
    whole = before - least
    if not whole > 0 or not len(found.path.usual):
        return None
    explained = float(np.clip((before - after) / whole, 0, 1))
    predictable = float(np.clip((after - boxed) / whole, 0, 1 - explained))
    return {"explained": explained, "predictable": predictable, "random": 1 - explained - predictable}


def contributions(found, every=1):
    """{effect: {H: rise of the first gap without it, the others fitted again}}, over each so many predictions."""
    path, starts, gap = found.path, found.starts[::every], next(iter(found.path.gaps))
    size = lambda causes: ahead.rms(ahead.errors(path, causes, starts)[gap])  # noqa: E731
    whole = size(found.fit.causes)
    rises = (size(proof.rest.causes) - whole for proof in found.proofs)
    names = (path.effects[c.name].reported_as for c in found.fit.causes)
    return {name: dict(zip(map(str, ahead.HORIZONS), map(float, rise))) for name, rise in zip(names, rises)}


def noise(path, noise, motion=0):
    """The `noise` of the report; motion: the way in which random motion depends on the command."""
    sensor = {
        name: {"sd": float((noise.sensor * path.sensor_scale)[c]), "unit": unit, "correlation": float(noise.sensor_rho[c])}
        for name, (unit, c) in path.sensors.items()
    }
    lasts = -path.dt / np.log(noise.process_rho)
    process = {
        name: {"sd": float(sd), "unit": unit, "share": float(sd / usual), "seconds": float(tau)}
        for (name, unit), sd, usual, tau in zip(path.pushes.items(), noise.process, path.usual, lasts)
    }
    return {
        "sensor": sensor,
        "process": process,
        "motion": path.motions[motion],
        "outliers": int(((path.present > 1) & np.isfinite(path.present)).any(1).sum()),
    }


def open_questions(found):
    """(pairs of a cause and what may be it instead, names of effects that the log would hardly show)."""
    pairs = [(cause, rival) for cause, proof in zip(found.fit.causes, found.proofs) for rival in proof.others]
    return pairs, judge.untestable(found.search, found.fit)


def left_over(found):
    """The `unexplained` of the report."""
    left = found.left
    return {
        "unit": left.unit, "gap": left.gap, "of_gap": left.of, "smallest_that_matters": left.smallest, "share": left.share,
        "matters": bool(left.matters), "depends_on": found.box.depends() if left.matters else [],
    }  # fmt: skip


def report_of(found, where, hidden, unexplained=None, seed=0):
    """What the report of any platform has.

    where, unexplained: its parts of these names; hidden: effects that the log would hardly show.
    """
    path, log, fit = found.path, found.path.log, found.fit
    fitter, names = found.fitter, {*fit.names}
    every = effects(found)
    named = found.verdict != "unknown"  # where confidence is not each effect's own, all of them or none
    believed = [e for e, proof in zip(every, found.proofs) if named and (not path.calibrated or judge.established(path, proof))]
    return {
        "verdict": found.verdict,
        "effects": believed,
        "best_fit": every if len(believed) < len(every) else [],
        "small": [told(path, cause) for cause in found.small],
        "ranking": [{"name": n, "score": float(s)} for n, s in judge.ranking(found.search, fitter.fit_of(()), fit, found.proofs)],
        "ambiguous_with": {path.effects[c.name].reported_as: list(p.others) for c, p in zip(fit.causes, found.proofs) if p.others},
        "lookalikes": [{"effects": sorted(some), "as": what} for some, what in path.lookalikes.items() if some <= names],
        "suggested_excitation": "",
        "where": where,
        **gaps(path, found.before, found.after, found.floor, seed),
        "shares": shares(found),
        "not_testable": hidden,
        "unexplained": left_over(found) if unexplained is None else unexplained,
        "noise": noise(path, found.state.noise, found.state.motion),
        "log": {
            "rows": len(log.x), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": elsewhere.seconds(log),
            "cautions": cautions.of(found),
        },
    }  # fmt: skip


AGREES, HELPS = 0.5, 0.25  # of the share closed on the log, that must close on the fresh one for a cause to be known, or known in part


def check_on_fresh(result, path):
    """Adds `fresh` to the report, with the Path of another log; what does not hold there is known in part, or not at all."""
    compare(result.report, on_fresh(result, path))


def compare(report, fresh):
    """Takes `fresh` into a report, and into what it is sure of."""
    report["fresh"] = fresh
    realised = _realised(report)
    if report["verdict"] in ("known", "partly") and realised < AGREES:
        for effect in report["effects"]:
            effect["confidence"] *= max(realised, 0.0)
        report["verdict"] = "partly" if realised >= HELPS else "unknown" if _has_gap(report) else "none"
    elif ahead.misses(fresh["gap"]):
        for effect in report["effects"]:
            effect["confidence"] = min(effect["confidence"], judge.DOUBT)
    if report["verdict"] in ("unknown", "none"):
        report["best_fit"], report["effects"] = report["best_fit"] or report["effects"], []


def _has_gap(report):
    """Whether anything on the log itself, beside an effect that a fresh log does not confirm, stands out of the noise."""
    return report["unexplained"]["matters"] or np.isfinite(list(report["gap"]["closed_fraction"].values())).any()


def _realised(report):
    """What closes on the fresh log, of what closes on the log, at the longest horizon with a gap on both; 1 where there is none.

    Where the log has too small a gap for a share, it is what closes on the fresh log. Where the fresh log has none, and would have one with
    the causes, nothing closes.
    """
    log, fresh = (part["gap"]["closed_fraction"] for part in (report, report["fresh"]))
    if ahead.opens(report["fresh"]["gap"]):
        return 0.0
    seen = [h for h in log if np.isfinite(log[h]) and np.isfinite(fresh[h]) and log[h] > 0]
    if seen:
        return fresh[seen[-1]] / log[seen[-1]]
    alone = [fresh[h] for h in fresh if np.isfinite(fresh[h]) and not np.isfinite(log[h])]
    return min(alone[-1], 1.0) if alone else 1.0


def on_fresh(result, path):
    """The `fresh` of the report, on the Path of another log.

    Nothing is fitted there but its noise, and whether that acts which came or went.
    """
    search, causes = Search(path), result.fit.causes
    parameters = {name: effect.parameters for name, effect in path.effects.items()}
    carried = elsewhere.carry(causes, parameters, (result.log, path.log), lambda some: search.fitter.fit_of(some).cost)
    causes = elsewhere.acting(carried)
    path.about(causes)
    state = search.referred(search.robust(search.likeliest(search.fitter.fit_of(causes))))
    path.tell_hidden(state.noise)
    starts = ahead.starts_of(path)
    before, after = (ahead.errors(path, some, starts) for some in ((), causes))
    boxed, box = openset.boxed(search, state, path.ahead(causes, starts, ahead.HORIZONS), starts)
    least = judge.floors(path, state.noise, before, after, boxed, starts)
    least = judge.surely(path, box, least, starts) if causes else least
    return {
        **gaps(path, before, after, least),
        "effects": [one | called(path.effects[one["name"]]) for one in elsewhere.told(carried, parameters)],
    }
