"""The flight that would settle what a log leaves open."""

from functools import lru_cache

import numpy as np

from ... import bridge
from ...plumbing.errors import UserError
from .fit import ALWAYS, Cause
from .innovations import Innovations
from .search import FlightSearch
from .vehicle import Fwmav

MENU = {"hover": "hold still", "pitch": "tip to and fro", "yaw": "turn to and fro"}
SECONDS, PAIRS = 20, 3


def advise(search, healthy, pairs, hidden):
    """{drive, words, separation} of the flight that separates most; None if nothing is open.

    Separation: standard deviations, RMS per row, by which the best that the rival can do, or nothing, falls behind.
    """
    questions = [(cause.name, cause.params, rival) for cause, rival in pairs[:PAIRS]]
    if not questions:
        spec = search.fitter.effects
        questions = [(name, tuple(p.usual for p in spec[name][1]), None) for name in hidden[:PAIRS]]
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
    pieces = _flown(healthy, manoeuvre, cause)
    if pieces is None:
        return 0.0
    fitter = FlightSearch.fitter_type(pieces)
    other = fitter.fit_of(())
    if rival:
        other = fitter.refine(fitter.scan(rival, other)[0], steps=4)
    return float(np.sqrt(max(other.cost - fitter.fit_of((cause,)).cost, 0) / len(pieces.log.x)))


@lru_cache(maxsize=32)
def _flown(healthy, manoeuvre, cause):
    """The Innovations of a simulated flight with this effect; None if it tumbles."""
    try:
        log, _ = bridge.fwmav(manoeuvre, SECONDS, 1, [*healthy.base, *cause.active()])
    except UserError:
        return None
    return Innovations(Fwmav(), log, healthy.whitener, healthy.base)
