"""The CSV of a robot: its columns as the robot's signals, in its units."""

import csv

import numpy as np

from ...plumbing.errors import UserError
from .. import elsewhere
from ..prediction_errors.noise import white
from ..robot import RobotLog

FEWEST = 60  # usable transitions
GAP = 1.5  # times the usual step of time, from which on rows are missing


def _columns(path):
    try:
        with open(path, newline="", encoding="utf-8", errors="replace") as file:
            lines = list(csv.reader(file))
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    if len(lines) < 2:
        raise UserError(f"{path}: has no rows; the first line names the columns, each other one is a row")
    return [name.strip() for name in lines[0]], lines[1:]


def _number(text, path, line, column):
    if not text.strip():
        return np.nan
    try:
        return float(text)
    except ValueError:
        raise UserError(
            f"{path}:{line}: {column}: {text.strip()[:40]} is not a number; leave the cell empty if the value is missing"
        ) from None


def read(path, robot):
    """The RobotLog of a file."""
    names, rows = _columns(path)
    wanted = [robot.time, *robot.states, *robot.commands, *robot.outputs]
    for signal in wanted:
        if signal.column and signal.column not in names:
            raise UserError(f"{path}: has no column {signal.column}, which {robot.name} needs for {signal.name}; it has {', '.join(names)}")
    values = {}
    for signal in wanted:
        at = names.index(signal.column) if signal.column else None
        cells = (
            [_number(row[at], path, i + 2, signal.column) if at < len(row) else np.nan for i, row in enumerate(rows)]
            if signal.column
            else [np.nan] * len(rows)
        )
        values[signal.name] = np.array(cells) * signal.scale
    return _log(path, robot, values)


def _log(path, robot, values):
    t = values[robot.time.name]
    step = np.diff(t)
    if not np.isfinite(t).all() or not (step > 0).all():
        row = int(np.argmin(np.r_[True, step > 0])) if np.isfinite(t).all() else int(np.argmin(np.isfinite(t)))
        raise UserError(f"{path}:{row + 2}: every row needs a time, and time must increase; sort the log, or remove the row")
    dt = float(np.median(step))
    x = np.stack([values[s.name] for s in robot.states], 1)
    u = np.stack([values[s.name] for s in robot.commands], 1)
    y = np.stack([values[s.name] for s in robot.channels], 1)
    usable = (step < GAP * dt) & (step > dt / GAP) & np.isfinite(u[:-1]).all(1)
    if usable.sum() < FEWEST:
        raise UserError(f"{path}: {int(usable.sum())} usable transitions are too few for a diagnosis; record {FEWEST} at least")
    return RobotLog(t, x, np.nan_to_num(u), y, usable, dt, str(path))


def continued(values, wraps):
    """Without what is missing, in a line between what is there, and without jumps by a turn."""
    seen = np.isfinite(values)
    if not seen.any():
        return np.zeros(len(values))
    there = np.unwrap(values[seen]) if wraps else values[seen]
    return np.interp(np.arange(len(values)), np.flatnonzero(seen), there)


def windows(usable, rows):
    """First rows (W,) of windows of `rows` usable transitions in a row."""
    starts, run = [], 0
    for k, good in enumerate(usable):
        run = run + 1 if good else 0
        if run and run % rows == 0:
            starts.append(k + 1 - rows)
    return np.array(starts, int)


def noise(log, robot):
    """Standard deviations (c,) of the channels' white noise, at most."""
    measured = np.stack([continued(y, c.wraps) for y, c in zip(log.y.T, robot.channels)], 1)
    whole = log.usable[:-2] & log.usable[1:-1] & log.usable[2:]
    return np.maximum(white(measured, whole), 1e-6 * np.abs(measured).max(0))


def joined(logs):
    """Several RobotLogs one after the other, with no transition between them."""
    t, end = [], 0.0
    for log in logs:
        t.append(log.t - log.t[0] + end)
        end = t[-1][-1] + log.dt
    (x, u, y), usable = elsewhere.joined(logs, "xuy")
    return RobotLog(np.concatenate(t), x, u, y, usable, logs[0].dt, ", ".join(log.path for log in logs))
