"""MuJoCo models as simulators: the examples' arm and two-wheeler, and small models whose motion is known in closed form."""

import csv
import importlib.util
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.platforms.own import Path as LogPath
from tinykoop.diagnose.robots import toml
from tinykoop.diagnose.robots.log import read
from tinykoop.plumbing.errors import UserError

mujoco = pytest.importorskip("mujoco", reason="no mujoco here: pip install -r tools/requirements-simulators.txt")

EXAMPLES = Path(__file__).resolve().parents[2] / "examples/own_robot"
HEADERS = {"arm": ("t", "q1", "q2", "tau1", "tau2"), "two_wheeler": ("t", "x", "y", "yaw", "left", "right")}


def example(name):
    return toml.read(EXAMPLES / name / f"{name}.toml")


def true_robot(name):
    """make_log.py of an example, as a module."""
    spec = importlib.util.spec_from_file_location(f"make_log_{name}", EXAMPLES / name / "make_log.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def drawn(name, robot, folder, seed, **hidden):
    """A RobotLog of the true robot, half as long; hidden: what it has that its simulator lacks."""
    true = true_robot(name)
    for what, size in {"ROWS": 1000, **hidden}.items():
        setattr(true, what, size)
    with open(folder / "log.csv", "w", newline="") as file:
        csv.writer(file).writerows([HEADERS[name], *true.drive(seed)])
    return read(folder / "log.csv", robot)


LOG = """
name = "small"
[log]
time = {column = "t"}
state = [%s]
command = [{name = "u", column = "u"}, {name = "w", column = "w"}]
[simulator]
mujoco = "small.xml"
%s
%s
"""


def small(folder, xml, states, maps, parameters=""):
    """The Robot of a model of these few lines; states: names, of which the columns have the same."""
    (folder / "small.xml").write_text(f"<mujoco>{xml}</mujoco>")
    columns = ", ".join(f'{{name = "{name}", column = "{name}"}}' for name in states)
    (folder / "small.toml").write_text(LOG % (columns, maps, parameters))
    return toml.read(folder / "small.toml")


def parameter(field, low=0.0, high=10.0):
    return f'[[parameter]]\nname = "p"\nfield = "{field}"\nlow = {low}\nhigh = {high}\n'


# ---- steps against other writings ------------------------------------------------------------------------------


def lagrange(t, x, torque, hand, damping):
    """The arm by its mass matrix, of which the Coriolis forces are differences: none is derived by hand."""
    q, v = x[:2], x[2:]

    def kinetic(q):
        """The mass matrix from the Jacobians of the three bodies' centres."""
        whole = np.zeros((2, 2))
        for reach, mass, inertia in (((0.2, 0), 1.5, 0.02), ((0.4, 0.16), 0.9, 0.009), ((0.4, 0.32), hand, 0.001 * hand)):
            c, s = np.cos([q[0], q[0] + q[1]]), np.sin([q[0], q[0] + q[1]])
            J = np.array([[reach[0] * c[0] + reach[1] * c[1], reach[1] * c[1]], [reach[0] * s[0] + reach[1] * s[1], reach[1] * s[1]]])
            turn = np.array([1.0, 1.0 if reach[1] else 0.0])
            whole += mass * J.T @ J + inertia * np.outer(turn, turn)
        return whole

    h = 1e-5
    slopes = [(kinetic(q + h * e) - kinetic(q - h * e)) / (2 * h) for e in np.eye(2)]
    coriolis = sum(slope * rate for slope, rate in zip(slopes, v)) @ v - np.array([v @ slope @ v / 2 for slope in slopes])
    low = 9.81 * (0.9 * 0.16 + hand * 0.32) * math.sin(q[0] + q[1])
    weight = np.array([9.81 * (1.5 * 0.2 + (0.9 + hand) * 0.4) * math.sin(q[0]) + low, low])
    return [*v, *np.linalg.solve(kinetic(q), torque - coriolis - weight - damping * v)]


@pytest.mark.parametrize("change", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.5, 0.2)])
def test_the_arm_moves_by_lagrange_s_equations_with_each_parameter(change):
    robot, rng = example("arm"), np.random.default_rng(2)
    x, u, damping = rng.uniform(-1.5, 1.5, (8, 4)), rng.uniform(-5, 5, (8, 2)), np.array([0.4, 0.25]) + change[1:]
    exact = [
        solve_ivp(lagrange, (0, 0.02), row, args=(torque, 0.4 + change[0], damping), rtol=1e-9, atol=1e-11).y[:, -1]
        for row, torque in zip(x, u)
    ]
    off = [np.abs(robot.simulator.finer(times).step(x, u, 0.02, robot.nominal + change) - exact).max() for times in (8, 16)]
    assert off[1] < 3e-3 and 0.4 < off[1] / off[0] < 0.6  # an error that goes with the step of time


def test_finer_steps_are_those_of_a_model_with_a_shorter_step():
    robot, model = example("two_wheeler"), mujoco.MjModel.from_xml_path(str(EXAMPLES / "two_wheeler/two_wheeler.xml"))
    model.opt.timestep /= 4
    data = mujoco.MjData(model)
    data.ctrl[:] = 6, 3
    mujoco.mj_step(model, data, 20)
    x = robot.simulator.finer(4).step(np.zeros((1, 12)), np.array([[6.0, 3.0]]), 0.02, robot.nominal)
    np.testing.assert_allclose(x[0, robot.simulator.state], [*data.qpos, *data.qvel], rtol=1e-12, atol=1e-15)


CART = """<option gravity="0 0 0"/><worldbody><body name="cart"><joint name="x" type="slide" axis="1 0 0"/>
<geom type="box" size=".1 .1 .1" mass="2"/><site name="imu"/></body></worldbody>"""
MOTORS = '<actuator><motor name="push" joint="x"/><motor name="pull" joint="x" gear="-1"/></actuator>'
MAPS = 'hidden = ["v"]\nqpos = ["x"]\nqvel = ["v"]\nctrl = ["u", "w"]\n'


def test_a_sensor_is_a_state_that_moves_nothing_and_is_read_at_the_end_of_a_step(tmp_path):
    sensors = '<sensor><velocimeter name="v" site="imu"/><accelerometer name="a" site="imu"/></sensor>'
    robot = small(tmp_path, CART + MOTORS + sensors, ["x", "speed", "a"], MAPS + 'sensordata = {speed = "v/0", a = "a"}')
    x, u = np.random.default_rng(1).normal(size=(2, 5, 4))
    u = u[:, :2]
    after = robot.simulator.step(x, u, 0.02, [])
    v = x[:, 3] + 0.02 * (u[:, 0] - u[:, 1]) / 2
    np.testing.assert_allclose(after[:, 1:], np.stack([v, (u[:, 0] - u[:, 1]) / 2, v], 1), atol=1e-12)
    x[:, 1:3] = 7.0
    np.testing.assert_array_equal(robot.simulator.step(x, u, 0.02, []), after)


def test_the_state_of_an_actuator_is_a_state_of_the_robot(tmp_path):
    """One with a filter of 50 ms: its exact solution behind a constant command."""
    motors = """<actuator><general name="push" joint="x" dyntype="filterexact" dynprm=".05"/><motor name="pull" joint="x"/></actuator>"""
    robot = small(tmp_path, CART + motors, ["x", "act"], MAPS + 'act = ["act"]')
    after = robot.simulator.step(np.array([[0.0, 0.3, 0.0]]), np.array([[1.0, 0.0]]), 0.02, [])
    assert abs(after[0, 1] - (1 - 0.7 * math.exp(-0.02 / 0.05))) < 1e-12


# ---- parameters by field ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("field, value, speed", [
    ("body/cart/mass", 4.0, 0.02 * 3 / 4),
    ("actuator/push/gainprm", 0.5, 0.02 * 0.5 * 3 / 2),
    ("actuator/push/gear/0", 3.0, 0.02 * 3 * 3 / 2),
    ("option/gravity/0", 1.5, 0.02 * (1.5 + 1.5)),
    ("joint/x/armature", 1.0, 0.02 * 3 / 3),
])  # fmt: skip
def test_a_parameter_acts_where_its_field_says(tmp_path, field, value, speed):
    robot = small(tmp_path, CART + MOTORS, ["x"], MAPS, parameter(field))
    step = lambda p: robot.simulator.step(np.zeros((1, 2)), np.array([[3.0, 0.0]]), 0.02, [p])  # noqa: E731
    before = step(robot.nominal[0])
    np.testing.assert_allclose(before[0, 1], 0.02 * 3 / 2, rtol=1e-12)
    np.testing.assert_allclose(step(value)[0, 1], speed, rtol=1e-12)
    np.testing.assert_array_equal(step(robot.nominal[0]), before)  # as it was before


def test_a_heavier_body_has_more_inertia():
    """A bare disc that a torque turns about its centre."""
    disc = '<worldbody><body name="b"><joint name="x"/><geom type="cylinder" size=".2 .05" mass="2"/></body></worldbody>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{disc}</mujoco>")
    from tinykoop.diagnose.simulators.mujoco import Field

    Field(model, "body/b/mass").write(model, 3.0)
    np.testing.assert_allclose(model.body("b").inertia, 1.5 * mujoco.MjModel.from_xml_string(f"<mujoco>{disc}</mujoco>").body("b").inertia)


def test_one_parameter_may_stand_for_several_elements_and_indices(tmp_path):
    """Wheels 10 % larger under both: as fast as their rims."""
    text = (EXAMPLES / "two_wheeler/two_wheeler.toml").read_text().replace("geom/left,right/friction", "geom/left,right/size/0,1")
    text = text.replace('name = "wheel_friction"', 'name = "radius"').replace("high = 2.0", "high = 0.06")
    (tmp_path / "two_wheeler.toml").write_text(text)
    (tmp_path / "two_wheeler.xml").write_text((EXAMPLES / "two_wheeler/two_wheeler.xml").read_text())
    robot = toml.read(tmp_path / "two_wheeler.toml")
    names, ways = [s.name for s in robot.states], []
    for radius in (0.05, 0.055):
        x = np.zeros((1, 12))
        for _ in range(100):
            x, before = robot.simulator.step(x, np.array([[6.0, 6.0]]), 0.02, robot.nominal + [0, radius - 0.05, 0]), x
        turned = (x - before)[0, names.index("left_angle")]
        ways.append((x - before)[0, names.index("px")] / turned)
    assert abs(ways[1] / ways[0] / 1.1 - 1) < 0.01


# ---- forces, contacts, threads, blow-ups -----------------------------------------------------------------------------


def test_a_push_is_a_force_that_friction_resists(tmp_path):
    """A box on a floor with friction 0.5: below 0.5 g a push creeps, above it the box moves on."""
    box = """<worldbody><geom type="plane" size="5 5 1" friction=".5"/><body name="b" pos="0 0 .1"><joint name="x" type="slide"/>
    <joint name="z" type="slide" axis="0 0 1"/><geom type="box" size=".1 .1 .1" friction=".5"/></body></worldbody>
    <actuator><motor name="a" joint="x"/><motor name="b" joint="x"/></actuator>"""
    maps = 'hidden = ["v", "vz"]\nqpos = ["x", "z"]\nqvel = ["v", "vz"]\nctrl = ["u", "w"]'
    box = '<option cone="elliptic"/>' + box.replace('type="slide"/>', 'type="slide" axis="1 0 0"/>')
    robot, x = small(tmp_path, box, ["x", "z"], maps), {}
    for push in (2.0, 8.0):
        x[push] = np.zeros((1, 4))
        for _ in range(50):
            x[push] = robot.simulator.step(x[push], np.zeros((1, 2)), 0.02, [], np.array([[0.0, 0.0, push, 0.0]]))
    assert x[2.0][0, 2] < 0.03
    assert abs(x[8.0][0, 2] - (8 - 0.5 * 9.81)) < 0.3


def test_the_answer_does_not_depend_on_threads_or_on_the_order_of_rows():
    robot, rng = example("two_wheeler"), np.random.default_rng(4)
    x = rng.normal(size=(60, 12)) * 0.2
    x[:, 3] *= 1e-3  # the height: in contact, more or less
    u, order, one = rng.uniform(-5, 10, (60, 2)), rng.permutation(60), robot.simulator
    first = one.step(x, u, 0.02, robot.nominal)
    for threads in (1, 2, 5):
        one.data = [mujoco.MjData(one.model) for _ in range(threads)]
        np.testing.assert_array_equal(one.step(x, u, 0.02, robot.nominal), first)
        np.testing.assert_array_equal(one.step(x[order], u[order], 0.02, robot.nominal), first[order])


def test_a_run_that_blows_up_is_not_finite_and_leaves_neither_words_nor_files(tmp_path, monkeypatch, capfd):
    robot = example("arm")
    monkeypatch.chdir(tmp_path)
    x = np.zeros((3, 4))
    x[1, 2] = 1e200
    after = robot.simulator.step(x, np.zeros((3, 2)), 0.02, robot.nominal)
    assert np.isfinite(after[[0, 2]]).all() and not np.isfinite(after[1]).all()
    assert os.listdir(tmp_path) == [] and capfd.readouterr() == ("", "")
    assert mujoco.get_mju_user_warning() is None


def test_windows_on_a_floor_begin_where_the_wheels_bear_and_roll(tmp_path):
    """The height and the wheels' speeds are hidden: their starts come from the simulator, not from 0."""
    robot = example("two_wheeler")
    path = LogPath(robot, drawn("two_wheeler", robot, tmp_path, 5, WEAK=0.0))
    assert path.cut
    names, starts = [s.name for s in robot.states], path.X[path.begins == 1].T
    height, yaw, vx, vy = (starts[names.index(name)] for name in ("pz", "yaw", "vx", "vy"))
    assert -1e-3 < np.median(height) < -2e-5
    ahead = vx * np.cos(yaw) + vy * np.sin(yaw)
    rims = 0.05 * (starts[names.index("left_rate")] + starts[names.index("right_rate")]) / 2
    assert np.ptp(ahead) > 0.3 and np.median(np.abs(ahead - rims)) < 0.05 * np.ptp(ahead)


# ---- end to end --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name, effect, parameter, size", [
    ("arm", "parameter:payload", "change", 0.12), ("two_wheeler", "gain:left", "a", -0.08),
])  # fmt: skip
def test_each_example_says_what_its_true_robot_has(tmp_path, name, effect, parameter, size):
    robot = example(name)
    report = own.diagnose(drawn(name, robot, tmp_path, 1), robot).report
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == [effect]
    assert abs(report["effects"][0]["params"][parameter] / size - 1) < 0.05
    assert report["gap"]["closed_fraction"]["50"] > 0.9
    assert report["passes"] <= 200


@pytest.mark.parametrize("name, hidden", [("arm", "PAYLOAD"), ("two_wheeler", "WEAK")])
def test_each_example_without_its_effect_is_healthy(tmp_path, name, hidden):
    robot = example(name)
    report = own.diagnose(drawn(name, robot, tmp_path, 2, **{hidden: 0.0}), robot).report
    assert report["verdict"] == "none" and report["passes"] <= 200


# ---- files that cannot be used --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("old, new, said", [
    ('"arm.xml"', '"arn.xml"', "there is no file .*arn.xml"),
    ('"arm.xml"', "3", "mujoco: must be a text"),
    ('"arm.xml"', '"broken.xml"', "broken.xml: XML Error"),
    ('"arm.xml"', '"free.xml"', "joint root is free or a ball; replace it by three slides"),
    ('qpos = ["q1", "q2"]', 'qpos = ["q1"]', r"qpos: the model has 2 \(shoulder, elbow\); name a signal"),
    ('qpos = ["q1", "q2"]', "qpos = 3", "qpos: the model has 2"),
    ('qvel = ["dq1", "dq2"]', 'qvel = ["dq1", "dq3"]', "qvel: there is no signal dq3; there is dq"),
    ('qvel = ["dq1", "dq2"]', 'qvel = ["dq1", "q2"]', "must name every state once; the states are q1, q2, dq1, dq2"),
    ('ctrl = ["tau1", "tau2"]', 'ctrl = ["tau1"]', r"ctrl: the model has 2 \(shoulder, elbow\)"),
    ('ctrl = ["tau1", "tau2"]', 'ctrl = ["tau1", "tau2"]\nsensordata = ["q1"]', "sensordata: write"),
    ('ctrl = ["tau1", "tau2"]', 'ctrl = ["tau1", "tau2"]\nsensordata = {q1 = "encoder"}', "no sensor encoder; there is none at all"),
    ('ctrl = ["tau1", "tau2"]', 'ctrl = ["tau1", "tau2"]\nact = ["q1"]', r"act: the model has 0"),
    ("body/hand/mass", "body/hamd/mass", "field body/hamd/mass: there is no body hamd; there is hand"),
    ("body/hand/mass", "bode/hand/mass", "there is no kind bode; there is body"),
    ("body/hand/mass", "body/hand/mas", "there is no number mas; there is mass"),
    ("body/hand/mass", "body/hand/inertia/3", "inertia has 3 numbers; the last is inertia/2"),
    ("body/hand/mass", "body/hand,lower/mass", r"refers to different numbers, \[0.4, 0.9\]"),
    ("body/hand/mass", "body/hand", "write KIND/NAME/WHAT, such as body/hand/mass"),
    ("body/hand/mass", "option/timestep", "every diagnosis tests shorter time steps"),
    ('field = "body/hand/mass"', "", "field payload: write KIND/NAME/WHAT"),
    ("low = 0.1", "low = 0.5", "the model has 0.4, which is not between low and high"),
])  # fmt: skip
def test_a_robot_s_file_that_is_wrong_gets_one_line(tmp_path, old, new, said):
    text = (EXAMPLES / "arm/arm.toml").read_text()
    assert old in text
    (tmp_path / "arm.toml").write_text(text.replace(old, new, 1))
    (tmp_path / "arm.xml").write_text((EXAMPLES / "arm/arm.xml").read_text())
    (tmp_path / "broken.xml").write_text("<mujoco><arm/></mujoco>")
    (tmp_path / "free.xml").write_text('<mujoco><worldbody><body><freejoint name="root"/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(UserError, match=said) as told:
        toml.read(tmp_path / "arm.toml")
    assert "\n" not in str(told.value)


def test_a_missing_package_is_told_with_the_command_that_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(UserError, match="build/venv/bin/pip install -r tools/requirements-simulators.txt"):
        example("arm")
