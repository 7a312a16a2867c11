"""What follows a command row by row, by host_sim/followers.c."""

import ctypes as ct

import numpy as np

from .library import address, raw, reals


def _followed(name, u, size):
    u = reals(u)
    out = np.empty_like(u)
    raw(name, ct.c_size_t(len(u)), ct.c_double(size), address(u), address(out))
    return out


def play(u, half):
    """Behind a gear with play of `half` to either side, for commands u (K,); it begins in the middle."""
    return _followed("tk_play", u, half)


def limited_rate(u, most):
    """The mean over each row of what goes to the command by `most` per row; it begins there."""
    return _followed("tk_limited_rate", u, most)


def pole(u, at):
    """y[k] = at y[k - 1] + u[k] (K,), from zero, by a real or complex number `at`."""
    u, at = reals(u), complex(at)
    at, out = reals([at.real, at.imag]), np.empty(len(u), complex)
    raw("tk_pole", ct.c_size_t(len(u)), address(at), address(u), address(out))
    return out
