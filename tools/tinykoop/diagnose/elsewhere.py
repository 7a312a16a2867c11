"""The causes of one log on another, whose clock is its own: when a cause acts there, and how large it grows."""

from dataclasses import replace
from itertools import product

import numpy as np

from .prediction_errors.fit import ALWAYS

AT_END = "loss_at_end"  # a parameter that is reached where the log ends, or the stretch in which the effect acts


def seconds(log):
    """From the first row to the last."""
    return (len(log.x) - 1) * log.dt


def joined(logs, names):
    """(columns of these names, usable transitions) of several logs one after the other: between two of them none is usable."""
    usable = np.concatenate([np.append(log.usable, False) for log in logs])[:-1]
    return [np.concatenate([getattr(log, name) for log in logs]) for name in names], usable


def carry(causes, parameters, logs, cost):
    """[(cause that acts throughout, whether it acts)] of a fit of the first of two logs on the second.

    What came or went on the first log acts throughout on the second or not at all, whichever costs less there; a loss
    grows as fast as on the first. parameters: {name: (Parameter, ..)}. cost(causes): misfit of the second log.
    """
    along = [replace(as_fast(cause, parameters[cause.name], *map(seconds, logs)), segments=ALWAYS) for cause in causes]
    choices = product(*((True,) if cause.segments == ALWAYS else (True, False) for cause in causes))
    return list(zip(along, min(choices, key=lambda acts: cost(acting(zip(along, acts))))))


def acting(carried):
    """The causes of carry() that act."""
    return tuple(cause for cause, acts in carried if acts)


def told(carried, parameters):
    """carry() as the report has it."""
    return [
        {"name": c.name, "params": {p.name: float(v) for p, v in zip(parameters[c.name], c.params)}, "acts": acts} for c, acts in carried
    ]


def as_fast(cause, parameters, own, other):
    """The cause with its loss after `other` seconds; own: seconds of the log that it was fitted to."""
    acted = np.mean([min(t1, own) - max(t0, 0.0) for t0, t1 in cause.segments])
    grown = [float(np.clip(v * (other / acted), p.low, p.high)) if p.name == AT_END else v for v, p in zip(cause.params, parameters)]
    return replace(cause, params=tuple(grown))
