"""Several logs of one robot fitted together: what they share, what each group has for itself, and what they settle."""

import functools
import json

import numpy as np
import pytest
from test_diagnose import DT, drive, log_of
from tinykoop import bridge
from tinykoop.diagnose import pooled
from tinykoop.diagnose.platforms import ddr
from tinykoop.plumbing.errors import UserError

Effect = bridge.Effect


def held(commands, speed):
    """The commands with one speed throughout."""
    return np.stack([np.full(len(commands), speed), commands[:, 1]], 1)


def told(folder, logs, groups=None, without=("clock_scale",)):
    """([report of each log by itself], pooled.json); logs: [(commands, effects)]. A clock error is exactly two gains."""
    files, reports = [], []
    for k, (u, effects) in enumerate(logs):
        log = log_of(u, effects, seed=k)
        files.append(folder / f"drive{k}.csv")
        bridge.write_log(files[-1], log.x, log.u, DT)
        reports.append(ddr.diagnose(ddr.load(files[-1]), without=without).report | {"log_file": str(files[-1])})
    pooled.run(list(zip(files, reports)), folder, groups, "ddr", without)
    return reports, json.loads((folder / "pooled.json").read_text())


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
    logs = [(drive(500, k + 1), [Effect("yaw_gain", (0.1,)), Effect("actuator_lag", (tau,))]) for k, tau in enumerate(LAGS.values())]
    return told(tmp_path_factory.mktemp("grounds"), logs)


def test_a_common_size_has_a_narrower_interval_than_in_any_log_by_itself(grounds):
    singles, report = grounds
    gain = by_name(report)["yaw_gain"]
    low, high = gain["params_ci95"]["b"]
    assert report["verdict"] == "known" and gain["common"] and low < 0.1 < high
    assert all(width(gain, "b") < 0.95 * width(by_name(single)["yaw_gain"], "b") for single in singles)


def test_what_differs_between_groups_has_a_size_in_each(grounds):
    lag = by_name(grounds[1])["actuator_lag"]
    assert not lag["common"] and set(lag["per_group"]) == set(LAGS)
    for label, tau in LAGS.items():
        low, high = lag["per_group"][label]["params_ci95"]["tau"]
        assert low < tau < high < low + 0.01


def test_each_log_has_its_gap(grounds):
    singles, report = grounds
    for single in singles:
        gap = report["gap"][single["log_file"]]
        assert gap["before"] == pytest.approx(single["gap"]["before"]) and gap["closed_fraction"]["50"] > 0.95
        assert gap["after"]["50"] == pytest.approx(single["gap"]["after"]["50"], rel=0.05)


def test_an_effect_may_be_absent_in_a_group(tmp_path):
    logs = [(drive(450, k + 1), [Effect("yaw_gain", (0.1,)), *skid]) for k, skid in enumerate(([Effect("lateral_skid", (0.08,))], []))]
    effects = by_name(told(tmp_path, logs)[1])
    assert effects["yaw_gain"]["common"] and not effects["lateral_skid"]["common"]
    there, absent = (effects["lateral_skid"]["per_group"][label] for label in ("drive0", "drive1"))
    assert there["params"]["k"] == pytest.approx(0.08, rel=0.05) and absent is None


def test_logs_of_one_group_have_one_size(tmp_path):
    logs = [(drive(450, k + 1), [Effect("yaw_gain", (b,))]) for k, b in enumerate((0.1, 0.1, -0.05))]
    (gain,) = told(tmp_path, logs, ["floor", "floor", "grass"])[1]["effects"]
    sizes = {label: size["params"]["b"] for label, size in gain["per_group"].items()}
    assert sizes == {"floor": pytest.approx(0.1, abs=1e-3), "grass": pytest.approx(-0.05, abs=1e-3)}


def test_healthy_logs_have_no_effect_together(tmp_path):
    report = told(tmp_path, [(drive(400, k), []) for k in range(2)])[1]
    assert report["verdict"] == "none" and not report["effects"] and not report["best_fit"]


# ---- what several logs settle -------------------------------------------------------------------------------


@functools.cache
def asymmetry():
    """Two drives of one speed each, on which driving straight turns the robot by 0.04 rad/m: a bias at one speed."""
    return [(held(drive(450, k + 1), v), [Effect("wheel_asymmetry", (0.04,))]) for k, v in enumerate((0.6, 1.5))]


def test_what_each_log_leaves_ambiguous_is_settled_by_logs_of_one_group(tmp_path):
    singles, report = told(tmp_path, asymmetry(), ["floor", "floor"])
    for single in singles:
        ((name, others),) = single["ambiguous_with"].items()
        assert {name, *others} == {"wheel_asymmetry", "yaw_bias"}
    (effect,) = report["effects"]
    assert effect["name"] == "wheel_asymmetry" and effect["common"] and effect["params"]["c"] == pytest.approx(0.04, rel=0.01)
    assert report["settled"] == {"wheel_asymmetry": ["yaw_bias"]} and not report["ambiguous_with"]


def test_what_may_differ_between_two_groups_stays_ambiguous(tmp_path):
    """A bias per group explains as much: only its further parameter speaks against it."""
    report = told(tmp_path, asymmetry())[1]
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


def test_a_log_without_traction_is_refused(tmp_path):
    reports = [("a.csv", {"platform": "ddr", "effects": []}), ("b.csv", {"platform": "ddr", "effects": [{"name": "no_traction"}]})]
    with pytest.raises(UserError, match="b.csv: the robot has no traction"):
        pooled.run(reports, tmp_path, robot="ddr")


def test_the_command_says_what_is_common_and_what_is_not(tinykoop_in, tmp_path):
    for k, b in enumerate((0.1, -0.1)):
        log = log_of(drive(300, k), [Effect("yaw_gain", (b,))], seed=k)
        bridge.write_log(tmp_path / f"{'ab'[k]}.csv", log.x, log.u, DT)
    done = tinykoop_in(tmp_path, "diagnose", "a.csv", "b.csv", "--pool", "--groups", "sand", "ice", "--out", "out")
    assert done.returncode == 0 and "2 logs in 2 groups, fitted together: known." in done.stdout
    assert "sand" in done.stdout and "ice" in done.stdout
    assert json.loads((tmp_path / "out/pooled.json").read_text())["groups"] == {"sand": ["a.csv"], "ice": ["b.csv"]}
