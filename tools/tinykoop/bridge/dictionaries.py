"""Dictionaries of the user's own, as the library takes them."""

import ctypes as ct
from typing import NamedTuple

import numpy as np

from .library import DOUBLES, call, doubles, raw, reals


class _Part(ct.Structure):
    _fields_ = [
        ("kind", ct.c_char_p),
        ("n", ct.c_size_t),
        ("states", ct.c_char_p),
        ("wrapped", ct.c_int),
        ("low", ct.c_size_t),
        ("high", ct.c_size_t),
        ("count", ct.c_size_t),
        ("centers", DOUBLES),
        ("widths", DOUBLES),
        ("kernel", ct.c_char_p),
    ]


class Part(NamedTuple):
    """Settings of one part: kind and, as far as the kind has them, the fields of koopf_angles, koopf_rbf, .. of tinykoop_api.h."""

    kind: str
    states: tuple = ()  # indices of states; of products, two for each
    wrapped: bool = False
    low: int = 0
    high: int = 0
    centers: np.ndarray | None = None  # (count, n), units of the states
    widths: np.ndarray | None = None  # (count,)
    kernel: str = "gaussian"

    @property
    def n(self):
        """Number of states, or of pairs of them."""
        return len(self.states) // (2 if self.kind == "products" else 1)


class Own:
    """A dictionary in both precisions: of Parts, or of n_lifted functions by `lift`, from states (K, n) to psi (K, N).

    lift is None for parts, which the library lifts.
    """

    def __init__(self, name, n_states, parts=(), n_lifted=None, lift=None):
        self.handle, self.name, self.lift = ct.c_void_p(), name, lift
        if lift:
            sizes = ct.c_size_t(n_states), ct.c_size_t(n_lifted)
            call("tk_dictionary_outside", name.encode(), *sizes, ct.byref(self.handle))
            return
        array = (_Part * max(len(parts), 1))()
        kept = [(part, *(None if a is None else reals(a) for a in (part.centers, part.widths))) for part in parts]
        for c, (part, centers, widths) in zip(array, kept):
            c.kind, c.n, c.states = part.kind.encode(), part.n, bytes(part.states)
            c.wrapped, c.low, c.high, c.kernel = part.wrapped, part.low, part.high, part.kernel.encode()
            c.count, c.centers, c.widths = 0 if widths is None else len(widths), doubles(centers), doubles(widths)
        call("tk_dictionary_new", name.encode(), ct.c_size_t(n_states), ct.c_size_t(len(parts)), array, ct.byref(self.handle))

    def __del__(self):
        if getattr(self, "handle", None):
            raw("tk_dictionary_free", self.handle)


class Given(ct.Structure):
    """koopf_dictionary or koopd_dictionary of a compiled source."""

    _fields_ = [
        ("name", ct.c_char_p),
        ("n_states", ct.c_size_t),
        ("n_lifted", ct.c_size_t),
        ("lift", ct.c_void_p),
        ("context", ct.c_void_p),
    ]


class Compiled(Own):
    """A dictionary of a compiled source, by pointers to Given in float and in double. The library must stay loaded."""

    def __init__(self, f32, f64):
        self.handle, self.lift = ct.c_void_p(), None
        call("tk_dictionary_given", f32, f64, ct.byref(self.handle))
        self.name, self.n = f32.contents.name.decode(errors="replace"), f32.contents.n_states
