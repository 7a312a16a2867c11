"""A C function in a shared library: int step(const double *x, const double *u, double dt, const double *params, double *x_next)."""

import ctypes
import os
from itertools import repeat

import numpy as np

from ...plumbing.errors import UserError

# Addresses, not typed pointers: making one costs more than most simulators' step.
ARGUMENTS = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)
# The library's own names first: else its calls of its own `step` reach the C library's old function of that name.
MODE = getattr(os, "RTLD_DEEPBIND", 0)


def _rows(array):
    """Addresses of the rows of an array (W, k)."""
    first, size = array.ctypes.data, array.shape[1] * array.itemsize
    return range(first, first + len(array) * size, size) if size else repeat(first)


class Library:
    def __init__(self, function, place):
        self.function, self.place = function, place

    def step(self, x, u, dt, params):
        x, u, params = (np.ascontiguousarray(a, float) for a in (x, u, params))
        after, function, numbers = np.empty_like(x), self.function, params.ctypes.data
        for at, command, to in zip(_rows(x), _rows(u), _rows(after)):
            status = function(at, command, dt, numbers, to)
            if status:
                state = np.array2string(x[_rows(x).index(at)], precision=4)
                raise UserError(f"{self.place}: returns {status} for the state {state}; return 0")
        return after


KEYS = ()


def make(table, folder, names):
    place = table["library"]
    file, _, name = place.rpartition(":")
    path = folder / file
    if not file or not path.is_file():
        raise UserError(f"{place}: there is no file {path}; compile it, and write FILE.so:NAME, relative to the robot's file")
    try:
        function = getattr(ctypes.CDLL(str(path.resolve()), MODE), name)
    except (OSError, AttributeError) as error:
        raise UserError(f"{place}: {error}; NAME is a function that the library exports") from error
    function.argtypes, function.restype = ARGUMENTS, ctypes.c_int
    return Library(function, place)
