"""From the paths of several logs to what is said of all: common sizes and sizes per group, how sure each effect is, how far each gap closes."""

from dataclasses import dataclass, replace

import numpy as np

from . import ahead, judge, openset
from .fit import ALWAYS
from .pool import Pool
from .states import MARGIN, State, States


@dataclass(frozen=True)
class Joint:
    """An effect in all logs: its causes, what its absence would cost, how sure it is, what else it may be, and what it is not."""

    causes: tuple
    worth: float
    confidence: float
    any_name: float
    others: tuple  # rivals that all logs together leave
    settled: tuple  # those that they rule out, and one of them alone does not


@dataclass
class JointAnswer:
    """before, after, floor: [{gap: errors (S, H)}], one of each log."""

    pool: Pool
    state: State
    joints: list
    verdict: str
    before: list
    after: list
    floor: list


def _started(path, causes):
    """States of one log, the noise being that beside its own causes."""
    states = States(path)
    state = states.referred(states.likeliest(states.fitter.fit_of(causes)))
    states.with_coloured_noise(states.robust(state))
    return states


def _pool(paths, groups, known):
    return Pool([_started(path, causes) for path, causes in zip(paths, known)], groups, known)


def answer(paths, groups, known, alike):
    """The JointAnswer; groups: [numbers of the logs of a group]; known: causes of each log; alike: {effect: names of what may be it}.

    Which effects there are and what they share is decided on fewer rows, where logs are long.
    """
    fewer = [path.coarse() or path for path in paths]
    pool = _pool(fewer, groups, known)
    state, behind = _best(pool, pool.run(alike), alike)
    if fewer != paths:
        pool = _pool(paths, groups, known)
        state = pool.begun_at(state)
    parts = [_ahead(pool, state, k) for k in range(len(paths))]
    left = _left([part[-1] for part in parts])
    joints = _joints(pool, state, behind, alike, left)
    before, after, floor, _ = map(list, zip(*parts))
    return JointAnswer(pool, state, joints, judge.verdict(pool.path, joints, left), before, after, floor)


# ---- which effects ---------------------------------------------------------------------------------------


def _best(pool, state, alike):
    """(state, {effect: {rival: squares and price, by which it is worse}}); with a rival as the state, if that is worth more."""
    names = dict.fromkeys(c.name for c in state.causes if c.segments == ALWAYS)
    rivals = {name: _rivals(pool, state, name, alike) for name in names}
    more = pool.promising(state, state.causes) if len(names) < pool.path.most_effects else ()
    wider = _fits(pool, state, state.causes, [(name,) for name in more])
    best = min((fit for some in (*rivals.values(), wider) for _, fit in some), key=pool.priced, default=state.fit)
    if pool.priced(best) < pool.priced(state.fit) - MARGIN:
        better = pool.simplified(pool.settled(state, best))
        if pool.worth(better) < pool.worth(state) - MARGIN:
            return _best(pool, better, alike)
    return state, {name: _behind(pool, state, name, some) for name, some in rivals.items()}


def _rivals(pool, state, name, alike):
    """[(names, fit with these instead of an effect)]: of what single logs cannot distinguish from it, and of the likeliest others."""
    rest = tuple(c for c in state.causes if c.name != name or c.segments != ALWAYS)
    known = pool.instead(state.fit.names, name, alike)
    likely = [(other,) for other in pool.promising(state, rest) if other != name and (other,) not in known]
    return _fits(pool, state, rest, [*known, *likely])


def _fits(pool, state, causes, sets):
    """[(names, the simplest fit with these beside causes)]."""
    return [(names, pool.plainer(state, pool.refined(state, pool.begun(causes, names)))) for names in sets]


def _behind(pool, state, name, rivals):
    """{other effect: squares and price, by which it is worse}; another form is the same effect."""
    behind, title = {}, {n: effect.reported_as for n, effect in pool.path.effects.items()}
    for others, fit in rivals:
        for other in (other for other in others if title[other] != title[name]):
            worse = pool.priced(fit) - pool.priced(state.fit) if other in fit.names else np.inf
            behind[title[other]] = min(behind.get(title[other], np.inf), worse)
    return behind


def _joints(pool, state, behind, alike, left):
    """[Joint], the effect that is worth most first."""
    fitter, fit = pool.at(state), state.fit
    whole = [c for c in fit.causes if c.segments == ALWAYS]
    parts = [tuple(c for c in whole if c.name == name) for name in dict.fromkeys(c.name for c in whole)]
    parts += [(c,) for c in fit.causes if c.segments != ALWAYS]
    rests = [fitter.refine(fitter.fit_of(c for c in fit.causes if c not in part), 5) for part in parts]
    worths = [max(rest.cost - fit.cost, 0.0) for rest in rests]
    found = []
    for part, rest, worth in zip(parts, rests, worths):
        name = part[0].name
        masks = any(name in names for names in pool.path.lookalikes if names <= set(fit.names))
        sure = judge.certainty(pool.path, worth, max(worths), judge.steadiness(fit, rest), left, masks)
        found.append(_joint(pool, part, worth, sure, behind[name] if part[0] in whole else {}, alike, left))
    return sorted(found, key=lambda joint: -joint.worth)


def _joint(pool, part, worth, sure, behind, alike, left):
    others = tuple(name for name, worse in behind.items() if worse < pool.price)
    confidence, any_name = judge.confidences(pool.path, sure, left, {**behind, "": worth}, others)
    open_ = alike.get(pool.path.effects[part[0].name].reported_as, ())
    return Joint(part, worth, confidence, any_name, others, tuple(name for name in behind if name in open_ and name not in others))


# ---- how far predictions are off ---------------------------------------------------------------------------


def _ahead(pool, state, k):
    """(before, after, floor, Left) of log k; each prediction has sizes that all logs tell but for the rows about it."""
    pool.at(state)
    folds = [pool.path.of(causes, k) for causes in ahead.held_out(pool.fitter, state.fit)]
    log, own = pool.logs[k], pool.split(state)[k]
    path = log.path
    path.tell_hidden(own.noise)
    starts = ahead.starts_of(path)
    missed = ahead.missed_by(path, folds, starts)
    before, after = ahead.errors(path, (), starts), ahead.sizes(path, missed)
    boxed, box = openset.boxed(log, own, missed, starts)
    floor = judge.floors(path, own.noise, before, after, boxed, starts)
    return before, after, floor, judge.left(log, own, before, after, boxed, floor, box, starts)


def _left(lefts):
    """Of the log in which most is left that matters; white if all are."""
    return replace(max(lefts, key=lambda left: left.matters * left.share), white=all(left.white for left in lefts))
