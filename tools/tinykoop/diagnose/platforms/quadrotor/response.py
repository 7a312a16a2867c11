"""How late the vehicle answers to a request: the impulse response from request to angular velocity, and the lag and delay of its form.

An autoregression with enough terms is consistent in closed loop, whatever the noise is (L. Ljung, "System Identification", 2nd ed.,
1999, sections 8.5 and 13.4), as long as the controller does not act between the rows of the log. It does, many times, so only a flight
that manoeuvres is believed.
"""

import numpy as np

PAST, ASKED, SHOWN = 12, 14, 14  # rows of angular velocity and of requests in the regression; of the response that are compared
LAGS, DELAYS = np.arange(0.01, 0.2, 0.0025), np.arange(-0.02, 0.06, 0.00125)  # s, that are tried
MANOEUVRES = 0.03  # rad, RMS about the mean, from which on a tilt is a manoeuvre's
AXES = (("gx", "roll", 1, 1), ("gy", "pitch", 2, -1))  # angular velocity, angle, row of MIX, sign
DRAWS = 100


def response(log, rows):
    """{"lag", "delay": (value, standard error)}, s; {} where the log does not tell."""
    from .features import MIX, STATES, runs

    x = dict(zip(STATES, log.x.T))
    stretches = [(first, last) for first, last in runs(rows) if last - first > PAST + 2 * ASKED]
    if not stretches or log.dt > 0.02:
        return {}
    costs = []
    for rate, angle, mixed, sign in AXES:
        tilt = x[angle][rows] if np.isfinite(x[angle][rows]).all() else np.zeros(1)
        if np.isfinite(x[rate][rows]).all() and tilt.std() > MANOEUVRES:
            costs.append(_cost(*_regression(x[rate], sign * (log.u[:, :4] @ MIX[mixed]), stretches), log.dt))
    return _told(sum(costs), len(costs)) if costs else {}


def _regression(rate, asked, stretches):
    """(coefficients, their covariance) of the angular velocity one row on."""
    X, y = [], []
    for first, last in stretches:
        k = np.arange(first + max(PAST, ASKED), last - 1)
        X.append(np.stack([*(rate[k - i] for i in range(PAST)), *(asked[k - i] for i in range(ASKED)), np.ones(len(k))], 1))
        y.append(rate[k + 1])
    X, y = np.concatenate(X), np.concatenate(y)
    inverse = np.linalg.pinv(X.T @ X)
    found = inverse @ (X.T @ y)
    return found, inverse * ((y - X @ found) ** 2).sum() / max(len(y) - len(found), 1)


def _impulse(found):
    """The response (..., SHOWN) of the angular velocity to a request of one row."""
    a, b = found[..., :PAST], found[..., PAST : PAST + ASKED]
    h = np.zeros((*found.shape[:-1], SHOWN))
    for k in range(SHOWN):
        n = min(PAST, k)
        h[..., k] = b[..., k] + (a[..., :n] * h[..., k - n : k][..., ::-1]).sum(-1)
    return h


def _cost(found, covariance, dt):
    """Squares (lags, delays), by which responses of that form miss the one that was found."""
    draws = np.random.default_rng(0).multivariate_normal(found, covariance, DRAWS, method="eigh")
    h, spread = _impulse(found), np.cov(_impulse(draws).T)
    W = np.linalg.inv(spread + 1e-6 * np.diag(spread.diagonal()))
    F = _forms(dt)
    gain = (F @ W @ h) / np.einsum("...i,ij,...j", F, W, F)
    left = h - gain[..., None] * F
    return np.einsum("...i,ij,...j", left, W, left)


def _forms(dt):
    """Angular velocity (lags, delays, SHOWN) after a request of one row, through a lag and a delay."""
    lag, late = LAGS[:, None, None], DELAYS[None, :, None]
    after = np.arange(1, SHOWN + 1) * dt

    def stepped(t):
        t = np.maximum(t, 0)
        return t - lag * -np.expm1(-t / lag)

    return stepped(after - late) - stepped(after - dt - late)


def _told(cost, axes):
    """Means and standard errors over all forms; where none fits, by as much less."""
    weights = np.exp(-0.5 * (cost - cost.min()) / max(cost.min() / (axes * SHOWN), 1.0))
    weights /= weights.sum()
    out = {}
    for name, values in (("lag", LAGS[:, None]), ("delay", DELAYS[None, :])):
        mean = (weights * values).sum()
        out[name] = (mean, np.sqrt((weights * (values - mean) ** 2).sum()))
    return out
