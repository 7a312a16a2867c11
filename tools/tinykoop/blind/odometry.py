"""The optional columns of a log: wheel odometry and gyro, with noise and a small scale error of their own."""

import numpy as np

COLUMNS = ("v_odo", "omega_odo", "omega_imu")


def settings(random):
    """{column: (scale, noise)} of one robot's sensors; noise in m/s or rad/s."""
    sizes = zip(COLUMNS, (0.01, 0.01, 0.005), ((0.005, 0.03), (0.005, 0.03), (0.002, 0.02)))
    return {name: [float(random.uniform(-scale, scale)), float(random.uniform(*noise))] for name, scale, noise in sizes}


def measured(random, drive, sensors):
    """{column: values (K + 1)}: row k is the mean over the step that begins there, as a counter of ticks gives it."""
    true = dict(zip(COLUMNS, (drive.v, drive.w, drive.turn)))
    return {
        name: np.append((1 + scale) * true[name], true[name][-1]) + noise * random.normal(size=len(true[name]) + 1)
        for name, (scale, noise) in sensors.items()
    }


def append(path, columns):
    """Adds columns to a CSV log."""
    head, *rows = path.read_text().splitlines()
    values = ([f"{value:.6f}" for value in row] for row in np.transpose(list(columns.values())))
    lines = [",".join([head, *columns]), *(",".join([row, *more]) for row, more in zip(rows, values))]
    path.write_text("\n".join(lines) + "\n")
