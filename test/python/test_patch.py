"""The fix handed back: what a report found, put into files of simulators and controllers."""

import csv
import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML as YAMLReader
from tinykoop import bridge
from tinykoop.diagnose import patch, run
from tinykoop.diagnose.patch import diff_drive, mjcf
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
OWN = ROOT / "examples/own_robot"
YAML = """controller:
  ros__parameters:
    left_wheel_names: ["left"]
    wheel_separation: 0.4
    wheel_radius: 0.1
    left_wheel_radius_multiplier: 1.02
"""


def report_of(folder, effects, verdict="known"):
    """A report file with these effects {name: params}, which act throughout."""
    told = [
        {"name": name, "params": params, "segments": [[0.0, 10.0]], "formula": "", "field": field}
        for name, (params, field) in effects.items()
    ]
    path = folder / "report.json"
    path.write_text(json.dumps({"verdict": verdict, "effects": told, "log": {"seconds": 10.0}}))
    return path


def drive(**params):
    return {name: (values, "") for name, values in params.items()}


def test_wheels_of_a_patched_controller_do_what_was_commanded(tmp_path):
    """Wheel speeds by the controller's formula turn a robot whose true wheels follow from what the unpatched one did."""
    a, b, c = 0.08, -0.15, 0.05
    effects = drive(speed_gain={"a": a}, yaw_gain={"b": b}, wheel_asymmetry={"c": c})
    into = tmp_path / "controller.yaml"
    into.write_text(YAML)
    patch.run(report_of(tmp_path, effects), into, write=True)

    def wheels(text, v, omega):
        number = lambda name, default: float((re.search(rf"{name}: (\S+)", text) or [0, default])[1])  # noqa: E731
        half = number("wheel_separation", 0) * number("wheel_separation_multiplier", 1) / 2
        radii = [number("wheel_radius", 0) * number(f"{side}_wheel_radius_multiplier", 1) for side in ("left", "right")]
        return (v - half * omega) / radii[0], (v + half * omega) / radii[1]

    # the true robot: its wheels, as the unpatched controller's commands show them
    moves = [(v * (1 + a), omega * (1 + b) + c * v * (1 + a)) for v, omega in ((1.0, 0.0), (0.0, 1.0))]
    response = np.linalg.solve(np.array([wheels(YAML, 1.0, 0.0), wheels(YAML, 0.0, 1.0)]), np.array(moves))
    for v, omega in ((0.7, 0.0), (0.4, 0.9), (-0.3, 0.5)):
        done = np.array(wheels(into.read_text(), v, omega)) @ response
        np.testing.assert_allclose(done, (v, omega), atol=3e-3)  # c to first order


def test_a_multiplier_is_written_beside_the_separation_and_one_that_is_there_is_changed(tmp_path):
    into = tmp_path / "controller.yaml"
    into.write_text(YAML)
    effects = drive(speed_gain={"a": 0.1}, yaw_gain={"b": 0.25}, saturation={"v_max": 1.5, "w_max": 0.0})
    text, new = patch.patched({"effects": [{"name": n, "params": p} for n, (p, _) in effects.items()]}, into)
    assert text == into.read_text() == YAML
    assert "\n    wheel_separation_multiplier: 0.88\n" in new and "left_wheel_radius_multiplier: 1.122\n" in new
    assert "\n    right_wheel_radius_multiplier: 1.1\n" in new and "linear.x.max_velocity: 1.5" in new and "angular" not in new


def test_yaw_gain_alone_is_the_separation(tmp_path):
    assert diff_drive.factors({"yaw_gain": {"b": 0.25}}) == {"wheel_separation_multiplier": 0.8}


# Of diff_drive_controller, as ros2_controllers declares them in diff_drive_controller/src/diff_drive_controller_parameter.yaml (Humble to
# Jazzy; has_velocity_limits and its like are gone from Kilted on).
LIMITED = ("velocity", "acceleration", "jerk")
DECLARED = {
    "left_wheel_names", "right_wheel_names", "wheel_separation", "wheels_per_side", "wheel_radius", "wheel_separation_multiplier",
    "left_wheel_radius_multiplier", "right_wheel_radius_multiplier", "tf_frame_prefix_enable", "tf_frame_prefix", "odom_frame_id",
    "base_frame_id", "pose_covariance_diagonal", "twist_covariance_diagonal", "open_loop", "position_feedback", "enable_odom_tf",
    "cmd_vel_timeout", "publish_limited_velocity", "velocity_rolling_window_size", "use_stamped_vel", "publish_rate",
    *(f"{axis}.{name}" for axis in ("linear.x", "angular.z") for what in LIMITED for name in (f"has_{what}_limits", f"max_{what}", f"min_{what}")),
}  # fmt: skip
NESTED = """
controller_manager: {ros__parameters: {update_rate: 100}}  # wheel_separation: 9
base:
  ros__parameters:
    wheel_radius: 0.1
    wheel_separation: 0.4  # m
    linear:
      x:
        has_velocity_limits: false
        max_velocity: 2.0
        min_velocity: -2.0
    angular.z.max_velocity: 3.0
arm:
  ros__parameters:
    left_wheel_radius_multiplier: 7.0
    max_velocity: 8.0
"""


def flat(mapping, before=""):
    """{name with dots: value}, as ROS 2 reads nested parameters."""
    out = {}
    for key, value in mapping.items():
        out |= flat(value, f"{before}{key}.") if isinstance(value, dict) else {before + key: value}
    return out


@pytest.mark.parametrize("text, name", [(YAML, "controller"), (NESTED, "base"), ("c: {ros__parameters: {wheel_separation: 0.4}}\n", "c")])
def test_a_patched_controller_has_parameters_that_the_controller_declares_with_their_types(text, name, tmp_path):
    into = tmp_path / "controller.yaml"
    into.write_text(text)
    effects = drive(speed_gain={"a": 0.1}, yaw_gain={"b": 0.25}, wheel_asymmetry={"c": 0.05}, saturation={"v_max": 1.0, "w_max": 0.5})
    patch.run(report_of(tmp_path, effects), into, write=True)
    before, after = (flat(YAMLReader(typ="safe").load(part)) for part in (text, into.read_text()))
    of = f"{name}.ros__parameters."
    assert {key.removeprefix(of) for key in after if key.startswith(of)} <= DECLARED
    changed = {key.removeprefix(of): value for key, value in after.items() if value != before.get(key)}
    assert all(key.startswith(of) or before[key] == value for key, value in after.items())
    assert changed["linear.x.max_velocity"] == 1.0 and changed["angular.z.max_velocity"] == 0.5
    assert changed["wheel_separation_multiplier"] == pytest.approx(0.88) and changed["linear.x.has_velocity_limits"] is True
    assert all(type(value) is (bool if "has_" in key else float) for key, value in changed.items())
    assert "linear.x.min_velocity" not in before or changed["linear.x.min_velocity"] == -1.0


SNIPPETS = {
    "gains": [("speed_gain", (0.1,)), ("yaw_gain", (-0.2,)), ("wheel_asymmetry", (0.05,)), ("yaw_bias", (0.02,))],
    "lag and delay": [("actuator_lag", (0.3,)), ("transport_delay", (0.13,))],
    "limits": [("saturation", (0.9, 0.0)), ("dead_band", (0.2, 0.1)), ("actuator_lag", (0.2,))],
}


@pytest.mark.parametrize("case", SNIPPETS)
def test_a_python_snippet_does_to_commands_what_the_simulator_does(case, tmp_path):
    table, dt = bridge.effects(), 0.05
    effects = {name: ({row[0]: v for row, v in zip(table[name][1], params)}, "") for name, params in SNIPPETS[case]}
    into = tmp_path / "robot.py"
    patch.run(report_of(tmp_path, effects), into, write=True)
    module = program(into)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform((-0.5, -1.0), (1.5, 1.0), (20, 2)), 10, axis=0)
    active = [bridge.Effect(name, params) for name, params in SNIPPETS[case]]
    expected = bridge.simulate(u, dt, active=active, integrator=bridge.ARC)
    done = bridge.simulate(np.column_stack(module.executed(*u.T, dt)), dt, integrator=bridge.ARC)
    np.testing.assert_allclose(done, expected, atol=1e-9)


PROGRAM = """
#include <stdio.h>
int main(void) {
	struct executed past = {0};
	double u[2];
	while (scanf("%lf %lf", &u[0], &u[1]) == 2) {
		if (executed(&past, u, STEP)) { return 1; }
		printf("%.17g %.17g\\n", u[0], u[1]);
	}
	return 0;
}
"""


def compiled(folder, source, dt):
    """A program that puts each line of commands through the snippet; nothing of it may draw a warning."""
    (folder / "main.c").write_text(f"{source}{PROGRAM}")
    strict = "-std=c99 -Wall -Wextra -Werror -Wpedantic -Wconversion -Wshadow".split()
    subprocess.run(["gcc", *strict, f"-DSTEP={dt!r}", "-o", folder / "main", folder / "main.c", "-lm"], check=True)
    return folder / "main"


@pytest.mark.parametrize("case", SNIPPETS)
def test_a_c_snippet_does_to_commands_what_the_python_snippet_does(case, tmp_path):
    table, dt = bridge.effects(), 0.05
    effects = {name: ({row[0]: v for row, v in zip(table[name][1], params)}, "") for name, params in SNIPPETS[case]}
    for name in ("robot.py", "robot.c"):
        patch.run(report_of(tmp_path, effects), tmp_path / name, write=True)
    scope = {}
    exec((tmp_path / "robot.py").read_text(), scope)
    u = np.repeat(np.random.default_rng(3).uniform((-0.5, -1.0), (1.5, 1.0), (20, 2)), 10, axis=0)
    given = "\n".join(f"{v!r} {omega!r}" for v, omega in u.tolist())
    done = subprocess.run(
        [compiled(tmp_path, (tmp_path / "robot.c").read_text(), dt)], input=given, capture_output=True, text=True, check=True
    )
    found = np.array(done.stdout.split(), float).reshape(-1, 2)
    np.testing.assert_allclose(found, np.column_stack(scope["executed"](*u.T, dt)), atol=1e-12)


def test_a_c_snippet_refuses_a_delay_of_more_steps_than_it_remembers(tmp_path):
    patch.run(report_of(tmp_path, drive(transport_delay={"delay": 0.15})), tmp_path / "robot.c", write=True)
    program = compiled(tmp_path, (tmp_path / "robot.c").read_text(), 1e-4)
    assert subprocess.run([program], input="1 0\n", text=True).returncode == 1


def program(path):
    """A program of the examples as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def lagging(tmp_path_factory):
    """(folder, robot, log) of the car whose steering is slow."""
    folder = tmp_path_factory.mktemp("car")
    for name in ("car.toml", "car.py"):
        shutil.copy(OWN / "car" / name, folder)
    true = program(OWN / "car/make_log.py")
    with open(folder / "car.csv", "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "y", "psi", "v_cmd", "delta"), *true.drive(7)[:800]])
    return folder, folder / "car.toml", folder / "car.csv"


def test_a_patched_robot_has_the_gap_that_was_claimed(lagging):
    folder, robot, log = lagging
    claimed = run(log, folder / "out", robot=str(robot)).report
    assert [e["name"] for e in claimed["effects"]] == ["lag:steering"]
    patch.run(folder / "out/report.json", robot, write=True)
    again = run(log, folder / "again", robot=str(robot)).report
    before, floor = claimed["gap"]["before"]["50"], claimed["gap"]["noise_floor"]["50"]
    closed = (before - again["gap"]["before"]["50"]) / (before - floor)
    assert abs(closed - claimed["gap"]["closed_fraction"]["50"]) < 0.02 and again["verdict"] == "none"


def test_what_the_log_cannot_separate_is_said_beside_the_patch(tmp_path, capsys):
    path = report_of(tmp_path, drive(yaw_gain={"b": 0.25}))
    path.write_text(json.dumps(json.loads(path.read_text()) | {"ambiguous_with": {"yaw_gain": ["clock_scale"]}}))
    (tmp_path / "controller.yaml").write_text(YAML)
    patch.run(path, tmp_path / "controller.yaml")
    assert "yaw_gain may as well be clock_scale" in capsys.readouterr().out


def test_without_write_the_file_stays_and_the_change_is_shown(tmp_path, capsys):
    into = tmp_path / "controller.yaml"
    into.write_text(YAML)
    patch.run(report_of(tmp_path, drive(yaw_gain={"b": 0.25})), into)
    assert into.read_text() == YAML
    assert "+    wheel_separation_multiplier: 0.8\n" in capsys.readouterr().out


GIVEN = {
    "controller.yaml": YAML,
    "robot.urdf": "<robot><gazebo><plugin name='drive'><wheel_separation>0.5</wheel_separation></plugin></gazebo></robot>",
}


@pytest.mark.parametrize("name", ["controller.yaml", "robot.urdf", "effects.py", "effects.c"])
def test_the_effects_of_a_report_go_into_a_file_once(name, tmp_path):
    """A multiplier would be multiplied again."""
    into, report = tmp_path / name, report_of(tmp_path, drive(yaw_gain={"b": 0.25}))
    if name in GIVEN:
        into.write_text(GIVEN[name])
    patch.run(report, into, write=True)
    once = into.read_text()
    with pytest.raises(UserError, match="has the effects of this report already .*; diagnose a new log"):
        patch.run(report, into, write=True)
    assert into.read_text() == once
    patch.run(report_of(tmp_path, drive(yaw_gain={"b": 0.1})), into, write=True)
    assert into.read_text() != once


def test_an_effect_of_the_robots_file_must_be_one_that_there_is(lagging, tmp_path):
    folder, robot, log = lagging
    for name in ("car.toml", "car.py"):
        shutil.copy(OWN / "car" / name, tmp_path)
    text = (tmp_path / "car.toml").read_text()
    for block, says in (
        ('name = "lag:wheel"\nparams = {tau = 0.1}', "lists what there is"),
        ('name = "lag:speed"\nparams = {a = 0.1}', "tau"),
    ):
        (tmp_path / "car.toml").write_text(f"{text}\n[[effect]]\n{block}\n")
        with pytest.raises(UserError, match=says):
            run(log, tmp_path / "out", robot=str(tmp_path / "car.toml"))


BAD = {
    "unknown": (drive(yaw_gain={"b": 0.1}), "unknown", "controller.yaml", "nothing to patch"),
    "no parameter": (drive(world_drift={"wx": 0.1, "wy": 0.0}), "known", "controller.yaml", "no parameter for world_drift"),
    "no snippet": (drive(world_drift={"wx": 0.1, "wy": 0.0}), "known", "new.py", "no snippet for world_drift"),
    "other file": (drive(yaw_gain={"b": 0.1}), "known", "robot.json", "--into takes .toml"),
    "missing": (drive(yaw_gain={"b": 0.1}), "known", "missing.yaml", "cannot be read"),
    "no controller": (drive(yaw_gain={"b": 0.1}), "known", "other.yaml", "has 0 controllers with wheel_separation"),
    "no YAML": (drive(yaw_gain={"b": 0.1}), "known", "broken.yaml", "is no YAML"),
    "an expression": (drive(yaw_gain={"b": 0.1}), "known", "expression.yaml", "wheel_separation is no number"),
    "two": (drive(yaw_gain={"b": 0.1}), "known", "two.yaml", "has 2 controllers"),
}
FILES = {
    "controller.yaml": YAML, "other.yaml": "a: 1\n", "broken.yaml": "a: [1\n", "expression.yaml": "wheel_separation: $(var track)\n",
    "two.yaml": "a: {wheel_separation: 1.0}\nb: {wheel_separation: 1.0}\n",
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_patched_is_refused_with_a_reason(case, tmp_path):
    effects, verdict, name, says = BAD[case]
    for file, text in FILES.items():
        (tmp_path / file).write_text(text)
    with pytest.raises(UserError, match=says):
        patch.run(report_of(tmp_path, effects, verdict), tmp_path / name)


def test_an_effect_of_a_part_of_the_log_is_no_number_of_a_simulator(tmp_path):
    path = report_of(tmp_path, drive(yaw_gain={"b": 0.1}))
    path.write_text(path.read_text().replace("[[0.0, 10.0]]", "[[2.0, 10.0]]"))
    with pytest.raises(UserError, match="yaw_gain acts in a part of the log only"):
        patch.run(path, tmp_path / "new.py")


@pytest.mark.parametrize("text", [None, "no JSON", "[]", "{}"])
def test_what_is_no_report_is_refused(text, tmp_path):
    path = tmp_path / "report.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match="report.json: (is no report|cannot be read)"):
        patch.run(path, tmp_path / "new.py")


def test_a_patched_mujoco_model_has_the_parameters(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    text = (OWN / "two_wheeler/two_wheeler.xml").read_text()
    effects = [
        {"name": "parameter:chassis_mass", "params": {"change": 0.4}, "field": "body/chassis/mass", "value": 2.0},
        {"name": "parameter:wheel_friction", "params": {"change": -0.2}, "field": "geom/left,right/friction", "value": 0.8},
    ]
    new = mjcf.patched(text, {"effects": effects}, tmp_path / "robot.xml")
    before, after = (mujoco.MjModel.from_xml_string(model) for model in (text, new))
    body = before.body("chassis").id
    assert after.body_mass[body] - before.body_mass[body] == pytest.approx(0.4, abs=1e-5)
    np.testing.assert_allclose(after.body_inertia[body], 1.2 * before.body_inertia[body], rtol=1e-5)  # as the diagnoser has it
    for name in ("left", "right"):
        old, changed = before.geom(name).friction, after.geom(name).friction
        np.testing.assert_allclose(changed - old, (-0.2, 0, 0), atol=1e-6)


def test_a_patched_mujoco_model_closes_the_gap_on_a_fresh_log_as_claimed(tmp_path):
    """The arm with a payload: its patched model, loaded again, on a log that nothing was fitted to."""
    mujoco = pytest.importorskip("mujoco", reason="no mujoco here: pip install -r tools/requirements-simulators.txt")
    true = program(OWN / "arm/make_log.py")
    true.ROWS = 500
    for name in ("arm.toml", "arm.xml"):
        shutil.copy(OWN / "arm" / name, tmp_path)
    for seed, name in enumerate(("log.csv", "fresh.csv")):
        with open(tmp_path / name, "w", newline="") as file:
            csv.writer(file).writerows([("t", "q1", "q2", "tau1", "tau2"), *true.drive(seed)])
    robot = str(tmp_path / "arm.toml")
    claimed = run(tmp_path / "log.csv", tmp_path / "out", fresh=tmp_path / "fresh.csv", robot=robot).report
    patch.run(tmp_path / "out/report.json", tmp_path / "arm.xml", write=True)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert model.body("hand").mass[0] == pytest.approx(0.4 + true.PAYLOAD, rel=0.03)
    again = run(tmp_path / "fresh.csv", tmp_path / "again", robot=robot).report
    before, floor = (claimed["fresh"]["gap"][part]["50"] for part in ("before", "noise_floor"))
    closed = (before - again["gap"]["before"]["50"]) / (before - floor)
    assert again["verdict"] == "none" and abs(closed - claimed["gap"]["closed_fraction"]["50"]) < 0.02
    assert abs(claimed["fresh"]["gap"]["closed_fraction"]["50"] - closed) < 0.02  # as the report says before anything is patched
