"""A URDF file: masses of links, damping and friction of joints, friction of a link in Gazebo, and Gazebo's differential drive."""

from . import field, gazebo, markup

JOINT = {"damping": "damping", "friction": "friction", "frictionloss": "friction"}  # as MuJoCo calls it, too
SURFACE = ("mu1", "mu2")


def _with_mass(text, link, wanted, path):
    """Its inertia grows with it."""
    mass, inertia = field.masses(link, wanted, path)
    times = wanted.value / markup.as_number(mass.attributes.get("value", ""), mass, path)
    grown = {name: markup.number(times * markup.as_number(value, inertia, path)) for name, value in inertia.attributes.items()}
    for element, values in sorted(((mass, {"value": markup.number(wanted.value)}), (inertia, grown)), key=lambda change: -change[0].start):
        text = markup.with_attributes(text, element, values)
    return text


def _with_joint(text, joint, wanted):
    dynamics, name, value = joint.child("dynamics"), JOINT[wanted.what], markup.number(wanted.value)
    if dynamics:
        return markup.with_attributes(text, dynamics, {name: value})
    return markup.with_child(text, joint, f'<dynamics {name}="{value}"/>')


def _with_surface(text, robot, name, wanted, path):
    """URDF itself has no friction: what Gazebo reads beside it has."""
    value = markup.number(wanted.value)
    about = [block for block in robot.children if block.tag == "gazebo" and block.attributes.get("reference") == name]
    about = [block for block in about if any(block.child(tag) for tag in SURFACE)] or about
    if not about:
        made = "".join(f"<{tag}>{value}</{tag}>" for tag in SURFACE)
        return markup.with_child(text, robot, f'<gazebo reference="{name}">{made}</gazebo>')
    for tag in SURFACE:
        text = markup.with_content(text, markup.at(text, about[0].start, path), (tag,), value)
    return text


def _with(text, wanted, name, path):
    """With one element's parameter."""
    robot = markup.read(text, path).children[0]
    if wanted.kind in field.LINKS and wanted.what in ("mass", "friction"):
        link = field.named(robot.all("link"), name, "link", path)
        return _with_mass(text, link, wanted, path) if wanted.what == "mass" else _with_surface(text, robot, name, wanted, path)
    if wanted.kind == "joint" and wanted.what in JOINT:
        return _with_joint(text, field.named(robot.all("joint"), name, "joint", path), wanted)
    return field.refuse(wanted, path, "URDF")


def patched(text, report, path):
    return field.patched(text, report, path, _with, gazebo)
