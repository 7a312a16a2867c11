"""Sparse regression of the residual velocities on a library of functions: SINDy, with pysindy's optimisers.

Brunton, Proctor and Kutz 2016; the weak form of Messenger and Bortz 2021; bagging after Fasel et al. 2022.
Columns and targets are scaled so that a coefficient is about its own t-value, which is what the threshold
of the sequential least squares is then in. Its models over several thresholds and those of forward orthogonal
selection (FROLS, Billings 2013) compete by BIC: alone the former cancels delays against lags, the latter takes friction
for a gain. Non-zero terms are translated into causes by a written table, and the sparse model predicts by itself.
"""

import warnings

import numpy as np

from . import common, library

_THRESHOLDS = (3.0, 5.0, 8.0, 14.0, 25.0)
_MOST_TERMS = 8  # a channel
_BAGS = 20
_SHARE = 0.2  # of what the terms explain: less is no cause of its own

_LONG, _LAT, _YAW = range(3)
# (channel, how the function's name begins) -> effect; the first that fits counts
_TABLE = [
    (_LONG, "cos", "world_drift"), (_LONG, "sin", "world_drift"),
    (_LAT, "cos", "world_drift"), (_LAT, "sin", "world_drift"),
    (_LONG, "t v", "battery_sag"),
    (_LONG, "v late", "transport_delay"), (_YAW, "w late", "transport_delay"),
    (_LONG, "v lagging", "actuator_lag"), (_YAW, "w lagging", "actuator_lag"),
    (_YAW, "w play", "backlash"),
    (_LONG, "v below", "dead_band"), (_YAW, "w below", "dead_band"),
    (_LONG, "v above", "saturation"), (_YAW, "w above", "saturation"),
    (_LONG, "v |v w|", "pacejka_slip"), (_YAW, "w |v w|", "pacejka_slip"), (_LAT, "v |v w|", "pacejka_slip"),
    (_LONG, "v |v|", "stribeck_friction"), (_LONG, "v exp", "stribeck_friction"),
    (_LONG, "sign v", "stribeck_friction"), (_YAW, "sign w", "stribeck_friction"),
    (_LAT, "v w", "lateral_skid"), (_LAT, "w", "sensor_lever_arm"), (_LONG, "w", "sensor_lever_arm"),
    (_LAT, "v", "heading_bias"),
    (_YAW, "1", "yaw_bias"), (_YAW, "v", "wheel_asymmetry"),
    (_LONG, "v", "speed_gain"), (_YAW, "w", "yaw_gain"),
]  # fmt: skip


def _cause(channel, term):
    exact = [e for c, name, e in _TABLE if c == channel and name == term]
    begun = [e for c, name, e in _TABLE if c == channel and len(name) > 1 and term.startswith(name + " ")]
    return (exact or begun or [None])[0]


def _names(data):
    return list(library.functions(data)) + ["cos", "sin"]


def _columns(data):
    theta = library.heading_functions(data.x[:-1, 2])
    return np.stack([*library.functions(data).values(), *theta.values()], axis=1)


class _Sparse:
    """coefficients (3, n) on the library of a log; as a model for gap() and left()."""

    def __init__(self, coefficients):
        self.coefficients = coefficients

    def __call__(self, data, starts, steps):
        known = self.coefficients[:, :-2] @ np.stack(list(library.functions(data).values()))
        v, w = data.u[: len(data.x) - 1].T
        half = 0.5 * w * data.dt
        way = v * np.sinc(half / np.pi) * np.exp(1j * half) + known[_LONG] + 1j * known[_LAT]
        turn = w + known[_YAW]
        place, theta = np.zeros(len(starts), complex), data.x[starts, 2].copy()
        for k in range(steps):
            world = self.coefficients[:, -2:] @ np.stack(list(library.heading_functions(theta).values()))
            body = way[starts + k] + world[_LONG] + 1j * world[_LAT]
            place += body * np.exp(1j * theta) * data.dt
            theta = theta + (turn[starts + k] + world[_YAW]) * data.dt
        moved = data.moved(starts, steps) @ (1, 1j) - place * np.exp(-1j * data.x[starts, 2])
        turned = np.angle(np.exp(1j * (data.x[starts + steps, 2] - theta)))
        return np.stack([moved.real, moved.imag, turned], axis=1)


def _regress(A, y):
    """Sparse coefficients of one channel; y is in units of its noise, the columns of A have length one."""
    import pysindy

    found = [np.zeros(A.shape[1])]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of thresholds that leave nothing and of columns nearly alike
        found += [pysindy.STLSQ(threshold=t, alpha=0.01, max_iter=30).fit(A, y[:, None]).coef_[0] for t in _THRESHOLDS]
        try:
            path = pysindy.FROLS(alpha=1e-8, max_iter=_MOST_TERMS).fit(A, y[:, None]).history_
            found += [coefficients[0] for coefficients in path]
        except ValueError:  # it refuses columns that depend on each other exactly
            pass
    return min(found, key=lambda c: np.sum((y - A @ c) ** 2) + 2 * np.count_nonzero(c) * np.log(len(y)))


def _loss(A, y, support, without):
    """By how much the squares grow when the terms `without` are dropped and the others are refitted."""
    squares = []
    for kept in (support, support & ~without):
        squares.append(np.sum((y - A[:, kept] @ np.linalg.lstsq(A[:, kept], y, rcond=None)[0]) ** 2))
    return squares[1] - squares[0]


def _causes(channel, names, coefficients):
    """The cause of each term; a speed that is lost beside terms of friction is friction's constant part."""
    causes = np.array([_cause(channel, name) if c else "" for name, c in zip(names, coefficients)], object)
    if channel == _LONG and "stribeck_friction" in causes and coefficients[names.index("v")] < 0:
        causes[names.index("v")] = "stribeck_friction"
    return causes


@common.on_one_core
def peer(log_path, fresh_path=None, without=()):
    data = common.Data.read(log_path)
    names, columns, target = _names(data), _columns(data), library.residual_velocities(data)
    mask = data.fit & np.isfinite(target).all(axis=1)
    A, Y = library.weak(data, columns, mask), library.weak(data, target, mask)
    size = np.linalg.norm(A, axis=0) + 1e-12
    A = A / size
    coefficients, scores, often, terms = np.zeros((3, len(names))), {}, {}, {}
    random = np.random.default_rng(0)
    for channel, y in enumerate(Y.T):
        allowed = np.array([A[:, i].any() and _cause(channel, n) not in without for i, n in enumerate(names)])
        left = y - A[:, allowed] @ np.linalg.lstsq(A[:, allowed], y, rcond=1e-8)[0]
        spread = np.sqrt(np.sum(left**2) / max(len(y) - np.sum(allowed), 5)) + 1e-12
        found = np.zeros(len(names))
        found[allowed] = _regress(A[:, allowed], y / spread)
        coefficients[channel] = found * spread / size
        causes = _causes(channel, names, found)
        for cause in set(causes) - {""}:
            own = causes == cause
            scores[cause] = scores.get(cause, 0) + _loss(A, y / spread, found != 0, own)
            terms.setdefault(cause, {}).update({(channel, names[i]): coefficients[channel, i] for i in np.flatnonzero(own)})
            # rows drawn again: how often the terms still pay
            drawn = (random.integers(0, len(y), len(y)) for _ in range(_BAGS))
            pays = [_loss(A[rows], y[rows] / spread, found != 0, own) > 2 * np.sum(own) * np.log(len(y)) for rows in drawn]
            often[cause] = max(often.get(cause, 0), np.mean(pays))
    model = _Sparse(coefficients)
    nameless = scores.pop(None, 0)
    _equal_gains(scores, often, terms, without)
    scores = {name: score for name, score in scores.items() if name not in without}
    chosen = [name for name in scores if scores[name] > _SHARE * (sum(scores.values()) + nameless)]
    verdict = "known" if chosen else "none"
    if common.left(data, model if chosen else common.simulator(())) > common.MOST_LEFT:
        verdict = "unknown"
    effects = [
        {"name": name, "confidence": float(often[name]), "params": _params(name, terms[name]), "params_ci95": {},
         "segments": [list(map(float, data.span))]}
        for name in sorted(chosen, key=scores.get, reverse=True)
    ]  # fmt: skip
    ranking = dict.fromkeys(common.candidates(without), 0.0) | scores
    return common.report(data, model, fresh_path, verdict, effects, ranking)


def _equal_gains(scores, often, terms, without):
    """Both gains, and equal within a tenth: the slow clock that is their exact alias."""
    if not {"speed_gain", "yaw_gain"} <= set(scores) or "clock_scale" in without:
        return
    a, b = terms["speed_gain"][_LONG, "v"], terms["yaw_gain"][_YAW, "w"]
    if abs(a - b) < 0.1 * abs(a):
        scores["clock_scale"] = scores.pop("speed_gain") + scores.pop("yaw_gain")
        often["clock_scale"] = min(often["speed_gain"], often["yaw_gain"])
        terms["clock_scale"] = {(_LONG, "v"): (a + b) / 2}


def _params(name, terms):
    """The parameters that can be read off the coefficients; the others are left out."""
    read = {
        "speed_gain": {"a": (_LONG, "v")}, "yaw_gain": {"b": (_YAW, "w")}, "wheel_asymmetry": {"c": (_YAW, "v")},
        "yaw_bias": {"d": (_YAW, "1")}, "lateral_skid": {"k": (_LAT, "v w")}, "clock_scale": {"kappa": (_LONG, "v")},
        "world_drift": {"wx": (_LONG, "cos"), "wy": (_LONG, "sin")},
        "sensor_lever_arm": {"lx": (_LAT, "w"), "ly": (_LONG, "w")},
        "battery_sag": {"loss_at_end": (_LONG, "t v")}, "heading_bias": {"delta": (_LAT, "v")},
    }  # fmt: skip
    opposite = {"ly", "loss_at_end", "delta"}
    found = {p: float(terms[at]) * (-1 if p in opposite else 1) for p, at in read.get(name, {}).items() if at in terms}
    if name == "stribeck_friction":
        share = {term: -float(c) for (channel, term), c in terms.items() if channel == _LONG}
        fc = share.get("v", 0.0)
        found = {"Fs": fc + share.get("v exp(-v^2)", 0.0), "Fc": fc, "Fv": share.get("v |v|", 0.0), "vs": 1.0}
    if name in (
        "actuator_lag",
        "transport_delay",
    ):  # the mean over the channels: coefficients weigh the library's times
        channels = {channel for channel, _ in terms}
        time = sum(float(term.split()[-1]) * c for (_, term), c in terms.items()) / len(channels)
        found["tau" if name == "actuator_lag" else "delay"] = float(time)
    return found
