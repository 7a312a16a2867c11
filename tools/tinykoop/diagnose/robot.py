"""What the diagnoser is told of a user's robot: which columns its log has, and what simulates it.

A robot is data; what it does is left to its simulator.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..plumbing.errors import UserError


class RunsAway(UserError):
    """A simulator does not stay near the log, or cannot take a step at all."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect: refused outside low..high; `usual` is that of a robot that has the effect."""

    name: str
    unit: str
    low: float
    high: float
    usual: float


@dataclass(frozen=True)
class Signal:
    """A state, command or output; `column` of the log in `column_unit`, or None where no column measures it."""

    name: str
    unit: str
    column: str | None = None
    scale: float = 1.0  # from the column's unit to `unit`
    wraps: bool = False  # an angle that jumps by a turn
    measures: str | None = None  # an output: the state or command that it measures


@dataclass(frozen=True)
class Inner:
    """A parameter of the simulator that may be wrong: its value there, and in which range the true one is."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    usual: float  # of the difference
    field: str = ""  # where a model keeps it


class Simulator(Protocol):
    """The user's model: any number of rows at once, each from any state.

    One that takes steps of its own within a row may have finer(times): the same with steps so much shorter. One that forces can act
    on has `velocities`, the indices of states that they accelerate, `moved`, of those that each of these moves, and a last argument of
    step: what is added to rates (B, n), or None.
    """

    def step(self, x, u, dt, params):
        """States (B, n) one step of `dt` seconds after x (B, n), under commands u (B, m) and parameters (p,)."""


@dataclass(frozen=True)
class Gap:
    """What is reported of predictions: the norm over some states."""

    name: str
    unit: str
    states: tuple[str, ...]


@dataclass(frozen=True)
class Robot:
    name: str
    time: Signal
    states: tuple[Signal, ...]
    commands: tuple[Signal, ...]
    simulator: Simulator = field(compare=False)
    outputs: tuple[Signal, ...] = ()
    parameters: tuple[Inner, ...] = ()
    gaps: tuple[Gap, ...] = ()
    use: tuple[str, ...] = ()  # kinds of effects; none named: all
    own: tuple = ()  # effects of the user's own
    file: str = "the robot's file"  # where it is described
    acting: tuple = ()  # (name, {parameter: value}) of effects that belong to the simulator

    @property
    def nominal(self):
        """Parameters (p,) of the simulator as it is."""
        return np.array([p.value for p in self.parameters])

    @property
    def measured(self):
        """Indices of the states that the log has."""
        return [i for i, signal in enumerate(self.states) if signal.column]

    @property
    def channels(self):
        """What is compared: measured states, then outputs."""
        return tuple(self.states[i] for i in self.measured) + self.outputs

    def sense(self, x, u):
        """Channels (.., c) of states x (.., n) under commands u (.., m)."""
        names = [s.name for s in self.states], [s.name for s in self.commands]
        parts = [x[..., i] for i in self.measured]
        for output in self.outputs:
            parts.append(
                x[..., names[0].index(output.measures)] if output.measures in names[0] else u[..., names[1].index(output.measures)]
            )
        return np.stack(parts, -1)


@dataclass
class Work:
    """Rows that a simulator was asked for."""

    rows: int = 0


@dataclass(frozen=True)
class RobotLog:
    """A log in the robot's own units; NaN where a value is missing. What is made of one by replace() shares its work."""

    t: np.ndarray  # (K,)
    x: np.ndarray  # (K, n) measured states; hidden ones are NaN
    u: np.ndarray  # (K, m)
    y: np.ndarray  # (K, c) channels
    usable: np.ndarray  # (K - 1,) transitions
    dt: float
    path: str = "the log"
    work: Work = field(default_factory=Work, compare=False)

    @property
    def passes(self):
        """How often all rows were simulated so far, for whatever question."""
        return self.work.rows / (len(self.t) - 1)


def check_effects(without, effects):
    """Refuses what is to be left out of a robot's effects and is none of them."""
    for name in without:
        if name not in effects:
            raise UserError(f"--without '{name}': there is no such effect; there are {', '.join(effects)}")
