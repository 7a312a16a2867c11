"""From the user's model to a Simulator: one file for each kind of model.

Each has KEYS of [simulator] that it takes beside its own, and make(table, folder, names) with names of states, commands and
fields of the parameters in this order; what it makes may know values of parameters: value(field).
"""

from dataclasses import replace
from math import isfinite

from ...plumbing.errors import UserError
from . import fmu, mujoco, python, shared_library

KINDS = {"python": python, "library": shared_library, "mujoco": mujoco, "fmu": fmu}


def keys():
    """All keys that [simulator] may have."""
    return ("hidden", *KINDS, *(key for kind in KINDS.values() for key in kind.KEYS))


def make(table, folder, states, commands, parameters):
    """(Simulator that a TOML's [simulator] names, parameters with their values)."""
    kinds = [kind for kind in KINDS if kind in table]
    if len(kinds) != 1:
        raise UserError(f"[simulator]: give exactly one of {', '.join(KINDS)}")
    if not isinstance(table[kinds[0]], str):
        raise UserError(f"[simulator] {kinds[0]}: must be a text that names a file")
    simulator = KINDS[kinds[0]].make(table, folder, ([s.name for s in states], [s.name for s in commands], [p.field for p in parameters]))
    return simulator, tuple(_valued(simulator, p) for p in parameters)


def _valued(simulator, parameter):
    if isfinite(parameter.value):
        return parameter
    if not hasattr(simulator, "value"):
        raise UserError(f"[[parameter]] {parameter.name}: value must be a number: what the simulator has now")
    value = simulator.value(parameter.field)
    if not parameter.low <= value <= parameter.high:
        raise UserError(f"[[parameter]] {parameter.name}: the model has {value:g}, which is not between low and high")
    return replace(parameter, value=value)
