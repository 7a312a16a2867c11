"""One log in, one answer out: the report of the contract and what its page draws."""

from dataclasses import dataclass

import numpy as np

from .. import bridge
from ..plumbing.errors import UserError
from . import advise, elsewhere, where
from .platforms import ddr
from .prediction_errors import ahead, judge, openset
from .prediction_errors.answer import answer
from .prediction_errors.fit import Fit
from .prediction_errors.search import Search
from .robot import check_effects

FEWEST_ROWS, FEWEST = 60, 6  # usable transitions of a log, and in a row


@dataclass
class Diagnosis:
    """The report, and what was computed on the way that a page may draw."""

    report: dict
    log: bridge.Log
    path: ddr.Path
    fit: Fit
    starts: np.ndarray  # rows of the path
    before: dict  # {gap: errors (S, H)}
    after: dict
    floor: dict
    advice: tuple | None


def load(path, platform=ddr):
    """A log that is long enough to say something about."""
    log = bridge.read_log(path, platform.name)
    if log.usable.sum() < FEWEST_ROWS:
        raise UserError(
            f"{path}: {int(log.usable.sum())} usable transitions are too few for a diagnosis; record {FEWEST_ROWS} at least"
        )
    if _longest(log.usable) < FEWEST:
        raise UserError(f"{path}: nowhere are {FEWEST} rows in a row usable; record it with fewer gaps")
    if not np.any(np.abs(np.diff(log.x, axis=0)) > 0):
        raise UserError(f"{path}: the pose never changes; record a drive in which the robot moves")
    return log


def _longest(usable):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]]))).reshape(-1, 2)
    return int((edges[:, 1] - edges[:, 0]).max(initial=0))


def _effects(path, fitter, fit, proved):
    """The `effects` of the report."""
    out, at, intervals = [], 0, judge.intervals(fitter, fit)
    end = (len(path.log.x) - 1) * path.dt
    for i, (cause, proof) in enumerate(zip(fit.causes, proved)):
        spec = path.effects[cause.name].parameters
        limits = {p.name: judge.limits(fitter, fit, i, k, at + k, intervals[at + k]) for k, p in enumerate(spec)}
        at += len(spec)
        out.append({
            "name": cause.name, "evidence": proof.worth, "confidence": proof.confidence,
            "params": {p.name: float(v) for p, v in zip(spec, cause.params)}, "params_ci95": limits,
            "segments": [[float(max(a, 0.0)), float(min(b, end))] for a, b in cause.segments],
            "units": {p.name: p.unit for p in spec}, "at_bound": fitter.held(cause),
        })  # fmt: skip
    return out


def _noise(path, noise):
    """The `noise` of the report."""
    names, units = ("position", "heading"), ("m", "rad")
    sensor = {
        name: {"sd": float(noise.sensor[c]), "unit": unit, "correlation": float(noise.sensor_rho[c])}
        for name, unit, c in zip(names, units, (0, 2))
    }
    tau = float(-path.dt / np.log(noise.process_rho[0]))
    process = {
        name: {"sd": float(sd), "unit": unit, "share": float(sd / usual), "seconds": tau}
        for name, sd, usual, unit in zip(path.channels, noise.process, path.usual, ("m/s", "m/s", "rad/s"))
    }
    return {"sensor": sensor, "process": process, "outliers": int(((path.present > 1) & np.isfinite(path.present)).any(1).sum())}


def _contributions(path, fit, proved, starts):
    """{effect: {H: rise of the gap, m, without it}}."""
    whole = ahead.rms(ahead.errors(path, fit.causes, starts)["position"])
    rest = [ahead.rms(ahead.errors(path, p.rest.causes, starts)["position"]) for p in proved]
    return {c.name: dict(zip(map(str, ahead.HORIZONS), map(float, without - whole))) for c, without in zip(fit.causes, rest)}


def _gap(before, after, least, seed):
    """The `gap` of the report: position, and heading beside it."""
    gap = ahead.summary(before["position"], after["position"], least["position"], seed)
    heading = ahead.summary(before["heading"], after["heading"], least["heading"], seed)
    return gap | {"heading_rad": {k: v for k, v in heading.items() if k != "ci95"}, "windows": len(before["position"])}


def diagnose(log, platform=ddr, fresh=None, without=(), seed=0):
    """The Diagnosis of a log (bridge.Log); fresh: another log of the robot, on which nothing is fitted."""
    path = platform.Path(log, without)
    check_effects(without, platform.effects(path.u))
    found = answer(path)
    search, fitter, fit, proved, left = found.search, found.fitter, found.fit, found.proofs, found.left
    starts, before, after, least = found.starts, found.before, found.after, found.floor
    hidden = judge.untestable(search, fit)
    pairs = [(cause, rival) for cause, proof in zip(fit.causes, proved) for rival in proof.others]
    advice = advise.advise(platform, path, fitter, pairs, hidden)
    effects = _effects(path, fitter, fit, proved)
    ranked = judge.ranking(search, fitter.fit_of(()), fit, proved)
    report = {
        "platform": platform.name,
        "verdict": found.verdict,
        "effects": effects,
        "small": [c.name for c in found.small],
        "ranking": ([{"name": "measurement_noise", "score": 1.0}] if found.verdict == "none" else [])
        + [{"name": name, "score": float(score)} for name, score in ranked],
        "ambiguous_with": {c.name: list(proof.others) for c, proof in zip(fit.causes, proved) if proof.others},
        "lookalikes": [{"effects": sorted(names), "as": what} for names, what in path.lookalikes.items() if names <= set(fit.names)],
        "suggested_excitation": f"{advice[0]}: {advice[1]}" if advice else "",
        "where": where.located(path, before, least, starts, fit),
        "gap": _gap(before, after, least, seed),
        "not_testable": hidden,
        "contributions": _contributions(path, fit, proved, starts),
        "unexplained": {
            "unit": left.unit, "gap_m": left.gap, "of_gap_m": left.of, "smallest_that_matters_m": left.smallest, "share": left.share,
            "matters": bool(left.matters), "depends_on": openset.depends(openset.gains(search, found.state)) if left.matters else [],
        },
        "noise": _noise(path, found.state.noise),
        "integrator": path.variants[path.variant],
        "log": {"rows": len(log.x), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": (len(log.x) - 1) * log.dt}
        | ({"searched_rows": len(path.rows)} if len(path.rows) < len(log.x) else {}),
        "advice": {"drive": advice[0], "words": advice[1], "separation": advice[3]} if advice else None,
    }  # fmt: skip
    result = Diagnosis(report, log, path, fit, starts, before, after, least, advice)
    if fresh is not None:
        _add_fresh(result, platform, fresh, seed)
    return result


def in_log_time(report, t0):
    """The report with segments in the log's own time, which need not begin at zero."""
    effects = [effect | {"segments": [[a + t0, b + t0] for a, b in effect["segments"]]} for effect in report["effects"]]
    where = report["where"] | {"segments": [[a + t0, b + t0, share] for a, b, share in report["where"]["segments"]]}
    return report | {"effects": effects, "where": where}


def _add_fresh(result, platform, fresh, seed):
    """The same fitted model on another log: only the noise is measured there, and whether that acts which came or went."""
    path = platform.Path(fresh, variant=result.path.variant)
    search = Search(path)
    fitter = search.fitter
    parameters = {name: effect.parameters for name, effect in path.effects.items()}
    carried = elsewhere.carry(result.fit.causes, parameters, (result.log, fresh), lambda causes: fitter.fit_of(causes).cost)
    causes = elsewhere.acting(carried)
    noise = search.robust(search.likeliest(fitter.fit_of(causes))).noise
    starts = ahead.starts_of(path)
    parts = [ahead.errors(path, some, starts) for some in ((), causes)]
    gap = _gap(*parts, ahead.floor(path, noise.quiet(path), starts), seed)
    result.report["fresh"] = {"gap": gap, "effects": elsewhere.told(carried, parameters)}
