"""The robot's own random motion: every wheel slips at random in proportion to its speed, and the body slides sideways.

The random slip of a wheel is AR(1): on real ground it lasts for some tenths of a second.
"""

import numpy as np
from scipy.signal import lfilter

TRACK = 0.5  # m between the wheels
SIDEWAYS = 0.3  # of the slip of a wheel


def ar1(random, columns, rows, step, tau):
    """(columns, rows) of unit variance, stationary from the first row; correlation time tau (s)."""
    kept = np.exp(-step / tau)
    draws = random.normal(size=(columns, rows))
    draws[:, 1:] *= np.sqrt(1 - kept**2)
    return lfilter([1], [1, -kept], draws)


def shake(m, size, tau):
    """Adds random motion to the body of m; size: standard deviation of a wheel's slip, a share of its speed at the rim."""
    left, right, side = size * ar1(m.random, 3, len(m.t), m.part, tau)
    left, right = left * (m.v - m.w * TRACK / 2), right * (m.v + m.w * TRACK / 2)
    m.forward += (left + right) / 2
    m.turn += (right - left) / TRACK
    m.left += SIDEWAYS * side * np.abs(m.v)
