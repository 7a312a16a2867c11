"""The causes of the vocabulary in other forms, as other people write them.

A form takes the parameters of the plain one, so that both come in the same sizes, and may read them in its own way.
What m and s hold is said in `plain`.
"""

import numpy as np
from scipy.signal import cont2discrete, lfilter

from .plain import drag, follow, on_rims, play, ramp, slip

SUB = 10  # parts of a step
TRACK = 0.5  # m between the wheels, where a form has wheels and its parameters have no track width


def _late(u, steps):
    """u as it was so many parts earlier, and its first value before the log."""
    return u[np.maximum(np.arange(len(u)) - steps, 0)]


# ---- saturation --------------------------------------------------------------------------------


def soft_saturation(m, v_max, w_max):
    m.v /= (1 + np.abs(m.v / v_max) ** 6) ** (1 / 6)
    m.w /= (1 + np.abs(m.w / w_max) ** 6) ** (1 / 6)


def tanh_saturation(m, v_max, w_max):
    m.v[:], m.w[:] = v_max * np.tanh(m.v / v_max), w_max * np.tanh(m.w / w_max)


def curvature_keeping_saturation(m, v_max, w_max):
    """Both commands are scaled by the same factor, so that the robot stays on its path."""
    over = np.maximum(1, np.maximum(np.abs(m.v) / v_max, np.abs(m.w) / w_max))
    m.v /= over
    m.w /= over


def one_sided_saturation(m, v_max, w_max):
    """Backward and to the right the limits are lower."""
    np.clip(m.v, -0.6 * v_max, v_max, out=m.v)
    np.clip(m.w, -0.8 * w_max, w_max, out=m.w)


def soft_wheel_saturation(m, v_max, track):
    on_rims(m, track, lambda rim: rim / (1 + np.abs(rim / v_max) ** 6) ** (1 / 6))


def curvature_keeping_wheel_saturation(m, v_max, track):
    """The faster wheel is held at the limit and the other is slowed down by the same factor."""
    over = np.maximum(1, (np.abs(m.v) + np.abs(m.w) * track / 2) / v_max)
    m.v /= over
    m.w /= over


def weak_wheel_saturation(m, v_max, track):
    """The motor of the left wheel reaches 85 % of the limit of the other."""
    left, right = m.v - m.w * track / 2, m.v + m.w * track / 2
    left, right = np.clip(left, -0.85 * v_max, 0.85 * v_max), np.clip(right, -v_max, v_max)
    m.v[:], m.w[:] = (left + right) / 2, (right - left) / track


# ---- delay -------------------------------------------------------------------------------------


def jittery_delay(m, delay):
    """Every command comes after a delay of its own, 20 % more or less."""
    steps = -(-len(m.v) // SUB)
    late = np.repeat(delay * m.random.uniform(0.8, 1.2, steps), SUB)[: len(m.v)]
    sent = np.rint(late / m.part).astype(int)
    m.v[:], m.w[:] = _late(m.v, sent), _late(m.w, sent)


def axis_delay(m, delay):
    """The turn comes after less than half of the delay of the speed."""
    m.v[:], m.w[:] = (_late(u, round(share * delay / m.part)) for u, share in ((m.v, 1.0), (m.w, 0.4)))


def polled_delay(m, delay):
    """The drive reads its command at times 2 delay apart and holds it: the delay is that on average."""
    held = max(1, round(2 * delay / m.part))
    m.v[:], m.w[:] = (_late(u, np.arange(len(u)) % held) for u in (m.v, m.w))


# ---- dead band ---------------------------------------------------------------------------------


def _smooth_band(u, half):
    return u * (1 - np.exp(-((u / half) ** 4)))


def _offset_band(u, half):
    return np.sign(u) * np.maximum(np.abs(u) - half, 0)


def _sticking(u, start, stop):
    """u once it has been over `start`, until it falls below `stop`."""
    out, moves = np.zeros_like(u), False
    for i, command in enumerate(u.tolist()):
        moves = abs(command) >= (stop if moves else start)
        out[i] = command if moves else 0
    return out


def smooth_dead_band(m, v_db, w_db):
    m.v[:], m.w[:] = _smooth_band(m.v, v_db), _smooth_band(m.w, w_db)


def offset_dead_band(m, v_db, w_db):
    """Larger commands lose the width of the band, too."""
    m.v[:], m.w[:] = _offset_band(m.v, v_db), _offset_band(m.w, w_db)


def hysteresis_dead_band(m, v_db, w_db):
    """A drive that stands needs more to start than a drive that moves needs to keep going."""
    m.v[:], m.w[:] = _sticking(m.v, 1.2 * v_db, 0.5 * v_db), _sticking(m.w, 1.2 * w_db, 0.5 * w_db)


def moving_dead_band(m, v_db, w_db):
    """Small turns do nothing while the robot stands, and half as small ones while it drives."""
    m.w[np.abs(m.w) < np.where(np.abs(m.v) < 0.1, w_db, w_db / 2)] = 0
    m.v[np.abs(m.v) < v_db] = 0


def smooth_wheel_dead_band(m, v_db, track):
    on_rims(m, track, lambda rim: _smooth_band(rim, v_db))


def offset_wheel_dead_band(m, v_db, track):
    on_rims(m, track, lambda rim: _offset_band(rim, v_db))


def hysteresis_wheel_dead_band(m, v_db, track):
    on_rims(m, track, lambda rim: _sticking(rim, 1.2 * v_db, 0.5 * v_db))


# ---- backlash ----------------------------------------------------------------------------------


def _angle_play(speed, part, half):
    """The speed behind a gear whose angle (or way) has this much play on either side."""
    turned = np.concatenate([[0], np.cumsum(speed) * part])
    return np.diff(play(turned, half)) / part


def spread_backlash(m, half_width):
    """Three plays in parallel."""
    m.w[:] = sum(play(m.w, share * half_width) for share in (0.2, 1, 1.8)) / 3


def angle_backlash(m, half_width):
    """Play of the angle: after each reversal the robot does not turn until the angle is taken up."""
    m.w[:] = _angle_play(m.w, m.part, half_width)


def wheel_angle_backlash(m, half_width):
    """Play of the angle in the gears of both wheels."""
    on_rims(m, TRACK, lambda rim: _angle_play(rim, m.part, 0.4 * half_width))


def wheel_speed_backlash(m, half_width):
    """Play in the speed commands of both wheels."""
    on_rims(m, TRACK, lambda rim: play(rim, TRACK / 2 * half_width))


# ---- acceleration ------------------------------------------------------------------------------


def wheel_acceleration_limit(m, a, alpha):
    """Each wheel's motor limits its own acceleration."""
    on_rims(m, TRACK, lambda rim: ramp(rim, a * m.part))


def braking_acceleration_limit(m, a, alpha):
    """The drive brakes faster than it accelerates."""
    for u, most in ((m.v, a), (m.w, alpha)):
        u[:] = _braking(u, 0.8 * most * m.part, 2 * most * m.part)


def _braking(u, faster, slower):
    out, at = np.empty_like(u), u[0]
    for i, command in enumerate(u.tolist()):
        most = slower if at * (command - at) < 0 else faster
        at += min(max(command - at, -most), most)
        out[i] = at
    return out


def fading_acceleration_limit(m, a, alpha):
    """A motor has less torque to spare at speed."""
    for u, most, peak in ((m.v, a, 3.0), (m.w, alpha, 1.5)):
        u[:] = _fading(u, 1.3 * most * m.part, peak)


def _fading(u, most, peak):
    out, at = np.empty_like(u), u[0]
    for i, command in enumerate(u.tolist()):
        step = most * max(0.3, 1 - abs(at) / peak)
        at += min(max(command - at, -step), step)
        out[i] = at
    return out


# ---- lag ---------------------------------------------------------------------------------------


def _second_order(u, part, tau):
    return follow(follow(u, part, 0.6 * tau), part, 0.4 * tau)


def _swinging(u, part, tau):
    """A servo of damping 0.5, which overshoots by 16 % and is late by tau."""
    b, a, _ = cont2discrete(([1.0], [tau**2, tau, 1.0]), part)
    return u[0] + lfilter(b.ravel(), a, u - u[0])


def _uneven(u, part, tau):
    """Slower up than down: the inertia is overcome by the motor, the friction helps to stop."""
    out, at = np.empty_like(u), u[0]
    up, down = (1 - np.exp(-part / (share * tau)) for share in (1.3, 0.5))
    for i, command in enumerate(u.tolist()):
        end = at + (command - at) * (up if abs(command) > abs(at) else down)
        out[i], at = (at + end) / 2, end
    return out


def second_order_lag(m, tau):
    m.v[:], m.w[:] = _second_order(m.v, m.part, tau), _second_order(m.w, m.part, tau)


def swinging_lag(m, tau):
    m.v[:], m.w[:] = _swinging(m.v, m.part, tau), _swinging(m.w, m.part, tau)


def uneven_lag(m, tau):
    m.v[:], m.w[:] = _uneven(m.v, m.part, tau), _uneven(m.w, m.part, tau)


def axis_lag(m, tau):
    m.v[:], m.w[:] = follow(m.v, m.part, tau), follow(m.w, m.part, 0.4 * tau)


def wheel_lag(m, tau):
    """The left wheel is slower than the right one."""
    left, right = m.v - m.w * TRACK / 2, m.v + m.w * TRACK / 2
    left, right = follow(left, m.part, tau), follow(right, m.part, 0.8 * tau)
    m.v[:], m.w[:] = (left + right) / 2, (right - left) / TRACK


def second_order_speed_lag(m, tau):
    m.v[:] = _second_order(m.v, m.part, tau)


def swinging_speed_lag(m, tau):
    m.v[:] = _swinging(m.v, m.part, tau)


def uneven_speed_lag(m, tau):
    m.v[:] = _uneven(m.v, m.part, tau)


def second_order_yaw_lag(m, tau):
    m.w[:] = _second_order(m.w, m.part, tau)


def swinging_yaw_lag(m, tau):
    m.w[:] = _swinging(m.w, m.part, tau)


def uneven_yaw_lag(m, tau):
    m.w[:] = _uneven(m.w, m.part, tau)


# ---- gains and offsets -------------------------------------------------------------------------


def speed_gain_with_speed(m, a):
    m.v *= 1 + a * (1 + 0.25 * (np.abs(m.v) - 1))


def speed_gain_with_turn(m, a):
    m.v *= 1 + a * (1 - 0.4 * np.abs(m.w))


def speed_gain_by_direction(m, a):
    m.v *= 1 + a * (1 + 0.3 * np.sign(m.v))


def early_sag(m, loss_at_end):
    m.v *= 1 - loss_at_end * np.expm1(-2.5 * m.passed) / np.expm1(-2.5)


def late_sag(m, loss_at_end):
    """The voltage falls slowly at first and fast towards the end, as that of a lithium cell does."""
    m.v *= 1 - loss_at_end * (0.4 * m.passed + 0.6 * m.passed**4)


def energy_sag(m, loss_at_end):
    """The battery loses by what was driven, not by the clock."""
    used = np.cumsum(np.abs(m.v))
    m.v *= 1 - loss_at_end * used / max(used[-1], 1e-12)


def yaw_gain_with_rate(m, b):
    m.w *= 1 + b * (1 + 0.5 * (np.abs(m.w) - 0.5))


def yaw_gain_with_speed(m, b):
    m.w *= 1 + b * (1 + 0.3 * (np.abs(m.v) - 1))


def asymmetry_with_speed(m, c):
    m.w += c * m.v * (1 + 0.25 * (np.abs(m.v) - 1))


def radius_asymmetry(m, c):
    """One wheel is larger and the other smaller by the same share: in turns the speed changes, too."""
    share = c * TRACK / 2
    m.v[:], m.w[:] = m.v + share * m.w * TRACK / 2, m.w + c * m.v


def wandering_bias(m, d):
    m.w += d * (1 + 0.3 * np.sin(2 * np.pi * m.t / 37))


def moving_bias(m, d):
    """Nothing while the robot stands."""
    m.w += d * -np.expm1(-((m.v / 0.2) ** 2))


def wandering_clock(m, kappa):
    m.h *= 1 + kappa * (1 + 0.3 * np.sin(2 * np.pi * m.t / 45))


def drifting_clock(m, kappa):
    m.h *= 1 + kappa * (0.6 + 0.8 * m.passed)


# ---- slip --------------------------------------------------------------------------------------


def _load(m, B):
    return 0.18 * B * np.abs(m.v * m.w)


def exponential_slip(m, B, C, D, E, lat):
    slip(m, np.clip(-D * np.expm1(-C * _load(m, B)), 0, 1), lat)


def hill_slip(m, B, C, D, E, lat):
    s = (_load(m, B) / 0.6) ** 2
    slip(m, 1.2 * D * s / (1 + s), lat)


def threshold_slip(m, B, C, D, E, lat):
    """The tyres hold up to a lateral acceleration and slide beyond it."""
    slip(m, np.minimum(1.5 * D * np.maximum(_load(m, B) - 0.3, 0), 0.9), lat)


def understeer(m, B, C, D, E, lat):
    """The slip angle grows with v^2 times the curvature: the robot turns less, the faster the wider."""
    m.turn /= 1 + D * m.forward**2


def wheel_slip(m, B, C, D, E, lat):
    """Each wheel loses a share of its own rim speed, which grows with the torque that this speed needs."""
    left, right = (m.forward + side * m.turn * TRACK / 2 for side in (-1, 1))
    left, right = (rim * (1 - D * np.tanh(0.04 * B * rim**2)) for rim in (left, right))
    m.forward[:], m.turn[:] = (left + right) / 2, (right - left) / TRACK


def skid_steer(m, B, C, D, E, lat):
    """The centres of rotation of both tracks move apart, and forward, as the load in turns grows."""
    shift = D * np.tanh(_load(m, B))
    m.turn /= 1 + 2 * shift
    m.left += lat * shift * m.turn
    m.forward *= 1 - 0.2 * shift


def saturating_skid(m, k):
    bend = m.forward * m.turn
    m.left += k * bend / (1 + 0.5 * np.abs(bend))


def threshold_skid(m, k):
    """The tyres hold the first 0.1 m/s2."""
    bend = m.forward * m.turn
    m.left += 1.5 * k * _offset_band(bend, 0.1)


def lagging_skid(m, k):
    """The mass takes half a second to slide outwards."""
    m.left += k * follow(m.forward * m.turn, m.part, 0.5)


# ---- friction ----------------------------------------------------------------------------------


def _lost(speed, most):
    """A speed that is lost, against the direction of motion, down to standstill."""
    return np.sign(speed) * np.maximum(np.abs(speed) - most, 0)


def smooth_friction(m, Fs, Fc, Fv, vs):
    drag(m, lambda v: Fc + (Fs - Fc) / (1 + (v / vs) ** 2) + Fv * np.abs(v), lambda w: np.tanh(w / 0.05))


def lost_speed_friction(m, Fs, Fc, Fv, vs):
    """Coulomb and viscous: a constant speed is lost and a share of the speed."""
    m.forward[:] = (1 - Fv) * _lost(m.forward, 0.5 * Fc)
    m.turn[:] = (1 - Fv) * _lost(m.turn, 0.1 * Fc)


def quadratic_friction(m, Fs, Fc, Fv, vs):
    """Viscous, of a motor whose torque falls as it turns faster: the loss grows with the square of the speed."""
    m.forward *= 1 / (1 + Fc * np.abs(m.forward))
    m.turn *= 1 / (1 + 0.3 * Fc * np.abs(m.turn))


def wheel_friction(m, Fs, Fc, Fv, vs):
    """Each wheel loses a constant speed at its rim, and stands below it."""
    left, right = (_lost(m.forward + side * m.turn * TRACK / 2, 0.4 * Fc) for side in (-1, 1))
    m.forward[:], m.turn[:] = (left + right) / 2, (right - left) / TRACK


def bristles(speed, part, stretch):
    """LuGre's bristles: their deflection over the one at which they slide, -1 to 1; `stretch` is that way or angle."""
    out, at = np.empty_like(speed), 0.0
    for i, v in enumerate(speed.tolist()):
        end = np.sign(v) if v else at
        at = end + (at - end) * np.exp(-abs(v) * part / stretch)
        out[i] = at
    return out


def presliding_friction(m, Fs, Fc, Fv, vs):
    """Friction builds up over the first 0.1 m after a reversal (LuGre)."""
    for u, most, stretch in ((m.forward, 0.6 * Fc, 0.1), (m.turn, 0.15 * Fc, 0.1)):
        u -= np.clip(most * bristles(u, m.part, stretch), -np.abs(u), np.abs(u))


# ---- wind and sensors --------------------------------------------------------------------------


def wandering_drift(m, wx, wy):
    swing = 0.3 * np.sin(2 * np.pi * m.t / 53)
    m.wind += (wx + 1j * wy) * (1 + swing) * np.exp(1j * np.sin(2 * np.pi * m.t / 41) / 3)


def growing_drift(m, wx, wy):
    m.wind += (wx + 1j * wy) * (0.5 + m.passed)


def swaying_arm(s, lx, ly):
    s.z += (lx + 1j * ly) * (1 + 0.15 * np.sin(2 * np.pi * s.t / 31)) * np.exp(1j * s.theta)


def yielding_arm(s, lx, ly):
    """The mount gives way in the course of the log."""
    s.z += (lx + 1j * ly) * (0.8 + 0.4 * s.passed) * np.exp(1j * s.theta)


def compass_bias(s, delta):
    s.theta += delta * (1 + 0.3 * np.sin(s.theta))


def soft_iron_bias(s, delta):
    """Iron on the robot bends the field twice per turn."""
    s.theta += delta * (1 + 0.3 * np.sin(2 * s.theta))
