"""What input asks for and may not be there: packages, and names."""

import difflib
from importlib import import_module

from . import checkout
from .errors import UserError

LISTED = 12  # names that are said where none is near
LONGEST = 80  # characters of a name


def package(name, extra):
    """An optional package, of tools/requirements-EXTRA.txt."""
    try:
        return import_module(name)
    except ImportError:
        raise UserError(f"the package {name.partition('.')[0]} is missing; {checkout.install(extra)}") from None


def plain(name):
    """A name that a file has, as a message of one line can say it."""
    return "".join(c if c.isprintable() else "?" for c in str(name))[:LONGEST]


def near(name, names):
    """The names that are like one, as a message lists them; the first ones where none is."""
    found = difflib.get_close_matches(name, names, 3, 0.3) or sorted(names)[:LISTED]
    return ", ".join(map(plain, found)) or "none at all"


def among(name, names, where, what):
    """Refuses a name that is none of names, and says which are near."""
    if name not in names:
        raise UserError(f"{where}: there is no {what} {name}; there is {near(name, names)}")
