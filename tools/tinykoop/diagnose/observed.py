"""Rows of a flight that an observer has come to know, and from which it can predict."""

import numpy as np

from .prediction_errors.ahead import HORIZONS
from .prediction_errors.healthy import LAGS


def settled(log, seconds):
    """Rows (K,) so long after the start of a log or a gap."""
    since = np.zeros(len(log.x), int)
    for k in np.flatnonzero(log.usable):
        since[k + 1] = since[k] + 1
    return since >= max(round(seconds / log.dt), 2 * LAGS)


def predictable(log, known):
    """Indices of the rows that are `known` (K,) and from which the longest horizon can be predicted."""
    run = np.zeros(len(log.x), int)
    for k in range(len(log.usable) - 1, -1, -1):
        run[k] = run[k + 1] + 1 if log.usable[k] else 0
    return np.flatnonzero(known & (run >= max(HORIZONS)))
