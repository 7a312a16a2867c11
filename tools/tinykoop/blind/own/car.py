"""A steered car, as a camera sees it."""

import math

from .plant import rk4

NAME, FILE = "car", "car/car.toml"
DT, ROWS = 0.02, 2000
HEADER = ("t", "x", "y", "psi", "v_cmd", "delta")
COMMANDS = ("speed", "steering")
SENSORS = (("px", 0, 0.005), ("py", 1, 0.005), ("yaw", 2, 0.003))
WHEELBASE = 0.33

# Sizes (low, high), of either sign where `signed`.
KNOWN = {
    "gain:speed": (0.05, 0.15), "gain:steering": (0.05, 0.15), "bias:steering": (0.01, 0.04), "lag:steering": (0.04, 0.2),
    "lag:speed": (0.06, 0.3), "delay:steering": (0.04, 0.16), "delay:all": (0.04, 0.16), "dead_band:steering": (0.04, 0.1),
    "saturation:steering": (0.18, 0.3), "rate_limit:steering": (0.5, 1.5), "backlash:steering": (0.02, 0.06), "sag:speed": (0.1, 0.25),
    "parameter:wheelbase": (0.02, 0.06), "cross:steering<-speed": (0.01, 0.03),
}  # fmt: skip
UNKNOWN = {"understeer": (0.15, 0.4), "side_slip": (0.08, 0.2), "turning_slows": (0.3, 0.8), "slope": (0.05, 0.15)}
# Effects that do the same, alone or together: a longer wheelbase turns the car less, as a smaller steering angle does, or a
# larger speed on a map that is drawn smaller.
_TURNS = ("gain:steering", "parameter:wheelbase", "gain:speed", "scale:px", "scale:py", "clock")
_LATE = ("delay:steering", "delay:speed", "delay:all")
ALIKE = dict.fromkeys(_TURNS, _TURNS) | dict.fromkeys(_LATE, _LATE)
SIGNED = ("gain", "bias", "parameter", "cross", "slope", "side_slip")


def start(chance):
    return [0.0, 0.0, chance.uniform(-math.pi, math.pi)]


def commands(chance):
    """New ones every half a second."""
    held = [0.0, 0.0, -1.0]

    def wish(t, seen):
        if math.floor(t / 0.5 + 1e-9) != held[2]:
            held[:] = [chance.uniform(0.3, 1.8), chance.uniform(-0.4, 0.4), math.floor(t / 0.5 + 1e-9)]
        return held[:2]

    return wish


def advance(effects):
    """The motion with what is in the plant itself."""
    of = lambda name: effects.get(name, 0.0)  # noqa: E731
    wheelbase = WHEELBASE + of("parameter:wheelbase")

    def rate(x, u):
        speed, steering = u[0], u[1] + of("cross:steering<-speed") * u[0]
        speed *= 1 - of("turning_slows") * abs(steering)
        speed -= of("slope") * math.sin(x[2])
        turn = speed * math.tan(steering) / wheelbase / (1 + of("understeer") * speed * speed)
        aside = of("side_slip") * speed * turn
        return (
            speed * math.cos(x[2]) - aside * math.sin(x[2]),
            speed * math.sin(x[2]) + aside * math.cos(x[2]),
            turn,
        )

    return lambda x, u, h: rk4(rate, x, u, h)


def columns(row):
    """A row of the log, in the units of its columns."""
    t, x, y, yaw, speed, steering = row
    return t, x, y, (math.degrees(yaw) + 180) % 360 - 180, speed, steering
