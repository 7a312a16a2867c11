"""`tinykoop choose`: errors against a second writing, no look ahead, and a choice that is right where it is known."""

import json

import numpy as np
import pytest
import tinykoop as tk
from tinykoop import bridge
from tinykoop.logs import choose, fit
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
    members = choose.MEMBERS if setting.regulator == "average" else ((setting.regulator, setting.lam),)
    out, log = [], trial.log
    for row in trial.rows[:: len(trial.rows) // 4]:
        models = []
        for regulator, lam in members:
            learner = bridge.Estimator(lifting, regulator, 32, form="sqrt", lam=lam, check=bridge.CHECK_REFUSE)
            learner.theta = theta
            learner.replay(log.x[: row + 1], log.u[:row], usable=trial.learned[:row], traces=())
            models.append(learner.theta)
        learner = bridge.Estimator(lifting, "none", 64)
        learner.theta = np.mean(models, axis=0)
        state = learner.rollout(log.x[row], log.u[row : row + choose.STEPS])[-1, :3]
        out.append(np.sqrt(np.mean(((state - log.x[row + choose.STEPS]) / trial.scale) ** 2)))
    return out


@pytest.mark.parametrize(
    "setting", [choose.Setting("poly", "ef", 0.98), choose.Setting("rbf", "sift", 0.95), choose.Setting("affine", choose.AVERAGE, None)]
)
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
    assert scores == sorted(scores) and {row["regulator"] for row in result["settings"]} == {*bridge.regulator_names(), choose.AVERAGE}
    assert {row["dictionary"] for row in result["settings"]} == {"poly", "rbf", "affine"}
    assert sum(row["best_in"] for row in result["settings"]) == pytest.approx(1) and (tmp_path / "choose.png").exists()
    assert set(result["regret"]) == {"drive0", "drive1"} and all(0 <= value["others"] < 0.5 for value in result["regret"].values())
    assert "best 10 steps ahead on drive0, drive1" in " ".join(capsys.readouterr().out.split())


def test_regret_is_what_the_choice_costs():
    """By hand: a and b on two logs; the second half of the first log is where b is worse."""
    a, b = choose.Setting("poly", "ef", 0.98), choose.Setting("poly", "ef", 0.99)
    errors = {a: [np.full(4, 1.0), np.full(4, 3.0)], b: [np.array([0.5, 0.5, 2.5, 2.5]), np.full(4, 2.0)]}
    one, two = choose.regrets(errors, [type("T", (), {"name": name}) for name in ("one", "two")]).values()
    size = np.sqrt((2 * 0.25 + 2 * 6.25) / 4)
    assert one == {"others": pytest.approx(size - 1), "single": pytest.approx(0), "own": pytest.approx(1.5)}
    assert two == {"others": pytest.approx(0.5), "single": pytest.approx(0.5), "own": pytest.approx(0)}
    assert choose.best(errors) == a and choose.scores(errors)[a] == pytest.approx(1.5)
    assert choose.regrets(choose.picked(errors, lambda i: i == 0), [type("T", (), {"name": "one"})])["one"]["others"] is None


# ---- closed loop ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def gentle(tmp_path_factory):
    """A healthy robot that drives forward in wide bends."""
    t, path = np.arange(ROWS) * DT, tmp_path_factory.mktemp("gentle") / "gentle.csv"
    u = np.stack([0.8 + 0.3 * np.sin(0.5 * t), 0.4 * np.cos(0.3 * t)], axis=1)
    noise = np.random.default_rng(4).normal(size=(ROWS, 3)) * 0.002
    bridge.write_log(path, bridge.simulate(u[:-1], DT) + noise, u, DT)
    return path


def test_closed_loop_is_that_of_the_library(gentle):
    """The loop plans in Python on the mean of the models; with one model, the library plans the same by itself."""
    trial, setting = choose.Trial(gentle), choose.Setting("poly", "ef", 0.99)
    learner, u = trial.learner(setting), trial.log.u
    learner.replay(trial.log.x, u[:-1], usable=trial.learned, traces=())
    mpc = bridge.Mpc(horizon=choose.STEPS, u_min=(0.0, u[:, 1].min()), u_max=tuple(u.max(0)))
    path = bridge.simulate(u[-choose.DRIVEN - choose.STEPS :], DT, trial.log.x[-1])
    x = learner.control(mpc, path, DT, choose.DRIVEN, path[0])["x"]
    expected = np.mean(np.hypot(*(x - path[: len(x)])[:, :2].T))
    assert choose.tracking(trial, setting, []) == pytest.approx(expected, rel=1e-3) and expected < 1


def test_all_members_of_an_average_learn_in_closed_loop(gentle, monkeypatch):
    """Three times the same member is that member."""
    monkeypatch.setattr(choose, "MEMBERS", (("ct", 0.999),) * 3)
    trial = choose.Trial(gentle)
    average, one = (choose.tracking(trial, choose.Setting("affine", *kind), []) for kind in ((choose.AVERAGE, None), ("ct", 0.999)))
    assert average == pytest.approx(one, rel=1e-3) and one < 1


def test_an_effect_acts_in_closed_loop(gentle):
    trial, setting = choose.Trial(gentle), choose.Setting("affine", "ct", 0.999)
    healthy, lagging = (choose.tracking(trial, setting, active) for active in ([], [bridge.Effect("transport_delay", (0.4,))]))
    assert lagging > 1.2 * healthy, (lagging, healthy)


def test_tracking_of_the_short_list_is_written(gentle, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(choose, "LAMBDAS", (0.99,))
    rows = choose.run([gentle], tmp_path, effects=["yaw_gain=0.1"])
    assert sum("tracking" in row for row in rows) == len({(row["dictionary"], row["regulator"]) for row in rows})
    assert "tracking (m)" in capsys.readouterr().out


def test_closed_loop_of_another_robot_or_an_unknown_effect_is_refused(gentle, tmp_path):
    with pytest.raises(UserError, match="--closed-loop ice: there is no effect 'ice'"):
        choose.run([gentle], tmp_path, effects=["ice"])
    log, _ = bridge.fwmav("hover", 10, 1)
    bridge.write_log(tmp_path / "hover.csv", log.x, log.u, log.dt, "fwmav")
    with pytest.raises(UserError, match="only the ddr has a simulator with a controller"):
        choose.run([tmp_path / "hover.csv"], tmp_path, effects=[])


def test_a_model_of_the_affine_dictionary_goes_into_firmware(gentle, tmp_path):
    fit.run(gentle, tmp_path / "model.h", "affine")
    assert "koopf_part_constant" in (tmp_path / "model.h").read_text()
    assert tk.RLS(tk.Constant(), 2).load(tmp_path / "model.h", 3).theta.shape == (4, 6)


def test_an_average_costs_what_its_members_cost(gentle):
    trial = choose.Trial(gentle)
    members = [choose.cost(choose.Setting("affine", *member), trial) for member in choose.MEMBERS]
    assert choose.cost(choose.Setting("affine", choose.AVERAGE, None), trial) == sum(members) and min(members) > 0


def test_a_dictionary_by_a_function_has_no_closed_loop(gentle, tmp_path):
    (tmp_path / "own.py").write_text("import numpy as np\n\ndef mine(x):\n    return np.column_stack([x, np.sin(x[:, 2])])\n")
    assert choose.tracking(choose.Trial(gentle), choose.Setting(f"{tmp_path / 'own.py'}:mine", "ef", 0.99), []) is None


def test_short_log_is_refused(tmp_path, monkeypatch):
    x, u = drive(3)
    bridge.write_log(tmp_path / "short.csv", x[:105], u[:105], DT)
    monkeypatch.setattr(choose, "STEPS", 60)
    with pytest.raises(UserError, match="record a longer log"):
        choose.Trial(tmp_path / "short.csv")
