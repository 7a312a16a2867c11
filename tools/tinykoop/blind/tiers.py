"""What the logs are made of: tiers, magnitudes, noise, and the truth that is sealed.

Magnitudes are 0.6 to 2 times those of host_sim's `usual`; dead bands, saturations and quantisation are drawn from the
drive's own commands, so that it reaches them. Effects take turns, so that each comes up equally often. A log is drawn
again until every one of its effects, by itself, opens a gap of at least twice the noise floor at 50 steps, on the log
and on the fresh log (noise-free, against the nominal simulator, within the span in which it acts). Only `poor` (no
such demand) and the healthy robots are exempt. The floor of a robot that slips at random includes that motion.

The fresh log is another drive of the same robot in the same noise, on a clock of its own: an effect that switches acts
there throughout.
"""

from dataclasses import asdict, replace

import numpy as np

from .. import bridge
from ..experiments import scenario
from . import drives, odometry, plant
from .plant import Cause

HORIZONS = (1, 10, 50)
EXACT = ("speed_gain", "yaw_gain", "clock_scale")  # any two of them make the third
# what the library can name; of a robot without traction the pose shows nothing else, so it has no part in the decks
VOCABULARY = tuple(name for name in plant.PLAIN if name in bridge.effects() and name != "no_traction")
UNSEEN = tuple(plant.NEVER)
# of the effects that were added to the vocabulary later; limits and dead bands come from the commands
TYPICAL = {"speed_lag": {"tau": 0.3}, "yaw_lag": {"tau": 0.3}, "acceleration_limit": {"a": 0.8, "alpha": 0.6}, "no_traction": {}}
SIGNED = ("speed_gain", "yaw_gain", "wheel_asymmetry", "yaw_bias", "lateral_skid", "world_drift", "sensor_lever_arm",
          "heading_bias", "clock_scale")  # fmt: skip

# a tier's place is part of its seed: new ones come last
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
    "lags": "speed, turn or both lag, or a lag and a gain",
    "none_slip": "healthy robot that slips at random by 1 to 10 %",
    "slipping": "one effect of a robot that slips at random by 1 to 5 %",
    "odometry": "one effect, in a log with wheel odometry and gyro",
}


# ---- effects -----------------------------------------------------------------------------------


def _usual(name):
    return TYPICAL[name] if name in TYPICAL else {row[0]: row[4] for row in bridge.effects()[name][1]}


def _threshold(random, commands, low, high):
    """A value between the sizes of the commands that were given, below the largest."""
    sizes = np.abs(commands[np.abs(commands) > 1e-9])
    return float(min(np.quantile(sizes, random.uniform(low, high)), sizes.max() * random.uniform(0.7, 0.95)))


def _of_axes(names, low, high):
    return lambda random, u: {name: _threshold(random, column, low, high) for name, column in zip(names, u.T)}


def _of_wheels(name, low, high):
    """Of the speeds at the rims, with a track width."""

    def draw(random, u):
        track = float(random.uniform(0.4, 0.7))
        rims = u[:, :1] + np.array([-1, 1]) * u[:, 1:] * track / 2
        return {name: _threshold(random, rims, low, high), "track": track}

    return draw


THRESHOLDS = {
    "dead_band": _of_axes(("v_db", "w_db"), 0.15, 0.4),
    "saturation": _of_axes(("v_max", "w_max"), 0.5, 0.8),
    "wheel_dead_band": _of_wheels("v_db", 0.15, 0.4),
    "wheel_saturation": _of_wheels("v_max", 0.5, 0.8),
}


def known(random, name, u):
    """Parameters of an effect of the vocabulary, for commands u."""
    if name in THRESHOLDS:
        return THRESHOLDS[name](random, u)
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
        "command_quantisation": lambda: {"qv": 0.35 * size, "qw": 0.25 * size},
        "warm_up": lambda: {"loss": 0.2 * size, "tau": 0.2 * duration},
        "payload_swing": lambda: {"share": 0.25 * size, "frequency": random.uniform(0.5, 1.2), "damping": 0.08},
        "turn_asymmetry": lambda: {"e": 0.12 * size * sign},
        "wheel_eccentricity": lambda: {"size": 0.12 * size, "radius": random.uniform(0.2, 0.4), "phase": angle},
        "camber": lambda: {"k": 0.04 * size * sign},
        "slope": lambda: {"pull": 0.08 * size, "downhill": angle},
        "terrain": lambda: {"loss": min(0.25 * size, 0.45), "patch": random.uniform(0.8, 2), "phase": angle},
        "tether": lambda: {"loss": min(0.25 * size, 0.45), "slack": random.uniform(3, 8)},
        "heat": lambda: {"loss": 0.15 * size, "tau": random.uniform(5, 20)},
        "caster_kick": lambda: {"kick": 0.25 * size * sign, "tau": random.uniform(0.4, 1)},
        "heading_scale": lambda: {"e": 0.05 * size * sign},
    }[name]()
    return {key: float(value) for key, value in p.items()}


def _other_forms(shuffled):
    """All (name, form) in an order in which no name comes again before every other one came."""
    names = [str(name) for name in shuffled(list(plant.OTHER))]
    forms = {name: [str(form) for form in shuffled(list(plant.OTHER[name]))] for name in names}
    rounds = range(max(map(len, forms.values())))
    return [(name, forms[name][i]) for i in rounds for name in names if i < len(forms[name])]


def _with_odometry(shuffled, k):
    """One effect that acts at a link of the odometry, in its plain and in another form by turns."""
    names = [str(name) for name in shuffled([name for name in (*VOCABULARY, "no_traction") if plant.link(name)])]
    lap, name = k // len(names), names[k % len(names)]
    forms = list(plant.OTHER.get(name, ()))
    other = forms and (k + lap) % 2
    return name, forms[lap // 2 % len(forms)] if other else ""


LAGS = (("speed_lag",), ("yaw_lag",), ("speed_lag", "yaw_lag"), ("actuator_lag", "speed_gain"), ("actuator_lag", "yaw_gain"))


def cast(tier, seed, k):
    """The effects of log k of a tier, (name, form) with no form if plain; they take turns."""
    shuffled = np.random.default_rng([seed, list(TIERS).index(tier)]).permutation
    if tier == "never":
        return [(str(shuffled(UNSEEN)[k % len(UNSEEN)]), "")]
    if tier == "single_other":
        forms = _other_forms(shuffled)
        return [forms[k % len(forms)]]
    if tier == "odometry":
        return [_with_odometry(shuffled, k)]
    if tier == "lags":
        return [(name, "") for name in LAGS[shuffled(len(LAGS))[k % len(LAGS)]]]
    return [(name, "") for name in _of_the_vocabulary([str(name) for name in shuffled(VOCABULARY)], tier, k)]


def _of_the_vocabulary(deck, tier, k):
    chosen, shift = [deck[k % len(deck)]], k // len(deck)
    while len(chosen) < {"pair": 2, "triple": 3}.get(tier, 1):
        shift += 1
        name = deck[(k + shift) % len(deck)]
        # with two of the three that are one another's alias, or two of one family, the set is not defined
        apart = plant.family(name) not in map(plant.family, chosen)
        if apart and len({name, *chosen} & set(EXACT)) < 2:
            chosen.append(name)
    return chosen


def members(tier, seed, k):
    return [name for name, _ in cast(tier, seed, k)]


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
    chosen = cast(tier, seed, k)
    if tier == "never":
        return [Cause(name, unseen(random, name, u, duration), "never") for name, _ in chosen]
    span = (0.0, float("inf"))
    if tier == "switch":
        begin = dt * round(random.uniform(0.2, 0.45) * duration / dt)
        span = (begin, begin + dt * round(random.uniform(0.25, 0.4) * duration / dt))
    return [Cause(name, known(random, name, u), "other" if form else "plain", *span, form) for name, form in chosen]


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


def wandering(u, dt, acting, x0, motion, random, draws=2):
    """The same of its random motion: other draws of the true robot, restarted in each window, against the robot without it."""

    def ahead(robot, h):
        z = robot.poses @ (1, 1j, 0) - robot.blown  # the wind is the same in every draw
        return (z[h:] - z[:-h]) * np.exp(-1j * robot.heading[:-h])

    steady = plant.drive(u, dt, acting, x0, random)
    shaken = [plant.drive(u, dt, acting, x0, random, motion) for _ in range(draws)]
    return {str(h): float(np.sqrt(np.mean([np.abs(ahead(robot, h) - ahead(steady, h)) ** 2 for robot in shaken]))) for h in HORIZONS}


# ---- one log ------------------------------------------------------------------------------------


def _noise(random, tier):
    kind = tier.removeprefix("none_") if tier in ("none_white", "none_coloured", "none_heavy") else None
    kind = kind or str(random.choice(("white", "coloured", "heavy"), p=(0.6, 0.2, 0.2)))
    settings = {"kind": kind, "sp": float(random.uniform(0.002, 0.01)), "st": float(random.uniform(0.002, 0.01))}
    return settings | ({"rho": float(random.uniform(0.5, 0.9))} if kind == "coloured" else {})


def _motion(random, tier, k):
    """The random slip of the wheels; None of a robot that does not slip at random."""
    if tier not in ("none_slip", "slipping"):
        return None
    size = (0.01, 0.03, 0.1)[k % 3] if tier == "none_slip" else 10 ** random.uniform(-2, np.log10(0.05))
    return {"size": float(size), "tau": float(10 ** random.uniform(-1, 0))}


def _design(random, tier, k, most):
    """dt, rows and a function that draws a drive of this kind; `most` limits the rows."""
    if tier == "five_phase" and k % 2 == 0:
        rows = min(scenario.STEPS + 1, most)

        def paper(random):
            u = scenario.commands(rows)
            ahead = random.integers(0, 1000)  # the fresh log is a later part of it, in other phases
            return np.roll(u, -ahead, axis=0), ["paper"]

        return scenario.DT, rows, paper
    dt = float(random.choice((0.05, 0.02, 0.1), p=(0.7, 0.15, 0.15)))
    if tier == "poor":
        rows = int(random.integers(300, 601))
        return dt, rows, lambda random: drives.poor(random, rows, dt)
    rows = min(2501 if tier == "five_phase" else int(random.integers(1600, 2401)), most)
    return dt, rows, lambda random: drives.rich(random, rows, dt)


def _recording(random, u, dt, acting, noise, motion, sensors):
    """What one drive of the robot gives: rows of the log, its noise-free path, its floor."""
    x0 = random.uniform((-5, -5, -np.pi), (5, 5, np.pi))
    robot = plant.drive(u[:-1], dt, acting, x0, random, motion)
    e = plant.noise(random, rows=len(robot.poses), **noise)
    least = floor(robot.poses, e)
    if motion:
        wander = wandering(u[:-1], dt, acting, x0, motion, random)
        least = {h: float(np.hypot(least[h], wander[h])) for h in least}
    columns = odometry.measured(random, robot, sensors) if sensors else None
    return {"x": robot.poses, "u": u, "e": e, "floor": least, "x0": x0, "columns": columns}


def _visible(recording, dt, acting, random):
    """Whether each effect by itself opens twice the floor."""
    return all(
        gap(plant.simulate(recording["u"][:-1], dt, [c], recording["x0"], random), recording["u"], dt,
            (c.t0, c.t1))["50"] >= 2 * recording["floor"]["50"]
        for c in acting
    )  # fmt: skip


def _withheld(tier, truth):
    """What a diagnoser may not name: the effect, and those of its family, which would explain it as well."""
    if tier != "left_out":
        return []
    return [name for name in VOCABULARY if plant.family(name) in map(plant.family, truth)]


def draw(tier, seed, k, most=10**6):
    """Log k of a tier of at most so many rows: its label, and (poses, commands, odometry or None) of log and fresh log."""
    random = np.random.default_rng([seed, list(TIERS).index(tier), k])
    for attempt in range(1000):
        dt, rows, drive = _design(random, tier, k, most)
        noise, motion = _noise(random, tier), _motion(random, tier, k)
        sensors = odometry.settings(random) if tier == "odometry" else None
        (u, drive_of), (fresh_u, _) = drive(random), drive(random)
        acting = causes(random, tier, seed, k, u, dt)
        there = _along(acting, (rows - 1) * dt)
        log = _recording(random, u, dt, acting, noise, motion, sensors)
        fresh = _recording(random, fresh_u, dt, there, noise, motion, sensors)
        if tier == "poor" or tier.startswith("none") or (_visible(log, dt, acting, random) and _visible(fresh, dt, there, random)):
            break
    else:
        raise RuntimeError(f"{tier} {k}: no drive in {attempt + 1} shows {[c.name for c in acting]}")
    truth = [] if tier.startswith("none") else sorted({c.name for c in acting})
    label = {
        "tier": tier, "truth": truth, "families": sorted(set(map(plant.family, truth))), "without": _withheld(tier, truth),
        "alias": tier == "left_out" and truth[0] in EXACT,
        "causes": [_told(c, (rows - 1) * dt) for c in acting],
        "dt": dt, "rows": rows, "noise": noise, "motion": motion, "odometry": sensors,
        "drive": drive_of, "drawn_again": attempt,
        "gap": gap(log["x"], u, dt), "floor": log["floor"],
        "fresh": {"gap": gap(fresh["x"], fresh_u, dt), "floor": fresh["floor"]},
    }  # fmt: skip
    wrapped = bool(random.integers(2))
    return label, *(_measured(r, wrapped) for r in (log, fresh))


def _told(cause, duration):
    """A cause as the label has it."""
    form = plant.function(cause).__name__ if cause.shape == "other" else cause.shape
    more = {"t1": min(cause.t1, duration), "form": form, "family": plant.family(cause.name), "link": plant.link(cause.name)}
    return asdict(cause) | more


def _measured(recording, wrapped):
    x = recording["x"] + recording["e"]
    if wrapped:
        x[:, 2] = np.angle(np.exp(1j * x[:, 2]))
    return x, recording["u"], recording["columns"]
