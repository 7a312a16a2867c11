"""An arm of two joints in a vertical plane, by Lagrange's equations; a controller moves it to and fro."""

import math

from .plant import rk4

NAME, FILE = "arm", "arm/arm.toml"
DT, ROWS = 0.01, 2000
HEADER = ("t", "q1", "q2", "tau1", "tau2")
COMMANDS = ("tau1", "tau2")
SENSORS = (("q1", 0, 0.001), ("q2", 1, 0.001))

GRAVITY = 9.81
UPPER, LOWER = 0.4, 0.32  # m, lengths
CENTRES, MASSES, INERTIAS = (0.2, 0.16), (1.5, 0.9), (0.02, 0.009)  # m, kg, kg m2 about the centres
HAND, HAND_INERTIA = 0.4, 0.0004  # kg, kg m2; a heavier hand has more of both
DAMPING = (0.4, 0.25)  # N m s/rad
STIFFNESS, BRAKE = (30.0, 6.0), (4.0, 0.3)  # of the controller: N m/rad, N m s/rad
FILTER = 0.02  # s, of the speed that the controller sees

# Sizes (low, high), of either sign where `signed`.
KNOWN = {
    "parameter:payload": (0.05, 0.3), "parameter:shoulder_damping": (0.15, 0.6), "parameter:elbow_damping": (0.1, 0.4),
    "gain:tau1": (0.04, 0.12), "gain:tau2": (0.04, 0.12), "bias:tau1": (0.2, 0.8), "bias:tau2": (0.1, 0.5),
    "lag:tau1": (0.02, 0.06), "lag:tau2": (0.02, 0.06), "delay:all": (0.01, 0.02), "saturation:tau1": (8.5, 10.5),
    "dead_band:tau2": (0.3, 0.8), "sag:tau1": (0.05, 0.15), "cross:tau1<-tau2": (0.05, 0.15),
    "scale:q2": (0.02, 0.06), "sensor_delay:q2": (0.01, 0.02),
}  # fmt: skip
# N m of dry friction; N m/rad of a spring between the upper arm and a wall; N m s/rad3 of friction that grows with the angle.
UNKNOWN = {"dry_friction": (0.3, 0.8), "spring_to_the_wall": (3.0, 8.0), "friction_by_angle": (0.5, 1.5)}
SIGNED = ("gain", "bias", "cross", "scale")
# Effects that do the same, alone or together.
_SHOULDER = ("bias:tau1", "force:dq1")
_ELBOW = ("bias:tau2", "force:dq2")
_UPPER = ("parameter:shoulder_damping", "damping:dq1")
_LOWER = ("parameter:elbow_damping", "damping:dq2")
_LATE = ("delay:tau1", "delay:tau2", "delay:all")
ALIKE = {name: group for group in (_SHOULDER, _ELBOW, _UPPER, _LOWER, _LATE) for name in group}
STICKS, WALL = 0.01, 0.8  # rad/s: below it dry friction is not yet whole; rad: where the spring begins


def start(chance):
    return [chance.uniform(-0.1, 0.1), chance.uniform(-0.1, 0.1), 0.0, 0.0]


def _wish(chance, offset, size):
    """Angle over time: a sum of three sines, into which the arm is led from where it hangs."""
    waves = [(chance.uniform(0.2, 1.0), chance.uniform(0, 2 * math.pi), size * chance.uniform(0.5, 1.0) / 2) for _ in range(3)]
    return lambda t: (1 - math.exp(-t)) * (offset + sum(a * math.sin(2 * math.pi * f * t + phase) for f, phase, a in waves))


def commands(chance):
    """A controller that follows smooth angles; it differentiates what the encoders see."""
    wishes, speeds, before = (_wish(chance, 0.6, 1.0), _wish(chance, 0.8, 1.0)), [0.0, 0.0], []

    def wish(t, seen):
        for i, value in enumerate(seen):
            speeds[i] += ((value - before[i]) / DT - speeds[i]) * DT / (FILTER + DT) if before else 0.0
        before[:] = seen
        ahead = [(w(t + DT) - w(t - DT)) / (2 * DT) for w in wishes]
        return [k * (w(t) - q) + b * (a - v) for k, b, w, a, q, v in zip(STIFFNESS, BRAKE, wishes, ahead, seen, speeds)]

    return wish


def _moments(hand):
    """(coefficients of the mass matrix, of gravity) with a hand of so many kg."""
    (c1, c2), (m1, m2), (i1, i2) = CENTRES, MASSES, INERTIAS
    far = m2 * c2 + hand * LOWER
    inner = i1 + m1 * c1 * c1 + (m2 + hand) * UPPER * UPPER
    outer = i2 + m2 * c2 * c2 + hand * LOWER * LOWER + HAND_INERTIA * hand / HAND
    return inner, outer, UPPER * far, GRAVITY * (m1 * c1 + (m2 + hand) * UPPER), GRAVITY * far


def advance(effects):
    """The motion with what is in the plant itself."""
    of = lambda name: effects.get(name, 0.0)  # noqa: E731
    inner, outer, cross, weight, weight_2 = _moments(HAND + of("parameter:payload"))
    damping = [d + of(f"parameter:{name}_damping") for d, name in zip(DAMPING, ("shoulder", "elbow"))]

    def friction(q, v):
        return of("dry_friction") * math.tanh(v / STICKS) + of("friction_by_angle") * q * q * v

    def rate(x, u):
        q1, q2, v1, v2 = x
        turned = cross * math.sin(q2)
        t1 = u[0] + of("cross:tau1<-tau2") * u[1] - damping[0] * v1
        t1 += turned * (2 * v1 + v2) * v2 - weight * math.sin(q1) - weight_2 * math.sin(q1 + q2)
        t2 = u[1] - damping[1] * v2 - weight_2 * math.sin(q1 + q2) - turned * v1 * v1 - friction(q2, v2)
        t1 -= of("spring_to_the_wall") * max(q1 - WALL, 0.0)
        a12, a22 = outer + cross * math.cos(q2), outer
        a11 = inner + outer + 2 * cross * math.cos(q2)
        whole = a11 * a22 - a12 * a12
        return v1, v2, (a22 * t1 - a12 * t2) / whole, (a11 * t2 - a12 * t1) / whole

    return lambda x, u, h: rk4(rate, x, u, h)


def columns(row):
    """A row of the log, in the units of its columns."""
    return row
