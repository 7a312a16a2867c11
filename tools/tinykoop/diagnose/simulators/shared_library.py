"""A C function in a shared library: int step(const double *x, const double *u, double dt, const double *params, double *x_next)."""

import ctypes

import numpy as np

from ...errors import UserError

REAL = ctypes.POINTER(ctypes.c_double)


class Library:
    def __init__(self, function, place):
        self.function, self.place = function, place

    def step(self, x, u, dt, params):
        x, u, params = (np.ascontiguousarray(a, float) for a in (x, u, params))
        after = np.empty_like(x)
        at = lambda a: a.ctypes.data_as(REAL)  # noqa: E731
        for row in range(len(x)):
            status = self.function(at(x[row]), at(u[row]), dt, at(params), at(after[row]))
            if status:
                raise UserError(f"{self.place}: returns {status} for the state {np.array2string(x[row], precision=4)}; return 0")
        return after


KEYS = ()


def make(table, folder, names):
    place = table["library"]
    file, _, name = place.rpartition(":")
    path = folder / file
    try:
        function = getattr(ctypes.CDLL(str(path.resolve())), name)
    except (OSError, AttributeError) as error:
        raise UserError(f"{place}: {error}; write FILE.so:NAME, relative to the robot's file") from error
    function.argtypes = (REAL, REAL, ctypes.c_double, REAL, REAL)
    function.restype = ctypes.c_int
    return Library(function, place)
