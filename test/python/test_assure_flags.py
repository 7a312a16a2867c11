"""`make flags` without its builds: the flags it reads, which of them a compiler takes, what it runs and what it says."""

import json
import re

import pytest
from tinykoop.assure import flags
from tinykoop.firmware import targets
from tinykoop.plumbing.errors import UserError

DATA = json.loads(flags.DATA.read_text())
STRICT, LOOSE = flags.FlagSet("strict", ("-O2",)), flags.FlagSet("loose", ("-Ofast",), emulated=True)

FAILED_TEST = """exit status 1: build/test/test_gate_koopf
test/c/test_gate.c:93:test_outliers_are_refused:PASS
test/c/test_gate.c:120:test_nan_is_refused:FAIL: status 0
test/c/test_gate.c:140:test_other:FAIL: status 0
"""
FAILED_BUILD = """exit status 2: cmake --build build/flags/gcc-x86-64
[  1%] Building C object koopf.c.o
lib/src/rls.c:12:3: error: comparing floating-point with '==' [-Werror=float-equal]
gmake: *** [Makefile:1: all] Error 2"""


# ---- the data ------------------------------------------------------------------------------------------------


def test_every_stack_says_where_its_flags_were_read():
    for row in DATA["stacks"]:
        assert row["read_from"] and row["note"] and re.fullmatch(r"[\w-]+/[\w-]+", row["repository"])
        for file, commit in row["read_from"]:
            assert file and re.fullmatch("[0-9a-f]{40}", commit)


def test_the_stacks_that_are_promised_are_there():
    names = [row["name"] for row in [*DATA["stacks"], *DATA["ours"]]]
    assert len(set(names)) == len(names)
    assert {"PX4", "ArduPilot", "Betaflight", "INAV", "Crazyflie", "Zephyr", "ESP-IDF", "-ffast-math", "-Ofast"} <= set(names)
    assert any(name.startswith("Arduino") for name in names)
    emulated = {row.name for row in flags.read_sets(DATA) if row.emulated}
    assert {"PX4", "Betaflight"} <= emulated


def test_every_word_of_the_data_is_a_flag():
    for row in flags.read_sets(DATA):
        assert row.flags and all(re.fullmatch(r"-[fWOsw][\w=+-]*", flag) for flag in row.flags), row


def test_warnings_are_flags_of_lib_and_link_flags_are_not():
    row = flags.flag_set({"name": "a", "flags": "-O2", "warnings": "-Wall -Werror", "link": "-ffast-math"})
    assert row == flags.FlagSet("a", ("-O2", "-Wall", "-Werror"), "-ffast-math")


def test_the_page_shows_the_data():
    page = (flags.ROOT / "docs/microcontroller.md").read_text()
    assert flags.markdown(DATA) in page, f"put this in its place:\n{flags.markdown(DATA)}"


# ---- which flags a compiler takes ---------------------------------------------------------------------------


@pytest.fixture
def gcc():
    return flags.Tree("gcc", flags.HOST)


def test_a_flag_that_needs_company_is_not_dropped(gcc):
    company = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")
    assert not gcc.accepts(company[:1])
    assert flags.split(company, gcc.accepts) == (company, ())


def test_what_a_compiler_does_not_know_is_dropped_and_named(gcc):
    assert flags.split(("-O2", "-fno-such-flag"), gcc.accepts) == (("-O2",), ("-fno-such-flag",))


# ---- one compiler -------------------------------------------------------------------------------------------


class Stand(flags.Tree):
    """A tree whose library is its optimisation level, and whose tests fail under -Ofast."""

    def __init__(self, target=flags.HOST, compiler="gcc"):
        super().__init__(compiler, target)
        self.tried = []

    def accepts(self, some):
        return True

    def build(self, kept, link):
        if "-Wbroken" in kept:
            raise UserError(FAILED_BUILD)
        self.now = kept[0]

    def library(self):
        return self.now

    def failures(self, names):
        self.tried.append(self.now)
        return ["gate_koopf: FAIL"] if self.now == "-Ofast" else []


def test_tests_are_run_once_per_library():
    tree = Stand()
    again = flags.FlagSet("loose again", ("-Ofast", "-fno-common"))
    rows = [tree.row(some) for some in (STRICT, LOOSE, again)]
    assert tree.tried == ["-O2", "-Ofast"]
    assert [row["failed"] for row in rows] == [[], ["gate_koopf: FAIL"], ["gate_koopf: FAIL"]]
    assert [row["same_as"] for row in rows] == [None, None, "loose"]


def test_other_link_flags_are_another_program():
    tree = Stand()
    for some in (LOOSE, flags.FlagSet("linked", LOOSE.flags, link="-ffast-math")):
        tree.row(some)
    assert tree.tried == ["-Ofast", "-Ofast"]


def test_a_build_that_fails_says_its_first_error():
    row = Stand().row(flags.FlagSet("broken", ("-O2", "-Wbroken")))
    assert row["failed"] == ["build: lib/src/rls.c:12:3: error: comparing floating-point with '==' [-Werror=float-equal]"]


def test_the_remedy_that_the_library_asks_for_is_put_behind_the_flags_but_on_a_microcontroller():
    class Refusing(Stand):
        def build(self, kept, link):
            if flags.REMEDY not in kept:
                raise UserError(f"strict.h:9:2: error: {flags.REFUSAL} behind -ffast-math")
            super().build(kept, link)

    refused = [f"build: strict.h:9:2: error: {flags.REFUSAL} behind -ffast-math"]
    for compiler, failed in (("clang-19", []), ("gcc", []), (flags.CROSS, refused)):
        tree = Refusing(compiler=compiler)
        row = tree.row(STRICT)
        assert row["failed"] == failed and tree.tried == ([] if failed else ["-O2"])


def test_a_failed_test_says_its_first_assertion():
    assert flags.complaint("gate_koopf", FAILED_TEST) == "gate_koopf: test/c/test_gate.c:120:test_nan_is_refused:FAIL: status 0"
    assert flags.complaint("mpc_koopf", "no end after 120 s: test_mpc_koopf") == "mpc_koopf: no end after 120 s: test_mpc_koopf"


def test_the_host_runs_all_tests_of_both_precisions():
    subjects = {path.stem.removeprefix("test_") for path in flags.TESTS.glob("test_*.c")}
    assert set(flags.Tree("gcc", flags.HOST).names) == {f"{subject}_{p}" for subject in subjects for p in ("koopf", "koopd")}


def test_the_emulated_processor_runs_float32_and_the_sets_meant_for_it():
    tree = Stand(flags.EMULATED)
    assert tree.names and all(name.endswith("_koopf") and not targets.left_out(flags.EMULATED, name) for name in tree.names)
    assert tree.meant([STRICT, LOOSE]) == [LOOSE] and Stand().meant([STRICT, LOOSE]) == [STRICT, LOOSE]


def test_what_is_left_out_exists_has_a_reason_and_is_not_run():
    subjects = {path.stem.removeprefix("test_") for path in flags.TESTS.glob("test_*.c")}
    (row,) = [row for row in flags.read_sets(DATA) if row.left_out]
    assert row.link and set(row.left_out) <= subjects and len(flags.reasons(DATA)) == len(row.left_out)
    names = Stand().names_under(row)
    assert set(Stand().names) - set(names) == {f"{subject}_{p}" for subject in row.left_out for p in ("koopf", "koopd")}
    assert Stand().row(row)["tests"] == len(names)


def test_flags_reach_lib_as_a_list_and_the_toolchain_keeps_its_linker_flags(monkeypatch):
    asked = []
    monkeypatch.setattr(flags, "run_command", lambda *command: asked.append(command))
    flags.Tree("gcc", flags.HOST).configure(("-Ofast", "-Wall"), "-ffast-math")
    flags.Tree("arm-none-eabi-gcc", flags.EMULATED).configure(("-Ofast",))
    assert "-DTINYKOOP_LIBRARY_FLAGS=-Ofast;-Wall;-Wfatal-errors" in asked[0] and "-DCMAKE_EXE_LINKER_FLAGS=-ffast-math" in asked[0]
    assert not any("EXE_LINKER_FLAGS" in str(word) for word in asked[1])


# ---- the self-test ------------------------------------------------------------------------------------------


@pytest.fixture
def lib(monkeypatch, tmp_path):
    """Makes a stand-in of lib/ with this strict.h, whose self-tests find loose arithmetic in this way."""

    def make(strict, finds):
        for name in ("src", "include"):
            (tmp_path / "lib" / name).mkdir(parents=True)
        (tmp_path / "lib/src/strict.h").write_text(strict)
        (tmp_path / "lib/include/tinykoop.h").write_text("enum { KOOP_OK = 0 };\nint koopf_self_test(void), koopd_self_test(void);\n")
        for unit in ("koopf", "koopd"):
            text = f'#include "src/strict.h"\nint {unit}_self_test(void) {{ return {finds}; }}\n'
            (tmp_path / f"lib/{unit}.c").write_text(text)
        monkeypatch.setattr(flags, "ROOT", tmp_path)
        monkeypatch.setattr(flags, "BUILD", tmp_path / "build")

    return make


STRICT_H = '#pragma GCC optimize("no-fast-math")\n'


def test_a_self_test_that_finds_loose_arithmetic_passes(lib):
    lib(STRICT_H, "__FINITE_MATH_ONLY__")
    assert flags.self_test_row("gcc")["failed"] == []


@pytest.mark.parametrize("strict, finds, told", [(STRICT_H, "0", "exit status 1"), ("", "1", "no #pragma")])
def test_a_self_test_that_finds_nothing_fails_and_so_does_nothing_to_be_left_out(lib, strict, finds, told):
    lib(strict, finds)
    (line,) = flags.self_test_row("gcc")["failed"]
    assert line.startswith("self_test: ") and told in line


# ---- the command --------------------------------------------------------------------------------------------


@pytest.fixture
def one_tree(monkeypatch):
    tree = Stand()
    monkeypatch.setattr(tree, "configure", lambda: None)
    monkeypatch.setattr(flags, "trees", lambda: [tree])
    monkeypatch.setattr(flags, "self_test_row", lambda compiler: flags.result("self-test", compiler, flags.HOST, 1, []))


def test_what_failed_is_named_after_the_results_are_written(one_tree, monkeypatch, tmp_path):
    monkeypatch.setattr(flags, "read_sets", lambda data: [STRICT, LOOSE])
    with pytest.raises(UserError, match="1 failures\nloose, gcc, x86-64: gate_koopf: FAIL"):
        flags.run(tmp_path)
    assert [row["stack"] for row in json.loads((tmp_path / "flags.json").read_text())] == ["strict", "loose", "self-test"]


def test_a_fault_of_our_own_is_not_taken_for_a_result(one_tree, monkeypatch, tmp_path):
    monkeypatch.setattr(Stand, "failures", lambda tree, names: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        flags.run(tmp_path)


def test_strict_sets_alone_pass(one_tree, monkeypatch, tmp_path):
    monkeypatch.setattr(flags, "read_sets", lambda data: [STRICT])
    row, _ = flags.run(tmp_path)
    assert row["failed"] == [] and row["tests"] == len(Stand().names)


def test_compilers_that_are_missing_are_left_out():
    def only_gcc(name):
        return name if name == "gcc" else None

    assert [tree.compiler for tree in flags.trees(only_gcc)] == ["gcc"]
    assert [tree.target for tree in flags.trees(lambda name: name)] == [flags.EMULATED] + [flags.HOST] * len(flags.COMPILERS)


def test_one_compiler_can_be_chosen_and_one_that_is_not_here_is_refused():
    here = [flags.Tree("gcc", flags.HOST), flags.Tree(flags.CROSS, flags.EMULATED)]
    assert flags.chosen(here, None) == here
    assert flags.chosen(here, [flags.CROSS]) == here[1:]
    with pytest.raises(UserError, match="--compiler icc: not one of those that are here: gcc, arm-none-eabi-gcc"):
        flags.chosen(here, ["icc"])


def test_one_set_can_be_chosen_and_one_that_nobody_compiles_with_is_refused():
    sets = flags.read_sets(json.loads(flags.DATA.read_text()))
    assert flags.named(sets, None) == sets
    assert [chosen.name for chosen in flags.named(sets, ["PX4", "Betaflight"])] == ["PX4", "Betaflight"]
    with pytest.raises(UserError, match="--set OpenPilot: not one of PX4, "):
        flags.named(sets, ["OpenPilot"])
