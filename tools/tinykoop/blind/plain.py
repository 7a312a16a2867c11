"""The vocabulary, as the contract words it, in continuous time.

An effect changes what it acts on in place. m has arrays over the parts: t (s), passed (share of the span), v, w (command),
forward, left, turn (body), wind (complex, world), h (true duration, s); dt and part (s) are scalars. s has arrays over the
rows: t, z (complex), theta.
"""

import numpy as np
from scipy.signal import lfilter


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


def speed_lag(m, tau):
    m.v[:] = follow(m.v, m.part, tau)


def yaw_lag(m, tau):
    m.w[:] = follow(m.w, m.part, tau)


def ramp(u, most):
    """u with a change of at most `most` (a number or one for each part) in a part, as its mean over each part."""
    out, at = np.empty_like(u), u[0]
    for i, (command, step) in enumerate(zip(u.tolist(), np.broadcast_to(most, u.shape).tolist())):
        way = command - at
        moved = min(max(way, -step), step)
        share = min(abs(way) / step, 1.0)  # of the part, for which it moves
        out[i] = at + moved * (1 - share / 2)
        at += moved
    return out


def acceleration_limit(m, a, alpha):
    m.v[:], m.w[:] = ramp(m.v, a * m.part), ramp(m.w, alpha * m.part)


def on_rims(m, track, change):
    """Commands after `change` of the speeds of both wheels at their rims."""
    left, right = (change(m.v + side * m.w * track / 2) for side in (-1, 1))
    m.v[:], m.w[:] = (left + right) / 2, (right - left) / track


def wheel_dead_band(m, v_db, track):
    on_rims(m, track, lambda rim: np.where(np.abs(rim) < v_db, 0, rim))


def wheel_saturation(m, v_max, track):
    on_rims(m, track, lambda rim: np.clip(rim, -v_max, v_max))


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


def no_traction(m):
    """The wheels turn in the air."""
    for u in (m.forward, m.left, m.turn):
        u[:] = 0


def world_drift(m, wx, wy):
    m.wind += wx + 1j * wy


def sensor_lever_arm(s, lx, ly):
    s.z += (lx + 1j * ly) * np.exp(1j * s.theta)


def heading_bias(s, delta):
    s.theta += delta
