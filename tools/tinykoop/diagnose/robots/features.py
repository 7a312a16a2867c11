"""Functions of a robot's states and commands, scaled to size one, on which an unknown effect may depend."""

import numpy as np


def functions(robot, x, u, x_reach, u_reach):
    """[(what it is of, values (K,))]."""
    named = [("constant", np.ones(len(x)))]
    angles = [i for i, s in enumerate(robot.states) if s.wraps]
    signals = [(s.name, x[:, i] / x_reach[i]) for i, s in enumerate(robot.states) if i not in angles]
    signals += [(s.name, u[:, j] / u_reach[j]) for j, s in enumerate(robot.commands)]
    for i in angles:
        named += [(f"sin {robot.states[i].name}", np.sin(x[:, i])), (f"cos {robot.states[i].name}", np.cos(x[:, i]))]
    for name, v in signals:
        named += [(name, v), (f"{name} |{name}|", v * np.abs(v)), (f"sign of {name}", np.tanh(v / 0.1))]
    for a, (one, v) in enumerate(signals):
        named += [(f"{one} {two}", v * w) for two, w in signals[a + 1 :]]
    return named
