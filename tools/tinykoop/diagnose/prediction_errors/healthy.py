"""Noise that healthy runs show, instead of noise.py: innovations are white once what healthy ones correlate by is taken out."""

from dataclasses import dataclass, replace

import numpy as np

from .noise import Noise

LAGS = 12  # rows of the autoregression
RIDGE = 1e-4  # share of noise that it allows for: no two runs correlate by quite the same


@dataclass(frozen=True)
class Whitener:
    """What is new in each row: L (innovation - sum of B lagged ones), of unit covariance on healthy runs.

    mean (c,): of the innovations there.
    """

    mean: np.ndarray
    B: np.ndarray  # (LAGS c, c)
    L: np.ndarray  # (c, c)

    @classmethod
    def fitted(cls, series):
        """From innovations [(K, c)] of healthy runs, NaN where there are none."""
        mean = np.nanmean(np.concatenate(series), axis=0)
        X, Y = (np.concatenate(part) for part in zip(*(_lagged(missed - mean) for missed in series)))
        good = np.isfinite(X).all(1) & np.isfinite(Y).all(1)
        X, Y = X[good], Y[good]
        gram = X.T @ X
        B = np.linalg.solve(gram + RIDGE * np.diag(np.diag(gram)), X.T @ Y)
        left = Y - X @ B
        return cls(mean, B, np.linalg.inv(np.linalg.cholesky(left.T @ left / (len(left) - len(B)))))

    def __call__(self, missed):
        """(K, c) -> (K, c), NaN where a lag is missing."""
        return self.changed(missed - self.mean)

    def changed(self, change):
        """What a change of the innovations (K, c) changes: the mean is the same."""
        X, Y = _lagged(change)
        out = np.full_like(change, np.nan)
        out[LAGS:] = (Y - X @ self.B) @ self.L.T
        return out


def _lagged(missed):
    """(K - LAGS, LAGS c) of what came before each row, and the rows themselves."""
    K = len(missed)
    return np.concatenate([missed[LAGS - i : K - i] for i in range(1, LAGS + 1)], axis=1), missed[LAGS:]


class Healthy:
    """The noise of a path as healthy runs have it: only its size is looked for.

    parts: [(rows (K,), Whitener)], each for its rows; what is in none of them is not compared. missed (H, c): RMS that predictions
    of healthy runs miss. allow() takes in what differs between them.
    """

    def __init__(self, parts, missed):
        self.parts, self.missed, self._own = parts, missed, None

    def mean(self, path):
        """Of the innovations of healthy runs (K, c)."""
        out = np.zeros(path.present.shape)
        for rows, whitener in self.parts:
            out[rows] = whitener.mean
        return out

    def allow(self, path, changes):
        """Takes into the covariance what by so much, (K, c, p), healthy runs differ."""
        columns = self._white(path, changes)
        self._own, s, _ = np.linalg.svd(columns, full_matrices=False)
        self._shrunk = 1 - 1 / np.sqrt(1 + s**2)

    def _white(self, path, D):
        """(n, q), of unit covariance on healthy runs."""
        out = np.zeros_like(D)
        for rows, whitener in self.parts:
            for j in range(D.shape[2]):
                out[rows, :, j] = whitener.changed(D[..., j])[rows]
        return np.where(np.isfinite(path.present)[..., None], out, 0.0).reshape(-1, D.shape[2])

    def first(self, path):
        c = path.present.shape[1]
        return Noise(np.ones(c), np.zeros(c), np.zeros(0), np.zeros(0))

    def whitened(self, path, noise, D, E):
        """Innovations (K, c, q), less their mean."""
        white = self._white(path, D)
        if self._own is not None:
            white = white - self._own @ (self._shrunk[:, None] * (self._own.T @ white))
        return white.reshape(D.shape) / noise.sensor[0]

    def likeliest(self, path, noise, D, E, rounds=None, coloured=None):
        """(Noise, -2 log likelihood): never less noise than healthy runs have."""
        n = np.isfinite(path.present).sum()
        cost = float((self.whitened(path, self.first(path), D, E) ** 2).sum())
        size = max(np.sqrt(cost / n), 1.0)
        return replace(noise, sensor=np.full(len(noise.sensor), size)), cost / size**2 + 2 * n * np.log(size)

    def ahead(self, path, noise, starts, horizons):
        """Variances (S, H, c) of predictions."""
        return np.tile(self.missed**2, (len(starts), 1, 1))
