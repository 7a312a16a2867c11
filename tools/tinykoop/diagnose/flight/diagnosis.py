"""One flight in, one answer out: the report of the contract and what its page draws."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ... import bridge
from ...logs import replay
from ...plumbing.errors import UserError
from .. import elsewhere
from ..robot import check_effects
from . import advise, evidence, gap, where
from .baseline import Baseline, of_vehicle, simulated
from .fit import active
from .generic import FEIGNED, SIGNIFICANT, Generic
from .innovations import Innovations
from .search import FlightSearch
from .vehicle import Fwmav, turns_yaw
from .vibration import measure

RATE = 100.0  # Hz, of simulated flights
LEAST_SECONDS = 6.0
UNEXPLAINED = 0.1  # of what generic accelerations find may be left and the effects still be called the explanation
ANOTHER = 1.4  # times the variance of a healthy flight, from which on this is not the simulated vehicle
KICKED = 1.5  # s, on either side of where shaking changes
TURNS = 2  # of noise and effects of a healthy flight
WORSE = 1.1  # times the simulator's error of prediction, from which on effects are not believed
BELIEVED = 0.2  # confidence below which a single effect is not known


@dataclass
class Diagnosis:
    """The report, and what was computed on the way that a page may draw."""

    report: dict
    log: bridge.Log
    pieces: Innovations
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
    if not len(gap.predictable(log)):
        raise UserError(f"{path}: nowhere are 1.5 s in a row usable; record the flight with fewer gaps")
    if not np.any(np.diff(log.u[:, 0])):
        raise UserError(f"{path}: u never changes; log the command that the controller sends to the servo")
    return log


@lru_cache(maxsize=8)
def _differ(healthy, yaw):
    return healthy.differ(Fwmav(), yaw)


def _pieces(platform, log, healthy, whiten=None):
    return Innovations(platform, log, whiten or healthy.whitener, healthy.base, _differ(healthy, turns_yaw(log)))


def _shaken(log, healthy):
    """(Vibration or None, the baseline whose noise is that of most of the log, what whitens all of it)."""
    found = measure(log, healthy)
    if found is None or healthy.base:
        return found, healthy, healthy.whitener
    (_, _, low, high, _), *_ = bridge.effects("fwmav")["vibration"][1]
    shaken, (t0, t1) = simulated(float(np.clip(round(found.a, 2), low, high))), found.segment
    if (t0, t1) == (0.0, np.inf):
        return found, shaken, shaken.whitener
    t = (log.t - log.t[0])[:, None]
    # shaking that sets in at once gives the body a kick, whatever else acts; and when, is known to a second
    kicked = np.minimum(np.abs(t - t0), np.abs(t - t1)) < KICKED

    def whiten(missed):
        return np.where(kicked, np.nan, np.where((t >= t0) & (t < t1), shaken.whitener(missed), healthy.whitener(missed)))

    return found, healthy, whiten


def baseline_of(log):
    """The Baseline of the vehicle that a healthy flight shows: noise and effects by turns, as each is known from the other."""
    own = of_vehicle(log, ())
    for _ in range(TURNS):
        pieces = Innovations(Fwmav(), log, own.whitener)
        own = of_vehicle(log, active(FlightSearch(pieces).run().causes))
    return own


@lru_cache(maxsize=4)
def _healthy_flights(healthy, yaw):
    """Innovations of healthy flights."""
    return [_pieces(Fwmav(), log, healthy) for log in healthy.on(yaw)]


@lru_cache(maxsize=8)
def _feigned(healthy, yaw):
    """(gain, peak) that generic accelerations find at most on healthy flights."""
    found = []
    for pieces in _healthy_flights(healthy, yaw):
        left = Generic(pieces).left(pieces.whiten(pieces.residual()).ravel())
        found.append((left.gain, left.peak))
    return np.max(found, axis=0)


@lru_cache(maxsize=8)
def _floor(healthy, yaw):
    """RMS (H, 9) of what is missed ahead on healthy flights."""
    missed = [gap.ahead(pieces, (), gap.starts_of(pieces)) for pieces in _healthy_flights(healthy, yaw)]
    return np.sqrt(np.mean(np.concatenate(missed) ** 2, axis=0))


def diagnose(log, fresh=None, without=(), own=None):
    """The Diagnosis of a flight (bridge.Log); own: a healthy flight of this vehicle, which else is the simulated one."""
    platform = Fwmav()
    check_effects(without, bridge.effects(platform.name))
    healthy = baseline_of(own) if own is not None else simulated()
    shaking, noise, whiten = _shaken(log, healthy)
    if "vibration" in without:
        shaking = None
    yaw = turns_yaw(log)
    pieces = _pieces(platform, log, noise, whiten)
    search = FlightSearch(pieces, without)
    fit = search.explain()
    proofs = evidence.evidence(search, fit)
    order = sorted(range(len(proofs)), key=lambda i: -proofs[i].worth)
    fit, proofs = search.fitter.fit_of([fit.causes[i] for i in order]), [proofs[i] for i in order]

    starts, floor = gap.starts_of(pieces), _floor(noise, yaw)
    before, after = gap.errors(search.fitter, fit, starts)
    unexplained = _unexplained(search, fit, shaking, _feigned(noise, yaw))
    word, trust = _verdict(fit, proofs, shaking, unexplained, _worse(before, after))
    effects = [_effect(search, fit, i, proof, trust, log) for i, proof in enumerate(proofs)]
    if shaking:
        effects.append(_vibration_effect(shaking, log))
        effects.sort(key=lambda effect: -effect["evidence"])
    if word == "none":
        effects, fit, proofs, after = [], search.base, [], before
    rivals = {name for proof in proofs for name in proof.ambiguous}
    blind_to = [name for name in evidence.untestable(search, fit) if name not in rivals]
    pairs = [(cause, rival) for cause, proof in zip(fit.causes, proofs) for rival in proof.ambiguous]
    advice = advise.advise(search, noise, pairs, blind_to)
    left = pieces.residual(), pieces.residual(active(fit.causes))
    systematic = where.explained(pieces, left, fit)
    report = {
        "platform": platform.name,
        "verdict": word,
        "effects": effects,
        "ranking": _ranking(search, fit, proofs, shaking),
        "ambiguous_with": {c.name: list(p.ambiguous) for c, p in zip(fit.causes, proofs) if p.ambiguous},
        "suggested_excitation": f"{advice['drive']}: {advice['words']}" if advice else "",
        "where": {
            "channels": where.channels(systematic),
            "segments": where.segments(systematic, log, [s for c in fit.causes for span in c.segments for s in span]),
            "regions": where.regions(before, floor, starts, log),
            "frequencies": where.frequencies(left[0], noise, log, pieces.known),
        },
        "gap": gap.summary(before, after, floor),
        "contributions": gap.contributions(pieces, fit.causes, starts),
        "not_testable": blind_to + (["vibration"] if "vibration" in without else []),
        "unexplained": unexplained,
        "vehicle": "own" if own is not None else "simulated",
        "axis": "yaw" if yaw else "pitch",
        "log": {"rows": len(log.x), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": (len(log.x) - 1) * log.dt},
        "advice": advice,
    }
    result = Diagnosis(report, log, pieces, fit, before, after, floor, starts, left, noise)
    if fresh is not None:
        other = _pieces(platform, fresh, noise)
        rows = gap.starts_of(other)
        misfit = lambda causes: float(np.sum(other.whiten(other.residual(active(causes))) ** 2))  # noqa: E731
        parameters = {name: spec for name, (_, spec) in platform.effects().items()}
        carried = elsewhere.carry(fit.causes, parameters, (log, fresh), misfit)
        parts = [gap.ahead(other, causes, rows) for causes in ((), elsewhere.acting(carried))]
        there = elsewhere.told(carried, parameters)
        report["fresh"] = {"gap": gap.summary(*parts, _floor(noise, turns_yaw(fresh))), "effects": there}
        result.fresh_log, result.fresh_errors = fresh, parts
    return result


def _worse(before, after):
    """Whether the effects make predictions worse than the simulator's on rows that they were not fitted on."""
    then, now = (gap.rms(gap.attitude(missed)[:, -1]) for missed in (before, after))
    return bool(now > WORSE * then)


def _unexplained(search, fit, shaking, feigned):
    """What generic accelerations find beside the effects, against the (gain, peak) that healthy flights feign."""
    generic = Generic(search.pieces)
    first, last = generic.left(search.base.left), generic.left(fit.left)
    before, after = first.gain - feigned[0], last.gain - feigned[0]
    matters = bool(last.significance() < SIGNIFICANT and last.peak > FEIGNED * feigned[1])
    times = fit.cost / search.pieces.degrees
    depends = [{"on": on, "channel": channel, "share": part} for (on, channel), part in list(last.depends.items())[:4]]
    return {
        "share": float(np.clip(after / before, 0, 1)) if before > 0 else 0.0,
        "p": last.significance(),
        "matters": matters,
        "another_vehicle": bool(times > ANOTHER or (shaking is not None and not shaking.alike)),
        "times_noise": times,
        "depends_on": depends if matters else [],
    }


def _verdict(fit, proofs, shaking, unexplained, worse):
    """(the word of the contract, factor of the confidence in each effect)."""
    left, found = unexplained["matters"], bool(fit.causes or shaking)
    trust = 1 - unexplained["share"] if left else 1.0
    if worse:
        return "unknown", trust * BELIEVED
    if unexplained["another_vehicle"] or (left and (unexplained["share"] > UNEXPLAINED or not fit.causes)):
        return "unknown", trust
    if found and not shaking and max(proof.confidence for proof in proofs) < BELIEVED:
        return "unknown" if left else "none", trust
    return "known" if found else "none", trust


def _segments(cause_segments, log):
    end = (len(log.x) - 1) * log.dt
    return [[float(max(a, 0.0)), float(min(b, end))] for a, b in cause_segments]


def _effect(search, fit, index, proof, trust, log):
    cause, fitter = fit.causes[index], search.fitter
    spec, scale = fitter.effects[cause.name][1], fitter.scale(cause)
    low, high = fitter.bounds(cause)
    first = sum(len(c.params) for c in fit.causes[:index])
    J = fitter.jacobian(fit)
    heat = search.heat(fit)
    spread = np.sqrt(heat * np.diag(np.linalg.pinv(J.T @ J, rcond=1e-12)))[first : first + len(spec)]
    z = fitter.vector((cause,))
    limits = [np.clip([v - 1.96 * s, v + 1.96 * s], a, b) * k for v, s, a, b, k in zip(z, spread, low, high, scale)]
    return {
        "name": cause.name,
        "evidence": float(proof.worth),
        "confidence": float(proof.confidence * trust),
        "params": {p.name: float(v) for p, v in zip(spec, cause.params)},
        "params_ci95": {p.name: [float(v) for v in interval] for p, interval in zip(spec, limits)},
        "segments": _segments(cause.segments, log),
        "units": {p.name: p.unit for p in spec},
        "at_bound": fitter.held(cause),
    }


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


def _ranking(search, fit, proofs, shaking):
    """The causes by their worth, then the others by how much of a cause's worth they would take over."""
    whole = max(search.base.cost - min(fit.cost, search.base.cost), 1e-9)
    score = {c.name: 1 + proof.worth / whole for c, proof in zip(fit.causes, proofs)}
    if shaking:
        score["vibration"] = 2.0
    for name in search.fitter.effects:
        if name not in score:
            alone = search.fits.get(frozenset([name]))
            gain = search.base.cost - alone.cost if alone and not fit.causes else 0
            gain /= gain + search.price * search.heat(fit)  # by itself, not worth its price: below a half
            score[name] = max([gain, *(p.absorbed.get(name, 0) * p.worth / whole for p in proofs)])
    return [{"name": name, "score": float(s)} for name, s in sorted(score.items(), key=lambda item: -item[1])]
