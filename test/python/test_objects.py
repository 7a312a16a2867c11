"""What the compiled library promises, read from its object files: no warnings, no heap, no writable data,
no double arithmetic in float32, no recursion, bounded stack, and only its own names."""

import os
import platform
import re
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from tinykoop.firmware.callgraph import calls, cycle, deepest, held_in_tables

ROOT = Path(__file__).resolve().parents[2]
LIB = ROOT / "lib"
UNITS = {"koopf": "f", "koopd": ""}  # suffix of its functions of <math.h>
STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion",
          "-Wvla", "-Werror"]  # fmt: skip
# what distributions switch on by themselves, off: it adds symbols that a microcontroller does not have
BARE = ["-fno-pie", "-fno-stack-protector", "-U_FORTIFY_SOURCE", "-ffp-contract=off"]
STACK = 512  # bytes that a function may take
# what gcc notes beside an object; each function in a section of its own, so that it can be told apart
GRAPH = ["-fcallgraph-info=su", "-ffunction-sections"]
NO_GRAPH = "this gcc has no -fcallgraph-info"

MATH = ["sqrt", "sin", "cos", "exp", "atan2", "fabs"]
MEMORY = {"memcpy", "memmove", "memset", "memcmp", "strlen"}
DOUBLE_ARITHMETIC = re.compile(
    r"\b(v?(add|sub|mul|div|sqrt|min|max|u?comi|cmp\w*|round|fn?m(add|sub)\d*)[sp]d"
    r"|v?cvt\w*[sp]d(2\w+)?|f(add|sub|mul|div|ld|stp?|sqrt)[slpt]?)\b"
)

compilers = [
    pytest.param(c, marks=[] if shutil.which(c) else pytest.mark.skip(f"{c} is not installed"))
    for c in ("gcc", "clang-19" if shutil.which("clang-19") else "clang")
]
needs = {tool: pytest.mark.skipif(not shutil.which(tool), reason=f"{tool} is not installed") for tool in ("gcc", "g++", "nm", "objdump")}
only_x86 = pytest.mark.skipif(platform.machine() != "x86_64", reason="knows the mnemonics of x86_64 only")


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@lru_cache
def notes(compiler):
    """Options that make gcc note the stack of each function, and who calls whom where it can."""
    if compiler != "gcc":
        return []
    with TemporaryDirectory() as folder:
        command = ["gcc", *GRAPH, "-x", "c", "-c", os.devnull, "-o", f"{folder}/nothing.o"]
        known = subprocess.run(command, capture_output=True).returncode == 0
    return ["-fstack-usage", *(GRAPH if known else [])]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """compiled(compiler, unit, optimise): path of the object file, with gcc's notes beside it; each is compiled once."""
    known = {}

    def get(compiler, unit, optimise):
        key = (compiler, unit, optimise)
        if key not in known:
            out = tmp_path_factory.mktemp("objects") / f"{unit}.o"
            source = LIB / f"{unit}.c"
            run(compiler, *STRICT, *BARE, optimise, *notes(compiler), f"-I{LIB / 'include'}", "-c", source, "-o", out)
            known[key] = out
        return known[key]

    return get


@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("compiler", compilers)
def test_compiles_without_a_warning(compiled, compiler, unit, optimise):
    """-Wvla too: no array grows with an argument."""
    compiled(compiler, unit, optimise)


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("compiler", compilers)
def test_compiles_strictly_or_says_which_flag_to_add(tmp_path, compiler, unit, flag):
    """Microcontrollers' GCC is told by the file itself. Clang cannot be told of arguments that are NaN, GCC on x86 not of their order."""
    command = [compiler, flag, f"-I{LIB / 'include'}", "-c", LIB / f"{unit}.c", "-o", tmp_path / "out.o"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        remedy = re.search(r"TinyKoop: add (-\S+) behind", done.stderr)
        done = subprocess.run([*command, remedy[1]], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@needs["g++"]
def test_headers_are_cxx(tmp_path):
    source = tmp_path / "user.cpp"
    source.write_text("""
        #include "tinykoop.h"
        static float storage32[KOOP_RLS_REALS_SQRT(22, 2)];
        static double storage64[KOOP_RLS_REALS_PLAIN(7, 2)];
        int main() {
            koopf_config single = {&koopf_rbf_ddr, 2, &koopf_reg_ct, 0, &koopf_form_sqrt, 0.98f, 100,
                                   KOOP_CHECK_REFUSE, 0};
            koopd_config both = {&koopd_poly_ddr, 2, &koopd_reg_ef, 0, &koopd_form_plain, 0.98, 100,
                                 KOOP_CHECK_REFUSE, 0};
            koopf_rls f;
            koopd_rls d;
            return koopf_rls_init(&f, &single, storage32, sizeof storage32 / sizeof *storage32) +
                   koopd_rls_init(&d, &both, storage64, sizeof storage64 / sizeof *storage64);
        }
    """)
    for standard in ("c++11", "c++17"):
        run("g++", f"-std={standard}", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only",
            f"-I{LIB / 'include'}", source)  # fmt: skip


@needs["gcc"]
def test_header_stands_alone(tmp_path):
    source = tmp_path / "user.c"
    source.write_text('#include "tinykoop.h"\nint main(void) { return KOOP_OK; }\n')
    run("gcc", *STRICT, "-fsyntax-only", f"-I{LIB / 'include'}", source)


@needs["nm"]
@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("compiler", compilers)
def test_needs_only_mathematics_and_memory_functions(compiled, compiler, unit, optimise):
    """No heap, no printing, and from <math.h> only functions of its own precision."""
    undefined = set(run("nm", "-u", compiled(compiler, unit, optimise)).split()) - {"U"}
    assert undefined <= MEMORY | {name + UNITS[unit] for name in MATH}
    assert "sqrt" + UNITS[unit] in undefined  # the check does see undefined symbols


@needs["nm"]
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("compiler", compilers)
def test_public_names_have_the_prefix(compiled, compiler, unit):
    symbols = run("nm", "-g", "--defined-only", compiled(compiler, unit, "-O2")).splitlines()
    public = [line.split()[-1] for line in symbols]
    assert len(public) > 20
    assert [name for name in public if not name.startswith(unit + "_")] == []


@needs["objdump"]
@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("compiler", compilers)
def test_has_no_writable_data(compiled, compiler, unit, optimise):
    headers = run("objdump", "-h", "-w", compiled(compiler, unit, optimise)).splitlines()
    sections = [line.split(maxsplit=7) for line in headers if re.match(r"\s+\d+ ", line)]
    assert any(name == ".text" for _, name, *_ in sections)
    for _, name, size, *_, flags in sections:
        if "ALLOC" in flags and "READONLY" not in flags and not name.startswith(".data.rel.ro"):
            assert int(size, 16) == 0, name


@only_x86
@needs["objdump"]
@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("compiler", compilers)
def test_float32_computes_nothing_in_double(compiled, compiler, optimise):
    """A microcontroller with a single-precision FPU would do it in software, a hundred times slower."""
    found = {}
    for unit in UNITS:
        code = run("objdump", "-d", "--no-show-raw-insn", compiled(compiler, unit, optimise))
        found[unit] = DOUBLE_ARITHMETIC.findall(code)
    assert found["koopf"] == []
    assert len(found["koopd"]) > 100  # the check does find it where it is


@needs["gcc"]
@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("unit", UNITS)
def test_stack_of_each_function(compiled, unit, optimise):
    usage = compiled("gcc", unit, optimise).with_suffix(".su").read_text().splitlines()
    assert len(usage) > 20
    for line in usage:
        function, size, kind = line.split("\t")
        assert int(size) <= STACK, function
        assert kind == "static", function  # no alloca, no variable array


# ---- recursion -------------------------------------------------------------------------------------


def possible_calls(source, out):
    flags = ["-fcallgraph-info", "-ffunction-sections", "-O0", f"-I{LIB / 'include'}", "-c", source, "-o", out]
    if subprocess.run(["gcc", *flags], capture_output=True).returncode:
        pytest.skip(NO_GRAPH)
    return calls(out.with_suffix(".ci").read_text(), held_in_tables(run("objdump", "-r", out)))


@needs["gcc"]
@needs["objdump"]
@pytest.mark.parametrize("unit", UNITS)
def test_no_recursion(tmp_path, unit):
    reached = possible_calls(LIB / f"{unit}.c", tmp_path / f"{unit}.o")
    assert {"plain_apply", "sqrt_apply", "decide_sift", "lift_rbf_ddr"} <= set().union(*reached.values())
    assert cycle(reached) is None


@needs["gcc"]
@needs["objdump"]
@pytest.mark.parametrize("optimise", ["-O2", "-Os"])
@pytest.mark.parametrize("unit", UNITS)
def test_stack_of_public_calls(compiled, unit, optimise):
    """Frame by frame down to the last function called; that of libm is not counted."""
    out = compiled("gcc", unit, optimise)
    if GRAPH[0] not in notes("gcc"):
        pytest.skip(NO_GRAPH)
    depths = deepest(out.with_suffix(".ci").read_text(), held_in_tables(run("objdump", "-r", out)))
    assert len(depths) > 15 and depths[f"{unit}_mpc_solve"][0] > 200
    for name, (size, path) in depths.items():
        assert size <= STACK, f"{name}: {' > '.join(path)}"


@needs["gcc"]
@needs["objdump"]
def test_recursion_through_a_table_would_be_found(tmp_path):
    source = tmp_path / "odd.c"
    source.write_text("""
        struct table { int (*step)(const struct table *, int); };
        static int one_step(const struct table *self, int n) {
            return n ? self->step(self, n - 1) : 0;
        }
        const struct table table = {one_step};
        int odd(int n) { const struct table *t = &table; return t->step(t, n); }
    """)
    assert cycle(possible_calls(source, tmp_path / "odd.o")) == "one_step"
