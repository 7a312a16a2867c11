"""The flapping-wing vehicle as an observer sees it: what the simulated one, held to a logged flight, misses in each row."""

import numpy as np
from scipy import linalg

from .... import bridge
from ... import observed

CHANNELS = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z", "roll", "pitch", "yaw")
UNITS = ("rad/s",) * 3 + ("m/s^2",) * 3 + ("rad",) * 3
ANGLES = slice(6, 9)
SHAKEN = slice(0, 6)  # of the IMU
COLUMNS = [0, 1, 2, 3, 4, 5, 7, 6, 8]  # of a log, in the order of CHANNELS
# of the turbulent air that the observer allows for, m/s^2 and rad/s^2, and how long it lasts (host_sim/fwmav_flight.c, fwmav.h)
AIR, LASTING = (0.3, 0.3, 0.3, 4.0, 4.0, 4.0), 0.1
LIFT, CLIMBING, GRAVITY = 0.02, 2.0, 9.81  # weights that a height hold asks for, more or less, and how long, s; m/s^2
SETTLE = 1.0  # s after the start of a log or a gap: how the vehicle moved is not known there
NORTH = 0.3  # rad, from which on a heading is not zero
SMOOTHED, MOMENT = 0.08, 0.2  # s: longer than a wing beat; in which a pilot's or planner's wishes change less than the vehicle moves


def measured(log):
    """What the log has of CHANNELS (K, 9)."""
    return log.x[:, COLUMNS]


def turns_yaw(log):
    """Whether u is the twist, and not the dihedral: within a moment it goes with the axis that its controller holds."""
    rows = max(round(MOMENT / log.dt), 1)
    short = max(round(SMOOTHED / log.dt), 1)

    def change(values):
        return values[rows:] - values[:-rows]

    def left(angle, rate):
        columns = [np.unwrap(angle), *(np.convolve(rate, np.full(n, 1 / n))[: len(rate)] for n in (short, max(short // 3, 1)))]
        X, u = np.column_stack([change(c) for c in columns]), change(log.u[:, 0])
        return np.sum((u - X @ np.linalg.lstsq(X, u, rcond=None)[0]) ** 2)

    return bool(left(log.x[:, 8], log.x[:, 2]) < left(log.x[:, 6], log.x[:, 1]))


def heading(log):
    """Heading (rad) that the controller holds: zero where the vehicle took off, or else where the log has it mostly."""
    usual = float(np.median(np.unwrap(log.x[:, 8])))
    return usual if abs(usual) > NORTH else 0.0


def settled(log):
    """Rows (K,) that the observer has come to know."""
    return observed.settled(log, SETTLE)


def predictable(log):
    """Rows that the observer knows and from which the longest horizon can be predicted."""
    return observed.predictable(log, settled(log))


# ---- the observer ------------------------------------------------------------------------------


def _linear(dt):
    """(A (16, 16), C (9, 16)) of the hovering vehicle from row to row: what is corrected, and what is sensed of it."""
    state = bridge.FWMAV_STATE
    rigid = [*range(*state["velocity"].indices(99)), *range(7, 10), *range(*state["spin"].indices(99))]
    unit = np.r_[np.ones(3), np.full(3, 0.5), np.ones(3)]  # of a quaternion, half a tilt
    hover, command, h = bridge.fwmav_hover(), np.array([[bridge.fwmav_hover()[state["beat"]], 0, 0, 0]]), 1e-4
    rest = bridge.fwmav_roll(hover, command, dt)[1]
    A, C = np.zeros((16, 16)), np.zeros((9, 16))
    for j, i in enumerate(rigid):
        moved = hover.copy()
        moved[i] += h * unit[j]
        A[:9, j] = (bridge.fwmav_roll(moved, command, dt)[1] - rest)[rigid] / unit / h
    kept = np.exp(-dt / LASTING)
    A[9:15, 9:15] = kept * np.eye(6)
    A[15, 15] = np.exp(-dt / CLIMBING)
    A[2, 15], C[5, 15] = GRAVITY * dt, GRAVITY
    A[:3, 9:12] = A[6:9, 12:15] = 0.5 * (1 + kept) * dt * np.eye(3)
    A[3:6, 12:15] = 0.5 * dt**2 * np.eye(3)
    C[:3, 6:9] = C[3:6, 9:12] = np.eye(3)
    slope = (A[:3, :9] - np.eye(3, 9)) / dt  # what is felt: change of velocity but for gravity, which only a tilt brings in
    slope[:, 3:6] = 0
    C[3:6, :9] = slope
    C[6:9, 6:9] = dt * np.eye(3)  # on board the attitude is known but for the turn since the last row
    return A, C


def observer_gain(log):
    """Gain (16, 9) of the stationary Kalman filter about hover, with the sensors' noise of the log."""
    A, C = _linear(log.dt)
    lost = -np.expm1(-2 * log.dt / np.r_[np.full(6, LASTING), CLIMBING])
    Q = np.diag(np.r_[np.full(9, 1e-10), np.square([*AIR, LIFT]) * lost])
    y = measured(log)
    y[:, ANGLES] = np.unwrap(y[:, ANGLES], axis=0)
    rough = np.diff(y[:, SHAKEN], axis=0), np.diff(y[:, ANGLES], n=2, axis=0)
    R = np.diag(np.concatenate([np.var(d[log.usable[-len(d) :]], axis=0) / 2 for d in rough]) + 1e-12)
    P = linalg.solve_discrete_are(A.T, C.T, Q, R)
    return P @ C.T @ np.linalg.inv(C @ P @ C.T + R)


def wrapped(missed):
    """Measured less predicted, angles in -pi..pi."""
    missed[..., ANGLES] = (missed[..., ANGLES] + np.pi) % (2 * np.pi) - np.pi
    return missed


def follower(log, gain):
    """A function (active, push=None, starts=(), steps=()) -> (innovations (K, 9), what is missed ahead) of the observer of a log."""
    yaw, held, y = turns_yaw(log), heading(log), measured(log)

    def follow(active=(), push=None, starts=(), steps=()):
        predicted, ahead = bridge.fwmav_follow(log, gain, active, yaw, held, starts, steps, push)
        if ahead is not None:
            ends = np.minimum(np.asarray(starts)[:, None] + np.asarray(steps), len(y) - 1)
            ahead = wrapped(y[ends] - ahead)
        return wrapped(y - predicted), ahead

    return follow
