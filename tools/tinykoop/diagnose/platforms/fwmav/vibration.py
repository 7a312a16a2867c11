"""How much the wing beat shakes the IMU, against healthy flights: measured, since it is noise to everything else."""

from dataclasses import dataclass

import numpy as np

from .baseline import levels, shaking

PRICE = 25.0  # of a change, in squares of its standard deviation
SMALLEST = 0.05  # share that matters
ALIKE = 0.15  # spread of the six sensors' logarithms, from which on it is not the same shaking made larger


@dataclass(frozen=True)
class Vibration:
    """Shaking by the share a more than healthy in segment (s); sd of a; evidence: squares of standard deviations."""

    a: float
    sd: float
    segment: tuple
    evidence: float
    alike: bool  # all sensors by about the same factor


def measure(log, baseline):
    """The Vibration of a log, or None."""
    change = shaking(log)
    level = levels(change, baseline.shaking, log.dt)
    T = len(level)
    good = np.isfinite(level)
    # seconds in a row are alike, and flights differ: no flight is known better than by this share of a second's spread
    sd = np.sqrt(baseline.spread**2 / np.maximum(np.arange(1, T + 1), 1) + baseline.between**2)
    value, count = np.cumsum(np.r_[0, np.where(good, level, 0)]), np.cumsum(np.r_[0, good])
    best = None
    for i in range(T):
        for j in range(i + 1, T + 1):
            n = count[j] - count[i]
            if n == 0:
                continue
            mean = (value[j] - value[i]) / n
            gain = n * mean**2 / (baseline.spread**2 + n * baseline.between**2) - PRICE * (1 + (i > 0) + (j < T))
            # what is left elsewhere counts too
            rest = count[T] - n
            if rest:
                other = (value[T] - value[j] + value[i]) / rest
                gain -= rest * other**2 / (baseline.spread**2 + rest * baseline.between**2)
            if best is None or gain > best[0]:
                best = gain, i, j, mean, n
    if best is None or best[0] <= 0 or abs(np.expm1(best[3])) < SMALLEST:
        return None
    gain, i, j, mean, n = best
    each = 0.5 * np.log(np.nanmean(change[round(i / log.dt) : round(j / log.dt)], axis=0) / baseline.shaking**2)
    end = np.inf if j == T else float(j)
    return Vibration(
        float(np.expm1(mean)),
        float(np.exp(mean) * sd[n - 1]),
        (0.0 if i == 0 else float(i), end),
        float(gain + PRICE),
        bool(np.std(each) < ALIKE),
    )
