"""The quadrotor of host_sim/: the simulated one is held to a flight by an observer (vehicle)."""

from ....plumbing.errors import UserError


def read(path, *_):
    """Refuses: what an observer misses is not yet explained."""
    raise UserError(f"{path}: a quadrotor's log cannot be diagnosed yet; give one of a ddr or fwmav")
