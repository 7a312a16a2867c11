"""The study against what can be known without it."""

import json

import numpy as np
import pytest
from test_tools import strict_json, tinykoop
from tinykoop import bridge
from tinykoop.experiments import control, scenario, study
from tinykoop.experiments.study import bistability, causes, closed_loop, sensitivities, solvers
from tinykoop.plumbing.errors import UserError

POLY_CT = scenario.Method("poly", "ct")


@pytest.fixture(scope="module")
def paper():
    return closed_loop.scene()


# Newcombe, "Two-sided confidence intervals for the single proportion", 1998, table I, method 3
@pytest.mark.parametrize(
    "successes, n, low, high",
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson(successes, n, low, high):
    assert np.allclose(closed_loop.wilson(successes, n), (low, high), atol=5e-5)


def test_sensitivities_of_the_nominal_robot_are_those_of_the_unicycle():
    x, u = np.array([3.0, -1.0, 0.3]), scenario.commands(50)
    dt, ahead = scenario.DT, (0, 9, 49)
    theta = x[2] + dt * np.concatenate([[0], np.cumsum(u[:, 1])])
    found = sensitivities.plant_sensitivities(x, u, ahead=ahead)
    for i, j in enumerate(ahead):
        later = slice(1, j + 1)  # a change of omega[0] turns the robot from step 1 on
        expected = [
            [dt * np.cos(theta[0]), -(dt**2) * np.sum(u[later, 0] * np.sin(theta[later]))],
            [dt * np.sin(theta[0]), dt**2 * np.sum(u[later, 0] * np.cos(theta[later]))],
            [0, dt],
        ]
        assert np.allclose(found[i], expected, rtol=0, atol=1e-6)


def test_sensitivities_of_a_model_are_those_of_running_it():
    random = np.random.default_rng(1)
    N = 7
    theta = np.hstack([0.3 * random.standard_normal((N, N)), random.standard_normal((N, 2))])
    psi, u = random.standard_normal(N), random.standard_normal((50, 2))

    def state(u, j):
        z = psi
        for row in u[: j + 1]:
            z = theta @ np.concatenate([z, row])
        return z[:3]

    found = sensitivities.sensitivities(theta, (0, 9, 49))
    for i, j in enumerate((0, 9, 49)):
        for c in range(2):
            moved = u.copy()
            moved[0, c] += 1  # the model is linear: any step will do
            assert np.allclose(found[i][:, c], state(moved, j) - state(u, j), rtol=1e-9, atol=1e-9)


def test_shifted_effects_act_when_they_would_have():
    u = scenario.commands(600)
    effects = scenario.effects((100, 200, 300, 400))
    whole = bridge.simulate(u, scenario.DT, active=effects)
    for k in (0, 95, 250, 399, 500):
        tail = bridge.simulate(u[k:], scenario.DT, whole[k], closed_loop.shifted(effects, k))
        assert np.allclose(tail, whole[k:], rtol=0, atol=1e-12)


def test_capped():
    random = np.random.default_rng(2)
    theta = random.standard_normal((7, 9))
    before, after = (np.linalg.eigvals(t[:, :7]) for t in (theta, causes.capped(theta)))
    assert np.max(np.abs(before)) > causes.RADIUS
    assert np.max(np.abs(after)) < causes.RADIUS + 1e-9
    kept = np.sort_complex(before[np.abs(before) < causes.RADIUS])
    assert len(kept) and all(np.min(np.abs(after - value)) < 1e-9 for value in kept)
    assert np.array_equal(causes.capped(theta)[:, 7:], theta[:, 7:])
    assert causes.capped(theta / 100) is not None and np.array_equal(causes.capped(theta / 100), theta / 100)


def test_stages_make_one_run(paper):
    one = paper.track(paper.learned(POLY_CT), np.zeros(3), (closed_loop.Stage(500),))
    parts = paper.track(paper.learned(POLY_CT), np.zeros(3), (closed_loop.Stage(70), closed_loop.Stage(430)))
    assert one["x"].shape == parts["x"].shape and np.allclose(one["x"], parts["x"], rtol=0, atol=1e-6)


def test_solvers_agree_where_the_program_is_well_posed(paper):
    estimator = paper.learned(POLY_CT)
    step = estimator.theta, estimator.lift(paper.reference[:1])[0], paper.reference[1:51]
    expected = solvers.library(estimator)(*step)
    assert np.allclose(solvers.daqp_solver()(*step), expected, atol=1e-7)
    assert solvers.daqp_solver()(np.full_like(step[0], np.nan), *step[1:]) is None
    assert np.allclose(solvers.osqp_solver()(*step), expected, atol=1e-2)


def test_learner_in_numpy_learns_as_the_library_does(paper):
    vanilla = causes.VANILLA
    one = paper.track(paper.learned(vanilla), np.zeros(3), (closed_loop.Stage(6),))
    estimator = paper.learned(vanilla)
    solver = causes.relearned(estimator, estimator.covariance)
    other = paper.track(estimator, np.zeros(3), (closed_loop.Stage(6, solver=solver, learn=False),))
    assert np.allclose(one["x"], other["x"], rtol=0, atol=1e-5)
    # the unit of px^2 is a matter of what P says about it: with P in the same unit nothing changes
    P = estimator.covariance
    P[3], P[:, 3] = P[3] * 1e4, P[:, 3] * 1e4
    estimator = paper.learned(vanilla)
    scaled = closed_loop.Stage(6, solver=causes.relearned(estimator, P, unit=1e4), learn=False)
    assert np.allclose(paper.track(estimator, np.zeros(3), (scaled,))["x"], other["x"], rtol=0, atol=1e-5)


def test_outcomes():
    reference = np.zeros((1000, 3))
    moving, standing = np.ones((1000, 2)), np.zeros((1000, 2))

    def trace(miss, u):
        x = np.vstack([np.zeros(3), reference + miss])
        return {"x": x, "u": u, "reference": reference, "error": np.linalg.norm(x[1:] - reference, axis=1)}

    assert closed_loop.outcome(trace([0.1, 0, 0], moving)) == "tracks"
    assert closed_loop.outcome(trace([70, 0, 0], standing)) == "stands"
    assert closed_loop.outcome(trace([0.1, 0, 2 * np.pi], moving)) == "turned"
    assert closed_loop.outcome(trace([70, 0, 0], moving)) == "lost"


def test_a_reset_covariance_breaks_constant_trace_and_a_capped_radius_mends_it(paper):
    offset = closed_loop.starts(closed_loop.SIGMA, 1)[0]
    assert closed_loop.outcome(bistability.Setting(POLY_CT).run(paper, offset)) == "tracks"
    assert closed_loop.outcome(bistability.Setting(POLY_CT, start="P reset").run(paper, offset)) == "stands"
    estimator = paper.learned(POLY_CT)
    estimator.reset_covariance(bistability.RESET_P0)
    solver = solvers.library(estimator, edit=causes.capped)
    assert closed_loop.outcome(paper.track(estimator, offset, (closed_loop.Stage(control.STEPS, solver=solver),))) == "tracks"


def test_study_on_a_small_design(tmp_path, monkeypatch):
    methods = [scenario.Method("poly", "ct"), scenario.Method("poly", "sift"), scenario.Method("rbf", "sift")]
    monkeypatch.setattr(scenario, "METHODS", methods)
    monkeypatch.setattr(bistability, "design", lambda: [bistability.Setting(POLY_CT), bistability.Setting(POLY_CT, start="P reset")])
    monkeypatch.setattr(causes, "INTERVENTIONS", dict(list(causes.INTERVENTIONS.items())[:1]))
    monkeypatch.setattr(causes, "TWIN_DISTANCE", 1.0)
    monkeypatch.setattr(solvers, "SOLVER_STEPS", 30)
    study.run(tmp_path, runs=1)
    rows = strict_json(tmp_path / "study.json")
    kinds = [row["study"] for row in rows]
    assert kinds == ["bistability"] * 2 + ["horizon"] * 18 + ["intervention"] + ["rescue"] * 3 + ["twins"] + ["sensitivities"] * 3
    assert all(row["failures"] == sum(e > closed_loop.FAILED for e in row["mean_errors"]) for row in rows[:21])
    assert rows[4]["mean_errors"] == pytest.approx(rows[0]["mean_errors"])  # the same run: the longest horizon is the paper's
    assert [row["as_newton"] for row in rows[:2]] == [1.0, 0.0]
    twins = rows[kinds.index("twins")]
    assert twins["outcomes"][0] == "tracks" != twins["outcomes"][1]
    assert json.dumps(rows) and len(list(tmp_path.glob("study_*.png"))) == 4


def test_study_refuses(tmp_path, monkeypatch):
    status, error = tinykoop("study", "--runs", 0, "--out", tmp_path)
    assert status == 2 and error.count("\n") == 1 and "--runs" in error
    monkeypatch.setattr(solvers, "import_module", lambda name: (_ for _ in ()).throw(ImportError))
    with pytest.raises(UserError, match="daqp is missing"):
        study.run(tmp_path, runs=1)
