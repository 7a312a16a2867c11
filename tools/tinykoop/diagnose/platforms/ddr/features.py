"""A drive without physics: velocity errors of the body as plain functions of command, heading, time and place.

They answer what no list of effects can: on what that depends which no effect explains.
"""

import numpy as np
from scipy import ndimage

from ....bridge import followers

SMOOTH = 25  # rows
SHIFTS = (1, -1, -2, -4)  # rows: what answers a command too early, or late as no lag does
LARGE, LATE = (0.5, 0.8), 1.0  # quantiles of what is large; s, by which actuators may follow it late
HALF_TRACK = 1.0  # of the wheels, in units of the usual speed over the usual yaw rate
BLOCKS = 6  # of time, for errors that come and go
WARMS = (5.0, 20.0)  # s, over which motors and brakes remember how they were used
REVERSED = (0.4, 1.0)  # s, for which a reversal may be felt
SWINGS, DAMPING = tuple(np.geomspace(0.4, 1.6, 6)), 0.12  # Hz, of loads and masts; damping ratio, so that two neighbours overlap
WHEELS = (0.04, 1.0)  # m, radii of wheels
SPOT, FARTHEST = 0.01, 5e4  # m of the way: that count as one place; beyond which commands are in another unit
PEAKS = 3  # radii that are tried
CELLS, REACH = 6, 2.0  # of a map, per axis; standard deviations of the place, that it reaches to


def _after(u, seconds, dt):
    """What a first-order lag is behind the command."""
    keep = np.exp(-dt / seconds)
    return followers.pole(np.append(u[:1], (1 - keep) * u[:-1]), keep).real - u


def _shifted(c, rows):
    """A command so many rows later, or earlier if negative."""
    return np.concatenate([c[rows:], np.full(rows, c[-1])]) if rows > 0 else np.concatenate([np.full(-rows, c[0]), c[:rows]])


def _past(c, seconds, dt):
    """Mean square of a command (K,) in so many seconds before."""
    keep = np.exp(-dt / seconds)
    return followers.pole((1 - keep) * c**2, keep).real


def _felt(c, seconds, dt):
    """+-1 when a command changes its sign, and what is felt of that later."""
    turns = np.diff(np.sign(c), prepend=np.sign(c[0])) / 2
    return followers.pole(turns, np.exp(-dt / seconds)).real


def _swing(c, frequency, dt):
    """Swing and rate of a damped pendulum that changes of a command (K,) push, (K, 2)."""
    pole = np.exp((-DAMPING + 1j * np.sqrt(1 - DAMPING**2)) * 2 * np.pi * frequency * dt)
    swing = followers.pole(np.diff(c, prepend=c[0]), pole)
    return np.stack([swing.imag, swing.real], 1)


def remembered(u, dt):
    """{name: (values (K), channels)} of what a robot remembers of its commands: heat, reversals, loads that swing."""
    table = {}
    for title, c, on in (("v", u[:, 0], 0), ("omega", u[:, 1], 2)):
        scale = np.std(c) + 1e-9
        for seconds in WARMS:
            table[f"use of {title} in the past: {seconds:g} s"] = (_past(c / scale, seconds, dt) * c / scale, (on,))
        for seconds in REVERSED:
            table[f"reversals of {title}: {seconds:g} s"] = (_felt(c, seconds, dt), (on, 2))
        for frequency in SWINGS:
            for part, values in zip(("swing", "rate"), _swing(c / scale, frequency, dt).T):
                table[f"swings of {frequency:.2g} Hz after changes of {title}: {part}"] = (values, (on,))
    return table


def _map(place, a):
    """Bumps on a grid of the place (K, 2), times the speed."""
    centres = np.linspace(-REACH, REACH, CELLS)
    x, y = (np.exp(-0.5 * ((axis[:, None] - centres) / (centres[1] - centres[0])) ** 2) for axis in place.T)
    return {f"place: v, {i}, {j}": (x[:, i] * y[:, j] * a, (0,)) for i in range(CELLS) for j in range(CELLS)}


def _turning(way, a, left):
    """Waves of the way (K,) that wheels which are not round make, of the radii that show most in what is left (K, 3)."""
    table = {}
    if not way[-1] - way[0] < FARTHEST:
        return table
    spots = ((way - way[0]) / SPOT).astype(int)
    count = 2 * (spots[-1] + 1)  # twice as many as there are, so that no wave falls between two that are tried
    paces = 2 * np.pi * np.arange(count // 2 + 1) / (count * SPOT)
    of_wheels = (paces > 1 / WHEELS[1]) & (paces < 1 / WHEELS[0])
    for title, axis in (("speed", 0), ("turn", 2)):
        shown = np.abs(np.fft.rfft(np.bincount(spots, left[:, axis] * a), count)) * of_wheels
        for k in sorted(_peaks(shown), key=lambda k: -shown[k])[:PEAKS]:
            for part, wave in (("sine", np.sin(paces[k] * way)), ("cosine", np.cos(paces[k] * way))):
                table[f"angle of a wheel of {1 / paces[k]:.2f} m radius: {title}, {part}"] = (a * wave, (axis,))
    return table


def _peaks(values):
    """Indices of values that are greater than their neighbours."""
    padded = np.concatenate([[0.0], values, [0.0]])
    return np.flatnonzero((values > padded[:-2]) & (values > padded[2:]))


def functions(u, rows, pose, dt, left):
    """{name: (values (K), channels it acts on)}; names group by what the error depends on.

    u: commands of the whole log; rows, pose, left (K, 3): the rows that are looked at, their poses and what the causes leave there.
    """
    later = {title: (values[rows], on) for title, (values, on) in remembered(u, dt).items()}
    step = np.abs(u[:, 0]) * dt
    way, u = (np.cumsum(step) - step / 2)[rows], u[rows]
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
        table[f"change of v, {seconds:.2g} s"] = (_after(a, seconds, dt), (0, 2))
        table[f"change of omega, {seconds:.2g} s"] = (_after(b, seconds, dt), every)
    for rows in SHIFTS:
        for title, c in (("v", a), ("omega", b)):
            table[f"change of {title}, {rows:+d} rows"] = (_shifted(c, rows) - c, every)
    for title, c in (("v", a), ("omega", b), ("left wheel", a - HALF_TRACK * b), ("right wheel", a + HALF_TRACK * b)):
        for part in LARGE:
            over = np.sign(c) * np.maximum(np.abs(c) - np.quantile(np.abs(c), part), 0)
            table[f"large {title}, over {part:g}"] = (over, (0, 2))
            table[f"large {title}, over {part:g}, late"] = (over + _after(over, LATE, dt), (0, 2))
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
    far = np.hypot(*(pose[:, :2] - pose[0, :2]).T)
    table["distance from the start: v"] = (far / (far.std() + 1e-9) * a, (0,))
    table["distance from the start: near v"] = (far / (far + np.median(far) + 1e-9) * a, (0,))
    table["angle turned through: v"] = ((theta - theta[0]) * a, (1,))
    place = pose[:, :2] - pose[:, :2].mean(0)
    place = place / (place.std() + 1e-9)
    for axis, name in enumerate("xy"):
        table[f"place v {name}"] = (place[:, axis] * a, (0, 1))
        table[f"place omega {name}"] = (place[:, axis] * b, (2,))
    return table | _map(place, a) | later | _turning(way, a, left)


def dependence(name):
    """The group a feature's name belongs to, for words: what stands before a colon, or what its first word means."""
    if ":" in name:
        return name.split(":")[0]
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
