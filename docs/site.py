"""Collects the pages of the site: those of docs/, the README as the first one, and the reference of the C headers and of the commands.

python docs/site.py build/docs; Sphinx does the rest (docs/conf.py).
"""

import argparse
import os
import re
import shutil
import sys
from pathlib import Path

from tinykoop import cli

ROOT = Path(__file__).resolve().parents[1]
HEADERS = ("tinykoop.h", "tinykoop_api.h", "tinykoop_supervisor.h", "tinykoop_supervisor_api.h")
FROM_ROOT = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "security.md": "SECURITY.md", "changelog.md": "CHANGELOG.md"}
EXIT_STATUS = """`build/venv/bin/tinykoop COMMAND --help` prints the same. Exit status: 0; 1 if a limit that was asked for is exceeded;
2 with one line on standard error if an input must be corrected.
"""
CONTENTS = {
    "Tutorials": "tutorial-microcontroller tutorial-control tutorial-dictionary tutorial-diagnose own-robot tutorial-paper",
    "Guides": "microcontroller learning control diagnose flapping-wing quadrotor quadrotor-blind logs convert",
    "Reference": "reference command-line python glossary",
    "Results": "paper benchmarks assurance diagnose-constants quadrotor-flights",
    "Project": "contributing security changelog",
}


# ---- Reference of the C interface, out of the headers --------------------------------------


def _prose(comment):
    """The text of a C comment as Markdown; indented lines become code."""
    lines = [re.sub(r"^ ?\*? ?", "", line) for line in comment.removeprefix("/*").strip("\n ").splitlines()]
    return re.sub(r"(?m)(?<=\S)\n(?= {4,}\S)", "\n\n", "\n".join(lines)).strip()


def _name(code):
    """What a declaration declares: a function, a type, or nothing that needs a heading of its own."""
    found = re.search(r"\bKOOP\((\w+)\)\(|^\} KOOP\((\w+)\);|^\} (koop_\w+);", code, re.M)
    return found and next((f"koopf_{name}" for name in found.groups()[:2] if name), found[3])


def _section(block):
    """Markdown of one block of a header: what the comment says, then the declarations."""
    comment, _, code = block.partition("*/")
    title = re.match(r"/\* -{4} (.*?) -{4,}", comment)
    if title:
        return f"## {title[1]}\n\n{_prose(comment[title.end() :])}\n"
    code = code.strip("\n")
    heading = f"### {_name(code)}\n\n" if _name(code) else ""
    declared = re.sub(r"\bKOOP\((\w+)\)", r"koopf_\1", code).replace("KOOP_REAL", "float").expandtabs(4)
    return heading + f"{_prose(comment)}\n\n" + (f"```c\n{declared}\n```\n" if code else "")


def _blocks(header):
    """Comments at the left margin with the declarations that follow them."""
    body = re.split(r"^#define KOOP_REAL", header.split('extern "C" {', 1)[-1], maxsplit=1, flags=re.M)[0]
    return re.findall(r"^/\*.*?\*/(?:\n(?!/\*)[^\n]*)*", body, re.S | re.M)


def _linked(text):
    """Every `name()` in prose leads to its function."""
    functions = set(re.findall(r"^### koopf_(\w+)$", text, re.M))
    link = lambda found: f"[`koopf_{found[1]}()`](#koopf_{found[1]})" if found[1] in functions else found[0]  # noqa: E731
    parts = re.split(r"(^```c\n.*?^```$|^    [^\n]*$)", text, flags=re.S | re.M)
    return "".join(part if k % 2 else re.sub(r"\b([a-z_]+)\(\)", link, part) for k, part in enumerate(parts))


def reference():
    """All public declarations with their comments."""
    texts = [(ROOT / "lib/include" / name).read_text() for name in HEADERS]
    intro = re.match(r"/\*.*?\*/", texts[0], re.S)[0]
    parts = ["# C interface\n", _section(intro), "Below, `koopf_` and `float` also stand for `koopd_` and `double`.\n"]
    for name, text in zip(HEADERS, texts):
        if name == "tinykoop_supervisor.h":
            parts += ["## Supervisor\n", _section(re.match(r"/\*.*?\*/", text, re.S)[0])]
        elif name == "tinykoop.h":
            parts.append("## Statuses, checks and sizes\n")
        parts += [_section(block) for block in _blocks(text)]
    return _linked("\n".join(parts))


# ---- Reference of the command line, out of its parser --------------------------------------


def _cell(text):
    return re.sub(r"([|<>*_])", r"\\\1", text)


def _argument(action):
    """A row of the table: how an argument is written, and what it means."""
    value = action.metavar or ("{" + ", ".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper())
    names = ", ".join(action.option_strings) if action.option_strings else str(value)
    written = names + (f" {value}" if action.option_strings and action.nargs != 0 else "")
    notes = ["required"] if action.required and action.option_strings else []
    if action.option_strings and action.default not in (None, False, []) and "default" not in (action.help or ""):
        notes.append(f"default {action.default}")
    return f"| `{written}` | {_cell(action.help or '')}{f' ({notes[0]})' if notes else ''} |"


def _command(name, parser, level=3):
    """Markdown of one command, and of the commands below it."""
    about = parser.description or ""
    usage = parser.format_usage().removeprefix("usage: ").replace("\n       ", "\n")
    parts = [f"{'#' * level} tinykoop {name}\n", f"{_cell(about[:1].upper() + about[1:])}\n", f"```text\n{usage}```\n"]
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    said = [action for action in parser._actions if action not in below and (action.help or action.option_strings)]
    rows = [_argument(action) for action in said if action.dest != "help"]
    parts += ["| argument | meaning |\n| --- | --- |", *rows, ""] if rows else []
    for action in below:
        parts += [_command(f"{name} {inner}", own, level + 1) for inner, own in action.choices.items()]
    return "\n".join(parts)


def command_line():
    """Every command with its arguments, by groups, as `tinykoop COMMAND --help` prints them."""
    os.environ["COLUMNS"] = "80"  # which argparse asks for the width of a line
    (commands,) = (action for action in cli.parser()._actions if isinstance(action, argparse._SubParsersAction))
    parts = ["# Command line\n", EXIT_STATUS]
    for group, fill in cli.GROUPS.items():
        names = []
        fill(lambda name, summary, out=True: names.append(name) or argparse.ArgumentParser())
        parts += [f"## {group.capitalize()}\n", *(_command(name, commands.choices[name]) for name in names)]
    return "\n".join(parts)


# ---- The pages ----------------------------------------------------------------------------


def contents():
    """The table of contents, which Sphinx shows at the left of every page."""
    trees = []
    for title, pages in CONTENTS.items():
        trees.append("\n".join(["```{toctree}", ":hidden:", f":caption: {title}", "", *pages.split(), "```"]))
    return "\n\n" + "\n\n".join(trees) + "\n"


def _moved(text):
    """A page of the root as a page of docs/: links lead to where things are from there."""
    text = re.sub(r"\]\(docs/", "](", text)
    for page, source in FROM_ROOT.items():
        text = text.replace(f"]({source})", f"]({page})")
    return re.sub(r"\]\((?=CITATION\.cff|targets/|examples/)", "](../", text)


def _without_files(text):
    """Links to files of the repository that are no pages become their names."""
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]*\)", r"\1", text)


def pages():
    """{name: Markdown} of all pages."""
    own = {path.name: path.read_text() for path in (ROOT / "docs").glob("*.md")}
    moved = {page: _moved((ROOT / source).read_text()) for page, source in FROM_ROOT.items()}
    moved["index.md"] += contents()
    made = {"reference.md": reference(), "command-line.md": command_line()}
    return {name: _without_files(text) for name, text in {**own, **moved, **made}.items()}


def main(folder):
    """Writes all pages and pictures; files that are no longer there go."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, text in pages().items():
        (folder / name).write_text(text)
    for picture in (*(ROOT / "docs").glob("*.png"), *(ROOT / "docs").glob("*.svg")):
        shutil.copy(picture, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
