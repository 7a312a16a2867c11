"""A drive of a robot with two wheels whose controller has the wrong distance between them. A camera sees the pose with noise.

python make_log.py drive.csv [SEED]
"""

import csv
import math
import random
import sys

ROWS, DT, FINE = 800, 0.05, 10  # rows, s, steps of the integration per row
TRUE, ASSUMED = 0.33, 0.30  # m between the wheels: of the robot, and in its controller
NOISE = (0.005, 0.005, 0.003)  # m, m, rad


def wheels(speed, turn):
    """Rim speeds (m/s), left and right, that the controller computes from a command."""
    return speed - turn * ASSUMED / 2, speed + turn * ASSUMED / 2


def move(pose, left, right, dt):
    """The midpoint rule."""
    speed, turn = (left + right) / 2, (right - left) / TRUE
    heading = pose[2] + turn * dt / 2
    return [pose[0] + speed * math.cos(heading) * dt, pose[1] + speed * math.sin(heading) * dt, pose[2] + turn * dt]


def drive(seed):
    """Rows (t, px, py, theta, v, omega)."""
    chance, pose, rows = random.Random(seed), [0.0, 0.0, 0.0], []
    for k in range(ROWS):
        if k % 40 == 0:
            command = chance.uniform(0.2, 1.5), chance.uniform(-1.0, 1.0)
        seen = [p + chance.gauss(0, sd) for p, sd in zip(pose, NOISE)]
        rows.append([f"{v:.6g}" for v in (k * DT, *seen, *command)])
        for _ in range(FINE):
            pose = move(pose, *wheels(*command), DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "px", "py", "theta", "v", "omega"), *drive(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
