"""Plain functions beside effects, or instead of them: taken in one by one while the likelihood rises by more than their price."""

from dataclasses import dataclass, replace

import numpy as np

from .fit import ALWAYS

BESIDE = 3  # functions beside causes; instead of them there may be one more for each cause
SAME = 0.98  # cosine, from which on a function does the same as a cause
STEP = 1e-3  # of a size, by which slopes are taken
ROUNDS = 6  # of the search for noise
SHOWS = 1e-9  # norm of a column that is not nothing


@dataclass
class Taken:
    """chosen: indices of functions; gained: -2 log likelihood and price, that they are worth; noise: that suits what is left."""

    chosen: list
    gained: float
    noise: object
    weights: np.ndarray


class Functions:
    """The plain functions of a path, as pushes (K, n, q) in every step."""

    def __init__(self, search, state):
        self.search, self.path, self.state = search, search.path, state
        fitter = search.at(state)
        self.D, self.E = self.path.steps([state.fit.causes])
        left = fitter.whiten(self.D, self.E)[:, 0]
        self.names, self.pushes = self.path.generic(left.reshape(self.path.present.shape))
        self.price = np.log(fitter.degrees / self.path.alike_rows) + 2 * np.log(max(len(self.names), 2))

    def white(self, pushes):
        """What pushes (K, n, q) make of the residual (n, q), by the fitter's noise."""
        shape = *self.path.present.shape, pushes.shape[-1]
        return self.search.fitter.whiten(pushes, np.zeros(shape)) if shape[-1] else np.zeros((self.path.present.size, 0))

    def _slopes(self, causes):
        """By how much sizes of causes move where steps end, (K, n, p)."""
        z = self.search.fitter.vector(causes)[0]
        trials = [self.search.fitter.split(causes, z + sign * STEP * unit) for unit in np.eye(len(z)) for sign in (1, -1)]
        if not trials:
            return np.zeros((*self.D.shape[:2], 0))
        D = self.path.steps(trials)[0]
        return (D[..., ::2] - D[..., 1::2]) / STEP

    def beside(self):
        """The functions Taken that add to the causes."""
        causes = self.state.fit.causes
        if not self.path.competes:
            return Taken([], 0.0, self.state.noise, np.zeros(0))
        return self._taken(self.D, self._slopes(causes), np.ones(len(self.names), bool), BESIDE)

    def instead(self):
        """-2 log likelihood and price of the causes over those of functions that do without them.

        What does the same as a cause is not tried: that is the cause by another name.
        """
        self.search.at(self.state)
        causes = self.state.fit.causes
        none, throughout = self.path.steps([()])[0], [(replace(c, segments=ALWAYS),) for c in causes]
        effect = self.white(self.path.steps(throughout)[0] - none)
        columns = self.white(self.pushes)
        like = np.abs(columns.T @ effect) > SAME * np.outer(np.linalg.norm(columns, axis=0), np.linalg.norm(effect, axis=0))
        begun = self.path.noises.likeliest(self.path, self.state.noise, none, self.E)[1]
        now = self.path.noises.likeliest(self.path, self.state.noise, self.D, self.E, ROUNDS)[1]
        taken = self._taken(none, none[..., :0], ~like.any(1), BESIDE + len(causes))
        return now + self.search.costs(causes) - begun + taken.gained

    def _taken(self, D, slopes, allowed, most):
        fitter, noises = self.search.at(self.state), self.path.noises
        noise, worth = noises.likeliest(self.path, fitter.noise, D, self.E)
        out = Taken([], 0.0, noise, np.zeros(0))
        while len(out.chosen) < most:
            fitter.noise = out.noise
            j = self._best(D, slopes, out.chosen, allowed)
            if j is None:
                break
            chosen = [*out.chosen, j]
            moves = np.concatenate([slopes, self.pushes[..., chosen]], -1)
            weights = -np.linalg.lstsq(self.white(moves), fitter.whiten(D, self.E)[:, 0], rcond=None)[0]
            noise, deviance = noises.likeliest(self.path, out.noise, D + (moves @ weights)[..., None], self.E, ROUNDS)
            gained = worth - deviance - self.price * len(chosen)
            if not gained > out.gained:  # a likelihood that overflows is worth nothing
                break
            out = Taken(chosen, gained, noise, weights[slopes.shape[-1] :])
        return out

    def _best(self, D, slopes, chosen, allowed):
        """Index of the function that takes most of what sizes and the chosen ones leave; None if that is less than its price."""
        left, columns = self.search.fitter.whiten(D, self.E)[:, 0], self.white(self.pushes)
        Q = np.linalg.qr(np.hstack([self.white(slopes), columns[:, chosen]]))[0]
        size = np.linalg.norm(columns, axis=0)
        columns = columns - Q @ (Q.T @ columns)
        beyond = np.linalg.norm(columns, axis=0)
        free = allowed & (size > SHOWS) & (beyond > np.sqrt(1 - SAME**2) * size)
        gains = np.where(free, (columns.T @ (left - Q @ (Q.T @ left))) ** 2 / np.maximum(beyond, SHOWS) ** 2, 0.0)
        return int(gains.argmax()) if gains.max(initial=0) > self.price else None
