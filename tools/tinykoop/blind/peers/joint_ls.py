"""Joint least squares with t-tests: every effect of the library at once, then those that are significant.

What an engineer does first, and the core of grey-box system identification (Ljung, System Identification,
1999, chapters 7 and 16). Windows of 20 steps; a weak prior keeps near aliases solvable; the start is each
effect's own best grid point. Effects leave one by one, the least significant first (Wald test on the joint
curvature, Bonferroni over the library), and those that stay are fitted again. To read the t-values
of the full fit without that elimination is worse: aliases make one another insignificant.
"""

import numpy as np
from scipy.stats import chi2

from . import common

_LEVEL = 0.01  # of the whole family of tests
_PRIOR = 10.0  # in usual values of the parameters


def _tests(fit):
    """{name: log of the p-value} of each effect, the others free.

    What dropping it costs is read off the curvature; where that says more than leaving the others as they are
    does (a threshold has hardly a curvature), the latter counts.
    """
    owners, tests = np.array([name for name, _ in fit.places]), {}
    C, here = np.linalg.inv(fit.information), fit.cost_at(fit.z)
    for name in fit.names:
        own = fit.amplitude & (owners == name)
        wald = fit.z[own] @ np.linalg.solve(C[np.ix_(own, own)], fit.z[own])
        plain = (fit.cost_at(np.where(own, 0.0, fit.z)) - here) / fit.spread
        cost = max(min(wald, plain), 0)
        tests[name] = max(chi2.logsf(cost, np.sum(own)), -cost / 2)  # the former underflows
    return tests


def _equal_gains(fit):
    """Whether both gains are there and equal within their errors."""
    names = [name for name, _ in fit.places]
    if not {"speed_gain", "yaw_gain"} <= set(names):
        return False
    i, j = names.index("speed_gain"), names.index("yaw_gain")
    contrast = np.zeros(len(names))
    contrast[i], contrast[j] = abs(fit.rows["speed_gain"][0][4]), -abs(fit.rows["yaw_gain"][0][4])
    return abs(contrast @ fit.z) < 3 * np.sqrt(contrast @ np.linalg.inv(fit.information) @ contrast)


@common.on_one_core
def peer(log_path, fresh_path=None, without=()):
    data = common.Data.read(log_path)
    library = common.candidates(without)
    # the clock is exactly both gains: it cannot be fitted beside them, but be read off them
    clock = {"speed_gain", "yaw_gain", "clock_scale"} <= set(library)
    alive = [name for name in library if name != "clock_scale" or not clock]
    fit = common.Fit(data, common.Noise.of(data), alive, prior=_PRIOR)
    noise = common.Noise.of(data, common.simulator(fit.active()))
    fit = common.Fit(data, noise, alive, prior=_PRIOR, begin=fit.fitted())
    left_at, tests = {}, {}
    while fit.names:
        tests = _tests(fit)
        worst = max(tests, key=tests.get)
        if tests[worst] > np.log(_LEVEL / len(library)):
            alive = [name for name in fit.names if name != worst]
            left_at[worst] = -1.0 * len(alive)
        elif clock and _equal_gains(fit):
            alive = [name for name in fit.names if name not in ("speed_gain", "yaw_gain")] + ["clock_scale"]
            left_at |= {"speed_gain": 0.0, "yaw_gain": 0.0}
        else:
            break
        fit = common.Fit(data, noise, alive, prior=_PRIOR, begin=fit.fitted())
    model = common.simulator(fit.active())
    verdict = "known" if fit.names else "none"
    if common.left(data, model) > common.MOST_LEFT:
        verdict = "unknown"
    confidence = {name: 1 - min(1, len(library) * np.exp(tests[name])) for name in fit.names}
    # behind those that stayed the others, the last to leave first
    ranking = dict.fromkeys(library, -99.0) | left_at | {name: -tests[name] for name in fit.names}
    return common.report(data, model, fresh_path, verdict, fit.effects(confidence), ranking)
