"""The flipped bits: what it judges, and one kind of learner with a bit of every part of its storage flipped."""

import json

import pytest
from tinykoop.assure import campaigns, flips
from tinykoop.plumbing.errors import UserError

ROW = {
    "what": "Theta", "configuration": "gate_checksum", "regulator": "ef", "form": "sqrt", "check": "refuse", "precision": "f32",
    "trials": 1000, "detected": 990, "harmless": 9, "silent": 1, "for_ever": 0, "unsafe": 0, "example": "word 3, bit 30, after 812 samples",
}  # fmt: skip
BARE = ROW | {"configuration": "alone", "silent": 300, "for_ever": 20}
WHERE = "ef sqrt refuse f32, first word 3, bit 30, after 812 samples"


def test_a_thousandth_may_be_silent_with_gate_and_checksum():
    assert flips.failures([ROW, BARE]) == []
    assert flips.failures([ROW | {"silent": 2}]) == [f"Theta, gate, checksum: 2 of 1000 flipped bits are silent ({WHERE})"]
    assert flips.failures([ROW | {"silent": 2}, ROW | {"silent": 0}]) == [], "of all kinds together"
    assert len(flips.failures([ROW | {"silent": 2}, ROW | {"what": "P", "silent": 0}])) == 1, "but of each part by itself"


def test_nothing_may_be_refused_for_ever_with_gate_and_checksum():
    for use in flips.PROTECTED:
        lines = flips.failures([ROW, ROW | {"configuration": use, "silent": 0, "for_ever": 1}])
        assert len(lines) == 1 and "are refused forever" in lines[0]


def test_no_input_may_be_unsafe_anywhere():
    assert "1 of 1000 lead to an input outside its limits" in flips.failures([BARE | {"unsafe": 1}])[0]


def test_the_example_is_of_a_row_that_has_one():
    rows = [ROW | {"silent": 0, "regulator": "none", "example": None}, ROW]
    assert flips.example(rows, "silent") == WHERE


def test_figures_of_the_table():
    assert flips.cells([ROW, ROW | {"silent": 0, "harmless": 10, "for_ever": 2}]) == ["2,000", "99.00", "0.95", "0.05", 2, 0]
    assert list(flips.groups([ROW, BARE, ROW | {"what": "P"}, ROW])) == [
        ("Theta", "alone"), ("Theta", "gate_checksum"), ("P", "gate_checksum"),
    ]  # fmt: skip


def test_trials_are_shared_out_among_the_parts():
    assert flips.trials_of_part(240_000) * sum(flips.PARTS[use] for _, use, *_ in flips.KINDS) == pytest.approx(240_000, rel=0.01)
    assert flips.trials_of_part(1) == 1


@pytest.mark.parametrize("trials", [0, -1.0, float("nan")])
def test_trials_that_are_none(trials, tmp_path):
    with pytest.raises(UserError, match="at least 1 is needed"):
        flips.run(tmp_path, trials, 1)


def test_a_seed_that_does_not_fit(tmp_path):
    with pytest.raises(UserError, match="--seed -1: from 0"):
        flips.run(tmp_path, 1, -1)


def test_what_does_not_hold_is_refused_and_written_down(tmp_path, monkeypatch):
    monkeypatch.setattr(campaigns, "build", lambda name: None)
    monkeypatch.setattr(flips, "rows_of", lambda kind, trials, seed: [ROW | {"for_ever": 1}, BARE])
    with pytest.raises(UserError, match="1 promises do not hold: Theta, gate, checksum: 1 of 1000 are refused forever"):
        flips.run(tmp_path, 100, 1, flips.KINDS[:1])
    assert len(json.loads((tmp_path / "flips.json").read_text())) == 2


def test_every_part_of_one_kind_in_every_use(tmp_path):
    kinds = [("koopf", use, "ef", "plain", "refuse") for use in flips.USES]
    rows = flips.run(tmp_path, 1, 1, kinds)
    assert json.loads((tmp_path / "flips.json").read_text()) == rows
    assert {use: sum(row["configuration"] == use for row in rows) for use in flips.USES} == flips.PARTS
    assert all(set(row) == set(ROW) and row["trials"] == 1 for row in rows)
    assert all(row["detected"] + row["harmless"] + row["silent"] == 1 for row in rows)
    assert flips.rows_of(kinds[2], 1, 1) == [row for row in rows if row["configuration"] == "gate"], "the same every time"


def test_a_learner_without_protection_has_silent_bits_and_one_with_a_checksum_has_none():
    campaigns.build("flips")
    silent = {use: flips.rows_of(("koopf", use, "none", "sqrt", "refuse"), 200, 1)[0] for use in ("alone", "checksum")}
    assert silent["alone"]["what"] == "Theta" and silent["alone"]["silent"] > 0
    assert silent["checksum"]["silent"] == 0 and silent["checksum"]["detected"] == 200
