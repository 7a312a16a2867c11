"""The regulators' C tests in float64 on a big-endian processor whose long double is a pair of doubles: PowerPC, emulated."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNITY = ROOT / "build/unity/src"
COMPILER, EMULATOR = "powerpc-linux-gnu-gcc", "qemu-ppc"
MISSING = [program for program in (COMPILER, EMULATOR) if not shutil.which(program)]

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"missing: {', '.join(MISSING)} (Debian: gcc-powerpc-linux-gnu qemu-user)"),
    pytest.mark.skipif(not UNITY.is_dir(), reason="no build/unity: `make c-tests` fetches it"),
]


def ran(*command):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=300)


def test_regulators_follow_the_paper_on_powerpc(tmp_path):
    sources = [ROOT / "test/c" / name for name in ("test_regulators.c", "support.c", "reference.c")]
    flags = ["-std=gnu11", "-O2", "-ffp-contract=off", "-static", "-DTEST_DOUBLE=1", f"-I{ROOT / 'lib/include'}", f"-I{UNITY}"]
    program = tmp_path / "test_regulators"
    built = ran(COMPILER, *flags, *sources, UNITY / "unity.c", ROOT / "lib/koopd.c", "-lm", "-o", program)
    assert built.returncode == 0, built.stderr
    done = ran(EMULATOR, program)
    assert done.returncode == 0, done.stdout
    assert "test_reference_stays_symmetric:PASS" in done.stdout
