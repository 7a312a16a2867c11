"""The YAML file of ros2_control's diff_drive_controller.

Names of its parameters: ros2_controllers, diff_drive_controller_parameter.yaml. The wheels turn with (v -+ omega s / 2) / r, where s
and r are separation and radius times their multipliers. A robot that drives (1 + a) v and turns (1 + b) omega has wheels of (1 + a) r
at a distance of (1 + a) / (1 + b) s.
"""

import re

from ...plumbing.errors import UserError

KNOWN = ("speed_gain", "yaw_gain", "wheel_asymmetry", "saturation")


def factors(effects, separation=None):
    """({parameter: factor}, {parameter: value}) of effects {name: params}."""
    a, b = effects.get("speed_gain", {}).get("a", 0.0), effects.get("yaw_gain", {}).get("b", 0.0)
    wider = (1 + a) / (1 + b)
    aside = effects.get("wheel_asymmetry", {}).get("c", 0.0) * (separation or 0.0) * wider / 2  # to first order
    times = {
        "wheel_separation_multiplier": wider,
        "left_wheel_radius_multiplier": (1 + a) * (1 - aside),
        "right_wheel_radius_multiplier": (1 + a) * (1 + aside),
    }
    limits = effects.get("saturation", {})
    largest = {"linear.x.max_velocity": limits.get("v_max", 0.0), "angular.z.max_velocity": limits.get("w_max", 0.0)}
    return {name: factor for name, factor in times.items() if abs(factor - 1) > 1e-9}, {n: v for n, v in largest.items() if v}


def _entry(name):
    return re.compile(rf"^([ \t]*){re.escape(name)}:[ \t]*([-+.\deE]+)", re.M)


def _with(text, name, value, path):
    """The text with a parameter of that value, beside wheel_separation where there was none."""
    found = _entry(name).search(text)
    if found:
        return text[: found.start(2)] + value + text[found.end(2) :]
    beside = _entry("wheel_separation").search(text)
    if not beside:
        raise UserError(f"{path}: has no {name} and no wheel_separation; is it the file of a diff_drive_controller?")
    return f"{text[: beside.start()]}{beside[1]}{name}: {value}\n{text[beside.start() :]}"


def patched(text, report, path):
    effects = {effect["name"]: effect["params"] for effect in report["effects"]}
    strange = [name for name in effects if name not in KNOWN]
    if strange:
        raise UserError(f"{path}: the controller has no parameter for {', '.join(strange)}; it knows {', '.join(KNOWN)}")
    separation = _entry("wheel_separation").search(text)
    if "wheel_asymmetry" in effects and not separation:
        raise UserError(f"{path}: has no wheel_separation, which the wheels' radii follow from; write it there")
    times, largest = factors(effects, float(separation[2]) if separation else None)
    for name, factor in times.items():
        found = _entry(name).search(text)
        text = _with(text, name, f"{(float(found[2]) if found else 1.0) * factor:.6g}", path)
    for name, value in largest.items():
        text = _with(text, name, f"{value:.6g}", path)
    return text
