"""Logs of the robots that come with TinyKoop."""

import ctypes as ct
import os
from dataclasses import dataclass, field

import numpy as np

from .. import platforms
from ..plumbing.results import sweep
from .library import call, doubles, ints, raw, reals


@dataclass
class Log:
    """A log: times (s), states and commands (SI units), and the step of time.

    usable[k] is true if the transition from row k to row k + 1 is neither masked nor across a gap.
    extra: {column: (K,)} of optional columns, NaN where one has no finite number.
    """

    t: np.ndarray  # (K,) s
    x: np.ndarray  # (K, n)
    u: np.ndarray  # (K, m)
    usable: np.ndarray  # (K - 1,) bool
    dt: float  # s
    extra: dict = field(default_factory=dict)


def read_log(path, platform="ddr"):
    """Reads a CSV log (docs/logs.md) of a platform, ddr, fwmav or quadrotor; returns a Log.

    Columns that a quadrotor's log lacks are NaN in x and u.

    Raises UserError with file, line and column if the file is bad.
    """
    handle = ct.c_void_p()
    call("tk_log_read", os.fsencode(path), platform.encode(), ct.byref(handle))
    try:
        K = raw("tk_log_rows", handle)
        n, m = platforms.sizes(platform)
        t, x, u = np.empty(K), np.empty((K, n)), np.empty((K, m))
        usable = np.empty(K - 1, np.int32)
        call("tk_log_get", handle, doubles(t), doubles(x), doubles(u), ints(usable))
        return Log(t, x, u, usable.astype(bool), raw("tk_log_dt", handle))
    finally:
        raw("tk_log_free", handle)


def read_columns(path, names):
    """{name: (K,)} of those of the named columns that a CSV log has; NaN where there is no finite number.

    For a log that read_log() accepts: it has checked the rows, and it does not look at these columns.
    """
    with open(path, encoding="utf-8-sig", errors="replace", newline="\n") as file:
        header = [name.strip() for name in file.readline().split(",")]
        at = {name: header.index(name) for name in names if name in header}
        rows = [line.split(",") for line in file if line.strip("\r\n")] if at else []
    return {name: np.array([_number(row[i]) for row in rows]) for name, i in at.items()}


def _number(text):
    try:
        value = float(text)
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def write_log(path, x, u, dt, platform="ddr"):
    """Writes a CSV log of states x (K, n) and commands u (K, m), SI units, at the times k dt (s)."""
    sweep(path)
    n, m = platforms.sizes(platform)
    x, u = reals(x, n), reals(u, m)
    call(
        "tk_log_write", os.fsencode(path), platform.encode(), ct.c_size_t(len(x)), ct.c_double(dt),
        doubles(x), doubles(u),
    )  # fmt: skip
