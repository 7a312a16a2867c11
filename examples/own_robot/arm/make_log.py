"""A log of the true arm: it moves in continuous time by its own equations, encoders see its angles with noise, and its hand is heavier.

A controller leads it along smooth ways, so the log is one of a closed loop.

python make_log.py arm.csv [SEED]
"""

import csv
import math
import random
import sys

ROWS, DT, FINE = 2000, 0.01, 10  # rows, s, steps of the integration in a row
PAYLOAD = 0.12  # kg in the hand, of which arm.xml knows nothing
NOISE = 0.001  # rad
UPPER, LOWER, GRAVITY = 0.4, 0.32, 9.81  # m, m, m/s2
UPPER_MASS, UPPER_CENTRE, UPPER_INERTIA = 1.5, 0.2, 0.02  # kg, m from the joint, kg m2 about that
LOWER_MASS, LOWER_CENTRE, LOWER_INERTIA = 0.9, 0.16, 0.009
HAND_MASS, HAND_RADIUS2 = 0.4, 0.001  # kg, m2 of its inertia for each kg
DAMPING = (0.4, 0.25)  # N m s/rad


def inertias(elbow):
    """(a, b, c) of the mass matrix [[a, b], [b, c]], and what of b changes with the elbow's angle."""
    hand = HAND_MASS + PAYLOAD
    far = LOWER_MASS * LOWER_CENTRE + hand * LOWER
    c = LOWER_INERTIA + LOWER_MASS * LOWER_CENTRE**2 + hand * (LOWER**2 + HAND_RADIUS2)
    a = UPPER_INERTIA + UPPER_MASS * UPPER_CENTRE**2 + (LOWER_MASS + hand) * UPPER**2 + c + 2 * UPPER * far * math.cos(elbow)
    return a, c + UPPER * far * math.cos(elbow), c, UPPER * far * math.sin(elbow)


def weights(q):
    """Torques of gravity at both joints."""
    hand = HAND_MASS + PAYLOAD
    outer = GRAVITY * (LOWER_MASS * LOWER_CENTRE + hand * LOWER) * math.sin(q[0] + q[1])
    return GRAVITY * (UPPER_MASS * UPPER_CENTRE + (LOWER_MASS + hand) * UPPER) * math.sin(q[0]) + outer, outer


def rate(x, torque):
    """dx/dt of both angles and both velocities, by Lagrange's equations."""
    q, (v, w) = x[:2], x[2:]
    (a, b, c, slope), weight = inertias(q[1]), weights(q)
    shoulder = torque[0] - DAMPING[0] * v - weight[0] + slope * w * (2 * v + w)
    elbow = torque[1] - DAMPING[1] * w - weight[1] - slope * v * v
    return [v, w, (c * shoulder - b * elbow) / (a * c - b * b), (a * elbow - b * shoulder) / (a * c - b * b)]


def move(x, u, dt):
    """The classical Runge-Kutta method."""
    a = rate(x, u)
    b = rate([p + dt / 2 * s for p, s in zip(x, a)], u)
    c = rate([p + dt / 2 * s for p, s in zip(x, b)], u)
    d = rate([p + dt * s for p, s in zip(x, c)], u)
    return [p + dt / 6 * (i + 2 * j + 2 * k + m) for p, i, j, k, m in zip(x, a, b, c, d)]


def way(chance):
    """Angle over time: a sum of three sines, into which the arm is led from where it hangs."""
    waves = [(chance.uniform(0.15, 0.45), 2 * math.pi * chance.uniform(0.2, 1.0), chance.uniform(0, 6)) for _ in range(3)]
    return lambda t: (1 - math.exp(-t)) * (0.6 + sum(size * math.sin(speed * t + phase) for size, speed, phase in waves))


class Controller:
    """Springs and brakes between the wished angles and what the encoders see; speeds are smoothed differences."""

    def __init__(self, ways):
        self.ways, self.before, self.speed = ways, (0.0, 0.0), [0.0, 0.0]

    def __call__(self, t, seen):
        for i, (now, before) in enumerate(zip(seen, self.before)):
            self.speed[i] += 0.3 * ((now - before) / DT - self.speed[i])
        self.before = seen
        wished = [(way(t), (way(t + DT) - way(t - DT)) / (2 * DT)) for way in self.ways]
        return [k * (a - q) + b * (r - v) for k, b, (a, r), q, v in zip((30, 6), (4, 0.3), wished, seen, self.speed)]


def drive(seed):
    """Rows (t, q1, q2, tau1, tau2)."""
    chance, x, rows = random.Random(seed), [0.0, 0.0, 0.0, 0.0], []
    controller = Controller([way(chance), way(chance)])
    for k in range(ROWS):
        seen = [angle + chance.gauss(0, NOISE) for angle in x[:2]]
        torque = controller(k * DT, seen)
        rows.append([f"{v:.7g}" for v in (k * DT, *seen, *torque)])
        for _ in range(FINE):
            x = move(x, torque, DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "q1", "q2", "tau1", "tau2"), *drive(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
