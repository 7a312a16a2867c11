"""Other ways to name the cause, on the same flights and the same splits.

Whatever a peer chooses or learns for a flight, it does on the flights of the other groups: conditions, or sessions of healthy flights.
Of these it uses those whose cause must be found, so that a cut that is too small to show misleads no peer.
"""

from functools import cache

import numpy as np

from ...diagnose.platforms.quadrotor import causes, features
from ...diagnose.platforms.quadrotor.changes import MOST, RIVAL
from ...plumbing.results import progress
from . import answers
from .answers import Answer

ROTORS = tuple(map(causes.rotor, features.ROTORS))
RIDGE = 1e-6  # keeps the normal equations solvable where a signal stands still
SEED = 1
NONE = "none"  # the class of healthy flights
MOTION = [features.STATES.index(name) for name in ("vx", "vy", "vz", "roll", "yaw")]


def _others(flight, flights):
    """[(flight, its healthy flights)] that a choice about a flight may look at: of other groups, and with a cause that must be found."""
    left = [one for one in flights if one.group != flight.group]
    return [(one, one.healthy(left)) for one in left if one.asks and one.healthy(left)]


def _above(scores, threshold):
    """The Answer that names the rotor of the largest score, if that is above the threshold; the others above it are declared."""
    order = [i for i in np.argsort(-scores) if scores[i] > threshold][:MOST]
    return Answer(tuple(ROTORS[i] for i in order[:1]), tuple(ROTORS[i] for i in order[1:]))


def _threshold(pairs):
    """The one of the best balanced accuracy of healthy and changed flights, or the middle one of several; pairs: [(flight, scores (4,))]."""
    parts = [[pair for pair in pairs if bool(pair[0].truth) == changed] for changed in (False, True)]
    tops = np.sort([score.max() for _, score in pairs])
    candidates = np.append(0.5 * (tops[1:] + tops[:-1]), np.inf)
    accuracy = np.array([sum(_share(part, c) for part in parts if part) for c in candidates])
    best = candidates[accuracy >= accuracy.max() - 1e-9]
    return float(best[len(best) // 2])


def _share(pairs, threshold):
    """Of (flight, scores), that are answered rightly as far as a rotor can be."""
    return np.mean([answers.near(one, _above(score, threshold)) for one, score in pairs])


def _by_threshold(score):
    """The peer that names the rotor of the largest score (4,), with a threshold chosen on the other groups."""

    def peer(flight, flights):
        limit = _threshold([(one, score(one, healthy)) for one, healthy in _others(flight, flights)])
        return _above(score(flight, flight.healthy(flights)), limit)

    return peer


# ---- means -------------------------------------------------------------------------------------------


def excess(flight, healthy):
    """By how much the mean requests (4,) are above those of the healthy flight that is nearest to them."""
    apart = [flight.features.rotors - one.features.rotors for one in healthy]
    return min(apart, key=np.linalg.norm)


def _beside(flight, healthy):
    """The mean requests (4,) minus those of the healthy flights together."""
    return flight.features.rotors - np.mean([one.features.rotors for one in healthy], axis=0)


# ---- gradient boosting -------------------------------------------------------------------------------


def _label(flight):
    """What a classifier is to say, such as rotor1_thrust+rotor2_thrust; a weight is a payload, on a string or not."""
    return causes.PAYLOAD if causes.PAYLOAD in flight.truth else "+".join(sorted(flight.truth)) or NONE


def _causes(label):
    return () if label == NONE else tuple(label.split("+"))


def boosting(flight, flights):
    """Gradient boosting (J. H. Friedman, 2001) on what the rotors are asked for beside the healthy mean."""
    from sklearn.ensemble import GradientBoostingClassifier

    others = _others(flight, flights)
    features, labels = [_beside(*pair) for pair in others], [_label(one) for one, _ in others]
    if len(set(labels)) < 2:
        return Answer((), ())
    model = GradientBoostingClassifier(random_state=SEED).fit(features, labels)
    p = model.predict_proba([_beside(flight, flight.healthy(flights))])[0]
    order = np.argsort(-p)
    named = _causes(model.classes_[order[0]])
    likely = [name for k in order[1:] if p[k] >= RIVAL for name in _causes(model.classes_[k])]
    rivals = [name for name in dict.fromkeys(likely) if name not in named] if named else []
    return Answer(named, tuple(rivals[: MOST - len(named)]), float(p[order[0]]))


# ---- one-step least squares --------------------------------------------------------------------------


@cache
def _coefficients(flight):
    """(coefficients (4, 5), their variances (4, 5)) of the requests in the steps of velocity, roll and yaw, in steady flight."""
    log, rows = flight.log, features.steady(flight.log)
    x = log.x[:, MOTION]
    rows &= np.isfinite(x).all(1)
    k = np.flatnonzero(rows[:-1] & rows[1:])
    z = np.column_stack([np.ones(len(x)), x, log.u[:, :4]])[k]
    inverse = np.linalg.inv(z.T @ z + RIDGE * np.eye(z.shape[1]))
    steps = x[k + 1] - x[k]
    theta = inverse @ z.T @ steps
    variance = np.mean((steps - z @ theta) ** 2, axis=0)
    return theta[-4:], np.outer(np.diag(inverse)[-4:], variance)


def departure(flight, healthy):
    """By how many standard deviations, RMS over the states, the coefficients of each rotor (4,) differ from the healthy mean."""
    theta, variance = _coefficients(flight)
    before = [_coefficients(one) for one in healthy]
    mean = np.mean([one for one, _ in before], axis=0)
    spread = np.mean([one for _, one in before], axis=0) / len(before)
    return np.sqrt(np.mean((theta - mean) ** 2 / (variance + spread), axis=1))


PEERS = {
    "nearest healthy mean": _by_threshold(excess),
    "gradient boosting": boosting,
    "one-step least squares": _by_threshold(departure),
}


def run(flights, names=tuple(PEERS)):
    """{peer: {flight: Answer}}."""
    return {name: {one.name: PEERS[name](one, flights) for one in progress(flights, name)} for name in names}
