"""Is something systematic left? Accelerations of the body as generic functions of command, motion and time.

They know nothing of effects: what they still find beside an explanation, and do not find on healthy flights, is unexplained.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from .vehicle import turns_yaw

AXES = ("x", "y", "z")
ANGLE = (7, 6, 8)  # columns of a log: roll, pitch, yaw
SMOOTH = 0.08  # s
PUSH = (0.3, 0.3, 0.3, 4.0, 4.0, 4.0)  # m/s^2 and rad/s^2, of a column
FEIGNED = 1.7  # times the largest peak of healthy flights, from which on something is left
SIGNIFICANT = 1e-4


def functions(log):
    """{name: (values (K,), accelerations it drives)}; accelerations along x, y, z: 0 to 2, about them: 3 to 5."""
    rows = max(round(SMOOTH / log.dt), 1)
    # of the past alone: what was yet to come would give away the noise that the innovations are
    smooth = lambda v: np.convolve(np.nan_to_num(v), np.full(rows, 1 / rows))[: len(v)]  # noqa: E731
    scaled = lambda v: v / (np.std(v) + 1e-9)  # noqa: E731
    u, t = log.u[:, 0] - log.u[:, 0].mean(), np.linspace(-1, 1, len(log.x))
    axis = 5 if turns_yaw(log) else 4
    table = {"always": (np.ones(len(t)), (0, 1, 3, 4, 5)), "time": (t, (3, 4, 5))}
    table["command"] = scaled(smooth(u)), (axis,)
    table["changes of the command"] = scaled(np.diff(smooth(u), prepend=u[0])), (axis,)
    table["command, more with time"] = scaled(smooth(u) * t), (axis,)
    table["command, by its size"] = scaled(smooth(u) * np.abs(smooth(u))), (axis,)
    for i, name in enumerate(("roll", "pitch", "yaw")):
        angle, rate = np.unwrap(np.nan_to_num(log.x[:, ANGLE[i]])), smooth(log.x[:, i])
        table[name] = scaled(smooth(angle) - angle.mean()), (3 + i, *({"roll": (1,), "pitch": (0,)}.get(name, ())))
        table[f"{name} rate"] = scaled(rate), (3 + i,)
    return table


@dataclass(frozen=True)
class Left:
    """What generic accelerations find: gain (of the sum of squares), peak (of a single one), {(on, acceleration): share}."""

    gain: float
    peak: float
    count: int
    scale: float  # variance per value that they leave
    depends: dict

    def significance(self):
        """Probability of such a peak if nothing but noise is left (Bonferroni)."""
        return float(min(self.count * stats.chi2.sf(self.peak / self.scale, 1), 1.0))


class Generic:
    """The columns of one flight, made once."""

    def __init__(self, pieces):
        self.pieces, self.names, columns = pieces, [], []
        plain = pieces.whiten(pieces.residual())
        for on, (values, accelerations) in functions(pieces.log).items():
            for j in accelerations:
                push = np.zeros((len(values), 6))
                push[:, j] = PUSH[j] * values
                columns.append((pieces.whiten(pieces.residual(push=push)) - plain).ravel())
                self.names.append((on, f"{'along' if j < 3 else 'about'} {AXES[j % 3]}"))
        F = np.stack(columns, 1)
        size = np.linalg.norm(F, axis=0)
        self._single = F / np.maximum(size, 1e-12)
        U, s, _ = np.linalg.svd(self._single, full_matrices=False)
        self._basis = U[:, s > 1e-4 * s[0]]

    def left(self, residual):
        """The Left of whitened residuals (n,)."""
        gain = float(np.sum((self._basis.T @ residual) ** 2))
        alone = (self._single.T @ residual) ** 2
        depends = {name: float(a / max(gain, 1e-12)) for name, a in zip(self.names, alone)}
        count = self._basis.shape[1]
        scale = max(float(residual @ residual) - gain, 1e-9) / max(self.pieces.degrees - count, 1)
        return Left(gain, float(alone.max()), count, scale, dict(sorted(depends.items(), key=lambda item: -item[1])))
