"""A drive of the true robot: MuJoCo by another integrator in steps of 1 ms, a camera with noise, and a drive that is weak.

../../../build/venv/bin/python make_log.py two_wheeler.csv [SEED]
"""

import csv
import math
import random
import sys
from pathlib import Path

import mujoco

ROWS, DT, STEP = 2000, 0.02, 0.001  # rows, s, s
WEAK = 0.08  # part of its speed that the left wheel lacks, of which two_wheeler.xml knows nothing
NOISE = (0.002, 0.002, 0.003)  # m, m, rad


def robot():
    """Model and data of the true robot."""
    spec = mujoco.MjSpec.from_file(str(Path(__file__).with_name("two_wheeler.xml")))
    spec.option.timestep, spec.option.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    model = spec.compile()
    return model, mujoco.MjData(model)


def drive(seed):
    """Rows (t, x, y, yaw in degrees, left, right) with new wheel speeds every half a second."""
    chance, (model, data), rows = random.Random(seed), robot(), []
    for k in range(ROWS):
        if k % 25 == 0:
            ahead, turn = chance.uniform(-4, 14), chance.uniform(-4, 4)
            left, right = ahead - turn, ahead + turn
        pose = [data.joint(name).qpos[0] + chance.gauss(0, sd) for name, sd in zip(("x", "y", "yaw"), NOISE)]
        turned = (math.degrees(pose[2]) + 180) % 360 - 180
        rows.append([f"{v:.7g}" for v in (k * DT, *pose[:2], turned, left, right)])
        data.ctrl[:] = left * (1 - WEAK), right
        mujoco.mj_step(model, data, round(DT / STEP))
    return rows


if __name__ == "__main__":
    with open(sys.argv[1], "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "y", "yaw", "left", "right"), *drive(int(sys.argv[2]) if len(sys.argv) > 2 else 1)])
