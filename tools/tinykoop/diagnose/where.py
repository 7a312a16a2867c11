"""Where the gap lies: in which direction, when, and in what kind of driving."""

import numpy as np

from .prediction_errors.ahead import HORIZONS

BINS = 4
BLOCKS = 8


def located(path, before, least, starts, fit):
    """The `where` of the report."""
    h = int(np.flatnonzero(np.isfinite(before["position"]).any(0)).max(initial=0))
    edges = sorted({float(e) for c in fit.causes for span in c.segments for e in span if np.isfinite(e)})
    rows = path.rows[starts]
    excess = np.maximum(np.nan_to_num(before["position"][:, h]) ** 2 - least["position"][:, h] ** 2, 0)
    return {
        "channels": channels(path, least, starts, h),
        "segments": segments(excess, path.log, rows + HORIZONS[h] // 2, edges),
        "regions": regions(excess, path.log, path.u, rows, HORIZONS[h]),
    }


def channels(path, least, starts, h):
    """Share of each body axis in the squared error above the noise, heading as the error it grows to in the window."""
    log, rows = path.log, path.rows[starts]
    ends = np.minimum(rows + HORIZONS[h], len(log.x) - 1)
    half_way = 0.5 * np.sqrt(np.mean(np.sum((log.x[ends, :2] - log.x[rows, :2]) ** 2, axis=1)))
    errors = np.nan_to_num(path.ahead((), starts, HORIZONS)[:, h]) ** 2
    floors = np.stack([least["position"][:, h] ** 2 / 2] * 2 + [least["heading"][:, h] ** 2], 1)
    size = np.maximum(errors - floors, 0).mean(0) * (1, 1, half_way**2)
    return dict(zip(path.channels, map(float, size / (size.sum() or 1.0))))


def segments(excess, log, middle, edges):
    """[(t0, t1, share of the squared error above the noise)] between the edges (s) found, or in equal blocks."""
    end = len(log.x) * log.dt
    bounds = [0.0, *edges, end] if edges else [end * i / BLOCKS for i in range(BLOCKS + 1)]
    part = np.clip(np.searchsorted(bounds, middle * log.dt, side="right") - 1, 0, len(bounds) - 2)
    size = np.bincount(part, excess, minlength=len(bounds) - 1)
    return [[a, b, float(s)] for a, b, s in zip(bounds, bounds[1:], size / (size.sum() or 1.0))]


def regions(excess, log, u, starts, H):
    """Kinds of driving with more than their share of the gap, worst first."""
    ends = np.minimum(starts + H, len(u) - 1)
    mean = lambda values: np.array([values[a:b].mean() if b > a else values[a] for a, b in zip(starts, ends)])  # noqa: E731
    v, w = u.T
    change = np.abs(np.diff(u, axis=0, prepend=u[:1]))
    turns = np.concatenate([[0.0], (np.sign(w[1:]) * np.sign(w[:-1]) < 0).astype(float)])
    variables = {
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
    whole = excess.mean() or 1.0
    out = []
    for name, (values, unit) in variables.items():
        edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
        for low, high in zip(edges, edges[1:]):
            inside = (values >= low) & (values <= high)
            if inside.sum() >= 10:
                ratio = excess[inside].mean() / whole
                out.append(
                    {
                        "variable": name,
                        "unit": unit,
                        "from": float(low),
                        "to": float(high),
                        "times_average": float(ratio),
                    }
                )
    return sorted(out, key=lambda region: -region["times_average"])[:5]
