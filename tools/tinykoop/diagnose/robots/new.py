"""A robot's file to begin with."""

from pathlib import Path

from ...plumbing.errors import UserError
from ...plumbing.results import write_bytes

TOML = """# A robot for `tinykoop diagnose LOG.csv --robot {name}.toml`. Change names, columns and units to your own.
name = "{name}"

[log]  # columns of the CSV. Units are turned into those of your simulator: deg, deg/s, ms, mm, km/h, rpm, ..
time = {{column = "t", unit = "s"}}
state = [
  {{name = "px", column = "x", unit = "m"}},
  {{name = "py", column = "y", unit = "m"}},
  {{name = "yaw", column = "yaw", unit = "rad", wraps = true}},  # an angle that jumps by a turn
]
command = [
  {{name = "speed", column = "v_cmd", unit = "m/s"}},
  {{name = "yaw_rate", column = "w_cmd", unit = "rad/s"}},
]
# Columns that measure what commands do, or a state again: the report then says in which link the gap arises.
# extra = [{{name = "odometer", column = "v", unit = "m/s", measures = "speed"}}]

[simulator]  # what you believe the robot does; `tinykoop diagnose` says what is missing in it
python = "{name}.py:step"
# library = "./{name}.so:step"  # int step(const double *x, const double *u, double dt, const double *params, double *x_next)
# fmu = "{name}.fmu"  # of FMI 2.0 or 3.0, for co-simulation
# hidden = ["vx"]  # states that no column measures, behind those of the log

# [[parameter]]  # of the simulator, that may be wrong: params[0] in step()
# name = "wheelbase"
# unit = "m"
# value = 0.33
# low = 0.2
# high = 0.6
# usual = 0.05  # by which it may well be off

# [effects]
# use = ["gain", "lag", "delay"]  # kinds that may act; without this line all of `tinykoop effects --robot {name}.toml`

[report]
gap = [{{name = "position", unit = "m", states = ["px", "py"]}}, {{name = "heading", unit = "rad", states = ["yaw"]}}]
"""

PYTHON = '''"""The simulator of {name}.toml: where the robot is one step later."""

import numpy as np


def step(x, u, dt, params):
    """States (W, n) `dt` seconds after x (W, n), under commands u (W, m): one row for each of W windows."""
    px, py, yaw = x.T
    speed, yaw_rate = u.T
    return np.stack([px + dt * speed * np.cos(yaw), py + dt * speed * np.sin(yaw), yaw + dt * yaw_rate], 1)
'''


def run(name):
    """Writes NAME.toml and NAME.py into this folder."""
    if not name.isidentifier():
        raise UserError(f"{name}: is not a valid robot name; use letters, digits and _")
    for text, ending in ((TOML, ".toml"), (PYTHON, ".py")):
        path = Path(f"{name}{ending}")
        if path.exists():
            raise UserError(f"{path}: already exists; choose another name, or remove it")
        write_bytes(path, text.format(name=name).encode())
        print(path)
