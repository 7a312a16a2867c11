"""What a robot's file asks for and may not be there: packages, and names of a model."""

import difflib
from importlib import import_module

from ...plumbing.errors import UserError

LISTED = 12  # names that are said where none is near


def package(name):
    """The optional package that a simulator needs."""
    try:
        return import_module(name)
    except ImportError:
        remedy = "build/venv/bin/pip install -r tools/requirements-simulators.txt"
        raise UserError(f"[simulator]: the package {name.partition('.')[0]} is missing; {remedy}") from None


def among(name, names, where, what):
    """Refuses a name that is none of names, and says which are near."""
    if name not in names:
        near = difflib.get_close_matches(name, names, 3, 0.3) or sorted(names)[:LISTED]
        raise UserError(f"{where}: there is no {what} {name}; there is {', '.join(near) or 'none at all'}")
