"""A drive of the true car: it moves in continuous time, a camera sees it with noise, and its steering is slow.

python make_log.py car.csv [SEED]
"""

import csv
import math
import random
import sys

ROWS, DT, FINE = 1500, 0.02, 10  # rows, s, steps of the integration in a row
WHEELBASE, LAG = 0.33, 0.12  # m; s: the steering follows its command by a first-order lag, of which car.py knows nothing
NOISE = (0.005, 0.005, 0.003)  # m, m, rad


def rate(pose, speed, steering):
    return speed * math.cos(pose[2]), speed * math.sin(pose[2]), speed * math.tan(steering) / WHEELBASE


def move(pose, speed, steering, dt):
    """Heun's method."""
    first = rate(pose, speed, steering)
    second = rate([p + dt * f for p, f in zip(pose, first)], speed, steering)
    return [p + dt / 2 * (a + b) for p, a, b in zip(pose, first, second)]


def drive(seed):
    """Rows (t, x, y, psi in degrees, v_cmd, delta)."""
    chance, pose, wheels, rows = random.Random(seed), [0.0, 0.0, 0.3], 0.0, []
    speed = steering = 0.0
    for k in range(ROWS):
        if k % 25 == 0:
            speed, steering = chance.uniform(0.3, 1.8), chance.uniform(-0.4, 0.4)
        seen = [p + chance.gauss(0, sd) for p, sd in zip(pose, NOISE)]
        turned = (math.degrees(seen[2]) + 180) % 360 - 180
        rows.append([f"{v:.6g}" for v in (k * DT, seen[0], seen[1], turned, speed, steering)])
        for _ in range(FINE):
            wheels += (steering - wheels) * (1 - math.exp(-DT / FINE / LAG))
            pose = move(pose, speed, wheels, DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "y", "psi", "v_cmd", "delta"), *drive(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
