"""Where the gap lies: in which channel, when, in what kind of flight, and at which frequencies."""

import numpy as np
from scipy import signal

from ... import where
from ...elsewhere import seconds
from ...prediction_errors.ahead import HORIZONS
from ...prediction_errors.fit import Fitter
from .vehicle import ANGLES, CHANNELS

# Hz
BANDS = {(0.0, 1.0): "drift", (1.0, 3.0): "manoeuvres", (3.0, 8.0): "control loop", (8.0, 25.0): "wing beat", (25.0, 50.0): "its harmonics"}
SEGMENT = 200  # rows of a spectrum
LOUD = 1.3  # times the noise of healthy flights, from which on a band is named
MOST = 6  # bands


def located(found, missed, innovations, healthy):
    """The `where` of the report. missed (W, H, 9): by predictions without effects; innovations (K, 9): the same; healthy: a Baseline."""
    path, log, systematic = found.path, found.path.log, _systematic(found.path, found.fit)
    edges = [edge for cause in found.fit.causes for span in cause.segments for edge in span]
    return {
        "channels": where.shares(CHANNELS, systematic.sum(axis=0)),
        "segments": where.parts(systematic.sum(axis=1), path.t, seconds(log), edges),
        "regions": where.regions(_excess(missed, path.noises.missed), _variables(found.starts, log)),
        "frequencies": frequencies(innovations, healthy, log, path.known),
    }


def _systematic(path, fit):
    """What is systematic of the squared whitened innovations (K, 9): what the effects take away, or all beyond noise if there are none."""
    fitter = Fitter(path, path.noises.first(path))
    before, after = (fitter.fit_of(causes).left.reshape(path.present.shape) ** 2 for causes in ((), fit.causes))
    return before - after if fit.causes else np.where(path.known[:, None], before - 1, 0.0)


def _excess(missed, floor):
    """Squared attitude error (W,) at the longest horizon above the noise, in units of the noise."""
    size = np.sum(np.nan_to_num(missed[:, -1, ANGLES]) ** 2, axis=-1)
    return np.maximum(size / np.sum(floor[-1, ANGLES] ** 2) - 1, 0)


def _variables(starts, log):
    """{name: (values (W,), unit)}: kinds of flight in the rows after each start."""
    mean = lambda v: np.array([v[a : a + HORIZONS[-1]].mean() for a in starts])  # noqa: E731
    u = log.u[:, 0]
    return {
        "tilt": (mean(np.hypot(log.x[:, 6], log.x[:, 7])), "rad"),
        "pitch": (mean(log.x[:, 6]), "rad"),
        "yaw rate": (mean(np.abs(np.gradient(np.unwrap(log.x[:, 8]), log.dt))), "rad/s"),
        "size of u": (mean(np.abs(u - np.median(u))), "rad"),
        "changes of u": (mean(np.abs(np.gradient(u, log.dt))), "rad/s"),
    }


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
    return sorted(out, key=lambda band: -band["times_noise"])[:MOST]
