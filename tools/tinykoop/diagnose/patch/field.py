"""Parameters of a robot that were wrong, and where a model keeps them: KIND/NAMES/WHAT, with indices of the numbers if not the first."""

from dataclasses import dataclass

from ...plumbing.errors import UserError

PREFIX = "parameter:"
LINKS = ("link", "body")  # URDF's and SDF's word, and MuJoCo's
ELSEWHERE = "the robot's .toml takes every effect, a snippet (.py or .c) most of a drive's"


@dataclass(frozen=True)
class Field:
    """value: what the parameter is after all; at: indices of the numbers."""

    text: str
    kind: str
    names: tuple
    what: str
    at: tuple
    value: float


def of(effect, path):
    """The Field of an effect; refuses effects that are no parameter with a place in a model."""
    name, pieces, at = effect["name"], effect.get("field", "").split("/"), (0,)
    if not name.startswith(PREFIX):
        raise UserError(f"{path}: {name} is no parameter of a model; {ELSEWHERE}")
    if pieces[-1] and not set(pieces[-1]) - set("0123456789,"):
        at = tuple(int(part) for part in pieces.pop().split(",") if part)
    if len(pieces) < 2 or effect.get("value") is None:
        raise UserError(f"{path}: the report does not say where {name} is; give its [[parameter]] a value and a field, as link/base/mass")
    names = tuple("/".join(pieces[1:-1]).split(",")) if len(pieces) > 2 else ()
    return Field(effect["field"], pieces[0], names, pieces[-1], at, effect["value"] + effect["params"]["change"])


def refuse(field, path, form):
    raise UserError(f"{path}: {form} has no place for {field.text}; change it by hand to {field.value:.6g}, or patch the robot's .toml")


def named(elements, name, what, path):
    """The one element of that name."""
    found = [element for element in elements if element.attributes.get("name") == name]
    if len(found) != 1:
        raise UserError(f"{path}: has {len(found)} elements {what} named '{name}', one is needed; the field of the [[parameter]] names it")
    return found[0]


def masses(link, wanted, path):
    """(mass, inertia) of a link's <inertial>."""
    inertial = link.child("inertial")
    found = [inertial.child(tag) for tag in ("mass", "inertia")] if inertial else [None]
    if None in found:
        raise UserError(f"{path}: {wanted.text}: write <inertial> with <mass> and <inertia> there, so that it can be changed")
    return found


def patched(text, report, path, write, drive):
    """Parameters by write(text, Field, name, path), the effects of a drive by `drive`."""
    effects = {}
    for effect in report["effects"]:
        if not effect["name"].startswith(PREFIX):
            effects[effect["name"]] = effect["params"]
            continue
        wanted = of(effect, path)
        for name in wanted.names or ("",):
            text = write(text, wanted, name, path)
    return drive.patched(text, effects, path) if effects else text
