"""The ledger of the paper's claims: verdicts follow from figures, and the page has those that were computed."""

import json
import re

import pytest
from tinykoop.experiments import ledger
from tinykoop.plumbing.errors import UserError

PAGE = ledger.pages.ROOT / "docs/paper.md"


def rows(name, **errors):
    """Rows of an experiment with RBF: {regulator: mean error}."""
    return [{"dictionary": "rbf", "regulator": key, "precision": "f64", "mean_error": value} for key, value in errors.items()]


def results(folder, **experiments):
    for name, found in experiments.items():
        (folder / f"{name}.json").write_text(json.dumps(found))
    return ledger.Results(folder)


def test_every_claim_of_the_page_has_one_of_four_verdicts():
    page = PAGE.read_text()
    lines = [line for line in page.splitlines() if "| `make " in line]
    assert len(lines) == len(ledger.CLAIMS)
    for (claim, command, _), line in zip(ledger.CLAIMS, lines):
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert cells[0] == claim and cells[1] == f"`make {command}`"
        assert cells[3] in (ledger.HOLDS, ledger.DIFFERS, ledger.CONTRADICTED, ledger.OPEN)


def test_rankings_agree_or_not(tmp_path):
    learned = rows("learn", dz_cs=1.0, sift=2.0, dz_ks=3.0, ct=4.0)
    agreeing = results(tmp_path, learn=learned, control=rows("control", dz_cs=0.1, sift=0.2, dz_ks=0.3, ct=0.4))
    assert ledger._rankings(agreeing)[1] == ledger.HOLDS
    other = results(tmp_path, control=rows("control", dz_cs=0.4, sift=0.2, dz_ks=0.3, ct=0.1))
    said, verdict = ledger._rankings(other)
    assert verdict == ledger.CONTRADICTED and "rank correlation -0.80" in said


def test_tracking_is_compared_with_the_offline_model(tmp_path):
    better = results(tmp_path, control=rows("control", offline=0.05, dz_cs=0.04, dz_ks=0.03, ct=0.045, sift=0.02))
    assert ledger._tracking(better)[1] == ledger.HOLDS
    worse = results(tmp_path, control=rows("control", offline=0.05, dz_cs=0.04, dz_ks=0.03, ct=0.055, sift=0.02))
    assert ledger._tracking(worse)[1] == ledger.CONTRADICTED


def test_float32_does_not_count(tmp_path):
    found = results(
        tmp_path, learn=rows("learn", offline=1.0) + [{"dictionary": "rbf", "regulator": "offline", "precision": "f32", "mean_error": 9.0}]
    )
    assert found.errors("learn", "rbf") == {"offline": 1.0}


def test_a_dictionary_of_ones_own_does_not_count(tmp_path):
    mine = [row | {"dictionary": "own.c:mine"} for row in rows("learn", offline=9.0)]
    assert results(tmp_path, learn=rows("learn", offline=1.0) + mine).rows("learn") == rows("learn", offline=1.0)


def flights(source, **errors):
    """Rows of transfer.json with RBF, all four directions alike."""
    directions = ("P->P", "Y->Y", "P->Y", "Y->P")
    return [row | {"source": source, "direction": d, "calibrated": False} for d in directions for row in rows("transfer", **errors)]


def test_real_flights_are_told_and_simulated_ones_decide(tmp_path):
    found = results(tmp_path, transfer=flights("synthetic", offline=1.0, ef=2.0) + flights("mine", offline=2.0, ef=1.0))
    said, verdict = ledger._within_regime(found)
    assert verdict == ledger.HOLDS
    assert said == "P->P rank 1 of 2, Y->Y rank 1 of 2 (simulated flights); P->P rank 2 of 2, Y->Y rank 2 of 2 (real flights)"


@pytest.mark.parametrize(
    "gain, norm, verdict", [(0.03, 1.0, ledger.HOLDS), (1.01, 0.9, ledger.CONTRADICTED), (0.1, 1.2, ledger.CONTRADICTED)]
)
def test_the_bounds_of_constant_trace_are_tried_on_every_run(tmp_path, gain, norm, verdict):
    runs = [{"study": "ct", "gain_over_bound": g, "norm_over_trace": n} for g, n in ((0.001, 0.5), (gain, norm))]
    assert ledger._trace_bounds(results(tmp_path, ablate=runs))[1] == verdict


@pytest.mark.parametrize("error, share, verdict", [(70.0, 0.98, ledger.HOLDS), (70.0, 0.1, ledger.CONTRADICTED), (0.05, 0.98, ledger.OPEN)])
def test_only_runs_that_fail_tell_of_the_lower_bound(tmp_path, error, share, verdict):
    run = {"dictionary": "poly", "regulator": "dz_ks", "precision": "f64", "mean_error": error, "at_bounds": {"v_min": share}}
    assert ledger._lower_bound(results(tmp_path, control=[run]))[1] == verdict


def test_a_missing_experiment_is_named_with_its_command(tmp_path):
    with pytest.raises(UserError, match=re.escape("learn.json: cannot be read; run `make learn` first")):
        ledger.Results(tmp_path).rows("learn")


def test_a_verdict_that_is_not_the_pages_is_refused(tmp_path, monkeypatch):
    claim, command, _ = ledger.CLAIMS[0]
    monkeypatch.setattr(ledger, "CLAIMS", ((claim, command, lambda _: ("none", ledger.CONTRADICTED)),))
    with pytest.raises(UserError, match="UPDATE=1 updates them"):
        ledger.run(tmp_path)
