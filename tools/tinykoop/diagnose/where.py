"""Where the gap lies: in which channel, when, and in what kind of motion."""

import numpy as np

BINS, BLOCKS = 4, 8  # of a variable's range, and of the time
FEWEST, MOST = 10, 5  # values in a region, and regions


def shares(names, sizes):
    """{name: share} of what is systematic."""
    sizes = np.maximum(sizes, 0)
    return dict(zip(names, map(float, sizes / (sizes.sum() or 1.0))))


def parts(sizes, t, end, edges=()):
    """[(t0, t1, share of the sizes)] between the edges (s) found, or in equal blocks; t: times of the sizes."""
    inner = sorted({float(edge) for edge in edges if 0 < edge < end})
    bounds = [0.0, *inner, end] if inner else np.linspace(0, end, BLOCKS + 1).tolist()
    part = np.clip(np.searchsorted(bounds, t, side="right") - 1, 0, len(bounds) - 2)
    sums = np.maximum(np.bincount(part, sizes, minlength=len(bounds) - 1), 0)
    return [[a, b, float(share)] for a, b, share in zip(bounds, bounds[1:], sums / (sums.sum() or 1.0))]


def regions(sizes, variables):
    """Regions of variables {name: (values, unit)} with more than their share of the sizes, worst first."""
    whole, out = sizes.mean() or 1.0, []
    for name, (values, unit) in variables.items():
        edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
        for low, high in zip(edges, edges[1:]):
            inside = (values >= low) & (values <= high)
            if inside.sum() >= FEWEST:
                times = float(sizes[inside].mean() / whole)
                out.append({"variable": name, "unit": unit, "from": float(low), "to": float(high), "times_average": times})
    return sorted(out, key=lambda region: -region["times_average"])[:MOST]
