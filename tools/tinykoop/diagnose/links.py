"""The links of a robot, from command to actuator and on to motion and sensors: what the report says of each, and its share of the gap."""

import numpy as np

from .diagnosis import effects, gaps, noise
from .prediction_errors import ahead

TOLD = ("name", "params", "units", "params_ci95", "confidence", "at_bound", "segments")


def told(name, own, of):
    """What the report says of a link, by the Answer to its log; of: the gap of the whole log of which it has a share."""
    gap = gaps(own.path, own.before, own.after, own.floor)["gap"]
    named = [{key: effect[key] for key in TOLD} for effect in effects(own)]
    return {"link": name, "verdict": own.verdict, "of": of, "gap": gap, "effects": named, "noise": noise(own.path, own.state.noise)}


def main(found):
    """The gap that the verdict is about."""
    return next(name for name, (unit, _) in found.path.gaps.items() if unit == found.left.unit)


def hidden(part, floor):
    """Whether noise hides what a link makes predictions miss (S, H, c): then no effect is looked for there."""
    size, least = ahead.rms(np.sqrt((part**2).sum(-1))), ahead.rms(floor)
    return not (size > (1 + ahead.SHOWS) * least).any()


def share(whole, part, floor, has_noise):
    """The share of a link, from vectors (S, H, c) at the longest horizon that there is; None where the whole is about the noise.

    A prediction by the commands misses what was measured by what the actuators miss the commands, and what the motion misses the
    actuators: as vectors these add up. The share of a link is the mean of its part times the whole, over the mean square of the whole,
    both without the noise of what was measured, which the part of the motion has: shares from command to motion add up to one.
    """
    there = np.isfinite(whole).all(-1) & np.isfinite(part).all(-1)
    if not there.any():
        return None
    h = int(np.flatnonzero(there.any(0)).max())
    whole, part, least = whole[there[:, h], h], part[there[:, h], h], np.mean(floor[there[:, h], h] ** 2)
    square = np.mean((whole**2).sum(-1))
    if np.sqrt(square) < (1 + ahead.SHOWS) * np.sqrt(least):
        return None
    return float((np.mean((whole * part).sum(-1)) - has_noise * least) / (square - least))


def tagged(effects, links, names=lambda name: (name,)):
    """Effects of the whole log, each with the `link` in which the same one is found, of several that with the largest share.

    names: those that an effect of the whole log may have in a link.
    """
    where = {}
    for link in sorted(links, key=lambda link: link["share"] or 0.0):
        where |= {effect["name"]: link["link"] for effect in link["effects"]}
    at = (next((where[name] for name in names(effect["name"]) if name in where), None) for effect in effects)
    return [effect | ({"link": link} if link else {}) for effect, link in zip(effects, at)]
