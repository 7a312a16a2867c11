"""The links of a drive: from command to wheel, from wheel to ground, from gyro to heading.

Each is a log of its own, with the speeds that go in as commands and the motion that comes out as pose, and is diagnosed as one.
"""

from dataclasses import dataclass, replace

import numpy as np

from .... import bridge
from ... import links
from ...prediction_errors import ahead
from ...prediction_errors.answer import answer
from . import odometry, traction
from .path import Path

WHEEL, GROUND, HEADING, WHOLE = "command to wheel", "wheel to ground", "gyro to heading", "command to ground"
GEOMETRY = ("speed_gain", "yaw_gain", "wheel_asymmetry", "yaw_bias")  # a wheel's size, the track, skid steering: at the wheels or below
CLOCK = ("clock_scale",)  # odometry and commands count by one clock, the pose by another
SCALE = ("yaw_gain", "yaw_bias")  # of a gyro
MOST = 1500  # rows of a link that are looked at
ENOUGH = 400_000  # steps that a link may ask for before no further cause is looked for there


@dataclass(frozen=True)
class Link:
    name: str
    log: bridge.Log
    effects: tuple  # names of those that can act here
    gap: str  # what is compared

    @property
    def dead(self):
        """Whether what comes out does not answer what goes in."""
        return traction.dead(self.log, self.log.u)


class LinkPath(Path):
    """The path of a link: of its effects only, by the one rule of integration that its input was integrated by.

    noise: of the pose. What the pose would not show does not matter at the wheels either, so their odometry counts as no more exact.
    """

    variants = ("as the drive",)
    integrator = bridge.ARC
    most = MOST

    def __init__(self, link, whole, noise):
        self.integrator, self.finest = whole.integrator, noise.sensor
        super().__init__(link.log, [name for name in bridge.effects() if name not in link.effects])
        self.gaps = {link.gap: Path.gaps[link.gap]}

    @property
    def spent(self):
        """A search of the links takes less time than that of the whole log."""
        return self.asked > ENOUGH


def _of_block(*blocks):
    return tuple(name for name, (block, _) in bridge.effects().items() if block in blocks)


def of(log, speeds, gap="position", integrator=bridge.ARC):
    """The Links of a log; speeds: of its wheels and its gyro, where they are known; gap: what is compared, if the link has it."""
    found = []
    if "wheels" in speeds:
        wheels = speeds["wheels"]
        turned = replace(log, x=odometry.integrated(log, wheels, integrator), usable=wheels.usable)
        actuators = tuple(name for name in _of_block("actuator") if name not in CLOCK)
        found.append(Link(WHEEL, turned, actuators, gap))
        below = (*_of_block("plant", "sensor"), *GEOMETRY, *CLOCK)
        found.append(Link(GROUND, replace(log, u=wheels.u, usable=wheels.usable), below, gap))
    if "gyro" in speeds:
        found.append(Link(HEADING, _on_the_spot(log, speeds["gyro"]), SCALE, "heading"))
    return found


def _on_the_spot(log, gyro):
    """The log of a robot that turns as the heading shows and does not move."""
    return replace(log, x=log.x * (0.0, 0.0, 1.0), u=gyro.u, usable=gyro.usable)


def dead(log, speeds):
    """The name of the first link in which nothing arrives, or None."""
    wheel, ground, *_ = [*of(log, {"wheels": speeds["wheels"]} if "wheels" in speeds else {}), None, None]
    if wheel is None:
        return WHOLE if traction.dead(log, log.u) else None
    if ground.dead:
        return GROUND
    return WHEEL if wheel.dead and traction.dead(log, log.u) else None


def diagnosed(found, speeds):
    """The `where.links` of the report, for the answer to the whole log."""
    path, rows = found.path, found.path.rows[found.starts]
    whole, out = _missed(path.log, rows, path.integrator), []
    for link in of(path.log, speeds, links.main(found), path.integrator):
        part, axes, floor = _missed(link.log, rows, path.integrator), list(Path.gaps[link.gap][1]), found.floor[link.gap]
        searched = replace(link, effects=()) if links.hidden(part[..., axes], floor) else link
        share = links.share(whole[..., axes], part[..., axes], floor, link.name != WHEEL)
        out.append(_of_link(searched, path, found.state.noise) | {"share": share})
    return out


def _of_link(link, whole, noise_of_pose):
    """What the report says of a link; whole: the path of the whole log."""
    return links.told(link.name, answer(LinkPath(link, whole, noise_of_pose)), link.gap)


def _missed(log, rows, integrator):
    """Measured less predicted (S, H, 3) by the speeds alone, in the axes of the poses in these rows."""
    steps = np.minimum(ahead.HORIZONS, len(log.x) - 1)
    return bridge.windows(log.x, log.u, log.dt, rows, steps, usable=log.usable, integrator=integrator)[1]
