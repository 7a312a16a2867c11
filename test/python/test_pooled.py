"""Several logs of one robot fitted together: what they share, what each group has for itself, and what they settle."""

import json

import numpy as np
import pytest
from test_diagnose import DT, drive, log_of, usual
from test_own_robot import CAR, example, written
from tinykoop import bridge
from tinykoop.diagnose import pooled
from tinykoop.diagnose.platforms import ddr, own
from tinykoop.diagnose.prediction_errors import joint
from tinykoop.diagnose.prediction_errors.fit import Cause
from tinykoop.diagnose.prediction_errors.pool import Pool, Shared
from tinykoop.diagnose.prediction_errors.states import States
from tinykoop.diagnose.robots import toml
from tinykoop.diagnose.robots.log import read
from tinykoop.plumbing.errors import UserError

Effect = bridge.Effect


def held(commands, speed):
    """The commands with one speed throughout."""
    return np.stack([np.full(len(commands), speed), commands[:, 1]], 1)


WITHOUT = ("clock_scale",)  # a clock error is exactly two gains


def diagnosed(folder, logs):
    """[(file, report of the log by itself)]; logs: [(commands, effects)]."""
    files, reports = [], []
    for k, (u, effects) in enumerate(logs):
        log = log_of(u, effects, seed=k)
        files.append(folder / f"drive{k}.csv")
        bridge.write_log(files[-1], log.x, log.u, DT)
        reports.append(ddr.diagnose(ddr.load(files[-1]), without=WITHOUT).report)
    return list(zip(files, reports))


def told(reports, folder, groups=None):
    """pooled.json."""
    pooled.run(reports, folder, groups, "ddr", WITHOUT)
    return json.loads((folder / "pooled.json").read_text())


def by_name(report):
    return {effect["name"]: effect for effect in report["effects"]}


def width(sizes, parameter):
    low, high = sizes["params_ci95"][parameter]
    return high - low


# ---- what is common, and what is not ----------------------------------------------------------------------

LAGS = {"drive0": 0.05, "drive1": 0.18}  # s


@pytest.fixture(scope="module")
def grounds(tmp_path_factory):
    """Two logs with the same yaw gain of 0.1, and another lag each."""
    logs = [(drive(400, k + 1), [Effect("yaw_gain", (0.1,)), Effect("actuator_lag", (tau,))]) for k, tau in enumerate(LAGS.values())]
    reports = diagnosed(tmp_path_factory.mktemp("grounds"), logs)
    return reports, told(reports, tmp_path_factory.mktemp("pooled"))


def test_a_common_size_has_a_narrower_interval_than_in_any_log_by_itself(grounds):
    singles, report = grounds
    gain = by_name(report)["yaw_gain"]
    low, high = gain["params_ci95"]["b"]
    assert report["verdict"] == "known" and gain["common"] and low < 0.1 < high
    assert all(width(gain, "b") < 0.95 * width(by_name(single)["yaw_gain"], "b") for _, single in singles)


def test_what_differs_between_groups_has_a_size_in_each(grounds):
    lag = by_name(grounds[1])["actuator_lag"]
    assert not lag["common"] and set(lag["per_group"]) == set(LAGS)
    for label, tau in LAGS.items():
        low, high = lag["per_group"][label]["params_ci95"]["tau"]
        assert low < tau < high < low + 0.01


def test_each_log_has_its_gap(grounds):
    singles, report = grounds
    for file, single in singles:
        gap = report["gap"][str(file)]
        assert gap["before"] == pytest.approx(single["gap"]["before"]) and gap["closed_fraction"]["50"] > 0.95
        assert gap["after"]["50"] == pytest.approx(single["gap"]["after"]["50"], rel=0.05)


def sizes(logs, groups, known):
    """{effect: {logs of one size: that size}} of logs whose own causes are given."""
    states = [States(ddr.Path(log_of(u, effects, seed=k))) for k, (u, effects) in enumerate(logs)]
    found = {}
    for cause in Pool(states, groups, known).run({}).causes:
        found.setdefault(cause.name, {})[cause.logs] = cause.params
    return found


def test_an_effect_may_be_absent_in_a_group():
    gain, skid = Cause("yaw_gain", (0.1,)), Cause("lateral_skid", (0.08,))
    logs = [(drive(300, k + 1), [Effect(c.name, c.params) for c in causes]) for k, causes in enumerate(([gain, skid], [gain]))]
    found = sizes(logs, [(0,), (1,)], [(gain, skid), (gain,)])
    assert found == {"yaw_gain": {(0, 1): pytest.approx((0.1,), rel=0.02)}, "lateral_skid": {(0,): pytest.approx((0.08,), rel=0.05)}}


def test_logs_of_one_group_have_one_size():
    logs = [(drive(300, k + 1), [Effect("yaw_gain", (b,))]) for k, b in enumerate((0.1, -0.05, 0.1))]
    found = sizes(logs, [(0, 2), (1,)], [(Cause("yaw_gain", (0.2,)),)] * 3)
    assert found == {"yaw_gain": {(0, 2): pytest.approx((0.1,), abs=1e-3), (1,): pytest.approx((-0.05,), abs=1e-3)}}


def test_healthy_logs_have_no_effect_together(tmp_path):
    report = told(diagnosed(tmp_path, [(drive(300, k), []) for k in range(2)]), tmp_path)
    assert report["verdict"] == "none" and not report["effects"] and not report["best_fit"]


def test_a_threshold_is_common_where_each_log_locates_it_between_commands_of_its_own():
    """No slope leads from the size in one log to that in another."""
    logs = [(drive(400, k + 1), [Effect("dead_band", (0.12, 0.2)), Effect("speed_gain", (a,))]) for k, a in enumerate((0.1, -0.1))]
    known = [(Cause("dead_band", band), Cause("speed_gain", (0.1,))) for band in ((0.1215, 0.2), (0.119, 0.202))]
    found = sizes(logs, [(0,), (1,)], known)
    assert set(found["dead_band"]) == {(0, 1)} and set(found["speed_gain"]) == {(0,), (1,)}
    assert found["dead_band"][0, 1] == pytest.approx((0.12, 0.2), rel=0.03)


def test_an_effect_in_a_part_of_one_log_stays_there():
    skid = Effect("lateral_skid", (0.15,), 5.0, 11.0)
    logs = [(drive(300, k + 1), [Effect("yaw_gain", (0.1,)), *some]) for k, some in enumerate(([skid], []))]
    timed = Cause("lateral_skid", (0.15,), ((5.0, 11.0),))
    states = [States(ddr.Path(log_of(u, effects, seed=k))) for k, (u, effects) in enumerate(logs)]
    causes = Pool(states, [(0,), (1,)], [(Cause("yaw_gain", (0.1,)), timed), ()]).run({}).causes
    assert {(c.name, c.logs, c.segments == timed.segments) for c in causes} == {("yaw_gain", (0, 1), False), ("lateral_skid", (0,), True)}


def test_long_logs_are_decided_on_fewer_rows_and_fitted_on_all(monkeypatch):
    monkeypatch.setattr(ddr.path, "FEW", 600)
    monkeypatch.setattr(ddr.path, "COARSE", 500)
    logs = [log_of(drive(700, k), [Effect("yaw_gain", (b,))], seed=k) for k, b in enumerate((0.1, 0.08))]
    found = joint.answer([ddr.Path(log) for log in logs], [(0,), (1,)], [(Cause("yaw_gain", (0.09,)),), ()], {})
    assert found.verdict == "known" and [len(path.rows) for path in found.pool.path.paths] == [700, 700]
    ((first, second),) = (one.causes for one in found.joints)
    assert (first.logs, second.logs) == ((0,), (1,)) and (*first.params, *second.params) == pytest.approx((0.1, 0.08), abs=1e-3)


def test_an_own_robot_has_sizes_per_group(tmp_path):
    true, files = example(), []
    true.ROWS = 400
    for k, true.LAG in enumerate((0.12, 0.2)):
        files.append(written(tmp_path / f"{k}.csv", true.drive(20 + k)))
    car = toml.read(CAR / "car.toml")
    reports = [own.diagnose(read(file, car), car).report for file in files]
    report = pooled.run(list(zip(files, reports)), tmp_path, robot=str(CAR / "car.toml"))
    (lag,) = report["effects"]
    assert lag["name"] == "lag:steering" and lag["confidence"] > 0.9
    assert [lag["per_group"][label]["params"]["tau"] for label in "01"] == pytest.approx([0.12, 0.2], rel=0.05)


# ---- the fit ------------------------------------------------------------------------------------------------


def pool_of(*logs):
    states = [States(ddr.Path(log)) for log in logs]
    return Pool(states, [(k,) for k in range(len(logs))], [()] * len(logs))


def test_residuals_of_several_logs_are_those_of_each_and_a_cause_acts_in_its_logs():
    pool = pool_of(log_of(drive(200, 1), usual("yaw_gain")), log_of(drive(150, 2), seed=1))
    gain, lag = ((name, tuple(p.usual for p in pool.path.effects[name].parameters)) for name in ("yaw_gain", "actuator_lag"))
    left = pool.fitter.fit_of([Shared(*gain, logs=(0, 1)), Shared(*lag, logs=(1,))]).left
    alone = [log.fitter.fit_of(causes).left for log, causes in zip(pool.logs, ([Cause(*gain)], [Cause(*gain), Cause(*lag)]))]
    np.testing.assert_array_equal(left, np.concatenate(alone))


def test_a_common_gain_is_the_mean_of_those_of_each_log_weighted_by_what_they_tell():
    """Least squares of two logs, from what each log by itself says of a linear effect."""
    pool = pool_of(*(log_of(drive(rows, rows), [Effect("yaw_bias", (d,))], seed=rows) for rows, d in ((300, 0.02), (200, 0.021))))
    begin = pool.fitter.fit_of([Shared("yaw_bias", (0.02,), logs=(0, 1))])
    common = pool.fitter.refine(begin).causes[0].params[0]
    alone = [log.fitter.refine(log.fitter.fit_of([Cause("yaw_bias", (0.02,))])) for log in pool.logs]
    told = [float((log.fitter.jacobian(fit) ** 2).sum()) for log, fit in zip(pool.logs, alone)]
    assert common == pytest.approx(np.average([fit.causes[0].params[0] for fit in alone], weights=told), rel=1e-4)


def test_a_battery_loses_as_much_per_second_in_a_log_twice_as_long():
    pool = pool_of(log_of(drive(201), []), log_of(drive(401), []))
    sag = Shared("battery_sag", (0.1,), logs=(0, 1))
    assert [pool.path.of([sag], k)[0].params for k in (0, 1)] == [(0.1,), pytest.approx((0.2,))]


def test_an_effect_costs_its_choice_once_and_its_sizes_in_each_group():
    pool = pool_of(log_of(drive(100), []), log_of(drive(100, 1), []))
    first, second = (Shared("actuator_lag", (0.1,), logs=(k,)) for k in (0, 1))
    choice = 2 * np.log(len(pool.path.effects))
    assert pool.costs([first, second]) == pytest.approx(2 * pool.costs([first]) - choice)


# ---- what several logs settle -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def asymmetry(tmp_path_factory):
    """Reports of two drives of one speed each, on which driving straight turns the robot by 0.04 rad/m: a bias at one speed."""
    logs = [(held(drive(400, k + 1), v), [Effect("wheel_asymmetry", (0.04,))]) for k, v in enumerate((0.6, 1.5))]
    return diagnosed(tmp_path_factory.mktemp("asymmetry"), logs)


def test_what_each_log_leaves_ambiguous_is_settled_by_logs_of_one_group(asymmetry, tmp_path):
    report = told(asymmetry, tmp_path, ["floor", "floor"])
    for _, single in asymmetry:
        ((name, others),) = single["ambiguous_with"].items()
        assert {name, *others} == {"wheel_asymmetry", "yaw_bias"}
    (effect,) = report["effects"]
    assert effect["name"] == "wheel_asymmetry" and effect["common"] and effect["params"]["c"] == pytest.approx(0.04, rel=0.01)
    assert report["settled"] == {"wheel_asymmetry": ["yaw_bias"]} and not report["ambiguous_with"]


def test_what_may_differ_between_two_groups_stays_ambiguous(asymmetry, tmp_path):
    """A bias per group explains as much: only its further parameter speaks against it."""
    report = told(asymmetry, tmp_path)
    assert report["ambiguous_with"] and not report["settled"]


# ---- the command --------------------------------------------------------------------------------------------

BAD = {
    "one log": (["a.csv", "--pool"], "--pool: one log has nothing to share"),
    "labels": (["a.csv", "b.csv", "--pool", "--groups", "x"], "--groups: 1 labels for 2 logs"),
    "groups alone": (["a.csv", "b.csv", "--groups", "x", "y"], "add --pool"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_pooled_is_refused_before_the_work(case, tinykoop_in, tmp_path):
    arguments, says = BAD[case]
    done = tinykoop_in(tmp_path, "diagnose", *arguments)
    assert done.returncode == 2 and says in done.stderr and done.stderr.count("\n") == 1 and not done.stdout


def test_logs_of_two_platforms_are_refused(tmp_path):
    report = {"effects": [], "best_fit": [], "ambiguous_with": {}}
    with pytest.raises(UserError, match="b.csv: a log of car, not of ddr"):
        pooled.run([("a.csv", report | {"platform": "ddr"}), ("b.csv", report | {"platform": "car"})], tmp_path, robot="ddr")


@pytest.mark.parametrize("fault", ["no_traction", "no_answer"])
def test_a_log_of_a_robot_that_does_not_answer_is_refused(tmp_path, fault):
    reports = [("a.csv", {"platform": "ddr", "effects": []}), ("b.csv", {"platform": "ddr", "effects": [{"name": fault}]})]
    with pytest.raises(UserError, match="b.csv: the robot does not answer there"):
        pooled.run(reports, tmp_path, robot="ddr")


def test_the_command_says_what_is_common_and_what_is_not(tinykoop_in, tmp_path):
    for k, b in enumerate((0.1, -0.1)):
        log = log_of(drive(300, k), [Effect("yaw_gain", (b,))], seed=k)
        bridge.write_log(tmp_path / f"{'ab'[k]}.csv", log.x, log.u, DT)
    done = tinykoop_in(tmp_path, "diagnose", "a.csv", "b.csv", "--pool", "--groups", "sand", "ice", "--out", "out")
    assert done.returncode == 0 and "2 logs in 2 groups, fitted together: known." in done.stdout
    assert "sand" in done.stdout and "ice" in done.stdout
    assert json.loads((tmp_path / "out/pooled.json").read_text())["groups"] == {"sand": ["a.csv"], "ice": ["b.csv"]}
