"""The differential-drive robot of host_sim/."""

import ctypes as ct

import numpy as np

from .library import address, call, doubles, reals
from .unmodelled import active_effects, remembering

EULER, MIDPOINT, ARC, SEMI_IMPLICIT = 0, 1, 2, 3  # integrators; the paper's is Euler


class _Recording(ct.Structure):
    _fields_ = [
        ("rows", ct.c_size_t),
        ("dt", ct.c_double),
        ("x", ct.c_void_p),
        ("u", ct.c_void_p),
        ("usable", ct.c_void_p),
        ("warm_up", ct.c_size_t),
    ]


def simulate(u, dt, x0=(0.0, 0.0, 0.0), active=(), integrator=EULER):
    """Simulates the differential drive under commands u (K, 2) [m/s, rad/s] of dt seconds each.

    Returns the measured states (K+1, 3) [m, m, rad], from the true state x0 on. active: the effects that act.
    integrator: EULER, MIDPOINT, ARC or SEMI_IMPLICIT.
    """
    u = reals(u, 2)
    x0 = reals(x0)
    x = np.empty((len(u) + 1, 3))
    c_effects = active_effects(active)
    call(
        "tk_ddr_simulate", c_effects, ct.c_size_t(len(active)), ct.c_int(integrator), ct.c_double(dt),
        ct.c_size_t(len(u)), doubles(x0), doubles(u), doubles(x),
    )  # fmt: skip
    return x


LONG = 6_000  # rows at most, of a log that is rolled as a whole: beyond, the rows that are looked at are the smaller part
WARM_UP = 30.0  # s: ten time constants of the slowest lag that can be


def _recording(x, u, dt, usable=None):
    """The log for the C side; warm-up only where it is LONG."""
    warm_up = max(int(min(WARM_UP / dt, len(x))), 1) if len(x) > LONG and dt > 0 else 0
    return _Recording(len(x), dt, address(x), address(u), address(usable), warm_up)


class Rollouts:
    """A log's measured poses x (K, 3), predicted from its commands u (K or K-1, 2) in windows of their own.

    A window begins at the pose measured in a row of `starts` (S); `steps` (n) says how many steps later
    it is compared. Actuator states are rolled over the whole log, or if it is LONG from WARM_UP before each window, through
    what is not usable (K-1) too.
    Arrays are kept, not copied: they are to stay as they are.
    """

    def __init__(self, x, u, dt, starts, steps, usable=None, integrator=EULER):
        x, u = reals(x, 3), reals(u, 2)
        starts, steps = np.ascontiguousarray(starts, np.int64), np.ascontiguousarray(steps, np.int64)
        usable = None if usable is None else np.ascontiguousarray(usable, np.int32)
        if len(u) not in (len(x), len(x) - 1) or (usable is not None and len(usable) != len(x) - 1):
            raise ValueError(f"{len(u)} commands and usable {np.shape(usable)} do not go with {len(x)} poses")
        self._predicted, self._residual = np.empty((2, len(starts), len(steps), 3))
        self._kept = x, u, usable, starts, steps  # what the addresses are of
        log = _recording(x, u, dt, usable)
        self._arguments = (
            ct.c_int(integrator), ct.byref(log),
            ct.c_size_t(len(starts)), address(starts), ct.c_size_t(len(steps)), address(steps),
            address(self._predicted), address(self._residual),
        )  # fmt: skip

    def predict(self, active=()):
        """predicted (S, n, 3) [m, m, rad] and residual (S, n, 3), both until the next call.

        The residual is measured less predicted: along, across [m, in the axes of the pose measured at the
        start] and heading [rad, wrapped]; NaN where an unusable transition, or the end of the log, lies between.
        """
        call("tk_windows", active_effects(active), ct.c_size_t(len(active)), *self._arguments)
        return self._predicted, self._residual


REACHED = 64  # commands behind what remembers, that are kept: most trials of a search have those of another


class Steps:
    """A log's measured poses x (K, 3), each stepped once from the rows `starts` (S, ascending) under its commands u (K or K-1, 2).

    places (S): rows of what beside() returns, of `count` in all; without them, all in order.
    Actuator states are rolled as Rollouts roll them. Arrays are kept, not copied: they are to stay as they are.
    """

    def __init__(self, x, u, dt, starts, integrator=EULER, places=None, count=None):
        x, u, starts = reals(x, 3), reals(u, 2), np.ascontiguousarray(starts, np.int64)
        places = np.arange(len(starts)) if places is None else np.ascontiguousarray(places, np.int64)
        facing = np.stack([np.cos(x[:, 2]), np.sin(x[:, 2])], 1)
        self._kept = x, u, facing, starts, places  # what the addresses are of
        self._count, self._reached = len(starts) if count is None else count, {}
        log = _recording(x, u, dt)
        self._rows = ct.byref(log), ct.c_size_t(len(starts)), address(starts)
        self._arguments = (
            ct.c_int(integrator), ct.byref(log), address(facing), ct.c_size_t(len(starts)), address(starts), address(places),
        )  # fmt: skip

    def beside(self, active=()):
        """Where steps end beside the next pose (count, 3): along, across [m, in the axes of that pose] and heading [rad, wrapped].

        Zero in rows that are the place of none.
        """
        out, reached = np.zeros((self._count, 3)), self._reaches(remembering(active))
        call("tk_steps", active_effects(active), ct.c_size_t(len(active)), *self._arguments, address(reached), address(out))
        return out

    def _reaches(self, active):
        """Commands (S, 2) behind effects that remember, from the second time on that they are asked for; None before, and of none."""
        if not active:
            return None
        found = None
        if active in self._reached:
            found = self._reached.pop(active)
            if found is None:
                found = np.empty((len(self._kept[3]), 2))
                call("tk_reaches", active_effects(active), ct.c_size_t(len(active)), *self._rows, address(found))
        elif len(self._reached) >= REACHED:
            del self._reached[next(iter(self._reached))]
        self._reached[active] = found
        return found


def windows(x, u, dt, starts, steps, active=(), usable=None, integrator=EULER):
    """What Rollouts predict with one set of effects."""
    return Rollouts(x, u, dt, starts, steps, usable, integrator).predict(active)
