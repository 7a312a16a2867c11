"""The quadrotor in MuJoCo: frame, weights, string and ground are MuJoCo's; rotors, air, and battery are written here.

Nothing of host_sim/ is called but for its list of parameters. Axes and rotors are those of docs/quadrotor.md.
"""

import math
from collections import deque

import numpy as np

from ... import bridge
from ...plumbing import checkout
from ...plumbing.errors import UserError

STEP = 0.0025  # s
GRAVITY = 9.81  # m/s^2
FRONT, LEFT, TURN = (1, -1, -1, 1), (-1, -1, 1, 1), (-1, 1, -1, 1)  # of the rotors; TURN: sign of the moment about z by their drag
PROPELLER = 0.023  # m, radius
HUB, SPHERE = 0.014, 0.005  # m, from the frame's centre to its feet; radius of a load
ROTOR_DRAG = 0.78  # of the drag at 1 m/s, that of the rotors; the rest is of the body and grows with the square of the speed
SAG, EMPTIES = 0.166, 0.00154  # of the voltage: by the current at full thrust, and per second of it; so that hover is as documented
CURRENT = 1.5  # exponent of the thrust in the current
STRING_DAMPING = 0.2  # 1/s
REMEMBERED = 0.2  # s of requests, for a delay


def mujoco():
    try:
        import mujoco as module
    except ImportError:
        raise UserError(f"the blind evaluation of the quadrotor needs the package mujoco; install it: {checkout.install('simulators')}")
    return module


def mjcf(numbers, effects, height):
    """The vehicle's MuJoCo model, its frame at this height."""
    at, lever = lambda *xyz: " ".join(f"{v:.9g}" for v in xyz), numbers["arm"] * math.sqrt(0.5)
    rotors = "".join(f'<site name="rotor{i}" pos="{at(lever * FRONT[i], lever * LEFT[i], 0)}"/>' for i in range(4))
    motors = "".join(f'<general site="rotor{i}" gear="0 0 1 0 0 {TURN[i] * numbers["torque_per_thrust"]:.9g}"/>' for i in range(4))
    weight, hung, string = "", "", ""
    if (p := effects.get("payload")) is not None:
        grain = at(*[1e-10] * 3)
        weight = f'<body pos="{at(p["x"], p["y"], 0)}"><inertial pos="0 0 0" mass="{p["mass"]:.9g}" diaginertia="{grain}"/></body>'
    if (p := effects.get("slung_load")) is not None:
        rotors += f'<site name="hook" pos="{at(p["x"], p["y"], 0)}"/>'
        hung = (
            f'<body name="load" pos="{at(p["x"], p["y"], max(height - p["length"], SPHERE))}">'
            f'<joint type="free" damping="{STRING_DAMPING * p["mass"]:.9g}"/><site name="load"/>'
            f'<geom type="sphere" size="{SPHERE}" mass="{p["mass"]:.9g}"/></body>'
        )
        string = (
            f'<tendon><spatial limited="true" range="0 {p["length"]:.9g}" solreflimit="0.006 1"><site site="hook"/><site site="load"/>'
            "</spatial></tendon>"
        )
    inertia = at(*(numbers[f"inertia_{axis}"] for axis in "xyz"))
    return (
        f'<mujoco><option timestep="{STEP}" gravity="0 0 {-GRAVITY}" integrator="implicitfast"/><worldbody>'
        f'<geom type="plane" size="50 50 1" friction="1"/><body name="frame" pos="{at(0, 0, height)}"><freejoint/>'
        f'<inertial pos="0 0 0" mass="{numbers["mass"]:.9g}" diaginertia="{inertia}"/>'
        f'<geom type="cylinder" size="{numbers["arm"]:.9g} {HUB}" mass="0" contype="2" conaffinity="1"/>{rotors}{weight}</body>{hung}'
        f"</worldbody>{string}<actuator>{motors}</actuator></mujoco>"
    )


class Vehicle:
    """What flies. effects: {name: {parameter: value}}; trims (4,): factors of the rotors' thrusts; open_: V of the battery without load."""

    def __init__(self, effects, height, seconds, trims=(1, 1, 1, 1), open_=None, flies=True, numbers=None):
        self.numbers = numbers or bridge.quadrotor_vehicle()
        self.effects, self.seconds, self.trims, self.t = effects, seconds, trims, 0.0
        self.engine = mujoco()
        self.model = self.engine.MjModel.from_xml_string(mjcf(self.numbers, effects, height))
        self.data = self.engine.MjData(self.model)
        n = self.numbers
        self.hover = n["mass"] * GRAVITY / (4 * n["thrust_full"])
        self.thrust = [self.hover if flies else 0.0] * 4  # of full
        self.slow = list(self.thrust)  # behind a further lag
        self.asked = deque([tuple(self.thrust)] * math.ceil(REMEMBERED / STEP), maxlen=math.ceil(REMEMBERED / STEP))
        self.open = (1.09 * n["voltage"] if open_ is None else open_) + 0.0
        self.lever = n["arm"] * math.sqrt(0.5)
        self.kept = math.exp(-STEP / n["motor_lag"])
        self.mean_left = -math.expm1(-STEP / n["motor_lag"]) * n["motor_lag"] / STEP
        self.acceleration = (0.0, 0.0, 0.0)

    def of(self, effect, parameter):
        return self.effects.get(effect, {}).get(parameter, 0.0)

    # ---- state ---------------------------------------------------------------------------------------

    @property
    def position(self):
        return self.data.qpos[:3].tolist()

    @property
    def velocity(self):
        return self.data.qvel[:3].tolist()

    @property
    def spin(self):
        return self.data.qvel[3:6].tolist()

    @property
    def rotation(self):
        """Body to world, rows."""
        w, x, y, z = self.data.qpos[3:7].tolist()
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )

    @property
    def angles(self):
        R = self.rotation
        return math.atan2(R[2][1], R[2][2]), -math.asin(max(-1.0, min(1.0, R[2][0]))), math.atan2(R[1][0], R[0][0])

    @property
    def voltage(self):
        return self.open - SAG * self.numbers["voltage"] * sum(max(f, 0.0) ** CURRENT for f in self.thrust) / 4

    # ---- one step ------------------------------------------------------------------------------------

    def _late(self):
        """Mean over this step of the requests that arrive, each held for a step."""
        steps = self.of("transport_delay", "delay") / STEP
        whole = int(steps + 1e-9)
        part = steps - whole
        new, old = self.asked[-1 - whole], self.asked[-2 - whole]
        return [(1 - part) * a + part * b for a, b in zip(new, old)]

    def _spun(self):
        """Mean thrusts of this step, as shares of full."""
        asked = self._late()
        if tau := self.of("motor_lag", "tau"):
            kept = math.exp(-STEP / tau)
            before, self.slow = self.slow, [a + kept * (s - a) for s, a in zip(self.slow, asked)]
            asked = [a + (s - a) * (1 - kept) * tau / STEP for s, a in zip(before, asked)]
        asked = [min(a, self.of("stuck_motor", f"most{i + 1}") or 1.0) for i, a in enumerate(asked)]
        mean = [a + (f - a) * self.mean_left for f, a in zip(self.thrust, asked)]
        self.thrust = [a + self.kept * (f - a) for f, a in zip(self.thrust, asked)]
        return mean

    def _factors(self):
        n, share = self.numbers, self.t / self.seconds
        common = 1 + n["voltage_slope"] * (self.voltage - n["voltage"])
        common *= (1 + self.of("thrust_gain", "a")) * (1 - self.of("battery_sag", "loss_at_end") * share)
        height = max(self.data.qpos[2], PROPELLER)
        common /= 1 - (PROPELLER / (4 * height)) ** 2  # Cheeseman and Bennett
        fades = [1 - self.of("fading_rotor", f"loss{i}") * share for i in (1, 2, 3, 4)]
        return [common * self.trims[i] * (1 + self.of(f"rotor{i + 1}_thrust", "a")) * fades[i] for i in range(4)]

    def _drag(self, R, thrusts):
        """(force, moment), body axes: each rotor brakes across its axis with its speed, the body with the square of its speed."""
        n = self.numbers
        height, shear = float(self.data.qpos[2]), self.effects.get("wind_shear", {})
        wind = [self.of("wind", "wx") + shear.get("x", 0.0) * height, self.of("wind", "wy") + shear.get("y", 0.0) * height, 0.0]
        through = [v - w for v, w in zip(self.velocity, wind)]
        air = [sum(R[j][i] * through[j] for j in range(3)) for i in range(3)]
        _, _, turn = self.spin
        speed, mass = math.sqrt(sum(v * v for v in air)), n["mass"]
        body = mass * ((1 - ROTOR_DRAG) * n["drag_xy"] * speed + self.of("drag", "k"))
        force, moment = [-body * v for v in air], [0.0, 0.0, 0.0]
        each = mass * ROTOR_DRAG / 4 / math.sqrt(self.hover * n["thrust_full"])
        for i, thrust in enumerate(thrusts):
            x, y, fast = self.lever * FRONT[i], self.lever * LEFT[i], math.sqrt(max(thrust, 0.0))
            fx = -each * fast * n["drag_xy"] * (air[0] - turn * y)
            fy = -each * fast * n["drag_xy"] * (air[1] + turn * x)
            force[0] += fx
            force[1] += fy
            force[2] -= each * fast * n["drag_z"] * air[2]
            moment[2] += x * fy - y * fx
        return force, moment

    def step(self, asked, gust=(0.0,) * 6):
        """On by STEP under these requests. gust: accelerations by turbulent air, body axes."""
        self.asked.append(tuple(min(max(a, 0.0), 1.0) for a in asked))
        n, R, d = self.numbers, self.rotation, self.data
        thrusts = [n["thrust_full"] * f * share for f, share in zip(self._factors(), self._spun())]
        force, moment = self._drag(R, thrusts)
        inertias = n["inertia_x"], n["inertia_y"], n["inertia_z"]
        force = [f + n["mass"] * g for f, g in zip(force, gust)]
        trim = [self.of("trim", axis) for axis in ("roll", "pitch", "yaw")]
        moment = [m + t + i * g for m, t, i, g in zip(moment, trim, inertias, gust[3:])]
        d.ctrl[:] = thrusts
        world = [sum(R[i][j] * v[j] for j in range(3)) for v in (force, moment) for i in range(3)]
        d.xfrc_applied[1] = world
        self.engine.mj_step(self.model, d)
        self.acceleration = d.qacc[:3].tolist()
        self.open -= EMPTIES * n["voltage"] * sum(max(f, 0.0) ** CURRENT for f in self.thrust) / 4 * STEP
        self.t += STEP

    @property
    def whole(self):
        """Whether it is still what flies: a number, and not on its back."""
        return bool(np.isfinite(self.data.qpos).all()) and self.rotation[2][2] > 0.3
