"""Dictionaries of your own: how a state is lifted, from parts that the C library has, by a C source, or by any Python function.

A dictionary lifts states x (K, n) to psi (K, N): the state itself, then the functions of each part. Parts are put
together by ``+``. What is made of parts runs in C, in float32 or float64, and ``c_code`` writes it for firmware: there
it gives the same bits. The parts are those of ``koopf_combine`` in tinykoop_api.h.
"""

import re
import runpy
import zlib
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from . import bridge
from .bridge.compiler import compiled
from .bridge.dictionaries import Compiled, Own, Part
from .plumbing.errors import UserError
from .plumbing.results import console, output_folder, printable, write_bytes

BUILT_IN = ("poly", "rbf")  # of every platform
AFFINE = "affine"  # the state and a constant, of every platform
KERNELS = ("gaussian", "inverse_quadratic", "inverse_multiquadric", "multiquadric", "thin_plate")


def _indices(states: Sequence[int] | None, count: int) -> tuple[int, ...]:
    """Indices of states, by default the first `count`."""
    found = tuple(range(count)) if states is None else tuple(int(i) for i in states)
    if any(not 0 <= i < 255 for i in found):
        raise ValueError(f"states are {found}: they are indices from 0 on")
    return found


class Dictionary:
    """Base of all dictionaries that are made of parts; ``a + b`` has the functions of both, in this order."""

    def parts(self, n: int) -> list[Part]:
        """The parts, for states of n values."""
        raise NotImplementedError

    def __add__(self, other: "Dictionary") -> "Combined":
        return Combined(self, other)

    def name(self, n: int) -> str:
        """Name that a stored model keeps: it differs between settings, so that firmware refuses a model of others."""
        told = repr([(p.kind, p.states, p.wrapped, p.low, p.high, p.kernel) for p in self.parts(n)]).encode()
        numbers = [np.ascontiguousarray(a, np.float64).tobytes() for p in self.parts(n) for a in (p.centers, p.widths) if a is not None]
        return f"parts_{zlib.crc32(b''.join([told, *numbers])):08x}"

    def own(self, n: int) -> Own:
        """The dictionary in C, for states of n values. Raises UserError for settings that the library refuses."""
        return Own(self.name(n), n, self.parts(n))


class RBF(Dictionary):
    """Radial basis functions of the distance from centers, kernel(distance / sigma).

    centers: (count, k), units of the states; sigma: one width for all, or (count,), same units; states: indices of the
    k states that the centers are of, by default the first k; kernel: one of KERNELS, gaussian being exp(-r^2 / 2).
    """

    def __init__(self, centers, sigma, states: Sequence[int] | None = None, kernel: str = "gaussian"):
        self.centers, self.sigma, self.states, self.kernel = centers, sigma, states, kernel

    def parts(self, n):
        if self.kernel not in KERNELS:
            raise ValueError(f"kernel is {self.kernel!r}; it must be one of {', '.join(KERNELS)}")
        centers = np.atleast_2d(np.asarray(self.centers, np.float64))
        states = _indices(self.states, centers.shape[1])
        if len(states) != centers.shape[1]:
            raise ValueError(f"centers have {centers.shape[1]} columns, but {len(states)} states are named")
        widths = np.broadcast_to(np.asarray(self.sigma, np.float64), len(centers)).copy()
        return [Part("rbf", states, centers=centers, widths=widths, kernel=self.kernel)]


class Poly(Dictionary):
    """All monomials of the named states (default: all) with a total degree from `low` to `degree`, at most 8.

    The states themselves, of degree 1, are in every dictionary: low is 2 unless you need a constant (0) or them twice.
    """

    def __init__(self, degree: int = 2, states: Sequence[int] | None = None, low: int = 2):
        self.degree, self.states, self.low = degree, states, low

    def parts(self, n):
        return [Part("polynomials", _indices(self.states, n), low=int(self.low), high=int(self.degree))]


class Products(Dictionary):
    """x[i] x[j] of each pair (i, j)."""

    def __init__(self, pairs: Sequence[tuple[int, int]]):
        self.pairs = pairs

    def parts(self, n):
        return [Part("products", _indices([i for pair in self.pairs for i in pair], 0))]


class Angles(Dictionary):
    """Sine and cosine of the named states (rad), and the angle in [-pi, pi] if `wrapped`."""

    def __init__(self, states: Sequence[int], wrapped: bool = False):
        self.states, self.wrapped = states, wrapped

    def parts(self, n):
        return [Part("angles", _indices(self.states, 0), wrapped=bool(self.wrapped))]


class Constant(Dictionary):
    """The function 1, for what acts always, as gravity does."""

    def parts(self, n):
        return [Part("constant")]


class Combined(Dictionary):
    """The functions of several dictionaries, one after another."""

    def __init__(self, *dictionaries: Dictionary):
        self.dictionaries = dictionaries

    def parts(self, n):
        return [part for dictionary in self.dictionaries for part in dictionary.parts(n)]


class Function:
    """A dictionary by a Python function, which need not be wrapped if it takes many states at once.

    function: from states (K, n) to psi (K, N), whose first n columns are the states; or with each=True from one state
    (n,) to psi (N,), which is slower. name: what a stored model keeps; firmware needs a dictionary of this name.
    """

    def __init__(self, function: Callable[[np.ndarray], np.ndarray], each: bool = False, name: str | None = None):
        self.function, self.each, self.name = function, each, name

    def __str__(self):
        return "a Python function"

    def lift(self, x: np.ndarray) -> np.ndarray:
        """psi (K, N) of states (K, n). Raises ValueError if the function gives anything else."""
        with np.errstate(all="ignore"):  # what is not finite is refused by its row
            psi = np.array([self.function(row) for row in x]) if self.each else np.asarray(self.function(x))
        if psi.ndim != 2 or len(psi) != len(x) or psi.shape[1] < x.shape[1]:
            raise ValueError(f"the dictionary made an array of shape {psi.shape} of states of shape {x.shape}; it must be (K, N), N >= n")
        if not np.array_equal(psi[:, : x.shape[1]], x, equal_nan=True):
            raise ValueError(f"the dictionary must begin with the state: its first {x.shape[1]} columns differ from x")
        return np.ascontiguousarray(psi, np.float64)

    def own(self, n: int) -> Own:
        """The dictionary as the library knows it, for states of n values."""
        name = self.name or getattr(self.function, "__name__", "function")
        return Own(name, n, n_lifted=self.lift(np.zeros((1, n))).shape[1], lift=self.lift)


class CSource:
    """A dictionary in C, as firmware compiles it: the koopf_dictionary `name` of a file, which may be static.

    The compiler is ``$CC``, or ``cc``. In float64 the koopd_dictionary is used that the file defines by
    ``KOOP(dictionary) KOOP(name)`` and ``KOOP_REAL``; a file without one is lifted in float32 there, too.
    """

    def __init__(self, file: str | Path, name: str):
        self.file, self.name = str(file), re.sub("^koop[fd]_", "", name)

    def __str__(self):
        return f"{self.file}:{self.name}"

    def own(self, n: int) -> Compiled:
        """The compiled dictionary, for states of n values. Raises UserError if it does not compile or fit."""
        if not re.fullmatch(r"[A-Za-z_]\w*", self.name, re.ASCII):
            raise UserError(f"{self}: NAME is the name of a constant in the C file")
        try:
            text = Path(self.file).read_text(errors="replace")
        except OSError as error:
            raise UserError(f"{self.file}: {error.strerror}") from None
        pointers = compiled(self.file, self.name, text)
        try:
            own = Compiled(*pointers)
        except UserError as error:
            raise UserError(f"{self}: {error}") from None
        if own.n != n:
            raise UserError(f"{self}: it lifts states of {own.n} values, but these have {n}")
        return own


def of(dictionary):
    """A dictionary of this module, or the name of a built-in one, from what a user gave."""
    if isinstance(dictionary, (str, Dictionary, Function, CSource)):
        return dictionary
    if callable(dictionary):
        return Function(dictionary)
    raise TypeError(f"dictionary is {dictionary!r}; give a name such as 'rbf_ddr', RBF(..), Poly(..), a sum of such, or a function")


def named(text: str, platform: str, n: int) -> str | Own:
    """What bridge.Estimator takes of a --dictionary: `poly` or `rbf` of a platform, or that of a file for states of n values."""
    return f"{text}_{platform}" if text in BUILT_IN else _own(text, n)


def _own(text, n):
    """The dictionary of a file, for states of n values."""
    given = from_file(text)
    try:
        return given.own(n)
    except Exception as error:  # of whatever kind: a function is the user's
        if isinstance(given, CSource) and isinstance(error, UserError):  # which names the file
            raise
        told = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        raise UserError(f"{text}, for states of {n} values: {told}") from None


def check(estimator: "bridge.Estimator", x: np.ndarray, used: np.ndarray, dictionary: str) -> None:
    """Raises UserError, with the row, if the dictionary of an estimator is not finite for a used (K) state of x (K, n)."""
    if used.any():
        try:
            estimator.lift(np.where(used[:, None], x, x[np.argmax(used)]))
        except UserError as error:
            raise UserError(f"{dictionary}: {error}") from None


def fingerprint(estimator: "bridge.Estimator") -> tuple[np.ndarray, np.ndarray]:
    """Sums of psi at eight fixed states, and of its magnitudes: they differ where functions of the same name do. NaN where lifting fails."""
    row, column = np.mgrid[:8, : estimator.n]
    states = np.sin(1.0 + 7 * row + 3 * column) * 3.0 ** (row % 4 - 2)  # up to 1/9, 1/3, 1 and 3, in m and rad
    weights = np.cos(1.0 + np.arange(estimator.N))
    psi = np.array([_lifted(estimator, state) for state in states])
    return psi @ weights, np.abs(psi) @ np.abs(weights)


def _lifted(estimator, state):
    try:
        return estimator.lift(state[None])[0]
    except Exception:  # of whatever kind: the function is the user's, and was made for other states
        return np.full(estimator.N, np.nan)


def is_as(estimator: "bridge.Estimator", sums: Sequence[float]) -> bool:
    """Whether the dictionary of an estimator has these sums, up to the round-off of another machine or precision."""
    now, size = fingerprint(estimator)
    return len(sums) == len(now) and bool(np.all((np.abs(now - sums) <= 1e-5 * size) | (np.isnan(now) & np.isnan(sums))))


@cache
def from_file(text: str) -> "Dictionary | Function | CSource":
    """AFFINE, or the dictionary of FILE.py:NAME, whose file is run once, or of FILE.c:NAME. Raises UserError if it is not there or none."""
    if text == AFFINE:
        return Constant()
    file, _, name = text.rpartition(":")
    if not file.endswith((".py", ".c")) or not name:
        raise UserError(
            f"--dictionary {text}: give {', '.join((*BUILT_IN, AFFINE))}, FILE.py:NAME, a dictionary or a function in a Python file,"
            " or FILE.c:NAME, a koopf_dictionary in a C file"
        )
    if file.endswith(".c"):
        return CSource(file, name)
    try:
        module = runpy.run_path(file)
    except OSError as error:
        raise UserError(f"--dictionary {file}: {error.strerror}") from None
    except Exception as error:  # of whatever kind: the file is the user's
        raise UserError(f"--dictionary {file}: running it failed with {type(error).__name__}: {error}") from None
    if name not in module:
        raise UserError(f"--dictionary {file}: it defines no {name!r}")
    if isinstance(module[name], str):
        raise UserError(f"--dictionary {text}: it is a text; give a dictionary or a function")
    try:
        return of(module[name])
    except TypeError as error:
        raise UserError(f"--dictionary {text}: {error}") from None


# ---- C code ------------------------------------------------------------------------------------------


def comment(text: str) -> str:
    """A C comment, which no text ends early, nor opens again."""
    return f"/* {re.sub(r'(?<=[*])(?=/)|(?<=/)(?=[*])', ' ', text)} */"


def _reals(values, bits):
    """C literals of exactly these values."""
    return ", ".join(float(np.float32(v)).hex() + "f" if bits == 32 else float(v).hex() for v in np.ravel(values))


def _part_code(part, prefix, koop, bits):
    """(definitions, initializer of koopX_part) of one part."""
    if part.kind == "constant":
        return [], f"{{&{koop}_part_constant, NULL}}"
    lines = [f"static const unsigned char {prefix}_states[] = {{{', '.join(map(str, part.states))}}};"]
    fields = {"angles": f", {int(part.wrapped)}", "polynomials": f", {part.low}, {part.high}"}.get(part.kind, "")
    if part.kind == "rbf":
        real = "float" if bits == 32 else "double"
        lines += [
            f"static const {real} {prefix}_centers[] = {{{_reals(part.centers, bits)}}};",
            f"static const {real} {prefix}_widths[] = {{{_reals(part.widths, bits)}}};",
        ]
        fields = f", {len(part.widths)}, {prefix}_centers, {prefix}_widths, &{koop}_{part.kernel}"
    lines.append(f"static const {koop}_{part.kind} {prefix} = {{{prefix}_states, {part.n}{fields}}};")
    return lines, f"{{&{koop}_part_{part.kind}, &{prefix}}}"


def _n_lifted(own):
    return bridge.Estimator(own, "none", 64, n_inputs=1).N


def c_code(dictionary: Dictionary, n: int, name: str, precision: str = "f32") -> str:
    """C source of a dictionary of parts for n states: its sizes, and `NAME_dictionary(koopX_dictionary *)`, which makes it."""
    bits, koop = (32, "koopf") if precision == "f32" else (64, "koopd")
    n_lifted = _n_lifted(dictionary.own(n))  # own() refuses what the library refuses
    lines, parts = [], []
    for i, part in enumerate(dictionary.parts(n)):
        made, entry = _part_code(part, f"{name}_part_{i}", koop, bits)
        lines += made
        parts.append(entry)
    return "\n".join([
        f"enum {{ {name}_n_states = {n}, {name}_n_lifted = {n_lifted} }};",
        *lines,
        f"static const {koop}_part {name}_parts[] = {{{', '.join(parts)}}};",
        f"static const {koop}_combination {name}_combination = {{{name}_parts, {len(parts)}}};",
        "",
        "/* Makes the dictionary. Its name is that of these settings. */",
        f"static inline int {name}_dictionary({koop}_dictionary *dictionary) {{",
        f'\treturn {koop}_combine(dictionary, "{dictionary.name(n)}", {n}, &{name}_combination);',
        "}",
        "",
    ])  # fmt: skip


def export(text: str, header: str | Path, n: int, bits: int = 32) -> None:
    """Writes the C code of the dictionary of parts FILE.py:NAME for n states to a header, all of whose names begin with NAME."""
    if text in BUILT_IN:
        raise UserError(
            f"{text}: it is in the library, as koopf_{text}_ddr and koopf_{text}_fwmav, and of a quadrotor in what `tinykoop fit` writes; give FILE.py:NAME"
        )
    header, (_, _, name), given = Path(header), text.rpartition(":"), from_file(text)
    if header.suffix != ".h":
        raise UserError(f"{header}: the dictionary is written as a C header; choose the ending .h")
    if isinstance(given, CSource):
        raise UserError(f"{text}: it is C already; compile it into the firmware as it is")
    if isinstance(given, Function):
        raise UserError(
            f"{text}: there is no C code for {given}; put it together of parts (RBF, Poly, Products, Angles, Constant), or write it in C"
            " and give FILE.c:NAME instead"
        )
    if not name.isascii():
        raise UserError(f"{text}: C names have ASCII letters only; give the dictionary such a name")
    sizes = f"n = {n}, N = {_n_lifted(_own(text, n))}"
    guard, told = f"{name}_DICTIONARY_H".upper(), comment(f"TinyKoop dictionary {printable(text)}: float{bits}, {sizes}")
    code = f'{told}\n#ifndef {guard}\n#define {guard}\n\n#include "tinykoop.h"\n\n{c_code(given, n, name, f"f{bits}")}\n#endif\n'
    output_folder(header.parent)
    write_bytes(header, code.encode())
    console.print(f"{name}_dictionary(), float{bits}, {sizes}: in {printable(header)}")
