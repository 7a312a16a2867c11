"""What an observer misses in each row of a flight, whitened.

The wing beat shakes every sensor, so what is missed is anything but white: but as long as vehicle and simulator are the
same, it is that of a healthy flight. A vector autoregression of such flights takes out what was to be expected.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...bridge import Effect
from .vehicle import CHANNELS, follower, observer_gain

LAGS = 12  # rows of the autoregression: two wing beats
RIDGE = 1e-4  # share of noise that it allows for: the wing beat is not the same from flight to flight
BIASES = (0.005,) * 3 + (0.1,) * 3  # of gyro and accelerometer, rad/s and m/s^2: what calibration leaves (host_sim/fwmav_flight.c)
SECONDS = 0.5  # of a piece
SETTLE = 1.0  # s after the start of a log or a gap: how the vehicle moved is not known there


@dataclass(frozen=True)
class Whitener:
    """What is new in each row: L (innovation - sum of B lagged ones), of unit covariance on healthy flights.

    mean (9,): of the innovations there, since shaking pushes the body to one side on average, and the observer's does not shake.
    """

    mean: np.ndarray
    B: np.ndarray  # (LAGS 9, 9)
    L: np.ndarray  # (9, 9)

    @classmethod
    def fitted(cls, series):
        """From innovations [(K, 9)] of healthy flights, NaN where there are none."""
        mean = np.nanmean(np.concatenate(series), axis=0)
        X, Y = (np.concatenate(part) for part in zip(*(_lagged(missed - mean) for missed in series)))
        good = np.isfinite(X).all(1) & np.isfinite(Y).all(1)
        X, Y = X[good], Y[good]
        gram = X.T @ X
        B = np.linalg.solve(gram + RIDGE * np.diag(np.diag(gram)), X.T @ Y)
        left = Y - X @ B
        return cls(mean, B, np.linalg.inv(np.linalg.cholesky(left.T @ left / (len(left) - len(B)))))

    def __call__(self, missed):
        """(K, 9) -> (K, 9), NaN where a lag is missing."""
        X, Y = _lagged(missed - self.mean)
        out = np.full_like(missed, np.nan)
        out[LAGS:] = (Y - X @ self.B) @ self.L.T
        return out


def _lagged(missed):
    """(K - LAGS, LAGS 9) of what came before each row, and the rows themselves."""
    K = len(missed)
    return np.concatenate([missed[LAGS - i : K - i] for i in range(1, LAGS + 1)], axis=1), missed[LAGS:]


class Innovations:
    """A flight followed by the observer; what pieces.Pieces is for a drive.

    base: effects that a healthy vehicle has too; differ: {effect: variances of its parameters, in usual values} by which
    healthy flights differ. A piece is a stretch of rows whose innovations are all known.
    """

    def __init__(self, platform, log, whiten, base=(), differ=None):
        self.platform, self.log, self.base = platform, log, tuple(base)
        self._gain = observer_gain(log)
        self.follow = follower(log, self._gain)
        self._whiten = whiten
        self.known = settled(log)
        self.L = max(round(SECONDS / log.dt), 1)
        runs = np.flatnonzero(np.diff(np.r_[0, self.known.astype(int), 0])).reshape(-1, 2)
        self.starts = np.concatenate([np.arange(a, b - self.L + 1, self.L) for a, b in runs] or [[]]).astype(np.int64)
        self.rows = self.starts[:, None] + np.arange(self.L)
        self._own, self._shrunk = np.zeros((self.rows.size * len(CHANNELS), 0)), np.zeros(0)
        self._allow(differ or {})

    def residual(self, active=(), push=None):
        """Measured less predicted (K, 9), with these effects beside the base."""
        return self.follow([*self.base, *active], push)[0]

    def white(self, missed):
        """(K, 9) -> (K, 9) of unit variance on a healthy flight; zero where nothing is known."""
        return np.where(self.known[:, None], np.nan_to_num(self._whiten(missed)), 0.0)

    def whiten(self, missed):
        """(K, 9) -> pieces (S, 9 L) of it; what differs between healthy flights counts for as little as it means."""
        w = self.white(missed)[self.rows].reshape(-1)
        return (w - self._own @ (self._shrunk * (self._own.T @ w))).reshape(len(self.starts), -1)

    def _allow(self, differ):
        """Takes the sensors' biases, and what differs between healthy flights, into the covariance."""
        plain = self.whiten(self.residual()).ravel()
        columns = []
        for channel, size in enumerate(BIASES):
            shifted = replace(self.log, x=self.log.x + size * np.eye(self.log.x.shape[1])[channel])
            columns.append(self.whiten(follower(shifted, self._gain)(self.base)[0]).ravel() - plain)
        for name, variances in differ.items():
            spec = self.platform.effects()[name][1]
            for i, (parameter, variance) in enumerate(zip(spec, variances)):
                if variance > 0:
                    size = np.sqrt(variance)
                    z = np.zeros(len(spec))
                    z[i] = size * (abs(parameter.usual) or 1.0)
                    z = np.clip(z, [p.low for p in spec], [p.high for p in spec])
                    columns.append(self.whiten(self.residual([Effect(name, tuple(z))])).ravel() - plain)
        self._own, s, _ = np.linalg.svd(np.stack(columns, 1), full_matrices=False)
        self._shrunk = 1 - 1 / np.sqrt(1 + s**2)

    @property
    def degrees(self):
        """Values that are left free."""
        return self.rows.size * len(CHANNELS)


def settled(log):
    """Rows that the observer has come to know."""
    since = np.zeros(len(log.x), int)
    for k in np.flatnonzero(log.usable):
        since[k + 1] = since[k] + 1
    return since >= max(round(SETTLE / log.dt), 2 * LAGS)
