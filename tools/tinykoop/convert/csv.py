"""Your own CSV, with any names, units and delimiter: what is not named as here, the user maps."""

import numpy as np

from . import table
from .log import FlatLog, Series


def is_mine(path, head):
    """Lines of text of which the second has numbers, of the same columns as the first."""
    lines = head.decode("utf-8-sig", "replace").splitlines()
    return b"\0" not in head and len(lines) > 1 and any(map(is_number, table.parted(*lines[:2])[1]))


def is_number(cell):
    try:
        return np.isfinite(table.number(cell, ";"))
    except ValueError:
        return False


def open_log(path, damaged):
    return OwnLog(path, damaged)


class OwnLog(FlatLog):
    mend = "add the column"
    timed = ("t",)

    def __init__(self, path, damaged):
        super().__init__(path, table.header(path)[0])
        self.damaged, self.clock = damaged, None
        self.usual = {name: (name,) for name in self.names()}

    def quadrotor(self):
        return {}

    def clocked(self, chosen):
        self.clock = chosen.pop("t")
        return chosen

    def read(self, names, commands):
        (clock,) = self.clock.names
        data = table.read(self.path, {clock, *names}, self.damaged)
        t = data[clock] * self.clock.factor
        return {name: samples(t, data[name]) for name in names}


def samples(t, x):
    """Series of a column: an empty cell is no sample, as where logs of several rates were joined."""
    there = np.isfinite(x)
    return Series(t[there], x[there])
