"""Where the gap lies: in which direction, when, and in what kind of driving."""

import numpy as np

from ... import where
from ...prediction_errors.ahead import HORIZONS


def located(found):
    """The `where` of the report."""
    path, starts, before, least = found.path, found.starts, found.before["position"], found.floor["position"]
    h = int(np.flatnonzero(np.isfinite(before).any(0)).max(initial=0))
    rows = path.rows[starts]
    excess = np.maximum(np.nan_to_num(before[:, h]) ** 2 - least[:, h] ** 2, 0)
    edges = [edge for cause in found.fit.causes for span in cause.segments for edge in span]
    return {
        "channels": where.shares(path.channels, _sizes(path, found.floor, starts, h)),
        "segments": where.parts(excess, (rows + HORIZONS[h] // 2) * path.dt, len(path.log.x) * path.dt, edges),
        "regions": where.regions(excess, _variables(path.log, path.u, rows, HORIZONS[h])),
    }


def _sizes(path, least, starts, h):
    """Squared error above the noise along each body axis, heading as the error it grows to in the window."""
    log, rows = path.log, path.rows[starts]
    ends = np.minimum(rows + HORIZONS[h], len(log.x) - 1)
    half_way = 0.5 * np.sqrt(np.mean(np.sum((log.x[ends, :2] - log.x[rows, :2]) ** 2, axis=1)))
    errors = np.nan_to_num(path.ahead((), starts, HORIZONS)[:, h]) ** 2
    floors = np.stack([least["position"][:, h] ** 2 / 2] * 2 + [least["heading"][:, h] ** 2], 1)
    return np.maximum(errors - floors, 0).mean(0) * (1, 1, half_way**2)


def _variables(log, u, starts, H):
    """{name: (values (W,), unit)}: kinds of driving in the H rows from each start."""
    ends = np.minimum(starts + H, len(u) - 1)
    mean = lambda values: np.array([values[a:b].mean() if b > a else values[a] for a, b in zip(starts, ends)])  # noqa: E731
    v, w = u.T
    change = np.abs(np.diff(u, axis=0, prepend=u[:1]))
    turns = np.concatenate([[0.0], (np.sign(w[1:]) * np.sign(w[:-1]) < 0).astype(float)])
    return {
        "speed |v|": (mean(np.abs(v)), "m/s"),
        "yaw rate |omega|": (mean(np.abs(w)), "rad/s"),
        "sideways load |v omega|": (mean(np.abs(v * w)), "m/s^2"),
        "changes of v": (mean(change[:, 0]) / log.dt, "m/s^2"),
        "changes of omega": (mean(change[:, 1]) / log.dt, "rad/s^2"),
        "yaw reversals": (mean(turns) / log.dt, "1/s"),
        "heading": (np.mod(log.x[starts, 2], 2 * np.pi), "rad"),
        "position x": (log.x[starts, 0], "m"),
        "position y": (log.x[starts, 1], "m"),
    }
