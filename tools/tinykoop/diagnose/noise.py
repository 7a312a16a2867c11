"""The noise of the measured pose, told from the gap without knowing what causes the gap.

First third differences, which no motion survives; then what the generic model of features.py and a
velocity error of its own for every piece leave over: AR(1) by restricted maximum likelihood, tails by
Student's t.
"""

import numpy as np
from scipy import optimize, special

from . import features
from .pieces import Noise

LIGHT = 15.0  # degrees of freedom of Student's t from which on tails count as Gaussian
CORRELATED = 0.2  # innovations more correlated than that are not the noise of a sensor
FINEST = 1e-6  # m or rad: no pose is measured better
RANGE = (-0.6, 0.98)  # of the correlation from row to row


def third_differences(log):
    """A first Noise, white: from differences that a smooth motion does not reach."""
    good = log.usable[:-2] & log.usable[1:-1] & log.usable[2:]
    x = log.x.copy()
    x[:, 2] = np.unwrap(x[:, 2])
    d = np.diff(x, n=3, axis=0)[good] if good.any() else np.diff(x, n=3, axis=0)
    sd = 1.4826 * np.median(np.abs(d), axis=0) / np.sqrt(20)
    return Noise(max(float(np.hypot(sd[0], sd[1])) / np.sqrt(2), FINEST), max(float(sd[2]), FINEST))


def _restricted(r, nuisance, columns, inside):
    """(-2 log restricted likelihood but for a constant, variance) of AR(1) noise as a function of rho.

    r (S, L, c): c series of the same noise in each piece; nuisance (S, L, c, k): what is free in every
    piece; columns (F, S, L, c): what the generic model may take away.
    """
    S, L, c, k = nuisance.shape
    size = np.sqrt((columns**2).sum((1, 2, 3)))
    columns = columns[size > 1e-9] / size[size > 1e-9, None, None, None]
    count = c * int(inside.sum())
    free = np.linalg.qr((nuisance * inside[..., None, None]).reshape(S, L * c, k))[0].swapaxes(1, 2)
    rest = np.moveaxis(np.concatenate([columns, r[None]]) * inside[..., None], 0, 1).reshape(S, -1, L * c)
    # taken away before rho is known: squares of what remains keep their digits
    rest -= (rest @ free.swapaxes(1, 2)) @ free
    free, rest = (a.reshape(S, -1, L, c) for a in (free, rest))
    free_free, free_rest = _lagged(free, free, inside), _lagged(free, rest, inside)
    rest_rest = [products.sum(0) for products in _lagged(rest, rest, inside)]

    def at(rho):
        def white(products):
            first, now, across, before = products
            return first + (now - rho * across + rho**2 * before) / (1 - rho**2)

        lower = np.linalg.cholesky(white(free_free))
        taken = np.linalg.solve(lower, white(free_rest)).reshape(-1, rest.shape[1])
        left = white(rest_rest) - taken.T @ taken
        values, vectors = np.linalg.eigh(left[:-1, :-1])
        good = values > features.INDEPENDENT * max(values[-1], 1e-30) if len(values) else np.zeros(0, bool)
        gains = (vectors[:, good].T @ left[:-1, -1]) ** 2 / values[good]
        degrees = max(count - k * S - good.sum(), 1)
        variance = max(left[-1, -1] - gains.sum(), 0) / degrees + 1e-300
        log_det = np.log(1 - rho**2) * (count - c * S) + np.log(values[good]).sum()
        log_det += 2 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum()
        return degrees * np.log(variance) + log_det, variance

    return at


def _lagged(a, b, inside):
    """Sums over the rows of each piece, (S, p, q), that make the products of whitened a (S, p, L, c) and b (S, q, L, c) at any rho.

    Of the first row; of rows with rows; of rows with those before, either way; of those before with those before.
    """
    follows = inside[:, None, 1:, None]

    def products(a, b):
        return a.reshape(*a.shape[:2], -1) @ b.reshape(*b.shape[:2], -1).swapaxes(1, 2)

    first, now, before = zip(*((v[:, :, :1], v[:, :, 1:], v[:, :, :-1] * follows) for v in (a, b)))
    return products(*first), products(*now), products(now[0], before[1]) + products(before[0], now[1]), products(*before)


def _ar1(r, nuisance, columns, inside):
    """Standard deviation and rho of the noise."""
    test = _restricted(r, nuisance, columns, inside)
    rho = optimize.minimize_scalar(lambda q: test(q)[0], bounds=RANGE, method="bounded", options={"xatol": 4e-3}).x
    return max(float(np.sqrt(test(rho)[1])), FINEST), float(rho)


def estimate(pieces, active=(), weigh=True):
    """Tells `pieces` the noise and better starts, given the effects found so far.

    weigh: look for heavy tails too. Returns Student's degrees of freedom, infinite without.
    """
    pieces.settle_starts(features.Generic(pieces, active).left)
    r, (_, raw) = pieces.residual(active), features.raw_columns(pieces)
    inside = pieces.inside[..., None]
    one = inside * np.ones(2)
    time = inside * np.linspace(0, 1, pieces.L)[:, None] * np.ones(2)
    first, second = np.array([1, 0]), np.array([0, 1])
    # a place and a velocity of its own for every piece; a heading too, which turns its path
    free = np.stack([one * first, one * second, time * first, time * second, pieces.turns[..., :2, 2] * inside], -1)
    sp, rho_p = _ar1(r[..., :2], free, raw[..., :2], pieces.inside)
    turning = np.stack([one[..., :1], time[..., :1]], -1)
    st, rho_t = _ar1(r[..., 2:], turning, raw[..., 2:], pieces.inside)
    pieces.set_noise(Noise(sp, st, rho_p, rho_t), weight=1.0)
    return _tails(pieces, features.Generic(pieces, active).left) if weigh else np.inf


def trusted(pieces, generic):
    """Whether what is left is like the noise of a sensor, that is AR(1).

    On a real log it often is not: wheels that slip as they like move the robot.
    """
    e = pieces.innovations(generic.left)
    chance = 4 / np.sqrt(pieces.inside.sum())
    lags = [(e[:, lag:] * e[:, :-lag]).sum((0, 1)) / (e**2).sum((0, 1)) for lag in (1, 2, 3)]
    return bool(np.abs(lags).max() < max(CORRELATED, chance))


def for_floor(pieces, generic):
    """The noise that the gap's floor is taken from: if in doubt a small one, which closes less, not more."""
    return pieces.noise if trusted(pieces, generic) else third_differences(pieces.log)


def _tails(pieces, n):
    """Gives rows weights after Student's t where tails are heavy, keeping the variance at one."""
    e = pieces.innovations(n)
    values = e[pieces.inside]
    scale = np.median(np.abs(values), 0) / 0.6745 + 1e-12

    def surprise(log_nu):
        nu = np.exp(log_nu)
        t = values / scale * special.stdtrit(nu, 0.75) / 0.6745
        constant = special.gammaln((nu + 1) / 2) - special.gammaln(nu / 2) - 0.5 * np.log(np.pi * nu)
        return (nu + 1) / 2 * np.log1p(t**2 / nu).sum() - constant * t.size

    nu = float(np.exp(optimize.minimize_scalar(surprise, bounds=(np.log(2.1), np.log(50)), method="bounded").x))
    if nu < LIGHT:
        core = scale * 0.6745 / special.stdtrit(nu, 0.75)
        weight = (nu + 1) / (nu + (e / core) ** 2)
        weight /= np.mean((weight * e**2)[pieces.inside], axis=0)
        pieces.set_noise(pieces.noise, weight)
    return nu
