"""Causes that are in no library. What m and s hold is said in `plain`."""

import numpy as np
from scipy.signal import lfilter


def command_quantisation(m, qv, qw):
    m.v[:], m.w[:] = qv * np.rint(m.v / qv), qw * np.rint(m.w / qw)


def warm_up(m, loss, tau):
    m.v *= 1 - loss * np.exp(-m.t / tau)


def heat(m, loss, tau):
    """The motor loses torque as it warms up, by the square of the speed, and gets it back as it cools down."""
    kept = np.exp(-m.part / tau)
    m.v *= np.maximum(0.2, 1 - loss * lfilter([1 - kept], [1, -kept], m.v**2))


def payload_swing(m, share, frequency, damping):
    """A hanging load pulls the robot: its swing is driven by the acceleration."""
    omega, q, rate = 2 * np.pi * frequency, 0.0, 0.0
    jump = np.diff(m.v, prepend=m.v[0])
    for i, pull in enumerate(jump.tolist()):
        rate += -pull - m.part * (2 * damping * omega * rate + omega**2 * q)
        q += m.part * rate
        m.v[i] += share * rate


def turn_asymmetry(m, e):
    m.turn *= 1 + e * np.sign(m.turn)


def wheel_eccentricity(m, size, radius, phase):
    way = np.cumsum(np.abs(m.forward) * m.h)
    m.turn += size * m.forward * np.cos(way / radius + phase)


def caster_kick(m, kick, tau):
    """The casters turn round when the robot reverses, and push its tail to one side for a moment."""
    reversals = np.diff(np.sign(m.forward), prepend=np.sign(m.forward[0]))
    m.turn += kick * lfilter([1], [1, -np.exp(-m.part / tau)], reversals / 2)


def camber(m, k):
    m.left += k * m.forward * np.abs(m.forward)


def slope(m, pull, downhill):
    m.forward += pull * np.cos(m.heading + np.cumsum(m.turn * m.h) - downhill)


def terrain(m, loss, patch, phase):
    def ground(z):
        where = np.sin(z.real / patch + phase) * np.sin(z.imag / patch + 2 * phase)
        return 1 - loss * (0.5 + 0.5 * np.tanh(4 * where))

    m.ground.append(ground)


def heading_scale(s, e):
    s.theta += e * (s.theta - s.theta[0])


def tether(m, loss, slack):
    """A cable that the robot drags holds it back more, the farther it is from the first row."""
    m.ground.append(lambda z: 1 - loss * np.tanh(abs(z - m.begin) / slack))
