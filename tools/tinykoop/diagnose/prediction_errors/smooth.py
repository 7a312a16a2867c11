"""The path that suits a log best: a simulator's steps and what was measured, weighed by their noise.

All rows at once, as one least-squares problem whose normal equations are block tridiagonal (Bell, "The iterated Kalman smoother
as a Gauss-Newton method", SIAM Journal on Optimization 4, 1994).
"""

import numpy as np
from scipy.linalg import solveh_banded

RIDGES = 1e-12, 1e-9, 1e-6  # of its own weight, that hold each state where it is: what nothing tells does not move


def weights(path, noise):
    """(of steps (K, n, n), of readings (K, c), of starts (n,)): inverse variances. floor: of states that nothing pushes."""
    grows = (1 + noise.process_rho) / (1 - noise.process_rho)  # slow motion counts for what it adds up to
    push = path.G * (noise.process * np.sqrt(grows))
    variance = push @ push.swapaxes(1, 2) + np.diag(path.exact**2)
    return np.linalg.inv(variance), 1 / (noise.sensor**2 * path.heeded()), 1 / (30 * path.spread) ** 2


def misfit(path, weights, D, E):
    """What a path costs, whose steps end D (K, n) beside it and which misses readings by E (K, c)."""
    steps, readings, _ = weights
    ends = np.einsum("ki,kij,kj->k", D[:-1], steps[:-1], D[:-1])
    return float(ends[_on(path)].sum() + (readings * E**2).sum())


def better(path, weights, D, E):
    """Deviations (K, n) of the path that would cost least, by its slopes."""
    K, n = D.shape
    diagonal, below, unit = _normal(path, weights)
    QD = np.einsum("kij,kj->ki", weights[0][:-1] * _on(path)[:, None, None], D[:-1])
    right = np.einsum("ci,kc->ki", path.C, weights[1] * E)
    right[1:] += QD
    right[:-1] -= np.einsum("kji,kj->ki", path.A[:-1], QD)
    for ridge in RIDGES:
        try:
            bands = _banded(diagonal + ridge * np.eye(n), below)
            return solveh_banded(bands, (right * unit).ravel(), lower=True, check_finite=False).reshape(K, n) * unit
        except np.linalg.LinAlgError:
            continue
    return np.zeros((K, n))


def _on(path):
    """Whether a step goes on from each row to the next (K - 1,)."""
    return path.begins[1:] == 0


def _normal(path, weights):
    """Blocks of the normal equations, on the diagonal (K, n, n) and below it (K - 1, n, n), in units (K, n) that make each state's 1."""
    steps, readings, starts = weights
    Q, A = steps[:-1] * _on(path)[:, None, None], path.A[:-1]
    diagonal = np.einsum("ci,kc,cj->kij", path.C, readings, path.C) + np.diag(starts) * np.where(path.begins, 1.0, RIDGES[0])[:, None, None]
    diagonal[1:] += Q
    diagonal[:-1] += A.swapaxes(1, 2) @ Q @ A
    unit = 1 / np.sqrt(np.einsum("kii->ki", diagonal))  # else states of other units would not be distinguished from round-off
    below = -Q @ A * unit[1:, :, None] * unit[:-1, None, :]
    return diagonal * unit[:, :, None] * unit[:, None, :], below, unit


def spread(path, weights):
    """Covariances (K, n, n) of what is told of each row by all of them."""
    diagonal, below, unit = _normal(path, weights)
    K, diagonal = len(diagonal), diagonal + RIDGES[1] * np.eye(diagonal.shape[1])
    kept, gains = np.empty_like(diagonal), np.empty_like(below)
    kept[0] = np.linalg.inv(diagonal[0])
    for k in range(K - 1):
        gains[k] = below[k] @ kept[k]
        kept[k + 1] = np.linalg.inv(diagonal[k + 1] - gains[k] @ below[k].T)
    for k in range(K - 2, -1, -1):
        kept[k] += gains[k].T @ kept[k + 1] @ gains[k]
    return kept * unit[:, :, None] * unit[:, None, :]


def _banded(diagonal, below):
    """Lower bands (2n, K n) of blocks (K, n, n) on the diagonal, and below it, column by column."""
    K, n, _ = diagonal.shape
    bands = np.zeros((2 * n, K, n))
    for i in range(n):
        for j in range(n):
            if i >= j:
                bands[i - j, :, j] = diagonal[:, i, j]
            bands[n + i - j, :-1, j] = below[:, i, j]
    return bands.reshape(2 * n, K * n)
