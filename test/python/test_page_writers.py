"""What commands write into the docs, from small results: the figures of the result, one number per cell."""

import re
import shutil
from types import SimpleNamespace

import pytest
from tinykoop.assure import coverage, determinism, flips, fuzz, mutants, sanitize, soak
from tinykoop.bench import learners
from tinykoop.bench import page as bench
from tinykoop.blind import page as blind
from tinykoop.experiments import real, scenario, supervisor, transfer
from tinykoop.experiments.study import tables as study
from tinykoop.experiments.study.closed_loop import SIGMA
from tinykoop.logs import choose
from tinykoop.plumbing import pages
from tinykoop.plumbing.errors import UserError

NUMBER = re.compile(r"\d[\d.,]*(?:e-?\d+)?")


def cells(markdown):
    """{first cell of a line: the others}; each of those holds one number at most."""
    bodies = re.findall(r"^\| ---.*\n((?:\|.*\n)+)", markdown, re.M)
    lines = [line.strip("| ").split(" | ") for body in bodies for line in body.splitlines()]
    assert all(len(NUMBER.findall(cell)) <= 1 for line in lines for cell in line[1:])
    return {line[0]: line[1:] for line in lines}


@pytest.fixture
def written(monkeypatch):
    """{region or name: what was written}."""
    found = {}
    monkeypatch.setattr(pages, "update", lambda page, name, contents: found.update({name: contents}))
    monkeypatch.setattr(pages, "headline", lambda name, value: found.update({name: value}))
    return found


def timed(task, ours, peer, name="Eigen"):
    return {"task": task, "ours": ours, "peer": peer, "ratio": round(peer / ours, 3), "peer_name": name, "samples_per_second": 2_340_000}


def bench_rows():
    tasks = [f"rls_update_{p}{s}{v}" for p in ("f32", "f64") for s in ("", "_O2") for v in ("", "_sqrt", "_checked")]
    rows = [timed(task, 200.0, 250.0) for task in tasks] + [timed("rls_update_f32_numpy", 200.0, 9248.0, "NumPy")]
    rows += [timed(f"replay_f32_N20_{r}{s}", 400.0, 400.0) for r in ("none", *scenario.REGULATORS) for s in ("", "_sqrt")]
    rows += [
        timed(f"qp_{mode}_1e-6_f64{o}", 50.0, peer, name)
        for mode in ("cold", "warm")
        for o in ("", "_O3")
        for name, peer in (("DAQP, tolerance 1", 200.0), ("CVXPY, dense", 900.0))
    ]
    for tasks, names in ((("fit",), learners.BATCH), (("update",), (*learners.ONLINE, learners.AT_ONCE))):
        rows += [timed(f"python_{task}, {name}", 2.0, 3.0, name) for task in (*tasks, "error_1", "error_10") for name in names]
    rows += [timed("python_fit_function", 0.01, 0.2, "asked for"), timed("python_update_function", 0.1, 0.2, "asked for")]
    rows += [timed("python_fit_built_in", 0.01, 0.008, learners.IN_C)]
    rows += [timed("qp_cold_1e-6_f64", 50.0, 800.0, "PIQP"), timed("qp_warm_1e-6_f64", 50.0, 800.0, "PIQP, no warm start")]
    return rows


def test_bench_writes_times_ratios_and_the_headline(written):
    bench.write(bench_rows())
    update = cells(written["bench-update"])
    assert update["Eigen / TinyKoop, median of pairs"] == ["1.25"] * 4
    assert update["NumPy"] == ["9,248", "-", "-", "-"]
    solve = cells(written["bench-solve"])
    assert solve["TinyKoop -O2"] == ["50", "50", "-", "-"] and solve["DAQP"] == ["200", "200", "-", "-"]
    assert solve["CVXPY, dense"] == ["900", "900", "-", "-"] and solve["PIQP"] == ["800", "-", "-", "-"]
    assert solve["TinyKoop -O2 / nearest peer, median of pairs"] == ["0.25", "0.25", "-", "-"]
    assert cells(written["bench-replay"])["vanilla"] == ["2.34", "2.34"]
    python = cells(written["bench-python"])
    assert python["pykoop, Edmd"] == ["3", "-", "3", "3", "1.5"] and python["odmd, OnlineDMD"] == ["-", "3", "3", "3", "1.5"]
    assert [figure for (figure,) in list(python.values())[-3:]] == ["0.01", "0.1", "0.8"]
    assert written["eigen"] == "0.80"


def drive(tier, who="tinykoop", **marks):
    row = {"who": who, "tier": tier, "alias": False, "verdict": "known", "statements": [], "seconds": 1.0, "rows": 2000}
    return row | marks


def test_blind_writes_counts_with_their_intervals_and_the_peers(written):
    rows = [drive("single", top1=k < 3, realised_50=0.99, parameter_errors={"a": 0.01}) for k in range(4)]
    rows += [drive("none_white", false_alarm=k == 0, false_unknown=False) for k in range(5)] + [drive("poor", top1=True)]
    rows += [drive("single_other", who="boosting", family1=True), drive("slipping", family1=True), drive("none_slip", false_alarm=False)]
    rows += [drive("poor", who="boosting", top1=False), drive("never", unknown=True), drive("never", who="boosting", unknown=True)]
    blind.drives({"seal": {"n": 4, "seed": 9}, "rows": rows})
    lines = cells(written["blind"])
    assert lines["single effect named first"][:2] == ["3", "4"]
    healthy = lines["healthy robots recognised as healthy: all kinds of noise, random slip, tiny gaps"]
    assert healthy == ["5", "6", "0.44", "0.97"]  # Wilson, as tabulated: 43.6 to 97.0 %
    assert lines["of these with random slip of 1 to 10 %"][:2] == ["1", "1"]
    assert lines["effect on a robot that slips at random by 1 to 5 %: its family named first"][:2] == ["1", "1"]
    peers = cells(written["blind-peers"])
    assert peers["boosting"][1:3] == ["0", "1"] and peers["tinykoop"][1:3] == ["1", "0"]
    assert (written["blind-single"], written["blind-healthy"]) == ("3 of 4", "5 of 6")
    assert "`make blind N=4 SEED=9`: 13 drives" in written["blind"] and "`make blind N=4 SEED=9`, by peers" in written["blind-peers"]


def test_blind_without_peers_leaves_their_table_and_says_so(written):
    blind.drives({"seal": {"n": 1, "seed": 9}, "rows": [drive("single", top1=True), drive("none_white", false_alarm=False)]})
    assert "blind-peers" not in written and "`make blind N=1 SEED=9 PEERS=no`: 2 drives" in written["blind"]


def test_blind_flights_are_counted_by_tier(written):
    good = {"right": True, "held": True, "held_but": True, "truth": ["lag"], "confidence": {"lag": 0.99}}
    rows = [{"tier": "single", **good}, {"tier": "switch", **good, "edge_error": 0.5, "inside_ci95": [True, False]}]
    rows += [{"tier": "left_out", "truth": ["lag"], "confidence": {"delay": 0.95}}]
    blind.flights(rows, 1, 7)
    lines = cells(written["blind-fwmav"])
    assert lines["one effect, throughout or from some time on"] == ["2", "2", "2", "2", "0"]
    assert lines["one effect, taken out of the library"] == ["1", "0", "0", "0", "1"]
    assert lines["onset off by, median (s)"] == ["0.5"] and lines["inside it"] == ["1"]


def test_blind_robots_have_a_table_each(written):
    rows = [{"tier": "single", "errors": [0.02], "seconds": 12.0, "right": True, "sure_wrong": False, "error": None}]
    blind.robot(SimpleNamespace(NAME="car"), rows, {"none": "none: healthy", "single": "one"}, 1, 7)
    assert cells(written["blind-car"])["one"] == ["1", "1", "0", "2", "12"]


def test_a_campaign_in_which_every_diagnosis_failed_is_not_written(written):
    with pytest.raises(UserError, match="every diagnosis failed, the first with no library"):
        blind.robot(SimpleNamespace(NAME="car"), [{"tier": "single", "error": "no library"}], {"single": "one"}, 1, 7)
    assert not written


def test_supervisor_counts_runs_that_are_lost():
    rows = [
        {"mean_error_without_supervisor": 3.0, "mean_error_supervised": 0.05},
        {"mean_error_without_supervisor": None, "mean_error_supervised": 0.08},
    ]
    lines = cells(supervisor.page(rows, [{"mean_error_without_supervisor": 0.04, "mean_error_supervised": 0.041}]))
    assert [figure for (figure,) in lines.values()] == ["2", "2", "0", "0.08", "1.025"]


def test_study_writes_counts_with_their_intervals():
    cell = {"dictionary": "poly", "regulator": "ef", "sigma": SIGMA, "solver": study.NEWTON, "precision": "f64", "form": "plain"}
    counts = {"runs": 40, "failures": 10, "ci95": [0.142, 0.402]}
    markdown = study.page([cell | {"start": "carried over"} | counts], [{"changed": "$A$ capped"} | counts])
    assert cells(markdown) == {"Theta and P carried over: vanilla": ["40", "10", "14", "40"], "A capped": ["40", "10", "14", "40"]}


def test_transfer_writes_errors_of_all_directions():
    rows = [
        {"dictionary": m.dictionary, "regulator": m.regulator, "precision": p, "calibrated": False, "mean_error": 0.5, "final_P_fro": None, "stays": 0.6}
        for m in scenario.METHODS for p in ("f64", "f32") for _ in transfer.DIRECTIONS
    ]  # fmt: skip
    lines = cells(transfer.page("simulated", rows))
    assert lines["RBF (CT)"] == ["0.5"] * 4 + ["-", "0"] and lines["state stays"][:4] == ["0.6"] * 4


def replayed(gate_error=0.2, refuse=0.1):
    """Rows of a replay with one method and one baseline."""
    row = {
        "source": "gravel",
        "method": "Poly",
        "steps": 900,
        "mean_error": 0.1,
        "lost_positive_definite_at": None,
        "refused": 0,
        "trust": None,
    }
    trust = {"trusted": 0.5, "doubtful": 0.4, "refuse": refuse}
    variants = [("sqrt", "f64", False), ("plain", "f32", False), ("sqrt", "f32", False)]
    rows = [row | dict(zip(("form", "precision", "gate"), variant)) for variant in variants]
    gated = row | {"form": "sqrt", "precision": "f32", "gate": True, "mean_error": gate_error, "trust": trust}
    return [{"source": "gravel", "method": "state stays", "mean_error": 0.3}, *rows, gated]


def test_real_logs_fill_three_tables():
    lines = cells(real.replay_page(replayed()))
    assert lines["Poly"] == ["0.1", "1", "1", "-", "0"] and lines["state stays"] == ["0.3", "-", "-", "-", "-"]
    assert cells(real.float32_page([replayed()])) == {"`gravel`": ["900", "1", "0", "0", "1.000"]}
    gate = cells(real.gate_page([replayed(0.2), replayed(0.1, 0.3)]))
    assert gate["samples called refuse, median (%)"] == ["20"] and gate["at most 1.1 times as large, of these"] == ["1"]
    gap = real.gap_page(
        [{"log": "a", "verdict": "unknown", "fit": ["speed_lag"], "gap": {"before": {"50": 1.3}, "closed_fraction": {"50": 0.74}}}]
    )
    assert "| `a` | unknown | speed_lag | 1.3 | 74 |" in gap


def test_regrets_of_choices_are_written_by_group():
    regrets = {f"d{i}": {"others": v, "single": v / 2, "own": 0.0} for i, v in enumerate((0.01, 0.03, 0.2))}
    lines = cells(real.regret_page([{"group": "real drives", "best": "affine", "regrets": regrets}]))
    assert lines["real drives"] == ["3", "3", "20", "1.5", "10", "0", "0"]


def test_choices_are_compared_within_groups_of_logs(tmp_path, monkeypatch):
    """Two drives of a series and two of each kind of simulated robot; the groups are what their names say."""
    monkeypatch.setattr(real, "SIMULATED", 2)
    monkeypatch.setattr(choose, "LAMBDAS", (0.98,))
    _, one = real.simulated(tmp_path)
    found = [tmp_path / f"cart_{k}.csv" for k in range(2)]
    for path, drive in zip(found, one.values()):
        shutil.copy(drive, path)
    rows = {row["group"]: row["regrets"] for row in real.chosen(found, tmp_path)}
    assert {group: len(regrets) for group, regrets in rows.items()} == {
        "real drives": 2, "`cart_*`": 2, "drives of several simulated robots": 2, "all of these": 4, "drives of one simulated robot": 2,
    }  # fmt: skip
    assert list(rows["`cart_*`"].values()) == list(rows["drives of one simulated robot"].values())


def test_assurance_tables_hold_the_totals():
    figures = {"lines": 100.0, "branches": 99.5, "mcdc": 98.0, "counted": {"lines": 10, "branches": 200, "mcdc": 50}, "never": [1]}
    assert cells(coverage.page(figures))["branches, of 200 (%)"] == ["99.5"]
    score = cells(mutants.page(mutants.Counter(killed=95, equivalent=3, survived=2), 4))
    assert score["mutants drawn"] == ["100"] and score["killed, of those that change anything (%)"] == ["97.9"]
    assert cells(fuzz.page([{"executions": 5, "findings": 0}, {"executions": 7, "findings": 0}], 3))["inputs"] == ["12"]
    assert cells(sanitize.page([{"check": "valgrind", "tests": 38, "findings": []}]))["valgrind"] == ["38", "0"]
    parts = [{"build": b, "precision": "float32", "contracted": b == "fast", "equal": b == "gcc"} for b in ("gcc", "fast")]
    assert cells(determinism.page(parts))["float32: equal"] == ["1"]
    run = {"gate": 1, "updates": 5e7, "episodes": 20, "recovered": 20, "steps_to_recover": 217}
    assert [figure for (figure,) in cells(soak.page([run, run | {"gate": 0, "steps_to_recover": 9999}])).values()] == [
        "1.0e8",
        "20",
        "20",
        "217",
    ]
    flip = {"what": "Theta", "trials": 50, "detected": 25, "harmless": 25, "silent": 0, "for_ever": 0, "unsafe": 0}
    table = cells(flips.page([flip | {"configuration": use} for use in flips.USES], 1))
    assert table["gate, checksum"] == ["50", "50.00", "50.00", "0.00", "0", "0"]


@pytest.mark.parametrize("value, told", [(100.0, "100"), (99.96, "100"), (2.2e-12, "0"), (0.0253, "0.025"), (-0.5, "-0.5"), (1, "1")])
def test_figures_of_the_blind_evaluation_have_no_powers_of_ten(value, told):
    assert blind._figure(value) == told
