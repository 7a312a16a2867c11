"""What the logs are made of: tiers, magnitudes, noise, and the truth that is sealed.

Magnitudes are 0.6 to 2 times those of host_sim's `usual`; dead bands, saturations and quantisation are drawn from the
drive's own commands, so that it reaches them. Effects take turns, so that each comes up equally often. A log is drawn
again until every one of its effects, by itself, opens a gap of at least twice the noise floor at 50 steps, on the log
and on the fresh log (noise-free, against the nominal simulator, within the span in which it acts). Only `poor` (no
such demand) and the healthy robots are exempt.

The fresh log is another drive of the same robot in the same noise, on a clock of its own: an effect that switches acts
there throughout.
"""

from dataclasses import asdict, replace

import numpy as np

from .. import bridge
from ..experiments import scenario
from . import drives, plant
from .plant import Cause

HORIZONS = (1, 10, 50)
EXACT = ("speed_gain", "yaw_gain", "clock_scale")  # any two of them make the third
VOCABULARY = tuple(plant.PLAIN)
UNSEEN = tuple(plant.NEVER)
SIGNED = ("speed_gain", "yaw_gain", "wheel_asymmetry", "yaw_bias", "lateral_skid", "world_drift", "sensor_lever_arm",
          "heading_bias", "clock_scale")  # fmt: skip

TIERS = {
    "single": "one effect of the vocabulary",
    "single_other": "one effect, in another form than the library's",
    "none_white": "healthy robot, white noise",
    "none_coloured": "healthy robot, coloured noise",
    "none_heavy": "healthy robot, heavy-tailed noise with outliers",
    "none_small": "healthy robot, a gap too small to matter",
    "pair": "two effects",
    "triple": "three effects",
    "switch": "one effect during a part of the log",
    "five_phase": "slip and friction in the paper's five phases",
    "left_out": "one effect, taken out of the library",
    "never": "an effect that is in no library",
    "poor": "one effect, short and poorly exciting drive",
}


# ---- effects -----------------------------------------------------------------------------------


def _usual(name):
    return {row[0]: row[4] for row in bridge.effects()[name][1]}


def _threshold(random, commands, low, high):
    """A value between the sizes of the commands that were given, below the largest."""
    sizes = np.abs(commands[np.abs(commands) > 1e-9])
    return float(min(np.quantile(sizes, random.uniform(low, high)), sizes.max() * random.uniform(0.7, 0.95)))


def known(random, name, u):
    """Parameters of an effect of the vocabulary, for commands u."""
    if name in ("dead_band", "saturation"):
        span = (0.15, 0.4) if name == "dead_band" else (0.5, 0.8)
        return {key: _threshold(random, column, *span) for key, column in zip(_usual(name), u.T)}
    p = {key: value * random.uniform(0.6, 2) for key, value in _usual(name).items()}
    if name in SIGNED:
        p = {key: value * random.choice((-1, 1)) for key, value in p.items()}
    if name == "pacejka_slip":
        p["C"], p["E"] = random.uniform(1.2, 1.9), random.uniform(-0.5, 0.6)
    if name == "stribeck_friction":
        p["Fs"] = min(max(p["Fs"], p["Fc"] + 0.1), 0.7)
    return {key: float(value) for key, value in p.items()}


def unseen(random, name, u, duration):
    """Parameters of an effect in no library."""
    size, sign, angle = random.uniform(0.6, 2), random.choice((-1, 1)), random.uniform(0, 2 * np.pi)
    p = {
        "slew_limit": lambda: {"dv": 0.8 / size, "dw": 0.6 / size},
        "command_quantisation": lambda: {"qv": 0.35 * size, "qw": 0.25 * size},
        "warm_up": lambda: {"loss": 0.2 * size, "tau": 0.2 * duration},
        "payload_swing": lambda: {"share": 0.25 * size, "frequency": random.uniform(0.5, 1.2), "damping": 0.08},
        "understeer": lambda: {"K": 0.08 * size},
        "turn_asymmetry": lambda: {"e": 0.12 * size * sign},
        "wheel_eccentricity": lambda: {"size": 0.12 * size, "radius": random.uniform(0.2, 0.4), "phase": angle},
        "camber": lambda: {"k": 0.04 * size * sign},
        "slope": lambda: {"pull": 0.08 * size, "downhill": angle},
        "terrain": lambda: {"loss": min(0.25 * size, 0.45), "patch": random.uniform(0.8, 2), "phase": angle},
        "gusts": lambda: {"size": 0.07 * size, "tau": random.uniform(2, 6)},
        "heading_scale": lambda: {"e": 0.05 * size * sign},
    }[name]()
    return {key: float(value) for key, value in p.items()}


def members(tier, seed, k):
    """The effects of log k of a tier; they take turns."""
    shuffled = np.random.default_rng([seed, list(TIERS).index(tier)]).permutation
    if tier == "never":
        return [str(shuffled(UNSEEN)[k % len(UNSEEN)])]
    deck = [str(name) for name in shuffled(VOCABULARY)]
    chosen, shift = [deck[k % len(deck)]], k // len(deck)
    while len(chosen) < {"pair": 2, "triple": 3}.get(tier, 1):
        shift += 1
        name = deck[(k + shift) % len(deck)]
        # with two of the three that are one another's alias the set is not defined
        if name not in chosen and len({name, *chosen} & set(EXACT)) < 2:
            chosen.append(name)
    return chosen


def _phases(random, duration):
    """Nominal, slip, friction, both, nominal."""
    slip, friction = (known(random, name, np.zeros((0, 2))) for name in ("pacejka_slip", "stribeck_friction"))
    edges = [float(duration * i / 5) for i in range(6)]
    return [
        Cause("pacejka_slip", slip, "plain", edges[1], edges[2]),
        Cause("stribeck_friction", friction, "plain", edges[2], edges[4]),
        Cause("pacejka_slip", slip, "plain", edges[3], edges[4]),
    ]


def causes(random, tier, seed, k, u, dt):
    """The effects that act on log k under commands u."""
    duration = (len(u) - 1) * dt
    if tier == "none_small":
        small = (("heading_bias", {"delta": 1.5e-3}), ("speed_gain", {"a": 1e-3}), ("yaw_gain", {"b": -1e-3}))
        return [Cause(*small[k % 3])]
    if tier.startswith("none"):
        return []
    if tier == "five_phase":
        return _phases(random, duration)
    names = members(tier, seed, k)
    if tier == "never":
        return [Cause(names[0], unseen(random, names[0], u, duration), "never")]
    span = (0.0, float("inf"))
    if tier == "switch":
        begin = dt * round(random.uniform(0.2, 0.45) * duration / dt)
        span = (begin, begin + dt * round(random.uniform(0.25, 0.4) * duration / dt))
    shape = "other" if tier == "single_other" else "plain"
    return [Cause(name, known(random, name, u), shape, *span) for name in names]


def _along(acting, duration):
    """The causes on the fresh log, s: each once, throughout; what a battery loses goes with time."""
    there, most = {}, bridge.effects()["battery_sag"][1][0][3]
    for c in acting:
        parameters = dict(c.parameters)
        if c.name == "battery_sag":
            faster = duration / (min(c.t1, duration) - c.t0)
            parameters["loss_at_end"] = min(parameters["loss_at_end"] * faster, most)
        there[c.name] = replace(c, parameters=parameters, t0=0.0, t1=float("inf"))
    return list(there.values())


# ---- gap and floor ---------------------------------------------------------------------------------


def gap(x, u, dt, span=(0.0, np.inf), active=(), usable=None):
    """{horizon: RMS position error (m)} of the simulator with `active`, over windows that lie in the span."""
    out = {}
    for steps in HORIZONS:
        first = int(np.ceil(span[0] / dt - 1e-6))
        last = min(len(x) - 1, int(np.floor(span[1] / dt + 1e-6))) if np.isfinite(span[1]) else len(x) - 1
        starts = np.arange(first, last - steps + 1)
        if len(starts) == 0:
            return dict.fromkeys(map(str, HORIZONS), np.nan)
        residual = bridge.windows(x, u, dt, starts, (steps,), active, usable, bridge.ARC)[1][:, 0, :2]
        out[str(steps)] = float(np.sqrt(np.nanmean(np.sum(residual**2, axis=1))))
    return out


def floor(x, e):
    """The same of the true robot, restarted at poses measured with noise e (K, 3) about x."""
    z, n, turned = x[:, 0] + 1j * x[:, 1], e[:, 0] + 1j * e[:, 1], np.exp(1j * e[:, 2])
    error = {h: n[h:] - n[:-h] - (turned[:-h] - 1) * (z[h:] - z[:-h]) for h in HORIZONS}
    return {str(h): float(np.sqrt(np.mean(np.abs(error[h]) ** 2))) for h in HORIZONS}


# ---- one log ------------------------------------------------------------------------------------


def _noise(random, tier):
    kind = tier.removeprefix("none_") if tier in ("none_white", "none_coloured", "none_heavy") else None
    kind = kind or str(random.choice(("white", "coloured", "heavy"), p=(0.6, 0.2, 0.2)))
    settings = {"kind": kind, "sp": float(random.uniform(0.002, 0.01)), "st": float(random.uniform(0.002, 0.01))}
    return settings | ({"rho": float(random.uniform(0.5, 0.9))} if kind == "coloured" else {})


def _design(random, tier, k):
    """dt, rows and a function that draws a drive of this kind."""
    if tier == "five_phase" and k % 2 == 0:
        rows = scenario.STEPS + 1

        def paper(random):
            u = scenario.commands(rows)
            ahead = random.integers(0, 1000)  # the fresh log is a later part of it, in other phases
            return np.roll(u, -ahead, axis=0), ["paper"]

        return scenario.DT, rows, paper
    dt = float(random.choice((0.05, 0.02, 0.1), p=(0.7, 0.15, 0.15)))
    if tier == "poor":
        rows = int(random.integers(300, 601))
        return dt, rows, lambda random: drives.poor(random, rows, dt)
    rows = 2501 if tier == "five_phase" else int(random.integers(1600, 2401))
    return dt, rows, lambda random: drives.rich(random, rows, dt)


def _recording(random, u, dt, acting, noise):
    """What one drive of the robot gives: rows of the log, its noise-free path, its floor."""
    x0 = random.uniform((-5, -5, -np.pi), (5, 5, np.pi))
    x = plant.simulate(u[:-1], dt, acting, x0, random)
    e = plant.noise(random, rows=len(x), **noise)
    return {"x": x, "u": u, "e": e, "floor": floor(x, e), "x0": x0}


def _visible(recording, dt, acting, random):
    """Whether each effect by itself opens twice the floor."""
    return all(
        gap(plant.simulate(recording["u"][:-1], dt, [c], recording["x0"], random), recording["u"], dt,
            (c.t0, c.t1))["50"] >= 2 * recording["floor"]["50"]
        for c in acting
    )  # fmt: skip


def draw(tier, seed, k):
    """Log k of a tier: its label, and (poses, commands) as measured, of the log and of the fresh one."""
    random = np.random.default_rng([seed, list(TIERS).index(tier), k])
    for attempt in range(1000):
        dt, rows, drive = _design(random, tier, k)
        noise = _noise(random, tier)
        (u, drive_of), (fresh_u, _) = drive(random), drive(random)
        acting = causes(random, tier, seed, k, u, dt)
        there = _along(acting, (rows - 1) * dt)
        log, fresh = _recording(random, u, dt, acting, noise), _recording(random, fresh_u, dt, there, noise)
        if tier == "poor" or tier.startswith("none") or (_visible(log, dt, acting, random) and _visible(fresh, dt, there, random)):
            break
    else:
        raise RuntimeError(f"{tier} {k}: no drive in {attempt + 1} shows {[c.name for c in acting]}")
    truth = [] if tier.startswith("none") else sorted({c.name for c in acting})
    label = {
        "tier": tier, "truth": truth, "without": truth if tier == "left_out" else [],
        "alias": tier == "left_out" and truth[0] in EXACT,
        "causes": [asdict(c) | {"t1": min(c.t1, (rows - 1) * dt)} for c in acting],
        "dt": dt, "rows": rows, "noise": noise, "drive": drive_of, "drawn_again": attempt,
        "gap": gap(log["x"], u, dt), "floor": log["floor"],
        "fresh": {"gap": gap(fresh["x"], fresh_u, dt), "floor": fresh["floor"]},
    }  # fmt: skip
    wrapped = bool(random.integers(2))
    return label, *(_measured(r, wrapped) for r in (log, fresh))


def _measured(recording, wrapped):
    x = recording["x"] + recording["e"]
    if wrapped:
        x[:, 2] = np.angle(np.exp(1j * x[:, 2]))
    return x, recording["u"]
