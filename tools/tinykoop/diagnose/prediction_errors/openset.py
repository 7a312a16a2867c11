"""On what that depends which no effect explains: pushes by plain functions, chosen on some blocks of rows, tried on others."""

import numpy as np

from . import ahead
from .functions import Functions

BLOCKS, STRIPES, MOST = 8, 24, 8  # folds; stripes of rows that they are made of; functions that are chosen
SHOWS = 1e-9  # norm of a column that is not nothing
CERTAIN = 25.0  # squares of rows that it was not fitted on, that it must take: of noise it takes none
SURELY = 50.0  # the same of rows that they were chosen on: noise of another form than the one that is told takes some
WORTH = 12.0  # squares, that a function must take: the best of some hundreds takes as much of white noise


def forward(gram, slope, most=MOST):
    """Columns chosen one by one by what each adds, and their weights."""
    chosen, weights, left = [], np.zeros(0), slope.copy()
    size = np.maximum(np.diag(gram), 1e-12)
    for _ in range(min(most, len(slope))):
        gain = left**2 / size
        gain[chosen] = -1
        if gain.max() < WORTH:
            break
        chosen.append(int(gain.argmax()))
        part = gram[np.ix_(chosen, chosen)]
        weights = np.linalg.solve(part + 1e-9 * np.diag(np.diag(part)), slope[chosen])
        left = slope - gram[:, chosen] @ weights
    return chosen, weights


def boxed(search, state, missed, starts):
    """({gap: errors (S, H)} of predictions that miss so much (S, H, c), with what a black box predicts of that; the BlackBox).

    Where the noise has no random motion of the robot, the errors are as they are.
    """
    path, box = search.path, BlackBox(search, state)
    if not len(path.usual):
        return ahead.sizes(path, missed), box
    pushed = ahead.pushed(path, box.pushes, starts)
    box.moved = ahead.sizes(path, pushed)
    return ahead.sizes(path, missed - pushed), box


class BlackBox:
    """What plain functions predict of that which the causes of a state leave, each block of rows by functions fitted on the others.

    pushes (K, n): what they add to where each step ends; moved: {gap: (S, H)}, by how much that moves predictions, if it was asked for;
    beside: the functions that are chosen on all rows, with the noise that is left then: as noise, the random motion of the robot, a
    function would hide.
    """

    moved = None

    def __init__(self, search, state):
        self.path, self.share = search.path, {}
        self.functions = functions = Functions(search, state)
        self.beside = functions.beside()
        fitter = search.at(state)
        fitter.noise = self.beside.noise
        left, columns = fitter.whiten(functions.D, functions.E)[:, 0], functions.white(functions.pushes)
        size = np.linalg.norm(columns, axis=0)
        keep = np.flatnonzero(size > SHOWS)
        self._names, self._pushes = [functions.names[i] for i in keep], functions.pushes[..., keep] / size[keep]
        self.whole, self.pushes = max(float(left @ left), 1e-12), np.zeros(self._pushes.shape[:2])
        self._predict(columns[:, keep] / size[keep], left)
        if not self.predicts:
            self.pushes = self.shows * functions.pushes[..., self.beside.chosen] @ self.beside.weights

    def _predict(self, columns, left):
        K = len(self.pushes)
        rows = np.arange(K) * STRIPES // K % BLOCKS
        block = np.repeat(rows, len(left) // K)
        grams = np.stack([columns[block == b].T @ columns[block == b] for b in range(BLOCKS)])
        slopes = np.stack([-columns[block == b].T @ left[block == b] for b in range(BLOCKS)])
        for b in range(BLOCKS):
            chosen, weights = forward(grams.sum(0) - grams[b], slopes.sum(0) - slopes[b])
            self._count(chosen, 2 * weights * slopes[b][chosen] - weights * (grams[b][np.ix_(chosen, chosen)] @ weights))
            self.pushes[rows == b] = self._pushes[rows == b][..., chosen] @ weights

    def _count(self, chosen, taken):
        for i, gain in zip(chosen, taken):
            feature, channel = self._names[i]
            key = self.path.dependence(feature), self.path.channels[channel]
            self.share[key] = self.share.get(key, 0.0) + float(gain)

    def rival(self):
        """Squares and price, by which plain functions alone are worse than the causes with the functions beside them."""
        return self.beside.gained - self.functions.instead() if self.path.competes and self.functions.state.causes else np.inf

    @property
    def predicts(self):
        """Whether it predicts more of rows that it was not fitted on than noise lets it."""
        return sum(self.share.values()) > CERTAIN

    @property
    def shows(self):
        """Whether it predicts, or is worth more on all rows than noise lets it."""
        return self.predicts or self.beside.gained > SURELY

    def depends(self):
        """[{on, channel, share of all squares}], largest share first."""
        shares = self.share if self.predicts else self._beside()
        largest = sorted(((gain / self.whole, *key) for key, gain in shares.items() if gain > 0), reverse=True)
        return [{"on": on, "channel": channel, "share": share} for share, on, channel in largest[:4]]

    def _beside(self):
        """{(function, channel): squares} of the functions that are chosen on all rows, in equal parts."""
        named = [self.functions.names[i] for i in self.beside.chosen]
        return {(self.path.dependence(f), self.path.channels[c]): self.beside.gained / len(named) for f, c in named}
