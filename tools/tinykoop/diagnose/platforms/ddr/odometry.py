"""What a drive's own sensors say of its motion: optional columns of the log, as the mean speed of each step of time."""

from dataclasses import dataclass, replace

import numpy as np

from .... import bridge
from . import traction

WHEELS, GYRO = ("v_odo", "omega_odo"), ("omega_imu",)
COLUMNS = (*WHEELS, *GYRO)
FEWEST = 0.5  # share of the usable transitions, in which a column must have numbers
LARGEST = 1e4  # m/s or rad/s: no speed of a robot is beyond, as in the log reader


@dataclass(frozen=True)
class Speeds:
    """Mean speeds (K, 2) of the steps of time, v and omega, and the transitions (K - 1,) in which they are known."""

    u: np.ndarray
    usable: np.ndarray


def read(log):
    """({"wheels", "gyro": Speeds} of those that the log has and that can be true, sentences about those that it has not)."""
    moved = motion(log)
    found, ignored = {}, []
    for kind, names, fault in (("wheels", WHEELS, _wheel_fault), ("gyro", GYRO, _gyro_fault)):
        speeds, said = _speeds(log, names, moved)
        said = said or (fault(log, speeds, moved) if speeds else "")
        if said:
            ignored.append(said)
        elif speeds:
            found[kind] = speeds
    return found, ignored


def motion(log):
    """Speeds (K, 2) along the robot and of its heading that the pose shows from row to row; zero where it is not known."""
    return np.vstack([traction.steps(log) / log.dt, np.zeros(2)])


def _speeds(log, names, moved):
    """(Speeds of columns or None, what is wrong with them)."""
    there = [name for name in names if name in log.extra]
    if not there:
        return None, ""
    if len(there) < len(names):
        missing = next(name for name in names if name not in there)
        return None, f"Column {there[0]} is not used, because there is no column {missing}: the motion of the wheels takes both."
    values = np.stack([log.extra[name] for name in names], 1)
    values[~(np.abs(values) <= LARGEST)] = np.nan
    known = np.isfinite(values).all(1)
    usable = log.usable & known[:-1] & known[1:]
    if usable.sum() < FEWEST * log.usable.sum():
        share = 100 * usable.sum() / max(log.usable.sum(), 1)
        return None, f"{_columns(names)} not used: only {share:.0f} % of the usable rows have numbers there."
    return Speeds(_of_steps(_filled(values, known), moved[:, 2 - len(names) :]), usable), ""


def _filled(values, known):
    """Without what is missing, in a line between what is there."""
    rows = np.arange(len(values))
    return np.stack([np.interp(rows, rows[known], column[known]) for column in values.T], 1)


def _of_steps(values, moved):
    """Mean speeds (K, 2) of the steps, from speeds (K, c) that were read in the middle of a step, at its begin or at its end.

    A log does not say which, and half a step of time looks like a delay. The one that goes best with the pose is taken.
    """
    after = np.vstack([values[1:], values[-1:]])
    best = max(((values + after) / 2, values, after), key=lambda speeds: _agreement(speeds, moved))
    return best if best.shape[1] == 2 else np.column_stack([np.zeros(len(best)), best])


def _agreement(speeds, moved):
    """Sum of squared correlations of the columns, without their means taken off."""
    squares = (speeds**2).sum(0) * (moved**2).sum(0)
    return float(((speeds * moved).sum(0) ** 2 / np.where(squares > 0, squares, np.inf)).sum())


def _wheel_fault(log, speeds, moved):
    """That the wheels do not show the motion of a robot that moves: then the columns are wrong, not the wheels."""
    if not traction.dead(replace(log, x=integrated(log, speeds), usable=speeds.usable), log.u):
        return ""
    return "" if traction.dead(log, log.u) else f"{_columns(WHEELS)} not used: they do not answer the commands, but the robot moves."


def _gyro_fault(log, speeds, moved):
    if np.ptp(speeds.u[:, 1]) == 0:
        return f"{_columns(GYRO)} not used: it is constant."
    turned = replace(log, x=integrated(log, speeds), usable=speeds.usable)
    dead = traction.dead(turned, moved * (0.0, 1.0))
    return f"{_columns(GYRO)} not used: it does not show the turns that the pose shows." if dead else ""


def integrated(log, speeds, integrator=bridge.ARC):
    """Poses (K, 3) of a robot that moves at these speeds."""
    return bridge.simulate(speeds.u[:-1], log.dt, integrator=integrator)


def _columns(names):
    return f"Column {names[0]} is" if len(names) == 1 else f"Columns {' and '.join(names)} are"
