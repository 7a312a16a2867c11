"""A run of the true pendulum: it moves in continuous time, its encoders have noise, and the force comes late.

python make_log.py pendulum.csv [SEED]
"""

import csv
import math
import random
import sys

ROWS, DT, FINE = 2000, 0.02, 10  # rows, s, steps of the integration in a row
CART, POLE, LENGTH, FRICTION, BEARING, GRAVITY = 0.6, 0.2, 0.4, 0.3, 0.004, 9.81  # kg, kg, m, N s/m, N m s/rad, m/s2
LATE = 0.06  # s: the force acts that much after it is asked for, of which pendulum.c knows nothing
NOISE = (0.001, 0.003)  # m, rad


def rate(x, force):
    """d x/dt of position, angle, velocity and angular rate: the accelerations that two balances ask for.

    Of forces along the rail:      (cart + pole) a + pole length cos b = force - friction v + pole length w^2 sin
    Of torques about the bearing:  pole length cos a + pole length^2 b = -pole gravity length sin - bearing w
    """
    _, angle, v, w = x
    arm = POLE * LENGTH
    cross, inertia = arm * math.cos(angle), arm * LENGTH
    along = force - FRICTION * v + arm * w * w * math.sin(angle)
    about = -arm * GRAVITY * math.sin(angle) - BEARING * w
    size = (CART + POLE) * inertia - cross * cross
    return v, w, (inertia * along - cross * about) / size, ((CART + POLE) * about - cross * along) / size


def move(x, force, dt):
    """The classical Runge-Kutta method."""
    a = rate(x, force)
    b = rate([p + dt / 2 * s for p, s in zip(x, a)], force)
    c = rate([p + dt / 2 * s for p, s in zip(x, b)], force)
    d = rate([p + dt * s for p, s in zip(x, c)], force)
    return [p + dt / 6 * (i + 2 * j + 2 * k + m) for p, i, j, k, m in zip(x, a, b, c, d)]


def run(seed):
    """Rows (t, x in mm, theta in degrees, f_cmd): random pushes, and a feedback that keeps the cart on its rail."""
    chance, x, push, before, asked, rows = random.Random(seed), [0.0, 0.2, 0.0, 0.0], 0.0, 0.0, [], []
    for k in range(ROWS):
        if k % 15 == 0:
            push = chance.uniform(-2.5, 2.5)
        position, angle = (value + chance.gauss(0, sd) for value, sd in zip(x, NOISE))
        force = push - 10 * position - 2 * (position - before) / DT
        before = position
        rows.append([f"{v:.6g}" for v in (k * DT, 1e3 * position, math.degrees(angle), force)])
        asked.append(float(rows[-1][3]))
        for i in range(FINE):
            at = math.floor((k + i / FINE) - LATE / DT + 1e-9)
            x = move(x, asked[max(at, 0)], DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "theta", "f_cmd"), *run(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
