"""A log cut into pieces, and what is left of it, whitened, after a prediction.

In a piece the model runs freely. Where it starts is not the measured pose, which has noise, but
unknown: position and heading of every start are eliminated by projection. So the noise of what is
left is the sensor's own, row by row, and neither shared between pieces nor grown along the path.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np

from ..plumbing.errors import UserError

SECONDS = 2.5  # of a piece: long enough for slow effects,
ROWS, MOST_ROWS = 50, 150  # but in rows not less than the longest horizon that is reported
AVOIDED = 10  # rows on either side of one where something changes
FEWEST = 6  # rows that are worth a piece: three go into its start
SETTLE = 8  # pieces from which on the first is left out: how actuators stood before the log began is not known
MOST = 7500  # rows of a long log, in pieces evenly spread


@dataclass(frozen=True)
class Noise:
    """Of the measured pose: AR(1) in time, standard deviation and correlation from row to row."""

    sp: float  # m
    st: float  # rad
    rho_p: float = 0.0
    rho_t: float = 0.0


def usual_rows(dt):
    """Rows of a piece for a sampling time."""
    return int(np.clip(round(SECONDS / dt), ROWS, MOST_ROWS))


def cut(usable, rows):
    """Starts (S) and lengths (S), in rows, of pieces that hold usable transitions only."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]])))
    starts, lengths = [], []
    for begin, end in edges.reshape(-1, 2):
        total = end - begin + 1
        count = max(1, round(total / rows))
        cuts = begin + np.arange(count + 1) * total // count
        starts.extend(cuts[:-1])
        lengths.extend(np.diff(cuts))
    starts, lengths = np.array(starts, np.int64), np.array(lengths, np.int64)
    keep = lengths >= FEWEST
    if keep.sum() >= SETTLE and starts[keep][0] == 0:
        keep[0] = False
    most = MOST // rows
    if keep.sum() > most:
        chosen = np.flatnonzero(keep)[np.linspace(0, keep.sum() - 1, most).round().astype(int)]
        keep = np.isin(np.arange(len(keep)), chosen)
    return starts[keep], lengths[keep]


class Pieces:
    """Residuals of a log in pieces; whiten() makes white noise of unit variance of them.

    Shapes: S pieces of up to L rows, 3 channels (along and across the heading at the start, m;
    heading, rad). Rows beyond a piece's end are zero everywhere. avoid: rows that no piece comes near.
    """

    def __init__(self, platform, log, integrator, rows=None, avoid=()):
        self.platform, self.log, self.integrator = platform, log, integrator
        whole = log.usable.copy()
        for row in avoid:
            whole[max(row - AVOIDED, 0) : row + AVOIDED] = False
        self.starts, self.lengths = cut(whole, rows or usual_rows(log.dt))
        if not len(self.starts):
            raise UserError(f"the log has no {FEWEST} usable rows in a row: record it with fewer gaps")
        self.L = int(self.lengths.max())
        self.steps = np.arange(1, self.L)
        self.inside = np.arange(self.L) < self.lengths[:, None]  # (S, L)
        self.rows = np.minimum(self.starts[:, None] + np.arange(self.L), len(log.x) - 1)
        self.weight = 1.0
        self.features = None  # values of features.functions() are kept here
        self.begin_at(log.x[self.starts])
        self._turns()
        self.noise = Noise(1.0, 1.0)
        self._prepare()

    def begin_at(self, poses):
        """Lets every piece start at another pose (S, 3)."""
        self.start_pose = poses.copy()
        log, x = self.log, self.log.x.copy()
        x[self.starts] = poses
        self._rollouts = self.platform.rollouts(x, log.u, log.dt, self.starts, self.steps, log.usable, self.integrator)
        first = log.x[self.starts] - poses
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        along, across = c * first[:, 0] + s * first[:, 1], c * first[:, 1] - s * first[:, 0]
        self._first = np.stack([along, across, first[:, 2]], 1)

    def _turns(self):
        """How what is left moves with position and heading of the start: (S, L, 3, 3)."""
        x0 = self.start_pose
        way = self.log.x[self.rows][..., :2] - x0[:, None, :2]
        c, s = np.cos(x0[:, 2])[:, None], np.sin(x0[:, 2])[:, None]
        along, across = c * way[..., 0] + s * way[..., 1], c * way[..., 1] - s * way[..., 0]
        turns = np.zeros((*self.rows.shape, 3, 3))
        turns[..., 0, 0] = turns[..., 1, 1] = turns[..., 2, 2] = 1
        turns[..., 0, 2], turns[..., 1, 2] = -across, along
        self.turns = turns
        self.raw = None  # features.raw_columns() are kept here while starts stay as they are

    def residual(self, active=()):
        """Measured less predicted, (S, L, 3)."""
        _, after = self._rollouts.predict(active)
        r = np.empty((len(self.starts), self.L, 3))
        r[:, 0] = self._first
        r[:, 1:] = after
        r[~self.inside] = 0
        return r

    def set_noise(self, noise, weight=None):
        """What whiten() takes the noise to be; weight (S, L, 3): below 1 for outliers."""
        self.noise = noise
        if weight is not None:
            self.weight = np.sqrt(weight)
        self._prepare()

    def _prepare(self):
        n = self.noise
        self.sd = np.array([n.sp, n.sp, n.st])
        self.rho = np.array([n.rho_p, n.rho_p, n.rho_t])
        gain = self.inside[..., None] * self.weight / self.sd * np.ones(3)
        gain[:, 1:] /= np.sqrt(1 - self.rho**2)
        self._now, self._before = gain, gain[:, 1:] * self.rho
        white = self._filter(np.moveaxis(self.turns, -1, 0))  # (3, S, L, 3)
        columns = np.moveaxis(white, 0, -1).reshape(len(self.starts), -1, 3)
        self.basis, self.upper = np.linalg.qr(columns)
        self._basis_t = np.ascontiguousarray(np.swapaxes(self.basis, 1, 2))
        self.generic = None  # features.Generic keeps its basis here while pieces stay as they are

    def _filter(self, r):
        e = r * self._now
        e[..., 1:, :] -= r[..., :-1, :] * self._before
        return e

    def innovations(self, r):
        """(.., S, L, 3) residuals -> what is new in every row, in standard deviations."""
        z = r / self.sd
        e = z.copy()
        e[..., 1:, :] -= self.rho * z[..., :-1, :]
        e[..., 1:, :] /= np.sqrt(1 - self.rho**2)
        return np.where(self.inside[..., None], e, 0)

    def whiten(self, r):
        """(.., S, L, 3) residuals -> (.., S, 3 L), white, without what a start pose can explain."""
        e = self._filter(r)
        e = e.reshape(*e.shape[:-2], -1)
        return e - (self.basis @ (self._basis_t @ e[..., None]))[..., 0]

    def cost(self, active=()):
        """Sum of squares of what is left, whitened."""
        return float((self.whiten(self.residual(active)) ** 2).sum())

    def settle_starts(self, r):
        """Moves every start to where residuals r (S, L, 3) want it: the projection is linear, the way it turns is not."""
        e = self._filter(r).reshape(len(self.starts), -1)
        shift = np.linalg.solve(self.upper, np.einsum("snk,sn->sk", self.basis, e)[..., None])[..., 0]
        c, s = np.cos(self.start_pose[:, 2]), np.sin(self.start_pose[:, 2])
        moved = np.stack([c * shift[:, 0] - s * shift[:, 1], s * shift[:, 0] + c * shift[:, 1], shift[:, 2]], 1)
        self.begin_at(self.start_pose + moved)
        self._turns()
        self._prepare()

    def reach(self, H):
        """H, or the last row that most pieces have."""
        return min(H, int(np.quantile(self.lengths, 0.2)) - 1)

    def only(self, chosen):
        """These pieces alone, with the same noise and starts; None if there are none."""
        if not chosen.any():
            return None
        part = copy(self)
        part.features = None
        for name in ("starts", "lengths", "inside", "rows"):
            setattr(part, name, getattr(self, name)[chosen])
        part.begin_at(self.start_pose[chosen])
        if np.ndim(self.weight):
            part.weight = self.weight[chosen]
        part._turns()
        part._prepare()
        return part

    @property
    def degrees(self):
        """Values that are left free when every start is fitted."""
        return int(3 * self.lengths.sum() - 3 * len(self.starts))
