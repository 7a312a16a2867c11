"""`make fuzz` without a fuzzer: what it reads from libFuzzer's output, what it says of a finding, and its corpus."""

import subprocess

import pytest
from tinykoop.assure import fuzz
from tinykoop.plumbing.errors import UserError

STATS = "stat::number_of_executed_units: {}\nstat::average_exec_per_sec:     5\n"

CLEAN = "#2\tINITED cov: 89 ft: 260\n#168575\tDONE   cov: 89 ft: 260\nDone 168575 runs in 11 second(s)\n" + STATS.format(168575)

BROKEN_PROMISE = """#2\tINITED cov: 89
FINDING /a/test/fuzz/world.c:434: b > 0: b = 0
==20200== ERROR: libFuzzer: deadly signal
    #0 0x7f1 in __sanitizer_print_stack_trace (/a/build/fuzz/tree/test/fuzz/fuzz_calls_koopf+0x143df1)
    #8 0x561 in call_lowpass_init /a/test/fuzz/world.c:434:27
    #9 0x562 in call /a/test/fuzz/world.c:694:2
artifact_prefix='/a/'; Test unit written to /a/findings/calls-crash-0dc9
""" + STATS.format(12)

UNDEFINED = """/a/lib/src/newton.c:299:2: runtime error: addition of unsigned offset overflowed
    #0 0x561 in take_rows /a/lib/src/newton.c:299:2
SUMMARY: UndefinedBehaviorSanitizer: undefined-behavior
Test unit written to /a/findings/sequence-crash-1
"""

ENDLESS = """ALARM: working on the last Unit for 7 seconds
Test unit written to /a/findings/timeout-26d1
==25188== ERROR: libFuzzer: timeout after 7 seconds
    #5 0x561 in square_above /a/lib/src/newton.c:167:9
SUMMARY: libFuzzer: timeout
""" + STATS.format(3)


def test_executions_are_those_of_the_last_count():
    assert fuzz.executions(CLEAN) == 168575
    assert fuzz.executions(BROKEN_PROMISE) == 12
    assert fuzz.executions(STATS.format(1) + STATS.format(2)) == 2


def test_output_without_a_count_is_not_taken_for_none():
    with pytest.raises(UserError, match="no count.*\n.*cannot allocate"):
        fuzz.executions("cannot allocate memory")


def test_a_clean_run_has_no_finding():
    assert fuzz.finding(CLEAN) is None


@pytest.mark.parametrize(
    "text, path, first, frames",
    [
        (BROKEN_PROMISE, "/a/findings/calls-crash-0dc9", "FINDING /a/test/fuzz/world.c:434: b > 0: b = 0", 2),
        (UNDEFINED, "/a/findings/sequence-crash-1", "/a/lib/src/newton.c:299:2: runtime error: addition of unsigned offset overflowed", 1),
        (ENDLESS, "/a/findings/timeout-26d1", "==25188== ERROR: libFuzzer: timeout after 7 seconds", 1),
    ],
)
def test_a_finding_is_the_input_and_the_first_telling_lines(text, path, first, frames):
    found = fuzz.finding(text)
    assert found["input"] == path
    assert found["report"][0] == first
    assert len(found["report"]) == 1 + frames and all(line.startswith("#") for line in found["report"][1:])


def test_complaint_says_how_to_see_it_again():
    said = fuzz.complaint("calls_koopf", fuzz.finding(BROKEN_PROMISE), "build/fuzz_calls_koopf")
    assert said.splitlines()[0] == "calls_koopf: FINDING /a/test/fuzz/world.c:434: b > 0: b = 0"
    assert said.splitlines()[-1].strip() == "again: build/fuzz_calls_koopf /a/findings/calls-crash-0dc9"


# ---- the command --------------------------------------------------------------------------------------------


@pytest.fixture
def outputs(monkeypatch, tmp_path):
    """Puts texts in place of the runs; tells which commands were asked for."""
    asked = []

    def use(texts):
        def call(target, *arguments, timeout):
            asked.append((target, [str(argument) for argument in arguments]))
            return texts.get(target, CLEAN)

        monkeypatch.setattr(fuzz, "BUILD", tmp_path / "build")
        monkeypatch.setattr(fuzz, "build", lambda: None)
        monkeypatch.setattr(fuzz, "call", call)
        return asked

    return use


def test_every_target_gets_its_time_and_its_corpus(outputs, tmp_path):
    asked = outputs({})
    rows = fuzz.run(tmp_path / "out", 7)
    assert [row["target"] for row in rows] == list(fuzz.TARGETS)
    assert sorted(target for target, _ in asked) == sorted(fuzz.TARGETS)  # side by side, so in any order
    assert all(row == {"target": row["target"], "executions": 168575, "findings": 0} for row in rows)
    assert (tmp_path / "out/fuzz.json").is_file()
    for target, arguments in asked:
        assert "-max_total_time=7" in arguments
        assert arguments[-1] == str(fuzz.COMMITTED / fuzz.TARGETS[target])
        assert arguments[-2] == str(tmp_path / "build/corpus" / fuzz.TARGETS[target])


def test_a_finding_stops_no_other_target_and_fails_the_command(outputs, tmp_path):
    asked = outputs({"calls_koopf": BROKEN_PROMISE})
    with pytest.raises(UserError, match="calls_koopf: FINDING"):
        fuzz.run(tmp_path / "out", 1)
    assert len(asked) == len(fuzz.TARGETS)
    assert '"findings": 1' in (tmp_path / "out/fuzz.json").read_text()


@pytest.mark.parametrize("seconds", [0, -1, float("nan")])
def test_no_time_is_refused(outputs, tmp_path, seconds):
    asked = outputs({})
    with pytest.raises(UserError, match="--seconds"):
        fuzz.run(tmp_path / "out", seconds)
    assert not asked


def test_says_what_is_missing(monkeypatch, tmp_path):
    monkeypatch.setattr("shutil.which", lambda name: None if name == fuzz.COMPILER else name)
    with pytest.raises(UserError, match="sudo apt-get install clang-19 libclang-rt-19-dev"):
        fuzz.build()
    monkeypatch.setattr("shutil.which", lambda name: name)
    monkeypatch.setattr(fuzz.subprocess, "run", lambda *a, **k: subprocess.CompletedProcess(a, 1))
    with pytest.raises(UserError, match="libFuzzer.*sudo apt-get install clang-19 libclang-rt-19-dev"):
        fuzz.build()


# ---- the committed corpus --------------------------------------------------------------------------------------


def test_corpus_is_there_and_small():
    folders = {path.name: list(path.iterdir()) for path in fuzz.COMMITTED.iterdir()}
    assert set(folders) == set(fuzz.TARGETS.values())
    assert all(len(files) >= 5 for files in folders.values())
    files = [path for folder in folders.values() for path in folder]
    assert len(files) < 400 and sum(path.stat().st_size for path in files) < 300_000


def test_inputs_named_by_hand_are_kept(tmp_path):
    assert fuzz.is_regression(tmp_path / "endless-search-for-bounds")
    assert not fuzz.is_regression(tmp_path / "0dc98c2950c2c4539d0eb429df5f30ca8b0104fd")
