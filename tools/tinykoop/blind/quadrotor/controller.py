"""A flight controller of another structure than that of host_sim/: acceleration wanted, tilt from it, and rates with a lead."""

import math

from .vehicle import FRONT, GRAVITY, LEFT, TURN

TICK, OUTER = 0.005, 4  # s; ticks of the loops of position and velocity
NEAR, FAST, SLOW = 1.4, 1.0, 2.2  # 1/s of place; m/s at most; 1/s of velocity
RISE, CLIMB = 1.6, 4.0  # the same of height
DRIFT, HELD = 0.5, 2.5  # 1/s^2 of the integral of the velocity error; m/s^2 at most
LEAN = 0.3  # rad at most
TILT, RATE, LEAD = 6.0, 42.0, 0.9  # 1/s of tilt; 1/s of rate; of the rate's change
TILT_SUM, RATE_HELD = 70.0, 60.0  # 1/s^2 of the integral of the rate error; rad/s^2 at most
YAW, YAW_RATE, YAW_SUM = 3.5, 8.0, 4.0  # the same of yaw
FILTER = 0.35  # of a new slope of the rate


def _limited(value, most):
    return max(-most, min(most, value))


class Controller:
    """numbers: parameters of the vehicle it was built for."""

    def __init__(self, numbers, flies):
        self.n, self.tick = numbers, 0
        self.hover = numbers["mass"] * GRAVITY / (4 * numbers["thrust_full"])
        self.start(flies)

    def start(self, flies=False):
        self.drift, self.turned = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        self.rate, self.slope = None, [0.0, 0.0, 0.0]
        self.lean, self.collective = (0.0, 0.0), self.hover if flies else 0.8 * self.hover

    def _steer(self, aim, position, velocity, yaw):
        dt, wanted = OUTER * TICK, []
        for i, (near, slow) in enumerate(((NEAR, SLOW), (NEAR, SLOW), (RISE, CLIMB))):
            off = _limited(near * (aim[i] - position[i]), FAST) - velocity[i]
            self.drift[i] = _limited(self.drift[i] + DRIFT * off * dt, HELD)
            wanted.append(slow * off + self.drift[i])
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left, up = c * wanted[0] + s * wanted[1], c * wanted[1] - s * wanted[0], _limited(wanted[2], 0.4 * GRAVITY)
        self.lean = _limited(-math.atan2(left, GRAVITY), LEAN), _limited(math.atan2(ahead, GRAVITY), LEAN)
        self.collective = self.hover * (1 + up / GRAVITY) / math.cos(self.lean[0]) / math.cos(self.lean[1])

    def _turning(self, aim_yaw, angles, rates):
        """Angular acceleration wanted, rad/s^2."""
        off = self.lean[0] - angles[0], self.lean[1] - angles[1], math.remainder(aim_yaw - angles[2], 2 * math.pi)
        wanted = TILT * off[0], TILT * off[1], YAW * off[2]
        last = self.rate or rates
        self.slope = [(1 - FILTER) * s + FILTER * (r - b) / TICK for s, r, b in zip(self.slope, rates, last)]
        self.rate, out = rates, []
        for i, (gain, total) in enumerate(((RATE, TILT_SUM), (RATE, TILT_SUM), (YAW_RATE, YAW_SUM))):
            error = wanted[i] - rates[i]
            self.turned[i] = _limited(self.turned[i] + total * error * TICK, RATE_HELD)
            out.append(gain * error + self.turned[i] - (LEAD * self.slope[i] if i < 2 else 0.0))
        return out

    def requests(self, aim, aim_yaw, position, velocity, angles, rates):
        """Of the four rotors, 0 to 1."""
        if self.tick % OUTER == 0:
            self._steer(aim, position, velocity, angles[2])
        self.tick += 1
        n, lever = self.n, self.n["arm"] * math.sqrt(0.5)
        roll, pitch, yaw = (n[f"inertia_{axis}"] * a for axis, a in zip("xyz", self._turning(aim_yaw, angles, rates)))
        arms = 4 * n["thrust_full"] * lever, 4 * n["thrust_full"] * n["torque_per_thrust"]
        tilts = [LEFT[i] * roll / arms[0] - FRONT[i] * pitch / arms[0] for i in range(4)]
        room = max(0.0, 1 - self.collective - max(tilts))  # yaw takes what tilt leaves
        turn = _limited(yaw / arms[1], max(room, 0.05))
        most = max(self.collective + tilts[i] + TURN[i] * turn for i in range(4))
        return [min(max(self.collective + tilts[i] + TURN[i] * turn - max(most - 1, 0.0), 0.0), 1.0) for i in range(4)]
