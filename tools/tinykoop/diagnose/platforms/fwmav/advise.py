"""The flight that would settle what a log leaves open."""

from functools import lru_cache

import numpy as np

from .... import bridge
from ....plumbing.errors import UserError
from ...prediction_errors.fit import ALWAYS, Cause, Fitter
from .path import acting

MENU = {"hover": "hold still", "pitch": "tip to and fro", "yaw": "turn to and fro"}
SECONDS, PAIRS = 20, 3


def advise(search, healthy, pairs, hidden):
    """{drive, words, separation} of the flight that separates most; None if nothing is open.

    Separation: standard deviations, RMS per row, by which the best that the rival can do, or nothing, falls behind.
    """
    questions = [(cause.name, cause.params, rival) for cause, rival in pairs[:PAIRS]]
    if not questions:
        effects = search.fitter.effects
        questions = [(name, tuple(p.usual for p in effects[name].parameters), None) for name in hidden[:PAIRS]]
    if not questions:
        return None
    best = None
    for manoeuvre, words in MENU.items():
        separation = {}
        for name, params, rival in questions:
            separation[f"{name} or {rival or 'not'}"] = _separation(healthy, manoeuvre, Cause(name, params, ALWAYS), rival)
        if best is None or sum(separation.values()) > sum(best["separation"].values()):
            best = {"drive": manoeuvre, "words": words, "separation": separation}
    return best


def _separation(healthy, manoeuvre, cause, rival):
    """Of a simulated flight with this effect: by how much the rival, or nothing, explains it worse than the effect itself."""
    path = _flown(healthy, manoeuvre, cause)
    if path is None:
        return 0.0
    fitter = Fitter(path, path.noises.first(path))
    trials = [(Cause(rival, start),) for start in path.effects[rival].starts] if rival else [()]
    other = min((fitter.refine(fitter.fit_of(trial), 4) for trial in trials), key=lambda fit: fit.cost)
    return float(np.sqrt(max(other.cost - fitter.fit_of((cause,)).cost, 0) / len(path.log.x)))


@lru_cache(maxsize=32)
def _flown(healthy, manoeuvre, cause):
    """The Path of a simulated flight with this effect; None if it tumbles."""
    try:
        log, _ = bridge.fwmav(manoeuvre, SECONDS, 1, [*healthy.base, *acting((cause,))])
    except UserError:
        return None
    return healthy.path(log, differ={})
