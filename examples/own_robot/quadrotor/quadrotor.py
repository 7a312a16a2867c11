"""The simulator of quadrotor.toml: a quadrotor that flies in a vertical plane, as one writes it down first."""

import numpy as np

GRAVITY = 9.81


def step(x, u, dt, params):
    """States (W, 6) `dt` seconds after x (W, 6), under commands u (W, 2): one row for each of W windows."""
    place, speed = x[:, :3], x[:, 3:]  # px, pz, pitch and their rates
    thrust, torque = u.T
    mass, inertia = params
    pitch = x[:, 2]
    rate = np.stack([thrust / mass * np.sin(pitch), thrust / mass * np.cos(pitch) - GRAVITY, torque / inertia], 1)
    faster = speed + dt * rate
    return np.concatenate([place + dt * (speed + faster) / 2, faster], 1)
