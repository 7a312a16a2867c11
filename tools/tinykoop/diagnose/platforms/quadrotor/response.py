"""How late the vehicle answers to a request: the lag and delay under which tilt and angular velocity are predicted best.

About each axis a Kalman filter predicts tilt and angular velocity from row to row, with air that accelerates the vehicle for a while. The
requests act through a lag and a delay, which are tried on a grid. Least squares of such predictions are consistent in closed loop if the
noise is modelled (L. Ljung, "System Identification", 2nd ed., 1999, sections 8.4 and 13.4), as long as the controller does not act between
the rows of the log. It does, several times, and mostly on the noise of the gyro: part of what a row asks for is gone before the next one.
So the gain of the requests is free, the lag is known to some extent only, and only a flight that manoeuvres is believed.
"""

import numpy as np
from scipy import linalg
from scipy.signal import lfilter

from .vehicle import AIR, LASTING, noise_of

LAGS, DELAYS = np.arange(0.02, 0.2, 0.01), np.arange(-0.02, 0.06, 0.0025)  # s, that are tried
SETTLES = 0.5  # s of each stretch, that the filter takes to know the air
MANOEUVRES = 0.03  # rad, RMS about the mean, from which on a tilt is a manoeuvre's
SLOWEST = 0.02  # s between rows, at most
AXES = (("gx", "roll", 1, 1), ("gy", "pitch", 2, -1))  # angular velocity, angle, row of MIX, sign
RIGID = 1e-6  # rad, rad/s: what else changes from row to row


def response(log, rows):
    """{"lag", "delay": (value, standard error)}, s; {} where the log does not tell."""
    from .features import MIX, STATES, runs

    x, noise = dict(zip(STATES, log.x.T)), dict(zip(STATES, noise_of(log)))
    stretches = [run for run in runs(rows) if (run[1] - run[0]) * log.dt > 2 * SETTLES]
    if not stretches or log.dt > SLOWEST or not np.isfinite(np.array([x[name] for axis in AXES for name in axis[:2]])[:, rows]).all():
        return {}
    tilts, found = _turned(x), np.zeros((3, len(LAGS), len(DELAYS)))
    for tilt, (rate, angle, mixed, sign) in zip(tilts, AXES):
        if x[angle][rows].std() > MANOEUVRES:
            asked = sign * np.nan_to_num(log.u[:, :4] @ MIX[mixed])
            seen, variances = np.stack([tilt, x[rate]], 1), np.array([noise[angle], noise[rate]])
            found += _products(seen, variances, asked - asked[rows].mean(), stretches, log.dt)
    return _told(*found) if found.any() else {}


def _turned(x):
    """Integrals (K,) of the angular velocities about x and y (body axes) that the angles show."""
    roll, pitch, yaw = (np.unwrap(np.nan_to_num(x[name])) for name in ("roll", "pitch", "yaw"))
    r, p = (0.5 * (angle[1:] + angle[:-1]) for angle in (roll, pitch))
    about_x = np.diff(roll) - np.diff(yaw) * np.sin(p)
    about_y = np.diff(pitch) * np.cos(r) + np.diff(yaw) * np.cos(p) * np.sin(r)
    return [np.concatenate([[0.0], np.cumsum(turn)]) for turn in (about_x, about_y)]


def _filter(variances, dt):
    """(A, C, gain, whitening) of the Kalman filter of tilt, angular velocity and the air's acceleration."""
    kept = np.exp(-dt / LASTING)
    A, C = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, kept]]), np.eye(3)[:2]
    Q = np.diag([RIGID**2, RIGID**2, AIR[3] ** 2 * (1 - kept**2)])
    P = linalg.solve_discrete_are(A.T, C.T, Q, np.diag(variances))
    S = C @ P @ C.T + np.diag(variances)
    return A, C, P @ C.T @ np.linalg.inv(S), np.linalg.inv(np.linalg.cholesky(S))


def _lagged(asked, dt):
    """Mean over each row (K, lags) of requests that are held for a row, behind each lag."""
    out = []
    for lag in LAGS:
        kept = np.exp(-dt / lag)
        out.append(asked + (lfilter([0, 1 - kept], [1, -kept], asked) - asked) * (1 - kept) * lag / dt)
    return np.stack(out, 1)


def _innovations(seen, inputs, A, C, gain, dt):
    """Innovations (K, 2, 1 + lags): of what is seen without any requests, and what each input takes off them."""
    state, out = np.zeros((3, 1 + inputs.shape[1])), np.empty((len(seen), 2, 1 + inputs.shape[1]))
    state[:2, 0], acts = seen[0], np.array([[dt**2 / 2], [dt], [0]])
    for row, y, acting in zip(out, seen, inputs):
        row[:] = -C @ state
        row[:, 0] += y
        state = A @ (state + gain @ row)
        state[:, 1:] += acts * acting
    return out


def _products(seen, variances, asked, stretches, dt):
    """Sums (3, lags, delays) of seen times seen, seen times input and input times input, all whitened innovations."""
    A, C, gain, whitening = _filter(variances, dt)
    inputs, out = _lagged(asked, dt), np.zeros((3, len(LAGS), len(DELAYS)))
    early, late = int(np.floor(DELAYS[0] / dt)), int(np.ceil(DELAYS[-1] / dt))
    for first, last in stretches:
        e = np.einsum("ij,kjl->kil", whitening, _innovations(seen[first:last], inputs[first:last], A, C, gain, dt))
        k = np.arange(round(SETTLES / dt) + late, len(e) + early)
        y, shifted = e[k, :, 0], {s: -e[k - s, :, 1:] for s in range(early, late + 1)}
        for j, delay in enumerate(DELAYS / dt):
            whole = int(np.floor(delay))
            h = (1 - delay + whole) * shifted[whole] + (delay - whole) * shifted[min(whole + 1, late)]
            out[0, :, j] += (y**2).sum()
            out[1, :, j] += np.einsum("ki,kil->l", y, h)
            out[2, :, j] += (h**2).sum((0, 1))
    return out


def _told(whole, mixed, inputs):
    """Means and standard errors over the grid, where the gain of the requests is the best one; whitened innovations have the variance 1."""
    left = whole - mixed**2 / inputs
    weights = np.exp(-0.5 * (left - left.min()))
    weights /= weights.sum()
    out = {}
    for name, values in (("lag", LAGS[:, None]), ("delay", DELAYS[None, :])):
        mean = (weights * values).sum()
        out[name] = (mean, np.sqrt((weights * (values - mean) ** 2).sum()))
    return out
