"""Candidate functions of a log's commands, and residual velocities in weak form, for sindy and boosting."""

import numpy as np
from scipy.signal import lfilter

_PLAYS = (0.04, 0.08, 0.16)  # rad/s
_DELAYS = (0.05, 0.1, 0.2, 0.4, 0.8)  # s
_LAGS = (0.1, 0.2, 0.4, 0.8, 1.6)  # s
_SMALL = (0.03, 0.06, 0.1, 0.15, 0.22, 0.3)  # shares of the largest command
_LARGE = (0.4, 0.55, 0.7, 0.85)
HALF = 10  # steps: half the width of the test function


def _played(command, half):
    out, state = np.empty(len(command)), command[0]
    for k, c in enumerate(command.tolist()):
        state = min(max(state, c - half), c + half)
        out[k] = state
    return out


def _late(command, delay, dt):
    k = np.arange(len(command))
    return np.interp(k - delay / dt, k, command)


def _lagging(command, tau, dt):
    keep = np.exp(-dt / tau)
    return lfilter([1 - keep], [1, -keep], command, zi=[keep * command[0]])[0]


def functions(data):
    """{name: values (K - 1)}: what a body velocity may depend on; v and w are the commands, t runs from 0 to 1."""
    v, w = data.u[: len(data.x) - 1].T
    t = np.arange(len(v)) / len(v)
    slip = np.abs(v * w)
    table = {
        "1": np.ones(len(v)), "v": v, "w": w, "v w": v * w, "t v": t * v, "v |v|": v * np.abs(v),
        "w |w|": w * np.abs(w), "sign v": np.sign(v), "sign w": np.sign(w), "v exp(-v^2)": v * np.exp(-(v**2)),
        "v |v w|": v * slip, "w |v w|": w * slip, "v |v w| sign w": v * slip * np.sign(w),
    }  # fmt: skip
    for letter, command in (("v", v), ("w", w)):
        peak, size = max(np.max(np.abs(command)), 1e-6), np.abs(command)
        for delay in _DELAYS:
            table[f"{letter} late {delay:g}"] = _late(command, delay, data.dt) - command
        for tau in _LAGS:
            table[f"{letter} lagging {tau:g}"] = _lagging(command, tau, data.dt) - command
        for share in _SMALL:
            table[f"{letter} below {share:g}"] = command * (size < share * peak)
        for share in _LARGE:
            table[f"{letter} above {share:g}"] = np.sign(command) * np.maximum(size - share * peak, 0)
    for half in _PLAYS:
        table[f"w play {half:g}"] = _played(w, half) - w
    return table


def heading_functions(theta):
    return {"cos": np.cos(theta), "sin": np.sin(theta)}


def weak(data, columns, mask):
    """Columns (K - 1, n) averaged with a bump over 2 HALF + 1 transitions, all in `mask`; every fifth such row.

    In weak form (Messenger and Bortz, 2021) the difference quotient is moved to the test function: noise of
    poses, which is large in one-step velocities, then counts little.
    """
    s = np.linspace(-1, 1, 2 * HALF + 3)[1:-1]
    bump = (1 - s**2) ** 2
    bump /= bump.sum()
    rows = data.starts(mask, len(bump), 5)
    filled = np.where(mask[:, None], columns, 0.0)
    windows = np.asarray(rows)[:, None] + np.arange(len(bump))
    return np.einsum("swn,w->sn", filled[windows], bump) if len(rows) else np.empty((0, columns.shape[1]))


def residual_velocities(data):
    """(K - 1, 3) of the nominal robot: along, across [m/s], heading [rad/s]; NaN where a transition is not usable."""
    velocities = np.full((len(data.x) - 1, 3), np.nan)
    starts = data.starts(data.usable, 1)
    velocities[starts] = data.residual(starts, 1) / data.dt
    return velocities
