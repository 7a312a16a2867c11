"""What control sees: C A^j B of the learned model against finite differences of the simulated robot."""

import numpy as np

from ... import bridge
from .. import control, scenario
from .closed_loop import Stage, outcome, shifted

AHEAD = (0, 9, 49)  # j
STRIDE = 10  # steps between two looks at the sensitivities
SHIFT = 1e-6  # of an input, for finite differences


def sensitivities(theta, ahead=AHEAD):
    """d x[k+j+1] / d u[k] as the model has it: C A^j B, (len(ahead), 3, 2)."""
    N = len(theta)
    rows, out = np.eye(3, N), []
    for j in range(max(ahead) + 1):
        if j in ahead:
            out.append(rows @ theta[:, N:])
        rows = rows @ theta[:, :N]
    return np.array(out)


def plant_sensitivities(x, u, active=(), ahead=AHEAD):
    """The same of the simulated robot at x, if u (at least max(ahead) + 1 rows) is what it is given from here on."""
    u = u[: max(ahead) + 1]
    base = bridge.simulate(u, scenario.DT, x, active)
    out = np.empty((len(ahead), 3, 2))
    for i in range(2):
        moved = u.copy()
        moved[0, i] += SHIFT
        out[:, :, i] = ((bridge.simulate(moved, scenario.DT, x, active) - base) / SHIFT)[np.array(ahead) + 1]
    return out


# name -> (state, input, whose j are asked for their sign): one step is too early for omega to move the robot sideways
WATCHED = {"dpx_dv": (0, 0, (0, 9, 49)), "dtheta_domega": (2, 1, (0, 9, 49)), "dpy_domega": (1, 1, (9, 49))}


def compare(scene, method):
    """(row of the study "sensitivities", what it comes from) for one method in closed loop, no offset."""
    learn = method.regulator != "offline"
    estimator = scene.learned(method)
    trace = scene.track(estimator, np.zeros(3), (Stage(control.STEPS, learn=learn),), every=1)
    steps = np.arange(0, control.STEPS - max(AHEAD) - 1, STRIDE)
    effects = scenario.effects(control.EDGES)
    with np.errstate(all="ignore"):
        learned = np.array([sensitivities(trace["theta"][k]) for k in steps])
        true = np.array([plant_sensitivities(trace["x"][k], trace["u"][k:], shifted(effects, k)) for k in steps])
        relative = np.linalg.norm(learned - true, axis=(2, 3)) / np.linalg.norm(true, axis=(2, 3))
        psi = estimator.lift(trace["x"])
        predicted = np.einsum("kij,kj->ki", trace["theta"], np.hstack([psi[:-1], trace["u"]]))[:, :3]
        one_step = np.linalg.norm(trace["x"][1:] - predicted, axis=1)
    row = {
        "study": "sensitivities",
        "dictionary": method.dictionary,
        "regulator": method.regulator,
        "mean_error": float(trace["error"].mean()),
        "outcome": outcome(trace),
        "one_step_error": float(one_step.mean()),
        "relative_error": {str(j): float(np.median(relative[:, i])) for i, j in enumerate(AHEAD)},
        "relative_error_p95": {str(j): float(np.percentile(relative[:, i], 95)) for i, j in enumerate(AHEAD)},
        "wrong_sign": {},
    }
    for name, (state, of, ahead) in WATCHED.items():
        row["wrong_sign"][name] = {}
        for j in ahead:
            says, is_ = (values[:, AHEAD.index(j), state, of] for values in (learned, true))
            # a robot that stands does not turn its yaw into lateral motion: no sign to get right
            counted = np.abs(is_) > 0.05 * scenario.DT
            share = float(np.mean(~(says[counted] * is_[counted] > 0))) if counted.any() else None
            row["wrong_sign"][name][str(j)] = share
    return row, {"t": steps * scenario.DT, "learned": learned, "true": true, "relative": relative}
