"""How far the controller should look ahead: every method over horizons of 10, 20 and 50 steps, from the same starts, near and far."""

from dataclasses import replace

import numpy as np

from ...plumbing.results import progress
from .. import control, scenario
from .closed_loop import SIGMA, Stage, count, starts

HORIZONS = (10, 20, 50)  # steps; the last is the paper's
FAR = 0.5  # standard deviation of the start (m, m, rad)


def horizons(scene, runs):
    """Rows of the study "horizon", one for each method, horizon and distance of the start."""
    cells = [(method, sigma, steps) for method in scenario.METHODS for sigma in (SIGMA, FAR) for steps in HORIZONS]
    return [_row(scene, *cell, runs) for cell in progress(cells, "horizons")]


def _row(scene, method, sigma, steps, runs):
    stages = (Stage(control.STEPS, replace(control.MPC, horizon=steps), learn=method.regulator != "offline"),)
    traces = [scene.track(scene.learned(method), offset, stages) for offset in starts(sigma, runs)]
    solve = np.concatenate([trace["solve_us"] for trace in traces])
    return {
        "study": "horizon",
        "dictionary": method.dictionary,
        "regulator": method.regulator,
        "sigma": sigma,
        "horizon": steps,
        "solve_us": {"median": float(np.median(solve)), "p95": float(np.percentile(solve, 95))},
        **count(traces),
    }
