"""Simpler states that are worth more: fewer causes, fewer edges, another rule of stepping."""

from dataclasses import replace
from itertools import combinations

from .candidates import candidates
from .fit import ALWAYS
from .states import MARGIN

SWAPS = 2  # effects that are tried instead of one
ABSORBED = 0.5  # of what several causes do, from which on one is tried in their place


def _without(causes, i):
    return causes[:i] + causes[i + 1 :]


def reduced(states, state):
    """Without causes that do not pay."""
    while len(state.causes) > 1:
        rests = [states.refined(state, _without(state.causes, i), 3) for i in range(len(state.causes))]
        less = states.settled(state, min(rests, key=states.priced))
        if states.worth(less) > states.worth(state) + MARGIN:
            break
        state = less
    return state


def stepped(states, state):
    """With the variant of the simulator that suits it best: another than the first must be worth that."""
    best, handicap = state, lambda variant: MARGIN * (variant > 0)
    for variant in range(len(states.path.variants)):
        if variant != state.variant:
            fit = states.refined(replace(state, variant=variant), state.causes, 3)
            if fit.cost + handicap(variant) < state.fit.cost + handicap(state.variant):
                best = min(best, states.likeliest(fit), key=lambda s: states.worth(s) + handicap(s.variant))
    return best


def discretised(states, state):
    """As stepped(), with a cause less if the variant makes up for it."""
    best = state
    for variant in range(len(states.path.variants)):
        for i in range(len(state.causes)) if variant != state.variant else ():
            fit = states.refined(replace(state, variant=variant), _without(state.causes, i), 3)
            if states.priced(fit) < states.priced(state.fit):
                best = min(best, states.likeliest(fit), key=states.worth)
    return best


def begun_anew(states, state):
    """With curves that begin at their usual sizes again: they have more than one hollow."""
    for i, cause in enumerate(state.causes):
        effect = states.path.effects[cause.name]
        if effect.curve:
            trials = [(*state.causes[:i], replace(cause, params=p), *state.causes[i + 1 :]) for p in effect.starts]
            best = min((states.refined(state, trial, 15) for trial in trials), key=lambda f: f.cost)
            if best.cost < state.fit.cost - MARGIN:
                state = min(state, states.settled(state, best), key=states.worth)
    return state


def swapped(states, state):
    """With another effect instead of one, if that is worth more: what was taken in first was chosen without the others."""
    for i in range(len(state.causes)):
        better = _swap(states, state, i)
        if better:
            return swapped(states, better)
    return state


def _swap(states, state, i):
    fitter, rest = states.at(state), _without(state.causes, i)
    beside = fitter.refine(fitter.fit_of(rest), 3)
    likely = [cause for _, cause in candidates(fitter, beside, state.causes[i].segments) if cause.name not in state.fit.names]
    fits = [states.refined(state, (*beside.causes, cause), 5) for cause in likely[:SWAPS]]
    close = [fit for fit in fits if states.rivals(state, fit)]
    best = min((states.settled(state, fit) for fit in close), key=states.worth, default=state)
    return best if states.worth(best) < states.worth(state) - MARGIN else None


def opened(states, state):
    """With causes that act throughout instead of those that come and go."""
    timed = [i for i, c in enumerate(state.causes) if c.segments != ALWAYS]
    for some in dict.fromkeys([tuple(timed), *((i,) for i in timed)] if timed else []):
        wider = tuple(replace(c, segments=ALWAYS) if i in some else c for i, c in enumerate(state.causes))
        fit = states.refined(state, wider)
        better = states.settled(state, fit) if states.rivals(state, fit) else state
        if states.worth(better) < states.worth(state):
            return opened(states, better)
    return state


def simplified(states, state):
    """One cause instead of several."""
    for count in range(len(state.causes), 1, -1):
        for group in combinations(state.causes, count):
            better = _one_for(states, state, group)
            if better:
                return simplified(states, better)
    return state


def _one_for(states, state, group):
    """The state with one cause instead of a group, if that is worth more."""
    fitter = states.at(state)
    base = fitter.fit_of(tuple(c for c in state.causes if c not in group))
    likely = []
    for segments in dict.fromkeys([ALWAYS, *(c.segments for c in group)]):
        gain, cause = next(iter(candidates(fitter, base, segments)), (0.0, None))
        likely += [cause] if gain > ABSORBED * (base.cost - state.fit.cost) else []
    wider = tuple(replace(c, segments=ALWAYS) for c in base.causes)
    for causes in dict.fromkeys((*rest, cause) for cause in likely for rest in (base.causes, wider)):
        fit = states.refined(state, causes, 5)
        better = states.settled(state, fit) if states.rivals(state, fit) else state
        if states.worth(better) < states.worth(state):
            return better
    return None
