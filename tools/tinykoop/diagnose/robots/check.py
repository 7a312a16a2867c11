"""Whether a log can be what a robot's file says: units, signs, wrapping, order and timing of its columns.

Each thing that is often wrong is undone on some windows of the log. Where the simulator then follows it much better, that is
said, with what to write instead.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...plumbing.errors import UserError
from ...plumbing.results import print_table
from ..platforms.own import extras, links, told_links
from ..platforms.own.path import Path
from ..prediction_errors import ahead, spans
from ..prediction_errors import noise as noises
from ..prediction_errors.fit import Cause, Fitter
from ..report.terminal import say
from ..report.words import capital, size_of
from ..robot import RunsAway
from . import toml
from .library import preference
from .log import noise as noise_of

ROWS = 8  # of a window that is looked at
WINDOWS = 4, 12  # in which each mistake is looked for, and then those that may be one
BETTER = 5.0  # times smaller a misfit, from which on a mistake is named
TURN = 2 * np.pi
FASTEST, SLOWEST = 1e-5, 1.0  # s between rows, that a log may have whose time is in another unit
NOTABLE, NEAR = 0.05, 1.5  # of the noise: a gain by shifted rows that is said, and what it must come down to
ANSWERS = 0.2  # correlation, below which a state does not do what it is asked
ALIKE = 0.98  # cosine of what two effects do, from which on they are the same
JITTER = 0.2  # of the usual step, by which single steps may differ


@dataclass(frozen=True)
class Finding:
    """`wrong`: cannot be right, so nothing is diagnosed with it."""

    text: str
    remedy: str
    wrong: bool = True


def _part(log, count):
    """Windows of the log that are evenly spread over it, with nothing between them."""
    K = len(log.t)
    firsts = np.linspace(0, K - 1 - ROWS, min(count, (K - 1) // ROWS)).astype(int)
    rows = (firsts[:, None] + np.arange(ROWS + 1)).ravel()
    usable = np.append(log.usable, False)[rows]
    usable[ROWS :: ROWS + 1] = False
    t = np.arange(len(rows)) * log.dt
    return replace(log, t=t, x=log.x[rows], u=log.u[rows], y=log.y[rows], usable=usable[:-1])


def misfit(robot, log, sigma, count):
    """Mean square of what the simulator misses of a part of the log, over the noise of the log; infinite where it runs away."""
    part = _part(log, count)
    with np.errstate(all="ignore"):
        try:
            path = Path(robot, part)
        except RunsAway:
            return np.inf
        cost = _quiet(path, sigma).fit_of(()).cost
    free = np.isfinite(path.present).sum() - (path.begins != 0).sum() * len(robot.states)
    return cost / max(free, 1) if np.isfinite(cost) else np.inf


def _quiet(path, sigma):
    """The Fitter by what the sensors alone would make."""
    return Fitter(path, replace(noises.first(path), sensor=np.maximum(sigma, path.finest)))


def _state(log, robot, i, change):
    """The log with state i changed, in the states and in the channels."""
    x, y = log.x.copy(), log.y.copy()
    x[:, i] = change(x[:, i])
    y[:, robot.measured.index(i)] = x[:, i]
    return replace(log, x=x, y=y)


def _swapped(log, robot, i, j):
    x, y = log.x.copy(), log.y.copy()
    x[:, [i, j]] = x[:, [j, i]]
    at = [robot.measured.index(k) for k in (i, j)]
    y[:, at] = y[:, at[::-1]]
    return replace(log, x=x, y=y)


def _command(log, change):
    return replace(log, u=change(log.u.copy()))


def _scaled(u, j, factor):
    u[:, j] *= factor
    return u


def _shifted(u, rows):
    return np.concatenate([np.repeat(u[:1], rows, 0), u[:-rows]]) if rows > 0 else np.concatenate([u[-rows:], np.repeat(u[-1:], -rows, 0)])


def mistakes(robot, log):
    """(what is wrong, remedy, the log without it) of all that is often wrong."""
    for factor, unit in ((1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"), (60.0, "min")):
        if FASTEST < log.dt * factor < SLOWEST:
            yield (
                f"time is in {unit}",
                f'time = {{column = "{robot.time.column}", unit = "{unit}"}}',
                replace(log, t=log.t * factor, dt=log.dt * factor),
            )
    for i in robot.measured:
        s = robot.states[i]
        if s.unit == "rad":
            yield f"{s.name} is in degrees", f'{s.name}: unit = "deg"', _state(log, robot, i, np.radians)
            yield f"{s.name} is in radians already", f'{s.name}: unit = "rad"', _state(log, robot, i, np.degrees)
        if s.unit == "m":
            yield f"{s.name} is in millimetres", f'{s.name}: unit = "mm"', _state(log, robot, i, lambda v: v * 1e-3)
        yield f"{s.name} has the other sign", f"{s.name}: factor = {turned(s)}", _state(log, robot, i, np.negative)
        for j in robot.measured:
            if i < j and robot.states[j].unit == s.unit:
                yield (
                    f"{s.name} and {robot.states[j].name} are swapped",
                    f"swap the columns {s.column} and {robot.states[j].column}",
                    _swapped(log, robot, i, j),
                )
    for j, c in enumerate(robot.commands):
        yield f"{c.name} has the other sign", f"{c.name}: factor = {turned(c)}", _command(log, lambda u, j=j: _scaled(u, j, -1.0))
        if c.unit in ("rad", "rad/s"):
            yield (
                f"{c.name} is in degrees",
                f'{c.name}: unit = "{"deg" if c.unit == "rad" else "deg/s"}"',
                _command(log, lambda u, j=j: _scaled(u, j, np.pi / 180)),
            )
        for i in range(j):
            other = robot.commands[i]
            yield (
                f"{other.name} and {c.name} are swapped",
                f"swap the columns {other.column} and {c.column}",
                _command(log, lambda u, i=i, j=j: _swap(u, i, j)),
            )


def turned(signal):
    """A factor that turns the sign."""
    return -1 if signal.scale > 0 else 1


def _swap(u, i, j):
    u[:, [i, j]] = u[:, [j, i]]
    return u


def _late(path):
    """Whether the commands fit better one row earlier or later, down to the noise."""
    fitter, degrees = _quiet(path, noise_of(path.log, path.robot)), np.isfinite(path.present).sum()
    shifted = {shift: replace(path.at, u=_shifted(path.at.u, shift)) for shift in (0, 1, -1)}
    cost = dict.fromkeys(shifted, np.inf)
    for variant in range(len(path.variants)):  # a step of time that is too long is not late
        path.step_by(variant)
        left = fitter.whiten(*path.changed(list(shifted.values())))
        cost = {shift: min(cost[shift], size) for shift, size in zip(shifted, (left**2).sum(0))}
    path.step_by(0)
    best = min(cost, key=cost.get)
    if best and cost[0] - cost[best] > max(NOTABLE * degrees, 0.5 * (cost[0] - degrees)) and cost[best] < NEAR * degrees:
        when, way = ("early: each acts from the next row on", "down") if best > 0 else ("late: each has acted before", "up")
        yield Finding(
            f"commands stand one row too {when}", f"shift the command columns {way} by one row, unless the robot is that slow", False
        )


def _deaf(path):
    """States that do not move as the commands ask."""
    robot, sigma, h = path.robot, noise_of(path.log, path.robot), (ahead.HORIZONS[-1],)
    starts = ahead.starts_of(path)
    missed = path.ahead((), starts, h)[:, 0]
    for c, i in enumerate(robot.measured):
        seen = path.measured[np.minimum(starts + h[0], len(path.rows) - 1), c] - path.measured[starts, c]
        asked = seen - missed[:, c]
        good = np.isfinite(asked)
        if (
            good.sum() > 8
            and np.ptp(seen[good]) > 0
            and np.median(np.abs(asked[good])) > 5 * sigma[c]
            and abs(np.corrcoef(asked[good], seen[good])[0, 1]) < ANSWERS
        ):
            yield Finding(
                f"{robot.states[i].name} does not answer the commands as the simulator says",
                f"check column {robot.states[i].column}, its rows against those of the commands, and the simulator",
            )


def _wrapping(robot, log):
    for i in robot.measured:
        signal, steps = robot.states[i], np.abs(np.diff(log.x[:, i]))
        steps = steps[np.isfinite(steps)]
        jumps = np.abs(steps - TURN) < 0.1 * TURN
        if signal.unit == "rad" and not signal.wraps and jumps.any() and np.median(steps) < 0.1 * TURN:
            yield Finding(f"{signal.name} jumps by a turn between rows", f"{signal.name}: wraps = true")
        if signal.wraps and signal.unit != "rad":
            yield Finding(f"{signal.name} wraps, but its unit is {signal.unit}", f'{signal.name}: unit = "rad" or "deg"')


def _dead(robot, log):
    for i in robot.measured:
        if not np.nanmax(log.x[:, i]) > np.nanmin(log.x[:, i]):
            yield Finding(
                f"{robot.states[i].name} never changes",
                f"check column {robot.states[i].column}: record a run in which the robot moves",
                False,
            )
    for j, c in enumerate(robot.commands):
        if not np.ptp(log.u[:, j]) > 0:
            yield Finding(f"{c.name} never changes", "nothing can be said of its effects; record a run in which it does", False)


def _sampling(log):
    steps = np.diff(log.t)
    if np.std(steps[np.abs(steps / log.dt - 1) < 0.5]) > JITTER * log.dt:
        yield Finding(f"rows come at unequal times (usual step {log.dt:.4g} s)", "resample the log to equal steps", False)


def mistaken(robot, log):
    """Findings in the columns of a log, and on some short windows of it."""
    found = [*_wrapping(robot, log), *_dead(robot, log), *_sampling(log)]
    if any(f.text.endswith("never changes") for f in found):
        return found
    sigma, left = noise_of(log, robot), list(mistakes(robot, log))
    for windows in WINDOWS:
        base, size = misfit(robot, log, sigma, windows), []
        if base < 1:
            return found
        for text, _, mended in left:
            own = noise_of(mended, robot)
            size.append(misfit(robot, mended, own, windows) * (1.0 if "swapped" in text else float(np.mean(own**2 / sigma**2))))
        order = [i for i in np.argsort(size) if size[i] * BETTER < base]
        left = [left[i] for i in order]
    return found + [Finding(text, remedy) for text, remedy, _ in left[:1]]


def along(path):
    """Findings of a whole log."""
    return [*_deaf(path), *_late(path)]


def refuse(findings, log, robot):
    """Raises where a log cannot be what the robot's file says."""
    wrong = [f for f in findings if f.wrong]
    if wrong:
        raise UserError(f"{log.path}: it looks as if {wrong[0].text}; in {robot.file}: {wrong[0].remedy} (tinykoop robot check tells more)")


def run(robot_file, log_file, sim=None):
    """Prints what looks wrong, how far the simulator is off, and which effects this log cannot distinguish; 2 where it cannot be right."""
    given = extras.read(*toml.read_both(robot_file, log_file, sim))
    robot, log = given.robot, given.log
    say(f"{robot.name}: {len(log.t)} rows, {log.t[-1] - log.t[0]:.4g} s at {1 / log.dt:.4g} Hz", "bold")
    for said in links.uses(given):
        say(f"  {said}")
    dead = links.dead_link(given)
    for said in (*given.ignored, *([capital(told_links.fault({"link": dead}))] if dead else ())):
        say(f"  look: {said}")
    if not dead:  # else nothing can be said of the simulator
        _compare(robot, log, log_file)


def _compare(robot, log, log_file):
    """Prints how the log compares with the simulator."""
    found = mistaken(robot, log)
    path = None if any(f.wrong for f in found) else Path(robot, log)
    found += along(path) if path else []
    for finding in found:
        say(f"  {'WRONG' if finding.wrong else 'look'}: {finding.text}. {finding.remedy}")
    if any(f.wrong for f in found):
        raise UserError(f"{log_file}: cannot be a log of {robot.name} as {robot.file} has it")
    starts = ahead.starts_of(path)
    errors, floor = ahead.errors(path, (), starts), ahead.floor(path, noises.first(path), starts)
    rows = [
        (name, *(size_of(unit)(v) for v in ahead.rms(errors[name])), size_of(unit)(ahead.rms(floor[name])[-1]))
        for name, (unit, _) in path.gaps.items()
    ]
    print_table("The simulator as it is", ("gap", *(f"{h} ahead" for h in ahead.HORIZONS), "noise"), rows)
    classes = alike(path)
    if classes:
        say("This log cannot distinguish:", "bold")
        for names in classes:
            say(f"  {', '.join(names)}")


def alike(path):
    """[names of effects whose columns are the same], from the preferred name on."""
    trials = [(Cause(name, tuple(p.usual for p in effect.parameters)),) for name, effect in path.effects.items()]
    columns = _quiet(path, noise_of(path.log, path.robot)).whiten(*spans.beside(path, (), trials))
    size = np.linalg.norm(columns, axis=0)
    names, unit = [name for name, s in zip(path.effects, size) if s > 1], columns[:, size > 1] / size[size > 1]
    close, out, left = np.abs(unit.T @ unit) > ALIKE, [], set(range(len(names)))
    while left:
        i = min(left)
        group = [j for j in left if close[i, j]]
        left -= set(group)
        if len(group) > 1:
            out.append(sorted((names[j] for j in group), key=preference))
    return out
