"""A drive without physics: velocity errors of the body as plain functions of command, heading, time and place.

They answer what no list of effects can: on what that depends which no effect explains.
"""

import numpy as np
from scipy import linalg, ndimage

SMOOTH = 25  # rows
SHIFTS = (1, -1, -2, -4)  # rows: what answers a command too early, or late as no lag does
LARGE, LATE = (0.5, 0.8), 1.0  # quantiles of what is large; s, by which actuators may follow it late
HALF_TRACK = 1.0  # of the wheels, in units of the usual speed over the usual yaw rate
BLOCKS = 6  # of time, for errors that come and go


def _after(u, seconds, dt):
    """What a first-order lag is behind the command."""
    keep = np.exp(-dt / seconds)
    recursion = np.stack([np.ones(len(u)), np.full(len(u), -keep)])
    return linalg.solve_banded((1, 0), recursion, np.vstack([u[:1], (1 - keep) * u[:-1]])) - u


def _shifted(c, rows):
    """A command so many rows later, or earlier if negative."""
    return np.concatenate([c[rows:], np.full(rows, c[-1])]) if rows > 0 else np.concatenate([np.full(-rows, c[0]), c[:rows]])


def functions(u, pose, dt):
    """{name: (values (K), channels it acts on)}; names group by what the error depends on."""
    v, w = u.T
    K = len(u)
    t = np.linspace(-1, 1, K)
    one = np.ones(K)
    v_s, w_s = np.std(v) + np.abs(v).mean() + 1e-9, np.std(w) + np.abs(w).mean() + 1e-9
    a, b = v / v_s, w / w_s
    every = (0, 1, 2)
    # smooth: a feature must not carry the noise from which it must be distinguished
    pose = ndimage.uniform_filter1d(np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])]), SMOOTH, axis=0)
    theta = pose[:, 2]
    # in the order in which a short log can afford them
    table = {"constant": (one, every), "v": (a, every), "omega": (b, every), "v omega": (a * b, every)}
    table |= {"heading, sine": (np.sin(theta), every), "heading, cosine": (np.cos(theta), every)}
    for seconds in (0.3, 2 * dt, 1.0):
        behind = _after(np.stack([a, b], 1), seconds, dt)
        table[f"change of v, {seconds:.2g} s"] = (behind[:, 0], (0, 2))
        table[f"change of omega, {seconds:.2g} s"] = (behind[:, 1], every)
    for rows in SHIFTS:
        for title, c in (("v", a), ("omega", b)):
            table[f"change of {title}, {rows:+d} rows"] = (_shifted(c, rows) - c, every)
    for title, c in (("v", a), ("omega", b), ("left wheel", a - HALF_TRACK * b), ("right wheel", a + HALF_TRACK * b)):
        for part in LARGE:
            over = np.sign(c) * np.maximum(np.abs(c) - np.quantile(np.abs(c), part), 0)
            table[f"large {title}, over {part:g}"] = (over, (0, 2))
            table[f"large {title}, over {part:g}, late"] = (over + _after(over[:, None], LATE, dt)[:, 0], (0, 2))
    table |= {"v^2": (a * np.abs(a), every), "omega^2": (b * np.abs(b), every)}
    table |= {"time": (t, every), "time v": (t * a, every), "time omega": (t * b, every)}
    table |= {"|v|": (np.abs(a), every), "|omega|": (np.abs(b), every), "v |omega|": (a * np.abs(b), every)}
    table |= {"v^3": (a**3, (0, 2)), "omega^3": (b**3, (0, 2))}
    table |= {"v omega^2": (a * b * b, (0, 1)), "v^2 omega": (a * a * b, (1, 2))}
    for name, c in (("v", a), ("omega", b)):
        small = np.abs(c) < 0.5 * np.median(np.abs(c)) + 1e-9
        table[f"small {name}"] = (c * small, (0, 2))
        table[f"sign of {name}"] = (np.sign(c), (0, 2))
    for i in range(BLOCKS - 1):
        inside = ((t + 1) / 2 * BLOCKS).astype(int) == i
        table[f"block v {i}"] = (inside * a, (0, 1))
        table[f"block omega {i}"] = (inside * b, (1, 2))
    place = pose[:, :2] - pose[:, :2].mean(0)
    place = place / (place.std() + 1e-9)
    for axis, name in enumerate("xy"):
        table[f"place v {name}"] = (place[:, axis] * a, (0, 1))
        table[f"place omega {name}"] = (place[:, axis] * b, (2,))
    return table


def dependence(name):
    """The group a feature's name belongs to, for words."""
    for word in ("change", "heading", "time", "block", "place", "small", "sign", "large"):
        if name.startswith(word):
            return {
                "block": "time",
                "small": "small commands",
                "sign": "sign of the command",
                "large": "large commands",
                "change": "changes of the command",
            }.get(word, word)
    return name
