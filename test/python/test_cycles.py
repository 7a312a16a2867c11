"""Cycles estimated from disassembly: against sums made by hand from the processors' tables."""

import pytest
from tinykoop.firmware import cycles


def program(*lines):
    """Instructions as objdump prints them, one after the other, each of two bytes unless it ends in .w."""
    text, address = "", 0x100
    for line in lines:
        mnemonic, _, operands = line.partition(" ")
        raw = "1234 5678" if mnemonic.endswith(".w") else "1234     "
        text += f" {address:x}:\t{raw} \t{mnemonic}\t{operands}\n"
        address += 4 if mnemonic.endswith(".w") else 2
    return cycles.disassembled(text)


def m4(*lines, **options):
    return [cost for cost, _ in cycles.cortex_m4(program(*lines), **options)]


def m7(*lines, **options):
    return [cost for cost, _ in cycles.cortex_m7(program(*lines), **options)]


def test_reads_what_objdump_prints():
    text = """
prog:     file format elf32-littlearm
08002bee <koopf_lift>:
 8002bee:\t4628      \tmov\tr0, r5
 8002bf0:\tf7ff fbac \tbl\t800235c <learn_plainly>
 8002bf4:\ted9d 0a02 \tvldr\ts0, [sp, #8]
 8002bf8:\t9b0a      \tldr\tr3, [sp, #40]\t@ 0x28
 8002bfa:\t4770      \tbx\tlr
 8002bfc:\t40490fdb \t.word\t0x40490fdb
"""
    seen = cycles.disassembled(text)
    assert [(i.address, i.size, i.kind) for i in seen] == [
        (0x8002BEE, 2, "integer"),
        (0x8002BF0, 4, "branch"),
        (0x8002BF4, 4, "float load"),
        (0x8002BF8, 2, "load"),
        (0x8002BFA, 2, "branch"),
        (0x8002BFC, 4, None),
    ]
    assert seen[3].operands == "r3, [sp, #40]"


@pytest.mark.parametrize(
    "mnemonic, kind",
    [("bls.n", "branch"), ("blt.w", "branch"), ("bleq", "branch"), ("muls", "multiply"), ("mls", "multiply"), ("lsls", "integer")]
    + [("vmlsgt.f32", "accumulate"), ("vmulle.f32", "float"), ("ldrsh.w", "load"), ("strbne", "store"), ("itete", "integer")]
    + [("vsqrtmi.f32", "root"), ("udiv", "divide"), ("vldmia", "multiple"), ("bics.w", "integer"), ("movwlt", "integer"), (".word", None)],
)
def test_suffixes_do_not_change_the_kind(mnemonic, kind):
    (instruction,) = program(f"{mnemonic} r0, r1")
    assert instruction.kind == kind


def test_registers_of_lists_and_of_double_precision():
    assert cycles.registers("{r4-r6, lr}") == {"r4", "r5", "r6", "lr"}
    assert cycles.registers("sp!, {d8-d9}") == {"sp", "s16", "s17", "s18", "s19"}
    assert cycles.registers("s3, s4, #8") == {"s3", "s4"}


# ---- Cortex-M4 -------------------------------------------------------------------------------------


def test_loads_that_follow_each_other_are_pipelined():
    assert m4("ldr r0, [r1, r5]", "ldr r1, [r2, #0]", "ldr r2, [r3, #4]") == [2, 1, 1]  # Arm: normally four cycles in total
    assert m4("ldr r0, [r1, r2]", "str r0, [r3, #20]") == [2, 1]  # Arm: normally three
    assert m4("ldr r0, [r1, r2]", "str r1, [r3, r2]") == [2, 1]
    assert m4("ldr r0, [r1, #0]", "ldr r2, [r0, #0]") == [2, 2]  # its address waits for the first


def test_an_address_just_computed_costs_a_cycle():
    assert m4("adds r1, r1, #4", "ldr r0, [r1, #0]") == [1, 3]
    assert m4("adds r1, r1, #4", "vldr.w s0, [r1, #0]") == [1, 3]
    assert m4("adds r1, r1, #4", "ldr r1, [r2, #0]") == [1, 2]


def test_a_float_result_used_at_once_costs_a_cycle():
    assert m4("vmul.f32 s1, s2, s3", "vadd.f32 s0, s0, s1") == [1, 2]
    assert m4("vmul.f32 s1, s2, s3", "vadd.f32 s0, s0, s4") == [1, 1]
    assert m4("vmul.f32 s1, s2, s3", "vstr s1, [r0]") == [1, 3]
    assert m4("vmul.f32 s1, s2, s3", "b.n 120", "vadd.f32 s0, s0, s1") == [1, 1, 1]


def test_a_product_and_sum_in_one_takes_what_is_assumed():
    lines = ("vmla.f32 s0, s1, s2", "vfma.f32 s3, s4, s5", "vmla.f32 s3, s4, s5")
    assert m4(*lines) == [3, 3, 4]
    assert m4(*lines, accumulate=1) == [1, 1, 2]


def test_words_that_are_moved_count():
    assert m4("push {r4, r5, lr}", "vpush {s16-s19}", "vldmia r3!, {s0-s1}", "ldrd r0, r1, [sp]") == [4, 5, 3, 3]
    assert m4("vldr d0, [r1]", "vdiv.f32 s4, s5, s6", "udiv r0, r1, r2") == [3, 14, 12]


def test_a_branch_costs_a_refill_only_if_taken():
    assert cycles.cortex_m4(program("bne.n 100", "pop {r4, pc}", "ldr r0, [r1]")) == [(1, 2), (3, 2), (2, 0)]


# ---- Cortex-M7 -------------------------------------------------------------------------------------


def test_two_slots_take_what_does_not_depend_on_each_other():
    lines = ("adds r0, r0, #1", "adds r1, r1, #1", "adds r2, r1, #1", "adds r3, r3, #1")
    assert sum(m7(*lines, slots=1)) == 4
    assert m7(*lines, slots=2) == [1, 0, 1, 0]


def test_a_unit_takes_one_instruction_a_cycle():
    assert m7("vadd.f32 s0, s1, s2", "vmul.f32 s3, s4, s5", "ldr r0, [r1]", "ldr r2, [r1]") == [1, 1, 0, 1]


def test_a_result_is_waited_for():
    chain = ["vadd.f32 s0, s0, s1"] * 4
    assert m7(*chain, slots=1) == m7(*chain, slots=2) == [1, 3, 3, 3]
    assert m7(*["vfma.f32 s0, s1, s2"] * 3) == [1, 3, 3]  # the accumulator comes three cycles later than the factors
    assert m7("vdiv.f32 s0, s1, s2", "adds r0, r0, #1", "vadd.f32 s3, s0, s0") == [1, 0, 16]


def test_two_slots_are_never_slower():
    lines = ["push {r4, r5, r6}", "vldr s0, [r0]", "vmul.f32 s1, s0, s0", "ldr r1, [r0]", "adds r1, #3", "udiv r2, r1, r3", "bx lr"]
    assert len(lines) <= sum(m7(*lines, slots=1))
    assert len(lines) / 2 <= sum(m7(*lines, slots=2)) <= sum(m7(*lines, slots=1))


# ---- for the plugin --------------------------------------------------------------------------------


@pytest.mark.parametrize("target", cycles.ESTIMATES)
def test_a_line_of_weights_for_each_instruction_and_none_for_data(target):
    text = " 100:\t4628      \tmov\tr0, r5\n 102:\td1fd      \tbne.n\t100 <loop>\n 104:\t40490fdb \t.word\t0x40490fdb\n"
    lines = [line.split() for line in cycles.weights(target, text).splitlines()]
    assert [line[:3] for line in lines] == [["100", "2", "1"], ["102", "2", "1"]]
    assert {len(line) for line in lines} == {2 + 2 * 3}
    assert [line[5] for line in lines] == ["0", "0"]  # a branch that is taken is not one instruction more
