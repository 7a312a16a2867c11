"""Where the gap lies: in which channel, when, in what kind of flight, and at which frequencies."""

import numpy as np
from scipy import signal

from ..prediction_errors.ahead import HORIZONS
from ..prediction_errors.fit import Fitter
from .gap import attitude
from .vehicle import ANGLES, CHANNELS

BLOCKS, BINS = 8, 4
BANDS = ((0.0, 1.0), (1.0, 3.0), (3.0, 8.0), (8.0, 25.0), (25.0, 50.0))  # Hz: drift, manoeuvres, loop, wing beat, its harmonics
SEGMENT = 200  # rows of a spectrum
LOUD = 1.3  # times the noise of healthy flights, from which on a band is named


def explained(path, fit):
    """What is systematic of the squared whitened innovations (K, 9): what the effects take away, or all beyond noise if there are none."""
    fitter = Fitter(path, path.noises.first(path))
    before, after = (fitter.fit_of(causes).left.reshape(path.present.shape) ** 2 for causes in ((), fit.causes))
    return before - after if fit.causes else np.where(path.known[:, None], before - 1, 0.0)


def channels(systematic):
    """Share of each channel."""
    size = np.maximum(systematic.sum(axis=0), 0)
    return dict(zip(CHANNELS, map(float, size / (size.sum() or 1.0))))


def _excess(before, floor):
    """Squared attitude error (W,) at the longest horizon above the noise, in units of the noise."""
    least = np.sum(floor[-1, ANGLES] ** 2)
    return np.maximum(np.nan_to_num(attitude(before)[:, -1]) ** 2 / least - 1, 0)


def segments(systematic, log, edges):
    """[(t0, t1, share of what is systematic)] between the edges found, or in equal blocks."""
    end = (len(log.x) - 1) * log.dt
    inner = sorted({float(e) for e in edges if 0 < e < end})
    bounds = [0.0, *inner, end] if inner else list(np.linspace(0, end, BLOCKS + 1))
    part = np.minimum(np.searchsorted(bounds, np.arange(len(log.x)) * log.dt, side="right") - 1, len(bounds) - 2)
    size = np.maximum(np.bincount(part, systematic.sum(axis=1), minlength=len(bounds) - 1), 0)
    share = size / (size.sum() or 1.0)
    return [[float(a), float(b), float(s)] for a, b, s in zip(bounds, bounds[1:], share)]


def regions(before, floor, starts, log):
    """Kinds of flight with more than their share of the gap, worst first."""
    H = HORIZONS[-1]
    mean = lambda v: np.array([v[a : a + H].mean() for a in starts])  # noqa: E731
    u = log.u[:, 0]
    variables = {
        "tilt": (mean(np.hypot(log.x[:, 6], log.x[:, 7])), "rad"),
        "pitch": (mean(log.x[:, 6]), "rad"),
        "yaw rate": (mean(np.abs(np.gradient(np.unwrap(log.x[:, 8]), log.dt))), "rad/s"),
        "size of u": (mean(np.abs(u - np.median(u))), "rad"),
        "changes of u": (mean(np.abs(np.gradient(u, log.dt))), "rad/s"),
    }
    excess, out = _excess(before, floor), []
    whole = excess.mean() or 1.0
    for name, (values, unit) in variables.items():
        edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
        for low, high in zip(edges, edges[1:]):
            inside = (values >= low) & (values <= high)
            if inside.sum() >= 10:
                ratio = float(excess[inside].mean() / whole)
                out.append({"variable": name, "unit": unit, "from": float(low), "to": float(high), "times_average": ratio})
    return sorted(out, key=lambda region: -region["times_average"])[:5]


def spectrum(missed, dt):
    """(frequencies (F,), power (F, 9)) of innovations; rows that are not known count as nothing missed."""
    return signal.welch(np.nan_to_num(missed), 1 / dt, nperseg=min(SEGMENT, len(missed)), axis=0)


def frequencies(missed, healthy, log, known):
    """Bands of a channel with more power than on healthy flights, worst first."""
    f, power = spectrum(np.where(known[:, None], missed, 0), log.dt)
    least = np.mean([spectrum(own, flight.dt)[1] for flight, own in healthy.flights], axis=0)
    out = []
    for low, high in BANDS:
        band = (f >= low) & (f < high)
        for c, name in enumerate(CHANNELS):
            ratio = float(np.sqrt(power[band, c].sum() / least[band, c].sum()))
            if ratio > LOUD:
                out.append({"channel": name, "from_hz": low, "to_hz": high, "times_noise": ratio})
    return sorted(out, key=lambda band: -band["times_noise"])[:6]
