"""A quadrotor in a vertical plane, as cameras see it: its velocities are those along its own axes. It flies in a closed loop."""

import math

from .plant import rk4

NAME, FILE = "quadrotor", "quadrotor/quadrotor.toml"
DT, ROWS = 0.02, 2000
HEADER = ("t", "x", "z", "pitch", "thrust", "torque")
COMMANDS = ("thrust", "torque")
SENSORS = (("px", 0, 0.002), ("pz", 1, 0.002), ("pitch", 2, 0.004))
MASS, INERTIA, GRAVITY = 0.8, 0.006, 9.81
POST, CORD, REACH = 1.2, 0.4, 0.3  # m: free length of the tether, length of the load's cord, height that the ground's effect reaches

# Sizes (low, high), of either sign where `signed`. A gain of thrust or torque is the same as another mass or inertia.
KNOWN = {
    "parameter:mass": (0.06, 0.2), "parameter:inertia": (0.0006, 0.0015), "bias:torque": (0.003, 0.01),
    "cross:torque<-thrust": (0.0005, 0.0015), "lag:thrust": (0.04, 0.15), "lag:torque": (0.03, 0.06), "delay:thrust": (0.04, 0.12),
    "delay:torque": (0.03, 0.05), "delay:all": (0.03, 0.05), "saturation:thrust": (9.0, 10.5), "saturation:torque": (0.03, 0.05),
    "dead_band:torque": (0.008, 0.02), "rate_limit:torque": (1.4, 2.2), "sag:thrust": (0.08, 0.2), "force:vx": (0.2, 0.6),
    "damping:vx": (0.15, 0.5), "damping:vz": (0.15, 0.5), "scale:px": (0.04, 0.1), "sensor_delay:pitch": (0.02, 0.04),
}  # fmt: skip
# 1/m of drag; N/m of a tether beyond its length; part of the thrust that the ground adds; kg that hang on a cord, of the mass as it is.
UNKNOWN = {"drag": (0.3, 0.7), "tether": (2.0, 6.0), "ground": (0.2, 0.5), "swinging_load": (0.1, 0.25)}
# Effects that do the same, alone or together.
_LIFTS, _TURNS = ("parameter:mass", "gain:thrust"), ("parameter:inertia", "gain:torque")
_TORQUE = ("bias:torque", "cross:torque<-thrust", "force:pitch_rate")
_LATE = ("delay:all", "delay:thrust", "delay:torque")
ALIKE = {name: group for group in (_LIFTS, _TURNS, _TORQUE, _LATE) for name in group}
SIGNED = ("parameter", "bias", "cross", "force", "scale")


def start(chance):
    """px, pz, pitch; velocities ahead and upwards along the body; pitch rate; angle and rate of the cord."""
    return [chance.uniform(-1, 1), chance.uniform(0.8, 1.6), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def commands(chance):
    """A cascade of controllers on the way to a new place every 1.5 s; speeds are smoothed differences."""
    goal, before, speed, held = (0.0, 1.0), None, [0.0, 0.0, 0.0], -1

    def wish(t, seen):
        nonlocal goal, before, held
        if math.floor(t / 1.5 + 1e-9) != held:
            goal, held = (chance.uniform(-2, 2), chance.uniform(0.4, 2.4)), math.floor(t / 1.5 + 1e-9)
        for i, (now, was) in enumerate(zip(seen, before or seen)):
            speed[i] = 0.5 * speed[i] + 0.5 * (now - was) / DT
        before = seen
        lean = within(0.2 * within(goal[0] - seen[0], 1.5) - 0.2 * speed[0], 0.5)
        climb = within(6 * (goal[1] - seen[1]) - 4 * speed[1], 5)
        return [
            MASS * (GRAVITY + climb) / math.cos(within(seen[2], 0.8)),
            INERTIA * within(60 * (lean - seen[2]) - 12 * speed[2], 60),
        ]

    return wish


def within(value, most):
    return max(-most, min(most, value))


def outside(of, x, velocity):
    """Forces of the surroundings (along x, along z), for each kg of robot and load."""
    (vx, vz), far = velocity, math.hypot(x[0], x[1] - 1)
    slow = of("drag") * math.hypot(vx, vz)
    pull = of("tether") * max(far - POST, 0.0) / max(far, POST) / MASS
    return of("force:vx") - (of("damping:vx") + slow) * vx - pull * x[0], -(of("damping:vz") + slow) * vz - pull * (x[1] - 1)


def advance(effects):
    """The motion with what is in the plant itself."""
    of = lambda name: effects.get(name, 0.0)  # noqa: E731
    load = of("swinging_load")
    mass, inertia = MASS + of("parameter:mass") - load, INERTIA + of("parameter:inertia")

    def rate(x, u):
        _, z, pitch, ahead, up, turn, swing, swings = x
        s, c = math.sin(pitch), math.cos(pitch)
        velocity = ahead * c + up * s, up * c - ahead * s
        lift = u[0] * (1 + of("ground") * math.exp(-max(z, 0.0) / REACH)) / mass
        cord = load / (mass + load) * (CORD * swings * swings + lift * math.cos(swing + pitch))  # its pull, for each kg
        fx, fz = outside(of, x, velocity)
        fx, fz = fx + cord * math.sin(swing), fz - cord * math.cos(swing) - GRAVITY
        torque = u[1] + of("cross:torque<-thrust") * u[0]
        return (
            *velocity, turn, fx * c - fz * s - turn * up, fx * s + fz * c + lift + turn * ahead, torque / inertia,
            swings, -lift * math.sin(swing + pitch) / CORD,
        )  # fmt: skip

    return lambda x, u, h: rk4(rate, x, u, h)


def columns(row):
    """A row of the log, in the units of its columns."""
    t, x, z, pitch, thrust, torque = row
    return t, x, z, (math.degrees(pitch) + 180) % 360 - 180, thrust, torque
