"""The firmware snippet of the README compiles as it stands, links, and learns."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FLAGS = ["-std=c99", "-O2", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]

DRIVE = """
#include <math.h>
#include <stdio.h>
int main(void) {
	float x[3] = {0, 0, 0}, u[2] = {0, 0};
	koopf_health health = {0};
	if (learner_start() != KOOP_OK) { return 1; }
	for (int k = 0; k < 400; k++) {
		if (learner_step(x, u, &health) != KOOP_OK) { return 2; }
		u[0] = 1.5f + 0.3f * sinf(0.1f * (float)k);
		u[1] = 0.6f * cosf(0.08f * (float)k);
		x[0] += 0.05f * u[0] * cosf(x[2]);
		x[1] += 0.05f * u[0] * sinf(x[2]);
		x[2] += 0.05f * u[1];
	}
	x[1] = NAN;
	if (learner_step(x, u, &health) != KOOP_E_INPUT) { return 3; }
	printf("%g %zu\\n", (double)health.innovation, sizeof storage);
	return 0;
}
"""


@pytest.fixture(scope="module")
def readme():
    return (ROOT / "README.md").read_text()


def test_firmware_snippet(readme, tmp_path):
    snippet = re.search(r"```c\n(.*?)```", readme, re.S).group(1)
    source = tmp_path / "firmware.c"
    source.write_text(snippet + DRIVE)
    program = tmp_path / "firmware"
    include = ["-I", str(ROOT / "lib/include")]
    subprocess.run(
        ["gcc", *FLAGS, *include, str(source), str(ROOT / "lib/koopf.c"), "-o", str(program), "-lm"], check=True
    )
    innovation, storage = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.split()
    assert float(innovation) < 0.05
    claimed = float(re.search(r"2 inputs: ([\d.]+) kB", readme).group(1))
    assert abs(int(storage) / 1000 - claimed) < 0.05


def test_named_files_exist(readme):
    for target in re.findall(r"\]\(([^)]+)\)", readme):
        assert (ROOT / target).exists(), target


def test_make_targets_exist(readme):
    makefile = (ROOT / "Makefile").read_text()
    for target in set(re.findall(r"(?:^|`)make ([a-z-]+)", readme, re.M)):
        assert re.search(rf"^{target}:", makefile, re.M), f"make {target}"
