"""Whether something is left that none of the effects explains: generic pushes, chosen on some windows, tried on others."""

from dataclasses import dataclass

import numpy as np

from ..prediction_errors.openset import forward

BLOCKS = 6
MATTERS = 0.02  # share of a held-out misfit that generic pushes take away, from which on something is left
NOISY = 1.5  # misfit per degree of freedom, from which on something is left whatever the pushes find


@dataclass(frozen=True)
class Left:
    share: float  # of the squares on windows not used, that generic pushes take away
    times: float  # misfit per degree of freedom
    on: tuple  # (function, state) that took most away

    @property
    def matters(self):
        return self.share > MATTERS or self.times > NOISY


def left(problem, fit, jacobian):
    """The Left of a fit, beside its own parameters."""
    G, W = problem.whiten(problem.generic()), len(problem.rollouts.starts)
    both = np.concatenate([jacobian, G], 1)
    size = np.linalg.norm(both, axis=0)
    both = both[:, size > 1e-9] / size[size > 1e-9]
    names = [name for name, s in zip([None] * jacobian.shape[1] + problem.generic_names, size) if s > 1e-9]
    blocks = np.minimum(np.arange(W) * BLOCKS // W, BLOCKS - 1)
    rows = lambda a: a.reshape(W, -1, *a.shape[1:])  # noqa: E731
    F, r = rows(both), rows(fit.left)
    grams = np.stack([np.einsum("wrp,wrq->pq", F[blocks == b], F[blocks == b]) for b in range(BLOCKS)])
    slopes = np.stack([np.einsum("wrp,wr->p", F[blocks == b], r[blocks == b]) for b in range(BLOCKS)])
    gained, on = 0.0, {}
    for b in range(BLOCKS):
        chosen, weights = forward(grams.sum(0) - grams[b], slopes.sum(0) - slopes[b])
        gained += 2 * weights @ slopes[b][chosen] - weights @ grams[b][np.ix_(chosen, chosen)] @ weights
        for i in chosen[:2]:
            if names[i]:
                on[names[i]] = on.get(names[i], 0) + 1
    order = tuple(sorted(on, key=on.get, reverse=True)[:3])
    return Left(float(max(gained, 0.0) / max(fit.cost, 1e-12)), float(fit.cost / problem.degrees), order)
