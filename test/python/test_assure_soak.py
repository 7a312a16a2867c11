"""The soak: what it judges, and one kind of estimator through every fault."""

import json

import pytest
from tinykoop.assure import campaigns, soak
from tinykoop.plumbing.errors import UserError

REFUSED = {"input": 0, "overflow": 0, "indefinite": 0, "outlier": 0, "range": 0}
SOUND = {
    "condition": "stuck sensor", "dictionary": "poly_ddr", "regulator": "ef", "form": "sqrt", "precision": "f32", "gate": 1,
    "updates": 1000, "refused": REFUSED | {"outlier": 40}, "restored": 1, "non_finite_without_status": 0, "lost": 0,
    "episodes": 4, "recovered": 4, "steps_to_recover": 120, "limit": 394, "error_ratio": 1.01,
}  # fmt: skip


def test_what_must_hold():
    bare = SOUND | {"gate": 0, "recovered": 1}
    assert soak.failures([SOUND, bare]) == []
    assert soak.failures([SOUND, SOUND | {"recovered": 3}]) == [
        "stuck sensor, poly_ddr ef sqrt f32 gated: 1 of 4 faults not recovered from in 394 steps"
    ]
    assert soak.failures([bare | {"lost": 2}]) == ["stuck sensor, poly_ddr ef sqrt f32 bare: 2 times Theta or P was lost"]
    assert soak.failures([bare | {"non_finite_without_status": 7}]) == [
        "stuck sensor, poly_ddr ef sqrt f32 bare: 7 outputs not finite without a status"
    ]


def test_figures_of_the_table():
    slower = SOUND | {"steps_to_recover": 300, "refused": REFUSED | {"outlier": 2, "input": 5}}
    assert soak.cell([SOUND, slower]) == "300"
    assert soak.cell([]) == "-"
    assert soak.cell([SOUND, slower | {"recovered": 3}]) == "87.5 %"
    assert soak.refused([SOUND, slower]) == {"outlier": 42, "input": 5}
    assert list(soak.by_condition([SOUND, SOUND | {"condition": "NaN bursts"}, slower])) == ["stuck sensor", "NaN bursts"]


@pytest.mark.parametrize("updates", [0, -1.0, float("nan")])
def test_updates_that_are_none(updates, tmp_path):
    with pytest.raises(UserError, match="at least 1 is needed"):
        soak.run(tmp_path, updates)


def test_a_run_that_does_not_hold_is_refused_and_written_down(tmp_path, monkeypatch):
    monkeypatch.setattr(campaigns, "build", lambda name: None)
    monkeypatch.setattr(soak, "rows_of", lambda kind, updates: [SOUND | {"recovered": 3}, SOUND | {"gate": 0}])
    with pytest.raises(UserError, match="1 of 2 runs do not hold: stuck sensor, poly_ddr ef sqrt f32 gated: 1 of 4"):
        soak.run(tmp_path, 100, soak.KINDS[:1])
    assert len(json.loads((tmp_path / "soak.json").read_text())) == 2


def test_one_kind_through_every_fault(tmp_path):
    kind = ("koopf", "poly_ddr", "ef", "plain")
    rows = soak.run(tmp_path, 1, [kind])
    assert json.loads((tmp_path / "soak.json").read_text()) == rows
    assert (tmp_path / "soak.png").stat().st_size > 10_000
    assert len(rows) == 24 and all(set(row) == set(SOUND) for row in rows)
    of = {(row["condition"], row["gate"]): row for row in rows}
    assert len(of) == 24
    assert of["rich excitation", 0]["error_ratio"] == of["rich excitation", 1]["error_ratio"] == 1
    for gate in (0, 1):
        missing = of["missing sensor", gate]
        assert missing["refused"]["input"] > 0 and missing["steps_to_recover"] == 0
    assert of["scale jumps by 1e12", 1]["refused"]["range"] > 0
    assert of["spiking sensor", 1]["refused"]["outlier"] > 0
    assert of["spiking sensor", 0]["refused"] == REFUSED
    assert soak.rows_of(kind, 1) == rows, "the same every time"
