"""Gazebo's differential drive, in URDF and SDF files alike: the numbers by which its plugin turns commands into wheel speeds.

Names: gz-sim's system DiffDrive (wheel_separation, wheel_radius, max_linear_velocity, ..) and Gazebo Classic's gazebo_ros_diff_drive
(wheel_separation, wheel_diameter; wheelSeparation, wheelDiameter for ROS 1). The plugin turns the wheels with (v -+ omega s / 2) / r, and
the model's own wheels stay. A model that drives (1 + a) v and turns (1 + b) omega thus has a plugin with r / (1 + a), s (1 + b) / (1 + a).
"""

from ...plumbing.errors import UserError
from . import markup
from .field import ELSEWHERE

KNOWN = ("speed_gain", "yaw_gain", "saturation")
SEPARATION, RADIUS = ("wheel_separation", "wheelSeparation"), ("wheel_radius", "wheel_diameter", "wheelDiameter")
LIMITED = "diff-drive-system"  # what the library's name of gz-sim's system ends with; Gazebo Classic's plugin has no limits
LIMITS = {"v_max": "linear", "w_max": "angular"}


def _plugin(text, path):
    found = [plugin for plugin in markup.read(text, path).all("plugin") if any(plugin.child(name) for name in SEPARATION)]
    if len(found) != 1:
        other = "with ros2_control, patch the controller's .yaml" if not found else "leave one of them in the file"
        raise UserError(f"{path}: has {len(found)} plugins with <wheel_separation>, one is needed; {other}")
    return found[0]


def _with_sizes(text, names, times, path):
    """With each of the plugin's numbers of these names times a factor."""
    places = [child for child in _plugin(text, path).children if child.tag in names]
    if not places:
        raise UserError(f"{path}: the plugin has no <{names[0]}>; write it there, so that it can be changed")
    for child in reversed(places):
        text = text[: child.opened] + markup.number(times * markup.content(text, child, path)) + text[child.closed :]
    return text


def _with_limits(text, limits, path):
    if LIMITED not in _plugin(text, path).attributes.get("filename", ""):
        raise UserError(f"{path}: saturation: only gz-sim's system DiffDrive has limits of velocity; {ELSEWHERE}")
    for parameter, axis in LIMITS.items():
        if limits[parameter]:
            for name, sign in (("max", 1), ("min", -1)):
                text = markup.with_content(text, _plugin(text, path), (f"{name}_{axis}_velocity",), markup.number(sign * limits[parameter]))
    return text


def patched(text, effects, path):
    """With effects {name: params} of a drive."""
    strange = [name for name in effects if name not in KNOWN]
    if strange:
        raise UserError(f"{path}: the plugin has no number for {', '.join(strange)}, only for {', '.join(KNOWN)}; {ELSEWHERE}")
    a, b = effects.get("speed_gain", {}).get("a", 0.0), effects.get("yaw_gain", {}).get("b", 0.0)
    if a:
        text = _with_sizes(text, RADIUS, 1 / (1 + a), path)
    if a or b:
        text = _with_sizes(text, SEPARATION, (1 + b) / (1 + a), path)
    return _with_limits(text, effects["saturation"], path) if "saturation" in effects else text
