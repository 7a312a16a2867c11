"""How large the gap is and how far it shrinks: RMS error of the attitude H rows ahead of what the observer knows."""

import numpy as np

from ..prediction_errors import ahead
from ..prediction_errors.ahead import HORIZONS, rms
from .vehicle import ANGLES, CHANNELS, wrapped


def attitude(missed):
    """Angle (W, H), rad, between predicted and logged attitude, to first order."""
    return np.sqrt(np.sum(missed[..., ANGLES] ** 2, axis=-1))


def contributions(path, causes, starts):
    """{effect: {H: RMS change, rad, of the attitude predicted H rows ahead, with it}}: what it moves, free of noise."""
    whole, out = path.ahead(causes, starts, HORIZONS), {}
    for i, cause in enumerate(causes):
        rest = path.ahead(causes[:i] + causes[i + 1 :], starts, HORIZONS)
        out[cause.name] = _named(rms(attitude(wrapped(rest - whole))))
    return out


def _named(row):
    return dict(zip(map(str, HORIZONS), map(float, row)))


def summary(before, after, floor, seed=0):
    """The `gap` of the report, in rad; before, after (W, H, 9); floor (H, 9): RMS that perfect prediction would leave."""
    least = np.broadcast_to(attitude(floor), before.shape[:2])
    channels = {
        name: {"before": _named(rms(before[..., c])), "after": _named(rms(after[..., c])), "noise_floor": _named(floor[:, c])}
        for c, name in enumerate(CHANNELS)
    }
    parts = ahead.summary(attitude(before), attitude(after), least, seed)
    return {"unit": "rad", **parts, "channels": channels, "windows": len(before)}
