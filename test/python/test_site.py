"""The site of the docs: its references are complete, and what leads nowhere fails the build."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tinykoop import cli

ROOT = Path(__file__).resolve().parents[2]
HEADERS = sorted((ROOT / "lib/include").glob("*.h"))


@pytest.fixture(scope="module")
def site():
    spec = importlib.util.spec_from_file_location("site_of_docs", ROOT / "docs/site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def functions(text):
    return re.findall(r"^(?:int|const char \*)\s*KOOP\((\w+)\)\(", text, re.M)


@pytest.mark.parametrize("header", HEADERS, ids=lambda path: path.name)
def test_every_public_function_has_a_comment_right_before_it(header):
    text = header.read_text()
    for name in functions(text):
        assert re.search(rf"\*/\n(?:int|const char \*)\s*KOOP\({name}\)\(", text), name


@pytest.mark.parametrize("header", HEADERS, ids=lambda path: path.name)
def test_every_field_of_a_configuration_has_a_comment(header):
    for fields in re.findall(r"^typedef struct KOOP\(\w*config\) \{\n(.*?)^\}", header.read_text(), re.S | re.M):
        bare = re.sub(r"(?m)^\t/\*.*?\*/\n\t.*;$", "", fields, flags=re.S)  # the comment stands before these
        silent = re.findall(r"^\t[^/\n]*;(?!.*/\*).*$", bare, re.M)
        assert [line for line in silent if not line.endswith(("*dictionary;", "*regulator;", "*form;"))] == []  # their types have one


def test_reference_has_every_function_with_its_own_heading(site):
    text = site.reference()
    names = [name for header in HEADERS for name in functions(header.read_text())]
    assert len(names) > 30 and [name for name in names if f"### koopf_{name}\n" not in text] == []


def test_command_line_has_every_option_of_every_command(site, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = site.command_line()
    options = re.findall(r'"(--[a-z-]+)"', Path(cli.__file__).read_text())
    assert len(options) > 20 and [option for option in options if f"`{option}" not in text and f" {option} " not in text] == ["--version"]
    for command in ("diagnose", "robot check", "learn", "size", "mutants"):
        assert f"# tinykoop {command}\n" in text


def test_every_page_is_in_the_table_of_contents(site):
    listed = {f"{name}.md" for pages in site.CONTENTS.values() for name in pages.split()}
    assert listed | {"index.md"} == set(site.pages())


def test_a_link_and_an_anchor_that_lead_nowhere_fail_the_build(tmp_path):
    pytest.importorskip("sphinx", reason="no Sphinx: make docs installs it")
    pages = tmp_path / "pages"
    pages.mkdir()
    (pages / "index.md").write_text("# Title\n\n[page](missing.md) [heading](#no-such-heading) [there](#title)\n")
    build = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", "-c", ROOT / "docs", pages, tmp_path / "site"]
    done = subprocess.run(build, capture_output=True, text=True)
    assert done.returncode != 0
    assert "missing.md" in done.stderr and "no-such-heading" in done.stderr and "'title'" not in done.stderr


def test_without_a_network_one_line_says_what_is_missing(tmp_path):
    pip = tmp_path / "venv/bin/pip"
    pip.parent.mkdir(parents=True)
    pip.write_text("#!/bin/sh\necho 'WARNING: Retrying after connection broken' >&2\nexit 1\n")
    pip.chmod(0o755)
    for stamp in ("packages", "ready"):
        (tmp_path / "venv" / stamp).touch()
    alone = {**os.environ, "MAKEFLAGS": ""}
    command = ["make", f"BUILD={tmp_path}", f"{tmp_path}/venv/docs-ready"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=alone)
    said = [line for line in done.stderr.splitlines() if not re.match(r"make(\[\d+\])?: \*\*\*", line)]
    assert done.returncode == 2 and len(said) == 1 and "is there a network?" in said[0]
