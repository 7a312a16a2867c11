"""The shared library of host_sim/ by ctypes: how it is found and called, and how arrays are passed.

Arrays are float64 and row-major whatever precision the estimator works in. What the C side
refuses is raised as UserError with its message.
"""

import ctypes as ct
import os
import sys
from pathlib import Path

import numpy as np

from ..plumbing import checkout
from ..plumbing.errors import UserError

# The variable is for a build with sanitizers.
_NAME = "libtinykoop_sim" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")
_LIBRARY = Path(os.environ.get("TINYKOOP_SIM") or checkout.data(f"build/host/host_sim/{_NAME}", f"_lib/{_NAME}"))
_REMEDY = "is not built: run `make build` first" if checkout.EXISTS else "is missing: pip install --force-reinstall --no-deps tinykoop"

DOUBLES = ct.POINTER(ct.c_double)
INTS = ct.POINTER(ct.c_int32)


def _load():
    if not _LIBRARY.exists():
        raise UserError(f"{_LIBRARY.name} {_REMEDY}")
    c = ct.CDLL(str(_LIBRARY))
    for name in ("tk_message", "tk_status_message", "tk_effect_name", "tk_effect_formula", "tk_effect_family", "tk_effect_reported_as"):
        getattr(c, name).restype = ct.c_char_p
    for name in ("tk_effect_parameters", "tk_log_rows"):
        getattr(c, name).restype = ct.c_size_t
    c.tk_log_dt.restype = ct.c_double
    return c


_c = None


def raw(name, *arguments):
    """What a function of the library returns."""
    global _c
    if _c is None:
        _c = _load()
    return getattr(_c, name)(*arguments)


def loaded():
    """Path of the library, which is loaded then."""
    raw("tk_message")
    return _LIBRARY


def call(name, *arguments):
    """Raises what the library says of arguments that it refuses."""
    if raw(name, *arguments) != 0:
        raise UserError(raw("tk_message").decode("utf-8", "backslashreplace"))


def reals(array, columns=None):
    """An array as C takes it."""
    array = np.ascontiguousarray(array, dtype=np.float64)
    if columns is not None and (array.ndim != 2 or array.shape[1] != columns):
        raise ValueError(f"expected an array of {columns} columns, got shape {array.shape}")
    return array


def doubles(array):
    return None if array is None else array.ctypes.data_as(DOUBLES)


def ints(array):
    return None if array is None else array.ctypes.data_as(INTS)


def address(array):
    """As doubles(), in a third of the time, for arrays of any type that the caller keeps."""
    return None if array is None else ct.c_void_p(array.ctypes.data)
