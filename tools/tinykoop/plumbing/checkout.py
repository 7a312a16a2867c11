"""The checkout of the project. An installed package has none: it has its data inside, and refuses what developers' commands work on."""

import os
from pathlib import Path

from .errors import UserError

PACKAGE = Path(__file__).resolve().parents[1]
ROOT = PACKAGE.parents[1]
EXISTS = PACKAGE == ROOT / "tools/tinykoop" and (ROOT / "Makefile").is_file()
OUT = ROOT / "build/out" if EXISTS else Path("tinykoop-out")  # results


def need(what):
    """Refuses arguments of the command that work on the files of the project, where there are none."""
    if not EXISTS:
        raise UserError(
            f"{what}: needs a checkout of TinyKoop, and this is an installed package; "
            f"in a checkout, run `make build`, then build/venv/bin/tinykoop {what}"
        )


def data(source, inside):
    """A file that the package needs, named from the root of a checkout and from the package, into which an installation puts it."""
    return ROOT / source if EXISTS else PACKAGE / inside


def cache(name):
    """A folder for what takes long to compute."""
    home = ROOT / "build" if EXISTS else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tinykoop"
    return home / name


def install(extra):
    """How the optional packages of tools/requirements-EXTRA.txt are installed."""
    return f"build/venv/bin/pip install -r tools/requirements-{extra}.txt" if EXISTS else f'pip install "tinykoop[{extra}]"'
