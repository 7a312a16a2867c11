"""The fix handed back into XML: URDF, SDF, Gazebo's differential drive and MuJoCo models, read again by other readers."""

import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from test_patch import drive, report_of
from tinykoop.diagnose import patch
from tinykoop.diagnose.patch import gazebo
from tinykoop.plumbing.errors import UserError

OWN = Path(__file__).resolve().parents[2] / "examples/own_robot"
PLUGIN = """<plugin filename="gz-sim-diff-drive-system" name="gz::sim::systems::DiffDrive">
\t\t\t<left_joint>left</left_joint><right_joint>right</right_joint>
\t\t\t<wheel_separation>0.4</wheel_separation>
\t\t\t<wheel_radius> 0.1 </wheel_radius><!-- <wheel_radius>9</wheel_radius> -->
\t\t\t<max_angular_velocity>2</max_angular_velocity>
\t\t</plugin>"""
URDF = f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<!-- é <link name="base"><inertial><mass value="99"/></inertial></link> -->
<robot name="cart">
\t<link name="base">
\t\t<inertial><origin xyz="0 0 0"/><mass value='2'/><inertia ixx="0.01" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.025"/></inertial>
\t</link>
\t<link name="slider"><inertial><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/><mass value="1"/></inertial></link>
\t<link name="pole"><inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
\t<joint name="slide" type="prismatic">
\t\t<parent link="base"/><child link="slider"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="9" velocity="9"/>
\t\t<dynamics friction="0.3" damping = "0.5" />
\t</joint>
\t<joint name="swing" type="continuous"><parent link="slider"/><child link="pole"/><axis xyz="0 1 0"/></joint>
\t<gazebo reference="base"><mu2>0.9</mu2></gazebo>
\t<gazebo>
\t\t{PLUGIN}
\t</gazebo>
</robot>
"""
SDF = f"""<?xml version="1.0"?>
<sdf version="1.9">
  <model name="cart">
    <link name="base">
      <inertial><mass>2</mass><inertia><ixx>0.01</ixx><iyy>0.02</iyy><izz>0.025</izz></inertia></inertial>
      <collision name="floor_side"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision>
      <collision name="caster">
        <geometry><sphere><radius>0.1</radius></sphere></geometry>
        <surface><friction><ode><mu>0.9</mu></ode></friction></surface>
      </collision>
    </link>
    <link name="wheel"/>
    <joint name="roll" type="revolute"><axis><xyz>0 1 0</xyz><dynamics><damping>0.5</damping></dynamics></axis></joint>
    <joint name="free" type="revolute"><axis><xyz>0 1 0</xyz></axis></joint>
    {PLUGIN}
  </model>
</sdf>
"""


def parameters(**changes):
    """Effects of parameters: NAME = (field, value, change)."""
    return [{"name": f"parameter:{name}", "params": {"change": c}, "field": f, "value": v} for name, (f, v, c) in changes.items()]


def changed(path, text, effects):
    """The file's text with effects in it; twice gives the same."""
    path.write_text(text)
    new = patch.patched({"effects": effects}, path)[1]
    return new


def test_a_patched_urdf_has_the_parameters_when_mujoco_reads_it(tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="no mujoco here: pip install -r tools/requirements-simulators.txt")
    effects = parameters(
        mass=("link/slider,pole/mass", 1.0, 0.5), damping=("joint/slide,swing/damping", 0.5, 0.2), dry=("joint/slide/friction", 0.3, -0.1)
    )
    before, after = (mujoco.MjModel.from_xml_string(text) for text in (URDF, changed(tmp_path / "cart.urdf", URDF, effects)))
    for name in ("slider", "pole"):
        assert after.body(name).mass[0] == pytest.approx(1.5)
        np.testing.assert_allclose(after.body(name).inertia, 1.5 * before.body(name).inertia, rtol=1e-5)
    np.testing.assert_allclose(after.dof_damping, 0.7)
    np.testing.assert_allclose(after.dof_frictionloss, (0.2, 0.0))


def test_friction_of_a_link_is_what_gazebo_reads_beside_the_urdf(tmp_path):
    effects = parameters(ground=("link/base,pole/friction", 0.9, -0.3))
    root = ElementTree.fromstring(changed(tmp_path / "cart.urdf", URDF, effects).encode("latin-1"))
    for name in ("base", "pole"):
        (block,) = [block for block in root.findall("gazebo") if block.get("reference") == name]
        assert {child.tag: float(child.text) for child in block} == {"mu1": 0.6, "mu2": 0.6}


def test_only_the_numbers_of_a_urdf_change(tmp_path):
    new = changed(tmp_path / "cart.urdf", URDF, parameters(mass=("link/base/mass", 2.0, 1.0), damping=("joint/slide/damping", 0.5, 0.1)))
    was, now = (text.splitlines() for text in (URDF, new))
    assert [line for line in now if line not in was] == [
        '\t\t<inertial><origin xyz="0 0 0"/><mass value=\'3\'/><inertia ixx="0.015" ixy="0.0015" ixz="0" iyy="0.03" iyz="0" izz="0.0375"/></inertial>',
        '\t\t<dynamics friction="0.3" damping = "0.6" />',
    ]
    assert len(was) == len(now)


def test_a_patched_sdf_has_the_parameters(tmp_path):
    effects = parameters(
        mass=("link/base/mass", 2.0, 1.0), damping=("joint/roll,free/damping", 0.5, 0.2), dry=("joint/free/frictionloss", 0.0, 0.1),
        ground=("body/base/friction", 0.9, -0.1),
    )  # fmt: skip
    model = ElementTree.fromstring(changed(tmp_path / "cart.sdf", SDF, effects)).find("model")
    numbers = lambda place: [float(found.text) for found in model.findall(place)]  # noqa: E731
    assert numbers("link/inertial/mass") == [3.0] and numbers("link/inertial/inertia/*") == [0.015, 0.03, 0.0375]
    assert numbers("joint/axis/dynamics/damping") == [0.7, 0.7] and numbers("joint[@name='free']/axis/dynamics/friction") == [0.1]
    assert numbers("link/collision/surface/friction/ode/mu") == numbers("link/collision/surface/friction/ode/mu2") == [0.8, 0.8]


@pytest.mark.parametrize(
    "suffix, text",
    [("urdf", URDF), ("sdf", SDF), ("xml", "<mujoco><worldbody><body name='base'><inertial mass='2'/></body></worldbody></mujoco>")],
)
def test_a_file_that_is_patched_twice_is_as_after_once(suffix, text, tmp_path):
    effects = parameters(mass=("body/base/mass", 2.0, 1.0))
    once = changed(tmp_path / f"cart.{suffix}", text, effects)
    assert changed(tmp_path / f"cart.{suffix}", once, effects) == once != text


@pytest.mark.parametrize("suffix, text", [("urdf", URDF), ("sdf", SDF)])
@pytest.mark.parametrize("radius", gazebo.RADIUS)
def test_a_patched_plugin_turns_the_model_s_own_wheels_as_the_robot_s_turned(suffix, text, radius, tmp_path):
    """By the plugin's formula with its new numbers, wheels of the old radius at the old distance drive (1 + a) v and turn (1 + b) omega."""
    a, b, text = 0.08, -0.15, text.replace("wheel_radius", radius)
    report = report_of(tmp_path, drive(speed_gain={"a": a}, yaw_gain={"b": b}))
    path = tmp_path / f"cart.{suffix}"
    path.write_text(text)
    patch.run(report, path, write=True)
    root = ElementTree.fromstring(path.read_text().encode("latin-1") if suffix == "urdf" else path.read_text())
    plugin = next(root.iter("plugin"))
    size, separation = float(plugin.find(radius).text), float(plugin.find("wheel_separation").text)
    for v, omega in ((0.7, 0.0), (0.4, 0.9)):
        left, right = ((v + side * omega * separation / 2) / size for side in (-1, 1))
        moved = 0.1 * (left + right) / 2, 0.1 * (right - left) / 0.4
        np.testing.assert_allclose(moved, ((1 + a) * v, (1 + b) * omega), rtol=1e-5)


def test_saturation_is_the_limits_of_gazebo_s_own_system(tmp_path):
    path = tmp_path / "cart.sdf"
    path.write_text(SDF)
    patch.run(report_of(tmp_path, drive(saturation={"v_max": 1.5, "w_max": 0.5})), path, write=True)
    plugin = next(ElementTree.fromstring(path.read_text()).iter("plugin"))
    limits = {child.tag: float(child.text) for child in plugin if child.tag.endswith("_velocity")}
    assert limits == {
        f"{name}_{axis}_velocity": sign * most
        for axis, most in (("linear", 1.5), ("angular", 0.5))
        for name, sign in (("max", 1), ("min", -1))
    }


def test_the_printed_change_is_a_patch_of_the_file(tmp_path, capsys):
    """By the program `patch`: tabs, and a last line without an end, included."""
    if not shutil.which("patch"):
        pytest.skip("no patch here: apt-get install patch")
    into, text = tmp_path / "cart.urdf", URDF.rstrip("\n")
    into.write_text(text)
    report = report_of(tmp_path, drive(speed_gain={"a": 0.1}))
    patch.run(report, into)
    printed = capsys.readouterr().out
    patch.run(report, into, write=True)
    new = into.read_text()
    into.write_text(text)
    subprocess.run(["patch", "-s", into], input=printed, text=True, check=True)
    assert into.read_text() == new != text


FIELD = {"mass": ("link/base/mass", 2.0, 0.1)}
BAD = {
    "an effect of a command": ("cart.urdf", URDF, [{"name": "lag:steering", "params": {"tau": 0.1}}], "no number for lag:steering.*robot's .toml takes every"),
    "asymmetry": ("cart.sdf", SDF, [{"name": "wheel_asymmetry", "params": {"c": 0.1}}], "no number for wheel_asymmetry.*snippet"),
    "no plugin": ("cart.urdf", "<robot/>", [{"name": "yaw_gain", "params": {"b": 0.1}}], "has 0 plugins.*patch the controller's .yaml"),
    "limits": (
        "cart.sdf", SDF.replace("gz-sim-diff-drive-system", "libgazebo_ros_diff_drive.so"),
        [{"name": "saturation", "params": {"v_max": 1.0, "w_max": 0.0}}], "only gz-sim's system DiffDrive has limits",
    ),
    "no radius": ("cart.sdf", SDF.replace("wheel_radius", "rim"), [{"name": "speed_gain", "params": {"a": 0.1}}], "has no <wheel_radius>"),
    "no link": ("cart.urdf", URDF, parameters(mass=("link/bas/mass", 2.0, 0.1)), "has 0 elements link named 'bas'"),
    "no place": ("cart.urdf", URDF, parameters(gear=("actuator/slide/gear", 2.0, 0.1)), "URDF has no place for actuator/slide/gear; change it by hand to 2.1"),
    "no place in MJCF": ("cart.xml", "<mujoco/>", parameters(gain=("actuator/a/gainprm", 2.0, 0.1)), "MJCF has no place for actuator/a/gainprm"),
    "an expression": ("cart.xacro", URDF.replace("value='2'", "value='${m}'"), parameters(**FIELD), "<mass> has '\\${m}' where a number is needed"),
    "no inertia": ("cart.sdf", SDF.replace("mass>", "weight>"), parameters(**FIELD), "write <inertial> with <mass> and <inertia>"),
    "no field": ("cart.urdf", URDF, parameters(mass=("mass", 2.0, 0.1)), "does not say where parameter:mass is"),
    "no XML": ("cart.urdf", "<robot>", parameters(**FIELD), "is no XML"),
    "second number": ("cart.xml", "<mujoco><worldbody><geom name='g'/></worldbody></mujoco>", parameters(size=("geom/g/size/1", 1.0, 0.1)), "write size with all"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_a_file_cannot_hold_is_refused_with_a_remedy(case, tmp_path):
    name, text, effects, says = BAD[case]
    with pytest.raises(UserError, match=says) as told:
        changed(tmp_path / name, text, effects)
    assert "\n" not in str(told.value)
