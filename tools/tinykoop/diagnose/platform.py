"""What the diagnoser must know of a robot: its nominal model, the effects that may act on it, drives to advise.

What comes with TinyKoop is described here; a robot of one's own is a file: docs/own-robot.md.
"""

from dataclasses import dataclass

import numpy as np

from .. import bridge
from .robot import Parameter


@dataclass(frozen=True)
class Integrator:
    """One way to turn the nominal velocities into a pose; a choice without a parameter."""

    name: str
    code: int
    skid: float  # lateral_skid, in steps of time, that it looks like beside the first one


class Ddr:
    """The differential-drive robot of host_sim/: pose (px, py, theta), commands (v, omega)."""

    name = "ddr"
    # A real robot moves in continuous time: where nothing speaks against it, that is assumed.
    integrators = (
        Integrator("exact arc", bridge.ARC, 0.0),
        Integrator("Euler steps", bridge.EULER, -0.5),
        Integrator("semi-implicit Euler steps", bridge.SEMI_IMPLICIT, 0.5),
    )
    command_names = ("v", "omega")
    # What together looks like something that is no effect here: then they are never sure.
    lookalikes = {frozenset(("actuator_lag", "transport_delay")): "actuators of second order"}
    curves = ("pacejka_slip", "stribeck_friction")
    # Noise is measured, not fitted: windows() cannot undo it at the start of a piece.
    not_fitted = ("measurement_noise",)

    def effects(self):
        """{name: (block, (Parameter, ..))} in the order of action."""
        return {
            name: (block, tuple(Parameter(*row) for row in rows))
            for name, (block, rows) in bridge.effects().items()
            if name not in self.not_fitted
        }

    def commands(self, u):
        """Speed (m/s) and yaw rate (rad/s) that the nominal model makes of the log's commands u (K, 2)."""
        return np.asarray(u, float)

    def rollouts(self, x, u, dt, starts, steps, usable, integrator):
        """As bridge.Rollouts."""
        return bridge.Rollouts(x, self.commands(u), dt, starts, steps, usable, integrator.code)

    def simulate(self, u, dt, active, integrator):
        """Poses (K + 1, 3) of a drive from (0, 0, 0)."""
        return bridge.simulate(self.commands(u), dt, active=active, integrator=integrator.code)


PLATFORMS = {"ddr": Ddr}
