"""Figures of README and docs are written by the commands that measure them: between markers, one number per cell."""

import re
from pathlib import Path

import pytest
from tinykoop import cli
from tinykoop.plumbing import pages
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("docs/*.md"))]
REGION = re.compile(r"<!-- ([\w-]+): begin, written by ([^>]*?) -->\n(.*?)<!-- \1: end -->", re.S)
FIGURE = re.compile(r"<!-- ([\w-]+) -->.*?<!-- /\1 -->")

# Tables whose digits are settings, names, formulas or sources, by page and head: nothing in them is measured.
SETTINGS = {
    ("README.md", "| learn on the robot | find what the simulator lacks |"),
    ("README.md", "| figure | value | command |"),
    ("README.md", "| page | content |"),
    ("assurance.md", "| Promise | Command |"),
    ("convert.md", "| `--format` | `SOURCE` |"),
    ("convert.md", "| column | Crazyflie | PX4 | ROS 2, by type |"),
    ("convert.md", "| column | ArduPilot | Betaflight |"),
    ("diagnose.md", "| FILE | what is changed | what it cannot represent |"),
    ("diagnose.md", "| option | meaning |"),
    ("diagnose.md", "| topic | schema | content |"),
    ("flapping-wing.md", "| parameter | value | source |"),
    ("learning.md", "| regulator | source | what is bounded without excitation | settings | use it when |"),
    ("flapping-wing.md", "| effect | parameters | acts on |"),
    ("glossary.md", "| term | meaning |"),
    ("logs.md", "| robot | columns |"),
    ("learning.md", "| choose | when |"),
    ("microcontroller.md", "| | reals | N = 22, m = 2, H = 50, float32 |"),
    ("microcontroller.md", "| your robot | choose |"),
    ("microcontroller.md", "| build | do |"),
    ("microcontroller.md", "| stack | compiles with | read from | what the library does |"),
    ("microcontroller.md", "| observation | meaning | action |"),
    ("quadrotor.md", "| column | unit | content |"),
    ("quadrotor.md", "| parameter | Crazyflie 2.1 | source |"),
    ("quadrotor.md", "| effect | parameters | acts on |"),
    ("own-robot.md", "| folder of `examples/own_robot/` | simulator | hidden deviation in its log |"),
    ("own-robot.md", "| key | content |"),
}
# Sentences with such figures that are settings of a command or of the diagnoser.
MEASURED = re.compile(r"\d[\d.,]* (?:%|us\b|ns\b|times as\b|alarms\b)|\b\d[\d,]* of \d[\d,]*\b")
RULES = (
    "at least 5 % of the log", "at least 2 % better", "within 15 % of the", "10 % of the gap", "(0.2 % of the", "10 % of its gap", "explains 90 % as much",
    "costs 50 % more at most", "first 20 %", "next 20 %", "below 5 % of its typical size", "decreases by 0.4 % per second",
    "(95 %)", "at most 2 % of its largest size", "at least 10 % of what past", "3 % of the gap is left",
    "sags by 13 % at full thrust", "within 8 % of its median", "0.12 % per second at full thrust",
)  # fmt: skip


def by_hand(page):
    """The text of a page without what commands write into it."""
    return FIGURE.sub("", REGION.sub("", page.read_text()))


def tables(text):
    """[lines of a table]."""
    return [found.splitlines() for found in re.findall(r"(?:^\|.*\n)+", text + "\n", re.M)]


def words(line):
    """A line without code and links, in which digits are names."""
    return re.sub(r"`[^`]*`|\[[^]]*\]\([^)]*\)", "", line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_with_figures_are_written_by_commands(page):
    by_us = [table[0] for table in tables(by_hand(page)) if any(re.search(r"\d", words(line)) for line in table[2:])]
    assert not [head for head in by_us if (page.name, head) not in SETTINGS], (
        "put the table between markers, or list it here if nothing is measured"
    )


def test_the_list_of_tables_without_measurements_has_no_other():
    assert not {(name, head) for name, head in SETTINGS if not any(page.name == name and head in page.read_text() for page in PAGES)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_prose_has_no_measured_figure(page):
    text = re.sub(r"```.*?```|^(?:    |\|).*?$", "", by_hand(page), flags=re.S | re.M)
    for rule in RULES:
        text = text.replace(rule, "")
    assert not [line for line in text.splitlines() if MEASURED.search(words(line))], "let the command write it, or list the setting here"


def test_each_headline_figure_of_the_readme_is_between_markers():
    (table,) = [table for table in tables((ROOT / "README.md").read_text()) if table[0] == "| figure | value | command |"]
    for line in table[2:]:
        assert FIGURE.fullmatch(line.strip("| ").split(" | ")[1]), line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_regions_are_written_by_commands_that_exist(page):
    text = page.read_text()
    assert len(re.findall(r"<!-- [\w-]+: begin", text)) == len(REGION.findall(text))
    for _, command, _ in REGION.findall(text):
        program = re.match(r"make ([a-z]+) (?:[A-Z]+=\S+ )*UPDATE=1$|test/python/(\S+)\.py ", command)
        assert program and (program[1] in (*cli.TABLES, "targets") or (ROOT / f"test/python/{program[2]}.py").exists()), command


def test_the_makefile_hands_update_to_every_command_that_writes_tables():
    makefile = (ROOT / "Makefile").read_text()
    for command in (*cli.TABLES, "demo", "targets"):
        assert re.search(rf"^\t@\$\(TINYKOOP\) {command}\b.* \$\(UPDATED\)$", makefile, re.M), command


def test_other_figures_of_a_line_stay():
    text = "| a | <!-- a -->1<!-- /a --> | <!-- b -->2<!-- /b --> |"
    assert pages.within_line(text, "b", "3 of 4") == "| a | <!-- a -->1<!-- /a --> | <!-- b -->3 of 4<!-- /b --> |"


def test_a_figure_without_markers_is_refused():
    with pytest.raises(UserError, match="no markers 'c' and '/c'"):
        pages.within_line("| a | 1 |", "c", 2)
