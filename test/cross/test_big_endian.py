"""C tests on a big-endian processor whose long double is a pair of doubles: PowerPC, emulated."""

import functools
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNITY = Path(re.search(r"^unity_folder:PATH=(.*)$", (ROOT / "build/test/CMakeCache.txt").read_text(), re.M)[1])
COMPILER, EMULATOR = "powerpc-linux-gnu-gcc", "qemu-ppc"
MISSING = [program for program in (COMPILER, EMULATOR) if not shutil.which(program)]

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"missing: {', '.join(MISSING)} (Debian: gcc-powerpc-linux-gnu qemu-user)")

# What depends on the order of bytes in memory, and what once failed here.
TESTS = [
    f"{subject}_{precision}" for subject in ("model", "model_format", "checksum", "flips", "self_test") for precision in ("koopf", "koopd")
]
TESTS += ["regulators_koopd"]


def ran(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """Builds a test; what tests of one precision share is compiled once."""

    def flags(precision):
        own = ["-std=gnu11", "-O2", "-ffp-contract=off", f"-DTEST_DOUBLE={int(precision == 'koopd')}"]
        return [*own, f"-I{ROOT / 'lib/include'}", f"-I{UNITY}"]

    @functools.cache
    def shared(precision):
        folder = tmp_path_factory.mktemp(precision)
        sources = [UNITY / "unity.c", *[ROOT / "test/c" / name for name in ("support.c", "reference.c", "problem.c")]]
        for source in [*sources, *(ROOT / "lib").glob("koop*.c")]:
            ran(COMPILER, *flags(precision), "-c", source, "-o", folder / f"{source.stem}.o")
        return folder

    def build(test):
        subject, precision = test.rsplit("_", 1)
        folder = shared(precision)
        source, out = ROOT / f"test/c/test_{subject}.c", folder / subject
        ran(COMPILER, *flags(precision), "-static", source, *folder.glob("*.o"), "-lm", "-o", out)
        return out

    return build


@pytest.mark.parametrize("test", TESTS)
def test_passes_on_powerpc(test, program):
    assert " 0 Failures" in ran(EMULATOR, program(test))
