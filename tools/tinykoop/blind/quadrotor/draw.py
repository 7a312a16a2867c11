"""What is in each flight of the campaign: effects of 0.7 to 1.5 times the usual size, of either sign where the bounds allow it."""

import numpy as np

from ... import bridge
from ...platforms import COLUMNS
from ...plumbing.errors import UserError
from . import flight

TIERS = {
    "none": "healthy",
    "single": "one effect",
    "left_out": "one effect, taken out of the library",
    "unknown": "an effect that was never in it",
    "lacking": "one effect, a log that lacks columns",
}
LEAST, MOST = 0.7, 1.5  # times the usual
# Taken out together, as they do the same: weights in steady flight and several weaker rotors, all rotors and a weight in the middle, a
# lag and a delay
ROTORS = tuple(f"rotor{i}_thrust" for i in (1, 2, 3, 4))
ALIKE = {
    "payload": ("slung_load", *ROTORS), "slung_load": ("payload", *ROTORS), "thrust_gain": ("payload", "slung_load"),
    "motor_lag": ("transport_delay",), "transport_delay": ("motor_lag",),
}  # fmt: skip
NEVER = ("stuck_motor", "fading_rotor", "wind_shear")
QUICK = ("motor_lag", "transport_delay", "stuck_motor", "wind_shear")  # that act in manoeuvres only
LACKS = (
    ("gx", "gy", "gz"), ("pitch",), ("vx", "vy", "vz"), ("ax", "ay", "az"), ("pitch", "gx", "gy", "gz"), ("roll", "pitch"),
    ("px", "py", "pz", "vx", "vy", "vz"),
)  # fmt: skip
TRIES = 20


def effects():
    return tuple(bridge.effects("quadrotor"))


def wanted(n):
    """[(tier, k)] of a campaign; k counts each tier's flights, and effects take turns."""
    some, few, every = -(-n // 4), -(-n // 10), len(effects())
    counts = {"none": 2 * n, "single": n * every, "left_out": some * every, "unknown": 2 * few * len(NEVER), "lacking": n}
    return [(tier, k) for tier, count in counts.items() for k in range(count)]


def sized(random, name):
    """{parameter: value} of an effect."""
    if name in NEVER:
        return {"stuck_motor": _stuck, "fading_rotor": _fading, "wind_shear": _shear}[name](random)
    out = {}
    for parameter, _, low, high, usual in bridge.effects("quadrotor")[name][1]:
        value = abs(usual) * random.uniform(LEAST, MOST) * (random.choice((-1, 1)) if low < 0 < high else 1)
        out[parameter] = float(np.clip(value, low, high))
    return out


def _stuck(random):
    """A motor that gives no more than a little above what hovering takes."""
    return {f"most{int(random.integers(1, 5))}": random.uniform(1.0, 1.02) * bridge.hover_request()}


def _fading(random):
    """A propeller out of balance: it shakes at one frequency (Hz; m/s^2) and loses thrust as its motor heats."""
    return {
        f"loss{int(random.integers(1, 5))}": random.uniform(0.15, 0.3),
        "hertz": random.uniform(18, 40),
        "shake": random.uniform(0.1, 0.3),
    }


def _shear(random):
    """Wind that grows with height, m/s per m."""
    angle, size = random.uniform(0, 2 * np.pi), random.uniform(2, 4)
    return {"x": size * np.cos(angle), "y": size * np.sin(angle)}


def acting(there):
    """Names that hold of a flight on average: a rotor that fades or sticks is weak, and wind that grows with height is wind."""
    of = {"wind_shear": lambda _: "wind"}
    weak = lambda sizes: next(f"rotor{name[-1]}_thrust" for name in sizes if name[-1].isdigit())  # noqa: E731
    return [of.get(name, weak)(sizes) if name in NEVER else name for name, sizes in there.items()]


def draw(tier, seed, k):
    """(label, log) of flight k of a tier; drawn again if the vehicle tumbles."""
    for attempt in range(TRIES):
        random = np.random.default_rng([seed, list(TIERS).index(tier), k, attempt])
        names = {"none": ("",), "unknown": NEVER}.get(tier, effects())
        name = names[k % len(names)]
        there = {name: sized(random, name)} if name else {}
        kind = "steps" if name in QUICK else str(random.choice(flight.KINDS))
        lacks = LACKS[random.integers(len(LACKS))] if tier == "lacking" else ()
        log = flight.fly(kind, int(random.integers(2**31)), there)
        if log is not None:
            log.x[:, [COLUMNS["quadrotor"].index(column) - 5 for column in lacks]] = np.nan
            without = [name, *ALIKE.get(name, ())] if tier == "left_out" else []
            return {"tier": tier, "kind": kind, "effects": there, "acts": acting(there), "without": without, "lacks": list(lacks)}, log
    raise UserError(f"seed {seed}, {tier} {k}: no flight of {TRIES} stays in the air")
