"""The YAML file of ros2_control's diff_drive_controller.

Names of its parameters: ros2_controllers, diff_drive_controller/src/diff_drive_controller_parameter.yaml. The wheels turn with
(v -+ omega s / 2) / r (src/diff_drive_controller.cpp there), where s and r are separation and radius times their multipliers. A robot that
drives (1 + a) v and turns (1 + b) omega has wheels of (1 + a) r at a distance of (1 + a) / (1 + b) s. Without min_velocity it is
-max_velocity. In ROS 2 Humble a limit acts only beside has_velocity_limits; from Kilted on that parameter is gone, and is not looked at.
"""

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import MappingNode

from ...plumbing.errors import UserError
from .field import ELSEWHERE

KNOWN = ("speed_gain", "yaw_gain", "wheel_asymmetry", "saturation")
SEPARATION = "wheel_separation"
LIMITS = {"v_max": "linear.x", "w_max": "angular.z"}


def factors(effects, separation=None):
    """{parameter: factor} of effects {name: params}."""
    a, b = effects.get("speed_gain", {}).get("a", 0.0), effects.get("yaw_gain", {}).get("b", 0.0)
    wider = (1 + a) / (1 + b)
    aside = effects.get("wheel_asymmetry", {}).get("c", 0.0) * (separation or 0.0) * wider / 2  # to first order
    times = {
        "wheel_separation_multiplier": wider,
        "left_wheel_radius_multiplier": (1 + a) * (1 - aside),
        "right_wheel_radius_multiplier": (1 + a) * (1 + aside),
    }
    return {name: factor for name, factor in times.items() if abs(factor - 1) > 1e-9}


# ---- the file: parameters are found in its tree, and changed in its text ------------------------------------------


def _mappings(node):
    """All mappings of a tree."""
    if isinstance(node, MappingNode):
        yield node
    for child in node.value if isinstance(node.value, list) else ():
        for part in child if isinstance(child, tuple) else (child,):
            yield from _mappings(part)


def _controller(text, path):
    """The mapping that has a controller's parameters."""
    try:
        root = YAML(typ="rt", pure=True).compose(text)
    except MarkedYAMLError as error:
        raise UserError(f"{path}: is no YAML: {' '.join(str(error).split())}") from error
    found = [mapping for mapping in _mappings(root) if any(key.value == SEPARATION for key, _ in mapping.value)] if root else []
    if len(found) != 1:
        raise UserError(
            f"{path}: has {len(found)} controllers with {SEPARATION}, one is needed; is it the file of a diff_drive_controller?"
        )
    return found[0]


def _place(mapping, name):
    """(mapping, what is left of the name there, its value or None): a name with dots is one key, or mappings inside each other."""
    for key, value in mapping.value:
        if key.value == name:
            return mapping, name, value
        if name.startswith(f"{key.value}.") and isinstance(value, MappingNode):
            return _place(value, name[len(key.value) + 1 :])
    return mapping, name, None


def _number(text, name, path):
    """What a parameter is, or None."""
    value = _place(_controller(text, path), name)[2]
    try:
        return None if value is None else float(value.value)
    except (TypeError, ValueError):
        raise UserError(f"{path}: {name} is no number; write the number itself") from None


def _with(text, name, value, path):
    """The text with a parameter of that value, where it is or before what it belongs to."""
    mapping, name, found = _place(_controller(text, path), name)
    if found is not None:
        return text[: found.start_mark.index] + value + text[found.end_mark.index :]
    keys = {key.value: key.start_mark for key, _ in mapping.value}
    beside = keys.get(SEPARATION) or next(iter(keys.values()))
    apart = ", " if mapping.flow_style else f"\n{' ' * beside.column}"
    return f"{text[: beside.index]}{name}: {value}{apart}{text[beside.index :]}"


def _with_limit(text, axis, limit, path):
    for name, value in (("max_velocity", limit), ("min_velocity", -limit)):
        if value > 0 or _number(text, f"{axis}.{name}", path) is not None:
            text = _with(text, f"{axis}.{name}", _written(value), path)
    return _with(text, f"{axis}.has_velocity_limits", "true", path)


def _written(value):
    """A double, which ROS 2 distinguishes from an integer by its point."""
    text = f"{value:.6g}"
    return text if set(text) & set(".en") else f"{text}.0"


def patched(text, report, path):
    effects = {effect["name"]: effect["params"] for effect in report["effects"]}
    strange = [name for name in effects if name not in KNOWN]
    if strange:
        raise UserError(f"{path}: the controller has no parameter for {', '.join(strange)}, only for {', '.join(KNOWN)}; {ELSEWHERE}")
    for name, factor in factors(effects, _number(text, SEPARATION, path)).items():
        known = _number(text, name, path)
        text = _with(text, name, _written((1.0 if known is None else known) * factor), path)
    for parameter, axis in LIMITS.items():
        limit = effects.get("saturation", {}).get(parameter)
        text = _with_limit(text, axis, limit, path) if limit else text
    return text
