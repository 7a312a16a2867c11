"""The flight that would settle what this one leaves open, judged by simulation."""

from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

from .... import bridge
from ....plumbing.errors import UserError
from .features import MIX, STATES, runs, steady

MENU = {"hover": "hold still", "mixed": "step to and fro, turn by steps and climb, and log the gyro"}
SECONDS, SEED = 30, 77
PAST, ASKED = 4, 14  # rows of angular velocity and of requests in the regression
AXES = (("gx", "gy", 1, 1, "inertia_x"), ("gy", "gx", 2, -1, "inertia_y"))  # angular velocity, the other one, row of MIX, sign, inertia


def advise(changes, ambiguous, vehicle):
    """{drive, words, separation} of the flight that separates most; None if nothing of the balance is open.

    Rotor and weight ask for the same where a vehicle stands still. A weak rotor lets requests of yaw turn the vehicle about the other
    axes, and a weight lets requests of thrust do so. Separation: standard deviations, by which simulated flights with the one and the
    other differ in that.
    """
    questions = [(name, rivals[0]) for name, rivals in ambiguous.items() if rivals and _both(changes, name, rivals[0])]
    best = None
    for drive, words in MENU.items() if questions else ():
        separation = {f"{name} or {rival}": _separation(drive, *_both(changes, name, rival), vehicle) for name, rival in questions}
        if best is None or sum(separation.values()) > sum(best["separation"].values()):
            best = {"drive": drive, "words": words, "separation": separation}
    return best


def _both(changes, name, rival):
    """The two causes as effects, each as large as the flight has it; None if they are not of the balance."""
    posterior = changes.posteriors.get("balance")
    sized = [s for s in posterior.sized if s.weights.sum() > 0] if posterior else []
    found = [next((s for s in sized if s.causes == (one,)), None) for one in (name, rival)]
    if None in found:
        return None
    return tuple((s.causes[0], tuple(sorted((n, value) for n, (value, _) in s.params()[s.causes[0]].items()))) for s in found)


def _separation(drive, one, other, vehicle):
    (a, errors), (b, more) = (_flown(drive, *cause, vehicle) for cause in (one, other))
    return float(np.sqrt(((a - b) ** 2 / (errors**2 + more**2)).sum())) if len(a) == len(b) else 0.0


@lru_cache(maxsize=16)
def _flown(drive, name, params, vehicle):
    """(couplings, their standard errors) of a simulated flight with one effect; none if it cannot be flown."""
    rows, given = bridge.quadrotor_effects(vehicle)[name][1], dict(params)
    values = tuple(float(np.clip(given.get(n, usual), low, high)) for n, _, low, high, usual in rows)
    try:
        log, _ = bridge.quadrotor(drive, SECONDS, SEED, [bridge.Effect(name, values)], vehicle=vehicle)
    except UserError:
        return np.zeros(0), np.zeros(0)
    return couplings(log, bridge.quadrotor_vehicle(vehicle))


def couplings(log, vehicle):
    """(values (4,), standard errors (4,)): by how much requests of yaw and of thrust act like ones of roll, and like ones of pitch."""
    rows, x, asked = steady(log), dict(zip(STATES, log.x.T)), log.u[:, :4] @ MIX.T
    kept = np.exp(-log.dt / vehicle["motor_lag"])
    given = lfilter([1 - kept], [1, -kept], asked - asked[rows].mean(0), axis=0)
    stretches = [(first, last) for first, last in runs(rows) if last - first > PAST + 2 * ASKED]
    found = [_regression(x, asked, given, stretches, axis, log.dt, vehicle) for axis in AXES] if stretches else []
    return tuple(np.concatenate(part) for part in zip(*found)) if found else (np.zeros(0), np.zeros(0))


def _regression(x, asked, given, stretches, axis, dt, vehicle):
    rate, other, mixed, sign, inertia = axis
    gain = sign * dt * 4 * vehicle["thrust_full"] * vehicle["arm"] * np.sqrt(0.5) / vehicle[inertia]
    X, y = [], []
    for first, last in stretches:
        k = np.arange(first + max(PAST, ASKED), last - 1)
        cross = gain * given[k, 3], gain * given[k, 0], x["gz"][k] * x[other][k], np.ones(len(k))
        X.append(np.stack([*cross, *(x[rate][k - i] for i in range(PAST)), *(asked[k - i, mixed] for i in range(ASKED))], 1))
        y.append(x[rate][k + 1])
    X, y = np.concatenate(X), np.concatenate(y)
    inverse = np.linalg.pinv(X.T @ X)
    found = inverse @ (X.T @ y)
    size = ((y - X @ found) ** 2).sum() / (len(y) - len(found))
    return found[:2], np.sqrt(size * inverse.diagonal()[:2])
