"""What a report says of the links of a drive: in which the gap arises, what acts there, and when one of them is dead."""

from ...report import figures, words
from ...report import links as telling
from ...report.story import PARTS
from ...report.words import length, listed, real
from . import links

NOTE = (
    "Each link is diagnosed by itself: its inputs are the speeds that go into it, and its effects those that can act there. "
    "The shares of the links from command to ground add up to 100 %; that of the gyro is a share of the heading error."
)
CHECK = "check that it is on the ground, that the drive is engaged, and that the pose sensor works"
DEAD = {
    links.GROUND: f"the wheels turn, but the robot does not move: {CHECK}",
    links.WHEEL: "the wheels do not answer the commands: check that the motors are on, and that the commands reach them",
    links.WHOLE: f"the wheels are told to turn, but the robot does not move: {CHECK}",
}
ENTERS = {links.GROUND: "the wheels turn", links.WHEEL: "the commands ask for", links.WHOLE: "the commands ask for"}
LEAVES = {links.GROUND: "the pose shows", links.WHEEL: "the wheels show", links.WHOLE: "the pose shows"}


def fault(effect):
    return DEAD[effect["link"]]


def motion(effect):
    """What goes into a dead link and what comes out, in one sentence."""
    sizes = {"along": length, "heading": words.angle}
    into, out = (listed(sizes[axis](moved[part]) for axis, moved in effect["motion"].items()) for part in ("into", "out"))
    return f"Per second {ENTERS[effect['link']]} {into} (RMS), and {LEAVES[effect['link']]} {out}. No other effect was looked for."


def figure(teller, found):
    """(caption, bars of before, after and floor of every link); one degree is as long as the way that it makes at a metre."""
    caption, entries = telling.caption(teller), []
    for link in found:
        entries.append((f"{link['link']} ({link['of']})",))
        entries += _bars(teller, link)
    return caption, figures.bars(entries, caption)


def _bars(teller, link):
    key, kinds = telling.horizon(teller, link), ("bar-before", "bar-after", "bar-floor")
    texts, names = teller.sizes(link["gap"], key), ("simulator", "with effects", "noise floor")
    bars = [(name, real(link["gap"][part][key]), text, kind) for name, part, text, kind in zip(names, PARTS, texts, kinds)]
    return bars if link["effects"] else bars[::2]
