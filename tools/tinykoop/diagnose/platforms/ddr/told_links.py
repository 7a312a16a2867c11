"""What a report says of the links of a drive: in which the gap arises, what acts there, and when one of them is dead."""

import math

from ...report import figures, words
from ...report.story import PARTS, Section, Table
from ...report.words import capital, length, listed, percent, real
from . import links, standing

HEADERS = ("link", "share", "before", "after", "what acts there")
NONE = 0.01  # share, below which a link has none
CANCELS = -0.05  # share, from which on the errors of links are said to cancel
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


def dead(report):
    """The effect of a robot that does not answer, or None."""
    return next((effect for effect in report["effects"] if effect["name"] == standing.EFFECT), None)


def motion(effect):
    """What goes into a dead link and what comes out, in one sentence."""
    sizes = {"along": length, "heading": words.angle}
    into, out = (listed(sizes[axis](moved[part]) for axis, moved in effect["motion"].items()) for part in ("into", "out"))
    return f"Per second {ENTERS[effect['link']]} {into} (RMS), and {LEAVES[effect['link']]} {out}. No other effect was looked for."


# ---- living links --------------------------------------------------------------------------------


def _between(link):
    return f"between {' and '.join(link['link'].split(' to '))}"


def sentences(teller):
    """In which link the gap arises, and which columns are not used."""
    found = [link for link in teller.report["where"].get("links", ()) if math.isfinite(real(link["share"]))]
    return [*_largest(teller, found), *_cancel(found), *teller.report["log"].get("ignored", ())]


def _largest(teller, found):
    """One sentence for the chain and one for the gyro."""
    chain = [link for link in found if link["link"] != links.HEADING]
    gyro = [link for link in found if link["link"] == links.HEADING]
    most = [max(chain, key=lambda link: real(link["share"]))] if chain else []
    return [f"{_part(link['share'])} of the {link['of']} gap arises {_between(link)}{_acting(teller, link)}." for link in most + gyro]


def _part(share):
    return capital(percent(share)) if real(share) >= NONE else "None"


def _acting(teller, link):
    names = listed(teller.title(effect["name"]) for effect in link["effects"])
    return f" ({names})" if names else ""


def _cancel(found):
    parts = [_between(link)[len("between ") :] for link in found if real(link["share"]) < CANCELS]
    return [f"The error between {listed(parts)} cancels a part of the others."] if parts else []


def added(teller, section):
    """The section with the links of the report in it, if it has any."""
    found = teller.report["where"].get("links", ())
    said = (*section.sentences, *sentences(teller))
    if not found:
        return Section(section.heading, section.tables, section.note, section.figures, said)
    table = Table(f"Links, {teller.ahead(_horizon(teller, found[0]))}", HEADERS, [_row(teller, link) for link in found], True)
    return Section(section.heading, (*section.tables, table), NOTE, (*section.figures, _figure(teller, found)), said)


def _horizon(teller, link):
    return teller.horizon(link["gap"]) or "1"


def _row(teller, link):
    key, names = _horizon(teller, link), listed(teller.title(effect["name"]) for effect in link["effects"])
    return link["link"], percent(link["share"]), *teller.sizes(link["gap"], key)[:2], names or "-"


def _figure(teller, found):
    """(caption, bars of before, after and floor of every link); one degree is as long as the way that it makes at a metre."""
    said = _largest(teller, [link for link in found if math.isfinite(real(link["share"]))])
    caption = said[0].rstrip(".") if said else "No link has a gap that stands out from the noise"
    entries = []
    for link in found:
        entries.append((f"{link['link']} ({link['of']})",))
        entries += _bars(teller, link)
    return caption, figures.bars(entries, caption)


def _bars(teller, link):
    key, kinds = _horizon(teller, link), ("bar-before", "bar-after", "bar-floor")
    texts, names = teller.sizes(link["gap"], key), ("simulator", "with effects", "noise floor")
    bars = [(name, real(link["gap"][part][key]), text, kind) for name, part, text, kind in zip(names, PARTS, texts, kinds)]
    return bars if link["effects"] else bars[::2]
