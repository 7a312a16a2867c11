"""The table of effects that a robot may have."""

import numpy as np

from ... import bridge
from ...plumbing.results import number, print_table, print_terms
from ..platforms.own.path import Path
from ..robot import RobotLog
from . import is_own, library, platform_of, toml, vehicle_of
from .log import read

HEADERS = ("effect", "at", "parameter", "unit", "from", "to", "usual")


def _bound(value):
    return number(float(value)) if abs(value) < library.WHOLE else "any"


def _of_c(robot):
    """Rows of a robot that comes with TinyKoop: [(name, block, parameters, formula)]."""
    platform = platform_of(robot)
    formulas = bridge.formulas(platform)
    table = bridge.quadrotor_effects(vehicle_of(robot)) if platform == "quadrotor" else bridge.effects(platform)
    return [(name, block, [tuple(p) for p in rows], formulas[name]) for name, (block, rows) in table.items()]


def _forms(robot):
    """{form: the effect as which it is reported}."""
    return {name: reported for name, (_, reported) in bridge.families(platform_of(robot)).items() if reported != name}


def _unit_log(robot):
    """A log in which every signal reaches from -1 to 1, for sizes relative to that."""
    t = np.arange(200) * 0.01
    wave = np.sin(np.linspace(0, 4 * np.pi, 200))
    many = lambda count: np.tile(wave[:, None], count)  # noqa: E731
    return RobotLog(t, many(len(robot.states)), many(len(robot.commands)), many(len(robot.channels)), np.ones(199, bool), 0.01)


def _of_own(robot, log):
    shown = log if log is not None else _unit_log(robot)
    found = Path(robot, shown).everything
    return [(e.name, e.block, [(p.name, p.unit, p.low, p.high, p.usual) for p in e.parameters], e.formula) for e in found.values()]


def run(robot, log_file=None):
    """Prints the table."""
    own = is_own(robot)
    found = toml.read(robot) if own else None
    rows, formulas, note = [], {}, ""
    for name, block, parameters, formula in _of_own(found, read(log_file, found) if log_file else None) if own else _of_c(robot):
        formulas[name] = formula
        for i, (parameter, unit, low, high, usual) in enumerate(parameters):
            first = (name, block) if i == 0 else ("", "")
            rows.append((*first, parameter, unit, _bound(low), _bound(high), number(float(usual))))
    if own and not log_file:
        note = "Sizes are those for signals that reach from -1 to 1, every 0.01 s; with --log LOG.csv they are those of your log."
    print_table(f"Effects of {found.name if own else robot}", HEADERS, rows, note)
    print_terms("Formulas", {name: formula for name, formula in formulas.items() if formula})
    if not own and (forms := _forms(robot)):
        print_terms("Forms of other effects, under whose names they are reported", forms)
