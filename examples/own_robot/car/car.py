"""The simulator of car.toml: a kinematic car, as one writes it down first."""

import numpy as np


def step(x, u, dt, params):
    """States (W, 3) `dt` seconds after x (W, 3), under commands u (W, 2): one row for each of W windows."""
    px, py, yaw = x.T
    speed, steering = u.T
    (wheelbase,) = params
    return np.stack([px + dt * speed * np.cos(yaw), py + dt * speed * np.sin(yaw), yaw + dt * speed * np.tan(steering) / wheelbase], 1)
