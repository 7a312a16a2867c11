"""From fits to an answer: none, known or unknown; how sure; and what the log cannot tell.

The cause is never inferred from the improvement alone: what an explanation leaves is tested against
generic errors (features.py), which know nothing of effects.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from .features import HEADING, POSITION, Generic
from .fit import Fit, active
from .noise import trusted

SMALLEST = 0.002  # a gap below this share of the way driven, or turned, does not matter,
SMALLEST_NOISE = 0.5  # nor one below this share of the noise of a pose,
SMALLEST_TURN = 0.003  # rad, nor a heading by that little
SIGNIFICANT = 1e-4
STANDS_OUT = 1.3  # times the noise floor, from which a held-out error is more than an error of the floor
UNEXPLAINED = 0.1  # of the gap may be left and the effects still be called its explanation
ALIAS = 0.9  # of an effect's worth that another takes over: they may be the same
STEADY, UNSURE = 0.02, 0.5  # share that commands of one kind vary by; most confidence that such a log allows
MISSHAPEN = 0.8  # most confidence where what is left is not noise, for no effect has the robot's exact form then; or of lookalikes
RIVALS = 5  # that are fitted in full
TESTABLE = 3.0  # prices that an effect of usual size must be worth for its absence to mean anything


@dataclass(frozen=True)
class Gate:
    """The systematic gap, H rows ahead: how large it is and what the causes leave of it.

    In position (m); in heading (rad) where only that has a gap worth the name, as of a robot that turns on the spot.
    """

    generic: Generic
    channels: slice
    before: float  # without noise
    after: float
    moved: float  # what the causes make of it
    smallest: float  # that matters
    like_noise: bool  # what is left by generic errors too

    @property
    def p(self):
        return self.generic.significance()

    @property
    def share(self):
        """Of the gap that no effect explains."""
        return min(self.after / self.before, 1.0) if self.before > 0 else 0.0

    @property
    def fails(self):
        """Something systematic is left that matters."""
        return self.after > self.smallest and (self.p < SIGNIFICANT or not self.like_noise)

    @property
    def matters(self):
        return self.before >= self.smallest


def gate(pieces, causes, horizon=50):
    """Tests an explanation: by what generic errors find beside it, and by what it changes itself."""
    horizon = pieces.reach(horizon)
    before, after = Generic(pieces), Generic(pieces, active(causes))
    log, noise = pieces.log, pieces.noise
    way = np.hypot(*np.diff(log.x[:, :2], axis=0)[log.usable].T).mean() * horizon
    turn = np.abs(pieces.platform.commands(log.u)[:, 1]).mean() * horizon * log.dt
    position = _gate(pieces, before, after, causes, horizon, POSITION, max(SMALLEST * way, SMALLEST_NOISE * noise.sp))
    heading = _gate(
        pieces, before, after, causes, horizon, HEADING, max(SMALLEST * turn, SMALLEST_NOISE * noise.st, SMALLEST_TURN)
    )
    return heading if heading.matters and not position.matters else position


def _gate(pieces, before, after, causes, horizon, channels, smallest):
    left = after.gap(horizon, channels)
    changed = (before.residual - after.residual)[:, horizon, channels][pieces.inside[:, horizon]]
    moved = float(np.sqrt((changed**2).sum(-1).mean())) if len(changed) else 0.0
    gap = max(before.gap(horizon, channels), np.hypot(moved, left) if causes else 0.0)
    return Gate(after, channels, gap, left, moved, smallest, trusted(pieces, after))


def stricter(gates, after, floor):
    """The gate with what predictions on held-out rows still miss (m, and its noise), where that stands out of the noise."""
    if gates.channels != POSITION:
        return gates
    missed = np.sqrt(after**2 - floor**2) if after > STANDS_OUT * floor else 0.0
    return replace(gates, after=max(gates.after, float(missed)), before=max(gates.before, float(missed)))


def verdict(fit, gates):
    """The word of the contract."""
    if not gates.matters or (gates.moved < gates.smallest and not gates.fails):
        return "none"
    if gates.fails and (gates.share > UNEXPLAINED or not fit.causes):
        return "unknown"
    return "known" if fit.causes else "none"


@dataclass(frozen=True)
class Evidence:
    """What speaks for one cause of a fit."""

    worth: float  # rise of the cost without it, everything else fitted again
    absorbed: dict  # {rival: share of that worth it takes over}
    behind: dict  # {rival: how much worse the fit is with it instead}
    ambiguous: tuple
    confidence: float
    without: Fit = field(repr=False)
    instead: dict = field(repr=False)  # {rival: fit with it in the place of the cause} of the ambiguous


def evidence(search, fit, gates, rests):
    """[Evidence] for every cause: what happens without it (`rests`) and with each other effect in its place."""
    fitter, out = search.fitter, []
    for cause, rest in zip(fit.causes, rests):
        worth = rest.cost - fit.cost
        scans = {name: fitter.scan(name, rest, cause.segments)[0] for name in fitter.effects if name not in fit.names}
        fits = {}
        for name in sorted(scans, key=lambda name: scans[name].cost)[:RIVALS]:
            fits[name] = fitter.refine(fitter.coordinates(scans[name]))
        cost = {name: min(scan.cost, rest.cost) for name, scan in scans.items()} | {n: f.cost for n, f in fits.items()}
        absorbed = {name: float(np.clip((rest.cost - c) / max(worth, 1e-9), 0, 1)) for name, c in cost.items()}
        behind = {name: c - fit.cost for name, c in cost.items()}
        ambiguous = [n for n in fits if _alike(search, fit, fits[n], absorbed[n], behind[n], gates)]
        ambiguous += [n for n in _pair(search, rest, fit, fits, worth) if n not in ambiguous]
        rivals = [d for name, d in behind.items() if name not in ambiguous] + [worth]
        sure = min(_confidence(rivals, fit, gates), UNSURE if steady(search.pieces) else 1.0)
        if any(cause.name in names for names in lookalikes(search.pieces.platform, fit)):
            sure = min(sure, MISSHAPEN)
        instead = {name: fits[name] for name in ambiguous}
        out.append(Evidence(worth, absorbed, behind, tuple(ambiguous), sure, rest, instead))
    return out


def inside(search, fit, proofs):
    """The fit, or the best that has another effect in the place of one at its bound and does the same with none there."""
    held = [i for i, cause in enumerate(fit.causes) if search.fitter.held(cause)]
    others = [other for i in held for other in proofs[i].instead.values()]
    plain = [other for other in others if not any(search.fitter.held(cause) for cause in other.causes)]
    return min(plain, key=search.worth, default=fit)


def lookalikes(platform, fit):
    """{names: what they look like together} of the causes of a fit."""
    return {names: what for names, what in platform.lookalikes.items() if names <= set(fit.names)}


def _alike(search, fit, rival, absorbed, behind, gates):
    """Whether the log leaves it open which of the two it is."""
    if absorbed < 0.5:
        return False
    if behind < search.price:
        return True
    if absorbed < ALIAS:
        return False
    left = Generic(search.pieces, active(rival.causes)).gap(search.pieces.reach(50), gates.channels)
    return left < max(gates.smallest, 2 * gates.after)


def _pair(search, rest, fit, fits, worth):
    """Two effects that together do the same, as equal gains on both axes do for a clock."""
    names = sorted(fits, key=lambda n: fits[n].cost)[:2]
    if len(names) < 2:
        return []
    both = search.fitter.add(names[1], fits[names[0]])
    if both.cost - fit.cost < search.price and min(rest.cost - fits[n].cost for n in names) > 0.05 * worth:
        return names
    return []


def steady(pieces):
    """Whether one command was held all along: then a few constants explain everything, and so does almost any effect."""
    u = pieces.platform.commands(pieces.log.u)
    return bool(np.all(np.std(u, axis=0) <= STEADY * (np.abs(u).max(0) + 1e-9)))


def _confidence(rivals, fit, gates):
    """Probability that the cause is right: against its rivals, less what nothing explains."""
    heat = 2 * max(1.0, gates.generic.scale) * (1 + 50 * gates.share)
    odds = sum(np.exp(-min(max(d, 0) / heat, 700)) for d in rivals)
    sure = 1 / (1 + odds)
    return float(sure * (1 - min(gates.share, 1.0)) * (MISSHAPEN if gates.fails or gates.p < SIGNIFICANT else 1.0))


def untestable(search, fit):
    """Effects that would not show in this log at their usual size, beside those that were found."""
    fitter, out = search.fitter, []
    if not fitter.effects:
        return out
    J = fitter.jacobian(fit) if fit.causes else np.zeros((len(fit.left), 0))
    q = np.linalg.qr(J)[0] if J.shape[1] else J
    for name, (_, parameters) in fitter.effects.items():
        if name in fit.names:
            continue
        cause, _ = fitter.rays(name)
        g = fitter.left((*fit.causes, replace(cause, params=tuple(p.usual for p in parameters)))) - fit.left
        g = g - q @ (q.T @ g)
        if g @ g < TESTABLE * search.price:
            out.append(name)
    return out


def ranking(search, fit, proofs):
    """[(name, score)]: the causes by their worth, then the others by how much of a cause's worth they would take."""
    whole = max(search.base.cost - min(fit.cost, search.base.cost), 1e-9)
    score = {c.name: 1 + proof.worth / whole for c, proof in zip(fit.causes, proofs)}
    for name in search.fitter.effects:
        if name not in score:
            alone = search.fits.get(frozenset([name]))
            gain = (search.base.cost - alone.cost) / whole if alone and not fit.causes else 0
            score[name] = max([gain, *(proof.absorbed.get(name, 0) * proof.worth / whole for proof in proofs)])
    return sorted(score.items(), key=lambda item: -item[1])
