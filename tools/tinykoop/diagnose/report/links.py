"""What a report says of the links of a robot: in which the gap arises, and what acts there."""

import math

from .. import standing
from .story import Section, Table, Teller
from .words import capital, listed, percent, real

HEADERS = ("link", "share", "before", "after", "what acts there")
NONE = 0.01  # share, below which a link has none
CANCELS = -0.05  # share, from which on the errors of links are said to cancel


def shared(teller):
    """Links that have a share of the gap, if there is one."""
    found = teller.report["where"].get("links", ()) if teller.report["verdict"] != "none" else ()
    return [link for link in found if math.isfinite(real(link["share"]))]


def sentences(teller):
    """In which link the gap arises, and which columns are not used."""
    return [*_largest(teller), *_cancel(shared(teller)), *teller.report["log"].get("ignored", ())]


def _largest(teller):
    """One sentence for the chain, and one for each link beside it."""
    chain = [link for link in shared(teller) if link["link"] not in teller.beside]
    others = [link for link in shared(teller) if link["link"] in teller.beside]
    most = [max(chain, key=lambda link: real(link["share"]))] if chain else []
    return [f"{_part(link['share'])} of the {link['of']} gap arises {_between(link)}{_acting(teller, link)}." for link in most + others]


def _between(link):
    return f"between {' and '.join(link['link'].split(' to '))}"


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
    table = Table(f"Links, {teller.ahead(horizon(teller, found[0]))}", HEADERS, [_row(teller, link) for link in found], True)
    return Section(section.heading, (*section.tables, table), teller.links_note, (*section.figures, teller.link_figure(found)), said)


def horizon(teller, link):
    return teller.horizon(link["gap"]) or "1"


def _row(teller, link):
    key, names = horizon(teller, link), listed(teller.title(effect["name"]) for effect in link["effects"])
    return link["link"], percent(link["share"]), *teller.sizes(link["gap"], key)[:2], names or "-"


def caption(teller):
    """What a figure of the links bears out."""
    said = _largest(teller)
    return said[0].rstrip(".") if said else "No link has a gap that stands out from the noise"


class Linked(Teller):
    """A robot whose report may have links, or a fault: that one of them is dead. A platform says in which words."""

    links_note, beside = "", ()  # below the table of links; names of links outside the chain

    def link_figure(self, found):
        """(caption, SVG) of the links."""
        raise NotImplementedError

    def fault(self, effect):
        """What is dead."""
        raise NotImplementedError

    def motion(self, effect):
        """What goes into a dead link and what comes out, in a sentence."""
        raise NotImplementedError

    @property
    def dead(self):
        """The effect of a robot that does not answer, or None."""
        return next((effect for effect in self.effects if effect["name"] in standing.FAULTS), None)

    def phrase(self, effect):
        return self.fault(effect) if effect["name"] in standing.FAULTS else self.effect_phrase(effect)

    def effect_phrase(self, effect):
        """What an effect that is no fault does."""
        return super().phrase(effect)

    def sentence(self):
        return f"{capital(self.fault(self.dead))} ({self.title(self.dead['name'])})." if self.dead else super().sentence()

    def asides(self):
        return [self.motion(self.dead)] if self.dead else [*super().asides(), *sentences(self)]

    def next_step(self):
        return "Next: correct this, and record the log again." if self.dead else super().next_step()

    def where(self):
        return added(self, super().where())
