"""What `make sanitize` makes of what it runs."""

import sys

import pytest
from tinykoop.assure import sanitize
from tinykoop.plumbing.errors import UserError


def test_a_command_that_fails_is_a_finding_with_its_last_lines():
    fails = [sys.executable, "-c", "print('heap-use-after-free'); raise SystemExit(1)"]
    passes = [sys.executable, "-c", ""]
    assert sanitize.attempt_all({"good": passes}) == []
    (line,) = sanitize.attempt_all({"good": passes, "bad": fails})
    assert line.startswith("bad: ") and "heap-use-after-free" in line


@pytest.mark.parametrize("result, message", [((3, ["bad: heap-use-after-free"]), "heap-use-after-free"), ((0, []), "no test was run")])
def test_findings_and_an_empty_run_fail(monkeypatch, tmp_path, result, message):
    monkeypatch.setattr(sanitize, "CHECKS", {"stand-in": lambda: result})
    monkeypatch.setattr(sanitize, "need", lambda programs: None)
    with pytest.raises(UserError, match=message):
        sanitize.run(tmp_path)
    assert (tmp_path / "sanitize.json").exists()


def test_what_is_left_out_exists():
    subjects = {path.stem.removeprefix("test_") for path in (sanitize.ROOT / "test/c").glob("test_*.c")}
    assert set(sanitize.NO_VALGRIND) <= subjects
    assert all((sanitize.ROOT / "test/python" / name).exists() for name in sanitize.NO_PRELOAD)
