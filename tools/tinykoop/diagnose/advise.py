"""The drive that would settle what a log leaves open."""

from dataclasses import replace

import numpy as np

from .. import sim
from .fit import Fitter
from .pieces import Pieces

SECONDS, FEWEST_ROWS = 40.0, 200
PAIRS = 6  # that are to be told apart, at most


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
        "chirp": ("chirps on speed and yaw rate", np.stack([0.5 * v * (1 + chirp), w * np.roll(chirp, rows // 7)], 1)),
        "speed levels": ("circles of both directions at four speeds", _steps(speeds, dt, rows)),
    }


def _separation(platform, integrator, noise, u, dt, causes, name, params):
    """How far (standard deviations, RMS per row) an effect `name` of this size stays from the best fit of `causes`."""
    true = [effect for cause in causes for effect in cause.active()] + [sim.Effect(name, params)]
    x = platform.simulate(u[:-1], dt, true, integrator)
    log = sim.Log(np.arange(len(x)) * dt, x, u, np.ones(len(x) - 1, bool), dt)
    pieces = Pieces(platform, log, integrator)
    pieces.set_noise(replace(noise, rho_p=max(noise.rho_p, 0.0), rho_t=max(noise.rho_t, 0.0)))
    return Fitter(pieces), pieces


def advise(search, fit, open_pairs, untestable):
    """(name, words, commands, {question: separation}) of the drive with the largest least separation; None if nothing is open.

    open_pairs: [(cause, rival name)]; untestable: names that the log does not excite.
    """
    pieces = search.pieces
    questions = [(cause, rival) for cause, rival in open_pairs][:PAIRS]
    hidden = [name for name in untestable][: PAIRS - len(questions)] if not questions else []
    if not questions and not hidden:
        return None
    platform, integrator, dt = pieces.platform, pieces.integrator, pieces.log.dt
    best = None
    for title, (words, u) in drives(pieces.log.u, dt).items():
        separation = {}
        for cause, rival in questions:
            fitter, _ = _separation(platform, integrator, pieces.noise, u, dt, (), cause.name, cause.params)
            alone = fitter.scan(rival, fitter.fit_of(()))[0]
            alone = fitter.refine(alone, steps=4)
            separation[f"{cause.name} or {rival}"] = float(np.sqrt(alone.cost / len(u)))
        for name in hidden:
            usual = tuple(p.usual for p in search.fitter.effects[name][1])
            fitter, _ = _separation(platform, integrator, pieces.noise, u, dt, (), name, usual)
            separation[f"{name} or not"] = float(np.sqrt(fitter.fit_of(()).cost / len(u)))
        if best is None or min(separation.values()) > min(best[3].values()):
            best = title, words, u, separation
    return best
