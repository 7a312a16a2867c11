"""A pole that hangs from a cart on a rail, as two encoders see it: its mass matrix is solved at each instant."""

import math

from .plant import rk4

NAME, FILE = "pendulum", "pendulum/pendulum.toml"
DT, ROWS = 0.02, 2000
HEADER = ("t", "x", "theta", "f_cmd")
COMMANDS = ("force",)
SENSORS = (("position", 0, 0.001), ("angle", 1, 0.003))
CART, POLE, LENGTH, FRICTION, BEARING, GRAVITY = 0.6, 0.2, 0.4, 0.3, 0.004, 9.81
STOP, STICKS = 0.1, 0.02  # m: where a stop begins; m/s: below it dry friction is not yet whole

# Sizes (low, high), of either sign where `signed`.
KNOWN = {
    "gain:force": (0.05, 0.15), "bias:force": (0.1, 0.4), "lag:force": (0.04, 0.12), "delay:force": (0.04, 0.12),
    "dead_band:force": (0.3, 0.8), "saturation:force": (2.0, 3.2), "rate_limit:force": (15.0, 40.0), "sag:force": (0.1, 0.25),
    "parameter:cart_mass": (0.05, 0.12), "parameter:pole_mass": (0.03, 0.06), "parameter:pole_length": (0.02, 0.05),
    "parameter:friction": (0.1, 0.25), "scale:angle": (0.04, 0.1), "scale:position": (0.04, 0.1),
    "sensor_delay:angle": (0.02, 0.06), "sensor_delay:position": (0.02, 0.06),
}  # fmt: skip
# N of dry friction; N/m of a stop at one side; N/m2 of a spring that grows with its square; N s2/m2 of drag at the tip of the pole.
UNKNOWN = {"dry_friction": (0.3, 0.8), "stop": (40.0, 150.0), "square_spring": (10.0, 30.0), "tip_drag": (0.03, 0.1)}
ALIKE = {"parameter:friction": ("damping:velocity",), "bias:force": ("force:velocity",)}  # effects that do the same
SIGNED = ("gain", "bias", "parameter", "scale")


def start(chance):
    return [0.0, chance.uniform(-0.4, 0.4), 0.0, 0.0]


def commands(chance):
    """A new push every 0.3 s, and a feedback that keeps the cart on its rail."""
    push, before, held = 0.0, 0.0, -1

    def wish(t, seen):
        nonlocal push, before, held
        if math.floor(t / 0.3 + 1e-9) != held:
            push, held = chance.uniform(-2.5, 2.5), math.floor(t / 0.3 + 1e-9)
        speed, before = (seen[0] - before) / DT, seen[0]
        return [push - 10 * seen[0] - 2 * speed]

    return wish


def solved(a, b, c, right):
    """(p, q) of a p + b q = right[0], b p + c q = right[1], by elimination."""
    q = (right[1] - b / a * right[0]) / (c - b / a * b)
    return (right[0] - b * q) / a, q


def advance(effects):
    """The motion with what is in the plant itself."""
    of = lambda name: effects.get(name, 0.0)  # noqa: E731
    cart, pole = CART + of("parameter:cart_mass"), POLE + of("parameter:pole_mass")
    length, friction = LENGTH + of("parameter:pole_length"), FRICTION + of("parameter:friction")

    def rate(x, u):
        place, angle, speed, turn = x
        along = u[0] - friction * speed + pole * length * turn * turn * math.sin(angle)
        along -= of("dry_friction") * math.tanh(speed / STICKS)
        along -= of("stop") * max(place - STOP, 0.0) + of("square_spring") * place * abs(place)
        about = -BEARING * turn - pole * GRAVITY * length * math.sin(angle)
        across, ahead = length * turn + speed * math.cos(angle), speed * math.sin(angle)  # of the tip
        drag = of("tip_drag") * math.hypot(across, ahead)
        about -= drag * length * across
        along -= drag * (across * math.cos(angle) + ahead * math.sin(angle))
        return speed, turn, *solved(cart + pole, pole * length * math.cos(angle), pole * length * length, (along, about))

    return lambda x, u, h: rk4(rate, x, u, h)


def columns(row):
    """A row of the log, in the units of its columns."""
    t, place, angle, force = row
    return t, 1e3 * place, math.degrees(angle), force
