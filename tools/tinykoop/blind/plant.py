"""A second plant, written apart from host_sim/: continuous time, Runge-Kutta, commands that are held.

Every step is cut into SUB parts. What drives the robot is an array over the parts, its mean within each; an effect
changes these arrays in place, over its own span of time. Three tables of effects:

PLAIN: the vocabulary, as the contract words it, in continuous time.
OTHER: the same causes in forms of their own (second-order lag, soft limits, another slip and friction curve, wandering
drift, jitter, ..).
NEVER: causes that no library of ours holds.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from scipy.signal import lfilter

SUB = 10


@dataclass(frozen=True)
class Cause:
    """An effect acting on [t0, t1), s from the first row."""

    name: str
    parameters: dict = field(default_factory=dict)
    shape: str = "plain"  # plain, other or never
    t0: float = 0.0
    t1: float = float("inf")


# ---- the vocabulary, plain ---------------------------------------------------------------------
# m has arrays over the parts: t (s), passed (share of the span), v, w (command), forward, left, turn (body), wind
# (complex, world), h (true duration, s); dt and part (s) are scalars. s has arrays over the rows: t, z (complex), theta.


def saturation(m, v_max, w_max):
    np.clip(m.v, -v_max, v_max, out=m.v)
    np.clip(m.w, -w_max, w_max, out=m.w)


def transport_delay(m, delay):
    """Mean over each part of what was sent `delay` earlier: the way covered comes out exactly."""
    edges = np.arange(len(m.v) + 1) * m.part
    for u in (m.v, m.w):
        way = np.concatenate([[0], np.cumsum(u) * m.part])
        u[:] = np.diff(np.interp(edges - delay, edges, way) + np.minimum(edges - delay, 0) * u[0]) / m.part


def dead_band(m, v_db, w_db):
    m.v[np.abs(m.v) < v_db] = 0
    m.w[np.abs(m.w) < w_db] = 0


def play(w, half):
    out, at = np.empty_like(w), w[0]
    for i, command in enumerate(w.tolist()):
        at = min(max(at, command - half), command + half)
        out[i] = at
    return out


def backlash(m, half_width):
    m.w[:] = play(m.w, half_width)


def follow(u, part, tau):
    """y' = (u - y) / tau from rest at u[0], a Runge-Kutta step for each part; the mean over it."""
    z = part / tau
    kept = 1 - z + z**2 / 2 - z**3 / 6 + z**4 / 24
    end = lfilter([1 - kept], [1, -kept], u, zi=[kept * u[0]])[0]
    return (np.concatenate([u[:1], end[:-1]]) + end) / 2


def actuator_lag(m, tau):
    m.v[:], m.w[:] = follow(m.v, m.part, tau), follow(m.w, m.part, tau)


def speed_gain(m, a):
    m.v *= 1 + a


def battery_sag(m, loss_at_end):
    m.v *= 1 - loss_at_end * m.passed


def yaw_gain(m, b):
    m.w *= 1 + b


def wheel_asymmetry(m, c):
    m.w += c * m.v


def yaw_bias(m, d):
    m.w += d


def clock_scale(m, kappa):
    m.h *= 1 + kappa


def pacejka_slip(m, B, C, D, E, lat):
    s = B * 0.18 * np.abs(m.v * m.w)
    slip(m, np.clip(D * np.sin(C * np.arctan(s - E * (s - np.arctan(s)))), 0, 1), lat)


def slip(m, loss, lat):
    m.forward *= 1 - 0.3 * loss
    m.left += lat * loss * m.v * np.sign(m.w)
    m.turn *= 1 - 0.7 * loss


def lateral_skid(m, k):
    m.left += k * m.forward * m.turn


def stribeck_friction(m, Fs, Fc, Fv, vs):
    drag(m, lambda v: Fc + (Fs - Fc) * np.exp(-((v / vs) ** 2)) + Fv * np.abs(v), np.sign)


def drag(m, mu, sign):
    m.forward *= 1 - mu(m.forward)
    m.left *= 1 - mu(m.left)
    m.turn -= sign(m.turn) * np.minimum(0.1 * mu(m.turn), np.abs(m.turn))


def world_drift(m, wx, wy):
    m.wind += wx + 1j * wy


def sensor_lever_arm(s, lx, ly):
    s.z += (lx + 1j * ly) * np.exp(1j * s.theta)


def heading_bias(s, delta):
    s.theta += delta


# ---- the same causes in other forms ------------------------------------------------------------


def soft_saturation(m, v_max, w_max):
    m.v /= (1 + np.abs(m.v / v_max) ** 6) ** (1 / 6)
    m.w /= (1 + np.abs(m.w / w_max) ** 6) ** (1 / 6)


def jittery_delay(m, delay):
    """Every command comes after a delay of its own, 20 % more or less."""
    steps = -(-len(m.v) // SUB)
    late = np.repeat(delay * m.random.uniform(0.8, 1.2, steps), SUB)[: len(m.v)]
    sent = np.maximum((np.arange(len(m.v)) - np.rint(late / m.part)).astype(int), 0)
    m.v[:], m.w[:] = m.v[sent], m.w[sent]


def smooth_dead_band(m, v_db, w_db):
    m.v *= 1 - np.exp(-((m.v / v_db) ** 4))
    m.w *= 1 - np.exp(-((m.w / w_db) ** 4))


def spread_backlash(m, half_width):
    """Three plays in parallel."""
    m.w[:] = sum(play(m.w, share * half_width) for share in (0.2, 1, 1.8)) / 3


def second_order_lag(m, tau):
    for u in (m.v, m.w):
        u[:] = follow(follow(u, m.part, 0.6 * tau), m.part, 0.4 * tau)


def speed_gain_with_speed(m, a):
    m.v *= 1 + a * (1 + 0.25 * (np.abs(m.v) - 1))


def early_sag(m, loss_at_end):
    m.v *= 1 - loss_at_end * np.expm1(-2.5 * m.passed) / np.expm1(-2.5)


def yaw_gain_with_rate(m, b):
    m.w *= 1 + b * (1 + 0.5 * (np.abs(m.w) - 0.5))


def asymmetry_with_speed(m, c):
    m.w += c * m.v * (1 + 0.25 * (np.abs(m.v) - 1))


def wandering_bias(m, d):
    m.w += d * (1 + 0.3 * np.sin(2 * np.pi * m.t / 37))


def wandering_clock(m, kappa):
    m.h *= 1 + kappa * (1 + 0.3 * np.sin(2 * np.pi * m.t / 45))


def exponential_slip(m, B, C, D, E, lat):
    slip(m, np.clip(D * -np.expm1(-B * C * 0.18 * np.abs(m.v * m.w)), 0, 1), lat)


def saturating_skid(m, k):
    bend = m.forward * m.turn
    m.left += k * bend / (1 + 0.5 * np.abs(bend))


def smooth_friction(m, Fs, Fc, Fv, vs):
    drag(m, lambda v: Fc + (Fs - Fc) / (1 + (v / vs) ** 2) + Fv * np.abs(v), lambda w: np.tanh(w / 0.05))


def wandering_drift(m, wx, wy):
    swing = 0.3 * np.sin(2 * np.pi * m.t / 53)
    m.wind += (wx + 1j * wy) * (1 + swing) * np.exp(1j * np.sin(2 * np.pi * m.t / 41) / 3)


def swaying_arm(s, lx, ly):
    s.z += (lx + 1j * ly) * (1 + 0.15 * np.sin(2 * np.pi * s.t / 31)) * np.exp(1j * s.theta)


def compass_bias(s, delta):
    s.theta += delta * (1 + 0.3 * np.sin(s.theta))


# ---- in no library -----------------------------------------------------------------------------


def slew_limit(m, dv, dw):
    for u, most in ((m.v, dv * m.part), (m.w, dw * m.part)):
        at = u[0]
        for i, command in enumerate(u.tolist()):
            at += min(max(command - at, -most), most)
            u[i] = at


def command_quantisation(m, qv, qw):
    m.v[:], m.w[:] = qv * np.rint(m.v / qv), qw * np.rint(m.w / qw)


def warm_up(m, loss, tau):
    m.v *= 1 - loss * np.exp(-m.t / tau)


def payload_swing(m, share, frequency, damping):
    """A hanging load pulls the robot: its swing is driven by the acceleration."""
    omega, q, rate = 2 * np.pi * frequency, 0.0, 0.0
    jump = np.diff(m.v, prepend=m.v[0])
    for i, pull in enumerate(jump.tolist()):
        rate += -pull - m.part * (2 * damping * omega * rate + omega**2 * q)
        q += m.part * rate
        m.v[i] += share * rate


def understeer(m, K):
    m.turn /= 1 + K * m.forward**2


def turn_asymmetry(m, e):
    m.turn *= 1 + e * np.sign(m.turn)


def wheel_eccentricity(m, size, radius, phase):
    way = np.cumsum(np.abs(m.forward) * m.h)
    m.turn += size * m.forward * np.cos(way / radius + phase)


def camber(m, k):
    m.left += k * m.forward * np.abs(m.forward)


def gusts(m, size, tau):
    kept = np.exp(-m.part / tau)
    draws = m.random.normal(size=(2, len(m.t))) * size * np.sqrt(1 - kept**2)
    m.wind += np.array([1, 1j]) @ lfilter([1], [1, -kept], draws)


def slope(m, pull, downhill):
    m.forward += pull * np.cos(m.heading + np.cumsum(m.turn * m.h) - downhill)


def terrain(m, loss, patch, phase):
    def ground(z):
        where = np.sin(z.real / patch + phase) * np.sin(z.imag / patch + 2 * phase)
        return 1 - loss * (0.5 + 0.5 * np.tanh(4 * where))

    m.ground.append(ground)


def heading_scale(s, e):
    s.theta += e * (s.theta - s.theta[0])


# ---- tables, in the order of action --------------------------------------------------------------

_ACTUATOR = {
    "saturation": (saturation, soft_saturation),
    "command_quantisation": command_quantisation,
    "transport_delay": (transport_delay, jittery_delay),
    "dead_band": (dead_band, smooth_dead_band),
    "backlash": (backlash, spread_backlash),
    "slew_limit": slew_limit,
    "actuator_lag": (actuator_lag, second_order_lag),
    "speed_gain": (speed_gain, speed_gain_with_speed),
    "battery_sag": (battery_sag, early_sag),
    "warm_up": warm_up,
    "payload_swing": payload_swing,
    "yaw_gain": (yaw_gain, yaw_gain_with_rate),
    "wheel_asymmetry": (wheel_asymmetry, asymmetry_with_speed),
    "yaw_bias": (yaw_bias, wandering_bias),
    "clock_scale": (clock_scale, wandering_clock),
}
_PLANT = {
    "pacejka_slip": (pacejka_slip, exponential_slip),
    "lateral_skid": (lateral_skid, saturating_skid),
    "understeer": understeer,
    "turn_asymmetry": turn_asymmetry,
    "wheel_eccentricity": wheel_eccentricity,
    "stribeck_friction": (stribeck_friction, smooth_friction),
    "camber": camber,
    "slope": slope,
    "terrain": terrain,
    "world_drift": (world_drift, wandering_drift),
    "gusts": gusts,
}
_SENSOR = {
    "sensor_lever_arm": (sensor_lever_arm, swaying_arm),
    "heading_scale": heading_scale,
    "heading_bias": (heading_bias, compass_bias),
}
_ALL = _ACTUATOR | _PLANT | _SENSOR
PLAIN = {name: entry[0] for name, entry in _ALL.items() if isinstance(entry, tuple)}
OTHER = {name: entry[1] for name, entry in _ALL.items() if isinstance(entry, tuple)}
NEVER = {name: entry for name, entry in _ALL.items() if callable(entry)}
SHAPES = {"plain": PLAIN, "other": OTHER, "never": NEVER}


# ---- the robot -----------------------------------------------------------------------------------


def _pass(block, causes, signal, end):
    """Lets the causes of one block change what flows through it, each in its own span of time."""
    for name in block:
        for cause in (c for c in causes if c.name == name):
            first, last = np.searchsorted(signal.t, np.array([cause.t0, cause.t1]) - 1e-6 * signal.dt)
            if first == last:
                continue
            views = {k: a[first:last] for k, a in vars(signal).items() if isinstance(a, np.ndarray)}
            span = SimpleNamespace(**{**vars(signal), **views})
            span.passed = (span.t - cause.t0) / (min(cause.t1, end) - cause.t0)
            SHAPES[cause.shape][name](span, **cause.parameters)


def _way(theta, forward, left, turn, h):
    """Runge-Kutta's step of z' = (forward + i left) exp(i theta), theta' = turn."""
    return (forward + 1j * left) * h / 6 * (
        np.exp(1j * theta) + 4 * np.exp(1j * (theta + turn * h / 2)) + np.exp(1j * (theta + turn * h))
    )  # fmt: skip


def simulate(u, dt, causes=(), x0=(0.0, 0.0, 0.0), random=None):
    """Poses (K+1, 3) as measured without noise under commands u (K, 2); `random` draws jitter and gusts."""
    parts = len(u) * SUB
    v, w = (np.repeat(np.asarray(column, float), SUB) for column in np.transpose(u))
    m = SimpleNamespace(
        t=np.arange(parts) * dt / SUB, v=v, w=w, h=np.full(parts, dt / SUB), dt=dt, part=dt / SUB, ground=[],
        heading=x0[2], random=random,
    )  # fmt: skip
    _pass(_ACTUATOR, causes, m, len(u) * dt)
    m.forward, m.left, m.turn, m.wind = m.v.copy(), np.zeros(parts), m.w.copy(), np.zeros(parts, complex)
    _pass(_PLANT, causes, m, len(u) * dt)

    theta = x0[2] + np.concatenate([[0], np.cumsum(m.turn * m.h)])
    ways = _way(theta[:-1], m.forward, m.left, m.turn, m.h)
    z = np.empty(parts + 1, complex)
    z[0] = complex(*x0[:2])
    if m.ground:  # the ground slows the robot down and does not turn it
        for i, (way, wind) in enumerate(zip(ways.tolist(), (m.wind * m.h).tolist())):
            z[i + 1] = z[i] + way * m.ground[0](z[i]) + wind
    else:
        z[1:] = z[0] + np.cumsum(ways + m.wind * m.h)

    s = SimpleNamespace(t=np.arange(len(u) + 1) * dt, z=z[::SUB].copy(), theta=theta[::SUB].copy(), dt=dt)
    _pass(_SENSOR, causes, s, len(u) * dt)
    return np.stack([s.z.real, s.z.imag, s.theta], axis=1)


def noise(random, kind, rows, sp, st, rho=0.0):
    """Noise (rows, 3) of standard deviation sp (m) and st (rad): white, coloured (AR(1)) or heavy.

    Heavy is Student's t with four degrees of freedom, and one row in 200 is ten times as far out.
    """
    if kind == "heavy":
        e = random.standard_t(4, (rows, 3)) / np.sqrt(2)
        e[random.random(rows) < 0.005] *= 10
    else:
        e = random.normal(size=(rows, 3))
    if kind == "coloured":
        e[1:] *= np.sqrt(1 - rho**2)
        e = lfilter([1], [1, -rho], e, axis=0)
    return e * (sp, sp, st)
