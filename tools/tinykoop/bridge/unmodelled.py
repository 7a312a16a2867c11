"""Unmodelled effects of host_sim/: what there is, and which act."""

import ctypes as ct
from dataclasses import dataclass
from functools import cache

from .. import platforms
from .library import call, raw

MAX_PARAMETERS = 6


class _Active(ct.Structure):
    _fields_ = [
        ("effect", ct.c_char_p),
        ("n_parameters", ct.c_size_t),
        ("parameters", ct.c_double * MAX_PARAMETERS),
        ("t0", ct.c_double),
        ("t1", ct.c_double),
    ]


@dataclass(frozen=True)
class Effect:
    """An unmodelled effect that acts from t0 to t1 (s from the first row). `tinykoop effects` lists names and parameters."""

    name: str
    parameters: tuple
    t0: float = 0.0
    t1: float = float("inf")


def effects(platform="ddr"):
    """Returns all effects of a platform in the order in which they act.

    {name: (block, ((parameter, unit, low, high, usual), ..))}; the block is actuator, plant or sensor.
    """
    platforms.check(platform)
    return dict(_effects(platform))


@cache
def formulas(platform="ddr"):
    """{effect: what it changes, in the names of its parameters}."""
    return {name: raw("tk_effect_formula", platform.encode(), ct.c_size_t(i)).decode() for i, name in enumerate(_effects(platform))}


@cache
def families(platform="ddr"):
    """{effect: (family, the name under which it is reported)}; effects that are reported under another's name are forms of it."""
    asked = ("tk_effect_family", "tk_effect_reported_as")
    return {
        name: tuple(raw(what, platform.encode(), ct.c_size_t(i)).decode() for what in asked) for i, name in enumerate(_effects(platform))
    }


@cache
def _memories(platform):
    """{effect: (its place in the order, whether it has a state of its own)}."""
    return {name: (i, raw("tk_effect_remembers", platform.encode(), ct.c_size_t(i)) != 0) for i, name in enumerate(_effects(platform))}


def remembering(active, platform="ddr"):
    """Those of some effects that act up to the last one that has a state of its own."""
    places = [_memories(platform).get(e.name, (-1, False)) for e in active]
    last = max((place for place, remembers in places if remembers), default=-1)
    return tuple(e for e, (place, _) in zip(active, places) if place <= last)


@cache
def _effects(platform):
    table, c_platform = {}, platform.encode()
    while name := raw("tk_effect_name", c_platform, ct.c_size_t(len(table))):
        place = (c_platform, ct.c_size_t(len(table)))
        rows = []
        for p in range(raw("tk_effect_parameters", *place)):
            parameter, unit = ct.c_char_p(), ct.c_char_p()
            low, high, usual = ct.c_double(), ct.c_double(), ct.c_double()
            call(
                "tk_effect_parameter", *place, ct.c_size_t(p), ct.byref(parameter), ct.byref(unit),
                ct.byref(low), ct.byref(high), ct.byref(usual),
            )  # fmt: skip
            rows.append((parameter.value.decode(), unit.value.decode(), low.value, high.value, usual.value))
        block = ("actuator", "plant", "sensor")[raw("tk_effect_block", *place)]
        table[name.decode()] = (block, tuple(rows))
    return table


def usual_effect(name, t0=0.0, t1=float("inf"), platform="ddr"):
    """Returns the effect of this name with its usual parameters."""
    return Effect(name, tuple(row[4] for row in effects(platform)[name][1]), t0, t1)


def active_effects(active):
    rows = [(e.name.encode(), len(e.parameters), e.parameters[:MAX_PARAMETERS], e.t0, e.t1) for e in active]
    return (_Active * max(len(rows), 1))(*rows)
