"""Runs in closed loop from many starts, and how they end."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import binomtest

from ... import bridge
from .. import control, scenario

FAILED = 1.0  # mean error (m, rad); about 1 % of the runs found are within a factor of three of it
SEED = 20260
SIGMA = 1e-2  # where one setting is compared with another


# ---- statistics ------------------------------------------------------------------------------


def wilson(successes, n):
    """Wilson's 95 % interval of a probability."""
    return tuple(map(float, binomtest(successes, n).proportion_ci(method="wilson")))


def starts(sigma, runs):
    """Offsets (runs, 3) of the start, N(0, sigma^2 I); those of another sigma are the same, scaled."""
    return sigma * np.random.default_rng(SEED).standard_normal((runs, 3))


def outcome(trace):
    """How a run ended: "tracks", "stands", "turned" (on the path with whole turns too many), or "lost"."""
    if trace["error"].mean() <= FAILED:
        return "tracks"
    if np.mean(trace["u"][:, 0] < 1e-9) > 0.5:
        return "stands"
    miss = trace["x"][1:] - trace["reference"]
    position = np.linalg.norm(miss[-500:, :2], axis=1)
    return "turned" if np.median(position) < FAILED and np.median(np.abs(miss[-500:, 2])) > np.pi else "lost"


def count(traces):
    """The figures of a cell or an intervention."""
    errors = [float(trace["error"].mean()) for trace in traces]
    failures, n = sum(error > FAILED for error in errors), len(errors)
    ends = [outcome(trace) for trace in traces]
    return {
        "runs": n,
        "failures": failures,
        "probability": failures / n,
        "ci95": list(wilson(failures, n)),
        "mean_errors": errors,
        "median_error_tracking": float(np.median([e for e in errors if e <= FAILED] or [np.nan])),
        "stands": ends.count("stands"),
        "turned": ends.count("turned"),
        "lost": ends.count("lost"),
        "fallback_rate": float(np.mean([np.mean(trace["status"] != 0) for trace in traces])),
    }


# ---- runs ------------------------------------------------------------------------------------


def shifted(effects, step):
    """The effects on a clock that begins at `step`."""
    return [replace(e, t0=e.t0 - step * scenario.DT, t1=e.t1 - step * scenario.DT) for e in effects]


@dataclass(frozen=True)
class Stage:
    """Some steps of a run: what the controller is, and whether the model learns."""

    steps: int
    mpc: bridge.Mpc = control.MPC
    solver: object = None
    learn: bool = True


@dataclass(frozen=True)
class Scene:
    """The run that methods learn on, and the reference they then track."""

    x: np.ndarray
    u: np.ndarray
    reference: np.ndarray

    def learned(self, method, precision=64, form="plain"):
        """A new estimator at the end of the one-step run."""
        return scenario.run(method, precision, self.x, self.u, form=form)[0]

    def track(self, estimator, offset, stages=(Stage(control.STEPS),), every=0, origin=(0, 0, 0)):
        """Trace of the stages one after the other, from `offset` off the reference, which is moved to `origin`."""
        reference = self.reference + np.asarray(origin, float)
        x0, step, parts = reference[0] + offset, 0, []
        for stage in stages:
            trace = estimator.control(
                stage.mpc, reference[step:], scenario.DT, stage.steps, x0,
                shifted(scenario.effects(control.EDGES), step), learn=stage.learn, every=every, solver=stage.solver,
            )  # fmt: skip
            x0, step = trace["x"][-1], step + stage.steps
            trace["x"] = trace["x"] if not parts else trace["x"][1:]
            parts.append(trace)
        whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        whole["reference"] = reference[1 : step + 1]
        whole["error"] = np.linalg.norm(whole["x"][1:] - whole["reference"], axis=1)
        return whole


def scene():
    """The paper's."""
    return Scene(*scenario.drive(), control.reference_path())
