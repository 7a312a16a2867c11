"""One flight in, one answer out: the report of the contract and what its page draws."""

from dataclasses import dataclass, field, replace

import numpy as np

from ... import bridge
from ...logs import replay
from ...plumbing.errors import UserError
from .. import elsewhere
from ..platforms import fwmav
from ..prediction_errors import ahead, judge, openset
from ..prediction_errors.answer import answer
from ..prediction_errors.fit import Fitter
from ..prediction_errors.search import Search
from ..robot import check_effects
from . import advise, gap, where
from .baseline import Baseline, of_vehicle, simulated
from .vehicle import predictable, turns_yaw
from .vibration import measure

RATE = 100.0  # Hz, of simulated flights
LEAST_SECONDS = 6.0
SYSTEMATIC = 60.0  # squares: on 68 healthy flights generic accelerations take 42 at most
ANOTHER = 1.4  # times the variance of a healthy flight, from which on this is not the simulated vehicle
KICKED = 1.5  # s, on either side of where shaking changes
TURNS = 2  # of noise and effects of a healthy flight
WORSE = 1.1  # times the simulator's error of prediction, from which on effects are not believed
DOUBTED = 0.2  # of the confidence in effects stays then


@dataclass
class Diagnosis:
    """The report, and what was computed on the way that a page may draw."""

    report: dict
    log: bridge.Log
    path: fwmav.Path
    fit: object
    before: np.ndarray  # (W, H, 9)
    after: np.ndarray
    floor: np.ndarray  # (H, 9)
    starts: np.ndarray
    left: tuple  # innovations (K, 9) without and with the effects; the observer knows little in the first second
    healthy: Baseline
    fresh_log: bridge.Log | None = None
    fresh_errors: tuple = field(default=())


def load(path):
    """A flight that is long enough to say something about."""
    log = replay.unwrapped(bridge.read_log(path, "fwmav"), "fwmav")
    if abs(log.dt * RATE - 1) > 0.02:
        raise UserError(f"{path}: rows come every {log.dt:.4g} s; the simulated vehicle is logged at {RATE:g} Hz: resample to that")
    if log.usable.sum() * log.dt < LEAST_SECONDS:
        raise UserError(
            f"{path}: {log.usable.sum() * log.dt:.1f} s are usable, too few for a diagnosis; record {LEAST_SECONDS:g} s at least"
        )
    if not len(predictable(log)):
        raise UserError(f"{path}: nowhere are 1.5 s in a row usable; record the flight with fewer gaps")
    if not np.any(np.diff(log.u[:, 0])):
        raise UserError(f"{path}: u never changes; log the command that the controller sends to the servo")
    return log


def _shaken(log, healthy):
    """(Vibration or None, the baseline whose noise is that of most of the log, [(rows, what whitens them)])."""
    found, every = measure(log, healthy), np.ones(len(log.x), bool)
    if found is None or healthy.base:
        return found, healthy, [(every, healthy.whitener)]
    (_, _, low, high, _), *_ = bridge.effects("fwmav")["vibration"][1]
    shaken, (t0, t1) = simulated(float(np.clip(round(found.a, 2), low, high))), found.segment
    if (t0, t1) == (0.0, np.inf):
        return found, shaken, [(every, shaken.whitener)]
    t = log.t - log.t[0]
    # shaking that sets in at once gives the body a kick, whatever else acts; and when, is known to a second
    kicked, during = np.minimum(np.abs(t - t0), np.abs(t - t1)) < KICKED, (t >= t0) & (t < t1)
    return found, healthy, [(during & ~kicked, shaken.whitener), (~during & ~kicked, healthy.whitener)]


def baseline_of(log):
    """The Baseline of the vehicle that a healthy flight shows: noise and effects by turns, as each is known from the other."""
    own = plain = of_vehicle(log, ())
    for _ in range(TURNS):
        found = Search(plain.path(log, [(np.ones(len(log.x), bool), own.whitener)], differ={})).run()
        own = of_vehicle(log, fwmav.acting(found.causes))
    return own


def diagnose(log, fresh=None, without=(), own=None):
    """The Diagnosis of a flight (bridge.Log); own: a healthy flight of this vehicle, which else is the simulated one."""
    check_effects(without, bridge.effects(fwmav.name))
    healthy = baseline_of(own) if own is not None else simulated()
    shaking, noise, parts = _shaken(log, healthy)
    if "vibration" in without:
        shaking = None
    path = noise.path(log, parts, without)
    found = answer(path)
    search, fit, proofs, starts, floor = found.search, found.fit, found.proofs, found.starts, path.noises.missed
    before = path.ahead((), starts, ahead.HORIZONS)
    after = ahead.missed(found.fitter, fit, starts) if fit.causes else before
    unexplained = _unexplained(found, shaking)
    worse = _worse(before, after)
    effects = _effects(path, found, DOUBTED if worse else 1 - unexplained["share"])
    if shaking:
        effects.append(_vibration_effect(shaking, log))
        effects.sort(key=lambda effect: -effect["evidence"])
    word = _verdict(found, effects, unexplained, worse)
    rivals = {name for proof in proofs for name in proof.others}
    hidden = [name for name in judge.untestable(search, fit) if name not in rivals]
    pairs = [(cause, rival) for cause, proof in zip(fit.causes, proofs) for rival in proof.others]
    advice = advise.advise(search, noise, pairs, hidden)
    left = tuple(path.follow([*path.base, *fwmav.acting(causes)])[0] for causes in ((), fit.causes))
    systematic = where.explained(path, fit)
    report = {
        "platform": fwmav.name,
        "verdict": word,
        "effects": effects,
        "ranking": _ranking(found, shaking),
        "ambiguous_with": {c.name: list(p.others) for c, p in zip(fit.causes, proofs) if p.others},
        "suggested_excitation": f"{advice['drive']}: {advice['words']}" if advice else "",
        "where": {
            "channels": where.channels(systematic),
            "segments": where.segments(systematic, log, [s for c in fit.causes for span in c.segments for s in span]),
            "regions": where.regions(before, floor, starts, log),
            "frequencies": where.frequencies(left[0], noise, log, path.known),
        },
        "gap": gap.summary(before, after, floor),
        "contributions": gap.contributions(path, fit.causes, starts),
        "not_testable": hidden + (["vibration"] if "vibration" in without else []),
        "unexplained": unexplained,
        "vehicle": "own" if own is not None else "simulated",
        "axis": "yaw" if turns_yaw(log) else "pitch",
        "log": {"rows": len(log.x), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": elsewhere.seconds(log)},
        "advice": advice,
    }
    result = Diagnosis(report, log, path, fit, before, after, floor, starts, left, noise)
    if fresh is not None:
        _add_fresh(result, fresh)
    return result


def _add_fresh(result, fresh):
    """The same causes on another flight; nothing is fitted again but whether that acts which came or went."""
    path, causes = result.healthy.path(fresh), result.fit.causes
    fitter, starts = Fitter(path, path.noises.first(path)), ahead.starts_of(path)
    parameters = {name: effect.parameters for name, effect in path.effects.items()}
    carried = elsewhere.carry(causes, parameters, (result.log, fresh), lambda some: fitter.fit_of(some).cost)
    errors = [path.ahead(some, starts, ahead.HORIZONS) for some in ((), elsewhere.acting(carried))]
    result.report["fresh"] = {"gap": gap.summary(*errors, path.noises.missed), "effects": elsewhere.told(carried, parameters)}
    result.fresh_log, result.fresh_errors = fresh, errors


def _worse(before, after):
    """Whether the effects make predictions worse than the simulator's on rows that they were not fitted on."""
    then, now = (ahead.rms(gap.attitude(missed)[:, -1]) for missed in (before, after))
    return bool(now > WORSE * then)


def _unexplained(found, shaking):
    """What is left beside the effects: of predictions, and of what generic accelerations take of rows that they were not fitted on."""
    times, left, search = float(found.state.noise.sensor[0] ** 2), found.left, found.search
    gains = openset.gains(search, replace(found.state, fit=found.fit))
    taken, share = sum(gains[0].values()), left.share if left.matters else 0.0
    if taken > SYSTEMATIC:
        share = max(share, taken / max(taken, sum(openset.gains(search, search.base)[0].values())))
    another = times > ANOTHER or (shaking is not None and not shaking.alike)
    matters = bool(left.matters or taken > SYSTEMATIC)
    return {
        "share": share,
        "matters": matters,
        "another_vehicle": bool(another),
        "times_noise": times,
        "depends_on": openset.depends(gains) if matters else [],
    }


def _verdict(found, effects, unexplained, worse):
    """The word of the contract."""
    left = unexplained["matters"] and (unexplained["share"] > judge.UNEXPLAINED or not found.fit.causes)
    if worse or unexplained["another_vehicle"] or left:
        return "unknown"
    return "known" if effects else "none"


def _segments(cause_segments, log):
    return [[float(max(a, 0.0)), float(min(b, elsewhere.seconds(log)))] for a, b in cause_segments]


def _effects(path, found, trust):
    """The `effects` of the report."""
    out, at, fitter = [], 0, found.fitter
    intervals = judge.intervals(fitter, found.fit)
    for i, (cause, proof) in enumerate(zip(found.fit.causes, found.proofs)):
        spec = path.effects[cause.name].parameters
        limits = {p.name: judge.limits(fitter, found.fit, i, k, at + k, intervals[at + k]) for k, p in enumerate(spec)}
        at += len(spec)
        out.append({
            "name": cause.name, "evidence": proof.worth, "confidence": proof.confidence * trust,
            "params": {p.name: float(v) for p, v in zip(spec, cause.params)}, "params_ci95": limits,
            "segments": _segments(cause.segments, path.log), "units": {p.name: p.unit for p in spec}, "at_bound": fitter.held(cause),
        })  # fmt: skip
    return out


def _vibration_effect(shaking, log):
    return {
        "name": "vibration",
        "evidence": shaking.evidence,
        "confidence": 0.99 if shaking.alike else 0.2,
        "params": {"a": shaking.a},
        "params_ci95": {"a": [shaking.a - 1.96 * shaking.sd, shaking.a + 1.96 * shaking.sd]},
        "segments": _segments((shaking.segment,), log),
        "units": {"a": "1"},
        "at_bound": [],
    }


def _ranking(found, shaking):
    """Vibration is measured: where there is some, it is beyond doubt."""
    ranked = judge.ranking(found.search, found.fitter.fit_of(()), found.fit, found.proofs)
    if shaking:
        ranked = sorted([*ranked, ("vibration", 2.0)], key=lambda s: -s[1])
    return [{"name": name, "score": float(score)} for name, score in ranked]
