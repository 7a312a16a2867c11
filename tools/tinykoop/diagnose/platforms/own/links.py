"""The links of your own robot: from commands to the actuators that columns measure, from these to the motion, and on to other sensors.

Each is a log of its own, and is diagnosed as one. Up to an actuator, and behind the motion, it is that of a robot which does as it is told.
"""

from dataclasses import dataclass, replace

import numpy as np

from ... import answers, links
from ...prediction_errors import ahead
from ...prediction_errors import noise as noises
from ...prediction_errors.answer import Answer, answer
from ...robot import Gap, RunsAway, Work
from ...robots.log import continued
from ...robots.log import noise as noise_of
from . import extras
from .path import Path, short

MOTION, WHOLE = "actuators to motion", "commands to motion"
STATIC = ("gain", "bias")  # effects of a command that may be below its actuator, too: a linkage, a wheel's size


def to_actuator(robot, actuator):
    """The name of a link."""
    return f"{robot.commands[actuator.j].name} command to {actuator.signal.name}"


def to_sensor(robot, c, i):
    """The name of a link."""
    return f"{robot.states[i].name} to {robot.channels[c].name}"


def moving(given):
    """The name of the link that ends with the motion."""
    return MOTION if given.actuators else WHOLE


class LinkPath(Path):
    """The path of a link: of the effects that can act there. allowed(Wrap) tells which."""

    def __init__(self, robot, log, allowed, before=()):
        super().__init__(robot, log, before=before)
        self.effects = {name: effect for name, effect in self.effects.items() if allowed(effect)}


@dataclass(frozen=True)
class Follows:
    """The simulator of an actuator that does what command j asks for, or of a sensor that shows it."""

    j: int

    def step(self, x, u, dt, params):
        return u[:, [self.j]].copy()


class Stands:
    """The simulator of a robot that does not move."""

    def step(self, x, u, dt, params):
        return x.copy()


# ---- paths of links ------------------------------------------------------------------------------


def _following(robot, log, signal, commands, j, acting=()):
    """(robot, log) of one whose state `signal` is in each row what command j asked for in the step before; log: of that state."""
    shown = replace(signal, unit=commands[j].unit, measures=None)
    gaps = (Gap(shown.name, shown.unit, (shown.name,)),)
    one = replace(robot, states=(shown,), commands=commands, outputs=(), parameters=(), own=(), gaps=gaps, acting=acting)
    return replace(one, simulator=Follows(j)), replace(log, x=log.y, work=Work())


def _to_actuator(given, actuator, effects, before):
    """The path of the link from a command; effects: names of those that may act; before: Causes that belong to the simulator."""
    robot, log = given.robot, given.log
    known = np.where(np.append(actuator.usable, False), actuator.u, np.nan)
    log = replace(log, y=np.append(np.nan, known[:-1])[:, None])
    at = lambda name: extras.at_actuator(robot, actuator, name)  # noqa: E731
    acting = tuple((new, params) for name, params in robot.acting for new in at(name))
    causes = [replace(cause, name=new) for cause in before for new in at(cause.name)]
    one, log = _following(robot, log, actuator.signal, robot.commands, actuator.j, acting)
    return LinkPath(one, log, lambda e: e.block == "command" and e.name in effects and at(e.name) == [e.name], causes)


def _to_motion(given, effects, before):
    """The path of the link from the actuators."""
    robot, log = extras.driven(given.robot, given.log, given.actuators)
    at = lambda name: extras.in_motion(given.robot, given.actuators, name)  # noqa: E731
    causes = [replace(cause, name=new) for cause in before for new in at(cause.name)]
    return LinkPath(robot, log, lambda e: e.name in effects and (e.kind in STATIC or at(e.name) == [e.name]), causes)


def _to_sensor(robot, log, c, i, effects):
    """The path of the link from a state that a column shows to another sensor of it, channel c."""
    signal, state = robot.channels[c], robot.states[i]
    shown = continued(log.x[:, i], state.wraps)
    log = replace(log, u=np.append(shown[1:], shown[-1])[:, None], y=log.y[:, [c]])
    one, log = _following(robot, log, replace(signal, wraps=signal.wraps or state.wraps), (replace(state, wraps=False),), 0)
    return LinkPath(one, log, lambda e: e.block == "output" and e.name in effects)


def uses(given):
    """Sentences that say what each extra column is used for."""
    robot, names = given.robot, {a.c: to_actuator(given.robot, a) for a in given.actuators}
    names |= {c: to_sensor(robot, c, i) for c, i in sensed(robot)}
    inputs, more = {a.c for a in given.actuators}, f", and input of '{MOTION}'"
    for c, signal in enumerate(robot.channels):
        if signal.measures:
            link = f"link '{names[c]}'" if c in names else "compared with the simulator, no link"
            yield f"{signal.name} measures {signal.measures}: {link}{more if c in inputs else ''}"


def sensed(robot):
    """[(channel, state)] of outputs that measure a state which a column shows, too."""
    shown = {robot.states[i].name: i for i in robot.measured}
    return [(c, shown[s.measures]) for c, s in enumerate(robot.channels) if s.measures in shown]


# ---- the report ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Link:
    name: str
    answer: Answer


def answered(path, given):
    """[Link] of the whole log's path; given: the Extras of the log. Where noise hides what a link does, no effect is looked for."""
    starts, of, names, out = ahead.starts_of(path), next(iter(path.gaps)), tuple(path.effects), []
    parts, floor = _parts(path, starts, given, of), ahead.floor(path, noises.first(path), starts)[of]
    seen = [() if links.hidden(part, floor) else names for part in parts]
    for actuator, some in zip(given.actuators, seen):
        out.append(Link(to_actuator(given.robot, actuator), answer(_to_actuator(given, actuator, some, path.added))))
    if given.actuators:
        out.append(Link(MOTION, answer(_to_motion(given, seen[-1], path.added))))
        given.work.rows += out[-1].answer.path.log.work.rows
    for c, i in sensed(given.robot):
        out.append(Link(to_sensor(given.robot, c, i), answer(_to_sensor(given.robot, given.log, c, i, names))))
    return out


def causes(found, most):
    """Up to `most` causes of all Links, those nearest to the commands first, each once."""
    every = [cause for link in found for cause in link.answer.fit.causes]
    return tuple({cause.name: cause for cause in reversed(every)}.values())[::-1][:most]


def told(found, whole, given):
    """The `where.links` of the report: Links, beside the Answer to the whole log."""
    of = links.main(whole)
    parts, floor = _parts(whole.path, whole.starts, given, of), whole.floor[of]
    shares = [links.share(sum(parts), part, floor, i == len(parts) - 1) for i, part in enumerate(parts)]
    shares += [None] * (len(found) - len(shares))
    return [links.told(link.name, link.answer, of) | {"share": share} for link, share in zip(found, shares)]


def _parts(path, starts, given, of):
    """[vectors (S, H, c)] in the gap `of`, that predictions miss by each link to an actuator, and by the motion; these add up to what the commands miss."""
    action, axes = path.action(()), list(path.gaps[of][1])
    missed = [path.ahead((), starts, ahead.HORIZONS)]
    for actuator in given.actuators:
        action = _with(action, actuator)
        after = path.ahead_by(action, starts, ahead.HORIZONS)
        missed.append(np.where(_known(actuator, starts)[..., None], after, np.nan))
    parts = [before - after for before, after in zip(missed, missed[1:])] + missed[-1:]
    turns = [c for c, channel in enumerate(path.robot.channels) if channel.wraps]
    for part in parts:
        part[..., turns] = short(part[..., turns])
    return [part[..., axes] for part in parts]


def _with(action, actuator):
    """An action with what an actuator did instead of what its command asked for."""
    u = action.u.copy()
    u[:, actuator.j] = actuator.u
    return replace(action, u=u)


def _known(actuator, starts):
    """Whether an actuator is known in every row of predictions (S, H)."""
    unknown = np.concatenate([np.zeros(1), np.cumsum(~actuator.usable)])
    ends = np.minimum(np.add.outer(starts, ahead.HORIZONS), len(actuator.usable))
    return unknown[ends] == unknown[starts][:, None]


def tagged(effects, told, given):
    """Effects of the whole log, with the link in which each is found."""
    robot, actuators = given.robot, given.actuators
    names = lambda name: [name, *(new for a in actuators for new in extras.at_actuator(robot, a, name))]  # noqa: E731
    return links.tagged(effects, told, names)


# ---- dead links ----------------------------------------------------------------------------------


def dead_link(given):
    """The name of a link in which nothing arrives, or None."""
    if given.dead:
        return to_actuator(given.robot, given.dead)
    try:
        return moving(given) if dead(Path(given.robot, given.log), given) else None
    except RunsAway:
        return None


def dead(path, given):
    """{state: axis} as answers.axis() gives them, if the motion does not answer what moves it: actuators, or commands; else None."""
    action = path.action(())
    for actuator in given.actuators:
        action = _with(action, actuator)
    axes = _answer(path, action)
    return axes if answers.dead(axes.values()) else None


def _answer(path, action):
    """{state: axis}: how far the simulator goes in a window from where the robot was, and how far the robot goes."""
    log, robot = path.log, path.robot
    n = extras.window(log)
    starts = answers.windows(log.usable, n)
    missed = path.ahead_by(action, starts, (n,))[:, 0, : len(robot.measured)]
    seen = (path.measured[starts + n] - path.measured[starts])[:, : len(robot.measured)]
    good = np.isfinite(missed).all(1)
    into = _before(starts[good], (seen - missed)[good], n)
    noise = noise_of(log, robot)
    return {robot.states[i].name: answers.axis(into[:, c], seen[good, c], noise[c]) for c, i in enumerate(robot.measured)}


def _before(starts, asked, n):
    """What was asked for (W, c, LAGS) in windows and in those before them; none where there is no window."""
    at = dict(zip(starts.tolist(), asked))
    lags = range(answers.LAGS)
    return np.stack([[at.get(start - lag * n, np.zeros(asked.shape[1])) for start in starts.tolist()] for lag in lags], -1)
