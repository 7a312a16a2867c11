"""A MuJoCo model: attributes of bodies, geoms and joints that parameters of the robot stand for."""

import re

from ...plumbing.errors import UserError

PREFIX = "parameter:"


def _element(text, kind, name, path):
    """(start, end) of the opening tag of an element."""
    found = re.search(rf'<{kind}\b[^>]*\bname="{re.escape(name)}"[^>]*>', text, re.S)
    if not found:
        raise UserError(f"{path}: there is no {kind} named '{name}'")
    return found.span()


def _changed(tag, attribute, value, change):
    """A tag with the first number of an attribute changed: what follows, as the second coefficient of friction, stays.

    value: what the model has where the tag leaves it to a default.
    """
    found = re.search(rf'\b{attribute}="\s*([-+.\deE]+)', tag)
    if found:
        return f"{tag[: found.start(1)]}{float(found[1]) + change:.6g}{tag[found.end(1) :]}"
    end = len(tag) - (2 if tag.endswith("/>") else 1)
    return f'{tag[:end].rstrip()} {attribute}="{value + change:.6g}"{tag[end:]}'


def _mass(text, name, change, path):
    """A body has the mass of its <inertial>, or of its only geom that has one."""
    start, end = _element(text, "body", name, path)
    inside = re.split(r"<body\b|</body>", text[end:])[0]
    tags = [m for m in re.finditer(r"<(?:inertial|geom)\b[^>]*>", inside) if re.search(r'\bmass="', m[0])]
    tags = [m for m in tags if m[0].startswith("<inertial")] or tags
    if len(tags) != 1:
        raise UserError(f"{path}: body {name}: write its mass as <inertial mass=..> or as the mass of one geom, so that it can be changed")
    at = end + tags[0].start()
    return text[:at] + _changed(tags[0][0], "mass", 0.0, change) + text[at + len(tags[0][0]) :]


def patched(text, report, path):
    for effect in report["effects"]:
        field = effect.get("field", "")
        if not effect["name"].startswith(PREFIX) or field.count("/") != 2:
            raise UserError(f"{path}: {effect['name']} is no parameter of the model; patch the robot's TOML file with it")
        kind, names, attribute = field.split("/")
        for name in names.split(","):
            if (kind, attribute) == ("body", "mass"):
                text = _mass(text, name, effect["params"]["change"], path)
                continue
            start, end = _element(text, kind, name, path)
            text = text[:start] + _changed(text[start:end], attribute, effect["value"], effect["params"]["change"]) + text[end:]
    return text
