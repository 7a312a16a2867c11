"""The Kalman filter of host_sim/: whiten.c for many columns under one noise, deviances.c for one residual under eight."""

import ctypes as ct

import numpy as np

from .library import address, call, reals

LANES = 8  # noises at once


class _Noise(ct.Structure):
    _fields_ = [(name, ct.c_size_t) for name in ("n", "r", "c")] + [
        (name, ct.c_void_p) for name in ("start", "C", "process", "process_rho", "coloured", "coloured_rho")
    ]


class _Path(ct.Structure):
    _fields_ = [(name, ct.c_void_p) for name in ("begins", "A", "G", "variance")]


def whiten(begins, A, G, variance, start, C, process, process_rho, coloured, coloured_rho, D, E):
    """(innovations (K, c, q) over their standard deviations, sum of log variances) of columns D (K, n, q), E (K, c, q)."""
    if not np.any(coloured):
        coloured = coloured_rho = None
    begins = np.ascontiguousarray(begins, np.int32)
    A, G, variance, start, C, process, process_rho, D, E = map(reals, (A, G, variance, start, C, process, process_rho, D, E))
    if coloured is not None:
        coloured, coloured_rho = reals(coloured), reals(coloured_rho)
    K, n, r = G.shape
    c, q = E.shape[1:]
    out, log_det = np.empty((K, c, q)), ct.c_double()
    noise = _Noise(n, r, c, *map(address, (start, C, process, process_rho, coloured, coloured_rho)))
    path = _Path(*map(address, (begins, A, G, variance)))
    call(
        "tk_whiten", ct.byref(noise), ct.c_size_t(K), ct.c_size_t(q), ct.byref(path), address(D), address(E), address(out),
        ct.byref(log_det),
    )  # fmt: skip
    return out, log_det.value


class _Noises(ct.Structure):
    _fields_ = [(name, ct.c_size_t) for name in ("n", "r", "c")] + [
        (name, ct.c_void_p) for name in ("start", "C", "process", "process_rho", "white", "coloured", "coloured_rho")
    ]


def deviances(begins, A, G, present, start, C, process, process_rho, white, coloured, coloured_rho, D, E):
    """Deviances (8,), -2 log likelihood but for a constant, of one residual D (K, n), E (K, c) under noises whose rows are process (8, r), white (8, c), .."""
    if not np.any(coloured):
        coloured = coloured_rho = None
    begins = np.ascontiguousarray(begins, np.int32)
    kept = [None if a is None else reals(a) for a in (A, G, present, start, C, process, process_rho, white, coloured, coloured_rho, D, E)]
    A, G, present, start, C, process, process_rho, white, coloured, coloured_rho, D, E = kept
    K, n, r = G.shape
    out = np.empty(LANES)
    noises = _Noises(n, r, E.shape[1], *map(address, (start, C, process, process_rho, white, coloured, coloured_rho)))
    path = _Path(*map(address, (begins, A, G, present)))
    call("tk_deviances", ct.byref(noises), ct.c_size_t(K), ct.byref(path), address(D), address(E), address(out))
    return out
