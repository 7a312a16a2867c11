"""The noise of the measured pose, told from the gap without knowing what causes the gap.

First third differences, which no motion survives; then what the generic model of features.py and a
velocity error of its own for every piece leave over: AR(1) by restricted maximum likelihood, tails by
Student's t.
"""

import numpy as np
from scipy import optimize, stats

from . import features
from .pieces import Noise

LIGHT = 15.0  # degrees of freedom of Student's t from which on tails count as Gaussian
CORRELATED = 0.2  # innovations more correlated than that are not the noise of a sensor
RANGE = (-0.6, 0.98)  # of the correlation from row to row


def third_differences(log):
    """A first Noise, white: from differences that a smooth motion does not reach."""
    good = log.usable[:-2] & log.usable[1:-1] & log.usable[2:]
    x = log.x.copy()
    x[:, 2] = np.unwrap(x[:, 2])
    d = np.diff(x, n=3, axis=0)[good] if good.any() else np.diff(x, n=3, axis=0)
    sd = 1.4826 * np.median(np.abs(d), axis=0) / np.sqrt(20)
    return Noise(max(np.hypot(sd[0], sd[1]) / np.sqrt(2), 1e-6), max(sd[2], 1e-6))


def _restricted(series, nuisance, inside):
    """(-2 log likelihood as a function of rho, variance at rho) of AR(1) with nuisance (S, L, k) in every piece."""

    def at(rho):
        def white(a):
            e = a.copy()
            e[:, 1:] -= rho * a[:, :-1]
            e[:, 1:] /= np.sqrt(1 - rho**2)
            return e * inside.reshape(*inside.shape, *([1] * (a.ndim - 2)))

        e, B = white(series), white(nuisance)
        q, upper = np.linalg.qr(B)
        left = e - np.einsum("slk,sk->sl", q, np.einsum("slk,sl->sk", q, e))
        free = inside.sum() - nuisance.shape[2] * len(series)
        variance = (left**2).sum() / free
        log_det = np.log(1 - rho**2) * (inside.sum() - len(series))
        log_det += 2 * np.log(np.abs(np.diagonal(upper, axis1=1, axis2=2)) + 1e-300).sum()
        return free * np.log(variance + 1e-300) + log_det, variance

    return at


def _ar1(series, nuisances, inside):
    """Standard deviation and rho of one or more series of the same noise."""
    tests = [_restricted(s, n, inside) for s, n in zip(series, nuisances)]
    found = optimize.minimize_scalar(lambda rho: sum(test(rho)[0] for test in tests), bounds=RANGE, method="bounded", options={"xatol": 1e-3})
    return float(np.sqrt(np.mean([test(found.x)[1] for test in tests]))), float(found.x)


def estimate(pieces, active=(), weigh=True):
    """Tells `pieces` the noise and better starts, given the effects found so far.

    weigh: look for heavy tails too. Returns Student's degrees of freedom, infinite without.
    """
    generic = features.Generic(pieces, active)
    pieces.settle_starts(generic.left)
    n = pieces.residual(active) - generic.part
    time = np.where(pieces.inside, np.arange(pieces.L) / pieces.L, 0)[..., None]
    offset = np.concatenate([pieces.inside[..., None], time], -1)
    along, across = (np.concatenate([offset, pieces.turns[..., i, 2:3]], -1) for i in (0, 1))
    sp, rho_p = _ar1([n[..., 0], n[..., 1]], [along, across], pieces.inside)
    st, rho_t = _ar1([n[..., 2]], [offset], pieces.inside)
    pieces.set_noise(Noise(max(sp, 1e-9), max(st, 1e-9), rho_p, rho_t), weight=1.0)
    return _tails(pieces, n) if weigh else np.inf


def trusted(pieces, generic):
    """The noise that the gap's floor may be taken from.

    What is left of a real log is often not AR(1): wheels that slip as they like move the robot and are no noise of
    its sensor. Then the third differences' estimate stands: a floor that is too low closes less, not more.
    """
    e = pieces.innovations(generic.left)
    for lag in (1, 2, 3):
        r = (e[:, lag:] * e[:, :-lag]).sum((0, 1)) / (e**2).sum((0, 1))
        if np.abs(r).max() > CORRELATED:
            return third_differences(pieces.log)
    return pieces.noise


def _tails(pieces, n):
    """Gives rows weights after Student's t where tails are heavy, keeping the variance at one."""
    e = pieces.innovations(n)
    values = e[pieces.inside]
    scale = np.median(np.abs(values), 0) / 0.6745 + 1e-12

    def surprise(log_nu):
        nu = np.exp(log_nu)
        return -stats.t.logpdf(values / scale * np.sqrt(stats.t.ppf(0.75, nu) ** 2 / 0.6745**2), nu).sum()

    nu = float(np.exp(optimize.minimize_scalar(surprise, bounds=(np.log(2.1), np.log(50)), method="bounded").x))
    if nu < LIGHT:
        core = scale * 0.6745 / stats.t.ppf(0.75, nu)
        weight = (nu + 1) / (nu + (e / core) ** 2)
        weight /= np.mean((weight * e**2)[pieces.inside], axis=0)
        pieces.set_noise(pieces.noise, weight)
    return nu
