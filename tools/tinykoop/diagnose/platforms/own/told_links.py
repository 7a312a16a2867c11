"""What a report says of the links of your own robot."""

from ...report import figures, words
from ...report import links as telling
from ...report.words import listed, percent, real
from . import links

NOTE = (
    "Each link is diagnosed by itself: its inputs are what goes into it, and its effects those that can act there. The shares of the links "
    "from commands to motion add up to 100 %. Before and after: the error of an actuator or a sensor in its own unit."
)
CHECK = "check that it is free to move, that its actuators are on, and that its sensors work"
DEAD = {
    links.MOTION: f"the actuators move, but the robot does not answer: {CHECK}",
    links.WHOLE: f"the robot does not answer its commands: {CHECK}",
}


def fault(effect):
    """What is dead."""
    command, _, actuator = effect["link"].partition(" command to ")
    said = f"{actuator} does not answer the {command} command: check that the actuator is on and free to move, and that commands reach it"
    return DEAD.get(effect["link"], said)


def motion(effect):
    """What goes into a dead link and what comes out, in one sentence."""
    sizes = lambda part: listed(f"{words.size_of(axis['unit'])(axis[part])} ({name})" for name, axis in effect["motion"].items())  # noqa: E731
    goes, comes = ("the simulator goes", "the robot") if effect["link"] in DEAD else ("the command varies by", "the column")
    return f"In windows of {words.seconds(effect['window'])} {goes} {sizes('into')} (RMS), {comes} {sizes('out')}. No other effect was looked for."


def figure(teller, found):
    """(caption, bars of the shares of the links)."""
    caption, shown = telling.caption(teller), telling.shared(teller)
    bars = [(link["link"], real(link["share"]), percent(link["share"]), "bar-before") for link in shown]
    return caption, figures.bars(bars, caption)
