"""Crazyflie client: one CSV for each log block, `Timestamp` in ms, then columns GROUP.NAME.

A block holds 26 bytes, six floats, so what a flight needs is spread over several files of one folder.
"""

import re
import warnings

import numpy as np
import rich.progress
from rich.markup import escape

from ..plumbing.errors import UserError
from ..plumbing.results import console
from .choose import listed
from .variables import CrazyflieLog

MEND = "add it to a log block in cfclient and convert the folder of the session"
WRAP = 1 << 24  # ms: the radio carries 24 bits of time
VARIABLE = re.compile(r"\w+\.\w+")


def is_mine(path, head):
    """A header whose second column is a log variable; or a folder with such files."""
    if path.is_dir():
        return any(path.glob("*.csv"))
    header = head.split(b"\n", 1)[0].decode("utf-8-sig", "replace").split(",")
    return len(header) > 1 and any(VARIABLE.fullmatch(name.strip()) for name in header[1:])


def open_log(path, damaged):
    """Every CSV of a folder, or one."""
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    samples = {}
    for file in files:
        for name, series in table(file, damaged).items():
            samples.setdefault(name, series)
    if not samples:
        raise UserError(f"{path}: no CSV in this folder; name the folder of a session, with its log blocks")
    return CrazyflieLog(path, samples, MEND)


def table(path, damaged):
    """{GROUP.NAME: (t, values)} of one file."""
    try:
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            header = [name.strip() for name in file.readline().split(",")]
        if not any(VARIABLE.fullmatch(name) for name in header[1:]):
            raise UserError(
                f"{path}:1: a time in ms and columns GROUP.NAME were expected, as cfclient writes; "
                f"there are {listed(header)}"
            )
        data = numbers(path, len(header), damaged)
        data = data[np.isfinite(data[:, :1]).all(axis=1)]
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path")
    if len(data) < 2:
        raise UserError(f"{path}: {len(data)} rows, at least 2 are needed")
    t = np.unwrap(data[:, 0], period=WRAP) / 1000
    return {name: (t, data[:, i]) for i, name in enumerate(header) if i and VARIABLE.fullmatch(name)}


def numbers(path, width, damaged):
    """Rows below the header: NumPy's fast reader, and where that stumbles the one that can say why."""
    try:
        with warnings.catch_warnings(), rich.progress.open(
            path, "rb", console=console, transient=True, disable=not console.is_terminal, description=escape(path.name)
        ) as file:  # fmt: skip
            warnings.simplefilter("ignore")  # no rows: said by the caller
            data = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8", comments=None)
        if not data.size or data.shape[1] == width:
            return data
    except ValueError:
        pass
    return line_by_line(path, width, damaged)


def line_by_line(path, width, damaged):
    """Says which line is bad, or leaves out a last one that is cut off."""
    rows = []
    lines = path.read_text(encoding="utf-8-sig", errors="replace").split("\n")
    for number, line in enumerate(lines[1:], 2):
        fields = line.split(",")
        try:
            if not line.strip():
                continue
            if len(fields) != width:
                raise ValueError(f"{len(fields)} fields under {width} columns")
            rows.append([float(field) for field in fields])
        except ValueError as error:
            if number < len(lines):
                raise UserError(f"{path}:{number}: {listed([error])}; mend or delete the line")
            if not damaged:
                raise UserError(f"{path}:{number}: the file is cut off in this line; --damaged leaves it out")
    return np.array(rows).reshape(-1, width)
