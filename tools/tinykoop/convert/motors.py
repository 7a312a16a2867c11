"""Motors of PX4 and ArduPilot as a quadrotor's log has them: M1 front right, M2 rear right, M3 rear left, M4 front left."""

import numpy as np

from ..platforms import REQUIRED

MOTORS = REQUIRED["quadrotor"]
X = (1, 4, 2, 3)  # of both autopilots' usual X: their motors that are M1 .. M4


def curve(speed, quadratic):
    """Thrust of a motor's output, both of full: linear for 0, quadratic for 1."""
    return (1 - quadratic) * speed + quadratic * speed**2


def share(output, low, high):
    """Where an output is from low to high; a motor can do no less and no more."""
    return np.clip((output - low) / (high - low), 0, 1)
