"""Tables on a terminal of 80 columns: nothing of them is cut, whatever their size; and `--help` says what is true."""

import os
import pty
import random
import re
import subprocess
import sys
from io import StringIO

import pytest
from rich.console import Console
from tinykoop import cli
from tinykoop.plumbing import results

WIDTH = 80


@pytest.fixture
def terminal(monkeypatch):
    console = Console(width=WIDTH, file=StringIO(), markup=False)
    monkeypatch.setattr(results, "console", console)
    return console.file


def columns(random, count, longest):
    return ["".join(random.choices("abcdefghij ", k=random.randint(1, longest))).strip() or "x" for _ in range(count)]


@pytest.mark.parametrize("seed", range(20))
def test_a_table_of_any_width_is_shown_whole_in_80_columns(seed, terminal):
    chance = random.Random(seed)
    headers = [f"h{j}{name.replace(' ', '_')}" for j, name in enumerate(columns(chance, chance.randint(1, 16), 14))]
    rows = [
        [f"c{i}_{j}{cell.replace(' ', '_')}" for j, cell in enumerate(columns(chance, len(headers), 30))]
        for i in range(chance.randint(1, 6))
    ]
    results.print_table("Some table", headers, rows, "a note")
    said = terminal.getvalue()
    assert max(map(len, said.splitlines())) <= WIDTH and "…" not in said
    for word in (*headers, *sum(rows, [])):
        assert re.search(rf"(?<!\S){re.escape(word)}(?!\S)", said), word


def test_a_cell_wider_than_the_terminal_is_folded(terminal):
    text = "".join(chr(ord("a") + i % 26) for i in range(200))
    results.print_table("Some table", ["name", "text"], [["one", text]])
    said = terminal.getvalue()
    assert max(map(len, said.splitlines())) <= WIDTH
    assert "".join(re.findall(r"[a-z]", said.split("─")[-1].replace("one", "", 1))) == text


def test_parts_of_a_table_repeat_the_columns_that_tell_its_rows_apart(terminal):
    rows = [[d, r, *(f"{d}{r}{j:>12}" for j in range(8))] for d in ("poly", "rbf") for r in ("ct", "ef")]
    results.print_table("Some table", ["dictionary", "regulator", *(f"column {j}" for j in range(8))], rows)
    parts = terminal.getvalue().split("dictionary")[1:]
    assert len(parts) > 1
    for part in parts:
        assert re.findall(r"^(poly|rbf) +(\w+)", part, re.M) == [("poly", "ct"), ("poly", "ef"), ("rbf", "ct"), ("rbf", "ef")]


def test_a_column_in_which_no_row_has_anything_is_left_out(terminal):
    results.print_table("Some table", ["name", "remark", "size"], [["one", "", 1], ["two", "", 2]])
    assert "remark" not in terminal.getvalue() and "size" in terminal.getvalue()


def test_on_a_terminal_of_80_columns_and_in_a_pipe_the_same_is_shown():
    command = [sys.executable, "-m", "tinykoop.cli", "effects", "--robot", "fwmav"]
    environment = {key: value for key, value in os.environ.items() if key != "COLUMNS"}
    piped = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True).stdout
    master, slave = pty.openpty()
    with open(master, "rb", buffering=0) as shown:
        subprocess.run(command, env=environment | {"COLUMNS": "80", "TERM": "dumb"}, stdin=slave, stdout=slave, stderr=slave, check=True)
        os.close(slave)
        seen = b""
        while True:
            try:
                seen += shown.read(65536)
            except OSError:  # Linux's end of a terminal without a writer
                break
    assert [line.rstrip() for line in seen.decode().splitlines()] == [line.rstrip() for line in piped.splitlines()]
    assert max(map(len, piped.splitlines())) <= WIDTH


# ---- help ---------------------------------------------------------------------------------------------------------


def subcommands():
    (commands,) = (action for action in cli.parser()._actions if isinstance(action.choices, dict))
    return commands.choices


def test_every_command_stands_in_one_group_of_the_help():
    shown = re.findall(r"^  (\w+) ", cli.parser().format_help().partition("your log:")[2], re.M)
    assert sorted(shown) == sorted(subcommands()) and len(shown) > 20


@pytest.mark.parametrize("name, command", subcommands().items())
def test_the_defaults_that_help_shows_are_those_without_options(name, command, monkeypatch):
    """An option with a value says its default, or that it needs one, or what happens without it."""
    monkeypatch.setenv("COLUMNS", "1000")
    parts = re.split(r"^  (?=-)", command.format_help(), flags=re.M)[1:]
    shown = {
        re.match(r".*?(--[a-z0-9-]+)", part)[1]: part.rpartition("(default: ")[2].strip()[:-1] for part in parts if "(default: " in part
    }
    for action in command._actions:
        option = next((text for text in action.option_strings if text.startswith("--")), None)
        if option in shown and action.default is not None and option != "--out":
            assert type(action.default)(shown[option]) == action.default
        if action.option_strings and isinstance(action.default, (int, float, str)) and action.default not in (False, "==SUPPRESS=="):
            assert any(text in shown for text in action.option_strings), action.option_strings
