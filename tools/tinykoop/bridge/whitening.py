"""The Kalman filter of host_sim/: whiten.c for many columns under one noise, deviances.c for one residual under several."""

import ctypes as ct

import numpy as np

from .library import address, call, reals


class _Noise(ct.Structure):
    _fields_ = [(name, ct.c_size_t) for name in ("n", "r", "c")] + [
        (name, ct.c_void_p) for name in ("start", "C", "process", "process_rho", "coloured", "coloured_rho")
    ]


class _Path(ct.Structure):
    _fields_ = [(name, ct.c_void_p) for name in ("begins", "A", "G", "variance")]


class Filter:
    """What the Kalman filter makes of a noise along a path of K rows, for any columns; log_det: sum of the log variances of innovations."""

    def __init__(self, begins, A, G, variance, start, C, process, process_rho, coloured, coloured_rho):
        if not np.any(coloured):
            coloured = coloured_rho = None
        arrays = [None if a is None else reals(a) for a in (A, G, variance, start, C, process, process_rho, coloured, coloured_rho)]
        self._kept = np.ascontiguousarray(begins, np.int32), *arrays  # what the addresses are of
        begins, A, G, variance, start, C, *noise = self._kept
        (K, n, r), c = G.shape, variance.shape[1]
        gains, units, log_det = np.empty((K, c, n + r + c * (coloured is not None))), np.empty((K, c)), ct.c_double()
        self._noise, self._path = _Noise(n, r, c, *map(address, (start, C, *noise))), _Path(*map(address, (begins, A, G, variance)))
        call(
            "tk_gains", ct.byref(self._noise), ct.c_size_t(K), ct.byref(self._path), address(gains), address(units), ct.byref(log_det)
        )  # fmt: skip
        self._gains, self.log_det = (gains, units), log_det.value

    def whiten(self, D, E):
        """Innovations (K, c, q) over their standard deviations, of columns D (K, n, q), E (K, c, q), or (K, c, 1) for all."""
        D, E = reals(D), reals(E)
        (K, c, shown), q = E.shape, D.shape[-1]
        out = np.empty((K, c, q))
        call(
            "tk_whiten", ct.byref(self._noise), ct.c_size_t(K), ct.c_size_t(q), ct.c_int(shown < q), ct.byref(self._path),
            *map(address, self._gains), address(D), address(E), address(out),
        )  # fmt: skip
        return out


class _Noises(ct.Structure):
    _fields_ = [(name, ct.c_size_t) for name in ("count", "n", "r", "c")] + [
        (name, ct.c_void_p) for name in ("start", "C", "process", "process_rho", "white", "coloured", "coloured_rho")
    ]


class Deviances:
    """Of one residual, D (K, n) and E (K, c), along a path of K rows, under any noises: -2 log likelihood but for a constant."""

    def __init__(self, begins, A, G, present, start, C, D, E):
        self._kept = np.ascontiguousarray(begins, np.int32), *map(reals, (A, G, present, start, C, D, E))
        begins, A, G, present, start, C, D, E = self._kept
        self._shape, self._of_path = (*G.shape[1:], E.shape[1]), (address(start), address(C))
        self._path = _Path(*map(address, (begins, A, G, present)))
        self._arguments = ct.c_size_t(len(G)), ct.byref(self._path), address(D), address(E)

    def under(self, process, process_rho, white, coloured, coloured_rho):
        """Deviances (m,) under m noises, whose rows are process (m, r), white (m, c), .."""
        if not np.any(coloured):
            coloured = coloured_rho = None
        rows = [None if a is None else reals(a) for a in (process, process_rho, white, coloured, coloured_rho)]
        out = np.empty(len(process))
        noises = _Noises(len(out), *self._shape, *self._of_path, *map(address, rows))
        call("tk_deviances", ct.byref(noises), *self._arguments, address(out))
        return out
