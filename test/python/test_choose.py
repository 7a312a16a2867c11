"""`tinykoop choose`: errors against a second writing, no look ahead, and a choice that is right where it is known."""

import json

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.logs import choose
from tinykoop.plumbing.errors import UserError

DT, ROWS = 0.05, 1500


def drive(seed, slip=False):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform((0.2, -1), (1.2, 1), (ROWS // 20, 2)), 20, axis=0)
    effects = [bridge.Effect("speed_gain", (-0.5,), 35.0, 1e9), bridge.Effect("yaw_gain", (0.8,), 35.0, 1e9)] if slip else []
    return bridge.simulate(u[:-1], DT, active=effects) + rng.normal(size=(ROWS, 3)) * 0.002, u


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("choose")
    for seed in range(2):
        bridge.write_log(folder / f"drive{seed}.csv", *drive(seed, slip=True), DT)
    return [folder / f"drive{seed}.csv" for seed in range(2)]


def second_writing(trial, setting):
    """The same errors, one window at a time, each by an estimator that has seen no later row."""
    lifting, theta, _, _ = trial.offline(setting.dictionary)
    out, log = [], trial.log
    for row in trial.rows[:: len(trial.rows) // 4]:
        learner = bridge.Estimator(lifting, setting.regulator, 32, form="sqrt", lam=setting.lam, check=bridge.CHECK_REFUSE)
        learner.theta = theta
        learner.replay(log.x[: row + 1], log.u[:row], usable=trial.learned[:row], traces=())
        state = learner.rollout(log.x[row], log.u[row : row + choose.STEPS])[-1, :3]
        out.append(np.sqrt(np.mean(((state - log.x[row + choose.STEPS]) / trial.scale) ** 2)))
    return out


@pytest.mark.parametrize("setting", [choose.Setting("poly", "ef", 0.98), choose.Setting("rbf", "sift", 0.95)])
def test_errors_are_those_of_models_that_have_seen_no_later_row(logs, setting):
    trial = choose.Trial(logs[0])
    expected = second_writing(trial, setting)
    np.testing.assert_allclose(trial.errors(setting)[:: len(trial.rows) // 4], expected, rtol=2e-3)


def test_a_robot_that_changes_is_learned_better_with_forgetting(logs):
    trial = choose.Trial(logs[0])
    fixed, forgetting = (
        np.sqrt(np.mean(trial.errors(s) ** 2)) for s in (choose.Setting("poly", "none", 1.0), choose.Setting("poly", "ef", 0.98))
    )
    assert forgetting < 0.97 * fixed, (forgetting, fixed)


def test_choice_and_regret_are_written(logs, tmp_path, capsys):
    choose.run(logs, tmp_path)
    result = json.loads((tmp_path / "choose.json").read_text())
    scores = [row["score"] for row in result["settings"]]
    assert scores == sorted(scores) and {row["regulator"] for row in result["settings"]} == set(bridge.regulator_names())
    assert sum(row["best_in"] for row in result["settings"]) == pytest.approx(1) and (tmp_path / "choose.png").exists()
    assert set(result["regret"]) == {"drive0", "drive1"} and all(0 <= value < 0.5 for value in result["regret"].values())
    assert "best 10 steps ahead on drive0, drive1" in " ".join(capsys.readouterr().out.split())


def test_regret_is_what_the_other_logs_choose():
    a, b = choose.Setting("poly", "ef", 0.98), choose.Setting("poly", "ef", 0.99)
    errors = {a: [np.full(4, 1.0), np.full(4, 3.0)], b: [np.full(4, 2.0), np.full(4, 2.0)]}
    trials = [type("T", (), {"name": name}) for name in ("one", "two")]
    assert choose.regrets(errors, trials) == {"one": pytest.approx(1.0), "two": pytest.approx(0.5)}
    assert choose.best(errors) == a and choose.scores(errors)[a] == pytest.approx(1.25)


def test_short_log_is_refused(tmp_path, monkeypatch):
    x, u = drive(3)
    bridge.write_log(tmp_path / "short.csv", x[:105], u[:105], DT)
    monkeypatch.setattr(choose, "STEPS", 60)
    with pytest.raises(UserError, match="record a longer log"):
        choose.Trial(tmp_path / "short.csv")
