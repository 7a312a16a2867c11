"""Robots: those of TOML files, of Python files, and those that come with TinyKoop."""

from ... import platforms


def is_own(robot):
    """Whether a robot is your own file, and not a platform; refuses what is neither."""
    if robot.endswith(".toml") and not robot.startswith(VEHICLE):
        return True
    platforms.check(platform_of(robot), "the TOML file of a robot of your own (docs/own-robot.md)")
    return False


def platform_of(robot):
    """The platform of a robot that is not your own file: quadrotor of quadrotor:iris."""
    return "quadrotor" if robot.startswith(VEHICLE) else robot


def vehicle_of(robot):
    """The vehicle of quadrotor:VEHICLE, by default a Crazyflie."""
    return robot.removeprefix(VEHICLE) if robot.startswith(VEHICLE) else "crazyflie"


VEHICLE = "quadrotor:"
