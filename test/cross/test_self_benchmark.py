"""The self-benchmark of a firmware, in QEMU: it says that no cycles are counted there, and with a counter of
instructions in place of the chip's counter of cycles it gives the figures of the footprint."""

import re
import subprocess
from pathlib import Path

import pytest
from tinykoop.firmware import boards, targets

ROOT = Path(__file__).resolve().parents[2]
RUN = sorted(name for name in targets.targets() if targets.Tree(name, "O2").runs)
QEMU = ["-nographic", "-monitor", "none", "-serial", "none", "-semihosting-config", "enable=on,target=native", "-icount", "shift=0"]

# SysTick counts 24 bits down; shifted up, differences are right when it wraps around. A tick is 5.95 instructions on this board.
SYSTICK = """
#include <stdint.h>
static uint32_t ticks(void) {
	volatile uint32_t *systick = (uint32_t *)0xE000E010u; /* control, reload, value */
	if (systick[0] != 5) { systick[1] = 0xFFFFFFu; systick[0] = 5; }
	return ~systick[2] << 8;
}
#define SELF_BENCHMARK_COUNTER ticks
#include "self_benchmark.c"
"""
INSTRUCTIONS = 1000 / 168 / 256  # of a unit of that counter: QEMU takes 1 ns for each, the clock has 168 MHz

pytestmark = pytest.mark.skipif(bool(targets.missing()), reason=f"missing: {', '.join(targets.missing())}")


def printed(target, out, source=ROOT / "examples/self_benchmark.c"):
    tree = targets.Tree(target, "O2")
    text = (ROOT / "targets" / target / "toolchain.cmake").read_text()
    flags = [*tree.flags, "-O2", "-std=gnu99", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-ffunction-sections", "-fdata-sections"]
    link = [
        "--specs=picolibc.specs",
        "--crt0=semihost",
        "--oslib=semihost",
        "-Wl,--gc-sections",
        "-T",
        ROOT / "targets" / target / "memory.ld",
    ]
    sources = [f"-I{ROOT / 'lib/include'}", f"-I{ROOT / 'examples'}", source, ROOT / "lib/koopf.c", "-lm"]
    subprocess.run([f"{tree.prefix}gcc", *flags, *link, *sources, "-o", out], check=True)
    machine = re.search(r"set\(TARGET_QEMU (.+)\)", text)[1].split()
    done = subprocess.run([*machine, *QEMU, "-kernel", out], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.parametrize("target", RUN)
def test_says_that_no_cycles_are_counted_in_qemu(tmp_path, target):
    assert printed(target, tmp_path / "program").strip() == "no cycle counter here"


def test_measures_the_functions_of_the_footprint(tmp_path):
    source = tmp_path / "counted.c"
    source.write_text(SYSTICK)
    seen = boards.measured(printed("cortex-m4f", tmp_path / "program", source))
    assert set(seen) == {(function, n, 2, 20) for n in targets.SIZES for function in ("lift", "update", "gate", "warm", "cold")}
    footprint = {
        targets._size(row): row for row in targets.read_committed() if (row["target"], targets._level(row)) == ("cortex-m4f", "O2")
    }
    for n in targets.SIZES:
        median = {key[0]: value[1] * INSTRUCTIONS for key, value in seen.items() if key[1] == n}
        count = footprint[n]["instructions"]
        assert median["lift"] == pytest.approx(count["lift"], abs=30)  # its sine takes longer at large angles
        assert median["update"] == pytest.approx(count["rls_update"]["dz_cs"], rel=0.02)
        assert 1.1 < median["gate"] / median["update"] < 1.6
        assert count["mpc_solve"]["condense"] / 10 < median["warm"] <= 1.3 * median["cold"] < count["mpc_solve"]["worst"]
