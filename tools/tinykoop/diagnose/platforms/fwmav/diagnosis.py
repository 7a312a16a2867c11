"""One flight in, one answer out: the simulated vehicle is held to the log by an observer."""

from dataclasses import replace

import numpy as np

from .... import bridge
from ....logs import replay
from ....plumbing.errors import UserError
from ...diagnosis import Diagnosis, check_on_fresh, inside, open_questions, report_of
from ...elsewhere import seconds
from ...prediction_errors import ahead, judge, openset
from ...prediction_errors.answer import answer
from ...prediction_errors.search import Search
from ...robot import check_effects
from . import advise, where
from .baseline import of_vehicle, simulated
from .path import acting, name
from .vehicle import CHANNELS, predictable, turns_yaw
from .vibration import measure

RATE = 100.0  # Hz, of simulated flights
LEAST_SECONDS = 6.0
SYSTEMATIC = 60.0  # squares: on 68 healthy flights generic accelerations take 42 at most
ANOTHER = 1.4  # times the variance of a healthy flight, from which on this is not the simulated vehicle
KICKED = 1.5  # s, on either side of where shaking changes
TURNS = 2  # of noise and effects of a healthy flight
WORSE = 1.1  # times the simulator's error of prediction, from which on effects are not believed
DOUBTED = 0.2  # of the confidence in effects stays then


def load(path):
    """A flight that is long enough to say something about."""
    log = replay.unwrapped(bridge.read_log(path, name), name)
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


def read(path, fresh=None, healthy=(), robot=name, sim=None):
    """(the log, what diagnose() takes beside it)."""
    return load(path), {"fresh": load(fresh) if fresh else None, "healthy": [load(file) for file in healthy]}


def _shaken(log, healthy):
    """(Vibration or None, the baseline whose noise is that of most of the log, [(rows, what whitens them)])."""
    found, every = measure(log, healthy), np.ones(len(log.x), bool)
    if found is None or healthy.base:
        return found, healthy, [(every, healthy.whitener)]
    (_, _, low, high, _), *_ = bridge.effects(name)["vibration"][1]
    shaken, (t0, t1) = simulated(float(np.clip(round(found.a, 2), low, high))), found.segment
    if (t0, t1) == (0.0, np.inf):
        return found, shaken, [(every, shaken.whitener)]
    t = log.t - log.t[0]
    # shaking that sets in at once gives the body a kick, whatever else acts; and when, is known to a second
    kicked, during = np.minimum(np.abs(t - t0), np.abs(t - t1)) < KICKED, (t >= t0) & (t < t1)
    return found, healthy, [(during & ~kicked, shaken.whitener), (~during & ~kicked, healthy.whitener)]


def baseline_of(logs):
    """The Baseline of the vehicle that healthy flights show: noise of all and effects of the longest, each known from the other, by turns."""
    own, longest = of_vehicle(logs, ()), max(logs, key=lambda log: len(log.x))
    plain = own
    for _ in range(TURNS):
        found = Search(plain.path(longest, [(np.ones(len(longest.x), bool), own.whitener)], differ={})).run()
        own = of_vehicle(logs, acting(found.causes))
    return own


def path_of(log, without=(), healthy=()):
    """The Path of a flight beside healthy ones."""
    _, noise, parts = _shaken(log, baseline_of(healthy) if healthy else simulated())
    return noise.path(log, parts, without)


def diagnose(log, fresh=None, without=(), healthy=()):
    """The Diagnosis of a flight (bridge.Log); healthy: flights of this vehicle, which else is the simulated one."""
    check_effects(without, bridge.effects(name))
    shaking, noise, parts = _shaken(log, baseline_of(healthy) if healthy else simulated())
    if "vibration" in without:
        shaking = None
    found = answer(noise.path(log, parts, without))
    path, missed = found.path, _missed(found)
    innovations = [path.follow([*path.base, *acting(causes)])[0] for causes in ((), found.fit.causes)]
    unexplained, worse = _unexplained(found, shaking), _worse(found)
    pairs, hidden = open_questions(found)
    hidden = [effect for effect in hidden if effect not in {rival for _, rival in pairs}]
    advice = advise.advise(found.search, noise, pairs, hidden)
    report = {"platform": name} | report_of(found, where.located(found, missed[0], innovations[0], noise), hidden, unexplained) | {
        "channels": _channels(found, *missed),
        "contributions": _contributions(found),
        "suggested_excitation": f"{advice['drive']}: {advice['words']}" if advice else "",
        "vehicle": "own" if healthy else "simulated",
        "axis": "yaw" if turns_yaw(log) else "pitch",
        "advice": advice,
    }  # fmt: skip
    for effect in report["effects"]:
        effect["confidence"] *= DOUBTED if worse else 1 - unexplained["share"]
    if shaking:
        _add_vibration(report, shaking, log)
    if "vibration" in without:
        report["not_testable"] = [*hidden, "vibration"]
    report["verdict"] = _verdict(found, report["effects"], unexplained, worse)
    if report["verdict"] == "unknown":
        report["best_fit"], report["effects"] = report["best_fit"] or report["effects"], []
    result = Diagnosis(report, found, {"missed": missed, "innovations": innovations, "healthy": noise})
    if fresh is not None:
        check_on_fresh(result, noise.path(fresh))
    return result


def _missed(found):
    """What predictions miss (W, H, 9), without and with the causes."""
    before = found.path.ahead((), found.starts, ahead.HORIZONS)
    return before, ahead.missed(found.fitter, found.fit, found.starts) if found.fit.causes else before


def _channels(found, before, after):
    """RMS errors of each channel."""
    floor, row = found.path.noises.missed, lambda values: dict(zip(map(str, ahead.HORIZONS), map(float, values)))
    parts = {"before": ahead.rms(before), "after": ahead.rms(after), "noise_floor": floor}
    return {channel: {part: row(values[:, c]) for part, values in parts.items()} for c, channel in enumerate(CHANNELS)}


def _contributions(found):
    """{effect: {H: RMS change, rad, of the attitude predicted H rows ahead, with it}}: what it moves, free of noise."""
    causes, out = found.fit.causes, {}
    missed = found.path.ahead(causes, found.starts, ahead.HORIZONS)
    for i, cause in enumerate(causes):
        moved = ahead.moved(found.path, missed, causes[:i] + causes[i + 1 :], found.starts)["attitude"]
        out[cause.name] = dict(zip(map(str, ahead.HORIZONS), map(float, moved)))
    return out


def _worse(found):
    """Whether the effects make predictions worse than the simulator's on rows that they were not fitted on."""
    then, now = (ahead.rms(errors["attitude"][:, -1]) for errors in (found.before, found.after))
    return bool(now > WORSE * then)


def _unexplained(found, shaking):
    """What is left beside the effects: of predictions, and of what generic accelerations take of rows that they were not fitted on."""
    times, left, search = float(found.state.noise.sensor[0] ** 2), found.left, found.search
    box = openset.BlackBox(search, replace(found.state, fit=found.fit))
    taken, share = sum(box.share.values()), left.share if left.matters else 0.0
    if taken > SYSTEMATIC:
        share = max(share, taken / max(taken, sum(openset.BlackBox(search, search.base).share.values())))
    another = times > ANOTHER or (shaking is not None and not shaking.alike)
    matters = bool(left.matters or taken > SYSTEMATIC)
    return {
        "unit": left.unit, "gap": left.gap, "of_gap": left.of, "smallest_that_matters": left.smallest, "share": share, "matters": matters,
        "depends_on": box.depends() if matters else [], "another_vehicle": bool(another), "times_noise": times,
    }  # fmt: skip


def _verdict(found, effects, unexplained, worse):
    """The word of the contract."""
    left = unexplained["matters"] and (unexplained["share"] > judge.UNEXPLAINED or not found.fit.causes)
    if worse or unexplained["another_vehicle"] or left:
        return "unknown"
    return "known" if effects else "none"


def _add_vibration(report, shaking, log):
    """Vibration is measured: where there is some, it is beyond doubt."""
    report["effects"].append({
        "name": "vibration", "evidence": shaking.evidence, "confidence": 0.99 if shaking.alike else 0.2, "params": {"a": shaking.a},
        "params_ci95": {"a": [shaking.a - 1.96 * shaking.sd, shaking.a + 1.96 * shaking.sd]},
        "segments": inside((shaking.segment,), seconds(log)), "units": {"a": "1"}, "at_bound": [], "formula": bridge.formulas(name)["vibration"],
    })  # fmt: skip
    report["effects"].sort(key=lambda effect: -effect["evidence"])
    report["ranking"] = sorted([*report["ranking"], {"name": "vibration", "score": 2.0}], key=lambda row: -row["score"])
