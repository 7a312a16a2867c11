"""The flapping-wing vehicle of host_sim/."""

import ctypes as ct

import numpy as np

from ..plumbing.errors import UserError
from .library import call, doubles, ints, reals
from .logs import Log
from .unmodelled import active_effects


class Flight(ct.Structure):
    _fields_ = [("manoeuvre", ct.c_char_p), ("seed", ct.c_uint64), ("noise", ct.c_double)]


# The true state of the flapping-wing vehicle, one slice of its columns each.
FWMAV_STATE = {
    "position": slice(0, 3),  # m, world
    "velocity": slice(3, 6),  # m/s, world
    "attitude": slice(6, 10),  # quaternion w, x, y, z, body to world
    "spin": slice(10, 13),  # rad/s, body
    "beat": 13,  # wing-beat frequency, Hz
    "phase": 14,  # of the beat, rad
    "dihedral": 15,  # rad; its rate follows, as with the next two
    "twist": 17,  # rad
    "share": 19,  # of thrust, moved to the left wing
}
_FWMAV_STATES, _FWMAV_HZ = 21, 100


def flight_rows(seconds, seed, hz):
    """Rows of a flight of any vehicle; refuses what cannot be flown."""
    if not 0.03 <= seconds <= 300:
        raise UserError(f"a flight of {seconds} s cannot be flown: the shortest log is 0.03 s, the battery lasts 300 s")
    if not 0 <= seed < 2**64:
        raise UserError(f"seed is {seed}, it must be between 0 and 2^64 - 1")
    return round(seconds * hz)


def fwmav(manoeuvre, seconds, seed, active=(), noise=1.0):
    """Simulates a flight of the flapping-wing vehicle at 100 Hz: hover, pitch (u: dihedral) or yaw (u: wing twist).

    seed: of the noise. active: the effects that act. noise: factor of turbulence, IMU noise and bias. Returns the Log that
    the flight controller writes, and the true states (K, 21); FWMAV_STATE names them.
    """
    rows = flight_rows(seconds, seed, _FWMAV_HZ)
    x, u, states = np.empty((rows, 10)), np.empty((rows, 1)), np.empty((rows, _FWMAV_STATES))
    call(
        "tk_fwmav_fly", active_effects(active), ct.c_size_t(len(active)),
        ct.byref(Flight(manoeuvre.encode(), seed, noise)), ct.c_size_t(rows), doubles(x), doubles(u), doubles(states),
    )  # fmt: skip
    dt = 1 / _FWMAV_HZ
    return Log(np.arange(rows) * dt, x, u, np.ones(rows - 1, bool), dt), states


def fwmav_hover():
    """The true state (21) of the flapping-wing vehicle as it hovers, level and at rest."""
    state = np.zeros(_FWMAV_STATES)
    state[FWMAV_STATE["attitude"]] = 1, 0, 0, 0
    state[FWMAV_STATE["beat"]] = 17
    return state


def fwmav_roll(state, commands, dt, active=(), yaw=False):
    """True states (K+1, 21) of the vehicle without its controller, in still air, from `state`.

    commands (K, 4): wing-beat frequency with a full battery [Hz], dihedral, twist [rad], share; each held for dt.
    yaw: effects on the log's command act on the twist, else on the dihedral.
    """
    state, commands = reals(state), reals(commands, 4)
    if state.shape != (_FWMAV_STATES,):
        raise ValueError(f"expected a state of {_FWMAV_STATES}, got shape {state.shape}")
    states = np.empty((len(commands) + 1, _FWMAV_STATES))
    call(
        "tk_fwmav_roll", active_effects(active), ct.c_size_t(len(active)), ct.c_int(yaw), ct.c_double(dt),
        ct.c_size_t(len(commands)), doubles(state), doubles(commands), doubles(states),
    )  # fmt: skip
    return states


class _Flown(ct.Structure):
    _fields_ = [
        ("rows", ct.c_size_t),
        ("dt", ct.c_double),
        ("x", ct.POINTER(ct.c_double)),
        ("u", ct.POINTER(ct.c_double)),
        ("usable", ct.POINTER(ct.c_int32)),
        ("yaw", ct.c_int),
        ("heading", ct.c_double),
        ("gain", ct.POINTER(ct.c_double)),
        ("push", ct.POINTER(ct.c_double)),
    ]


FWMAV_SENSED = 9


def fwmav_follow(log, gain, active=(), yaw=False, heading=0.0, starts=(), steps=(), push=None):
    """An observer of the flapping-wing vehicle along a log: predicted (K, 9), ahead (S, H, 9) or None.

    Predicted are gyro (rad/s), accelerometer (m/s^2), roll, pitch and yaw (rad) of the next row; gain (16, 9) takes what
    was missed to corrections of velocity, tilt, angular velocity, the accelerations by the air and the lift. yaw: u is the
    twist, else the dihedral, and the vehicle holds this heading (rad). ahead: predictions `steps` rows after `starts` (both
    rising) without correction. push (K, 6): further accelerations (m/s^2, rad/s^2). NaN where there is nothing to predict from.
    """
    x, u, gain = reals(log.x, 10), reals(log.u, 1), reals(gain, FWMAV_SENSED)
    push = None if push is None else reals(push, 6)
    usable = np.ascontiguousarray(log.usable, np.int32)
    starts, steps = np.ascontiguousarray(starts, np.int64), np.ascontiguousarray(steps, np.int64)
    predicted = np.empty((len(x), FWMAV_SENSED))
    ahead = np.empty((len(starts), len(steps), FWMAV_SENSED)) if len(starts) else None
    flown = _Flown(len(x), log.dt, doubles(x), doubles(u), ints(usable), yaw, heading, doubles(gain), doubles(push))
    address = lambda a: a.ctypes.data_as(ct.POINTER(ct.c_int64))  # noqa: E731
    call(
        "tk_fwmav_follow", active_effects(active), ct.c_size_t(len(active)), ct.byref(flown), doubles(predicted),
        ct.c_size_t(len(starts)), address(starts), ct.c_size_t(len(steps)), address(steps), doubles(ahead),
    )  # fmt: skip
    return predicted, ahead
