"""What a flight shows on average: what the controller asks of the rotors to stay in the air, and how far the vehicle answers otherwise.

A controller holds its vehicle whatever acts on it, so a constant cause shows in what it asks for, and hardly in how the vehicle moves.
Only the requests and the battery's voltage are needed; a feature whose columns a log lacks is NaN.
"""

from dataclasses import dataclass

import numpy as np

from ....platforms import COLUMNS, COMMANDS
from ....plumbing.errors import UserError
from .response import response

# name: (unit, what it is)
TABLE = {
    "thrust": ("1", "mean request that carries the vehicle: times the cosine of its tilt"),
    "roll": ("1", "request of the left rotors less the right ones, over four"),
    "pitch": ("1", "request of the front rotors less the rear ones, over four"),
    "yaw": ("1", "request of rotors 1 and 3 less 2 and 4, over four"),
    "drift": ("1", "by how much the mean request rises over the log"),
    "roll drift": ("1", "the same of roll"),
    "pitch drift": ("1", "the same of pitch"),
    "yaw drift": ("1", "the same of yaw"),
    "swing": ("1", "logarithm of the acceleration that is neither tilt nor drag, m/s^2"),
    "push x": ("m/s^2", "mean acceleration in x that is neither tilt nor drag"),
    "push y": ("m/s^2", "the same in y"),
    "drag": ("1/s", "acceleration over velocity"),
    "gyro x": ("rad/s", "gyro less the change of the angles"),
    "gyro y": ("rad/s", "the same about y"),
    "gyro z": ("rad/s", "the same about z"),
    "acceleration x": ("m/s^2", "acceleration less the change of the velocity, forward"),
    "acceleration y": ("m/s^2", "the same to the left"),
    "acceleration z": ("m/s^2", "the same upwards"),
    "lag": ("s", "time constant of the answer to a request"),
    "delay": ("s", "delay of the answer to a request"),
    "vibration": ("1", "logarithm of what gyro and acceleration change from row to row"),
}
NAMES = tuple(TABLE)
REQUESTS = NAMES[:8]  # that are told in 1 of the mean request
STATES = tuple(name for name in COLUMNS["quadrotor"] if name not in COMMANDS)
ROTORS = (1, 2, 3, 4)  # front right, rear right, rear left, front left
MIX = np.array([[1, 1, 1, 1], [-1, -1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1]]) / 4  # requests of rotors -> thrust, roll, pitch, yaw
GRAVITY = 9.81  # m/s^2
SMOOTH = 0.5  # s, over which thrust is averaged to see whether a flight is steady, and accelerations
AIRBORNE, STEADY = 0.5, 0.08  # of the largest thrust; of the usual one, that a steady flight differs from it at most
LEAST, TRIMMED = 1.0, 0.25  # s, of a steady part, and of each of its ends that is left out
ROUNDS = 3  # of looking for the usual thrust
BLOCK, FEWEST = 3.0, 2  # s of steady flight, whose means tell how sure a mean is, and how many of them there are at least
EDGE, LIMITED = 0.01, 0.5  # of full thrust, so near to a limit is at it; share of rows at one, from which on a balance says nothing
SLOW = 0.1  # m/s, standard deviation of the speed, below which drag does not show
SHAKEN = ("gx", "gy", "gz", "ax", "ay", "az")
ROUND_OFF = 1e-12  # a column that never changes is not shaken


@dataclass(frozen=True)
class Features:
    """values, errors (F,): in the order of NAMES, with their standard errors within the flight, NaN where the log lacks a column.

    volts: mean voltage; seconds: of steady flight; middle: its mean time, in 1 of the log.
    """

    values: np.ndarray
    errors: np.ndarray
    volts: float
    seconds: float
    middle: float

    @property
    def asked(self):
        """Mean requests in thrust, roll, pitch and yaw (4,)."""
        return self.values[:4]

    @property
    def rotors(self):
        """Mean requests of the rotors (4,)."""
        return np.linalg.solve(MIX, self.asked)


# ---- steady flight ---------------------------------------------------------------------------------


def smoothed(values, rows):
    """Moving average over so many rows, the ends held."""
    rows = max(rows, 1)
    before, after = rows // 2, rows - 1 - rows // 2
    return np.convolve(np.pad(values, (before, after), "edge"), np.full(rows, 1 / rows), "valid")


def runs(rows):
    """[(first, last + 1)] of stretches of true rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
    return list(zip(edges[::2], edges[1::2]))


def steady(log):
    """Rows (K,) of steady flight: take-off, landing and climbs ask for another thrust."""
    thrust = smoothed(np.nan_to_num(log.u[:, :4]).sum(1), round(SMOOTH / log.dt))
    flies = thrust > AIRBORNE * thrust.max()
    for _ in range(ROUNDS):
        flies = np.abs(thrust - np.median(thrust[flies])) < STEADY * np.median(thrust[flies]) if flies.any() else flies
    whole = np.isfinite(log.u[:, :4]).all(1) & np.append(log.usable, True)
    out, end = np.zeros(len(thrust), bool), round(TRIMMED / log.dt)
    for first, last in runs(flies & whole):
        if (last - first) * log.dt >= LEAST:
            out[first + end : last - end] = True
    return out


# ---- features --------------------------------------------------------------------------------------


def of(log):
    """The Features of a flight. Raises UserError where nothing of it is steady."""
    rows = steady(log)
    if not rows.any():
        raise UserError(
            f"{getattr(log, 'path', 'the flight')}: nowhere is the thrust steady for {LEAST:g} s; record a flight with some seconds of hover or cruise"
        )
    found, t = dict.fromkeys(NAMES, (np.nan, np.nan)), np.arange(len(log.u)) * log.dt
    x = dict(zip(STATES, log.x.T))
    for angle in ("roll", "pitch", "yaw"):
        x[angle] = _unwrapped(x[angle])
    blocks = np.array_split(np.flatnonzero(rows), max(round(rows.sum() * log.dt / BLOCK), FEWEST))
    found |= _requests(log, blocks, t / t[-1]) | _gyro(x, log.dt, blocks) | _acceleration(x, log.dt, blocks)
    found |= _pushes(x, log.dt, rows) | _shaking(x, rows) | response(log, rows)
    values, errors = np.array([found[name] for name in NAMES], float).T
    return Features(values, errors, float(log.u[rows, 4].mean()), float(rows.sum() * log.dt), float((t / t[-1])[rows].mean()))


def _unwrapped(angle):
    known = np.isfinite(angle)
    out = np.full(len(angle), np.nan)
    out[known] = np.unwrap(angle[known])
    return out


def _mean(values, blocks):
    """(mean, standard error) over steady flight."""
    means = np.array([values[block].mean() for block in blocks])
    return means.mean(), means.std(ddof=1) / np.sqrt(len(means))


def _requests(log, blocks, share):
    """Of rotors that are at their limits for a while the mean is not what balances the vehicle."""
    asked, rows = log.u[:, :4] @ MIX.T, np.concatenate(blocks)
    asked[:, 0] *= _upright(log)
    if (np.abs(log.u[rows, :4] - 0.5) > 0.5 - EDGE).any(1).mean() > LIMITED:
        return {}
    out = {name: _mean(column, blocks) for name, column in zip(NAMES[:4], asked.T)}
    return out | {name: _drift(column, share, blocks) for name, column in zip(NAMES[4:8], asked.T)}


def _drift(values, share, blocks):
    """(rise over the log, its standard error)."""
    at, means = (np.array([column[block].mean() for block in blocks]) for column in (share, values))
    around = at - at.mean()
    slope = around @ means / (around @ around)
    left = means - means.mean() - slope * around
    return slope, np.sqrt(left @ left / max(len(at) - 2, 1) / (around @ around)) if len(at) > 2 else np.inf


def _upright(log):
    """Share (K,) of the thrust that carries the vehicle: the more it tilts, the more it is asked for; 1 for a tilt that the log lacks."""
    return np.prod([np.cos(np.nan_to_num(log.x[:, STATES.index(angle)])) for angle in ("roll", "pitch")], axis=0)


def _gyro(x, dt, blocks):
    """Gyro less the angular velocity that the angles show (body axes)."""
    roll, pitch, yaw = (np.gradient(x[angle], dt) for angle in ("roll", "pitch", "yaw"))
    sr, cr, sp, cp = np.sin(x["roll"]), np.cos(x["roll"]), np.sin(x["pitch"]), np.cos(x["pitch"])
    turns = roll - yaw * sp, pitch * cr + yaw * cp * sr, yaw * cp * cr - pitch * sr
    return {f"gyro {axis}": _mean(x[f"g{axis}"] - turn, blocks) for axis, turn in zip("xyz", turns)}


def _acceleration(x, dt, blocks):
    """Acceleration less the change of the velocity, in axes that turn with the heading."""
    away = [x[f"a{axis}"] - np.gradient(x[f"v{axis}"], dt) for axis in "xyz"]
    c, s = np.cos(x["yaw"]), np.sin(x["yaw"])
    turned = c * away[0] + s * away[1], c * away[1] - s * away[0], away[2]
    return {f"acceleration {axis}": _mean(values, blocks) for axis, values in zip("xyz", turned)}


def _pushes(x, dt, rows):
    """Horizontal accelerations that tilt does not make, over SMOOTH each: a constant, drag, and what is left.

    A vehicle that hardly moves does not show its drag.
    """
    n, c, s = round(SMOOTH / dt), np.cos(x["yaw"]), np.sin(x["yaw"])
    ahead, left = GRAVITY * np.tan(x["pitch"]), -GRAVITY * np.tan(x["roll"])
    tilt = c * ahead - s * left, s * ahead + c * left
    starts = np.concatenate([np.arange(first, last - n, n) for first, last in runs(rows)])
    mean = lambda values: np.array([values[k : k + n].mean() for k in starts])  # noqa: E731
    pushes = [(x[f"v{axis}"][starts + n] - x[f"v{axis}"][starts]) / (n * dt) - mean(part) for axis, part in zip("xy", tilt)]
    speeds = [mean(x[f"v{axis}"]) for axis in "xy"]
    if len(starts) < 4 or not np.isfinite(np.concatenate(pushes + speeds)).all():
        return {}
    ones, none = np.ones(len(starts)), np.zeros(len(starts))
    moves = bool(np.concatenate(speeds).std() > SLOW)
    parts = [(ones, none), (none, ones)] + [(-speeds[0], -speeds[1])] * moves
    A, y = np.stack([np.concatenate(part) for part in parts], 1), np.concatenate(pushes)
    found = np.linalg.lstsq(A, y, rcond=None)[0]
    size = np.sqrt(((y - A @ found) ** 2).sum() / (len(y) - len(found)))
    errors = size * np.sqrt(np.linalg.pinv(A.T @ A).diagonal())
    told = dict(zip(("push x", "push y", "drag"), zip(found, errors)))
    return told | {"swing": (np.log(max(size, ROUND_OFF)), 1 / np.sqrt(2 * len(y)))}


def _shaking(x, rows):
    """Mean logarithm of the size of second differences."""
    sizes = [np.diff(x[name], 2)[rows[2:]].std() for name in SHAKEN]
    known = [np.log(size) for size in sizes if np.isfinite(size) and size > ROUND_OFF]
    return {"vibration": (np.mean(known), 1 / np.sqrt(2 * rows.sum()))} if len(known) == len(SHAKEN) else {}
