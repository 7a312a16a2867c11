"""Which causes explain how a flight differs from healthy ones: their probabilities and sizes.

Features that no cause shares are explained apart from each other. An explanation is linear in its sizes, which have half-normal or
normal priors; flights of a healthy vehicle differ by Student's t. Written as a scale mixture of normals, the marginal likelihood is
that of a linear model with a normal prior, times how much more probable the right signs are afterwards than before (A. O'Hagan and
J. Forster, "Bayesian Inference", 2nd ed., 2004, chapters 9 and 10).
"""

from dataclasses import dataclass
from functools import cache
from itertools import combinations, product

import numpy as np
from scipy import stats

from .features import GRAVITY, MIX, NAMES, REQUESTS, ROTORS

FREEDOM, SCALES = 5.0, 7  # of Student's t; normals that it is mixed of
DRAWS = 2048
PAYLOAD, SLUNG, GAIN, TRIM, SAG = "payload", "slung_load", "thrust_gain", "trim", "battery_sag"
LAG, DELAY = "motor_lag", "transport_delay"
OTHER = "other"  # something else, in any direction
# Features that are explained together
BLOCKS = {
    "balance": ("thrust", "roll", "pitch", "yaw", "drift", "swing"),
    "course": ("roll drift", "pitch drift", "yaw drift"),
    "air": ("push x", "push y"),
    "drag": ("drag",),
    "gyro": ("gyro x", "gyro y", "gyro z"),
    "accelerometer": ("acceleration x", "acceleration y", "acceleration z"),
    "answer": ("lag", "delay", "vibration"),
}
# Probabilities before a flight is seen, of all explanations of a kind together; chosen, as no survey of faults was found
SINGLE, PAIR, TRIPLE = 0.24, 0.09, 0.016  # so many rotors are weak
STRONGER = 0.02  # one rotor is stronger than it was
LOADED, SWINGS = 0.06, 0.02  # a weight was added; on a string
ALL_ROTORS, TRIMMED, SAGS = 0.01, 0.03, 0.02  # all rotors differ, the trim, the battery
BESIDE = 0.08  # one cause of another block
UNKNOWN = 0.02  # something else, in each block
HARDLY = 1e-4  # of a usual size, for none at all
MISFIT = 0.01  # probability of so large a rest, below which an explanation is none
# Usual sizes, in 1 of the mean request:
ROTOR, LOADS, GAINS, TORQUE, LOSS = (0.06, 0.18), (0.03, 0.1), (0.08,), (0.04,), (0.1,)
PLACE = 0.8  # of a rotor's lever, that a weight is off the centre
SWINGING = 0.7  # logarithm by which a load on a string swings more than the air does
WIND, DRAG, GYRO, ACCELEROMETER, LATE, RINGS = 1.5, 0.4, 0.05, 0.5, 0.015, 0.5  # m/s, 1/s, rad/s, m/s^2, s, logarithm
SHAKES = (0.7, 3.0)  # logarithms: some more or less, and hardly any vibration at all
BLURRED = 0.006  # s, that lag is off beside it
AS_LAG, AS_DELAY = 0.8, 0.6  # of a motor's lag, that shows as lag and as delay
ANYTHING = {  # usual sizes of something else, requests in 1 of the mean
    "thrust": 0.1, "roll": 0.06, "pitch": 0.06, "yaw": 0.06, "drift": 0.1, "roll drift": 0.06,
    "pitch drift": 0.06, "yaw drift": 0.06, "swing": 1.0, "push x": 0.5, "push y": 0.5, "drag": 0.5,
    "gyro x": 0.1, "gyro y": 0.1, "gyro z": 0.1, "acceleration x": 1.0, "acceleration y": 1.0, "acceleration z": 1.0, "lag": 0.05,
    "delay": 0.03, "vibration": 1.0,
}  # fmt: skip


@dataclass(frozen=True)
class Healthy:
    """What explanations depend on: the mean request of the healthy vehicle, its requests (4,), its parameters, and the flight's Features."""

    mean: float
    rotors: np.ndarray
    vehicle: dict
    flight: object


@dataclass(frozen=True)
class Explanation:
    """causes: names of effects; H (F, p): what sizes change of the features; scales: of the sizes' priors (p,), one after the other;
    positive: how many of the first sizes must be; params: {cause: {parameter: draws}} from draws (n, p) of the sizes."""

    causes: tuple
    prior: float
    H: np.ndarray
    scales: tuple
    positive: int
    params: object


def rotor(i):
    """The name of the effect of rotor i, 1 to 4."""
    return f"rotor{i}_thrust"


def _columns(*changes):
    """(F, p) of [{feature: change}]."""
    H = np.zeros((len(NAMES), len(changes)))
    for column, change in zip(H.T, changes):
        for name, value in change.items():
            column[NAMES.index(name)] = value
    return H


def _units(*names):
    return _columns(*({name: 1.0} for name in names))


def explanations(healthy, block):
    """[Explanation] of a block, nothing apart."""
    found = {"balance": _balance, "course": _course, "air": _air, "drag": _drag, "gyro": _gyro, "accelerometer": _accelerometer, "answer": _answer}[block](healthy)  # fmt: skip
    names = BLOCKS[block]
    sizes = np.array([ANYTHING[name] * (healthy.mean if name in REQUESTS else 1.0) for name in names])
    # It may change each of the features or not: all sets of them are as probable
    some = tuple(sizes * np.maximum(there, HARDLY) for there in product((0, 1), repeat=len(names)) if any(there))
    return [*found, Explanation((OTHER,), UNKNOWN, _units(*names), some, 0, lambda z: {OTHER: {}})]


def _balance(healthy):
    weight = healthy.vehicle["mass"] * GRAVITY
    lever, turn = healthy.vehicle["arm"] * np.sqrt(0.5), healthy.vehicle["torque_per_thrust"]
    mean, at = healthy.mean, healthy.flight.middle

    def load(z):
        x, y = (lever * np.clip(z[:, k] / z[:, 0], -FARTHEST, FARTHEST) for k in (2, 1))
        return {"mass": healthy.vehicle["mass"] * z[:, 0] / mean, "x": x, "y": y}

    loads = tuple(mean * s * np.array([1, PLACE, PLACE]) for s in LOADS)
    swinging = tuple(np.append(scale, swings) for scale in loads for swings in (SWINGING, HARDLY))  # in calm flight it hardly does
    swing = _columns({"thrust": 1}, {"roll": 1}, {"pitch": 1}, {"swing": 1})
    return [
        *_weak_rotors(healthy),
        Explanation((PAYLOAD,), LOADED, swing[:, :3], loads, 1, lambda z: {PAYLOAD: load(z)}),
        Explanation((SLUNG,), SWINGS, swing[:, [0, 3, 1, 2]], tuple(s[[0, 3, 1, 2]] for s in swinging), 2,
                    lambda z: {SLUNG: load(z[:, [0, 2, 3]])}),
        Explanation((GAIN,), ALL_ROTORS, _units("thrust"), tuple(np.array([mean * s]) for s in GAINS), 0,
                    lambda z: {GAIN: {"a": mean / (mean + z[:, 0]) - 1}}),
        Explanation((TRIM,), TRIMMED, _units("roll", "pitch", "yaw"), tuple(np.full(3, mean * s) for s in TORQUE), 0,
                    lambda z: {TRIM: dict(zip(("roll", "pitch", "yaw"), weight * np.array([-lever, lever, turn])[:, None] * z.T / mean))}),
        Explanation((SAG,), SAGS, _columns({"thrust": at, "drift": 1}), tuple(np.array([mean * s]) for s in LOSS), 1,
                    lambda z: {SAG: {"loss_at_end": z[:, 0] / mean}}),
    ]  # fmt: skip


FARTHEST = 2.0  # levers of a rotor, that a weight may be off the centre


def _weak_rotors(healthy):
    out = []
    for prior, count in ((SINGLE, 1), (PAIR, 2), (TRIPLE, 3)):
        sets = list(combinations(ROTORS, count))
        out += [_rotors(healthy, some, prior / len(sets)) for some in sets]
    return out + [_rotors(healthy, (i,), STRONGER / len(ROTORS), -1) for i in ROTORS]


def _rotors(healthy, some, prior, sign=1):
    H = _columns(*(dict(zip(NAMES[:4], sign * MIX[:, i - 1])) for i in some))
    scales = tuple(np.full(len(some), s * healthy.mean) for s in ROTOR)

    def params(z):
        return {rotor(i): {"a": _weaker(healthy.rotors[i - 1], sign * column)} for i, column in zip(some, z.T)}

    return Explanation(tuple(map(rotor, some)), prior, H, scales, len(some), params)


def _weaker(asked, more):
    """By how much a rotor is weaker that is asked for so much more; it may be asked for all that it has."""
    return asked / np.maximum(asked + more, 1e-3) - 1


def _course(healthy):
    """Every cause that is known is as large at the end of a flight as at its beginning, but for the battery, which moves the thrust alone."""
    return []


def _air(healthy):
    drag = max(healthy.vehicle["drag_xy"], 1e-3)
    H = drag * _units("push x", "push y")
    return [Explanation(("wind",), BESIDE, H, (np.full(2, WIND),), 0, lambda z: {"wind": {"wx": z[:, 0], "wy": z[:, 1]}})]


def _drag(healthy):
    return [Explanation(("drag",), BESIDE, _units("drag"), (np.array([DRAG]),), 0, lambda z: {"drag": {"k": z[:, 0]}})]


def _gyro(healthy):
    return [_bias("gyro_bias", "gyro", GYRO)]


def _accelerometer(healthy):
    return [_bias("accel_bias", "acceleration", ACCELEROMETER)]


def _bias(name, of, size):
    H = _units(*(f"{of} {axis}" for axis in "xyz"))
    return Explanation((name,), BESIDE, H, (np.full(3, size),), 0, lambda z: {name: dict(zip(("bx", "by", "bz"), z.T))})


def _answer(healthy):
    """A loop that answers late may ring, which shakes the vehicle; the more it rings the less lag and delay differ."""
    late, rings = tuple(np.array([LATE, size, BLURRED]) for size in (RINGS, HARDLY)), {"vibration": 1}
    shakes = tuple(np.array([size]) for size in SHAKES)
    lag, delay = (_columns(change, rings, {"lag": 1}) for change in ({"lag": AS_LAG, "delay": AS_DELAY}, {"delay": 1}))
    return [
        Explanation((LAG,), BESIDE / 2, lag, late, 2, lambda z: {LAG: {"tau": z[:, 0]}}),
        Explanation((DELAY,), BESIDE / 2, delay, late, 2, lambda z: {DELAY: {"delay": z[:, 0]}}),
        Explanation(("vibration",), BESIDE, _columns(rings), shakes, 0, lambda z: {"vibration": {"a": np.expm1(z[:, 0])}}),
    ]


# ---- probabilities ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sized:
    """An explanation after the flight: its probability, and draws (n, p) of its sizes with weights (n,)."""

    explanation: Explanation
    probability: float
    draws: np.ndarray
    weights: np.ndarray

    @property
    def causes(self):
        return self.explanation.causes

    def params(self):
        """{cause: {parameter: (median, [low, high])}}, with 95 % intervals."""
        told = self.explanation.params(self.draws)
        return {cause: {name: self._quantiles(values) for name, values in params.items()} for cause, params in told.items()}

    def _quantiles(self, values):
        order = np.argsort(values)
        at = (np.cumsum(self.weights[order]) - 0.5 * self.weights[order]) / self.weights.sum()
        low, middle, high = np.interp([0.025, 0.5, 0.975], at, values[order])
        return float(middle), [float(low), float(high)]


@dataclass(frozen=True)
class Posterior:
    healthy: float  # probability that nothing has changed
    sized: tuple  # of Sized, the most probable first

    def of(self, cause):
        """Probability that a cause acts."""
        return sum(s.probability for s in self.sized if cause in s.causes)


@cache
def _normals(p):
    return stats.norm.ppf(stats.qmc.Sobol(p, seed=1).random(DRAWS))


@cache
def _spreads():
    """Factors of the variance, equally probable, of the normals that Student's t of unit variance is mixed of."""
    middles = (np.arange(SCALES) + 0.5) / SCALES
    return (FREEDOM - 2) / (2 * stats.gamma.ppf(1 - middles, FREEDOM / 2))


def _normals_at(d, covariance):
    """Densities (k,) of N(0, covariance (k, f, f)) at d (k, f)."""
    L = np.linalg.cholesky(covariance)
    squares = (np.linalg.solve(L, d[..., None])[..., 0] ** 2).sum(1)
    logs = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(1)
    return np.exp(-0.5 * squares - logs - 0.5 * d.shape[1] * np.log(2 * np.pi))


def _scaled(differences):
    """(d (k, f), S (k, f, f)) of each healthy flight in each scale of the mixture, one behind the other."""
    d, S = (np.array(part) for part in zip(*differences))
    spreads = np.tile(_spreads(), len(d))
    return np.repeat(d, SCALES, 0), np.repeat(S, SCALES, 0) * spreads[:, None, None]


def _drawn(H, positive, scale, d, C):
    """(shares (k,) of draws of the sizes whose signs are right, those draws (n, p) of each) for a prior of this scale."""
    D = np.diag(scale**2)
    K = np.linalg.solve(C, H @ D).swapaxes(1, 2)
    z = K @ d[..., None] + np.linalg.cholesky(D - K @ H @ D + 1e-12 * D) @ _normals(len(scale)).T
    right = (z[:, :positive] > 0).all(1)
    return right.mean(1), [some[:, those].T for some, those in zip(z, right)]


def _sized(explanation, differences, known):
    """(marginal likelihood, draws, weights) of an explanation.

    differences: [(d (f,), S (f, f))], one for each healthy flight, of the features that are `known`.
    """
    H, (d, S) = explanation.H[known], _scaled(differences)
    likelihoods, draws = [], [np.zeros((0, H.shape[1]))]
    for scale in explanation.scales:
        C = H @ np.diag(scale**2) @ H.T + S
        likelihood = _normals_at(d, C)
        if explanation.causes != (OTHER,):
            share, some = _drawn(H, explanation.positive, scale, d, C)
            likelihood, draws = likelihood * share * 2.0**explanation.positive, [*draws, *some]
        likelihoods.append(likelihood)
    likelihoods = np.concatenate(likelihoods)
    weights = [np.full(len(z), likelihood / max(len(z), 1)) for likelihood, z in zip(likelihoods, draws[1:])]
    return likelihoods.mean(), np.concatenate(draws), np.concatenate([np.zeros(0), *weights])


def _unchanged(differences):
    return _normals_at(*_scaled(differences)).mean()


def posterior(every, differences, known):
    """The Posterior of a block with explanations `every`; differences, known: as for _sized()."""
    none = (1 - sum(e.prior for e in every)) * _unchanged(differences)
    sized = [(e, *_sized(e, differences, known)) for e in every]
    whole = none + sum(e.prior * likelihood for e, likelihood, *_ in sized)
    if not whole > 0:  # so far from everything that no density is a number
        return Posterior(0.0, tuple(Sized(e, float(e.causes == (OTHER,)), *rest) for e, _, *rest in sized))
    found = [Sized(e, e.prior * likelihood / whole, draws, weights) for e, likelihood, draws, weights in sized]
    return Posterior(none / whole, tuple(sorted(found, key=lambda s: -s.probability)))


def fits(one, differences, known):
    """Whether what a Sized leaves of the nearest healthy flight is what such flights differ by."""
    H, centre = one.explanation.H[known], one.weights @ one.draws / max(one.weights.sum(), 1e-300)
    free = len(known) - np.linalg.matrix_rank(H)
    left = [d - H @ centre for d, _ in differences]
    squares = min(float(part @ np.linalg.solve(S, part)) for part, (_, S) in zip(left, differences))
    return free == 0 or stats.f.sf(squares * FREEDOM / (FREEDOM - 2) / free, free, FREEDOM) > MISFIT


def odds(every, name, differences, known):
    """Of one cause of a block against none."""
    alone = [e for e in every if e.causes == (name,)]
    none = (1 - sum(e.prior for e in every)) * _unchanged(differences)
    return sum(e.prior * _sized(e, differences, known)[0] for e in alone) / max(none, 1e-300)
