"""A run of the true drive: it moves in continuous time, encoders see it with noise, and its load is heavier than two_mass.c has it.

python make_log.py drive.csv [SEED]
"""

import csv
import random
import sys

ROWS, DT, FINE = 2000, 0.01, 50  # rows, s, steps of the integration in a row
MOTOR, LOAD = 0.01, 0.03 * 1.3  # kg m2: the load is 30 % heavier, of which the FMU knows nothing
STIFFNESS, DAMPING, FRICTION = 60.0, 0.1, 0.04  # N m/rad, N m s/rad, N m s/rad
NOISE = 1e-3  # rad


def rate(x, torque):
    """d/dt of (motor angle, load angle, motor speed, load speed)."""
    motor, load, motor_speed, load_speed = x
    shaft = STIFFNESS * (motor - load) + DAMPING * (motor_speed - load_speed)
    return motor_speed, load_speed, (torque - shaft - FRICTION * motor_speed) / MOTOR, (shaft - FRICTION * load_speed) / LOAD


def move(x, torque, dt):
    """The midpoint method."""
    middle = [a + dt / 2 * b for a, b in zip(x, rate(x, torque))]
    return [a + dt * b for a, b in zip(x, rate(middle, torque))]


def drive(seed):
    """Rows (t, motor, load, torque): torques that last for 0.1 to 0.4 s, drawn so that the drive is turned to and fro."""
    chance, x, rows, torque, left = random.Random(seed), [0.0] * 4, [], 0.0, 0
    for k in range(ROWS):
        if left == 0:
            torque, left = chance.uniform(-2, 2), chance.randint(10, 40)
        left -= 1
        rows.append([f"{v:.8g}" for v in (k * DT, *(angle + chance.gauss(0, NOISE) for angle in x[:2]), torque)])
        for _ in range(FINE):
            x = move(x, torque, DT / FINE)
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "phi_motor", "phi_load", "torque"), *drive(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
