"""What is said of each flight, by the diagnoser or a peer, and whether it is right."""

from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from ... import bridge
from ...diagnose.platforms.quadrotor import baseline, causes
from ...diagnose.platforms.quadrotor.causes import SLUNG
from ...diagnose.platforms.quadrotor.changes import MOST, Changes
from ...diagnose.platforms.quadrotor.diagnosis import DECIDED
from ...plumbing.results import progress
from .data import SESSIONS

SURE = 0.9  # confidence, over which an answer should hardly ever be wrong


@dataclass(frozen=True)
class Answer:
    """named: causes, the first one first; declared: what else may be the cause; confidence: in the surest cause, or in no change.

    unknown: whether something has changed without a cause that is named.
    """

    named: tuple
    declared: tuple
    confidence: float | None = None
    unknown: bool = False

    @property
    def changed(self):
        return bool(self.named) or self.unknown

    @property
    def said(self):
        return (*self.named, *self.declared)


# ---- is it right? ------------------------------------------------------------------------------------


def right(flight, answer):
    """Whether a cause is found as the issue of the flight asks: in the order, in the set, or none."""
    if flight.asks == "healthy":
        return not answer.changed
    if not answer.named:
        return False
    if flight.asks == "rotor":
        return answer.named[0] in flight.truth
    if flight.asks == "pair":
        return flight.truth <= set(answer.said) and len(answer.said) <= MOST
    return bool(flight.truth & set(answer.said))


def near(flight, answer):
    """Whether the rotors that something was done at are in the set, even where it is a weight; healthy: whether nothing is named."""
    return answer.changed == bool(flight.at) and set(map(causes.rotor, flight.at)) <= set(answer.said)


def sure_and_wrong(flight, answer):
    """Counted strictly: more than SURE of a cause that does not act, or of no change where something was done."""
    sure = answer.confidence is not None and answer.confidence > SURE
    return sure and not (set(answer.named) <= flight.truth and bool(answer.named) == bool(flight.truth))


# ---- the diagnoser -----------------------------------------------------------------------------------


def changes(flight, healthy, factor=1.0):
    """Changes of a flight beside healthy ones; factor: of the spread of healthy flights."""
    known = baseline.of_vehicle([one.features for one in healthy])
    return Changes(flight.features, replace(known, spread=factor * known.spread), bridge.quadrotor_vehicle())


def answer(found):
    """The Answer of Changes: causes that are decided are named, the others declared."""
    decided = [cause for cause in found.named if found.decided(cause) >= DECIDED]
    named = tuple(cause.name for cause in decided)
    others = [cause.name for cause in found.named if cause.name not in named]
    rivals = [name for cause in found.named for name in found.rivals(cause.name)]
    confidence = max((found.confidence(cause) for cause in decided), default=None if found.best else found.healthy_probability)
    return Answer(
        named, tuple(name for name in dict.fromkeys([*others, *rivals]) if name not in named), confidence, bool(found.best) and not named
    )


def row(flight, found):
    """A row of flights.json."""
    said = answer(found)
    named = [{"name": c.name, "confidence": found.confidence(c), "params": c.params} for c in found.named if c.name in said.named]
    return {
        "flight": flight.name, "vehicle": flight.vehicle, "family": flight.family, "rotors": flight.rotors, "size": flight.size,
        "healthy": np.mean([one.rotors for one in found.healthy], axis=0).tolist(), "asked": flight.features.rotors.tolist(),
        "volts": flight.features.volts, "unchanged": found.healthy_probability, "changed": said.changed, "named": named, "declared": list(said.declared),
        "smallest": found.smallest(), "right": right(flight, said) if flight.asks else None,
    }  # fmt: skip


def rows(flights):
    """(rows of flights.json, {flight: Answer})."""
    found = {one.name: changes(one, one.healthy(flights)) for one in flights}
    out = [row(one, found[one.name]) for one in progress(flights, "what has changed")]
    return out, {name: answer(one) for name, one in found.items()}


# ---- what must hold ----------------------------------------------------------------------------------


def loss(row, rotor):
    """Loss of a rotor's thrust in a row, 0 where it is not named: (value, low, high) in 1."""
    for cause in row["named"]:
        if cause["name"] == causes.rotor(rotor):
            value, ends = cause["params"]["a"]
            return -value, *sorted(-end for end in ends)
    return 0.0, 0.0, 0.0


def rank_correlation(rows, vehicle="E8", rotors="M3"):
    """Spearman's of the loss of the one rotor that was cut against the mm, over flights of one vehicle."""
    some = [row for row in rows if (row["vehicle"], row["family"], row["rotors"]) == (vehicle, "rotor", rotors)]
    sizes, losses = [float(row["size"]) for row in some], [loss(row, int(rotors[1:]))[0] for row in some]
    return float(stats.spearmanr(sizes, losses).statistic) if len(set(sizes)) > 1 and len(set(losses)) > 1 else None


def holds(flights, rows, said):
    """[(what, right or value, of how many or None, what must be reached)]."""

    def count(some, test):
        return sum(test(one, said[one.name]) for one in some), len(some)

    def of(*asks):
        return [one for one in flights if one.asks in asks]

    loads = of("payload", SLUNG)
    seen = [one for one in of("payload") if said[one.name].changed]
    sure = [one for one in flights if (said[one.name].confidence or 0) > SURE]
    alike = {causes.PAYLOAD, SLUNG}
    return [
        ("healthy: none", *count(of("healthy"), right), 1.0),
        ("one rotor, 3 mm or more: named first, payload declared", *count(of("rotor"), lambda f, a: right(f, a) and causes.PAYLOAD in a.said), 0.9),
        ("two rotors, 4 mm or more together: both named or declared, with one more at most", *count(of("pair"), right), 0.9),
        ("payload, above the detection limit: a weight named or declared", *count(seen, right), 0.8),
        ("payload, all flights: a weight named or declared", *count(of("payload"), right), None),
        ("slung load: payload and slung load named or declared", *count(of(SLUNG), lambda f, a: alike <= set(a.said)), None),
        ("payload or slung load: the rotor next to it named or declared", *count(loads, near), None),
        ("rotor 3 of E8: Spearman of loss and mm", rank_correlation(rows), None, 0.85),
        ("confidence over 0.9: answers, of all flights", len(sure), len(flights), None),
        ("confidence over 0.9: wrong, of these", *count(sure, sure_and_wrong), None),
    ]  # fmt: skip


# ---- sensitivity -------------------------------------------------------------------------------------


@contextmanager
def single_prior(factor):
    """The prior of one weak rotor, times a factor."""
    before = causes.SINGLE
    causes.SINGLE = factor * before
    try:
        yield
    finally:
        causes.SINGLE = before


def _answers(flights, among, factor=1.0):
    """{flight: Answer} beside the healthy flights of `among`."""
    return {one.name: answer(changes(one, one.healthy(among), factor)) for one in flights}


def _beside(flights, session):
    """{flight: Answer} of the changed flights of a vehicle, beside the healthy ones of one session."""
    healthy = [one for one in flights if one.name in session]
    return _answers([one for one in flights if one.truth and one.vehicle == healthy[0].vehicle], healthy)


def variants(flights):
    """[(what is different, {flight: Answer})]: constants halved and doubled, one session of healthy flights instead of two."""
    out = []
    for name, factor in progress([("halved", 0.5), ("doubled", 2.0)], "constants halved, doubled"):
        out.append((f"`SPREAD` {name}", _answers(flights, flights, factor)))
        with single_prior(factor):
            out.append((f"`SINGLE` {name}", _answers(flights, flights)))
    there = [session for session in SESSIONS if any(one.name in session for one in flights)]
    out += [(f"healthy: only {' and '.join(session)}", _beside(flights, session)) for session in progress(there, "single sessions")]
    return out


def sensitivity(flights, said):
    """[(what is different, flights, of these with other causes named, with others in the set, asked for, right before, right now)]."""
    out = []
    for name, other in variants(flights):
        both = [(one, said[one.name], other[one.name]) for one in flights if one.name in other]
        named = sum(set(a.named) != set(b.named) for _, a, b in both)
        within = sum(set(a.said) != set(b.said) for _, a, b in both)
        asked = [(one, a, b) for one, a, b in both if one.asks]
        out.append(
            (name, len(both), named, within, len(asked), sum(right(f, a) for f, a, _ in asked), sum(right(f, b) for f, _, b in asked))
        )
    return out
