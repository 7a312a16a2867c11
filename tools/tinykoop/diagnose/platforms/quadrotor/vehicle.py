"""The quadrotor as an observer sees it: what the simulated one, held to a logged flight, misses in each row."""

import numpy as np
from scipy import linalg

from .... import bridge, platforms
from ... import observed

CHANNELS = platforms.COLUMNS["quadrotor"][5:]
UNITS = tuple(platforms.UNITS[name] for name in CHANNELS)
ANGLES = slice(9, 12)
AIR = (0.1, 0.1, 0.1, 2.5, 2.5, 0.8)  # m/s^2 and rad/s^2, of the turbulent air that the observer allows for
LASTING = 0.3  # s, of that air (host_sim/quadrotor.h)
ROTORS = 1e-3  # share of full thrust by which a rotor strays from what it was asked for, from row to row
RIGID = 1e-5  # m, m/s, rad, rad/s: what else changes from row to row
LEAK = 1e-4  # of a state per row: what a log does not show at all, such as its place or heading, stays bounded
SETTLE = 0.5  # s after the start of a log or a gap: how the vehicle moved is not known there
STRAYED = 25  # rows over which place and velocity are compared with what they integrate
FEWEST = 10  # rows in a row from which the noise of a channel is told


def settled(log):
    """Rows (K,) that the observer has come to know."""
    return observed.settled(log, SETTLE)


def predictable(log):
    """Rows that the observer knows and from which the longest horizon can be predicted."""
    return observed.predictable(log, settled(log))


# ---- the observer ------------------------------------------------------------------------------


def _moved(state, size):
    """The hovering state with each of its 16 corrected parts moved by `size`, and by how much of each."""
    rigid = [*range(6), 7, 8, 9, *range(10, 17)]
    unit = np.r_[np.ones(6), np.full(3, 0.5), np.ones(7)]  # of a quaternion, half a tilt
    return rigid, unit, [state + size * u * np.eye(len(state))[i] for i, u in zip(rigid, unit)]


def _linear(dt, vehicle, size=1e-4):
    """(A (22, 22), C (15, 22)) of the hovering vehicle from row to row: what is corrected, and what is measured of it."""
    hover = bridge.quadrotor_hover(vehicle)
    held = np.array([[*[bridge.hover_request(vehicle)] * 4, np.nan]])
    rigid, unit, moved = _moved(hover, size)

    def change(step):
        """What each move of the state moves a step later, in corrected parts."""
        ends = [bridge.quadrotor_roll(state, held, step, vehicle=vehicle)[1] - hover for state in moved]
        return np.array(ends).T[rigid] / unit[:, None] / size

    A, C, kept = np.zeros((22, 22)), np.zeros((15, 22)), np.exp(-dt / LASTING)
    A[:16, :16], short = change(dt), 1e-3
    A[16:, 16:] = kept * np.eye(6)
    for i, j in ((3, 16), (9, 19)):  # the air accelerates velocity and spin, and so moves place and tilt
        A[i : i + 3, j : j + 3] = 0.5 * (1 + kept) * dt * np.eye(3)
        A[i - 3 : i, j : j + 3] = 0.5 * dt**2 * np.eye(3)
    C[:6, :6] = np.eye(6)
    C[6:9, :16], C[6:9, 16:19] = (change(short)[3:6] - np.eye(16)[3:6]) / short, np.eye(3)
    C[9:12, 6:9], C[12:15, 9:12] = np.eye(3), np.eye(3)
    return (1 - LEAK) * A, C


def _variance(rows, unknown):
    """Of each column about its mean, `unknown` where it has too few numbers."""
    known = np.isfinite(rows)
    counts = np.maximum(known.sum(axis=0), 1)
    rows = np.where(known, rows, 0)
    return np.where(counts >= FEWEST, np.sum(rows**2, axis=0) / counts - (rows.sum(axis=0) / counts) ** 2, unknown)


def noise_of(log):
    """Variance (15) of the white noise of each channel, by its second differences; NaN where the log has none."""
    x = log.x.copy()
    known = np.isfinite(x)
    for i in range(ANGLES.start, ANGLES.stop):
        x[known[:, i], i] = np.unwrap(x[known[:, i], i])
    both = log.usable[:-1] & log.usable[1:]
    return _variance(np.diff(x, n=2, axis=0)[both], np.nan) / 6 + 1e-12  # of white noise: 1 + 4 + 1


def _strays(log, noise):
    """Variance per row (6) by which place and velocity stray from the integral of velocity and acceleration.

    State estimators correct each by itself. White noise adds the same to steps of one row and of many, so that the difference is
    that of what strays, and of the noise that was integrated.
    """
    rate = np.nan_to_num(log.x[:, 3:9])
    way = np.cumsum(0.5 * log.dt * (rate + np.vstack([rate[:1], rate[:-1]])), axis=0)
    apart = log.x[:, :6] - np.where(np.isfinite(log.x[:, 3:9]), way, np.nan)
    since = np.concatenate([[0], np.cumsum(~log.usable)])

    def spread(rows):
        whole = since[rows:] == since[:-rows]
        return _variance((apart[rows:] - apart[:-rows])[whole], 0.0)

    return np.maximum((spread(STRAYED) - spread(1)) / (STRAYED - 1) - log.dt**2 * np.nan_to_num(noise[3:9]), 0)


def observer_gain(log, vehicle="crazyflie"):
    """Gain (22, 15) of the stationary Kalman filter about hover, with the noise of the log; zeros for what it lacks."""
    A, C = _linear(log.dt, vehicle)
    lost = -np.expm1(-2 * log.dt / LASTING)
    R = noise_of(log)
    Q = np.diag(np.r_[_strays(log, R) + RIGID**2, np.full(6, RIGID**2), np.full(4, ROTORS**2), np.square(AIR) * lost])
    seen = np.isfinite(R)
    C, R = C[seen], np.diag(R[seen])
    P = linalg.solve_discrete_are(A.T, C.T, Q, R)
    gain = np.zeros((22, 15))
    gain[:, seen] = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    return gain


def wrapped(missed):
    """Measured less predicted, angles in -pi..pi."""
    missed[..., ANGLES] = (missed[..., ANGLES] + np.pi) % (2 * np.pi) - np.pi
    return missed


def follower(log, gain, vehicle="crazyflie"):
    """A function (active, push=None, starts=(), steps=()) -> (innovations (K, 15), what is missed ahead) of the observer of a log.

    NaN in channels that the log lacks.
    """

    def follow(active=(), push=None, starts=(), steps=()):
        predicted, ahead = bridge.quadrotor_follow(log, gain, active, vehicle, starts, steps, push)
        if ahead is not None:
            ends = np.minimum(np.asarray(starts)[:, None] + np.asarray(steps), len(log.x) - 1)
            ahead = wrapped(log.x[ends] - ahead)
        return wrapped(log.x - predicted), ahead

    return follow
