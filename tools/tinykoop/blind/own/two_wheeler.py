"""A robot with two driven wheels on a floor: contacts by MuJoCo, by another integrator and in steps of an eighth of the simulator's."""

import math

from ...plumbing.checkout import ROOT

NAME, FILE = "two_wheeler", "two_wheeler/two_wheeler.toml"
DT, ROWS = 0.02, 2000
HEADER = ("t", "x", "y", "yaw", "left", "right")
COMMANDS = ("left", "right")
SENSORS = (("px", 0, 0.002), ("py", 1, 0.002), ("yaw", 3, 0.003))
MODEL = ROOT / "examples/own_robot/two_wheeler/two_wheeler.xml"
PARTS = 4  # steps of the engine in one of the plant
WAVE = 0.4  # m, of a floor that is not flat

# Sizes (low, high), of either sign where `signed`.
KNOWN = {
    "parameter:chassis_mass": (0.3, 1.0), "parameter:wheel_friction": (-0.5, -0.25), "parameter:wheel_damping": (0.001, 0.003),
    "gain:left": (0.04, 0.12), "gain:right": (0.04, 0.12), "bias:right": (0.2, 0.8), "lag:left": (0.04, 0.15), "lag:all": (0.04, 0.15),
    "delay:all": (0.04, 0.12), "saturation:left": (8.0, 11.0), "dead_band:right": (2.0, 4.0), "rate_limit:left": (40.0, 80.0),
    "sag:left": (0.06, 0.2), "scale:px": (0.04, 0.1), "sensor_delay:yaw": (0.04, 0.1), "force:vx": (0.15, 0.4),
}  # fmt: skip
# What the caster's friction grows by; how fast a wheel loses grip, s/rad; slope of the waves.
UNKNOWN = {"dragging_caster": (0.03, 0.1), "left_slips_at_speed": (0.05, 0.12), "waves_in_the_floor": (0.02, 0.06)}
SIGNED = ("gain", "bias", "scale", "force")
# Effects that do the same, alone or together.
_SPEED = ("gain:left", "gain:right", "parameter:wheel_damping", "damping:vx", "damping:vy", "scale:px", "scale:py", "clock")
_LATE = ("delay:left", "delay:right", "delay:all")
_SLOW = ("lag:left", "lag:right", "lag:all")
_TORQUE = ("bias:right", "force:right_rate")
ALIKE = {name: group for group in (_SPEED, _LATE, _SLOW, _TORQUE) for name in group}


def start(chance):
    return [0.0, 0.0, 0.0, chance.uniform(-math.pi, math.pi), *[0.0] * 8]


def commands(chance):
    """New wheel speeds every half a second."""
    held = [0.0, 0.0, -1.0]

    def wish(t, seen):
        if math.floor(t / 0.5 + 1e-9) != held[2]:
            ahead, turn = chance.uniform(-4, 14), chance.uniform(-4, 4)
            held[:] = [ahead - turn, ahead + turn, math.floor(t / 0.5 + 1e-9)]
        return held[:2]

    return wish


def _model(mujoco, of):
    """The example's model with what is changed in it."""
    spec = mujoco.MjSpec.from_file(str(MODEL))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    chassis = spec.body("chassis")
    heavier = 1 + of("parameter:chassis_mass") / chassis.mass
    chassis.mass, chassis.inertia = chassis.mass * heavier, chassis.inertia * heavier
    spec.geom("caster").friction[0] += of("dragging_caster")
    for side in ("left", "right"):
        spec.geom(side).friction[0] += of("parameter:wheel_friction")
        spec.joint(side).damping[0] += of("parameter:wheel_damping")
    return spec.compile()


def advance(effects):
    """The motion with what is in the plant itself."""
    import mujoco

    of = lambda name: effects.get(name, 0.0)  # noqa: E731
    model = _model(mujoco, of)
    data, mass, grip = mujoco.MjData(model), sum(model.body_mass), model.geom("left").friction[0]

    def move(x, u, h):
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[: model.nq], x[model.nq :], u
        model.opt.timestep = h / PARTS
        model.geom("left").friction[0] = grip * math.exp(-of("left_slips_at_speed") * abs(x[-2]))
        data.qfrc_applied[0] = mass * of("force:vx") - mass * 9.81 * of("waves_in_the_floor") * math.cos(2 * math.pi * x[0] / WAVE)
        mujoco.mj_step(model, data, PARTS)
        return [*data.qpos, *data.qvel]

    return move


def columns(row):
    """A row of the log, in the units of its columns."""
    t, x, y, yaw, left, right = row
    return t, x, y, (math.degrees(yaw) + 180) % 360 - 180, left, right
