"""A MuJoCo model: attributes of bodies, geoms and joints that parameters of the robot stand for."""

from ...plumbing.errors import UserError
from . import field, markup

# Attributes of MJCF that the compiled model has under the same name (MuJoCo's XML reference).
SAME = ("mass", "friction", "size", "damping", "armature", "frictionloss", "stiffness", "gear", "wind", "viscosity", "density", "gravity")
INERTIA = ("diaginertia", "fullinertia")


def _element(top, wanted, name, path):
    """Of a kind, as a body; of a section whose elements have tags of their own, as an actuator; or the only <option>."""
    if wanted.kind == "option":
        options = list(top.all("option"))
        if len(options) != 1:
            raise UserError(f"{path}: has {len(options)} elements <option>; write one, so that {wanted.text} can be changed")
        return options[0]
    inside = (
        [child for section in top.all(wanted.kind) for child in section.children] if wanted.kind == "actuator" else top.all(wanted.kind)
    )
    return field.named(inside, name, wanted.kind, path)


def _with_number(text, element, wanted, path):
    """With the numbers of an attribute that the field names; what is beside them, as the second coefficient of friction, stays."""
    numbers = element.attributes.get(wanted.what, "").split()
    if max(wanted.at) >= max(len(numbers), 1):
        raise UserError(
            f"{path}: write {wanted.what} with all its numbers into <{element.tag}> itself, so that {wanted.text} can be changed"
        )
    numbers = numbers or [""]
    for i in wanted.at:
        numbers[i] = markup.number(wanted.value)
    return markup.with_attributes(text, element, {wanted.what: " ".join(numbers)})


def _with_mass(text, body, wanted, path):
    """A body has the mass of its <inertial>, whose inertia grows with it, or of its only geom that has one."""
    holders = [child for child in body.children if child.tag in ("inertial", "geom") and "mass" in child.attributes]
    holders = [child for child in holders if child.tag == "inertial"] or holders
    if len(holders) != 1:
        raise UserError(
            f"{path}: {wanted.text}: write the body's mass as <inertial mass=..> or as the mass of one geom, so that it can be changed"
        )
    given = {name: holders[0].attributes[name] for name in ("mass", *INERTIA) if name in holders[0].attributes}
    times = wanted.value / markup.as_number(given["mass"], holders[0], path)
    grown = {
        name: [markup.number(times * markup.as_number(part, holders[0], path)) for part in value.split()] for name, value in given.items()
    }
    return markup.with_attributes(text, holders[0], {name: " ".join(numbers) for name, numbers in grown.items()})


def patched(text, report, path):
    for effect in report["effects"]:
        wanted = field.of(effect, path)
        if wanted.what not in SAME:
            field.refuse(wanted, path, "MJCF")
        for name in wanted.names or ("",):
            element = _element(markup.read(text, path), wanted, name, path)
            write = _with_mass if (wanted.kind, wanted.what) == ("body", "mass") else _with_number
            text = write(text, element, wanted, path)
    return text
