"""The drive that would settle what a log leaves open."""

import numpy as np

from .... import bridge
from ...prediction_errors.fit import Cause, Fitter
from .path import Path

SECONDS, FEWEST_ROWS = 40.0, 200  # of a drive that is tried; rows of it, at least
PAIRS = 6  # that must be distinguished, at most


def _steps(values, dt, rows):
    """Commands (rows, 2) held for equal times."""
    return np.repeat(np.array(values, float), -(-rows // len(values)), axis=0)[:rows]


def drives(u, dt):
    """{name: (words, commands (K, 2))}: a menu in the range of speeds that the log shows."""
    rows = max(int(SECONDS / dt), FEWEST_ROWS)
    v, w = max(np.abs(u[:, 0]).max(), 0.2), max(np.abs(u[:, 1]).max(), 0.2)
    t = np.arange(rows) * dt
    ramp = np.abs((t / t[-1] * 4) % 2 - 1) * 2 - 1  # triangles through zero
    chirp = np.sin(2 * np.pi * (0.05 + 0.02 * t) * t)
    square = [(v, 0), (0.3 * v, w), (v, 0), (0.3 * v, w), (v, 0), (0.3 * v, -w), (v, 0), (0.3 * v, -w)]
    starts = [(v, 0), (0, 0), (v, w), (0, 0), (-0.5 * v, 0), (0, 0), (v, -w), (0, 0)]
    turns = [(0.6 * v, s * w) for s in (1, -1)] * 8
    speeds = [(f * v, g * w) for f in (0.25, 0.5, 0.75, 1.0) for g in (0.8, -0.8, 0.3, -0.3)]
    return {
        "square both ways": ("a square, left round and then right round", _steps(square, dt, rows)),
        "full steps": ("full-speed steps from standstill, straight, turning and backwards", _steps(starts, dt, rows)),
        "reversals": ("yaw reversals at steady speed", _steps(turns, dt, rows)),
        "slow ramp": (
            "slow ramps of speed and yaw rate through zero",
            np.stack([v * ramp, w * np.roll(ramp, rows // 8)], 1),
        ),
        "chirp": (
            "swings of speed and yaw rate, slow at first and then faster and faster",
            np.stack([0.5 * v * (1 + chirp), w * np.roll(chirp, rows // 7)], 1),
        ),
        "speed levels": ("circles of both directions at four speeds", _steps(speeds, dt, rows)),
    }


def _driven(path, noise, u, name, params):
    """A Fitter on drive u (K, 2) of a robot with this effect, free of noise but judged by that of the log."""
    active = [bridge.Effect(c.name, c.params) for c in (*path.base, Cause(name, params))]
    x = bridge.simulate(u[:-1], path.dt, active=active, integrator=path.integrator)
    log = bridge.Log(np.arange(len(x)) * path.dt, x, u, np.ones(len(x) - 1, bool), path.dt)
    return Fitter(Path(log, variant=path.variant, base=path.base), noise)


def _alone(fitter, rival):
    """The best that a rival can do on a drive."""
    starts = fitter.effects[rival].starts
    return fitter.refine(min((fitter.fit_of((Cause(rival, s),)) for s in starts), key=lambda f: f.cost), 4)


def _costs(path, fitter, u, open_):
    """(question, cost of the best answer that is not true) of drive u, one after another."""
    questions, hidden = open_
    for cause, rival in questions:
        yield f"{cause.name} or {rival}", _alone(_driven(path, fitter.noise, u, cause.name, cause.params), rival).cost
    for name in hidden:
        usual = tuple(p.usual for p in fitter.effects[name].parameters)
        yield f"{name} or not", _driven(path, fitter.noise, u, name, usual).fit_of(()).cost


def _separation(path, fitter, u, open_, least):
    """{question: separation} of drive u; None as soon as one is no larger than `least`, since the drive is then not the best."""
    found = {}
    for question, cost in _costs(path, fitter, u, open_):
        found[question] = float(np.sqrt(cost / len(u)))
        if found[question] <= least:
            return None
    return found


def advise(path, fitter, open_pairs, untestable):
    """(name, words, commands, {question: separation}) of the drive with the largest least separation.

    None if nothing is open. Separation: standard deviations, RMS per row, between an effect and the best that the
    rival can do. open_pairs: [(cause, rival name)]; untestable: names that the log does not excite.
    """
    questions, hidden = open_pairs[:PAIRS], [] if open_pairs else untestable[:PAIRS]
    if not questions and not hidden:
        return None
    best, least = None, -np.inf
    for title, (words, u) in drives(path.u, path.dt).items():
        separation = _separation(path, fitter, u, (questions, hidden), least)
        if separation:
            best, least = (title, words, u, separation), min(separation.values())
    return best
