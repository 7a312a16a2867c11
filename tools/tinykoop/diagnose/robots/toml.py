"""A robot from a TOML file (docs/own-robot.md)."""

import math
import tomllib
from pathlib import Path

from ... import units
from ...plumbing.errors import UserError
from .. import simulators
from ..robot import Gap, Inner, Robot, Signal
from ..simulators import python, recorded
from .log import read as read_log

SECTIONS = ("name", "log", "simulator", "parameter", "effect", "effects", "report")


def _expect(table, keys, where, path):
    unknown = [key for key in table if key not in keys]
    if unknown:
        raise UserError(f"{path}: {where}: unknown key {unknown[0]}; there are {', '.join(keys)}")


def _need(table, key, kind, where, path):
    if not isinstance(table.get(key), kind):
        names = {str: "a text", dict: "a table", list: "a list", (int, float): "a number"}
        raise UserError(f"{path}: {where}: {key} must be {names[kind]}")
    return table[key]


KEYS = ("name", "column", "unit", "factor", "wraps", "measures")


def _signal(table, where, path, column=True):
    if not isinstance(table, dict):
        raise UserError(f'{path}: {where}: {table!r} must be a table, as {{name = "px", column = "x", unit = "m"}}')
    _expect(table, KEYS, where, path)
    name = _need(table, "name", str, where, path)
    if column:
        _need(table, "column", str, f"{where} {name}", path)
    unit, scale = units.base(table.get("unit", "1"))
    scale *= _need({"factor": 1.0} | table, "factor", (int, float), f"{where} {name}", path)
    return Signal(name, unit, table.get("column"), scale, bool(table.get("wraps", False)), table.get("measures"))


def _inner(table, path):
    name = _need(table, "name", str, "[[parameter]]", path)
    where = f"[[parameter]] {name}"
    _expect(table, ("name", "field", "unit", "value", "low", "high", "usual"), where, path)
    low, high = (float(_need(table, key, (int, float), where, path)) for key in ("low", "high"))
    value = float(table.get("value", math.nan))
    usual = float(table.get("usual", 0.1 * (high - low)))
    if not low < high or not usual > 0 or (math.isfinite(value) and not low <= value <= high):
        raise UserError(f"{path}: {where}: low < high, value between them and usual above 0 are needed")
    return Inner(name, table.get("unit", "1"), value, low, high, usual, table.get("field", name))


def _acting(table, path):
    """(name, params) of an effect that belongs to the simulator."""
    name = _need(table, "name", str, "[[effect]]", path)
    _expect(table, ("name", "params"), f"[[effect]] {name}", path)
    params = _need(table, "params", dict, f"[[effect]] {name}", path)
    return name, {key: float(_need(params, key, (int, float), f"[[effect]] {name}: params", path)) for key in params}


def _text(path):
    try:
        return tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: {error}") from error


def _gaps(table, states, path):
    found = []
    for gap in table.get("report", {}).get("gap", []):
        for state in gap.get("states", []):
            if state not in states:
                raise UserError(f"{path}: [report]: gap {gap.get('name')}: there is no state {state}; there are {', '.join(states)}")
        found.append(
            Gap(
                _need(gap, "name", str, "[report] gap", path), gap.get("unit", "1"), tuple(_need(gap, "states", list, "[report] gap", path))
            )
        )
    return found


def _simulator(table, path):
    if "simulator" not in table:
        raise UserError(f"{path}: has no [simulator]; name it there, or give what it does under the log's commands: --sim SIM.csv")
    return _need(table, "simulator", dict, "the file", path)


def read_both(path, log_file, sim=None):
    """(Robot of a TOML file, its RobotLog); sim: a run of the simulator (CSV), instead of what the TOML has."""
    robot = read(path, sim is None)
    log = read_log(log_file, robot)
    return (recorded.of(robot, sim, log) if sim else robot), log


def _log(table, path):
    """(time, states, commands, outputs) of [log]."""
    _expect(table, SECTIONS, "the file", path)
    log = _need(table, "log", dict, "the file", path)
    _expect(log, ("time", "state", "command", "extra"), "[log]", path)
    time = _need(log, "time", dict, "[log]", path)
    time = _signal({"name": "t", "unit": "s"} | time, "[log] time", path)
    states = tuple(_signal(s, "[log] state", path) for s in _need(log, "state", list, "[log]", path))
    commands = tuple(_signal(s, "[log] command", path) for s in _need(log, "command", list, "[log]", path))
    return time, states, commands, tuple(_signal(s, "[log] extra", path) for s in log.get("extra", []))


def columns(path):
    """Signals of the log, time first, in a robot's file or one that has nothing but [log]."""
    path = Path(path)
    time, states, commands, _ = _log(_text(path), path)
    return time, *states, *commands


def read(path, simulated=True):
    """The Robot of a TOML file; without a simulator and what belongs to that if it is not `simulated`."""
    path = Path(path)
    table = _text(path)
    time, states, commands, outputs = _log(table, path)
    simulator = _simulator(table, path) if simulated else {}
    states += tuple(Signal(*h.split("@")) if "@" in h else Signal(h, "1") for h in simulator.get("hidden", []))
    _expect(simulator, simulators.keys(), "[simulator]", path)
    parameters = tuple(_inner(p, path) for p in table.get("parameter", []) if simulated)
    for what, some in (("state", states), ("command", commands)):
        if not some:
            raise UserError(f"{path}: [log]: {what} must list at least one")
    names = [s.name for s in (*states, *commands)]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"{path}: duplicate signal name {name}")
    for output in outputs:
        if output.measures not in names:
            raise UserError(f"{path}: [log] extra {output.name}: measures must be one of {', '.join(names)}")
    effects = table.get("effects", {})
    own = tuple(python.load(place, path.parent) for place in effects.get("own", []))
    model, parameters = simulators.make(simulator, path.parent, states, commands, parameters) if simulated else (None, ())
    gaps = tuple(_gaps(table, [s.name for s in states], path)) or tuple(Gap(s.name, s.unit, (s.name,)) for s in states if s.column)
    return Robot(
        _need(table, "name", str, "the file", path),
        time,
        states,
        commands,
        model,
        outputs,
        parameters,
        gaps,
        tuple(effects.get("use", ())),
        own,
        str(path),
        tuple(_acting(effect, path) for effect in table.get("effect", [])),
    )
