"""A function of the user's: step(x (W, n), u (W, m), dt, params (p,)) -> x_next (W, n)."""

import importlib.util

import numpy as np

from ...plumbing.errors import UserError


def load(place, folder):
    """What FILE.py:NAME names."""
    file, _, name = place.rpartition(":")
    path = folder / file
    if not file or not path.is_file():
        raise UserError(f"{place}: there is no file {path}; write FILE.py:NAME, relative to the robot's file")
    spec = importlib.util.spec_from_file_location(f"tinykoop_robot_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise UserError(f"{path}: cannot be imported: {type(error).__name__}: {error}") from error
    if not callable(getattr(module, name, None)):
        raise UserError(f"{path}: has no function {name}")
    return getattr(module, name)


class Python:
    def __init__(self, function, place):
        self.function, self.place = function, place

    def step(self, x, u, dt, params):
        try:
            after = self.function(x, u, dt, params)
        except Exception as error:
            raise UserError(f"{self.place}: raises {type(error).__name__}: {error}") from error
        after = np.asarray(after, float)
        if after.shape != x.shape:
            raise UserError(f"{self.place}: returns shape {after.shape} for {x.shape} states; return one row for each")
        return after


KEYS = ()


def make(table, folder, names):
    return Python(load(table["python"], folder), table["python"])
