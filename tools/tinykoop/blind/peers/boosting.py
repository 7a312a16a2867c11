"""Gradient boosting on features of the residual, trained on simulated logs of every effect: a black box.

Histogram gradient boosting of scikit-learn (after LightGBM, Ke et al. 2017), as in data-driven fault diagnosis. The
training logs come from host_sim's own simulator, random drives, parameters and noise. Probabilities are
tempered on a validation set of its own; less than the top probability that 95 % of that set's logs reach is called
unknown. For the gap closed the effect that it names is fitted by least squares on windows. A
classifier that may not name an effect is one that was trained without it.
"""

import hashlib
import json
import pickle
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from ... import bridge
from ...plumbing import checkout, results
from ...plumbing.locks import locked
from . import common, library

_CACHE = checkout.cache("peers")


@dataclass(frozen=True)
class Settings:
    logs: int = 4500  # a fifth of them for validation
    iterations: int = 120
    rate: float = 0.12
    leaves: int = 12
    share_unknown: float = 0.05
    seed: int = 20260101


# ---- features --------------------------------------------------------------------------------


def _features(data):
    """What a diagnoser might look at: residuals at three horizons, their dependence on the commands, the drive."""
    noise = common.Noise.of(data)
    found = []
    for steps in common.HORIZONS:
        starts = data.starts(data.usable, steps, 3)
        if len(starts) < 5:
            found += [np.nan] * 12
            continue
        white = np.einsum("sij,sj->si", noise.whitener(data, starts, steps), data.residual(starts, steps))
        white = np.clip(white, -1e3, 1e3)
        for column in white.T:
            rms = np.sqrt(np.mean(column**2)) + 1e-12
            found += [
                np.log(rms),
                np.mean(column) / rms,
                common.scale(column) / rms,
                np.mean(column[1:] * column[:-1]) / rms**2,
            ]
    table, theta = library.functions(data), library.heading_functions(data.x[:-1, 2])
    target = library.residual_velocities(data)
    mask = np.isfinite(target).all(axis=1)
    weak = library.weak(data, np.stack([*table.values(), *theta.values(), *target.T], axis=1), mask)
    A, Y = weak[:, :-3], weak[:, -3:]
    size, strength = np.linalg.norm(A, axis=0) + 1e-9, np.linalg.norm(Y, axis=0) + 1e-9
    quiet = np.array([noise.sp, noise.sp, noise.st]) * np.sqrt(max(len(Y), 1)) / (library.HALF * data.dt)
    found += [
        *(A.T @ Y / size[:, None] / strength).ravel(),
        *np.log(strength / quiet),
        *np.corrcoef(Y.T)[np.triu_indices(3, 1)],
    ]
    # what stays when the function that explains a channel best is taken out, by function again
    for y in Y.T:
        best = int(np.argmax(np.abs(A.T @ y) / size))
        rest = y - A[:, best] * (A[:, best] @ y) / size[best] ** 2
        found += [
            np.log((np.linalg.norm(rest) + 1e-9) / (np.linalg.norm(y) + 1e-9)),
            best,
            *(A.T @ rest / size / (np.linalg.norm(rest) + 1e-9)),
        ]
    v, w = data.u[:-1].T
    for c in (v, w):
        found += [
            np.mean(c),
            np.std(c),
            np.min(c),
            np.max(c),
            np.mean(np.abs(c) < 0.1 * data.peak.max()),
            np.std(np.diff(c)),
        ]
    found += [np.corrcoef(np.abs(v), np.abs(w))[0, 1] if np.std(v) > 0 and np.std(w) > 0 else 0.0, len(data.x), data.dt]
    return np.nan_to_num(np.array(found, float), nan=0.0, posinf=0.0, neginf=0.0)


# ---- training set ----------------------------------------------------------------------------


def _drive(random, K, dt):
    """Commands (K, 2): held levels, waves, or both, that may stand still; one in four is poor."""
    t, u = np.arange(K) * dt, np.zeros((K, 2))
    poor = random.random() < 0.25
    for i, (low, high) in enumerate(((-0.8, 2.0), (-1.0, 1.0))):
        centre, half = (low + high) / 2, (high - low) / 2
        kind = random.integers(3)
        if poor:
            u[:, i] = random.uniform(low, high) + half * random.uniform(0, 0.15) * np.sin(random.uniform(0.1, 2) * t)
            continue
        if kind != 1:
            hold = max(int(random.uniform(0.5, 6) / dt), 1)
            u[:, i] += np.repeat(random.uniform(-half, half, K // hold + 1), hold)[:K]
        if kind != 0:
            for _ in range(random.integers(1, 4)):
                u[:, i] += half * random.uniform(0.2, 0.7) * np.sin(random.uniform(0.1, 2.5) * t + random.uniform(0, 6))
        u[:, i] = centre * random.uniform(0, 1.5) + random.uniform(0.4, 1) * u[:, i]
    if random.random() < 0.25:
        u *= (np.sin(random.uniform(0.2, 0.9) * t) > random.uniform(-0.8, 0))[:, None]
    return np.clip(u, (-2.5, -1.5), (2.5, 1.5))


def _effect(random, name, u):
    rows, values = bridge.effects()[name][1], []
    for i, row in enumerate(rows):
        value = row[4] * np.exp(random.uniform(np.log(0.4), np.log(2.5)))
        if row[2] < 0 and name != "pacejka_slip" and random.random() < 0.5:
            value = -value
        if name == "saturation":
            value = max(np.max(np.abs(u[:, i])), 0.05) * random.uniform(0.4, 0.95)
        values.append(min(max(value, row[2]), row[3]))
    return bridge.Effect(name, tuple(values))


def _log(random, name):
    K, dt = int(random.uniform(300, 2500)), float(random.choice([0.02, 0.05, 0.05, 0.1]))
    u = _drive(random, K, dt)
    active = [] if name == "none" else [_effect(random, name, u)]
    x0 = (0.0, 0.0, random.uniform(-np.pi, np.pi))
    x = bridge.simulate(u[:-1], dt, x0, active, bridge.ARC)
    noise = random.standard_normal((K, 3)) if random.random() < 0.6 else random.standard_t(4, (K, 3)) / np.sqrt(2)
    if random.random() < 0.35:
        rho = random.uniform(0.3, 0.9)
        for k in range(1, K):
            noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    sp, st = np.exp(random.uniform(np.log(0.002), np.log(0.012), 2))
    return common.Data.of(x + noise * (sp, sp, st), u, dt)


def _training_set(settings):
    random, labels = np.random.default_rng(settings.seed), [*common.candidates(), "none"]
    names = [labels[i % len(labels)] for i in range(settings.logs)]
    rows = [_features(_log(random, name)) for name in results.progress(names, "boosting: training logs")]
    return np.array(rows, np.float32), np.array(names)


# ---- classifier ------------------------------------------------------------------------------


def _tempered(p, temperature):
    q = np.log(np.maximum(p, 1e-12)) / temperature
    q = np.exp(q - q.max(axis=1, keepdims=True))
    return q / q.sum(axis=1, keepdims=True)


def _train(settings, without):
    from sklearn.ensemble import HistGradientBoostingClassifier

    X, names = _kept("training", settings, (), lambda: _training_set(settings))
    allowed = ~np.isin(names, without)
    X, names = X[allowed], names[allowed]
    results.console.print(f"boosting: training{', without ' if without else ''}{', '.join(without)} ...")
    check = np.arange(len(names)) % 5 == np.arange(len(names)) // 90 % 5  # each label in its turn
    classifier = HistGradientBoostingClassifier(
        max_iter=settings.iterations, learning_rate=settings.rate, max_leaf_nodes=settings.leaves,
        l2_regularization=1.0, max_features=0.3, early_stopping=False, random_state=settings.seed,
    )  # fmt: skip
    classifier.fit(X[~check], names[~check])
    p = classifier.predict_proba(X[check])
    truth = np.searchsorted(classifier.classes_, names[check])

    def loss(log_temperature):
        q = _tempered(p, np.exp(log_temperature))
        return -np.mean(np.log(q[np.arange(len(q)), truth] + 1e-12))

    temperature = float(np.exp(minimize_scalar(loss, bounds=(-2, 2), method="bounded").x))
    q = _tempered(p, temperature)
    least = float(np.quantile(q.max(axis=1), settings.share_unknown))
    results.console.print(f"boosting: names {np.mean(q.argmax(axis=1) == truth):.3f} of its validation logs rightly")
    return {"classifier": classifier, "temperature": temperature, "least": least}


def _kept(what, settings, without, make):
    """make()'s result, from the build tree if it was made before from the same settings and code."""
    here = Path(__file__).parent
    code = "".join((here / name).read_text() for name in ("boosting.py", "common.py", "library.py"))
    key = json.dumps([asdict(settings), sorted(without), bridge.effects(), version("scikit-learn"), np.__version__, code])
    folder = results.output_folder(_CACHE)
    path = folder / f"boosting-{what}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.pickle"
    with locked(path.with_suffix(".lock")):  # one process trains, the others wait for it
        if not path.exists():
            results.write_bytes(path, pickle.dumps(make()))
        return pickle.loads(path.read_bytes())


_loaded = {}


def prepared(settings=Settings(), without=()):
    """The trained classifier and what belongs to it."""
    key = (settings, tuple(sorted(without)))
    if key not in _loaded:
        _loaded[key] = _kept("classifier", settings, key[1], lambda: _train(settings, key[1]))
    return _loaded[key]


@common.on_one_core
def peer(log_path, fresh_path=None, without=(), settings=Settings()):
    data = common.Data.read(log_path)
    trained = prepared(settings, without)
    p = trained["classifier"].predict_proba(_features(data)[None].astype(np.float32))
    p = dict(zip(trained["classifier"].classes_.tolist(), _tempered(p, trained["temperature"])[0].tolist()))
    top = max(p, key=p.get)
    names = () if top == "none" else (top,)
    fit = common.Fit(data, common.Noise.of(data), names)
    model = common.simulator(fit.active())
    verdict = "unknown" if p[top] < trained["least"] else "known" if names else "none"
    ranking = {name: score for name, score in p.items() if name != "none"}
    return common.report(data, model, fresh_path, verdict, fit.effects(p), ranking)
