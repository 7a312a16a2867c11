"""A quadrotor's log as learners take it: how the vehicle flies, by what its flight controller knows.

The state is made of the log's columns: velocities turn with the heading, requests of four rotors become thrust and three moments. What
the log lacks is left out, so that the state of a log without pitch and gyro is shorter.
"""

from dataclasses import dataclass

import numpy as np

from .. import bridge
from ..diagnose.platforms.quadrotor.features import AIRBORNE, MIX, SMOOTH, STATES, TRIMMED, runs, smoothed
from ..dictionaries import RBF, Combined, Constant, Products
from ..platforms import LEARNED
from ..plumbing.errors import UserError

NAMES = LEARNED["quadrotor"]
MOTION, ROTORS = NAMES[:8], NAMES[8:]  # how the vehicle flies, and what its rotors give
RATES = {"gx": "roll", "gy": "pitch", "gz": "yaw"}
LAG = 0.06  # s, of a rotor behind its request: that of the Crazyflie. Learned is how others differ.
HALF = 0.5  # of the rows in flight, in which a column must have a number to be used

# x[i] x[j] that the motion of a rigid body with rotors has to the second order
PAIRS = {
    "thrust": (("thrust", "roll"), ("thrust", "pitch")),  # horizontal acceleration
    "turning": (("gz", "forward"), ("gz", "left"), ("gz", "roll"), ("gz", "pitch")),  # axes that turn with the heading
    "gyroscopic": (("gx", "gy"), ("gy", "gz"), ("gz", "gx")),
}
TILT, CENTERS, WIDTH = ("roll", "pitch"), (-0.3, -0.1, 0.1, 0.3), 0.15  # rad: a grid of what vehicles tilt by, 3/4 of its spacing


@dataclass
class Learned(bridge.Log):
    """A log with x (K, n) of `states`, some of NAMES, and u (K, 4), the thrust and moments asked for."""

    states: tuple = ()


# ---- dictionaries ------------------------------------------------------------------------------------


def _products(states, kinds):
    """[Products] of the pairs that the log has both of; [] where there are none."""
    pairs = [pair for kind in kinds for pair in PAIRS[kind] if set(pair) <= set(states)]
    return [Products([tuple(states.index(name) for name in pair) for pair in pairs])] if pairs else []


def _gaussians(states):
    """On a grid of the tilt."""
    tilt = [states.index(name) for name in TILT if name in states]
    grid = np.stack(np.meshgrid(*[CENTERS] * len(tilt), indexing="ij"), -1).reshape(-1, len(tilt))
    return RBF(grid, WIDTH, states=tilt)


def dictionary(text, states=NAMES):
    """`poly` or `rbf` for these states: made of the library's parts, so firmware without a quadrotor has no byte of it.

    Both have products of thrust and tilt, and the constant, for weight and trims. poly adds further products, rbf Gaussians.
    """
    own = _products(states, PAIRS) if text == "poly" else [_gaussians(states), *_products(states, ["thrust"])]
    return Combined(*own, Constant())


# ---- logs --------------------------------------------------------------------------------------------


def airborne(log):
    """Rows (K,) in flight: on the ground requests move nothing. A vehicle stands there until its thrust is what it flies with."""
    thrust = smoothed(np.nan_to_num(log.u[:, :4]).sum(1), round(SMOOTH / log.dt))
    out, end = np.zeros(len(thrust), bool), round(TRIMMED / log.dt)
    for first, last in runs(thrust > AIRBORNE * thrust.max()):
        lifts = first + int(np.argmax(thrust[first:last] >= np.median(thrust[first:last])))
        out[lifts + end : last - end] = True
    return out


def _rates(x, log):
    """The angular velocities; those that the log lacks as the change of the angle since the row before, if there is no gap between."""
    change = lambda angle: np.append(np.nan, np.where(log.usable, np.diff(angle), np.nan)) / log.dt  # noqa: E731
    return {rate: x[rate] if np.isfinite(x[rate]).any() else change(x[angle]) for rate, angle in RATES.items()}


def _columns(log):
    """{name: (K,)} of all NAMES, NaN where the log lacks what they are made of."""
    x = dict(zip(STATES, log.x.T))
    for angle in RATES.values():
        known = np.isfinite(x[angle])
        x[angle] = x[angle].copy()
        x[angle][known] = np.unwrap(x[angle][known])
    c, s = np.cos(x["yaw"]), np.sin(x["yaw"])
    velocity = {"forward": c * x["vx"] + s * x["vy"], "left": c * x["vy"] - s * x["vx"], "up": x["vz"]}
    asked = np.nan_to_num(log.u[:, :4]) @ MIX.T
    return velocity | {name: x[name] for name in TILT} | _rates(x, log) | dict(zip(ROTORS, _lagged(asked, log.dt).T))


def _lagged(asked, dt):
    """What the rotors give (K, 4): the requests with first-order lag, up to the row before."""
    out, share = np.zeros_like(asked), 1 - np.exp(-dt / LAG)
    for k in range(1, len(asked)):
        out[k] = out[k - 1] + share * (asked[k - 1] - out[k - 1])
    return out


def learned(log, path="the log"):
    """The Learned log of a quadrotor's log, from take-off to landing; of the rows on the ground between none is usable."""
    flies, columns = airborne(log), _columns(log)
    if not flies.any():
        raise UserError(
            f"{path}: the vehicle is never in flight for {2 * TRIMMED:g} s; m1 to m4 are the thrust asked of each rotor, 0 to 1"
        )
    states = tuple(name for name in NAMES if np.isfinite(columns[name][flies]).mean() > HALF)
    if not set(states) & set(TILT):
        raise UserError(f"{path}: neither roll nor pitch in flight; a model needs one of them, and better both, with gx, gy, gz")
    x, u = np.stack([columns[name] for name in states], 1), log.u[:, :4] @ MIX.T
    whole = flies & np.isfinite(x).all(1)
    used = slice(*(np.flatnonzero(flies)[[0, -1]] + (0, 1)))
    usable = (log.usable & whole[:-1] & whole[1:] & np.isfinite(u[:-1]).all(1))[used.start : used.stop - 1]
    return Learned(log.t[used], x[used], u[used], usable, log.dt, states=states)
