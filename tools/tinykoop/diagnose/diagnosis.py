"""One log in, one answer out: the report of the contract and what its page draws."""

from dataclasses import dataclass, field

import numpy as np

from .. import bridge
from ..plumbing.errors import UserError
from . import advise, elsewhere, explain, features, measure, noise, verdict, where
from .fit import active
from .pieces import FEWEST, Pieces, cut, usual_rows
from .platform import PLATFORMS
from .robot import check_effects

FEWEST_ROWS = 60
ARTEFACT, SURE_ARTEFACT = 0.2, 0.08  # of half a step, to which a lateral skid is the integrator's; at first sight
PAYS, PAYS_AT_LEAST = 0.1, 0.1  # a cause must close that much: of the gap above the floor; of the smallest that matters
# where more is left than noise, that much of what is left, or of the whole gap: less may only mend the form of another
MENDS, MENDS_WHOLE = 0.5, 0.1
BELIEVED = 0.2  # confidence of the surest cause, below which nothing is known


@dataclass
class Diagnosis:
    """The report, and what was computed on the way that a page may draw."""

    report: dict
    log: bridge.Log
    pieces: Pieces
    fit: object
    before: measure.Windows
    after: measure.Windows
    floor: np.ndarray
    advice: tuple | None
    fresh_log: bridge.Log | None = None
    fresh_errors: tuple = field(default=())


def load(path, platform):
    """A log that is long enough to say something about."""
    log = bridge.read_log(path, platform.name)
    if log.usable.sum() < FEWEST_ROWS:
        raise UserError(
            f"{path}: {int(log.usable.sum())} usable transitions are too few for a diagnosis; record {FEWEST_ROWS} at least"
        )
    if not len(cut(log.usable, usual_rows(log.dt))[0]):
        raise UserError(f"{path}: nowhere are {FEWEST} rows in a row usable; record it with fewer gaps")
    if not np.any(np.abs(np.diff(log.x, axis=0)) > 0):
        raise UserError(f"{path}: the pose never changes; record a drive in which the robot moves")
    return log


def _stepped(platform, dt, integrator, causes, tolerance):
    """The integrator that a lateral skid among the causes is an artefact of; None if it is none."""
    skid = next((cause.params[0] for cause in causes if cause.name == "lateral_skid"), 0.0)
    for other in platform.integrators:
        expected = (other.skid - integrator.skid) * dt
        if other != integrator and abs(skid - expected) < tolerance * 0.5 * dt:
            return other
    return None


def _explained(platform, log, without, seed):
    """(pieces, Explanation). How the log was stepped is settled before any effect, and again if such a skid remains."""
    tried = [platform.integrators[0]]
    pieces = Pieces(platform, log, tried[0])
    search = explain.begin(pieces, without, seed)
    best = search.best(1)
    if "lateral_skid" in search.fitter.effects:
        skids = [search.single("lateral_skid")]
        if best.names != ("lateral_skid",):
            skids.append(search.fitter.add("lateral_skid", best))
        skid = min(skids, key=search.worth)
        other = _stepped(platform, log.dt, tried[0], skid.causes, SURE_ARTEFACT)
        if (
            other
            and search.worth(skid) < search.worth(search.base)
            and (best in skids or search.worth(skid) < search.worth(best))
        ):
            tried.append(other)
            pieces = Pieces(platform, log, other)
            search = explain.begin(pieces, without, seed)
    while True:
        found = explain.explain(search, without, seed)
        other = _stepped(platform, log.dt, tried[-1], found.fit.causes, ARTEFACT)
        if other is None or other in tried[1:] or len(tried) > 3:
            return pieces, found
        tried.append(other)
        pieces = Pieces(platform, log, other)
        search = explain.begin(pieces, without, seed)


def _paying(search, fit, starts):
    """(fit, gate, [fit without each cause]) without the causes that do not pay on rows they were not fitted on."""
    while True:
        gates = verdict.gate(search.pieces, fit.causes)
        sensor = noise.for_floor(search.pieces, gates.generic)
        heading = gates.channels != features.POSITION
        gaps = lambda f: measure.gaps(*measure.errors(search.fitter, f, starts, sensor), heading)  # noqa: E731
        before, after, least = gaps(fit)
        gates = verdict.stricter(gates, *measure.typical(*measure.errors(search.fitter, fit, starts, sensor)))
        if not fit.causes:
            return fit, gates, []
        doubtful = gates.p < verdict.SIGNIFICANT and len(fit.causes) > 1
        rests, gains = [], []
        for i in range(len(fit.causes)):
            rest = search.fitter.refine(search.fitter.fit_of(fit.causes[:i] + fit.causes[i + 1 :]), steps=5)
            without = gaps(rest)[1]
            gain = (without - after) / np.maximum(without - least, 1e-9)
            enough = (without - after > PAYS_AT_LEAST * gates.smallest) & (gain > PAYS)
            if doubtful:
                enough &= (gain > MENDS) | (without - after > MENDS_WHOLE * (before - least))
            rests.append(rest)
            gains.append((bool(enough[1:].any()), float(gain[1:].max())))
        if min(gains)[0]:
            return fit, gates, rests
        fit = rests[gains.index(min(gains))]


def _intervals(search, fit):
    """95 % intervals of all parameters (p, 2), robust to noise that differs between pieces; NaN without a gradient."""
    fitter, pieces = search.fitter, search.pieces
    J = fitter.jacobian(fit)
    by_piece = (J * fit.left[:, None]).reshape(len(pieces.starts), -1, J.shape[1]).sum(1)
    known = (J**2).sum(0) > 1e-6
    spread = np.full(J.shape[1], np.nan)
    if known.any():
        inverse = np.linalg.pinv(J[:, known].T @ J[:, known], rcond=1e-12)
        meat = by_piece[:, known].T @ by_piece[:, known]
        spread[known] = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), np.diag(inverse)))
    return fitter.vector(fit.causes)[:, None] + 1.96 * spread[:, None] * np.array([-1, 1])


def _threshold_interval(fitter, fit, index, price=3.84):
    """Where the cost of a parameter without a gradient rises by `price`: found by steps outwards."""
    z, ends = fitter.vector(fit.causes), []
    for sign in (-1, 1):
        step, edge = 1e-3, z[index]
        while step < 8:
            moved = z.copy()
            moved[index] = z[index] * (1 + sign * step)
            if fitter.fit_of(fitter.split(fit.causes, moved)).cost > fit.cost + price:
                break
            edge, step = moved[index], step * 2
        else:
            edge = np.inf if sign > 0 else 0.0
        ends.append(moved[index] if step < 8 else edge)
    return ends


def _effects(search, fit, proofs, log):
    """The `effects` of the report."""
    if not fit.causes:
        return []
    fitter, intervals, out, i = search.fitter, _intervals(search, fit), [], 0
    end = (len(log.x) - 1) * log.dt
    for cause, proof in zip(fit.causes, proofs):
        spec, scale = fitter.effects[cause.name][1], fitter.scale(cause)
        low, high = fitter.bounds(cause)
        limits = {}
        for k, parameter in enumerate(spec):
            interval = intervals[i + k]
            if not np.isfinite(interval).all():
                interval = _threshold_interval(fitter, fit, i + k)
            if cause.name == "lateral_skid":  # which integrator the robot is like, nothing tells then
                interval = interval + 0.5 * log.dt / scale[k] * np.array([-1, 1])
            limits[parameter.name] = [float(value) for value in np.clip(interval, low[k], high[k]) * scale[k]]
        i += len(spec)
        out.append(
            {
                "name": cause.name,
                "evidence": float(proof.worth),
                "confidence": proof.confidence,
                "params": {p.name: float(v) for p, v in zip(spec, cause.params)},
                "params_ci95": limits,
                "segments": [[float(max(a, 0.0)), float(min(b, end))] for a, b in cause.segments],
                "units": {p.name: p.unit for p in spec},
                "at_bound": fitter.held(cause),
            }
        )
    return out


def _contributions(search, fit, proofs, starts):
    """{effect: {H: rise of the gap, m, without it}}."""
    pieces = search.pieces
    arguments = pieces.platform, pieces.log, pieces.integrator
    whole = measure.rms(measure.windows(*arguments, fit.causes, starts).position)
    keys = [str(H) for H in measure.HORIZONS]
    return {
        cause.name: dict(
            zip(
                keys,
                map(float, measure.rms(measure.windows(*arguments, proof.without.causes, starts).position) - whole),
            )
        )
        for cause, proof in zip(fit.causes, proofs)
    }


def diagnose(log, platform=None, fresh=None, without=(), seed=0):
    """The Diagnosis of a log (bridge.Log); fresh: another log of the robot, on which nothing is fitted."""
    platform = platform or PLATFORMS["ddr"]()
    check_effects(without, platform.effects())
    pieces, found = _explained(platform, log, without, seed)
    fit, search, integrator = found.fit, found.search, pieces.integrator
    starts = measure.starts_of(log)
    fit, gates, rests = _paying(search, fit, starts)
    proofs = verdict.evidence(search, fit, gates, rests)
    plain = verdict.inside(search, fit, proofs)
    if plain is not fit:
        fit, gates, rests = _paying(search, search.fitter.refine(plain), starts)
        proofs = verdict.evidence(search, fit, gates, rests)
    word = verdict.verdict(fit, gates)
    if word == "known" and max(proof.confidence for proof in proofs) < BELIEVED:
        word = "unknown" if gates.fails else "none"
    if word == "none":
        fit, proofs = search.fitter.fit_of(()), []
    order = sorted(range(len(proofs)), key=lambda i: -proofs[i].worth)
    fit = search.fitter.fit_of(tuple(fit.causes[i] for i in order))
    proofs = [proofs[i] for i in order]
    before, after, least = measure.errors(search.fitter, fit, starts, noise.for_floor(pieces, gates.generic))
    blind_to = verdict.untestable(search, fit)
    pairs = [(cause, rival) for cause, proof in zip(fit.causes, proofs) for rival in proof.ambiguous]
    advice = advise.advise(search, pairs, blind_to)
    ranked = verdict.ranking(search, fit, proofs)
    report = {
        "platform": platform.name,
        "verdict": word,
        "effects": _effects(search, fit, proofs, log),
        "ranking": ([{"name": "measurement_noise", "score": 1.0}] if word == "none" else [])
        + [{"name": name, "score": float(score)} for name, score in ranked],
        "ambiguous_with": {c.name: list(proof.ambiguous) for c, proof in zip(fit.causes, proofs) if proof.ambiguous},
        "lookalikes": [{"effects": sorted(names), "as": what} for names, what in verdict.lookalikes(platform, fit).items()],
        "suggested_excitation": f"{advice[0]}: {advice[1]}" if advice else "",
        "where": {
            "channels": where.channels(before, least, log),
            "segments": where.segments(before, least, log, found.edges),
            "regions": where.regions(before, least, log, platform.commands(log.u)),
        },
        "gap": measure.summary(before, after, least, seed),
        "not_testable": blind_to,
        "contributions": _contributions(search, fit, proofs, starts),
        "unexplained": {
            "unit": "m" if gates.channels == features.POSITION else "rad",
            "gap_m": gates.after,
            "of_gap_m": gates.before,
            "smallest_that_matters_m": gates.smallest,
            "share": gates.share,
            "p": gates.p,
            "matters": bool(gates.fails),
            "depends_on": [{"on": on, "channel": channel, "share": share} for (on, channel), share in list(gates.generic.depends().items())[:4]],
        },
        "noise": {
            "sp": pieces.noise.sp, "st": pieces.noise.st, "rho_p": pieces.noise.rho_p, "rho_t": pieces.noise.rho_t,
            "tails_nu": found.nu,
        },
        "integrator": integrator.name,
        "log": {"rows": len(log.x), "dt": log.dt, "usable": float(log.usable.mean()), "seconds": (len(log.x) - 1) * log.dt}
        | ({"searched_rows": int(pieces.lengths.sum())} if len(log.x) > bridge.LONG else {}),
        "advice": {"drive": advice[0], "words": advice[1], "separation": advice[3]} if advice else None,
    }  # fmt: skip
    result = Diagnosis(report, log, pieces, fit, before, after, least, advice)
    if fresh is not None:
        _add_fresh(result, platform, integrator, fresh, seed)
    return result


def in_log_time(report, t0):
    """The report with segments in the log's own time, which need not begin at zero."""
    effects = [effect | {"segments": [[a + t0, b + t0] for a, b in effect["segments"]]} for effect in report["effects"]]
    where = report["where"] | {"segments": [[a + t0, b + t0, share] for a, b, share in report["where"]["segments"]]}
    return report | {"effects": effects, "where": where}


def _add_fresh(result, platform, integrator, fresh, seed):
    """The same fitted model on another log: only the noise is measured there, and whether that acts which came or went."""
    pieces, effects = Pieces(platform, fresh, integrator), platform.effects()
    pieces.set_noise(noise.third_differences(fresh))
    carried = elsewhere.carry(result.fit.causes, effects, (result.log, fresh), lambda causes: pieces.cost(active(causes)))
    causes = elsewhere.acting(carried)
    noise.estimate(pieces, active(causes))
    sensor = noise.for_floor(pieces, features.Generic(pieces, active(causes)))
    starts = measure.starts_of(fresh)
    parts = [measure.windows(platform, fresh, integrator, some, starts) for some in ((), causes)]
    least = measure.floor(sensor, fresh, starts)
    result.report["fresh"] = {"gap": measure.summary(*parts, least, seed), "effects": elsewhere.told(carried, effects)}
    result.fresh_log, result.fresh_errors = fresh, (*parts, least)
