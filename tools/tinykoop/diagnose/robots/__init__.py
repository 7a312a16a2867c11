"""Robots: those of TOML files, of Python files, and those that come with TinyKoop."""

from ... import platforms


def is_own(robot):
    """Whether a robot is your own file, and not a platform; refuses what is neither."""
    if robot.endswith(".toml"):
        return True
    platforms.check(robot, "the TOML file of a robot of your own (docs/own-robot.md)")
    return False
