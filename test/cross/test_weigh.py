"""Cycles estimated of what QEMU executes: a loop whose cycles are known by hand, and the kind of every instruction
of the compiled library against its encoding."""

import itertools
import re
import shutil
import statistics
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from tinykoop.firmware import cycles, settings, targets

ROOT = Path(__file__).resolve().parents[2]
COMMON = ROOT / "targets/common"

pytestmark = pytest.mark.skipif(bool(targets.missing()), reason=f"missing: {', '.join(targets.missing())}")


def ran(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def plugin(tmp_path_factory):
    out = tmp_path_factory.mktemp("plugin") / "weigh.so"
    ran("cc", "-O2", "-fPIC", "-shared", COMMON / "weigh.c", "-o", out)
    return out


def build(target, folder, *sources):
    tree = targets.Tree(target, "O2")
    memory = ROOT / "targets" / target / "memory.ld"
    out = folder / "program"
    flags = [*tree.flags, "--specs=picolibc.specs", "-O1", "-T", memory, "--crt0=semihost", "--oslib=semihost"]
    ran(f"{tree.prefix}gcc", *flags, *sources, "-o", out)
    return tree, out


def emulate(tree, program, plugin, weights):
    machine = re.search(r"set\(TARGET_QEMU (.+)\)", (ROOT / "targets" / tree.target / "toolchain.cmake").read_text())[1]
    table = program.with_suffix(".txt")
    table.write_text(weights)
    options = ["-nographic", "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native"]
    return subprocess.run(
        [*machine.split(), *options, "-plugin", f"{plugin},table={table}", "-kernel", program], capture_output=True, text=True, timeout=60
    )


def weigh(tree, program, plugin):
    """[sums of each measurement] of what a program executes."""
    text = emulate(tree, program, plugin, cycles.weights(tree.target, tree.tool("objdump", "-d", program))).stderr
    return [list(map(int, line.split()[1:])) for line in text.splitlines() if line.startswith("weighed")]


# ---- a loop by hand --------------------------------------------------------------------------------

MAIN = """
    .syntax unified
    .thumb
    .global main
    .type main, %function
main:
    push {r4, lr}
"""

LOOP = (
    MAIN
    + """
    sub sp, #16
    mov r1, sp
    dbg #1
    movs r0, #10            @ 1
1:  ldr r2, [r1, #0]        @ 2
    ldr r3, [r1, #4]        @ 1: pipelined
    vldr s0, [r1, #8]       @ 2
    vmul.f32 s1, s0, s0     @ 1
    vadd.f32 s2, s1, s0     @ 2: uses the product at once
    vmla.f32 s3, s2, s2     @ 3 or 1, and one more
    vdiv.f32 s4, s3, s3     @ 14, and one more
    push {r2, r3}           @ 3
    pop {r2, r3}            @ 3
    subs r0, #1             @ 1
    bne 1b                  @ 1, and 2 for each of the nine times that it is taken
    dbg #2
    dbg #1
    dbg #2
    movs r0, #0
    add sp, #16
    pop {r4, pc}
"""
)


def test_a_loop_takes_the_cycles_that_a_hand_calculation_gives(tmp_path, plugin):
    source = tmp_path / "loop.s"
    source.write_text(LOOP)
    loop, nothing = weigh(*build("cortex-m4f", tmp_path, source), plugin)
    assert loop == [1 + 11 * 10, 1 + 35 * 10 + 2 * 9, 1 + 33 * 10 + 2 * 9]
    assert nothing == [0, 0, 0]


BRANCHES = (
    MAIN
    + """
    movs r4, #{odd}
    dbg #1
    cmp r4, #1              @ 1
    bne 1f                  @ 1, and 2 if taken
    nop                     @ 1
1:  nop                     @ 1
    bl  2f                  @ 1 + 2
    b   3f                  @ 1 + 2
2:  bx  lr                  @ 1 + 2
3:  dbg #2
    movs r0, #0
    pop {r4, pc}
"""
)


@pytest.mark.parametrize("odd, by_hand", [(1, [7, 13]), (0, [6, 14])])
def test_a_branch_that_is_not_taken_costs_no_refill(tmp_path, plugin, odd, by_hand):
    source = tmp_path / "branches.s"
    source.write_text(BRANCHES.replace("{odd}", str(odd)))
    assert weigh(*build("cortex-m4f", tmp_path, source), plugin) == [[*by_hand, by_hand[1]]]


def test_an_instruction_without_a_weight_ends_the_run(tmp_path, plugin):
    source = tmp_path / "loop.s"
    source.write_text(LOOP)
    tree, program = build("cortex-m4f", tmp_path, source)
    table = cycles.weights(tree.target, tree.tool("objdump", "-d", program))
    assert emulate(tree, program, plugin, table).returncode == 0
    address = next(i.address for i in cycles.disassembled(tree.tool("objdump", "-d", program)) if i.mnemonic.startswith("vdiv"))
    without = "".join(line for line in table.splitlines(True) if not line.startswith(f"{address:x} "))
    done = emulate(tree, program, plugin, without)
    assert done.returncode == 1 and f"the instruction at {address:#x} has no weight" in done.stderr
    assert emulate(tree, program, plugin, "").returncode == 1


# ---- settings ----------------------------------------------------------------------------------------


def test_the_settings_of_the_footprint_give_its_figures():
    tree = targets.Tree("cortex-m4f", "O2")
    targets.host_loop()
    tree.build(tests=False)
    row = settings.measure(tree, "-O2 -ffp-contract=off")
    (committed,) = (r for r in targets.read_committed() if (r["target"], r["config"]) == ("cortex-m4f", "N22_m2_H50_O2"))
    ours, theirs = ({key: r[key] for key in ("text", "instructions", "cycles")} | {"target": "", "config": ""} for r in (row, committed))
    assert targets.changes([theirs], [ours]) == targets.changes([ours], [theirs]) == []


# ---- kinds, by the encodings of the Armv7-M Architecture Reference Manual ------------------------------


def short_kind(code):
    """Of a 16-bit instruction."""
    top = code >> 12
    if code & 0xFF00 == 0x4700 or top == 0xD or code & 0xF800 == 0xE000 or code & 0xF500 == 0xB100:
        return "branch"
    if code & 0xFE00 in (0xB400, 0xBC00) or top == 0xC:
        return "multiple"
    if top == 5:
        return "load" if code >> 9 & 7 >= 3 else "store"
    if top in (6, 7, 8, 9):
        return "load" if code & 0x800 else "store"
    if code & 0xF800 == 0x4800:
        return "load"
    return "multiply" if code & 0xFFC0 == 0x4340 else "integer"


def float_kind(first, second):
    """Of an instruction of the floating-point unit."""
    if first & 0xFFE0 == 0xEC40 or first & 0xFF00 in (0xFE00, 0xEE00) and second & 0x10 or first >> 8 == 0xFE:
        return "float"
    if first >> 8 == 0xEE:
        operation = first >> 5 & 4 | first >> 4 & 3
        if operation == 4 or operation == 7 and first & 0xF == 1 and second & 0xC0 == 0xC0:
            return "root"
        return "accumulate" if operation in (0, 1, 5, 6) else "float"
    if first & 0x120 == 0x100:
        return "float load" if first & 0x10 else "float store"
    return "multiple"


def long_kind(first, second):
    """Of a 32-bit instruction."""
    if first & 0xEC00 == 0xEC00:
        return float_kind(first, second)
    if first & 0xFE00 == 0xE800:
        return "branch" if first & 0xFFF0 == 0xE8D0 and second & 0xFFE0 == 0xF000 else "multiple"
    if first & 0xF800 == 0xF000 and second & 0x8000:
        return "branch"
    if first & 0xFE00 == 0xF800:
        return "load" if first & 0x10 else "store"
    if first & 0xFF80 == 0xFB80:
        return "divide" if first & 0x50 == 0x10 and second & 0xF0 == 0xF0 else "multiply"
    return "multiply" if first & 0xFF80 == 0xFB00 else "integer"


LINE = re.compile(r" *[0-9a-f]+:\t([0-9a-f]{4})(?: ([0-9a-f]{4}))? *\t\S+.*")


@pytest.mark.parametrize("target", cycles.ESTIMATES)
@pytest.mark.parametrize("flags", ["-O2 -ffp-contract=off", "-Os -ffp-contract=fast"])
def test_the_kind_of_every_instruction_of_the_library_is_that_of_its_encoding(tmp_path, target, flags):
    tree, out = targets.Tree(target, "O2"), tmp_path / "koopf.o"
    ran(f"{tree.prefix}gcc", *tree.flags, *flags.split(), f"-I{ROOT / 'lib/include'}", "-c", ROOT / "lib/koopf.c", "-o", out)
    seen = {}
    for line in tree.tool("objdump", "-d", out).splitlines():
        if not (codes := LINE.fullmatch(line)):
            continue
        (instruction,) = cycles.disassembled(line)
        first, second = (int(code or "0", 16) for code in codes.groups())
        assert instruction.size == (4 if codes[2] else 2) == (4 if first >> 11 >= 0x1D else 2), line
        if instruction.mnemonic.startswith("."):
            continue
        assert instruction.kind == (long_kind(first, second) if codes[2] else short_kind(first)), line
        seen[instruction.kind] = seen.get(instruction.kind, 0) + 1
    assert set(seen) >= set(cycles.KINDS) - {"divide"} and sum(seen.values()) > 8000, seen


# ---- Cortex-M7, against LLVM's own analysis of its model ----------------------------------------------

MCA = next(filter(shutil.which, ("llvm-mca", *(f"llvm-mca-{version}" for version in range(30, 13, -1)))), None)
REPEATS = 30


def straight_runs(program):
    """Instructions without a branch or a condition that follow each other, where the floating-point unit works."""
    run = []
    for now in [*program, None]:
        plain = now and now.kind not in (None, "branch", "multiple", "divide") and not re.match("it|tb", now.mnemonic)
        plain = plain and "pc" not in now.operands and re.fullmatch(r"[a-z0-9]+(\.\w+)*", now.mnemonic)
        if plain and (not run or run[-1].address + run[-1].size == now.address):
            run.append(now)
            continue
        if len(run) >= 8 and sum(i.kind in cycles.FLOAT for i in run) >= 3:
            yield run
        run = []


def analysed(run):
    """Cycles by llvm-mca, or None where it does not assemble the run, as with conditions."""
    source = ".syntax unified\n" + "".join(f"{i.mnemonic} {i.operands}\n" for i in run)
    command = [MCA, "-mtriple=thumbv7em-none-eabihf", "-mcpu=cortex-m7", f"-iterations={REPEATS}"]
    found = re.search(r"Total Cycles:\s+(\d+)", subprocess.run(command, input=source, capture_output=True, text=True).stdout)
    return found and int(found[1])


def repeated(run):
    """The same at consecutive addresses."""
    copies, address = [], 0
    for instruction in run * REPEATS:
        copies.append(replace(instruction, address=address))
        address += instruction.size
    return copies


@pytest.mark.skipif(not MCA, reason="missing: llvm-mca (Debian: llvm)")
def test_the_two_estimates_of_the_m7_lie_on_both_sides_of_llvms_analysis(tmp_path):
    tree, out = targets.Tree("cortex-m7", "O2"), tmp_path / "koopf.o"
    ran(f"{tree.prefix}gcc", *tree.flags, "-O2", "-ffp-contract=off", f"-I{ROOT / 'lib/include'}", "-c", ROOT / "lib/koopf.c", "-o", out)
    ratios = {1: [], 2: []}
    runs = straight_runs(cycles.disassembled(tree.tool("objdump", "-d", out)))
    for run in itertools.islice(runs, 45):
        if theirs := analysed(run):
            for slots, seen in ratios.items():
                seen.append(sum(cost for cost, _ in cycles.cortex_m7(repeated(run), slots)) / theirs)
    assert len(ratios[1]) > 25
    assert 0.7 < statistics.median(ratios[2]) <= 1 <= statistics.median(ratios[1]) < 1.3
