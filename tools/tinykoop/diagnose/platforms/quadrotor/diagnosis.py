"""One flight in, one answer out: what it shows on average beside healthy flights, and how far predictions are off."""

from types import SimpleNamespace

import numpy as np

from .... import bridge
from ....plumbing.errors import UserError
from ... import where
from ...diagnosis import Diagnosis, compare, gaps
from ...elsewhere import seconds
from ...prediction_errors import ahead
from ...robot import check_effects
from ...robots import vehicle_of
from . import advise, baseline, features, path
from .changes import Changes
from .features import NAMES, TABLE

name = "quadrotor"
SLOWEST = 0.05  # s between rows, at most: requests change faster than that
SMALLEST = 0.1  # of what predictions of healthy flights miss: a smaller gap does not matter
LOST = {"attitude": 0.35, "velocity": 1.5}  # rad and m/s, that predictions of healthy flights miss where they are lost
AXES = ("thrust", "roll", "pitch", "yaw")
DECIDED = 0.5  # probability of a cause and what may be it instead, from which on it is named


def load(file):
    """A flight with requests often enough."""
    log = bridge.read_log(file, name)
    if log.dt > SLOWEST:
        raise UserError(f"{file}: rows come every {log.dt:.3g} s; log the requests of the rotors at {1 / SLOWEST:g} Hz at least")
    if not np.any(np.diff(log.u[:, :4], axis=0)):
        raise UserError(f"{file}: m1 to m4 never change; log the thrust that is asked of each rotor, 0 to 1")
    return _of(log, file)


def _of(log, file):
    """The log and its Features, in one."""
    return SimpleNamespace(t=log.t, x=log.x, u=log.u, usable=log.usable, dt=log.dt, path=str(file))


def read(file, fresh=None, healthy=(), robot=name, sim=None):
    """(the log, what diagnose() takes beside it)."""
    vehicle = vehicle_of(robot or name)
    bridge.quadrotor_vehicle(vehicle)
    return load(file), {"fresh": load(fresh) if fresh else None, "healthy": [load(one) for one in healthy], "vehicle": vehicle}


def diagnose(log, fresh=None, without=(), healthy=(), vehicle="crazyflie"):
    """The Diagnosis of a flight (bridge.Log, with `path`); healthy: flights of this vehicle, which else is the simulated one."""
    check_effects(without, bridge.effects(name))
    flight = features.of(log)
    known = baseline.of_vehicle([features.of(one) for one in healthy]) if healthy else baseline.simulated(vehicle)
    base = path.base_of(known.flights, vehicle) if healthy else ()
    changes = Changes(flight, known, bridge.quadrotor_vehicle(vehicle), tuple(without))
    along = path.Path(log, vehicle, base)
    others = [path.Path(one, vehicle, base) for one in healthy] or path.simulated(vehicle)
    return _diagnosed(changes, along, others, fresh, known.own, len(healthy))


def _diagnosed(changes, along, others, fresh, own, healthy):
    effects, open_ = _effects(changes, along)
    causes = _acting([*effects, *open_], along.vehicle)
    before, after = along.errors(), along.errors(causes)
    floor = _floor(along, changes, others)
    before, after = (_within_reach(errors, floor) for errors in (before, after))
    found = SimpleNamespace(path=along, starts=along.starts, before=before, after=after, floor=floor)
    left = _left(changes, before, floor, along)
    report = {
        "platform": name, "verdict": _verdict(effects, open_, changes), "effects": effects, "best_fit": [*effects, *open_] if open_ else [],
        "small": [], "ranking": [{"name": n, "score": float(p)} for n, p in changes.ranking()],
        "ambiguous_with": {e["name"]: rivals for e in [*effects, *open_] if (rivals := changes.rivals(e["name"]))}, "lookalikes": [],
        "suggested_excitation": "", "where": _where(changes, found), **gaps(along, before, after, floor), "shares": None,
        "not_testable": _not_testable(changes), "unexplained": left,
        "noise": {"sensor": {}, "process": {}, "motion": "", "outliers": 0},
        "log": {"rows": len(along.log.x), "dt": along.log.dt, "usable": float(along.log.usable.mean()), "seconds": seconds(along.log),
                "cautions": []},
        "healthy": {"logs": healthy, "effects": [{"name": e.name, "params": list(e.parameters)} for e in along.base]},
        "contributions": {}, "vehicle": "own" if own else "simulated", "steady": changes.flight.seconds,
        "features": _features(changes), "smallest": changes.smallest() if "balance" in changes.known else {},
        "unchanged": changes.healthy_probability,
    }  # fmt: skip
    report["advice"] = advice = advise.advise(changes, report["ambiguous_with"], along.vehicle)
    report["suggested_excitation"] = f"{advice['drive']}: {advice['words']}" if advice else ""
    result = Diagnosis(report, found, {"changes": changes})
    if fresh is not None:
        compare(report, _on_fresh(causes, effects, path.Path(fresh, along.vehicle, along.base), changes, others))
    return result


def _effects(changes, along):
    """(effects that are named, those of which too many others may be the cause)."""
    named, open_, formulas, rows = [], [], bridge.formulas(name), bridge.quadrotor_effects(along.vehicle)
    for cause in changes.named:
        told = {
            "name": cause.name, "evidence": cause.evidence, "confidence": changes.confidence(cause),
            "params": {n: value for n, (value, _) in cause.params.items()}, "params_ci95": {n: ends for n, (_, ends) in cause.params.items()},
            "units": {row[0]: row[1] for row in rows[cause.name][1]}, "at_bound": [], "segments": [[0.0, seconds(along.log)]],
            "formula": formulas[cause.name],
        }  # fmt: skip
        (named if changes.decided(cause) >= DECIDED else open_).append(told)
    return named, open_


def _acting(effects, vehicle):
    """Effects as the simulator takes them: within their bounds, what has no value at its usual size."""
    rows, out = bridge.quadrotor_effects(vehicle), []
    for effect in effects:
        values = [float(np.clip(effect["params"].get(n, usual), low, high)) for n, _, low, high, usual in rows[effect["name"]][1]]
        out.append(bridge.Effect(effect["name"], tuple(values)))
    return out


def _floor(along, changes, others):
    """{gap: errors (S, H)} that healthy flights have, too; those of the vehicle itself also by how days differ."""
    least = path.floor_of(others, along.gaps)
    days = path.of_days(along, changes.spread_of_requests) if changes.baseline.own else dict.fromkeys(along.gaps, 0.0)
    shape = len(along.starts), len(ahead.HORIZONS)
    return {gap: np.broadcast_to(np.hypot(least[gap], ahead.rms(np.broadcast_to(days[gap], shape))), shape) for gap in along.gaps}


def _within_reach(errors, floor):
    """Errors, NaN at horizons at which even those of healthy flights say nothing: unstable, and without a gyro hardly known."""
    return {gap: np.where(floor[gap] < LOST[gap], part, np.nan) for gap, part in errors.items()}


def _verdict(effects, open_, changes):
    """The word of the contract."""
    if not effects and not open_ and not changes.unexplained:
        return "none"
    if not effects:
        return "unknown"
    return "partly" if open_ or changes.unexplained else "known"


def _left(changes, before, floor, along):
    """The `unexplained` of the report."""
    gap, (unit, _) = next(iter(along.gaps.items()))
    seen = np.flatnonzero(np.isfinite(before[gap]).any(0))
    off, least = (ahead.rms(part[gap])[seen[-1]] if len(seen) else np.nan for part in (before, floor))
    beyond = float(np.sqrt(max(off**2 - least**2, 0.0))) if np.isfinite(off) and np.isfinite(least) else 0.0
    blocks = changes.unexplained
    return {
        "unit": unit, "gap": beyond if blocks else 0.0, "of_gap": beyond, "smallest_that_matters": float(SMALLEST * np.nan_to_num(least)),
        "share": float(len(blocks) / max(len(changes.best), 1)), "matters": bool(blocks),
        "depends_on": [{"on": block, "channel": block, "share": 1.0 / len(blocks)} for block in blocks],
    }  # fmt: skip


def _where(changes, found):
    """Shares of what differs from healthy flights, by axis and in time."""
    sizes = np.zeros(4)
    for d, variances in map(changes.difference, changes.healthy):
        sizes += np.nan_to_num(np.maximum(d[:4] ** 2 / variances[:4] - 1, 0)) / len(changes.healthy)
    gap = next(iter(found.path.gaps))
    over = np.maximum(np.nan_to_num(found.before[gap] ** 2 - found.floor[gap] ** 2), 0).sum(1)
    return {
        "channels": where.shares(AXES, sizes), "regions": [],
        "segments": where.parts(over, found.path.t[found.starts], seconds(found.path.log)) if len(over) else [],
    }  # fmt: skip


def _features(changes):
    """[{name, unit, flight, healthy, spread, times}] of what is compared."""
    out, mean = [], baseline.mean_of(np.array([one.values for one in changes.healthy]))
    variances = np.mean([changes.difference(one)[1] for one in changes.healthy], axis=0)
    for i, title in enumerate(NAMES):
        if any(i in known for known in changes.known.values()):
            sd = float(np.sqrt(variances[i]))
            row = {
                "name": title,
                "unit": TABLE[title][0],
                "flight": float(changes.flight.values[i]),
                "healthy": float(mean[i]),
                "spread": sd,
            }
            out.append(row)
    return out


def _not_testable(changes):
    """Effects that show only in what this log lacks."""
    told = {name for every in changes.explanations.values() for one in every for name in one.causes}
    answers = {NAMES[i] for i in changes.known.get("answer", ())}
    hidden = {"motor_lag", "transport_delay"} if not answers & {"lag", "delay"} else set()
    return [effect for effect in bridge.effects(name) if effect not in changes.without and (effect not in told or effect in hidden)]


def _on_fresh(causes, effects, there, changes, others):
    """The `fresh` of the report, on another flight: nothing is fitted there."""
    before, after = there.errors(), there.errors(causes)
    floor = _floor(there, changes, others)
    before, after = (_within_reach(errors, floor) for errors in (before, after))
    return {**gaps(there, before, after, floor), "effects": [{**e, "acts": True} for e in effects]}
