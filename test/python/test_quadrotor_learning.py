"""A quadrotor's logs as learners take them: states against the simulator's truth, dictionaries and thresholds against a second writing."""

import json

import numpy as np
import pytest
import tinykoop as tk
from tinykoop import bridge, platforms
from tinykoop.bridge.quadrotor import QUADROTOR_STATE
from tinykoop.diagnose.platforms.quadrotor.features import STATES
from tinykoop.experiments import real, scenario
from tinykoop.logs import choose, fit, quadrotor, replay
from tinykoop.plumbing.errors import UserError

CRAZYFLIE = ("pitch", "gx", "gy", "gz")  # that its logs lack


def without(log, names):
    """The log without some of its columns."""
    x = log.x.copy()
    x[:, [STATES.index(name) for name in names]] = np.nan
    return bridge.Log(log.t, x, log.u, log.usable, log.dt)


@pytest.fixture(scope="module")
def flown():
    """A flight without noise, and its true states."""
    return bridge.quadrotor("mixed", 16, 3, noise=0)


@pytest.fixture(scope="module")
def legs():
    return bridge.quadrotor("legs", 26, 3)


@pytest.fixture(scope="module")
def files(tmp_path_factory, legs):
    """A log with all columns, and one without those that a Crazyflie's lacks."""
    folder = tmp_path_factory.mktemp("quadrotor")
    for name, log in (("whole", bridge.quadrotor("mixed", 12, 2)[0]), ("lacking", without(legs[0], CRAZYFLIE))):
        bridge.write_log(folder / f"{name}.csv", log.x, log.u, log.dt, "quadrotor")
    return folder


def test_states_are_those_of_the_simulated_vehicle(flown):
    log, truth = flown
    seen = quadrotor.learned(log)
    rows = slice(*np.searchsorted(log.t, seen.t[[0, -1]]) + (0, 1))
    w, x, y, z = truth[rows, QUADROTOR_STATE["attitude"]].T
    ahead = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], 1)  # the nose, seen from above
    ahead /= np.linalg.norm(ahead, axis=1)[:, None]
    forward = (truth[rows, QUADROTOR_STATE["velocity"]][:, :2] * ahead).sum(1)
    assert np.abs(seen.x[:, 0] - forward).max() < 1e-6 and np.ptp(forward) > 0.5
    m1, m2, m3, m4 = truth[rows, QUADROTOR_STATE["rotors"]].T
    given = np.stack([m1 + m2 + m3 + m4, m3 + m4 - m1 - m2, m1 + m4 - m2 - m3, m1 + m3 - m2 - m4], 1) / 4
    assert np.abs(seen.x[:, 8] - given[:, 0]).max() < 0.02
    alike = [np.corrcoef(column, true)[0, 1] for column, true in zip(seen.x[:, 8:].T, given.T)]
    assert min(alike) > 0.9  # requests of a controller at 500 Hz vary between rows


def test_what_a_log_lacks_is_left_out_and_rates_follow_from_angles(flown):
    whole, lacking = (quadrotor.learned(log) for log in (flown[0], without(flown[0], CRAZYFLIE)))
    assert whole.states == quadrotor.NAMES and len(whole.states) == platforms.learned("quadrotor")
    assert lacking.states == tuple(name for name in quadrotor.NAMES if name not in ("pitch", "gy"))
    gx = whole.x[:, whole.states.index("gx")]
    assert np.corrcoef(gx[1:], lacking.x[1:, lacking.states.index("gx")])[0, 1] > 0.95
    world = quadrotor.learned(without(flown[0], ["yaw"]))
    assert not {"forward", "left"} & set(world.states) and "up" in world.states


def test_no_step_on_the_ground_is_learned(legs):
    log, truth = legs
    seen = quadrotor.learned(log)
    height = truth[np.searchsorted(log.t, seen.t), 2]
    assert (height[:-1][seen.usable] > 0).all() and (height[1:][seen.usable] > 0).all()
    high = (height[:-1] > 0.4) & (height[1:] > 0.4)
    assert seen.usable[high].mean() > 0.9 and (height == 0).any()  # it stands between the legs


def test_a_row_without_a_number_is_not_learned(flown):
    log = without(flown[0], [])
    log.x[600, STATES.index("roll")] = np.nan
    seen, known = quadrotor.learned(log), quadrotor.learned(flown[0])
    lost = np.flatnonzero(known.usable & ~seen.usable)
    assert np.allclose(seen.t[lost], log.t[[599, 600]])


def test_no_rate_is_made_of_angles_on_both_sides_of_a_gap(flown):
    whole, gap = without(flown[0], []), without(flown[0], CRAZYFLIE)
    whole.usable, gap.usable = (np.arange(len(log.usable)) != 600 for log in (whole, gap))
    lost = [seen.t[:-1][~seen.usable] for seen in map(quadrotor.learned, (whole, gap))]
    assert np.allclose(lost[0], whole.t[[600]]) and np.allclose(lost[1], whole.t[[600, 601]])


def test_a_log_without_attitude_or_flight_is_one_line(flown):
    with pytest.raises(UserError, match="f.csv: neither roll nor pitch"):
        quadrotor.learned(without(flown[0], ["roll", "pitch"]), "f.csv")
    rests = bridge.Log(flown[0].t, flown[0].x, np.zeros_like(flown[0].u), flown[0].usable, flown[0].dt)
    with pytest.raises(UserError, match="f.csv: the vehicle is never in flight"):
        quadrotor.learned(rests, "f.csv")


def test_dictionaries_are_products_and_gaussians_of_the_states():
    x = np.random.default_rng(0).normal(scale=0.3, size=(50, 12))
    forward, left, _, roll, pitch, gx, gy, gz, thrust = x.T[:9]
    one, tilted = np.ones(50), [thrust * roll, thrust * pitch]
    poly = [*tilted, gz * forward, gz * left, gz * roll, gz * pitch, gx * gy, gy * gz, gz * gx, one]
    grid = [(a, b) for a in (-0.3, -0.1, 0.1, 0.3) for b in (-0.3, -0.1, 0.1, 0.3)]
    rbf = [np.exp(-((roll - a) ** 2 + (pitch - b) ** 2) / (2 * 0.15**2)) for a, b in grid] + [*tilted, one]
    for name, expected in (("poly", poly), ("rbf", rbf)):
        learner = bridge.Estimator(quadrotor.dictionary(name).own(12), "ef", 64, n_inputs=4)
        np.testing.assert_allclose(learner.lift(x), np.column_stack([x, *expected]), rtol=1e-12)


@pytest.fixture(scope="module")
def replays(files):
    return {name: replay.run_log(files / f"{name}.csv", files / "out") for name in ("whole", "lacking")}


@pytest.mark.parametrize("name", ["whole", "lacking"])
def test_replay_of_a_flight_beats_a_state_that_stays_in_both_precisions(files, replays, name):
    rows = replays[name]
    assert {row["method"] for row in rows[1:]} == {method.label for method in scenario.METHODS}
    stays, table = rows[0]["mean_error"], dict(replay.by_method(rows))
    for label in ("Poly", "Poly (DZ-CS)", "Poly (SIFt)", "RBF", "RBF (CT)"):
        root, narrow = (table[label]["sqrt", bits, False]["mean_error"] for bits in (64, 32))
        assert root < 0.95 * stays and narrow == pytest.approx(root, rel=1e-3)
    assert json.loads((files / "out" / f"replay_{name}.json").read_text())[0]["method"] == replay.NOTHING


def test_real_flights_without_a_drive_are_replayed(files, tmp_path):
    replays, rows = real.run(tmp_path, [files / "lacking.csv"])
    assert [part[0]["source"] for part in replays] == ["lacking"] and rows == json.loads((tmp_path / "real.json").read_text()) == []


def test_threshold_is_the_quantile_of_innovations_of_the_flights_second_fifth(files, replays):
    """By NumPy: ridge regression on the first fifth."""
    log, _ = replay.load(files / "lacking.csv")
    own = quadrotor.dictionary("poly", log.states).own(len(log.states))
    psi = bridge.Estimator(own, "ef", 64, n_inputs=4).lift(np.nan_to_num(log.x))
    now, after, share = np.hstack([psi[:-1], log.u[:-1]]), psi[1:], np.arange(len(log.usable)) / len(log.usable)
    first, second = (log.usable & (share >= a) & (share < a + 0.2) for a in (0, 0.2))
    ridge = np.eye(now.shape[1]) / replay.INVERSE_RIDGE["quadrotor"]
    theta = np.linalg.solve(now[first].T @ now[first] + ridge, now[first].T @ after[first])
    scores = np.linalg.norm(after - now @ theta, axis=1)[second]
    (delta,) = {row["delta"] for row in replays["lacking"] if row.get("delta") and row["dictionary"] == "poly"}
    assert np.mean(scores <= delta) == pytest.approx(0.75, abs=2 / len(scores))


def test_a_fitted_model_predicts_the_flight_that_it_was_fitted_to(files, tmp_path):
    """The model that firmware loads, in float32, and the header that says which states it has."""
    log, _ = replay.load(files / "whole.csv")
    fit.run(files / "whole.csv", tmp_path / "model.bin", "poly")
    fit.run(files / "lacking.csv", tmp_path / "model.h", "rbf")
    learner = tk.RLS(quadrotor.dictionary("poly", log.states), n_inputs=4).begin(12)
    learner.load(tmp_path / "model.bin")
    error = (learner.predict(log.x[:-1], log.u[:-1]) - log.x[1:])[log.usable]
    assert np.linalg.norm(error, axis=1).mean() < 0.8 * np.linalg.norm(np.diff(log.x, axis=0)[log.usable], axis=1).mean()
    header = (tmp_path / "model.h").read_text()
    assert "states forward, left, up, roll, gx, gz, thrust, " in header and "koop_model_dictionary(" in header


def test_settings_are_chosen_for_a_flight(files, tmp_path, monkeypatch):
    monkeypatch.setattr(choose, "LAMBDAS", (0.995,))
    rows = choose.run([files / "lacking.csv"], tmp_path)
    assert {row["dictionary"] for row in rows} == set(choose.DICTIONARIES)
    assert rows[0]["error"][0] < 1  # a model that predicts that nothing moves


def test_commands_that_need_another_robot_say_so(files, tinykoop_in):
    for arguments, told in ((("changes",), "tinykoop diagnose"), (("choose", "--closed-loop"), "only the ddr")):
        command, *options = arguments
        refused = tinykoop_in(files, command, "whole.csv", *options)
        assert refused.returncode == 2 and told in refused.stderr
