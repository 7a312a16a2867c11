"""Columns that measure what actuators do: which can be used, and the mean of each over the steps of time."""

from dataclasses import dataclass, field, replace

import numpy as np

from ... import answers
from ...prediction_errors import noise as noises
from ...prediction_errors.fit import Fitter
from ...robot import Robot, RobotLog, RunsAway, Signal, Work
from ...robots import check
from ...robots.log import continued
from ...robots.log import noise as noise_of
from .path import Path

FEWEST = 0.5  # share of the usable transitions, in which a column must have numbers
SECONDS, WINDOWS = 1.0, 24  # of a window in which an answer is looked for, at most; in a log, if they are shorter
PLACES, TURNS, GROWN = 3, 2, 0.01  # where in a step a column may be read; turns of all; share by which an actuator is changed for a slope
DECIDED = 10.0  # squares, by which the motion must speak for a column's place in a step
PARTS = 12  # of the log, on which it is tried whether a column is what moves the robot


@dataclass(frozen=True)
class Actuator:
    """What channel c measures of what command j asks for: means (K,) over each step, and transitions (K - 1,) in which they are known."""

    signal: Signal
    j: int
    c: int
    u: np.ndarray = field(compare=False)
    usable: np.ndarray = field(compare=False)
    place: int = 0  # of means(), the one that is used


@dataclass(frozen=True)
class Extras:
    """robot, log: without channels that cannot be true; kept: indices of the others; ignored: sentences about what is not used."""

    robot: Robot
    log: RobotLog
    kept: list
    actuators: list
    ignored: list
    work: Work  # that was done beside the search of the whole log

    def of(self, log):
        """Another log of the robot, with the same columns; None of None."""
        if log is None:
            return None
        log = replace(log, y=log.y[:, self.kept])
        return _seen(log, [_known(log, actuator) for actuator in self.actuators])

    @property
    def dead(self):
        """The first Actuator that does not answer its command, or None."""
        return next((actuator for actuator in self.actuators if answers.dead([answer(self.log, actuator)])), None)


def read(robot, log):
    """The Extras of a log."""
    work, false, found, ignored = Work(), [], {}, []
    for c, signal, j in commanded(robot):
        actuator = _known(log, Actuator(signal, j, c, None, None))
        few = _few(log, actuator)
        wrong = "" if few else _fault(robot, log, actuator, work)
        ignored += [said for said in (few, wrong) if said]
        if wrong:
            false.append(c)
        elif not few:
            found.setdefault(j, actuator)
    kept = [c for c in range(len(robot.channels)) if c not in false]
    robot, log = without_outputs(robot, log, false)
    found = _placed(robot, log, [replace(a, c=kept.index(a.c)) for a in found.values()], work)
    return Extras(robot, _seen(log, found), kept, found, ignored, work)


def commanded(robot):
    """[(channel, output, command)] of the outputs that measure a command."""
    names = [signal.name for signal in robot.commands]
    return [(c, s, names.index(s.measures)) for c, s in enumerate(robot.channels) if s.measures in names]


def without_outputs(robot, log, channels):
    """(robot, log) without some of the outputs."""
    kept = [c for c in range(len(robot.channels)) if c not in channels]
    outputs = tuple(robot.channels[c] for c in kept if c >= len(robot.measured))
    return replace(robot, outputs=outputs), replace(log, y=log.y[:, kept])


# ---- what a column says --------------------------------------------------------------------------


def means(values):
    """Means (K,) over each step of values (K,) that were read in the rows, in the middle of a step, or at its end.

    A log does not say which, and half a step of time looks like a delay.
    """
    after = np.append(values[1:], values[-1])
    return (values + after) / 2, values, after


def _known(log, actuator):
    """The actuator with what its column says in a log."""
    values = log.y[:, actuator.c]
    known = np.isfinite(values)
    u = means(continued(values, actuator.signal.wraps))[actuator.place]
    return replace(actuator, u=u, usable=log.usable & known[:-1] & known[1:])


def _seen(log, actuators):
    """The log with the means over steps as readings of the actuators."""
    y = log.y.copy()
    for actuator in actuators:
        y[:, actuator.c] = np.where(np.isfinite(y[:, actuator.c]), actuator.u, np.nan)
    return replace(log, y=y)


def _few(log, actuator):
    """That a column has too few numbers, or nothing."""
    share = actuator.usable.sum() / max(log.usable.sum(), 1)
    few = f"Column {actuator.signal.column} makes no link: only {100 * share:.0f} % of the usable rows have numbers there."
    return few if share < FEWEST else ""


def window(log):
    """Rows of a window in which an answer is looked for."""
    return int(np.clip(log.usable.sum() // WINDOWS, 2, max(SECONDS / log.dt, 2)))


def answer(log, actuator):
    """What is known of the answer to a command: RMS of windows of the command and of the actuator, about their means, and so on."""
    n = window(log)
    starts = answers.windows(actuator.usable, n)
    into, out = (values[:-1] - values[:-1][actuator.usable].mean() for values in (log.u[:, actuator.j], actuator.u))
    into, out = (answers.sums(values, starts, n, answers.LAGS) / n for values in (into, out))
    noise = noises.white(actuator.u[:, None], log.usable[:-2] & log.usable[1:-1] & log.usable[2:])[0]
    return answers.axis(into, out[:, 0], noise / np.sqrt(2 * n))


def _fault(robot, log, actuator, work):
    """That a column is not what moves the robot: then the column is wrong, not the actuator."""
    command, column = robot.commands[actuator.j].name, actuator.signal.column
    sizes = []
    for some in ([], [actuator]):
        one, driven_log = driven(robot, log, some)
        sizes.append(check.misfit(one, replace(driven_log, work=work), noise_of(driven_log, one), PARTS))
    if answers.dead([answer(log, actuator)]) and sizes[1] > sizes[0]:
        return f"Column {column} is not used: it does not answer the command {command}, but the robot does."
    if sizes[1] > check.BETTER * max(sizes[0], 1.0):
        return f"Column {column} is not used: the simulator follows the log far better with the command {command}; check its unit and sign."
    return ""


# ---- what moves the robot ------------------------------------------------------------------------


def driven(robot, log, actuators):
    """(robot, log) under what actuators did instead of what commands asked for, without outputs that measure commands."""
    u, usable = log.u.copy(), log.usable.copy()
    for actuator in actuators:
        u[:, actuator.j], usable = actuator.u, usable & actuator.usable
    acting = tuple((name, params) for old, params in robot.acting for name in in_motion(robot, actuators, old))
    plain, log = without_outputs(replace(robot, acting=acting), log, [c for c, _, _ in commanded(robot)])
    return plain, replace(log, u=u, usable=usable, work=Work())


def in_motion(robot, actuators, name):
    """Names of an effect of the whole robot between actuators and motion: those at a measured command are not there."""
    kind, _, signal = name.partition(":")
    measured = [robot.commands[a.j].name for a in actuators]
    if signal == "all" and actuators:
        return [f"{kind}:{c.name}" for c in robot.commands if c.name not in measured]
    sensors = [output.name for _, output, _ in commanded(robot)]
    return [] if signal.partition("<-")[0] in (*measured, *sensors) else [name]


def at_actuator(robot, actuator, name):
    """Names of an effect of the whole robot between a command and its actuator: none if it is not at that command."""
    kind, _, signal = name.partition(":")
    command = robot.commands[actuator.j].name
    if signal == "all":
        return [f"{kind}:{command}"]
    return [name] if signal.partition("<-")[0] == command else []


def _placed(robot, log, actuators, work):
    """Actuators with those of their means that go best with the motion; where it does not say, with those nearest to the commands."""
    if not actuators:
        return []
    plain, driven_log = driven(robot, log, actuators)
    try:
        path = Path(plain, replace(driven_log, work=work))
    except RunsAway:
        return actuators
    found = []
    for variant in range(len(path.variants)):  # a step of time that is too long is late, too
        path.step_by(variant)
        for place in range(PLACES):  # columns of one robot are often read alike
            found.append(_descended(path, log, [_known(log, replace(actuator, place=place)) for actuator in actuators]))
    return min(found, key=lambda one: one[0])[1]


def _descended(path, log, actuators):
    """(squares, actuators), each placed where the motion leaves least, in turns."""
    for _ in range(TURNS):
        for i, actuator in enumerate(actuators):
            trials = [[*actuators[:i], _known(log, replace(actuator, place=place)), *actuators[i + 1 :]] for place in range(PLACES)]
            costs = np.array([_cost(path, trial) for trial in trials])
            most = costs.min() + DECIDED * max(costs.min() / np.isfinite(path.present).sum(), 1.0)
            open_ = [trial for trial, cost in zip(trials, costs) if cost <= most]
            actuators = min(open_, key=lambda trial: _off(log, trial[i]))
    return _cost(path, actuators), actuators


def _off(log, actuator):
    """Squares by which an actuator misses its command."""
    return ((actuator.u - log.u[:, actuator.j])[:-1][actuator.usable] ** 2).sum()


def _cost(path, actuators):
    """Squares that the motion leaves under actuators, each times whatever number suits it."""
    u = np.repeat(path.at.u[None], 1 + len(actuators), 0)
    for i, actuator in enumerate(actuators):
        u[:, :, actuator.j] = actuator.u
        u[1 + i, :, actuator.j] = (1 + GROWN) * actuator.u
    left, *more = Fitter(path, noises.first(path)).whiten(*path.changed([replace(path.at, u=one) for one in u])).T
    slopes = np.stack(more, 1) - left[:, None]
    return float(((left - slopes @ np.linalg.lstsq(slopes, left, rcond=None)[0]) ** 2).sum())
