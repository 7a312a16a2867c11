"""What limits a log by itself: commands that hardly vary, too few rows, and commands that depend on the measurements (closed loop).

Steady: a constant is persistently exciting of order one, so one number is all that it determines (Ljung, System Identification, 2nd ed.,
1999, section 13.2). Short: the RMS of n independent errors has a relative standard error of 1 / sqrt(2 n). Closed loop: innovations predict
the next command beyond what past commands predict (Granger, Econometrica 37, 1969; Caines and Chan, IEEE Transactions on Automatic Control
20, 1975; Ljung, section 16.6). They are whitened first, since two smooth series correlate by chance (Haugh, Journal of the American
Statistical Association 71, 1976). In a closed loop a wrong noise model biases the fit (Forssell and Ljung, Automatica 35, 1999).
"""

import numpy as np
from scipy import special

from .prediction_errors.ahead import BLOCK, FOLDS, HORIZONS

STEADY = 0.02  # standard deviation of a command over its largest size, to which it hardly varies
FEWEST = 8  # separate predictions at the longest horizon: their RMS is then known to a quarter
PAST, LAGS = 10, 3  # rows of past commands, and of innovations before the present one, that may predict a command
FAR = 3.0  # standard deviations, at which innovations are clipped
PER = 3  # rows per coefficient, to test for feedback
BLOCKS = 5  # of the log, each predicted from the others
CHANCE = 1e-4  # of a false alarm, over all commands
SHARE = 0.1  # of a command beyond what past commands predict, that innovations must predict on held-out blocks
NONE = 1e-9  # of a column's size: what varies less is constant


def of(found):
    """The `cautions` of the report of an Answer."""
    path = found.path
    return [*of_log(path), *([] if path.steered else closed_loop(path, found.fit.left.reshape(path.present.shape)))]


def of_log(path):
    """Those that need no fit."""
    return [*steady(path), *short(path.log)]


def _commands(path):
    """(K, m): the last one is taken to last where a log has none in its last row."""
    u = path.log.u
    return u if len(u) == len(path.log.x) else np.vstack([u, u[-1:]])


# ---- steady, short -----------------------------------------------------------------------------------


def steady(path):
    """Commands that hardly vary, with their standard deviation over their largest size."""
    u = _commands(path)
    variation = np.nanstd(u, axis=0) / np.maximum(np.nanmax(np.abs(u), axis=0), NONE)
    held = {name: float(v) for name, v in zip(path.command_names, variation) if v <= STEADY}
    return [{"kind": "steady", "variation": held}] if held else []


def short(log):
    """Fewer separate predictions than tell their RMS, or less time than each fold of the held-out blocks needs."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], log.usable.astype(int), [0]]))).reshape(-1, 2)
    separate, seconds = int((np.diff(edges)[:, 0] // HORIZONS[-1]).sum()), float(log.usable.sum() * log.dt)
    if separate >= FEWEST and seconds >= FOLDS * BLOCK:
        return []
    return [{"kind": "short", "predictions": separate, "least_predictions": FEWEST, "seconds": seconds, "least_seconds": FOLDS * BLOCK}]


# ---- closed loop -------------------------------------------------------------------------------------


def closed_loop(path, innovations):
    """Commands that depend on the measurements, with the share that these predict and the p-value of an F test."""
    u = _commands(path)
    since = _since_break(path.begins)
    seen = _unpredicted(u[path.rows], np.where(np.isfinite(path.present), innovations, 0.0), np.flatnonzero(since >= PAST))
    tested = {}
    for j, name in enumerate(path.command_names):
        changes = u[path.rows, j] != u[np.maximum(path.rows - 1, 0), j]
        tested[name] = _feedback(u[path.rows], j, seen, np.flatnonzero(changes & (since >= PAST + LAGS)))
    fed = {name: test for name, test in tested.items() if test[0] < CHANCE / len(tested) and test[1] >= SHARE}
    if not fed:
        return []
    return [{"kind": "closed_loop", "share": {n: t[1] for n, t in fed.items()}, "p": {n: t[0] for n, t in fed.items()}}]


def _since_break(begins):
    """(K,): rows since a stretch began."""
    here = np.arange(len(begins))
    return here - np.maximum.accumulate(np.where(begins != 0, here, 0))


def _unpredicted(u, innovations, rows):
    """Innovations less what past commands and each channel's own past predict, of unit variance and clipped: white for any noise model."""
    seen = np.zeros_like(innovations)
    if len(rows) < PER * PAST * (u.shape[1] + 1):
        return seen
    known, past = np.clip(innovations / np.maximum(innovations.std(0), NONE), -FAR, FAR), _past(u, rows)
    for c, channel in enumerate(known.T):
        own = _varying(_lagged(channel[:, None], rows, range(1, PAST + 1)))
        seen[rows, c] = _without(np.column_stack([past, own]), channel[rows])
    return np.clip(seen / np.maximum(seen.std(0), NONE), -FAR, FAR)


def _feedback(u, j, seen, rows):
    """(p-value, share predicted on held-out blocks) of command j in the given rows, from innovations that are white.

    The ranks of the command are predicted, in which jumps of a reference have no more weight than others.
    """
    past, new = _past(u, rows), _varying(_lagged(seen, rows, range(LAGS + 1)))
    n, q = new.shape
    if not q or n < PER * (past.shape[1] + q):
        return 1.0, 0.0
    ranks = _ranks(_without(past, u[rows, j]))
    left, new = _without(past, ranks), _without(past, new)
    whole, rest = left @ left, (_without(new, left) ** 2).sum()
    degrees = n - past.shape[1] - q
    p = special.fdtrc(q, degrees, (whole - rest) / q / max(rest / degrees, NONE))
    return float(p), float(1 - _held_out(new, left) / max(whole, NONE))


def _ranks(values):
    """Of values, from 1; equal ones share the mean of theirs."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts - 1) / 2)[which]


def _past(u, rows):
    """A constant and past commands."""
    return np.column_stack([np.ones(len(rows)), _varying(_lagged(u, rows, range(1, PAST + 1)))])


def _lagged(values, rows, lags):
    return np.concatenate([values[rows - lag] for lag in lags], axis=1)


def _varying(columns):
    """Those that vary, of unit variance."""
    centred = columns - columns.mean(0) if len(columns) else columns
    size = np.sqrt((centred**2).mean(0)) if len(columns) else np.zeros(columns.shape[1])
    kept = size > NONE * (np.abs(columns).max(0, initial=0.0) + NONE)
    return centred[:, kept] / size[kept]


def _without(columns, values):
    """What a linear function of the columns leaves of values."""
    return values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]


def _held_out(columns, values):
    """Sum of squares that is left in each block, predicted from the others."""
    block = np.arange(len(values)) * BLOCKS // len(values)
    fits = (np.linalg.lstsq(columns[block != b], values[block != b], rcond=None)[0] for b in range(BLOCKS))
    return sum(float(((values - columns @ fit)[block == b] ** 2).sum()) for b, fit in enumerate(fits))
