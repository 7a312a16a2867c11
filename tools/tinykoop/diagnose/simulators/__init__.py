"""From the user's model to a Simulator: one file for each kind of model."""

from ...errors import UserError
from . import python, shared_library

# key of [simulator] in a robot's TOML -> make(where, folder, description) gives a Simulator
KINDS = {"python": python.make, "library": shared_library.make}


def make(table, folder, sizes):
    """The Simulator that a TOML's [simulator] names; sizes: (states, commands, parameters)."""
    kinds = [kind for kind in KINDS if kind in table]
    if len(kinds) != 1:
        raise UserError(f"[simulator]: give exactly one of {', '.join(KINDS)}")
    return KINDS[kinds[0]](table[kinds[0]], folder, sizes)
