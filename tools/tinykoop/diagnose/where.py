"""Where the gap lies: in which direction, when, and in what kind of driving."""

import numpy as np

from .measure import HORIZONS, longest

BINS = 4
BLOCKS = 8


def _excess(errors, least):
    """Squared error above the noise, not below zero."""
    return np.maximum(np.nan_to_num(errors) ** 2 - least**2, 0)


def channels(before, least, log):
    """Share of each body axis in the squared error above the noise, heading as the error it grows to in the window."""
    j = longest(before)
    starts = before.starts
    ends = np.minimum(starts + HORIZONS[j], len(log.x) - 1)
    half_way = 0.5 * np.sqrt(np.mean(np.sum((log.x[ends, :2] - log.x[starts, :2]) ** 2, axis=1)))
    axis_floor = least[:, j, 0] / np.sqrt(2)
    size = [
        _excess(before.along[:, j, 0], axis_floor).mean(),
        _excess(before.along[:, j, 1], axis_floor).mean(),
        _excess(before.heading[:, j], least[:, j, 1]).mean() * half_way**2,
    ]
    total = sum(size) or 1.0
    return dict(zip(("longitudinal", "lateral", "heading"), (float(s / total) for s in size)))


def segments(before, least, log, edges):
    """[(t0, t1, share of the squared error above the noise)] between the edges found, or in equal blocks."""
    rows = len(log.x)
    bounds = [0, *edges, rows] if edges else [rows * i // BLOCKS for i in range(BLOCKS + 1)]
    j = longest(before)
    excess = _excess(before.position[:, j], least[:, j, 0])
    middle = np.minimum(before.starts + HORIZONS[j] // 2, rows - 1)
    part = np.searchsorted(bounds, middle, side="right") - 1
    size = np.bincount(part, excess, minlength=len(bounds) - 1)
    share = size / (size.sum() or 1.0)
    time = [log.dt * row for row in bounds]
    return [[float(a), float(b), float(s)] for a, b, s in zip(time, time[1:], share)]


def regions(before, least, log, u):
    """Kinds of driving with more than their share of the gap, worst first."""
    j, starts = longest(before), before.starts
    H = HORIZONS[j]
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
    excess = _excess(before.position[:, j], least[:, j, 0])
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
