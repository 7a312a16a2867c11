"""The form of an effect that suits a log best, of those of its family."""

from dataclasses import replace


def _others(states, state, i):
    """Effects of the family of cause i that may act instead of it."""
    effects, cause = states.path.effects, state.causes[i]
    free = replace(state.fit, causes=state.causes[:i] + state.causes[i + 1 :]).lacks(effects)
    return [e for e in free.values() if e.kin == effects[cause.name].kin and e.name != cause.name and not e.transient]


def _begun(fitter, causes, i, effect):
    """Causes with an effect instead of cause i, at the best of its starts."""
    trials = [(*causes[:i], replace(causes[i], name=effect.name, params=start), *causes[i + 1 :]) for start in effect.starts]
    costs = (fitter.lefts(trials) ** 2).sum(0) + [fitter.guesses(trial) for trial in trials]
    return trials[int(costs.argmin())]


def begun(states, state, i):
    """[causes with cause i in another form, or as another effect of its family], each at the best of its starts."""
    return [_begun(states.at(state), state.causes, i, effect) for effect in _others(states, state, i)]


def reformed(states, state):
    """With each cause in the form, or as the effect of its family, that is worth most."""
    for i in range(len(state.causes)):
        fits = [
            fit
            for fit in (states.refined(state, trial) for trial in begun(states, state, i))
            if states.priced(fit) < states.priced(state.fit)
        ]
        if fits:
            state = min(state, states.settled(state, min(fits, key=states.priced)), key=states.worth)
    return state
