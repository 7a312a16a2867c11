"""The examples of your own robots, end to end, and the blind plants of them: other programs than the simulators."""

import csv
import importlib.util
import json
import random
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tinykoop.blind.own import ROBOTS
from tinykoop.blind.own.plant import drive
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.platforms.own import Path as LogPath
from tinykoop.diagnose.prediction_errors import noise as noises
from tinykoop.diagnose.prediction_errors.fit import Fitter
from tinykoop.diagnose.robots import check, toml
from tinykoop.diagnose.robots.log import read
from tinykoop.diagnose.simulators import shared_library
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples/own_robot"


def run(*command, where):
    done = subprocess.run(command, cwd=where, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """A copy of all examples, compiled by the command lines in their robots' files."""
    place = tmp_path_factory.mktemp("own") / "own_robot"
    shutil.copytree(EXAMPLES, place, ignore=shutil.ignore_patterns("*.so", "*.csv", "__pycache__"))
    for file in place.glob("*/*.toml"):
        for line in re.findall(r"^#\s+(gcc .*)$", file.read_text(), re.M):
            run(*line.split(), where=file.parent)
    return place


def true_robot(name):
    """make_log.py of an example, as a module."""
    spec = importlib.util.spec_from_file_location(f"make_log_{name}", EXAMPLES / name / "make_log.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# ---- as a newcomer does it ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, effect, parameter, size", [("pendulum", "delay:force", "delay", 0.06), ("quadrotor", "parameter:mass", "change", 0.16)]
)
def test_each_example_says_what_its_true_robot_has(examples, tinykoop_in, name, effect, parameter, size):
    place = examples / name
    run(sys.executable, "make_log.py", f"{name}.csv", where=place)
    checked = tinykoop_in(place, "robot", "check", f"{name}.toml", f"{name}.csv")
    assert checked.returncode == 0 and "look:" not in checked.stdout, checked.stderr
    said = tinykoop_in(place, "diagnose", f"{name}.csv", "--robot", f"{name}.toml", "--out", name)
    assert said.returncode == 0 and effect in said.stdout, said.stderr
    report = json.loads((place / name / "report.json").read_text())
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == [effect]
    assert abs(report["effects"][0]["params"][parameter] / size - 1) < 0.05
    assert report["gap"]["closed_fraction"]["50"] > 0.9
    assert report["passes"] <= 200


@pytest.mark.parametrize("name, hidden, header, drives", [
    ("pendulum", "LATE", ("t", "x", "theta", "f_cmd"), "run"),
    ("quadrotor", "PAYLOAD", ("t", "x", "z", "pitch", "thrust", "torque"), "fly"),
])  # fmt: skip
def test_each_example_without_its_effect_is_healthy(examples, tmp_path, name, hidden, header, drives):
    true, robot = true_robot(name), toml.read(examples / name / f"{name}.toml")
    setattr(true, hidden, 0.0)
    report = own.diagnose(read(written(tmp_path / "log.csv", [header, *getattr(true, drives)(21)]), robot), robot).report
    assert report["verdict"] == "none" and report["passes"] <= 200


def written(path, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows(rows)
    return path


# ---- the simulators -----------------------------------------------------------------------------------------------


def lagrange(t, x, force):
    """The pendulum by its mass matrix: the kinetic energy's is [[M + m, m l cos], [m l cos, m l^2]]."""
    (M, m, length, friction, bearing, g), (_, angle, v, w) = (0.6, 0.2, 0.4, 0.3, 0.004, 9.81), x
    cross = m * length * np.cos(angle)
    forces = [force - friction * v + m * length * w**2 * np.sin(angle), -bearing * w - m * g * length * np.sin(angle)]
    return [v, w, *np.linalg.solve([[M + m, cross], [cross, m * length**2]], forces)]


def complex_plane(t, x, thrust, torque):
    """The quadrotor with x + i z as one number: thrust is turned by the pitch, from i towards 1."""
    push = 1j * np.exp(-1j * x[2]) * thrust / 0.8 - 9.81j
    return [*x[3:], push.real, push.imag, torque / 0.006]


@pytest.mark.parametrize("name, law, steps, near", [("pendulum", lagrange, 10, 1e-5), ("quadrotor", complex_plane, 200, 5e-5)])
def test_the_step_of_each_example_is_the_motion_by_another_writing(examples, name, law, steps, near):
    """Steps shorter than a row: the motion is compared, not the method."""
    robot, rng = toml.read(examples / name / f"{name}.toml"), np.random.default_rng(4)
    x = rng.uniform(-1, 1, (12, len(robot.states)))
    u = rng.uniform((5, -0.05), (12, 0.05), (12, 2)) if name == "quadrotor" else rng.uniform(-4, 4, (12, 1))
    exact = [solve_ivp(law, (0, 0.02), row, args=tuple(command), rtol=1e-10, atol=1e-12).y[:, -1] for row, command in zip(x, u)]
    for _ in range(steps):
        x = robot.simulator.step(x, u, 0.02 / steps, robot.nominal)
    np.testing.assert_allclose(x, exact, atol=near)


C = """
int step(const double *x, const double *u, double dt, const double *params, double *next) {
	next[0] = x[0] + dt * (u[0] + 10 * u[1]) * params[0];
	next[1] = x[1] + dt * x[0];
	next[2] = x[2] - dt;
	return x[2] > 7;
}
int twice(const double *x, const double *u, double dt, const double *params, double *next) {
	double middle[3];
	return step(x, u, dt / 2, params, middle) || step(middle, u, dt / 2, params, next);
}
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """make() of a function of the library C, or of FILE:NAME beside it."""
    place = tmp_path_factory.mktemp("library")
    (place / "robot.c").write_text(C)
    run("gcc", "-O1", "-shared", "-fPIC", "robot.c", "-o", "robot.so", where=place)
    return lambda name: shared_library.make({"library": name if "." in name else f"robot.so:{name}"}, place, None)


def test_each_row_of_a_c_function_gets_its_own_state_and_command(library):
    rng = np.random.default_rng(6)
    x, u = rng.normal(size=(30, 6))[:, ::2], rng.normal(size=(2, 30)).T  # neither is contiguous
    want = np.stack([x[:, 0] + 0.1 * (u[:, 0] + 10 * u[:, 1]) * 3, x[:, 1] + 0.1 * x[:, 0], x[:, 2] - 0.1], 1)
    np.testing.assert_allclose(library("step").step(x, u, 0.1, [3.0]), want, rtol=1e-12)


def test_a_library_that_calls_its_own_step_does_not_reach_that_of_the_c_library(library):
    x, u = np.ones((3, 3)), np.ones((3, 2))
    one = library("step")
    half = one.step(one.step(x, u, 0.05, [2.0]), u, 0.05, [2.0])
    np.testing.assert_array_equal(library("twice").step(x, u, 0.1, [2.0]), half)


def test_a_c_function_that_refuses_a_state_is_told_with_that_state(library):
    x = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 9.0]])
    with pytest.raises(UserError, match=r"returns 1 for the state \[1. 2. 9.\]"):
        library("step").step(x, np.zeros((2, 2)), 0.1, [1.0])


@pytest.mark.parametrize("place, said", [
    ("robot.so:stap", "stap; NAME is a function that the library exports"),
    ("nothing.so:step", "there is no file .*nothing.so; compile it"),
    ("robot.c:step", "robot.c:step: .*robot.c"),
])  # fmt: skip
def test_a_library_that_cannot_be_used_gets_one_line(library, place, said):
    with pytest.raises(UserError, match=said):
        library(place)


# ---- the blind plants -----------------------------------------------------------------------------------------------

LIMITS = ("saturation", "rate_limit")


def weakest(name, sizes):
    """The size that shows least: of a limit the largest."""
    return sizes[name.partition(":")[0] in LIMITS]


def nothing(name):
    return 1e9 if name.partition(":")[0] in LIMITS else 0.0


@pytest.fixture(params=ROBOTS)
def plant(request, monkeypatch):
    """A plant with a log half as long; a quarter where MuJoCo is the plant, since that takes its time."""
    slow = "\nmujoco = " in (EXAMPLES / ROBOTS[request.param].FILE).read_text()
    if slow:
        pytest.importorskip("mujoco", reason="no mujoco here: pip install -r tools/requirements-simulators.txt")
    monkeypatch.setattr(ROBOTS[request.param], "ROWS", 500 if slow else 1000)
    return ROBOTS[request.param]


def of_plant(plant, effects, examples, folder, seed=8):
    """(robot, RobotLog) of a drive."""
    rows = [plant.columns(row) for row in drive(plant, effects, random.Random(seed))]
    robot = toml.read(examples / plant.FILE)
    return robot, read(written(folder / "log.csv", [plant.HEADER, *rows]), robot)


def test_zero_of_all_effects_is_exactly_the_plain_plant(plant):
    none = {name: nothing(name) for name in (*plant.KNOWN, *plant.UNKNOWN)}
    assert drive(plant, none, random.Random(3)) == drive(plant, {}, random.Random(3))


def test_a_plain_plant_is_healthy_and_its_columns_are_right(plant, examples, tmp_path):
    robot, log = of_plant(plant, {}, examples, tmp_path)
    assert check.mistaken(robot, log) + check.along(LogPath(robot, log)) == []
    assert own.diagnose(log, robot).report["verdict"] == "none"


def test_known_effects_are_in_the_library_with_these_sizes_and_unknown_ones_are_not(plant, examples, tmp_path):
    robot, log = of_plant(plant, {}, examples, tmp_path)
    found = LogPath(robot, log).everything
    for name, (low, high) in plant.KNOWN.items():
        (p,) = found[name].parameters
        assert p.low <= low < high <= p.high, name
        if name.partition(":")[0] in plant.SIGNED:
            assert p.low <= -high, name
    assert not {name for name in plant.UNKNOWN if name in {n.partition(":")[0] for n in found}}


def test_the_simulator_misses_each_effect_at_its_weakest_by_several_times_the_noise_of_a_window(plant, examples, tmp_path):
    """Controllers hide effects from the states, so it is asked what the simulator makes of the commands."""

    def missed(effects):
        robot, log = of_plant(plant, effects, examples, tmp_path)
        path = LogPath(robot, log)
        noise = noises.first(path)
        fitter = Fitter(path, replace(noise, sensor=np.array([sd for _, _, sd in plant.SENSORS])))
        return fitter.fit_of(()).cost

    plain, windows = missed({}), plant.ROWS // 50
    for name, sizes in (plant.KNOWN | plant.UNKNOWN).items():
        assert missed({name: weakest(name, sizes)}) > plain + 4**2 * windows, name


class Integrator:
    """A plant that is easy to follow: its one command is the rate of its one state, and nothing has noise."""

    NAME, DT, ROWS, COMMANDS, SENSORS = "integrator", 0.02, 60, ("rate",), (("place", 0, 0.0),)
    start = staticmethod(lambda chance: [0.0])
    commands = staticmethod(lambda chance: lambda t, seen: [1.0 if t > 0.199 else 0.0])
    advance = staticmethod(lambda effects: lambda x, u, h: [x[0] + h * u[0]])


@pytest.mark.parametrize("late", [0.0373, 0.0011, 0.02])
def test_delays_of_a_plant_are_as_long_as_they_say(late):
    """The command steps up at 0.2 s, so that the place grows by a second a second from then on."""
    t, plain = np.array(drive(Integrator, {}, random.Random(1)))[:, :2].T
    np.testing.assert_allclose(plain, np.maximum(t - 0.2, 0), atol=1e-12)
    for effect in ("delay:rate", "sensor_delay:place"):
        seen = np.array(drive(Integrator, {effect: late}, random.Random(1)))[:, 1]
        np.testing.assert_allclose(seen[14:], t[14:] - 0.2 - late, atol=1e-12)


def test_a_rate_limit_of_a_plant_is_a_ramp():
    """To 1 at 4 a second: the place stays behind by half of what the ramp takes, 0.125 s, but for the last short step."""
    t, seen = np.array(drive(Integrator, {"rate_limit:rate": 4.0}, random.Random(1)))[:, :2].T
    np.testing.assert_allclose(seen[24:], t[24:] - 0.2 - 0.125, atol=2e-5)
