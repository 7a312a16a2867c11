"""When did something change? Seen from the innovations of one log of the flapping wing alone.

A model of the whole log, by the library, on means over 0.1 s. It is fitted to what moves within a second, each second less its
mean: so it cannot learn the change, wherever in the log that comes, as a model of the whole log does otherwise, and it knows
every manoeuvre, unlike a model of the log's beginning. In what it leaves two things are looked for:

- a lasting change: all means over 3 s of the 9 s before lie on one side, and all of the 9 s after on the other (or as far as
  the log goes). A manoeuvre, which comes and goes, is none.
- a jolt: 0.2 s that stand out from the log's own largest of each second. A gust that a free vehicle follows is one: once it
  drifts with the air it flies as before, and no innovation can tell.

Each threshold is a quantile of a null distribution that knows nothing of the log but its length; docs/flapping-wing.md.
"""

import functools
from pathlib import Path

import numpy as np

from .. import bridge
from ..experiments import transfer
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, printable, replacing
from . import replay

STEP = 0.1  # s, over which rows are averaged; of a log slower than that each row is a step, and all that follows is longer
SWING = 10  # steps
# What swings little within a second says little of large slow motion, so the ridge keeps it from explaining that away; a jolt is short.
INVERSE_RIDGE = {"lasting": 1.0, "jolt": 1e4}
BIN = 5  # steps
WINDOW, REACH, SIDE = 6, 18, 11  # bins: 3 s, 9 s, and the 5.5 s at either end (take-off, landing) in which nothing is judged
LASTING_ALARMS = 0.05  # share of logs with a false alarm if all innovations are random walks, worse than a vehicle under control
JOLT, SECOND = 2, 10  # steps
JOLT_ALARMS = 0.01  # share of logs with a false alarm
DRAWS = 4000  # of each null distribution


def averaged(log):
    """The log as means over STEP; a step may be used if all rows of its two means may."""
    rows = max(1, round(STEP / log.dt))
    count = len(log.t) // rows
    t, x, u = (a[: count * rows].reshape(count, rows, -1).mean(axis=1) for a in (log.t, log.x, log.u))
    usable = np.array([log.usable[k * rows : (k + 2) * rows - 1].all() for k in range(count - 1)], bool)
    return bridge.Log(t[:, 0], x, u, usable, rows * log.dt)


def centred(values, usable):
    """The usable rows, less their mean over each SWING."""
    parts = [values[k : k + SWING][usable[k : k + SWING]] for k in range(0, len(values), SWING)]
    return np.concatenate([part - part.mean(axis=0) for part in parts if len(part)])


def innovations(log, kind):
    """(t (K), innovations (K, n)) of the steps of a log, to look for a kind of change in; NaN where a step may not be used."""
    log = averaged(log)
    seconds, least = log.usable.sum() * log.dt, max(2 * SIDE * BIN * log.dt, (log.t[-1] - log.t[0]) / 2)
    if seconds < least:
        raise UserError(
            f"{seconds:.1f} s of whole steps, at least {least:.0f} s are needed (and half of the log); "
            "take a longer log, or check seg and pose_ok"
        )
    estimator = bridge.Estimator("poly_fwmav", "none", 64, form="sqrt", n_inputs=1, p0=INVERSE_RIDGE[kind])
    psi = estimator.lift(np.where(np.isfinite(log.x), log.x, 0))
    now, after = np.column_stack([psi[:-1], log.u[:-1]]), psi[1:]
    estimator.soak(centred(now, log.usable), centred(after, log.usable), 1)
    left = (after - now @ estimator.theta.T)[:, : estimator.n]
    left[~log.usable] = np.nan
    return log.t[1:], left - np.nanmedian(left, axis=0)


def means(values, width):
    """Means over `width` consecutive rows, of those that are there; NaN where fewer than half of them are."""
    there = np.isfinite(values)
    sums, counts = (np.cumsum(np.pad(a, ((1, 0), (0, 0))), axis=0) for a in (np.where(there, values, 0), there))
    sums, counts = sums[width:] - sums[:-width], counts[width:] - counts[:-width]
    return np.where(2 * counts >= width, sums / np.maximum(counts, 1), np.nan)


def spread(sizes):
    """The usual size in each column; infinite where nothing moves, so that nothing stands out there."""
    usual = np.nanmedian(sizes, axis=0)
    return np.where(usual > 0, usual, np.inf)


def change(kind, t, begin, end, strength, channels):
    """One entry of the answer; times in s of the log, strength in thresholds, the channel that moved most first."""
    begin, end = round(float(t[begin]), 3), round(float(t[end]), 3)
    return {
        "kind": kind,
        "time": round((begin + end) / 2, 3),
        "from": begin,
        "to": end,
        "strength": float(strength),
        "channels": [transfer.CHANNELS[c][0] for c in channels],
    }


# ---- lasting changes -----------------------------------------------------------------------------


def gaps(bins):
    """By how much the windows after a place lie beyond those before it, in units of the usual change from window to window.

    bins (K, n); returns (K - 2 SIDE + 1, n), the first for the place before bin SIDE. Negative: they overlap.
    """
    windows = means(bins, WINDOW)
    steps = np.abs(windows[WINDOW:] - windows[:-WINDOW])
    usual = spread(steps)
    gap = np.empty((len(bins) - 2 * SIDE + 1, bins.shape[1]))
    for row, k in enumerate(range(SIDE, len(bins) - SIDE + 1)):
        before, after = windows[max(0, k - REACH) : k - WINDOW + 1], windows[k : k + REACH - WINDOW + 1]
        up = np.fmin.reduce(after) - np.fmax.reduce(before)
        down = np.fmin.reduce(before) - np.fmax.reduce(after)
        gap[row] = np.fmax(up, down)
    return gap / usual


@functools.cache
def lasting_threshold(count, channels):
    """Of gaps(), for a log of `count` bins of as many independent random walks as it has channels."""
    walks = np.cumsum(np.random.default_rng(0).normal(size=(count, DRAWS)), axis=0)
    return np.quantile(gaps(walks).max(axis=0), (1 - LASTING_ALARMS) ** (1 / channels))


def lasting_score(left):
    """(index of steps (R), score (R, n)): gaps() over the threshold, above 1 is a change."""
    count = len(left) // BIN
    return BIN * np.arange(SIDE, count - SIDE + 1), gaps(means(left, BIN)[::BIN][:count]) / lasting_threshold(count, left.shape[1])


def rise(values):
    """(begin, end) of the straight rise between two levels that fits the values best."""
    k = np.flatnonzero(np.isfinite(values))
    values = values[k] - values[k].mean()
    least = SIDE * BIN // 2  # of either level
    last, best = SIDE * BIN + least, (np.inf,)
    for begin in range(least, last):
        for end in range(begin + 1, min(begin + WINDOW * BIN, last) + 1):
            shape = np.clip((k - begin) / (end - begin), 0, 1)
            shape -= shape.mean()
            best = min(best, (-((shape @ values) ** 2) / (shape @ shape), begin, end))
    return best[1:]


def lasting(t, left):
    """Lasting changes: the strongest one, then those on either side of it."""
    if len(left) < 2 * SIDE * BIN:
        return []
    index, score = lasting_score(left)
    best = np.fmax.reduce(score, axis=1)
    row = int(np.argmax(np.nan_to_num(best)))
    if not best[row] > 1:
        return []
    near = np.fmax.reduce(score[max(0, row - WINDOW) : row + WINDOW + 1])
    first = index[row] - SIDE * BIN
    begin, end = (first + k for k in rise(left[first : first + 2 * SIDE * BIN, np.nanargmax(score[row])]))
    found = change("lasting", t, begin, end, best[row], [c for c in np.argsort(-near) if near[c] > 1])
    return lasting(t[:begin], left[:begin]) + [found] + lasting(t[end:], left[end:])


# ---- jolts ---------------------------------------------------------------------------------------


@functools.cache
def jolt_factor(count):
    """How many quartile distances above their median the largest of `count` values of Gumbel's distribution lies at most."""
    draws = np.random.default_rng(0).gumbel(size=(DRAWS, count))
    low, middle, high = np.quantile(draws, (0.25, 0.5, 0.75), axis=1)
    return np.quantile((draws.max(axis=1) - middle) / (high - low), 1 - JOLT_ALARMS)


def jolt_score(left):
    """(score (K - 1), channels in units of their usual size (K - 1, n)) of each two steps; a score above 1 is a jolt.

    The largest of each second are Gumbel's where tails are exponential; where they are lighter, alarms are fewer.
    """
    pairs = means(left, JOLT)
    pairs -= np.nanmedian(pairs, axis=0)
    each = pairs / spread(np.abs(pairs))
    size = np.sqrt((each**2).sum(axis=1))
    largest = np.fmax.reduce(size[: len(size) // SECOND * SECOND].reshape(-1, SECOND), axis=1)
    largest = largest[np.isfinite(largest)]
    low, middle, high = np.quantile(largest, (0.25, 0.5, 0.75))
    score = size / (middle + jolt_factor(len(largest)) * (high - low))
    score[: SIDE * BIN] = score[-SIDE * BIN :] = np.nan
    return score, each


def jolts(t, left):
    """Jolts; those less than a second apart are one."""
    score, each = jolt_score(left)
    above, found = np.flatnonzero(score > 1), []
    for rows in np.split(above, np.flatnonzero(np.diff(above) > SECOND) + 1):
        if len(rows):
            peak = rows[np.argmax(score[rows])]
            size = np.abs(each[peak])
            found.append(
                change("jolt", t, rows[0], rows[-1] + JOLT - 1, score[peak], [c for c in np.argsort(-size) if 2 * size[c] >= size.max()])
            )
    return found


# ---- both ----------------------------------------------------------------------------------------


def changes(log, platform):
    """When the log's innovations change, in the order of time: a list of what change() makes.

    A jolt that goes with a lasting change is not listed again.
    """
    if platform != "fwmav":
        raise UserError("changes are looked for in logs of the flapping wing; for other robots use `tinykoop diagnose`")
    found, margin = lasting(*innovations(log, "lasting")), WINDOW * BIN * STEP
    short = jolts(*innovations(log, "jolt"))
    found += [j for j in short if not any(c["from"] - margin < j["time"] < c["to"] + margin for c in found)]
    return sorted(found, key=lambda c: c["time"])


WORDS = {"lasting": "permanent change", "jolt": "a jolt"}


def run(path, out, platform=None):
    """Writes changes_STEM.json and its plot into `out`, prints a line for each change; returns the changes."""
    out = output_folder(out)
    log, platform = replay.load(path, platform)
    try:
        found = changes(log, platform)
    except UserError as error:
        raise UserError(f"{path}: {error}")
    t, left = innovations(log, "lasting")
    index, score = lasting_score(left)
    scores = {"lasting": (t[index], np.fmax.reduce(score, axis=1)), "jolt": (t[1:], jolt_score(innovations(log, "jolt")[1])[0])}
    largest = {kind: float(np.nanmax(values, initial=0)) for kind, (_, values) in scores.items()}
    stem = Path(path).stem
    with replacing(out / f"changes_{stem}.json", {"changes": found, "largest_score": largest}):
        draw(out, stem, found, t, left, score, scores)
    for c in found:
        when, where = f"{c['time']:.1f} s ({c['from']:.1f} to {c['to']:.1f} s)", ", ".join(c["channels"])
        print(f"{when}: {WORDS[c['kind']]}, {c['strength']:.1f} thresholds, in {where}")
    if not found:
        print(f"no change: at most {largest['lasting']:.2f} of the threshold of a lasting one, {largest['jolt']:.2f} of a jolt's")
    return found


def draw(out, stem, found, t, left, score, scores):
    """Innovations of the channels that moved, or came nearest to it, and the two scores."""
    strongest = max(found, key=lambda c: c["strength"], default=None)
    names = [name for name, _ in transfer.CHANNELS]
    shown = [names.index(name) for name in strongest["channels"]] if strongest else np.argsort(-np.nanmax(score, axis=0))
    shown = shown[:3]
    figure, axes = plots.subplots(len(shown) + 1, 1, figsize=(10, 2 + 1.6 * len(shown)), sharex=True)
    title = f"{WORDS[strongest['kind']]} at {strongest['time']:.1f} s, most in {strongest['channels'][0]}" if strongest else "no change"
    if len(found) > 1:
        title = f"{len(found)} changes, the strongest: {title}"
    figure.suptitle(f"{printable(stem)}: {title}", x=0.01, ha="left")
    for ax, c in zip(axes, shown):
        name, unit = transfer.CHANNELS[c]
        ax.plot(t, left[:, c], color="0.75", lw=0.7, label="innovations, mean over 0.1 s")
        ax.plot(
            t[: 1 - WINDOW * BIN] + WINDOW * BIN * (t[1] - t[0]) / 2, means(left, WINDOW * BIN)[:, c], color="k", lw=1.2, label="over 3 s"
        )
        ax.set_ylabel(f"{name} ({unit})")
    axes[0].legend(ncols=2, loc="upper right")
    (t_lasting, s_lasting), (t_jolt, s_jolt) = scores["lasting"], scores["jolt"]
    axes[-1].plot(t_jolt, s_jolt, color="0.6", lw=0.8, label="jolt")
    axes[-1].plot(t_lasting, np.maximum(s_lasting, 0), color="k", lw=1.5, label="lasting change")
    axes[-1].axhline(1, color="k", lw=0.8, ls="--", label="threshold")
    axes[-1].set_ylim(0)
    axes[-1].set_ylabel("score (thresholds)")
    axes[-1].set_xlabel("time (s)")
    axes[-1].legend(ncols=3, loc="upper right")
    for ax in axes:
        for c in found:
            ax.axvspan(c["from"], c["to"], color="0.88", zorder=0)
            ax.axvline(c["time"], color="k", lw=0.8, ls=":")
    plots.save(figure, out / f"changes_{stem}.png")
