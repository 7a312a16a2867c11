"""Dictionaries that are written in C: the compiler of this computer makes a shared library of them, which is loaded."""

import ctypes as ct
import os
import re
import shlex
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from ..plumbing import checkout
from ..plumbing.errors import UserError
from .dictionaries import Given
from .library import loaded

# The warnings are those of lib/. Nothing is contracted, so that the bits are those of firmware. Hidden symbols do not take
# the place of others of the same name in this process.
FLAGS = (
    "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Werror -O2 -ffp-contract=off -fPIC -shared"
    " -fvisibility=hidden"
).split()

# KOOP and KOOP_REAL stand for one precision, as in the library's own sources.
AROUND = """#include "tinykoop.h"
#define KOOP(name) {koop}_##name
#define KOOP_REAL {real}
#include "{file}"
__attribute__((visibility("default"))) const {koop}_dictionary *tinykoop_given(void);
const {koop}_dictionary *tinykoop_given(void) {{ return &{constant}; }}
"""
# A source that has the dictionary in float alone: in double it lifts by float, and keeps the state as it is.
WIDENED = """
static void tinykoop_lift_widened(const koopd_dictionary *self, const double *x, double *psi) {{
	float narrow[KOOP_MAX_DIM] = {{0}}, lifted[KOOP_MAX_DIM] = {{0}};
	for (size_t i = 0; i < self->n_states; i++) {{ narrow[i] = (float)x[i]; }}
	{constant}.lift(&{constant}, narrow, lifted);
	for (size_t i = 0; i < self->n_lifted; i++) {{ psi[i] = i < self->n_states ? x[i] : (double)lifted[i]; }}
}}
__attribute__((visibility("default"))) const koopd_dictionary *tinykoop_widened(void);
const koopd_dictionary *tinykoop_widened(void) {{
	static koopd_dictionary widened = {{NULL, 0, 0, tinykoop_lift_widened, NULL}};
	widened.name = {constant}.name;
	widened.n_states = {constant}.n_states;
	widened.n_lifted = {constant}.n_lifted;
	return &widened;
}}
"""


def _first_error(said, source, file):
    """Line of a compiler's messages that says what is wrong, with the file as the user named it."""
    found = re.search(r"^(.+?):(\d+):(?:\d+:)? (?:fatal )?error: (.+)$", said, re.M)
    if not found:
        return f"{file}: {(said.strip().splitlines() or ['the compiler says nothing'])[-1]}"
    where, line, message = found.groups()
    return f"{file}: {message}" if where == str(source) else f"{where.replace(str(Path(file).resolve()), str(file))}:{line}: {message}"


def _compile(code, file, folder, stem):
    """The library that is made of this C code, loaded."""
    source, target, compiler = folder / f"{stem}.c", folder / f"{stem}.so", shlex.split(os.environ.get("CC") or "cc")
    source.write_text(code)
    command = [*compiler, *FLAGS, "-I", checkout.data("lib", "_lib/c") / "include", source, loaded(), "-lm", "-o", target]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", env={**os.environ, "LC_ALL": "C"}, timeout=120)
    except FileNotFoundError:
        raise UserError(f"{file}: there is no C compiler '{compiler[0]}': install gcc, or name yours, as in CC=clang") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"{file}: compiling it with '{compiler[0]}' failed: {error}") from None
    if done.returncode:
        raise UserError(_first_error(done.stderr, source, file))
    try:
        return ct.CDLL(str(target))
    except OSError as error:
        raise UserError(f"{file}: the compiled file cannot be loaded: {str(error).removeprefix(f'{target}: ')}") from None


def _pointer(library, function):
    give = getattr(library, function)
    give.restype = ct.POINTER(Given)
    return give()


@cache
def compiled(file, name, text):
    """(pointer to the koopf_dictionary, pointer to the koopd_dictionary) NAME of the C file with this text. Raises UserError."""
    both = re.search(rf"\bKOOP\s*\(\s*{name}\s*\)|\bkoopd_{name}\b", text)
    single = f"koopf_{name}" if both or re.search(rf"\bkoopf_{name}\b", text) else name
    if not re.search(rf"\b(koop[fd]_)?{name}\b", text):
        raise UserError(f"{file}: it defines no '{name}'; NAME is the constant of type koopf_dictionary")
    told = {"file": Path(file).resolve(), "constant": single}
    with tempfile.TemporaryDirectory() as folder:
        f32 = _compile(
            AROUND.format(**told, koop="koopf", real="float") + ("" if both else WIDENED.format(**told)), file, Path(folder), "f32"
        )
        if not both:
            return _pointer(f32, "tinykoop_given"), _pointer(f32, "tinykoop_widened")
        code = AROUND.format(**told | {"constant": f"koopd_{name}"}, koop="koopd", real="double")
        return _pointer(f32, "tinykoop_given"), _pointer(_compile(code, file, Path(folder), "f64"), "tinykoop_given")
