"""What a search says: which causes matter, how sure each is, which others do as well, and whether something is left."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from . import ahead
from .candidates import first_forms
from .fit import SLOPE, Cause, Fit
from .profiles import SLOPES_BY, Profile

PAYS, ENOUGH = 0.1, 0.1  # of the gap above the floor, that a cause must close at one of the horizons; of the smallest that matters
UNEXPLAINED = 0.1  # of the gap may be left and the effects still be its explanation
BELIEVED = 0.2  # confidence of the surest cause, below which nothing is known
ESTABLISHED = 0.5  # confidence that a cause or what cannot be distinguished from it acts, from which on it is named
SAME = 6.0  # squares, by which two explanations may differ and be one
CANCELS = 0.5  # of the size of all effects, that others may have which do the same: large ones that cancel are one by another name
RIVALS = 5  # that are fitted in full
PLAIN = "plain functions"  # as a rival of causes
USUAL, STANDS_OUT = 0.95, 1.3  # share of predictions that are not the worst; times the noise, that they may be off
STRETCHES, CLEARLY = 20, 2.5  # parts of a log; standard errors, by which they must show that something can be predicted
# Odds that a cause acts, as they are on logs of the blind plant:
EVEN = 40.0  # squares, at which they are even
MISFIT, MISFITS = 0.08, 1 / 3  # of the main cause's squares, that its form may miss and another take; of all rows, and no more
MAIN, OTHER = 3.0, 5.0  # growth of their logarithm by decade of squares, of the main cause; of another
OF_STEADINESS, STEADY = 15.0, 0.9  # the same by share of stretches in which squares are gained; share at which that counts for nothing
OF_CHANCE = 3.0  # the same by standard error of the mean gain, below what is clear
DOUBT = 0.8  # of a confidence stays where something is left
HINTS = 0.03  # share of the gap that is left, from which on the effects may be others
UNSURE = 0.5  # most confidence where one command was held throughout
MISTAKABLE = 0.8  # most confidence beside an effect that does nearly the same
CORRELATED, LAGS = 0.2, 4  # innovations more correlated than that, so many rows apart, are not those of the noise that is told
SHOWN, UNTOLD = 1e-6, 1e-12  # squares that a usual size must be worth to have a slope; share of them that is round-off
ALONE = 0.1  # of what is told of a parameter, that other blocks tell at least: a block by itself has no residual to judge by
FEWEST = 2.5  # blocks that must tell of a size: else noise alone is believed, as of a gust, of which the block that has it tells all
TESTABLE = 3.0  # prices that an effect of usual size must be worth for its absence to mean anything


@dataclass(frozen=True)
class Proof:
    """Of one cause: what its absence would cost, how sure it is (0 to 1), which others may be it, and what it does to predictions."""

    worth: float
    confidence: float
    others: tuple
    rest: Fit
    absorbed: dict
    any_name: float  # how sure it is that it is this cause or one of the others


@dataclass(frozen=True)
class Left:
    """What is left: systematic or the robot's own random motion, at the longest horizon."""

    gap: float
    of: float
    smallest: float
    unit: str
    white: bool = True

    @property
    def share(self):
        return min(self.gap / self.of, 1.0) if self.of > 0 else 0.0

    @property
    def shows(self):
        """Whether it is more than the noise of a sensor."""
        return self.gap > self.smallest or not self.white

    @property
    def matters(self):
        return self.gap > self.smallest and self.share > UNEXPLAINED


def dropped(fitter, fit):
    """[fit without each cause]."""
    return [fitter.refine(fitter.fit_of(fit.causes[:i] + fit.causes[i + 1 :]), 5) for i in range(len(fit.causes))]


def rivals(search, fit, rest, i, count=RIVALS):
    """[fits with another effect instead of cause i], of so many that are likeliest."""
    fitter, effects = search.fitter, search.path.effects
    mine = effects[fit.causes[i].name].reported_as
    found = [(promise, c) for promise, c in search.candidates(rest) if effects[c.name].reported_as != mine]
    likely = [replace(c, segments=fit.causes[i].segments) for c in first_forms(effects, found, count)]
    return [fitter.refine(fitter.fit_of((*rest.causes, c)), 6) for c in likely]


def _pair(search, fit, rivals, name):
    """Two effects that together do the same as one, as equal gains on both axes do for a clock."""
    first, effects = min(rivals, key=lambda f: f.cost, default=fit), search.path.effects
    if first.cost - fit.cost < search.price:
        return []
    mine = effects[name].reported_as
    second = next((c for _, c in search.candidates(first) if effects[c.name].reported_as != mine), None)
    if second is None or effects[second.name].kin == effects[name].kin == effects[first.names[-1]].kin:
        return []  # as of lags: one on both axes is two, one on each
    both = search.fitter.refine(search.fitter.fit_of((*first.causes, second)))
    return [effects[c.name].reported_as for c in both.causes[-2:]] if both.cost - fit.cost < search.price else []


def all_rivals(search, fit, rests):
    """[fits with another effect in the place] of each cause."""
    return [rivals(search, fit, rest, i) for i, rest in enumerate(rests)]


def preferred(search, state, fit, every):
    """The fit with the preferred name of each cause, of those that do the same, and with small effects instead of large ones that cancel.

    every: all_rivals().
    """
    prefer = search.path.preference
    for cause, rivals in zip(fit.causes, every):
        close = [r for r in rivals if r.cost < fit.cost + search.price]
        close = [r for r in close if prefer(r.causes[-1].name) < prefer(cause.name) or _size(search, r) < CANCELS * _size(search, fit)]
        for rival in sorted(close, key=lambda r: (prefer(r.causes[-1].name), _size(search, r))):
            search.at(state)
            exact = search.exact(rival)
            if exact.cost < fit.cost + SAME:
                return exact
    search.at(state)
    return fit


def _size(search, fit):
    """Of all effects together, in usual sizes."""
    return float(np.linalg.norm(search.fitter.vector(fit.causes)[0]))


def steadiness(fit, rest):
    """(the share that a cause gains of what it gains and loses from one stretch of the log to the next, standard errors of the mean gain)."""
    gains = np.array([part.sum() for part in np.array_split(rest.left**2 - fit.left**2, STRETCHES)])
    errors = gains.mean() / max(gains.std(ddof=1) / np.sqrt(STRETCHES), 1e-12)
    return float(np.maximum(gains, 0).sum() / max(np.abs(gains).sum(), 1e-12)), float(errors)


def certainty(path, worth, main, steadiness, left, alike):
    """How sure it is that a cause acts, if no rival does.

    worth: squares that its absence costs; main: those of the cause that is worth most; alike: whether it is a lookalike. What the form of
    the main cause misses, others may take: they must be worth more than that.
    """
    if not path.calibrated:
        return (1 - left.share) * (DOUBT if left.shows or alike else 1.0)
    doubted = EVEN if worth == main else np.clip(MISFIT * main, EVEN, MISFITS * np.isfinite(path.present).sum())
    share, errors = steadiness
    odds = (MAIN if worth == main else OTHER) * np.log10(max(worth, 1.0) / doubted) + OF_STEADINESS * (share - STEADY)
    odds += OF_CHANCE * min(errors - CLEARLY, 0.0)
    unclear = alike or not left.white or left.share > HINTS or (left.shows and not path.wanders)
    return float(special.expit(odds)) * (DOUBT if unclear else 1.0)


def confidences(path, sure, left, behind, others, absorbed=0.0):
    """(confidence in a cause, that it is this one or one of `others`), if it is so sure that it acts should no rival.

    behind: {rival: squares, by which it is worse}, "" being none; absorbed: largest share of what the cause does that a rival takes.
    """
    heat = 2.0 * (1 + 50 * left.share * (not path.calibrated))
    odds = {name: np.exp(-min(max(worse, 0) / heat, 700)) for name, worse in behind.items()}
    same = sum(odds.pop(name, 0.0) for name in others)
    sure *= (1 - left.share * left.matters) / (1 + sum(odds.values()))
    sure = min(sure, UNSURE if path.steady else 1.0, MISTAKABLE if absorbed > path.alias else 1.0)
    return float(sure / (1 + same)), float(sure)


def unmatched(fitter, fit, rests, box):
    """Squares that the absence of each cause costs where the functions of a box, which add to the causes, may do what it did.

    What a function does as well is no evidence of the one form that a cause has.
    """
    stands = box.functions.white(box.functions.pushes[..., box.beside.chosen])

    def least(some):
        Q = np.linalg.qr(np.hstack([fitter.jacobian(some), stands]))[0]
        return some.cost - ((Q.T @ some.left) ** 2).sum()

    return [max(least(rest) - least(fit), 0.0) for rest in rests]


def proofs(search, fit, rests, every, left, box, plain):
    """[Proof] of each cause of a fit.

    every: all_rivals(); box: the BlackBox of what the causes leave; plain: squares and price, by which plain functions instead are worse.
    """
    out, worths = [], [max(rest.cost - fit.cost, 0.0) for rest in rests]
    alone = np.minimum(worths, unmatched(search.fitter, fit, rests, box)) if box.shows else worths
    for i, (rest, rivals, worth) in enumerate(zip(rests, every, worths)):
        called = lambda r: search.path.effects[r.causes[-1].name].reported_as  # noqa: E731
        absorbed = {called(r): float(np.clip((rest.cost - r.cost) / max(worth, 1e-9), 0, 1)) for r in rivals}
        behind = {called(r): r.cost - fit.cost for r in rivals}
        others = [n for n, d in behind.items() if (d < search.price and absorbed[n] > 0.5) or absorbed[n] > search.path.alias]
        others += [n for n in _pair(search, fit, rivals, fit.causes[i].name) if n not in others]
        alike = any(fit.causes[i].name in names for names in search.path.lookalikes if names <= set(fit.names))
        sure = certainty(search.path, alone[i], max(alone), steadiness(fit, rest), left, alike)
        most = max(absorbed.values(), default=0)
        confidence, any_name = confidences(search.path, sure, left, {**behind, "": worth, PLAIN: plain}, others, most)
        out.append(Proof(float(worth), confidence, tuple(others), rest, absorbed, any_name))
    return out


def floors(path, noise, before, after, boxed, starts):
    """{gap: errors (S, H)} that no simulator of this robot avoids: what the sensor and the robot's own random motion make of predictions.

    What plain functions predict is not random. before, after, boxed: {gap: errors (S, H)} of the nominal simulator, with causes, and
    with causes and what plain functions predict.
    """
    sensor, moving = (ahead.floor(path, n, starts) for n in (noise.quiet(path), noise))
    out = {}
    for gap in path.gaps:
        reached = np.minimum.reduce([ahead.rms(errors[gap]) for errors in (before, after, boxed)])
        most = np.maximum(reached, ahead.rms(sensor[gap]))
        with np.errstate(invalid="ignore"):
            out[gap] = np.maximum(moving[gap] * np.fmin(most / ahead.rms(moving[gap]), 1.0), sensor[gap])
    return out


def surely(path, box, floor, starts):
    """floors() without random motion that may be what the forms of causes miss, as a line where the robot has a curve.

    Random is at most what is left beside plain functions, and what the robot can do at random.
    """
    noise = path.random(box.beside.noise)
    sensor, least = (ahead.floor(path, n, starts) for n in (noise.quiet(path), noise))
    return {gap: np.maximum(np.fmin(floor[gap], least[gap]), np.fmin(floor[gap], sensor[gap])) for gap in path.gaps}


def left(search, state, before, after, boxed, floor, box, starts):
    """The Left of a state: what plain functions predict of what causes leave, or what noise does not make of that, if that is more.

    In the path's first gap; in the second where only that one is worth the name, as of a robot that turns on the spot.
    """
    path = search.path
    noises = state.noise.quiet(path), state.noise
    parts = before, after, boxed, floor, *(ahead.floor(path, noise, starts) for noise in noises)
    moved = box.moved if box.shows and box.moved else {gap: np.zeros_like(before[gap]) for gap in path.gaps}
    found = [_left_in(path, state.noise, [part[gap] for part in (*parts, moved)], gap) for gap in path.gaps]
    found = next((one for one in found if one.of >= one.smallest), found[0])
    return replace(found, white=_white(state.fit.left.reshape(path.present.shape)))


def _white(left):
    """Whether innovations (K, c) hardly correlate from row to row: else the noise is of another kind."""
    chance = 4 / np.sqrt(max((left != 0).sum(), 1))
    lags = [(left[lag:] * left[:-lag]).sum(0) / np.maximum((left**2).sum(0), 1e-12) for lag in range(1, LAGS + 1)]
    return bool(np.abs(lags).max() < max(CORRELATED, chance))


def _left_in(path, noise, parts, gap):
    """The Left of one gap, at that of the longer horizons where the larger share is left."""
    seen = np.flatnonzero(np.isfinite(parts[0]).any(0))[1:][-2:]
    found = [_left_at(path, noise, *parts, gap, h) for h in (seen if len(seen) else [0])]
    return max(reversed(found), key=lambda one: one.matters * one.share)


def _left_at(path, noise, before, after, boxed, floor, still, moving, pushed, gap, h):
    usual = after[:, h] <= np.nanquantile(after[:, h], USUAL) if np.isfinite(after[:, h]).any() else slice(0)  # outliers prove nothing
    missed, noisy = ahead.rms(after[usual, h]), ahead.rms(moving)[h]
    surely = not path.calibrated or _better(after[usual, h], moving[usual, h])
    unmodelled = _apart(missed, noisy) if missed > STANDS_OUT * noisy and surely else 0.0
    moved, least = (0.0, floor) if path.wanders else (_apart(noisy, ahead.rms(still)[h]), still)
    predicted = _apart(ahead.rms(after)[h], ahead.rms(boxed)[h]) if _better(after[:, h], boxed[:, h]) else 0.0
    predicted = max(predicted, min(ahead.rms(pushed)[h], missed))
    gap_left, of = max(unmodelled, predicted, moved), _apart(ahead.rms(before)[h], ahead.rms(least)[h])
    return Left(gap_left, max(gap_left, of), float(path.smallest_of(gap, noise, ahead.HORIZONS[h])), path.gaps[gap][0])


def _apart(size, other):
    """Root of the difference of two mean squares."""
    return float(np.sqrt(max(size**2 - other**2, 0.0)))


def _better(errors, others):
    """Whether others are smaller by more than they vary from one stretch of the log to the next."""
    gained = errors**2 - others**2
    means = [part.mean() for part in np.array_split(gained[np.isfinite(gained)], STRETCHES) if len(part)]
    return len(means) > 1 and np.mean(means) > CLEARLY * np.std(means, ddof=1) / np.sqrt(len(means))


def established(path, proof):
    """Whether a cause is named, by itself or with what this log cannot distinguish from it."""
    return proof.any_name >= (ESTABLISHED if path.calibrated else BELIEVED)


def verdict(path, proved, left):
    """The word of the contract. What may act, and is not sure enough to be named, is no reason to call the simulator right."""
    surest = max((proof.any_name for proof in proved), default=0.0)
    if surest < BELIEVED and not left.matters:
        return "none"
    if left.matters:
        return "partly" if path.calibrated and surest >= path.partial else "unknown"
    return "known" if any(established(path, proof) for proof in proved) else "unknown"


def threshold_interval(fitter, fit, index, price=3.84):
    """Where the cost of a parameter without a slope rises by `price`, whatever the others make up for: found by steps outwards."""
    z, ends, others = fitter.vector(fit.causes)[0], [], _others(fitter, fit, index)
    cost = lambda trial: trial.cost - ((others.T @ trial.left) ** 2).sum()  # noqa: E731
    most = cost(fit) + price * (1 + fitter.path.doubt(fit.causes) ** 2)
    for sign in (-1, 1):
        step, edge = 1e-3, z[index]
        while step < 8:
            moved = z.copy()
            moved[index] = z[index] * (1 + sign * step)
            if cost(fitter.fit_of(fitter.split(fit.causes, moved))) > most:
                break
            edge, step = moved[index], step * 2
        else:
            edge = np.inf if sign > 0 else 0.0
        ends.append(moved[index] if step < 8 else edge)
    return ends


def profile(profiled, fit, index, spread=1.0, begin=0.0):
    """The interval of one size by a Profile, with the size that is told, which guesses of curves may have moved."""
    low, high = profiled.interval(index, spread, begin)
    told = profiled.fitter.vector(fit.causes)[0][index]
    return [min(low, told), max(high, told)]


def band(profiled, fit, i):
    """(commands (M, n), what curve i takes from each velocity there (M, c), its 95 % band (M, c, 2)), pointwise; None if it is no curve.

    Sizes of a curve make up for one another, so what they do is known far better than each of them, and is nearly linear.
    """
    fitter, best, curve = profiled.fitter, profiled.best, profiled.fitter.path.curve(fit.causes[i])
    if curve is None:
        return None
    commands, takes = curve
    told, centre = (takes(causes[i].params) for causes in (fit.causes, best.fit.causes))
    slopes = [takes(fitter.split(fit.causes, best.sizes + by)[i].params) - centre for by in _inwards(profiled)]
    size = np.sqrt((best.J**2).sum(0))
    shown = size**2 > SHOWN
    G = (np.reshape(slopes, (len(slopes), -1)) / _inwards(profiled).sum(1)[:, None] / np.maximum(size, SHOWN)[:, None])[shown].T
    half = _halves(best.J[:, shown] / size[shown], best.fit.left, fitter.block, G).reshape(centre.shape)
    half *= np.hypot(1, fitter.path.doubt(fit.causes))
    return commands, told, np.stack([np.minimum(centre - half, told), np.maximum(centre + half, told)], -1)


def _inwards(profiled):
    """Small moves (p, p) of each size, away from a bound."""
    return np.diag(np.where(profiled.best.sizes + SLOPES_BY <= profiled.high, SLOPES_BY, -SLOPES_BY))


def _half_by_noise(fitter, fit, index):
    J = fitter.jacobian(fit)
    Q = _others(fitter, fit, index)
    alone = J[:, index] - Q @ (Q.T @ J[:, index])
    return 1.96 / max(np.sqrt(alone @ alone), 1e-12)


def _others(fitter, fit, index):
    """Orthonormal columns (n, r): what all parameters but this one can make of the residual."""
    J = np.delete(fitter.jacobian(fit), index, axis=1)
    return np.linalg.qr(J[:, (J**2).sum(0) > SLOPE])[0]


def _closes(path, noise, without, now, least):
    """Largest share of what is left above the floor that a cause closes; 0 where it moves predictions by less than matters.

    without, now: predictions miss so much (S, H, c) without the cause and with it.
    """
    shares, (then, now, moved) = [0.0], (ahead.sizes(path, missed) for missed in (without, now, without - now))
    for gap in path.gaps:
        smallest = path.smallest_of(gap, noise)
        a, b, f, way = (ahead.rms(errors[gap])[1:] for errors in (then, now, least, moved))
        enough = (a - b > ENOUGH * smallest) & (way > smallest)
        shares.append(np.nanmax(np.where(enough, (a - b) / np.maximum(a - f, 1e-9), 0), initial=0))
    return float(max(shares))


def _is_tiny(path, cause):
    """Whether all parameters of a cause are a small part of their usual sizes."""
    return all(abs(v) < path.tiny * abs(p.usual) for v, p in zip(cause.params, path.effects[cause.name].parameters))


def paying(search, state, starts):
    """(the state without causes that do not pay on rows that they were not fitted on, these)."""
    path, small = search.path, []
    while state.causes:
        fitter = search.at(state)
        rests, least, now = dropped(fitter, state.fit), ahead.floor(path, state.noise, starts), ahead.missed(fitter, state.fit, starts)
        shares = [_closes(path, state.noise, ahead.missed(fitter, rest, starts), now, least) for rest in rests]
        shares = [0.0 if _is_tiny(path, cause) else share for cause, share in zip(state.causes, shares)]
        i = int(np.argmin(shares))
        if shares[i] > PAYS:
            break
        small.append(state.causes[i])
        state = search.settled(state, rests[i])
    return state, small


def intervals(fitter, fit):
    """95 % intervals (p, 2) in usual sizes: by the noise, or by how blocks of rows differ where that is more."""
    z = fitter.vector(fit.causes)[0]
    J, half = fitter.jacobian(fit), np.full(len(z), np.nan)
    size = np.sqrt((J**2).sum(0))
    shown = size**2 > SHOWN
    if shown.any():
        half[shown] = _halves(J[:, shown] / size[shown], fit.left, fitter.block) / size[shown]
    return z[:, None] + np.hypot(1, fitter.path.doubt(fit.causes)) * half[:, None] * np.array([-1, 1])


def _halves(J, left, rows, of=None):
    """Half widths (m,) of sums `of` (m, p) of sizes, or of each size, for slopes of length 1. What no row tells is left open.

    A pseudoinverse would call it certain.

    Blocks are few and pull the fit towards themselves. Their scores are freed of that, and Student's t has one degree of freedom
    less than blocks that tell of a size (Bell and McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples", Survey Methodology 28, 2002; here blocks are counted by what they tell).
    """
    values, vectors = np.linalg.eigh(J.T @ J)
    whiten = vectors / np.sqrt(np.maximum(values, UNTOLD))
    scores, told = _scores(J @ whiten, left, rows)
    R = whiten if of is None else of @ whiten  # of the whole covariance R R'
    told = np.einsum("pi,bij,pj->bp", R, told, R)
    count = told.sum(0) ** 2 / np.maximum((told**2).sum(0), 1e-300)
    student = np.where(count > FEWEST, special.stdtrit(np.maximum(count - 1, 1), 0.975), 0.0)
    return np.maximum(1.96 * np.sqrt((R**2).sum(1)), student * np.sqrt(((R @ scores.T) ** 2).sum(1)))


def _scores(X, left, rows):
    """Scores (blocks, p) for orthonormal columns X, each over the root of what the other blocks tell, and what each tells (blocks, p, p)."""
    scores, told = [], []
    for first in range(0, len(X), rows):
        part = X[first : first + rows]
        told.append(part.T @ part)
        values, U = np.linalg.eigh(told[-1])
        scores.append(U @ (U.T @ (part.T @ left[first : first + rows]) / np.sqrt(np.maximum(1 - values, ALONE))))
    return np.array(scores), np.array(told)


def limits(fitter, fit, i, k, at, interval, profiled=None):
    """95 % interval of parameter k of cause i, number `at` of all, in its unit; profiled: gives the Profile of the fit."""
    effect, profiled = fitter.effects[fit.causes[i].name], profiled or (lambda: Profile(fitter, fit))
    if not np.isfinite(interval).all() or (effect.threshold and not fitter.smooth):
        interval = threshold_interval(fitter, fit, at)
    half = float(interval[1] - interval[0]) / 2
    if half < np.inf and effect.threshold and len(effect.parameters) > 1 and not fitter.smooth:
        interval = profile(profiled(), fit, at, begin=half)
    elif half < np.inf and effect.curve:
        interval = profile(profiled(), fit, at, half / _half_by_noise(fitter, fit, at))
    return [float(v) for v in np.clip(interval, effect.bounds[0][k], effect.bounds[1][k]) * effect.scale[k]]


def untestable(search, fit):
    """Effects that would not show in this log at their usual size."""
    fitter, out = search.fitter, []
    J = fitter.jacobian(fit)
    Q = np.linalg.qr(J)[0] if J.shape[1] else J
    names = [n for n, e in fit.lacks(fitter.effects).items() if n == e.reported_as and not e.transient]
    if not names:
        return out
    trials = [(*fit.causes, Cause(n, tuple(p.usual for p in fitter.effects[n].parameters))) for n in names]
    G = fitter.lefts(trials) - fit.left[:, None]
    G = G - Q @ (Q.T @ G)
    return [n for n, size in zip(names, (G**2).sum(0)) if size < TESTABLE * search.price]


def ranking(search, base, fit, proved):
    """[(name, score)]."""
    whole = max(base.cost - fit.cost, 1e-9)
    effects = search.fitter.effects
    score = {effects[c.name].reported_as: 1 + p.worth / whole for c, p in zip(fit.causes, proved)}
    for gain, cause in search.candidates(base):
        name = effects[cause.name].reported_as
        if name not in score:
            share = gain / max(base.cost, 1e-9) if not fit.causes else max([p.absorbed.get(name, 0) * p.worth / whole for p in proved])
            score[name] = share
    for effect in effects.values():
        score.setdefault(effect.reported_as, 0.0)
    return sorted(score.items(), key=lambda s: -s[1])
