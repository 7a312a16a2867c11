"""Every snippet of the pages: C is an excerpt of an example or compiles, sessions print what the page says, commands and files parse."""

import ast
import os
import re
import shlex
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from tinykoop import cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
EXAMPLES = [path.read_text() for path in sorted(ROOT.glob("examples/**/*")) if path.suffix in (".c", ".py", ".toml", ".yaml")]
TEXTS = {page: page.read_text() for page in PAGES}
COMPILE = ["gcc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I", ROOT / "lib/include", "-x", "c", "-"]
have_arm = shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm")
needs_arm = pytest.mark.skipif(not have_arm, reason="no arm-none-eabi-gcc or QEMU here")


def blocks(text, language):
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.S | re.M)


def with_blocks(language):
    return pytest.mark.parametrize("page", [page for page in PAGES if blocks(TEXTS[page], language)], ids=lambda page: page.name)


def is_excerpt(block):
    """Whether an example has these lines, one after the other."""
    return any(block in text for text in EXAMPLES)


def standing_alone(page):
    """The C of a page that is no excerpt, behind that of the page which it continues."""
    before = re.search(r"<!-- continues (\S+) -->", TEXTS[page])
    own = "\n".join(block for block in blocks(TEXTS[page], "c") if not is_excerpt(block))
    return (standing_alone(page.parent / before[1]) if before else "") + own


@with_blocks("c")
def test_c_is_an_excerpt_of_an_example_or_compiles(page):
    for block in blocks(TEXTS[page], "c"):
        assert is_excerpt(block) or '#include "tinykoop' in block, f"no example has these lines any more:\n{block}"
    done = subprocess.run(COMPILE, input=standing_alone(page) + "typedef int not_empty;", capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@with_blocks("python")
def test_python_is_valid(page):
    for block in blocks(TEXTS[page], "python"):
        ast.parse(block)


@with_blocks("toml")
def test_toml_is_valid(page):
    for block in blocks(TEXTS[page], "toml"):
        tomllib.loads(block)


def commands(text):
    """Command lines with `tinykoop`, of fenced and of indented blocks, continued lines in one."""
    text = text.replace("\\\n", " ")
    return re.findall(r"^(?:    |\$ )?(?:\.\./)*build/venv/bin/tinykoop +([^\n]+)", text, re.M)


def refusal(command):
    """What the parser has against a command; of a synopsis with [..] only the names of its options are looked at."""
    if "[" in command:
        known = re.findall(r'"(--[a-z-]+)"', Path(cli.__file__).read_text())
        return [option for option in re.findall(r"--[a-z-]+", command) if option not in known]
    try:
        cli.parser().parse_args(shlex.split(re.split(r">|\|\|", command)[0], comments=True))
    except SystemExit as refused:
        return refused.code


@pytest.mark.parametrize("page", [page for page in PAGES if commands(TEXTS[page])], ids=lambda page: page.name)
def test_commands_are_those_of_the_parser(page):
    assert [command for command in commands(TEXTS[page]) if refusal(command)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_variables_of_make_targets_exist(page):
    makefile = (ROOT / "Makefile").read_text()
    for line in re.findall(r"(?:^|`|    )make ([a-z-]+(?: [^\n`#]*)?)", TEXTS[page], re.M):
        for variable in re.findall(r"\b([A-Z]+)=", line):
            assert f"$({variable})" in makefile or f"$(if $({variable})" in makefile, line


STEP = re.compile(r"^\$ ((?:[^\n]*\\\n)*[^\n]*)\n((?:(?!\$ )[^\n]*\n)*)", re.M)  # a command, with continued lines, and what it prints


def shows(output, wanted):
    """Whether the output has these lines, one behind the other; `...` stands for anything, and blanks for each other."""
    pieces = (r"\s+".join(map(re.escape, piece.split())) for piece in re.split(r"\.\.\.|\n", wanted))
    at = 0
    for piece in pieces:  # each as early as it can be: one pattern of all would try every place of each
        found = re.compile(piece).search(output, at)
        if not found:
            return False
        at = found.end()
    return True


def checkout(folder):
    """The project as a reader has it after `make build`, with a build/ of its own to write to."""
    for entry in ROOT.iterdir():
        if entry.name not in ("build", ".git"):
            (folder / entry.name).symlink_to(entry)
    (folder / "build").mkdir()
    (folder / "build/venv").symlink_to(ROOT / "build/venv")
    return folder


def ready(page):
    """A page whose sessions need a cross compiler is tried where there is one."""
    marks = needs_arm if "arm-none-eabi" in TEXTS[page] else ()
    return pytest.param(page, marks=marks, id=page.name)


@pytest.mark.parametrize("page", [ready(page) for page in PAGES if blocks(TEXTS[page], "console")])
def test_sessions_print_what_the_page_says(page, tmp_path):
    folder = checkout(tmp_path)
    wide = {**os.environ, "COLUMNS": "110"}
    for command, wanted in (step for block in blocks(TEXTS[page], "console") for step in STEP.findall(block)):
        done = subprocess.run(["bash", "-c", command + " 2>&1"], cwd=folder, capture_output=True, text=True, env=wide)
        assert done.returncode == 0, f"$ {command}\n{done.stdout}{done.stderr}"
        assert shows(done.stdout, wanted), f"$ {command}\n{done.stdout}"
