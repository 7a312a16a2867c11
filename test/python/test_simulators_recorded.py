"""A recorded run instead of the simulator: what is found is what the simulator itself finds, or the run is refused."""

import csv
import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.robot import Signal
from tinykoop.diagnose.robots import toml
from tinykoop.diagnose.robots.log import read
from tinykoop.diagnose.simulators import recorded
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
CAR = ROOT / "examples/own_robot/car"
COLUMNS = ("t", "x", "y", "psi", "v_cmd", "delta")


@pytest.fixture(scope="module")
def car():
    return toml.read(CAR / "car.toml")


def written(path, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    return path


def log_of(car, folder, seed, lag=1e-9, gain=1.0):
    """car.csv: a log of the true car, another program than car.py."""
    spec = importlib.util.spec_from_file_location("make_log", CAR / "make_log.py")
    true = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(true)
    rate, true.LAG = true.rate, lag
    true.rate = lambda pose, speed, steering: rate(pose, speed, gain * steering)
    return read(written(folder / "car.csv", true.drive(seed)), car)


def run_of(car, folder, log, step=None, noise=0.0, every=1):
    """sim.csv: car.py, or another step, under the log's commands."""
    step = step or (lambda x, u: car.simulator.step(x, u, log.dt, car.nominal))
    rng, x, rows = np.random.default_rng(1), log.x[:1], []
    for t, u in zip(log.t, log.u):
        px, py, yaw = x[0] + noise * rng.normal(size=3)
        rows.append([t, px, py, (np.degrees(yaw) + 180) % 360 - 180, *u])
        x = step(x, u[None])
    return written(folder / "sim.csv", rows[::every])


CASES = {"healthy": {}, "steering gain": {"gain": 1.1}, "steering lag": {"lag": 0.12}}


@pytest.mark.parametrize("case", CASES)
def test_a_run_tells_what_the_simulator_itself_tells(car, tmp_path, case):
    log = log_of(car, tmp_path, 21, **CASES[case])
    robot = recorded.of(toml.read(CAR / "car.toml", simulated=False), run_of(car, tmp_path, log), log)
    by_run, by_simulator = own.diagnose(log, robot).report, own.diagnose(log, car).report
    assert by_run["verdict"] == by_simulator["verdict"] == ("none" if case == "healthy" else "known")
    assert [e["name"] for e in by_run["effects"]] == [e["name"] for e in by_simulator["effects"]]
    for one, other in zip(by_run["effects"], by_simulator["effects"]):
        np.testing.assert_allclose(list(one["params"].values()), list(other["params"].values()), rtol=0.01)
    assert by_run["passes"] <= 200 and max(by_run["surrogate"]["off"].values()) < recorded.OFF


def test_the_surrogate_steps_as_the_simulator_does(car, tmp_path):
    """From states and commands that the run never had, in its range."""
    log = log_of(car, tmp_path, 22)
    robot = recorded.of(car, run_of(car, tmp_path, log), log)
    rng = np.random.default_rng(2)
    x, u = rng.normal(size=(200, 3)) * 3, rng.uniform([0.4, -0.35], [1.7, 0.35], (200, 2))
    seen, asked = (r.simulator.step(x, u, log.dt, car.nominal) - x for r in (robot, car))
    assert np.abs(seen - asked).max() < 2e-3 * np.abs(asked).max()
    assert robot.simulator.surrogate["depends_on"] == {"px": ["yaw", "speed"], "py": ["yaw", "speed"], "yaw": ["speed", "steering"]}
    assert robot.parameters == ()


def test_rows_that_the_run_lacks_are_left_out(car, tmp_path):
    log = log_of(car, tmp_path, 23)
    rows = list(csv.reader(run_of(car, tmp_path, log).open()))[1:]
    rows[300][2] = rows[700][3] = ""
    robot = recorded.of(car, written(tmp_path / "sim.csv", rows[:900] + rows[910:]), log)
    assert max(robot.simulator.surrogate["off"].values()) < recorded.OFF


def test_a_run_needs_no_column_of_a_further_sensor(car, tmp_path):
    log = log_of(car, tmp_path, 28)
    odometer = replace(log, y=np.concatenate([log.y, log.u[:, :1]], 1))
    robot = recorded.of(replace(car, outputs=(Signal("odometer", "m/s", "v", measures="speed"),)), run_of(car, tmp_path, log), odometer)
    assert [c.name for c in robot.channels] == ["px", "py", "yaw", "odometer"]
    assert list(robot.simulator.surrogate["off"]) == ["px", "py", "yaw"]


# ---- runs that are refused ---------------------------------------------------------------------------------------


def behind(car, log):
    """A simulator whose steering is slow: a state that no column shows."""
    wheels = np.zeros(1)

    def step(x, u):
        wheels[:] += (u[0, 1] - wheels) * 0.15
        return car.simulator.step(x, np.array([[u[0, 0], wheels[0]]]), log.dt, car.nominal)

    return step


def limited(car, log):
    """A simulator with a corner: its car is no faster than 1.2 m/s."""
    return lambda x, u: car.simulator.step(x, np.minimum(u, [1.2, 9.0]), log.dt, car.nominal)


@pytest.mark.parametrize(
    "what, said",
    [
        (lambda car, log: {"step": behind(car, log)}, r"50 steps ahead the best is off by \d+ times the log's noise in yaw; add columns"),
        (lambda car, log: {"step": limited(car, log)}, r"50 steps ahead the best is off by [\d.]+ times the log's noise"),
        (lambda car, log: {"noise": 0.003}, r"the best is off by [\d.]+ times .*take noise out of the run"),
        (lambda car, log: {"every": 2}, "has rows every 0.04 s, the log every 0.02 s"),
    ],
    ids=["a hidden state", "a corner", "noise", "another rate"],
)
def test_a_run_that_says_too_little_gets_one_line(car, tmp_path, what, said):
    log = log_of(car, tmp_path, 24)
    path = run_of(car, tmp_path, log, **what(car, log))
    with pytest.raises(UserError, match=said) as raised:
        recorded.of(car, path, log)
    assert "\n" not in str(raised.value)


def test_a_run_that_does_not_go_where_the_log_goes_gets_one_line(car, tmp_path):
    log = log_of(car, tmp_path, 25)
    slow = run_of(car, tmp_path, replace(log, u=log.u * [0.5, 1.0]))
    with pytest.raises(UserError, match="does not follow the log in speed; record the simulator under the log's commands"):
        recorded.of(car, slow, log)


def test_a_short_run_gets_one_line(car, tmp_path):
    log = log_of(car, tmp_path, 26)
    rows = list(csv.reader(run_of(car, tmp_path, log).open()))[1:]
    with pytest.raises(UserError, match="2 whole windows of 50 rows are too few; record 4 at least"):
        recorded.of(car, written(tmp_path / "sim.csv", rows[:120]), log)


# ---- the commands ------------------------------------------------------------------------------------------------


def test_a_robot_s_file_needs_no_simulator_beside_a_run(car, tmp_path, tinykoop_in):
    run_of(car, tmp_path, log_of(car, tmp_path, 27, gain=1.1))
    text = (CAR / "car.toml").read_text()
    (tmp_path / "car.toml").write_text(text[: text.index("[simulator]")] + text[text.index("[report]") :])

    def tinykoop(*arguments):
        return tinykoop_in(tmp_path, *arguments)

    assert tinykoop("robot", "check", "car.toml", "car.csv", "--sim", "sim.csv").returncode == 0
    done = tinykoop("diagnose", "car.csv", "--robot", "car.toml", "--sim", "sim.csv", "--out", "out")
    assert done.returncode == 0, done.stderr
    report, page = json.loads((tmp_path / "out/report.json").read_text()), (tmp_path / "out/report.html").read_text()
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == ["gain:steering"]
    assert report["surrogate"]["file"] == "sim.csv" and report["surrogate"]["rows"] == 50
    for text in (done.stdout, page):
        assert "known only by its run sim.csv: a surrogate" in " ".join(text.split())
    without = tinykoop("diagnose", "car.csv", "--robot", "car.toml", "--out", "out")
    assert without.returncode == 2 and without.stderr.count("\n") == 1 and "has no [simulator]; name it there, or give" in without.stderr
    other = tinykoop("diagnose", "car.csv", "--sim", "sim.csv", "--out", "out")
    assert other.returncode == 2 and "--sim: only for your own robot; add --robot ROBOT.toml" in other.stderr
    several = tinykoop("diagnose", "car.csv", "car.csv", "--robot", "car.toml", "--sim", "sim.csv", "--out", "out")
    assert several.returncode == 2 and "--sim: a run under the commands of one log; give one log" in several.stderr
