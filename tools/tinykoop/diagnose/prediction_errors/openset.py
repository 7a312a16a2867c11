"""On what that depends which no effect explains: pushes by plain functions, chosen on some blocks of rows, tried on others."""

import numpy as np

BLOCKS, STRIPES, MOST = 8, 24, 8
SHOWS = 1e-9


def forward(gram, slope, most=MOST):
    """Columns chosen one by one by what each adds, and their weights."""
    chosen, weights, left = [], np.zeros(0), slope.copy()
    size = np.maximum(np.diag(gram), 1e-12)
    for _ in range(min(most, len(slope))):
        gain = left**2 / size
        gain[chosen] = -1
        chosen.append(int(gain.argmax()))
        part = gram[np.ix_(chosen, chosen)]
        weights = np.linalg.solve(part + 1e-9 * np.diag(np.diag(part)), slope[chosen])
        left = slope - gram[:, chosen] @ weights
    return chosen, weights


def gains(search, state):
    """({(function, channel): squares that it takes of what the sensor does not explain, on rows that it was not fitted on}, all squares)."""
    path, fitter = search.path, search.views[-1](state)
    fit = fitter.fit_of(state.fit.causes)
    names, pushes = path.generic()
    columns = fitter.whiten(pushes, np.zeros((*path.present.shape, pushes.shape[-1])))
    size = np.linalg.norm(columns, axis=0)
    keep = np.flatnonzero(size > SHOWS)
    columns = columns[:, keep] / size[keep]
    n = len(fit.left)
    block = np.arange(n) * STRIPES // n % BLOCKS
    grams = np.stack([columns[block == b].T @ columns[block == b] for b in range(BLOCKS)])
    slopes = np.stack([-columns[block == b].T @ fit.left[block == b] for b in range(BLOCKS)])
    share = {}
    for b in range(BLOCKS):
        chosen, weights = forward(grams.sum(0) - grams[b], slopes.sum(0) - slopes[b])
        taken = 2 * weights * slopes[b][chosen] - weights * (grams[b][np.ix_(chosen, chosen)] @ weights)
        for i, gain in zip(chosen, taken):
            feature, channel = names[keep[i]]
            key = path.dependence(feature), path.channels[channel]
            share[key] = share.get(key, 0.0) + float(gain)
    search.at(state)
    return share, max(float(fit.left @ fit.left), 1e-12)


def depends(found):
    """[{on, channel, share}] of gains(), largest share first."""
    found, whole = found
    largest = sorted(((gain / whole, *key) for key, gain in found.items() if gain > 0), reverse=True)
    return [{"on": on, "channel": channel, "share": share} for share, on, channel in largest[:4]]
