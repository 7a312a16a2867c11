"""Sensor noise and random motion of the robot, by maximum likelihood."""

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy import optimize

from ...bridge.whitening import Deviances, Filter

QUIET = 2e-4  # of the usual speed: less random motion than that is none
CORRELATED = 1e-2  # of a row with the next, below which sensor noise is white
BEGIN = (0.3, 0.6, 0.85)  # correlations from which a search of it begins
SHARES = (0.0, 0.01, 0.03, 0.1)  # of the usual speed, that random motion may be where a search of it begins
FAR = 100.0  # times the variance, that an outlier counts for: what is farther off is not noise
WHITE = 1e-3  # share of coloured noise that is white, which keeps the filter well conditioned
SPREAD = 30.0  # standard deviations of a start: it is free
LASTS = 3.0  # s, that random motion keeps its direction at most: what lasts longer is a cause
COARSEST = 2e7  # times the finest noise of a sensor, that it may have
AHEAD = 4  # noises whose errors of predictions are kept: they are asked for at several places
FILTERS = 2  # noises of a path whose filters are kept: a fit asks for one again and again
AT_ONCE = 8  # noises whose likelihoods are computed together
ROUNDS, TOLERANCE, STEP = 15, 0.02, 1e-4  # of the search; of -2 log likelihood; by which slopes are taken


@dataclass(frozen=True)
class Noise:
    """Standard deviations and correlations from row to row: of the sensor per channel (c,), of random motion per axis (r,)."""

    sensor: np.ndarray
    sensor_rho: np.ndarray
    process: np.ndarray
    process_rho: np.ndarray

    def quiet(self, path):
        """Without random motion."""
        return replace(self, process=QUIET * path.usual)


def white(measured, whole):
    """Standard deviations (c,) of channels (K, c), from third differences, which a smooth motion does not reach. whole: (K - 3,)."""
    return 1.4826 * np.median(np.abs(np.diff(measured, 3, axis=0)[whole]), axis=0) / np.sqrt(20)


def first(path):
    """White, without random motion."""
    sd = white(path.measured, path.whole)
    sensor = np.array([np.sqrt(np.mean(sd[path.alike == g] ** 2)) for g in path.alike])
    r = len(path.usual)
    return Noise(np.maximum(sensor, path.finest), np.zeros(len(sensor)), QUIET * path.usual, np.full(r, np.exp(-path.dt / 0.3)))


def _coloured(path, rho):
    """Without random motion, from third differences of noise that correlates so."""
    white = first(path)
    sensor = white.sensor * np.sqrt(20 / (20 - 30 * rho + 12 * rho**2 - 2 * rho**3))
    return replace(white, sensor=sensor, sensor_rho=np.full(len(sensor), rho))


def _moving(path, share):
    """White, with random motion of a share of the usual speed."""
    return replace(first(path), process=np.maximum(share, QUIET) * path.usual)


def whitened(path, noise, D, E):
    """Innovations (K, c, q) over their standard deviations."""
    made_of = noise, path.begins, path.A, path.G, path.present
    known = next((f for of, f in path.filters if all(a is b for a, b in zip(of, made_of))), None)
    if known is None:
        known = _filter(path, noise)
        path.filters = [(made_of, known), *path.filters[: FILTERS - 1]]
    return known.whiten(D, E)


def _filter(path, noise):
    coloured = noise.sensor_rho > CORRELATED
    variance = np.where(coloured, WHITE, 1.0) * noise.sensor**2 * path.present
    return Filter(
        path.begins, path.A, path.G, variance, SPREAD * path.spread, path.C, noise.process, noise.process_rho,
        np.where(coloured, noise.sensor, 0.0), np.where(coloured, noise.sensor_rho, 0.0),
    )  # fmt: skip


def ahead(path, noise, starts, horizons):
    """Variances (S, H, c) of what a perfect model misses, which starts at what was measured and is compared with what was measured."""
    of, unsure = (path.A, path.G, path.present, path.C), path.unsure(noise)[starts]
    numbers = *(getattr(noise, field.name) for field in fields(noise)), starts, np.array(horizons), unsure
    for known_of, known_numbers, known in path.variances_ahead:
        if all(a is b for a, b in zip(of, known_of)) and all(map(np.array_equal, numbers, known_numbers)):
            return known
    out = _ahead(path, noise, starts, horizons, unsure)
    path.variances_ahead = ((of, numbers, out), *path.variances_ahead[: AHEAD - 1])
    return out


def _ahead(path, noise, starts, horizons, unsure):
    n, r, c = len(path.spread), len(noise.process), len(noise.sensor)
    coloured, shown = noise.sensor_rho > CORRELATED, np.isfinite(path.present)
    outliers = np.where(shown, np.minimum(path.present, FAR), 0).sum(0) / np.maximum(shown.sum(0), 1)
    tint = np.where(coloured, noise.sensor**2, 0.0)
    white = np.where(coloured, WHITE, 1.0) * noise.sensor**2 * outliers
    back, own = np.linalg.pinv(path.C), np.eye(c)[:, : c * coloured.any()]  # coloured noise is a state, where there is any
    P = np.zeros((len(starts), n + r + own.shape[1], n + r + own.shape[1]))
    P[:, :n, :n] = back @ np.diag(tint + white) @ back.T + unsure
    P[:, n : n + r, n : n + r] = np.eye(r)
    P[:, n + r :, n + r :] = np.diag(tint @ own)
    P[:, :n, n + r :] = -back @ np.diag(tint) @ own
    P[:, n + r :, :n] = P[:, :n, n + r :].swapaxes(1, 2)
    drive = np.diag(np.concatenate([np.zeros(n), 1 - noise.process_rho**2, ((1 - noise.sensor_rho**2) * tint) @ own]))
    F = np.zeros_like(P)
    F[:, n : n + r, n : n + r] = np.diag(noise.process_rho)
    F[:, n + r :, n + r :] = np.diag(noise.sensor_rho @ own)
    H = np.concatenate([path.C, np.zeros((c, r)), own], 1)
    out = np.empty((len(starts), len(horizons), c))
    for k in range(1, max(horizons) + 1):
        rows = np.minimum(starts + k - 1, len(path.A) - 1)
        F[:, :n, :n], F[:, :n, n : n + r] = path.A[rows], path.G[rows] * noise.process
        P = F @ P @ F.swapaxes(1, 2) + drive
        if k in horizons:
            out[:, horizons.index(k)] = np.einsum("ij,sjk,ik->si", H, P, H) + white
    return out


class _Vector:
    """Noise as the numbers that a search moves: logarithms, and correlations if sensor noise is coloured."""

    def __init__(self, path, coloured):
        self.path, self.coloured = path, coloured
        self.groups = np.unique(path.alike)
        self.pick = np.searchsorted(self.groups, path.alike)
        g, r = len(self.groups), len(path.usual)
        self.cuts = np.cumsum([g, r, 1])
        finest = [path.finest[path.alike == group].min() for group in self.groups]
        self.bounds = [*((np.log(f), np.log(COARSEST * f)) for f in finest), *([(np.log(QUIET), np.log(2.0))] * r)]
        self.bounds += [(np.log(path.dt / 2), np.log(max(LASTS, 2 * path.dt))), *([(0.0, 0.97)] * g * coloured)]

    def of(self, noise):
        first = [int(np.argmax(self.path.alike == g)) for g in self.groups]
        tau = -self.path.dt / np.log(noise.process_rho[0])
        z = [*np.log(noise.sensor[first]), *np.log(noise.process / self.path.usual), np.log(tau)]
        z += [*np.maximum(noise.sensor_rho[first], BEGIN[0])] if self.coloured else []
        return np.clip(z, *np.transpose(self.bounds))

    def noise(self, z):
        return Noise(*(values[0] for values in self.noises(z[None])))

    def noises(self, z):
        """What Noise has, of each of the vectors z (m, p)."""
        g, m, t = self.cuts
        sensor, process, tau, rho = z[:, :g], z[:, g:m], z[:, m:t], z[:, t:]
        keeps = np.repeat(np.exp(-self.path.dt / np.exp(tau)), m - g, 1)
        rho = rho if self.coloured else np.zeros((len(z), g))
        return np.exp(sensor)[:, self.pick], rho[:, self.pick], np.exp(process) * self.path.usual, keeps


def likeliest(path, noise, D, E, rounds=ROUNDS, coloured=None):
    """(Noise, -2 log likelihood) of residuals D (K, n, 1), E (K, c, 1), from where `noise` is.

    coloured: whether the sensor's noise may be; if not given, whether it is.
    """
    vector = _Vector(path, bool((noise.sensor_rho > CORRELATED).any()) if coloured is None else coloured)

    residual = Deviances(path.begins, path.A, path.G, path.present, SPREAD * path.spread, path.C, D[..., 0], E[..., 0])

    def deviances_of(zs):
        """-2 log likelihoods of vectors (m, p), some at a time."""
        return np.concatenate([of_some(*vector.noises(some)) for some in np.array_split(zs, -(-len(zs) // AT_ONCE))])

    def of_some(sensor, rho, process, process_rho):
        coloured = rho > CORRELATED
        white = np.where(coloured, WHITE, 1.0) * sensor**2
        return residual.under(process, process_rho, white, np.where(coloured, sensor, 0.0), rho)

    def with_slope(z):
        values = deviances_of(np.concatenate([[z], z + STEP * np.eye(len(z))]))
        return values[0], (values[1:] - values[0]) / STEP

    others = [_coloured(path, rho) for rho in BEGIN] if vector.coloured else [_moving(path, share) for share in SHARES]
    starts = np.array([vector.of(n) for n in (noise, noise.quiet(path), *others)])
    begun = deviances_of(starts)
    found = optimize.minimize(
        with_slope, starts[begun.argmin()], jac=True, method="L-BFGS-B", bounds=vector.bounds,
        options={"maxiter": rounds, "ftol": TOLERANCE / max(abs(begun.min()), 1.0)},
    )  # fmt: skip
    return vector.noise(found.x), float(found.fun)
