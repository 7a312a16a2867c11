"""Crazyflie client: one CSV for each log block, `Timestamp` in ms, then columns GROUP.NAME.

A block holds 26 bytes, six floats, so what a flight needs is spread over several files of one folder.
"""

import re

import numpy as np

from ..plumbing.errors import UserError
from . import table
from .choose import listed
from .variables import CrazyflieLog

MEND = "add it to a log block in cfclient and convert the folder of the session"
WRAP = 1 << 24  # ms: the radio carries 24 bits of time
VARIABLE = re.compile(r"\w+\.\w+")


def is_mine(path, head):
    """A header of a time and log variables; or a folder with such files."""
    if path.is_dir():
        return any(path.glob("*.csv"))
    names = head.split(b"\n", 1)[0].decode("utf-8-sig", "replace").split(",")
    return names[0].strip() == "Timestamp" and any(VARIABLE.fullmatch(name.strip()) for name in names[1:])


def open_log(path, damaged):
    """Every CSV of a folder, or one."""
    files = sorted(path.glob("*.csv")) if path.is_dir() else [path]
    samples = {}
    for file in files:
        for name, series in blocks(file, damaged).items():
            samples.setdefault(name, series)
    if not samples:
        raise UserError(f"{path}: no CSV in this folder; name the folder of a session, with its log blocks")
    return CrazyflieLog(path, samples, MEND)


def blocks(path, damaged):
    """{GROUP.NAME: (t, values)} of one file."""
    names, _ = table.header(path)
    variables = [name for name in names[1:] if VARIABLE.fullmatch(name)]
    if not variables:
        raise UserError(f"{path}:1: a time in ms and columns GROUP.NAME were expected, as cfclient writes; there are {listed(names)}")
    data = table.read(path, [names[0], *variables], damaged)
    good = np.isfinite(data[names[0]])
    if good.sum() < 2:
        raise UserError(f"{path}: {int(good.sum())} rows, at least 2 are needed")
    t = np.unwrap(data[names[0]][good], period=WRAP) / 1000
    return {name: (t, data[name][good]) for name in variables}
