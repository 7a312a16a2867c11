"""An SDF file: masses of links, damping and friction of joints, friction of collisions, and Gazebo's differential drive."""

from . import field, gazebo, markup

JOINT = {"damping": "damping", "friction": "friction", "frictionloss": "friction"}  # as MuJoCo calls it, too
COLLISIONS = ("collision", "geom")
SURFACE = ("surface", "friction", "ode")


def _with_mass(text, link, wanted, path):
    """Its inertia grows with it."""
    mass, inertia = field.masses(link, wanted, path)
    times = wanted.value / markup.content(text, mass, path)
    for element in sorted([mass, *inertia.children], key=lambda element: -element.start):
        text = text[: element.opened] + markup.number(times * markup.content(text, element, path)) + text[element.closed :]
    return text


def _with_joint(text, joint, wanted):
    return markup.with_content(text, joint, ("axis", "dynamics", JOINT[wanted.what]), markup.number(wanted.value))


def _with_surface(text, collisions, wanted, path):
    for collision in reversed(collisions):
        for mu in ("mu", "mu2"):
            text = markup.with_content(text, markup.at(text, collision.start, path), (*SURFACE, mu), markup.number(wanted.value))
    return text


def _with(text, wanted, name, path):
    """With one element's parameter; a link's friction is that of all its collisions."""
    named = lambda kind: field.named(markup.read(text, path).all(kind), name, kind, path)  # noqa: E731
    if wanted.kind in field.LINKS and wanted.what == "mass":
        return _with_mass(text, named("link"), wanted, path)
    if wanted.kind == "joint" and wanted.what in JOINT:
        return _with_joint(text, named("joint"), wanted)
    if wanted.kind in (*field.LINKS, *COLLISIONS) and wanted.what == "friction":
        return _with_surface(
            text, [named("collision")] if wanted.kind in COLLISIONS else list(named("link").all("collision")), wanted, path
        )
    return field.refuse(wanted, path, "SDF")


def patched(text, report, path):
    return field.patched(text, report, path, _with, gazebo)
