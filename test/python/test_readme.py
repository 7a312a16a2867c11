"""The snippets of README and docs work as they stand."""

import json
import re
import subprocess
from pathlib import Path

import pytest
from tinykoop.firmware import targets

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
	static unsigned char model[KOOPF_MODEL_BYTES(22, 2)];
	static float path[10 * 3];
	if (koopf_model_save(&learner, model, sizeof model) != KOOP_OK) { return 3; }
	if (control_start(model, sizeof model) != KOOP_OK) { return 4; }
	for (int k = 0; k < 10; k++) {
		path[3 * k] = x[0] + 0.05f * 1.5f * (float)(k + 1) * cosf(x[2]);
		path[3 * k + 1] = x[1] + 0.05f * 1.5f * (float)(k + 1) * sinf(x[2]);
		path[3 * k + 2] = x[2];
	}
	if (learner_step(x, u, &health) != KOOP_OK || control_step(path, u) != KOOP_OK) { return 5; }
	const float speed = u[0];
	x[1] = NAN;
	if (learner_step(x, u, &health) != KOOP_E_INPUT) { return 6; }
	printf("%g %g %zu %zu %zu\\n", (double)health.innovation, (double)speed, sizeof storage, sizeof mpc_storage, sizeof supervisor_storage);
	return 0;
}
"""


@pytest.fixture(scope="module")
def readme():
    return (ROOT / "README.md").read_text()


def test_the_program_of_the_readme_is_the_example(readme):
    (program,) = re.findall(r"```c\n(.*?)```", readme, re.S)
    assert (ROOT / "examples/learn.c").read_text().partition("*/\n")[2] == program


def test_firmware_snippets(readme, tmp_path, firmware):
    pages = "".join((ROOT / "docs" / name).read_text() for name in ("learning.md", "control.md"))
    snippet = "".join(re.findall(r"```c\n(.*?)```", pages, re.S))
    source = tmp_path / "firmware.c"
    source.write_text(snippet + DRIVE)
    program = tmp_path / "firmware"
    units = [firmware("koopf"), firmware("koopf_supervisor")]
    include = ["-I", str(ROOT / "lib/include")]
    subprocess.run(["gcc", *FLAGS, *include, str(source), *map(str, units), "-o", str(program), "-lm"], check=True)
    told = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout.split()
    innovation, speed, *storage = map(float, told)
    assert innovation < 0.05
    assert 1 < speed < 2  # of a path that goes on straight at 1.5 m/s
    claims = re.findall(r"\[KOOP_\w+\([^]]*\)\];\s*/\*[^*]*?([\d.]+) kB", pages)
    assert [round(size / 1000, 1) for size in storage] == [float(claim) for claim in claims]


PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        assert target.startswith("https://") or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_targets_exist(page):
    makefile = (ROOT / "Makefile").read_text()
    for target in set(re.findall(r"(?:^|`)make ([a-z-]+)", page.read_text(), re.M)):
        assert re.search(rf"^{target}:", makefile, re.M), f"make {target}"


def test_readme_can_be_read_at_one_go(readme):
    assert len(readme.splitlines()) <= 130


def test_headline_figures_are_those_that_were_measured(readme):
    for name, value in targets.headlines(targets.read_committed()).items():
        assert f"<!-- {name} -->{value}<!-- /{name} -->" in readme


def test_assurance_names_files_that_exist():
    """The page that says where each promise is kept."""
    page = (ROOT / "docs/assurance.md").read_text()
    named = re.findall(r"`((?:lib|test|examples)/[\w/]+\.(?:c|h|py))`", page)
    assert len(named) > 25
    assert [name for name in named if not (ROOT / name).is_file()] == []


def _figures_of_the_diagnoser():
    """What docs/diagnose.md says of its constants, as the code has them."""
    from tinykoop import bridge
    from tinykoop.diagnose import cautions
    from tinykoop.diagnose.platforms import ddr
    from tinykoop.diagnose.platforms.ddr import links
    from tinykoop.diagnose.platforms.fwmav import diagnosis as flight
    from tinykoop.diagnose.prediction_errors import ahead, healthy, judge, spans, weighed

    return [
        f"The first {ddr.SETTLE} rows are excluded",
        f"From a long log {ddr.MOST:,} rows are used",
        f"At most {links.MOST:,} rows of each link are used",
        f"Beyond {bridge.LONG:,} rows the states of the actuators are simulated from {bridge.WARM_UP:g} s before each row",
        f"at least {100 * spans.LEAST:g} % of the log",
        "minimises the errors {}, {} and {} steps ahead".format(*weighed.STEPS),
        f"at least {100 * weighed.BETTER:g} % better",
        f"a log of fewer than {weighed.FEWEST * weighed.BLOCK:g} rows",
        "error {}, {} and {} steps after a *measured* pose".format(*ahead.HORIZONS),
        f"its own blocks of {ahead.BLOCK:g} s",
        f"within {100 * ahead.SHOWS:g} % of the noise floor",
        f"({100 * ddr.SMALLEST:.1f} % of the distance driven",
        f"more than {100 * judge.UNEXPLAINED:g} % of the gap",
        f"more than {judge.STANDS_OUT:g} times the error that all noise explains",
        f"a confidence of {judge.ESTABLISHED:g} or more",
        f"no effect has a confidence of {judge.BELIEVED:g}",
        f"at most {judge.UNSURE:g} if one command",
        f"at most {judge.DOUBT:g} beside what looks alike",
        f"more than {100 * judge.HINTS:g} % of the gap is left",
        f"over {ahead.FLOORS:g} times its noise floor and over {100 * ahead.LEFT:g} % of its gap",
        f"at {flight.RATE:g} Hz",
        f"at least {flight.LEAST_SECONDS:g} s long",
        f"autoregression over {healthy.LAGS} rows",
        f"fourth block of {ahead.BLOCK:g} s",
        f"From {flight.SYSTEMATIC:g} on a systematic error remains",
        f"over {flight.WORSE:g} times worse",
        f"over {flight.ANOTHER:g} times the variance",
        f"{flight.KICKED:g} s before and after the change",
        f"a command is at most {100 * cautions.STEADY:g} % of its largest size",
        f"Fewer than {cautions.FEWEST} separate predictions of {max(ahead.HORIZONS)} steps",
        f"usable rows last less than {ahead.FOLDS * ahead.BLOCK:g} s",
        f"their own past of {cautions.PAST} rows",
        f"present and the last {cautions.LAGS} rows",
        f"a p-value of {cautions.CHANCE:.4f} over all commands",
        f"at least {100 * cautions.SHARE:g} % of what past commands leave open",
    ]


def test_page_of_the_diagnoser_is_that_of_its_code():
    """Its figures, its files and its options."""
    text = (ROOT / "docs/diagnose.md").read_text()
    flat, folder = " ".join(text.split()), ROOT / "tools/tinykoop/diagnose"
    figures = _figures_of_the_diagnoser()
    assert figures and [figure for figure in figures if figure not in flat] == []
    files = re.findall(r"`([a-z_/]+(?:\.py|\.c|/))`", text)
    assert len(files) > 25
    places = ROOT, folder, folder / "platforms/ddr", folder / "platforms/fwmav"
    assert [name for name in files if not any((place / name).exists() for place in places)] == []
    options = re.findall(r"(?<![\w-])--[a-z]+(?:-[a-z]+)*", text)
    known = re.findall(r'"(--[a-z-]+)"', (ROOT / "tools/tinykoop/cli.py").read_text())
    assert len(options) > 10 and [option for option in options if option not in known] == []


def test_bill_of_materials_is_of_this_version():
    version = re.search(r'KOOP_VERSION "(.*)"', (ROOT / "lib/include/tinykoop.h").read_text())[1]
    bill = json.loads((ROOT / "sbom.spdx.json").read_text())
    assert bill["name"].endswith(version) and bill["packages"][0]["versionInfo"] == version
