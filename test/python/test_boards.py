"""What the self-benchmark prints on a board, as a table."""

import re

import pytest
from tinykoop.firmware import boards
from tinykoop.plumbing.errors import UserError

PRINTED = """STM32F405, 168 MHz, 5 wait states with the accelerator, GCC 12.2 -O2
cycles lift 22 2 20 1300 1310 1400
KOOPMAN: cycles update 22 2 20 21000 21400 22500
benchmark: ok
"""


def test_reads_the_lines_of_a_console():
    assert boards.measured(PRINTED) == {("lift", 22, 2, 20): (1300, 1310, 1400), ("update", 22, 2, 20): (21000, 21400, 22500)}


def test_the_line_of_the_program_is_the_one_that_is_read():
    source = (boards.ROOT / "examples/self_benchmark.h").read_text()
    (line,) = re.findall(r'#define SELF_BENCHMARK_LINE "(.*)\\n"', source)
    assert boards.measured(line.replace("%s", "gate") % (1, 2, 3, 4, 5, 6)) == {("gate", 1, 2, 3): (4, 5, 6)}


def test_a_column_for_each_board(tmp_path):
    (tmp_path / "crazyflie.txt").write_text(PRINTED)
    (tmp_path / "nucleo.txt").write_text("cycles lift 22 2 20 900 905 950\n")
    lines = boards.table(boards.read(tmp_path)).splitlines()
    assert lines[2] == "|  | crazyflie median | crazyflie max | nucleo median | nucleo max |"
    assert lines[4] == "| lift, N = 22, m = 2, horizon 20 | 1,310 | 1,400 | 905 | 950 |"
    assert lines[5] == "| update, N = 22, m = 2, horizon 20 | 21,400 | 22,500 | - | - |"


def test_a_file_without_results_is_refused(tmp_path):
    assert boards.table(boards.read(tmp_path)) == ""
    (tmp_path / "mine.txt").write_text("no cycle counter here\n")
    with pytest.raises(UserError, match="mine.txt: has no line 'cycles"):
        boards.read(tmp_path)
