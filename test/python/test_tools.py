"""The tinykoop command: results as the contract has them, bad input in one line and exit status 2."""

import argparse
import json
import math
import subprocess
from pathlib import Path

import numpy as np
import processes
import pytest
from tinykoop import bridge, cli
from tinykoop.experiments import ablate, control, learn, scenario, windup
from tinykoop.logs import fit
from tinykoop.plumbing import results
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]


def tinykoop(*arguments, cwd=None):
    """(exit status, standard error) of the command."""
    done = processes.tinykoop(*arguments, cwd=cwd)
    assert "…" not in done.stdout, "a table is cut"
    return done.returncode, done.stderr


@pytest.fixture(scope="module")
def noisy_log(tmp_path_factory):
    """A 60 s drive of the slipping robot with measurement noise."""
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    u = scenario.commands(1200)
    x = bridge.simulate(u, 0.05, active=[bridge.usual_effect("pacejka_slip")])
    x += np.random.default_rng(3).normal(0, 1e-3, x.shape)
    bridge.write_log(path, x, np.vstack([u, u[-1]]), 0.05)
    return path


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    out = tmp_path_factory.mktemp("learn")
    learn.run(out)
    return out


def strict_json(path):
    """JSON proper has no NaN."""
    return json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} in {path.name}"))


def test_learn_json(learned):
    rows = strict_json(learned / "learn.json")
    keys = {
        "dictionary", "regulator", "precision", "steps", "mean_error", "final_P_fro", "final_A_fro", "skip_rate",
        "lost_positive_definite_at", "non_finite_at", "rollout_error", "update_us",
    }  # fmt: skip
    assert len(rows) == 2 * len(scenario.METHODS)
    assert all(set(row) == keys and set(row["rollout_error"]) == {"1", "10", "50"} for row in rows)
    assert {row["precision"] for row in rows} == {"f32", "f64"}
    sift = next(r for r in rows if (r["dictionary"], r["regulator"], r["precision"]) == ("rbf", "sift", "f64"))
    assert math.isclose(sift["final_P_fro"], 348.0018460302284, rel_tol=1e-3)


def test_learn_plots(learned):
    plots = sorted(path.name for path in learned.glob("*.png"))
    assert plots == [
        "learn_adaptation.png",
        "learn_covariance.png",
        "learn_covariance_others.png",
        "learn_error.png",
        "learn_error_others.png",
        "learn_operator.png",
        "learn_operator_others.png",
        "learn_paths.png",
        "learn_precision.png",
    ]
    assert not list(learned.glob("*.part"))


@pytest.fixture(scope="module")
def controlled(tmp_path_factory):
    out = tmp_path_factory.mktemp("control")
    control.run(out)
    rows = strict_json(out / "control.json")
    return {(r["dictionary"], r["regulator"], r["precision"]): r for r in rows}


# Independent reproduction in NumPy with another solver: error, its band, energy
TRACKED = {
    "offline": (0.04686, 0.02, 3.544),
    "dz_cs": (0.0409, 0.08, 3.553),
    "dz_ks": (0.0383, 0.02, 3.541),
    "ct": (0.0452, 0.02, 3.571),
    "sift": (0.0383, 0.02, 3.567),
}


@pytest.mark.parametrize("regulator", TRACKED)
def test_control_bands(controlled, regulator):
    error, band, energy = TRACKED[regulator]
    row, narrow = (controlled["rbf", regulator, precision] for precision in ("f64", "f32"))
    assert abs(row["mean_error"] / error - 1) < band
    assert abs(row["control_energy"] / energy - 1) < 0.01
    assert row["fallback_rate"] == narrow["fallback_rate"] == 0
    assert abs(narrow["mean_error"] / row["mean_error"] - 1) < 0.05
    assert row["kkt_residual_max"] < 1e-8
    assert set(row["solve_us"]) == {"median", "p95", "max"}


def test_inputs_at_a_bound_are_counted_by_bound():
    u = np.array([[0.0, 0.3], [3.5, 1.2], [1.0, -1.2], [1.0, 0.0]])
    assert control.at_bounds(u) == {"v_min": 0.25, "v_max": 0.25, "omega_min": 0.25, "omega_max": 0.25, "any": 0.75}


def test_the_gain_under_constant_trace_is_that_of_the_change_of_theta():
    """Theta changes by K times the error of the prediction: the gain's norm follows from Theta alone."""
    x, u = scenario.drive(60)
    tau0 = 9 * scenario.P0
    estimator, trace = scenario.run(scenario.Method("poly", "ct"), 64, x, u, every=1, tau0=tau0)
    psi = estimator.lift(x)
    zeta = np.concatenate([psi[:-1], u], axis=1)
    ratios = []
    for k in range(1, 59):
        error = psi[k + 1] - trace["theta"][k] @ zeta[k]
        change = trace["theta"][k + 1] - trace["theta"][k]
        ratios.append(np.linalg.norm(change) / np.linalg.norm(error) * 0.98 / (tau0 * np.linalg.norm(zeta[k])))
    measured = ablate.constant_trace(estimator, trace, x, u, 0.98, tau0)
    assert math.isclose(measured["gain_over_bound"], max(ratios), rel_tol=1e-6)
    assert 0 < measured["norm_over_trace"] <= 1


def test_vanilla_rbf_fails_to_control(controlled):
    row = controlled["rbf", "ef", "f64"]
    assert row["fallback_rate"] >= 0.97 and row["mean_error"] > 20


@pytest.mark.parametrize("regulator, error", [("ct", 0.0391), ("sift", 0.0394)])
def test_poly_that_keeps_the_path(controlled, regulator, error):
    assert abs(controlled["poly", regulator, "f64"]["mean_error"] / error - 1) < 0.02


def test_departure_is_the_first_step_beyond_the_bound():
    reference = {"predicted": np.zeros((5, 3))}
    trace = {"predicted": np.zeros((5, 3))}
    assert windup.first_departure(trace, reference) is None
    trace["predicted"][3, 1] = 2 * windup.LEFT
    assert windup.first_departure(trace, reference) == 3
    trace["predicted"][1, 0] = np.nan
    assert windup.first_departure(trace, reference) == 1


def test_replay(noisy_log, tmp_path):
    status, error = tinykoop("replay", noisy_log, "--out", tmp_path)
    assert (status, error) == (0, "")
    rows = strict_json(tmp_path / "replay_drive.json")
    by = {(r["method"], r.get("form"), r.get("precision")): r["mean_error"] for r in rows if not r.get("gate")}
    assert by["RBF (SIFt)", "sqrt", "f64"] < by["unicycle", None, None] < by["state stays", None, None]
    assert math.isclose(by["RBF (SIFt)", "sqrt", "f32"], by["RBF (SIFt)", "sqrt", "f64"], rel_tol=1e-2)
    gated = {r["method"]: r["mean_error"] for r in rows if r.get("gate")}
    assert len(gated) == len(scenario.METHODS) - 1
    assert all(error < 1.1 * by[name, "sqrt", "f32"] for name, error in gated.items())
    assert (tmp_path / "replay_drive.png").stat().st_size > 10_000


@pytest.mark.parametrize("regulator", ["none", "sift"])
@pytest.mark.parametrize("precision", [32, 64])
def test_estimator_behind_the_gate_forgets_a_fault(precision, regulator):
    """On a drive with every sensor stuck for ten seconds."""
    u = scenario.commands(3000)
    x = bridge.simulate(u, 0.05)
    stuck = x.copy()
    stuck[1500:1700] = x[1500]
    after = {}
    for name, seen, gate in (("sound", x, False), ("gated", stuck, True), ("bare", stuck, False)):
        estimator = bridge.Estimator("poly_ddr", regulator, precision, form="sqrt", gate=gate)
        after[name] = np.nanmean(estimator.replay(seen, u)["error"][2000:])
    assert after["gated"] < 1.05 * after["sound"] < after["bare"] / 2


@pytest.mark.parametrize("precision", [32, 64])
def test_fitted_model_starts_firmware(noisy_log, tmp_path, precision, firmware):
    """The header compiles, loads, and holds the least-squares fit of the log."""
    fit.run(noisy_log, tmp_path / "model.h", "poly", precision, p0=1e6)
    koop, real = {32: ("koopf", "float"), 64: ("koopd", "double")}[precision]
    (tmp_path / "main.c").write_text(f"""
#include "tinykoop.h"
#include "model.h"
#include <stdio.h>
static {real} storage[KOOP_RLS_REALS_SQRT(7, 2)];
int main(void) {{
	static {koop}_rls rls;
	{real} theta[7 * 9];
	const {koop}_config config = {{.dictionary = &{koop}_poly_ddr, .n_inputs = 2, .regulator = &{koop}_reg_ef,
		.form = &{koop}_form_sqrt, .lambda = 1, .p0 = 1}};
	if ({koop}_rls_init(&rls, &config, storage, sizeof storage / sizeof *storage)) {{ return 1; }}
	if ({koop}_model_load(&rls, koop_model, sizeof koop_model)) {{ return 2; }}
	{koop}_rls_get_theta(&rls, theta);
	for (int i = 0; i < 63; i++) {{ printf("%.17g\\n", (double)theta[i]); }}
	return 0;
}}
""")
    subprocess.run(["gcc", "-std=c99", "-I", ROOT / "lib/include", "main.c", firmware(koop), "-o", "main", "-lm"], check=True, cwd=tmp_path)
    printed = subprocess.run([tmp_path / "main"], check=True, capture_output=True, text=True).stdout
    theta = np.array(printed.split(), float).reshape(7, 9)

    log = bridge.read_log(noisy_log)
    px, py, angle = log.x.T
    psi = np.stack([px, py, angle, px**2, py**2, np.sin(angle), np.cos(angle)], axis=1)
    zeta = np.hstack([psi[:-1], log.u[:-1]])
    ridge = np.vstack([zeta, 1e-3 * np.eye(9)])
    expected = np.linalg.lstsq(ridge, np.vstack([psi[1:], np.zeros((9, 7))]), rcond=None)[0].T
    assert np.abs(theta - expected).max() < {32: 1e-5, 64: 1e-8}[precision] * np.abs(expected).max()


@pytest.mark.parametrize(
    "arguments, says",
    [
        (("replay", "missing.csv"), "missing.csv: cannot be opened"),
        (("replay", "bad.csv"), "bad.csv:3: column 'px' (2): 'x' is not a finite number"),
        (("replay", "short.csv"), "short.csv: 4 usable steps, at least 100 are needed"),
        (("fit", "short.csv", "model.txt"), "model.txt: the model is written as .h"),
        (("learn", "--out", "short.csv/out"), "cannot be made as output folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(arguments, says, tmp_path):
    (tmp_path / "bad.csv").write_text("t,px,py,theta,v,omega\n0,0,0,0,0,0\n0.1,x,0,0,0,0\n0.2,0,0,0,0,0\n")
    (tmp_path / "short.csv").write_text("t,px,py,theta,v,omega\n" + "".join(f"{k},0,0,0,1,0\n" for k in range(5)))
    status, error = tinykoop(*arguments, cwd=tmp_path)
    assert status == 2
    assert says in error
    assert error.startswith("tinykoop: ") and error.count("\n") == 1


def test_plots_are_written_in_other_formats_with_the_traces_that_they_show(tmp_path, monkeypatch):
    from tinykoop.plumbing import plots

    figure, (left, right) = plots.subplots(1, 2)
    left.plot([0, 1, 2], [3.0, 4.0, 5.0], label="error")
    right.barh([0, 1], [0.5, 7.0])
    monkeypatch.setenv("TINYKOOP_FORMAT", "svg,npz")
    plots.save(figure, tmp_path / "a.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "a.png", "a.svg"]
    shown = np.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(shown["panel0: error"], [[0, 3], [1, 4], [2, 5]])
    np.testing.assert_array_equal(shown["panel1: bars0"], [0.5, 7.0])
    assert b"<svg" in (tmp_path / "a.svg").read_bytes()
    monkeypatch.setenv("TINYKOOP_FORMAT", "bmp")
    with pytest.raises(UserError, match="FORMAT=bmp: plots are written as png, svg, pdf, npz"):
        plots.save(plots.subplots()[0], tmp_path / "b.png")


def test_runs_that_lose_definiteness_are_counted_by_form_and_precision():
    from tinykoop.experiments import windup

    rows = [
        {"form": form, "precision": precision, "lost_positive_definite_at": lost}
        for form, precision, lost in (("plain", "f32", 500), ("plain", "f32", None), ("plain", "f64", None), ("textbook", "f64", 0))
    ]
    _, lines = windup.lost(rows)
    assert lines == [["plain", "1 of 2", "0 of 1"], ["sqrt", "0 of 0", "0 of 0"], ["textbook", "0 of 0", "1 of 1"]]


def test_help_lists_every_command_in_a_group_within_a_terminal():
    help_ = cli.parser().format_help()
    (commands,) = (action.choices for action in cli.parser()._actions if isinstance(action, argparse._SubParsersAction))
    listed = [line.split()[0] for line in help_.splitlines() if line.startswith("  ") and line.split()[0] in commands]
    assert listed == list(commands) and len(commands) > 20
    assert all(f"\n{group}:\n" in help_ for group in cli.GROUPS)
    assert max(map(len, help_.splitlines())) <= 100


def test_no_argument_defaults_to_a_place_outside_the_repository():
    (commands,) = (action.choices for action in cli.parser()._actions if isinstance(action, argparse._SubParsersAction))
    places = {
        (name, action.dest): Path(action.default)
        for name, command in commands.items()
        for action in command._actions
        if isinstance(action.default, Path) or "/" in str(action.default)
    }
    assert places and all(place.is_relative_to(ROOT) for place in places.values()), places


def test_results_are_written_whole_or_not_at_all(tmp_path):
    results.write_json(tmp_path / "a.json", [{"x": float("nan"), "y": [float("inf"), 1.5]}])
    assert strict_json(tmp_path / "a.json") == [{"x": None, "y": [None, 1.5]}]
    with pytest.raises(UserError, match="cannot be written"):
        results.write_json(tmp_path / "missing" / "a.json", [])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json"]


def test_smoothing_is_as_long_as_what_it_smooths():
    """Also where the window is longer, as in the plots of a short log."""
    from tinykoop.plumbing import plots

    assert plots.smooth(np.ones(89), 200) == pytest.approx(np.ones(89), abs=0.5) and len(plots.smooth(np.ones(300), 200)) == 300
