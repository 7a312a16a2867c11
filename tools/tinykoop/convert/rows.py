"""Uniform rows: states interpolated, commands held, gaps and doubtful poses marked."""

from dataclasses import dataclass

import numpy as np

from ..platforms import COMMANDS
from ..plumbing.errors import UserError
from .choose import ANGLES
from .log import Series
from .motors import MOTORS

FEW = 3.5  # a state that is silent for more than this many of its periods leaves a gap
BACK = 1.0  # s: samples out of order by up to this are put in order; more is a clock that was set back
SILENT = 1.0, 10  # s, periods: a command held for longer than both is worth a word
MOST_ROWS = 100  # rows for each sample of the slowest state; more are a wrong time stamp, or a wrong --rate
SAME = 1e-6  # of a step: times nearer than this are one
BEYOND = 0.01  # of full thrust: a request outside 0 to 1 by more than this is in another unit


class Untrusted(UserError):
    """A field without samples that can be used."""


@dataclass
class Table:
    """Rows as they are written."""

    t: np.ndarray
    columns: dict
    seg: np.ndarray
    pose_ok: np.ndarray
    rate: float
    rates: dict  # column: samples a second of its source
    notes: list


def resample(log, chosen, rate=None, optional=()):
    """Table of the chosen fields of a log; optional columns without usable samples are left out."""
    given = {name for column in COMMANDS if chosen.get(column) for name in chosen[column].names}
    raw = log.read({name for source in chosen.values() if source for name in source.names}, given)
    series, notes = usable(log, chosen, raw, optional)
    states = {c: s for c, s in series.items() if c not in COMMANDS}
    if not states:
        raise UserError(f"{log.path}: has commands only; log at least one of {', '.join(c for c in optional if c not in COMMANDS)}")
    periods = {c: float(np.median(np.diff(s.t))) if len(s.t) > 1 else np.inf for c, s in series.items()}
    t, step = grid(log, series, states, periods, rate)
    found = {c: holes(s, t, step, periods[c]) for c, s in states.items()}
    columns = {c: interpolate(s, t, c in ANGLES) for c, s in states.items()}
    keep = ~np.any([hole.inside for hole in found.values()], axis=0)
    gaps = np.concatenate([hole.gaps for hole in found.values()])
    for column in (c for c in series if c not in states):
        times = series[column].t
        index = np.searchsorted(times, t + SAME * step, side="right") - 1
        columns[column] = series[column].x[index]
        keep &= ~unknown(times[index], t + SAME * step, gaps)
        silent = np.max((t - times[index])[keep], initial=0)
        if silent > max(SILENT[0], SILENT[1] * periods[column] if np.isfinite(periods[column]) else 0):
            notes.append(f"{column} was silent for up to {silent:.1f} s and is taken as held: check that the robot did so.")
    if "yaw_rate" in chosen and not chosen["yaw_rate"]:
        columns["yaw_rate"] = yaw_rate(columns)
    if keep.sum() < 3:
        raise UserError(f"{log.path}: only {int(keep.sum())} rows have both state and command, at least 3 are needed")
    if not keep.all():
        notes.append(f"Rows left out in gaps: {int((~keep).sum()):,}.")
    breaks = np.sort(np.concatenate([hole.breaks for hole in found.values()]))
    return Table(
        t=(t - t[keep][0])[keep],
        columns={c: x[keep] for c, x in columns.items()},
        seg=np.unique(np.searchsorted(breaks, t + SAME * step, side="right")[keep], return_inverse=True)[1],
        pose_ok=np.all([hole.trusted for hole in found.values()], axis=0)[keep],
        rate=1 / step,
        rates={c: 1 / period for c, period in periods.items()},
        notes=notes,
    )


# ---- samples -----------------------------------------------------------------------------------------


def usable(log, chosen, raw, optional):
    """({column: Series}, notes)."""
    series, notes = {}, list(log.notes)
    for column, source in ((c, source) for c, source in chosen.items() if source):
        try:
            series[column] = tidy(log, column, source, raw)
        except Untrusted:
            if column not in optional:
                raise
            notes.append(f"{column} is left out: {source.label} has no samples to be trusted.")
    return series, notes


def tidy(log, column, source, raw):
    """One Series of a column: quaternion to angle, in order of time, one sample for each time."""
    parts, command = [raw[name] for name in source.names], column in COMMANDS
    first = parts[0]
    if not all(np.array_equal(part.t, first.t, equal_nan=True) for part in parts):
        raise UserError(f"{log.path}: the four parts of {source.label} were not logged together; log them in one block")
    x = angle(column, *(part.x for part in parts)) if len(parts) == 4 else first.x
    x = source.factor * (log.thrust(source.names[0], first) if column in MOTORS else x)
    good = np.isfinite(x) & np.isfinite(first.t)
    trusted = good if first.trusted is None else good & first.trusted
    # A command that is no number says nothing; of a state it says that there was one, not to be trusted.
    at = np.flatnonzero(good if command else np.isfinite(first.t))
    back = np.maximum.accumulate(first.t[at]) - first.t[at]
    if np.max(back, initial=0) > BACK:
        worst = int(np.argmax(back))
        raise UserError(
            f"{log.path}: the time of {source.label} goes back by {back[worst]:.3f} s at its sample {at[worst] + 1}: "
            "two recordings in one; split them there"
        )
    at = at[np.argsort(first.t[at], kind="stable")]
    at = at[np.append(np.diff(first.t[at]) > 0, True)[: len(at)]]  # of equal stamps the last counts
    if len(at) < (1 if command else 2) or not (command or trusted[at].any()):
        raise Untrusted(
            f"{log.path}: {source.label} for {column} has {int(trusted[at].sum())} samples to be trusted; "
            f"log it, or choose another with --map {column}={log.place}"
        )
    if column in MOTORS and not (-BEYOND <= x[at].min() and x[at].max() <= 1 + BEYOND):
        raise UserError(
            f"{log.path}: {source.label} for {column} is from {x[at].min():.6g} to {x[at].max():.6g}, but a thrust is from 0 to 1; "
            f"scale it with --map {column}={source.label}*FACTOR"
        )
    return Series(first.t[at], x[at], trusted[at], None if first.epoch is None else first.epoch[at])


def angle(column, w, x, y, z):
    """Roll, pitch or yaw of the rotation from body to world: yaw about z, then pitch about y, then roll about x."""
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = (np.where(norm > 1e-3, part / norm, np.nan) for part in (w, x, y, z))
        if column == "roll":
            return np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        if column == "pitch":
            return np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
        return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


# ---- rows --------------------------------------------------------------------------------------------


def grid(log, series, states, periods, rate):
    """(times of the rows, step): from where everything has begun, to where the first state ends."""
    begin, end = max(s.t[0] for s in series.values()), min(s.t[-1] for s in states.values())
    if end <= begin:
        spans = "; ".join(f"{c} {s.t[0]:.3f} to {s.t[-1]:.3f} s" for c, s in series.items())
        raise UserError(f"{log.path}: state and command are never there at the same time: {spans}")
    slowest = max(states, key=lambda c: round(periods[c], 6))
    step, samples = 1 / rate if rate else periods[slowest], states[slowest].t
    # A row falls on a sample of the slowest state, so that a uniform log is taken over as it is.
    begin = samples[np.searchsorted(samples, begin - SAME * step)]
    count = int((end - begin) / step + SAME) + 1
    if count > MOST_ROWS * len(samples):
        raise UserError(
            f"{log.path}: {count:,} rows from {begin:.3f} to {end:.3f} s at {1 / step:.6g} Hz are too many for "
            f"{len(samples):,} samples of {slowest}; check its time stamps, or give a lower --rate"
        )
    return begin + step * np.arange(count), step


def interpolate(s, t, turns):
    """Linear between trusted samples; angles the short way round, so that the seam at pi is no jump."""
    x = s.x[s.trusted]
    return np.interp(t, s.t[s.trusted], np.unwrap(x) if turns else x)


@dataclass
class Holes:
    """What a state leaves open."""

    inside: np.ndarray  # rows in a gap
    trusted: np.ndarray  # rows that lean on good samples only
    breaks: np.ndarray  # times where something new begins
    gaps: np.ndarray  # (n, 2) from, to


def holes(s, t, step, period):
    """Gaps, jumps of the estimate, and rows that lean on a sample that is not trusted."""
    left = np.clip(np.searchsorted(s.t, t + SAME * step, side="right") - 1, 0, len(s.t) - 2)
    on_left, on_right = t - s.t[left] <= SAME * step, s.t[left + 1] - t <= SAME * step
    between = ~on_left & ~on_right
    wide = np.diff(s.t) > FEW * period
    jump = np.zeros(len(wide), bool) if s.epoch is None else np.diff(s.epoch) != 0
    return Holes(
        inside=between & wide[left],
        trusted=(on_right | s.trusted[left]) & (on_left | s.trusted[left + 1]) & ~(between & jump[left]),
        breaks=s.t[1:][wide | jump],
        gaps=np.column_stack([s.t[:-1][wide], s.t[1:][wide]]),
    )


def unknown(given, t, gaps):
    """Rows after a gap whose command is from before it: who knows what was sent meanwhile."""
    if not len(gaps):
        return np.zeros(len(t), bool)
    gaps = gaps[np.argsort(gaps[:, 1])]
    began = np.maximum.accumulate(gaps[:, 0])
    last = np.searchsorted(gaps[:, 1], t, side="right") - 1
    return (last >= 0) & (given <= began[last])


def yaw_rate(columns):
    """Rate of the yaw angle, from body rates and attitude."""
    across = columns["gy"] * np.sin(columns["roll"]) + columns["gz"] * np.cos(columns["roll"])
    upright = np.cos(columns["pitch"])
    return across / np.where(np.abs(upright) < 0.01, 0.01, upright)
