"""A flight of the second vehicle: what it is to fly, the turbulent air, the sensors, and its log."""

import math
from types import SimpleNamespace

import numpy as np

from .controller import TICK, Controller
from .vehicle import STEP, Vehicle

DT, SECONDS = 0.01, 30.0
KINDS = ("steps", "legs")  # of the campaign
# What flights differ by and noise, as documented for the vehicle (docs/quadrotor.md)
ROTOR, LEVEL, BATTERY, ACCELEROMETER, GYRO = 0.006, 0.004, 0.03, 0.03, 0.003
NOISE = np.repeat([0.0004, 0.0015, 0.07, 0.0004, 0.02], 3)
VOLTS = 0.0012  # of the voltage
GUSTS = (0.05, 0.05, 0.05, 2.5, 2.5, 0.6)  # m/s^2, rad/s^2
LASTS, TONES, SPAN = 0.3, 60, (0.03, 9.0)  # s; number of sinusoids, and their frequencies, Hz
RESTS, RISES, SINKS = 2.5, 2.0, 1.5  # s of a flight from the ground
TURNS = 1.8  # rad/s at most, that the heading asked for turns
TUMBLED = 1.0  # rad
FARTHEST = 5.0  # m from where it should be


def gusts(random, rows, noise=1.0):
    """Accelerations (rows, 6): sums of sinusoids of random phase, with the spectrum of air that stays for LASTS (M. Shinozuka, 1971)."""
    edges = np.geomspace(*SPAN, TONES + 1)
    f = random.uniform(edges[:-1], edges[1:])
    power = np.diff(edges) / (1 + (2 * np.pi * f * LASTS) ** 2)
    sizes, phases = np.sqrt(2 * power / power.sum()), random.uniform(0, 2 * np.pi, (6, TONES))
    t = np.arange(rows) * STEP
    return noise * np.array([size * np.cos(2 * np.pi * np.outer(t, f) + p) @ sizes for size, p in zip(GUSTS, phases)]).T


# ---- what is flown -------------------------------------------------------------------------------


def hover(random):
    """A function t -> (place asked for, heading, flies)."""
    return lambda t: ([0.0, 0.0, 0.8], 0.0, True)


def steps(random):
    """The same: another place, heading or height every 1.1 to 2.4 s."""
    times, aims, t, aim = [0.0], [[0.0, 0.0, random.uniform(0.6, 1.0), 0.0]], random.uniform(0.8, 1.8), None
    while t < SECONDS:
        aim, what = list(aims[-1]), random.uniform()
        if what < 0.55:
            axis = int(random.integers(2))
            aim[axis] = 0.0 if abs(aim[axis]) > 0.5 else aim[axis] + random.choice((-1, 1)) * random.uniform(0.3, 0.7)
        elif what < 0.8:
            aim[3] += random.choice((-1, 1)) * random.uniform(0.4, 1.2)
        else:
            aim[2] = random.uniform(0.5, 1.5)
        times.append(t)
        aims.append(aim)
        t += random.uniform(1.1, 2.4)

    def at(t):
        aim = aims[np.searchsorted(times, t, "right") - 1]
        return aim[:3], aim[3], True

    return at


def legs(random):
    """The same from the ground: a slow circle, or there and back, and down again."""
    height, circle, speed = random.uniform(0.5, 0.9), random.uniform() < 0.5, random.uniform(0.25, 0.45)
    radius, start, sense = random.uniform(0.4, 0.8), random.uniform(0, 2 * np.pi), random.choice((-1, 1))
    until = SECONDS - RESTS - SINKS - 0.5

    def at(t):
        up = height * _eased((t - RESTS) / RISES) * (1 - 1.1 * _eased((t - until) / SINKS))
        gone = speed * max(min(t, until) - RESTS - RISES - 0.5, 0.0) / radius
        angle = start + sense * gone
        if circle:
            x, y = radius * (math.cos(angle) - math.cos(start)), radius * (math.sin(angle) - math.sin(start))
        else:
            x = y = 0.0
            way = 2 * radius * (1 - math.cos(gone / 2))
            x, y = way * math.cos(start), way * math.sin(start)
        return [x, y, up], 0.0, RESTS <= t < until + SINKS

    return at


def _eased(share):
    return 0.5 - 0.5 * math.cos(math.pi * max(0.0, min(1.0, share)))


PLANS = {"hover": hover, "steps": steps, "legs": legs}


# ---- the flight ----------------------------------------------------------------------------------


class Sensors:
    """What the log has, each tick, of 15 columns."""

    def __init__(self, random, vehicle, ticks, noise):
        self.vehicle, effects = vehicle, vehicle.effects
        shaken = np.ones(15)
        shaken[[6, 7, 8, 12, 13, 14]] = 1 + effects.get("vibration", {}).get("a", 0.0)
        self.noise = noise * shaken * NOISE * random.standard_normal((ticks, 15))
        self.noise[:, 9:11] += noise * LEVEL * random.standard_normal(2)
        self.noise[:, 6:9] += noise * ACCELEROMETER * random.standard_normal(3)
        self.noise[:, 12:15] += noise * GYRO * random.standard_normal(3) + self._bias("gyro_bias")
        if shake := effects.get("fading_rotor"):
            swing = np.sin(2 * np.pi * shake["hertz"] * np.arange(ticks) * TICK)
            self.noise[:, 6] += shake["shake"] * swing
            self.noise[:, 12] += 0.3 * shake["shake"] * swing
        self.bias = self._bias("accel_bias")

    def _bias(self, name):
        return np.array([self.vehicle.of(name, axis) for axis in ("bx", "by", "bz")])

    def read(self, tick):
        v = self.vehicle
        acceleration = np.array(v.acceleration) + np.array(v.rotation) @ self.bias
        return (np.concatenate([v.position, v.velocity, acceleration, v.angles, v.spin]) + self.noise[tick]).tolist()


def fly(kind, seed, effects=None, noise=1.0, seconds=SECONDS):
    """The log (t, x, u, dt) of a flight at 100 Hz, or None if it tumbles. effects: {name: {parameter: value}}."""
    random = np.random.default_rng(seed)
    plan = PLANS[kind](random)
    (_, _, height), _, flies = plan(0.0)
    trims = 1 + noise * ROTOR * random.standard_normal(4)
    v = Vehicle(effects or {}, max(height, 0.014), seconds, trims.tolist(), None, flies)
    v.open *= 1 + noise * BATTERY * random.standard_normal() / 1.09
    ticks, inner = round(seconds / TICK), round(TICK / STEP)
    sensors, air = Sensors(random, v, ticks, noise), gusts(random, ticks * inner, noise).tolist()
    volts = noise * VOLTS * v.numbers["voltage"] * random.standard_normal(ticks)
    controller, heading, still = Controller(v.numbers, flies), 0.0, [0.0] * 6
    x, u = [], []
    for tick in range(ticks):
        t, seen = tick * TICK, sensors.read(tick)
        aim, yaw, up = plan(t)
        heading += max(-TURNS * TICK, min(TURNS * TICK, yaw - heading))
        if up and not flies:
            controller.start()
        flies = up
        asked = controller.requests(aim, heading, seen[:3], seen[3:6], seen[9:12], seen[12:]) if flies else [0.0] * 4
        if tick % round(DT / TICK) == 0:
            x.append(seen)
            u.append([*asked, v.voltage + volts[tick]])
        for i in range(inner):
            v.step(asked, air[tick * inner + i] if flies and v.data.qpos[2] > 0.03 else still)
        if not v.whole or max(abs(a - p) for a, p in zip(aim, v.position)) > FARTHEST:
            return None
    x = np.array(x)
    return SimpleNamespace(t=np.arange(len(x)) * DT, x=x, u=np.array(u), usable=np.ones(len(x) - 1, bool), dt=DT)
