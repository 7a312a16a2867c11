"""A flight of the true quadrotor: it moves in continuous time, cameras see it with noise, and it carries a payload.

Without its controller it would fall over, so the log is one of a closed loop.

python make_log.py quadrotor.csv [SEED]
"""

import csv
import math
import random
import sys

ROWS, DT, FINE = 2000, 0.02, 20  # rows, s, steps of the integration in a row
MASS, INERTIA, GRAVITY = 0.8, 0.006, 9.81  # kg, kg m2, m/s2
PAYLOAD = 0.16  # kg, of which quadrotor.py knows nothing
NOISE = (0.002, 0.002, 0.004)  # m, m, rad


def rate(x, thrust, torque):
    """dx/dt of px, pz, pitch, vx, vz and pitch rate."""
    push = thrust / (MASS + PAYLOAD)
    return [*x[3:], push * math.sin(x[2]), push * math.cos(x[2]) - GRAVITY, torque / INERTIA]


def move(x, u, dt):
    """The classical Runge-Kutta method."""
    a = rate(x, *u)
    b = rate([p + dt / 2 * s for p, s in zip(x, a)], *u)
    c = rate([p + dt / 2 * s for p, s in zip(x, b)], *u)
    d = rate([p + dt * s for p, s in zip(x, c)], *u)
    return [p + dt / 6 * (i + 2 * j + 2 * k + m) for p, i, j, k, m in zip(x, a, b, c, d)]


def limited(value, most):
    return max(-most, min(most, value))


class Controller:
    """Position asks for a pitch, pitch for a torque; speeds are smoothed differences of what the cameras see."""

    def __init__(self):
        self.before, self.speed = None, [0.0, 0.0, 0.0]

    def __call__(self, seen, goal):
        for i, (now, before) in enumerate(zip(seen, self.before or seen)):
            self.speed[i] += 0.5 * ((now - before) / DT - self.speed[i])
        self.before = seen
        (x, z, pitch), (vx, vz, turning) = seen, self.speed
        lean = limited(0.2 * limited(goal[0] - x, 1.5) - 0.2 * vx, 0.5)
        thrust = MASS * (GRAVITY + limited(6 * (goal[1] - z) - 4 * vz, 5)) / math.cos(limited(pitch, 0.8))
        return thrust, INERTIA * limited(60 * (lean - pitch) - 12 * turning, 60)


def fly(seed):
    """Rows (t, x, z, pitch in degrees, thrust, torque) on the way to random places."""
    chance, controller, x, goal, rows = random.Random(seed), Controller(), [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], None, []
    for k in range(ROWS):
        if k % 75 == 0:
            goal = chance.uniform(-2, 2), chance.uniform(0.5, 2.5)
        seen = [value + chance.gauss(0, sd) for value, sd in zip(x, NOISE)]
        u = controller(seen, goal)
        rows.append([f"{v:.6g}" for v in (k * DT, *seen[:2], math.degrees(seen[2]), *u)])
        for _ in range(FINE):
            x = move(x, u, DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "z", "pitch", "thrust", "torque"), *fly(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
