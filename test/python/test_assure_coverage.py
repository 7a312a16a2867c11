"""`make coverage` without clang: how llvm-cov's exports are read, what counts as reached, and what is refused."""

import re

import pytest
from tinykoop.assure import coverage
from tinykoop.assure.coverage import Item
from tinykoop.plumbing.errors import UserError

# if (a && b) { .. } on line 3, of which b was never false; a loop on line 5, from a macro used twice
FUNCTION = {
    "name": "koopf.c:f",
    "filenames": ["/lib/src/a.c", "/lib/src/a.c", "/lib/src/a.c"],
    "branches": [
        [3, 6, 3, 7, 5, 2, 0, 0, 6],
        [3, 11, 3, 12, 5, 0, 0, 0, 6],
        [5, 9, 5, 14, 7, 5, 1, 0, 4],
        [5, 9, 5, 14, 0, 5, 2, 0, 4],
    ],
    "mcdc_records": [[3, 6, 3, 12, 0, 5, [True, False]]],
}
EXPORT = {"data": [{"functions": [FUNCTION]}]}
LCOV = "SF:/lib/src/a.c\nFN:1,f\nDA:3,7\nDA:4,0\nend_of_record\nSF:/lib/src/b.c\nDA:1,2\nend_of_record\n"


def unreached(items):
    return [(item.kind, item.file, item.line, item.what) for item in items if not item.reached]


def test_reads_lines():
    items = list(coverage.read_lines(LCOV))
    assert [(item.file, item.line) for item in items] == [("/lib/src/a.c", 3), ("/lib/src/a.c", 4), ("/lib/src/b.c", 1)]
    assert unreached(items) == [("lines", "/lib/src/a.c", 4, "line")]


def test_reads_both_ways_of_a_branch_and_each_use_of_a_macro():
    items = list(coverage.read_branches(FUNCTION))
    assert len(items) == 8
    assert unreached(items) == [
        ("branches", "/lib/src/a.c", 3, "column 11 never false"),
        ("branches", "/lib/src/a.c", 5, "column 9 never true"),
    ]


def test_reads_conditions_where_they_are():
    items = list(coverage.read_conditions(FUNCTION))
    assert [(item.line, item.what.split()[1], item.reached) for item in items] == [(3, "6", True), (3, "11", False)]


def units(lib):
    """Two compilations, of which the second reaches all."""
    first = coverage.read_items(EXPORT, LCOV, lib)
    return {"koopf": first, "koopd": [Item(i.kind, i.file, i.line, i.what, True) for i in first]}


def test_each_precision_counts_by_itself():
    both = units("/lib")
    lacking = coverage.missing(both)
    assert all(names == {"koopf"} for names in lacking.values())
    assert {(item.file, item.line) for item in lacking} == {("src/a.c", 3), ("src/a.c", 4), ("src/a.c", 5)}
    files = coverage.counts(both, {})
    count = files["src/a.c"]
    assert [(count[kind], count[kind, "reached"]) for kind in coverage.KINDS] == [(4, 3), (16, 14), (4, 3)]
    assert coverage.percent(count, "branches") == 100 * 14 / 16
    assert coverage.percent(files["src/b.c"], "branches") == 100  # there are none


def test_what_is_not_reached_is_said_with_its_place_and_text():
    lines = coverage.failures(coverage.missing(units("/lib")), {}, lambda file, line: f"text of {line}")
    assert lines == [
        "lib/src/a.c:3: column 11 never false (koopf): text of 3",
        "lib/src/a.c:3: column 11 does not decide by itself (koopf): text of 3",
        "lib/src/a.c:4: line (koopf): text of 4",
        "lib/src/a.c:5: column 9 never true (koopf): text of 5",
    ]


def test_a_reason_is_read_off_its_line_and_excuses_that_line_alone(tmp_path):
    (tmp_path / "src").mkdir()
    (tmp_path / "src/a.c").write_text("\n\nif (a && b) { /* never: b holds since x */\n/* never did: */ int never;\n")
    reasons = coverage.read_reasons(tmp_path)
    assert reasons == {("src/a.c", 3): "b holds since x"}
    both = units("/lib")
    lines = coverage.failures(coverage.missing(both), reasons, lambda file, line: "")
    assert [line.split(": ")[0] for line in lines] == ["lib/src/a.c:4", "lib/src/a.c:5"]
    count = coverage.counts(both, reasons)["src/a.c"]
    assert [(count[kind], count[kind, "reached"]) for kind in coverage.KINDS] == [(2, 1), (8, 7), (0, 0)]


def test_a_reason_that_is_not_needed_is_an_error():
    lines = coverage.failures(coverage.missing(units("/lib")), {("src/b.c", 1): "why"}, lambda file, line: "")
    assert any(re.match(r"lib/src/b\.c:1: the tests do reach this", line) for line in lines)


def test_run_writes_the_figures_and_refuses_what_is_not_reached(monkeypatch, tmp_path):
    written = {}
    monkeypatch.setattr(coverage, "need_tools", lambda: None)
    monkeypatch.setattr(coverage, "build_and_test", lambda kernel: kernel)
    monkeypatch.setattr(coverage, "read_reasons", dict)
    monkeypatch.setattr(coverage, "source", lambda file, line: "text")
    monkeypatch.setattr(coverage, "write_json", lambda path, rows: written.update(rows))
    monkeypatch.setattr(coverage, "read_unit", lambda kernel, precision: units("/lib")[precision])
    with pytest.raises(UserError, match="koopf scalar, koopf vectors"):
        coverage.run(tmp_path)
    assert written["lines"] < 100 and len(written["missing"]) == 4
    monkeypatch.setattr(coverage, "read_unit", lambda kernel, precision: units("/lib")["koopd"])
    assert coverage.run(tmp_path) == {"lines": 100, "branches": 100, "mcdc": 100}
    assert written["missing"] == []


def test_says_which_tools_are_missing(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match="sudo apt-get install clang-19 llvm-19"):
        coverage.run(tmp_path / "out")


def test_the_c_tests_see_the_public_headers_alone():
    own = {path.name for path in (coverage.ROOT / "test/c").glob("*.h")}
    for path in (coverage.ROOT / "test/c").glob("*.[ch]"):
        included = set(re.findall(r'#include "(.*)"', path.read_text()))
        assert included <= own | {"tinykoop.h", "tinykoop_supervisor.h", "unity.h"}, path
