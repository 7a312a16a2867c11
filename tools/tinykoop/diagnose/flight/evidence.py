"""What speaks for each cause: how the fit suffers without it, and with each other effect in its place."""

from dataclasses import dataclass

import numpy as np

TESTABLE = 1.5  # prices that an effect of usual size must be worth for its absence to mean anything
ALIKE, ALIAS = 0.5, 0.9  # of an effect's worth that a rival takes over: they may be the same, if as good; or however good
MISTAKABLE = 0.8  # most confidence beside such an alias: the simulator is not that exact


@dataclass(frozen=True)
class Evidence:
    """worth: rise of the cost without the cause; absorbed: {rival: share of it that the rival takes over}."""

    worth: float
    absorbed: dict
    ambiguous: tuple
    confidence: float


def evidence(search, fit):
    """[Evidence] for every cause of a fit."""
    return [_one(search, fit, i) for i in range(len(fit.causes))]


def _one(search, fit, index):
    fitter, cause = search.fitter, fit.causes[index]
    others = fit.causes[:index] + fit.causes[index + 1 :]
    rest = fitter.refine(fitter.fit_of(others), steps=4)
    worth = rest.cost - fit.cost
    absorbed, behind = {}, {}
    for name in fitter.effects:
        if name in fit.names:
            continue
        trial = fitter.refine(fitter.scan(name, rest, cause.segments)[0], steps=5)
        absorbed[name] = float(np.clip((rest.cost - trial.cost) / max(worth, 1e-9), 0, 1))
        behind[name] = trial.cost - fit.cost
    heat = 2 * search.heat(fit)
    odds = sum(np.exp(-min(max(d, 0) / heat, 700)) for d in [*behind.values(), worth])
    as_good = {n for n, d in behind.items() if absorbed[n] > ALIKE and d < search.price * search.heat(fit)}
    ambiguous = tuple(n for n in behind if n in as_good or absorbed[n] > ALIAS)
    return Evidence(worth, absorbed, ambiguous, min(float(1 / (1 + odds)), MISTAKABLE if ambiguous else 1.0))


def untestable(search, fit):
    """Effects that would not show in this flight at their usual size, beside those that were found."""
    fitter, out = search.fitter, []
    J = fitter.jacobian(fit) if fit.causes else np.zeros((len(fit.left), 0))
    q = np.linalg.qr(J)[0] if J.shape[1] else J
    for name, (_, spec) in fitter.effects.items():
        if name in fit.names or name in search.pieces.platform.transient:
            continue
        cause, _ = fitter.rays(name)
        g = fitter.left((*fit.causes, fitter.at(cause, np.array([np.sign(p.usual) or 1.0 for p in spec])))) - fit.left
        g = g - q @ (q.T @ g)
        if g @ g < TESTABLE * search.price * search.heat(fit):
            out.append(name)
    return out
