"""`make targets` without a cross toolchain: what it says is missing, how it reads what the targets print, and
what it compares."""

import copy
import json
import re

import pytest
from tinykoop.firmware import callgraph, cycles, targets
from tinykoop.plumbing import pages
from tinykoop.plumbing.errors import UserError

ALL = {"arm-none-eabi-gcc", "riscv64-unknown-elf-gcc", "qemu-system-arm", "qemu-system-riscv32"}


def absent(*tools, specs=True):
    there = ALL - set(tools)
    return targets.missing(which=lambda name: name if name in there else None, has_specs=lambda compiler: specs)


def test_names_the_packages_that_are_missing():
    assert absent() == []
    assert absent("qemu-system-riscv32") == ["qemu-system-misc"]
    assert absent("arm-none-eabi-gcc") == ["gcc-arm-none-eabi", "picolibc-arm-none-eabi"]
    assert absent(specs=False) == ["picolibc-arm-none-eabi", "picolibc-riscv64-unknown-elf"]
    assert len(absent(*ALL)) == 6


def test_installs_nothing_and_gives_the_command(monkeypatch, tmp_path):
    monkeypatch.setattr(targets, "missing", lambda: ["qemu-system-arm", "gcc-arm-none-eabi"])
    monkeypatch.setattr(targets.subprocess, "run", lambda *a, **k: pytest.fail("something was run"))
    with pytest.raises(UserError, match="sudo apt-get install qemu-system-arm gcc-arm-none-eabi$"):
        targets.run(tmp_path / "out")


# ---- targets ---------------------------------------------------------------------------------------


def test_a_target_is_a_folder_with_two_files():
    assert {"cortex-m4f", "cortex-m7", "cortex-m55", "cortex-m0plus", "rv32imafc"} <= set(targets.targets())
    for name in targets.targets():
        assert {path.name for path in (targets.FOLDER / name).iterdir()} == {"toolchain.cmake", "memory.ld"}
    runs = {name for name in targets.targets() if targets.Tree(name, "O2").runs}
    assert runs == set(targets.targets()) - {"cortex-m0plus"}


def test_tests_that_are_left_out_exist_and_have_a_reason():
    subjects = {path.stem.removeprefix("test_") for path in (targets.ROOT / "test/c").glob("test_*.c")}
    tests = {f"{subject}_{precision}" for subject in subjects for precision in ("koopf", "koopd")}
    for where, what, why in targets.LEFT_OUT:
        assert any(re.fullmatch(what, test) for test in tests), what
        assert any(re.fullmatch(f"{where}.*", target) for target in targets.targets()), where
        assert why
    for target in targets.targets():
        kept = {test for test in tests if not targets.left_out(target, test)}
        assert {f"{subject}_koopf" for subject in subjects - {"mpc_random", "supervisor", "long_run", "gate"}} <= kept
    assert not targets.left_out("cortex-m7", "supervisor_koopf")


# ---- closed loop -----------------------------------------------------------------------------------

HOST = "run poly\n0x1p+0 0x1p+1\n0x1p+1 0x1p+1\nrun rbf\n0x1p+0 0x0p+0\n"


def test_equal_loops_differ_by_nothing():
    assert targets.compare_loops(HOST, HOST) == {"poly": 0, "rbf": 0}


def test_a_difference_is_relative_to_its_column():
    other = HOST.replace("run poly\n0x1p+0", "run poly\n0x1.8p+0")
    assert targets.compare_loops(HOST, other) == {"poly": 0.25, "rbf": 0}


@pytest.mark.parametrize("other", ["", "run poly\n", HOST.replace("0x1p+1 0x1p+1\nrun", "run"), HOST.split("run rbf")[0]])
def test_a_loop_that_is_cut_short_differs(other):
    assert max(targets.compare_loops(HOST, other).values()) == float("inf")


def test_a_host_that_prints_nothing_is_no_reference():
    with pytest.raises(UserError):
        targets.compare_loops("", HOST)


def test_not_a_number_differs():
    other = HOST.replace("0x1p+1 0x1p+1\nrun", "0x1p+1 nan\nrun")
    assert targets.compare_loops(HOST, other) == {"poly": float("inf"), "rbf": 0}


# ---- footprint -------------------------------------------------------------------------------------


def printed():
    lines = []
    for n in targets.SIZES:
        lines += [f"instructions {n} lift - {n} {n + 1}"]
        for f, form in enumerate(targets.FORMS):
            lines += [f"instructions {n} {name} {form} {10 * n + f} {10 * n + f + 1}" for name in targets.REGULATORS]
        for k, kind in enumerate(("warm", "cold", "condense")):
            lines += [f"instructions {n} mpc {kind} {1000 * k + n} {2000 * k + n}"]
        lines += [f"ram {n} 100 200"]
    return "\n".join([*lines, "stack koopf_rls_update 300", "stack koopf_mpc_solve 400"])


def test_reads_what_the_program_prints():
    counted = targets.Counted.read(printed())
    assert counted.ram[22] == (100, 200)
    assert counted.stack["koopf_mpc_solve"] == 400
    row = targets.instructions(counted.instructions[22])
    assert row["lift"] == 22
    assert row["rls_update"]["ef"] == 221 and row["rls_update_plain"]["ef"] != row["rls_update_plain_checked"]["ef"]
    assert row["mpc_solve"] == {"warm": 22, "cold": 1022, "condense": 2022, "worst": 2022}


def weighed(*calls):
    return "".join(f"weighed {' '.join(map(str, call))}\n" for call in calls)


def test_cycles_are_of_the_calls_between_two_reports():
    text = weighed((0, 0, 0), (100, 150, 120), (110, 170, 130), (90, 140, 110)) + "instructions 7 lift - 100 110\n"
    text += weighed((20, 30, 25)) + "instructions 7 none sqrt 20 20\n"
    counted = targets.Counted.read(text)
    assert counted.instructions[7] == {("lift", "-"): (100, 110), ("none", "sqrt"): (20, 20)}
    assert counted.cycles[7] == {("lift", "-"): [(150, 170), (120, 130)], ("none", "sqrt"): [(30, 30), (25, 25)]}
    assert targets.Counted.read(printed()).cycles == {}


def test_weighed_instructions_must_be_those_of_the_clock():
    assert targets.estimates([(1_000_000, 1, 1)], (1_000_900, 1_000_900))
    with pytest.raises(UserError, match="weighed 1000000 instructions where QEMU's clock counted 1001100"):
        targets.estimates([(1_000_000, 1, 1)], (1_000_000, 1_001_100))
    with pytest.raises(UserError):
        targets.estimates([(100, 1, 1)], (117, 100))


def test_a_row_has_the_same_figures_in_cycles():
    counted = targets.Counted.read(printed())
    doubled = {key: [(2 * median, 2 * worst), (3 * median, 3 * worst)] for key, (median, worst) in counted.instructions[22].items()}
    row = targets.estimated("cortex-m4f", doubled)
    assert row["VMLA 3"]["lift"] == 44 and row["VMLA 1"]["lift"] == 66
    assert row["VMLA 3"]["mpc_solve"]["worst"] == 2 * targets.instructions(counted.instructions[22])["mpc_solve"]["worst"]


def test_what_must_hold_of_a_row():
    row = {**rows()[0], "foreign": [], "stack_seen": {"koopf_lift": 116, "koopf_rls_update": 316}}
    row["stack"] = {"koopf_lift": 100, "koopf_rls_update": 300}
    assert targets.check(row) == []
    row["stack_seen"] = None
    assert targets.check(row) == []
    bad = {**row, "stack": {"koopf_lift": 513, "koopf_rls_update": 300}, "stack_seen": {"koopf_rls_update": 317}}
    bad |= {"bss": 4, "foreign": ["malloc"]}
    lines = targets.check(bad)
    assert [line.removeprefix("chip -O2: ") for line in lines] == [
        "koopf_lift may take 513 bytes of stack",
        "koopf_rls_update took 317 bytes of stack, not 300",
        "4 bytes of writable globals in bss",
        "koopf.c needs malloc",
    ]


@pytest.mark.parametrize(
    "name", ["malloc", "printf", "sin", "sinf", "expf", "sqrt", "__aeabi_dadd", "__aeabi_f2d", "__adddf3", "__extendsfdf2", "__truncdfsf2"]
)
def test_heap_printing_and_double_arithmetic_are_foreign(name):
    assert targets.foreign_names(f"         U sqrtf\n         U {name}\n") == [name]


def test_what_a_soft_float_target_needs_is_not_foreign():
    assert targets.foreign_names(" U memcpy\n U sqrtf\n U __aeabi_fadd\n U __aeabi_fcmplt\n U __aeabi_uidiv\n") == []


# ---- against what is committed ---------------------------------------------------------------------


def rows():
    counted = targets.Counted.read(printed())
    return [
        {
            "target": "chip",
            "precision": "f32",
            "config": f"N{n}_m2_H50_O2",
            "text": 1000,
            "text_learn": 500,
            "data": 0,
            "bss": 0,
            "stack": {"koopf_lift": 100},
            "ram": {"learn": 100, "control": 200},
            "instructions": targets.instructions(counted.instructions[n]),
            "cycles": None,
        }
        for n in targets.SIZES
    ]


def test_equal_figures_are_no_change():
    assert targets.changes(rows(), rows()) == []


@pytest.mark.parametrize("grown, told", [(1050, False), (1051, True), (900, False)])
def test_growth_beyond_five_percent_is_told(grown, told):
    now = rows()
    now[1]["text"] = grown
    assert targets.changes(rows(), now) == [f"chip N22_m2_H50_O2 text: {grown}, was 1000"] * told


def test_growth_from_nothing_is_told():
    now = rows()
    now[0]["data"] = 4
    assert targets.changes(rows(), now) == ["chip N7_m2_H50_O2 data: 4, was 0"]


def test_new_and_vanished_figures_are_told():
    now = copy.deepcopy(rows())
    now[0]["stack"] = {"koopf_more": 8}
    name = "chip N7_m2_H50_O2 stack"
    assert targets.changes(rows(), now) == [f"{name} koopf_more: 8, is new", f"{name} koopf_lift: gone, was 100"]
    assert len(targets.changes(rows(), rows()[:1])) == len(targets.figures(rows())) / 2
    assert len(targets.changes([], rows())) == len(targets.figures(rows()))


def test_committed_figures_are_of_every_target_and_level():
    committed = json.loads(targets.COMMITTED.read_text())
    seen = {(row["target"], row["config"]) for row in committed}
    assert seen == {(t, f"N{n}_m2_H50_{level}") for t in targets.targets() for n in targets.SIZES for level in targets.LEVELS}
    for row in committed:
        assert row["data"] == 0 and row["bss"] == 0 and row["foreign"] == []
        assert list(row["cycles"] or ()) == list(cycles.ESTIMATES.get(row["target"], ()))


@pytest.mark.parametrize("name", targets.PAGES)
def test_the_table_in_the_docs_is_of_the_committed_figures(name):
    text = (targets.ROOT / name).read_text()
    assert pages.between_markers(text, "footprint", targets.PAGES[name](json.loads(targets.COMMITTED.read_text()))) == text


def test_pages_are_rewritten_between_the_markers_only(monkeypatch, tmp_path):
    begin, end = "<!-- learn: begin, written by make learn UPDATE=1 -->", "<!-- learn: end -->"
    other = "<!-- control: begin, by hand -->\nkept\n<!-- control: end -->"
    page = tmp_path / "page.md"
    page.write_text(f"before\n{begin}\nold\n{end}\nbetween\n{other}\nafter\n")
    monkeypatch.setattr(pages, "ROOT", tmp_path)
    pages.update("page.md", "learn", "new\n")
    assert page.read_text() == f"before\n{begin}\n\nnew\n\n{end}\nbetween\n{other}\nafter\n"
    with pytest.raises(UserError, match="no markers 'supervisor: begin'"):
        pages.update("page.md", "supervisor", "new\n")


# ---- call graph ------------------------------------------------------------------------------------


def test_calls_through_tables_count(tmp_path):
    source = tmp_path / "source.c"
    source.write_text("x = rls->config.form->gain(rls);\n")
    graph = (
        'node: { title: "koopf_f" label: "koopf_f\\n10 bytes (static)" }\n'
        'node: { title: "s.c:plain_gain" label: "plain_gain\\n20 bytes (static)" }\n'
        'node: { title: "s.c:sqrt_gain" label: "sqrt_gain\\n30 bytes (static)" }\n'
        f'edge: {{ sourcename: "koopf_f" targetname: "__indirect_call" label: "{source}:1:5" }}\n'
    )
    relocations = "RELOCATION RECORDS FOR [.rodata.table]:\n00 R_ARM_ABS32  plain_gain\n04 R_ARM_ABS32  .text.sqrt_gain\n"
    relocations += "RELOCATION RECORDS FOR [.srodata.kernel]:\n00 R_RISCV_32  values_gaussian\n"
    tables = callgraph.held_in_tables(relocations)
    assert tables == {"plain_gain", "sqrt_gain", "values_gaussian"}
    assert callgraph.deepest(graph, tables) == {"koopf_f": (40, ["koopf_f", "sqrt_gain"])}
