"""Every other form of the blind check's plant against what can be computed for it by hand: a limit, a step, a ramp."""

from types import SimpleNamespace

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.blind import drives, forms, plant, tiers
from tinykoop.blind.plant import Cause

PART, DT = 0.005, 0.05
ROWS = 4000
T = np.arange(ROWS) * PART
CHECKS = {}
SLIP = {"B": 10.0, "C": 1.6, "D": 0.2, "E": 0.3, "lat": 0.45}
RUB = {"Fs": 0.4, "Fc": 0.2, "Fv": 0.05, "vs": 1.0}


def of(name):
    """The check of a form."""

    def keep(check):
        CHECKS[name] = check
        return check

    return keep


def signals(v, w=0.0):
    v, w = np.broadcast_to(v, ROWS).astype(float), np.broadcast_to(w, ROWS).astype(float)
    z = np.zeros(ROWS)
    return SimpleNamespace(
        t=T, passed=T / T[-1], v=v.copy(), w=w.copy(), forward=v.copy(), left=z.copy(), turn=w.copy(), wind=z.astype(complex),
        h=np.full(ROWS, PART), dt=DT, part=PART, random=np.random.default_rng(0),
    )  # fmt: skip


def after(form, v, w=0.0, **parameters):
    m = signals(v, w)
    getattr(forms, form)(m, **parameters)
    return m


def rims(m, track):
    return m.v - m.w * track / 2, m.v + m.w * track / 2


def step(low, high, at=2.0):
    return np.where(at - 1e-9 > T, low, high)


def first(where):
    """The time of the first part that fulfils it."""
    return T[np.argmax(where)]


def near(value, **tolerance):
    return pytest.approx(value, **({"rel": 1e-6, "abs": 1e-9} | tolerance))


# ---- saturation --------------------------------------------------------------------------------


@of("soft_saturation")
def _():
    m = after("soft_saturation", np.linspace(-50, 50, ROWS), 0.5, v_max=1.0, w_max=0.5)
    assert m.v[-1] == near(1, rel=1e-4) and m.v[0] == near(-1, rel=1e-4) and m.w[0] == near(0.5 / 2 ** (1 / 6))
    assert after("soft_saturation", 0.3, 0.1, v_max=1.0, w_max=0.5).v[0] == near(0.3, rel=1e-3)


@of("tanh_saturation")
def _():
    m = after("tanh_saturation", np.linspace(-50, 50, ROWS), 1e-4, v_max=1.0, w_max=0.5)
    assert np.ptp(m.v) == near(2) and m.w[0] == near(1e-4)
    bend = after("tanh_saturation", 1.0, 0, v_max=1.0, w_max=0.5).v[0]
    assert bend == near((np.e**2 - 1) / (np.e**2 + 1))


@of("curvature_keeping_saturation")
def _():
    v, w = np.linspace(-3, 3, ROWS), 0.4
    m = after("curvature_keeping_saturation", v, w, v_max=1.0, w_max=0.8)
    assert np.max(np.abs(m.v)) == near(1) and np.allclose(m.w * v, w * m.v)
    m = after("curvature_keeping_saturation", 0.5, 1.6, v_max=1.0, w_max=0.8)
    assert (m.v[0], m.w[0]) == (near(0.25), near(0.8))


@of("one_sided_saturation")
def _():
    m = after("one_sided_saturation", np.linspace(-3, 3, ROWS), np.linspace(-3, 3, ROWS), v_max=1.0, w_max=0.5)
    assert (m.v.min(), m.v.max(), m.w.min(), m.w.max()) == (near(-0.6), near(1), near(-0.4), near(0.5))


@of("soft_wheel_saturation")
def _():
    m = after("soft_wheel_saturation", 40.0, 100.0, v_max=1.0, track=0.4)
    assert rims(m, 0.4)[0][0] == near(1, rel=1e-3) and rims(m, 0.4)[1][0] == near(1, rel=1e-3)
    assert after("soft_wheel_saturation", 0.1, 0.2, v_max=1.0, track=0.4).w[0] == near(0.2, rel=1e-3)


@of("curvature_keeping_wheel_saturation")
def _():
    v, w = np.linspace(-3, 3, ROWS), np.linspace(1, -2, ROWS)
    m = after("curvature_keeping_wheel_saturation", v, w, v_max=1.0, track=0.4)
    assert np.max(np.abs(rims(m, 0.4))) == near(1) and np.allclose(m.w * v, w * m.v)


@of("weak_wheel_saturation")
def _():
    left, right = rims(after("weak_wheel_saturation", np.linspace(-3, 3, ROWS), v_max=1.0, track=0.4), 0.4)
    assert np.max(np.abs(left)) == near(0.85) and np.max(np.abs(right)) == near(1)
    m = after("weak_wheel_saturation", 0.3, 0.5, v_max=1.0, track=0.4)
    assert (m.v[0], m.w[0]) == (near(0.3), near(0.5))  # below the limits


# ---- delay -------------------------------------------------------------------------------------


@of("jittery_delay")
def _():
    m = after("jittery_delay", T, 2 * T, delay=0.2)
    late = (T - m.v)[T > 0.5]
    assert np.mean(late) == near(0.2, rel=0.02) and 0.155 < late.min() < 0.17 and 0.23 < late.max() < 0.245
    assert np.allclose(m.w, 2 * m.v)


@of("axis_delay")
def _():
    m = after("axis_delay", step(0, 1), step(0, 1), delay=0.2)
    assert (first(m.v > 0), first(m.w > 0)) == (near(2.2), near(2.08))


@of("polled_delay")
def _():
    late = (T - after("polled_delay", T, delay=0.2).v)[T < 19.9]
    assert np.mean(late) == near(0.2, rel=0.03) and late.max() == near(0.4, rel=0.03) and late.min() == near(0)


# ---- dead band ---------------------------------------------------------------------------------


@of("smooth_dead_band")
def _():
    m = after("smooth_dead_band", np.linspace(0, 1, ROWS), 0.2, v_db=0.2, w_db=0.1)
    assert m.v[200] < 0.01 * 0.05 and m.v[-1] == near(1) and m.w[0] == near(0.2, rel=1e-6)


@of("offset_dead_band")
def _():
    m = after("offset_dead_band", np.linspace(-1, 1, ROWS), 0.3, v_db=0.2, w_db=0.1)
    assert m.v[-1] == near(0.8) and m.v[0] == near(-0.8) and m.w[0] == near(0.2) and np.mean(m.v == 0) == near(0.2, rel=0.01)


@of("hysteresis_dead_band")
def _():
    ramp = 1 - np.abs(np.linspace(-1, 1, ROWS))  # up, then down
    m = after("hysteresis_dead_band", ramp, v_db=0.2, w_db=0.1)
    moves = ramp[m.v > 0]
    assert (moves[0], moves[-1]) == (near(0.24, rel=0.01), near(0.1, rel=0.01))
    turns = ramp[after("hysteresis_dead_band", 0, ramp, v_db=0.2, w_db=0.1).w > 0]
    assert (turns[0], turns[-1]) == (near(0.12, rel=0.01), near(0.05, rel=0.01))


@of("moving_dead_band")
def _():
    for v, turns in ((0.0, False), (1.0, True)):
        assert (after("moving_dead_band", v, 0.08, v_db=0.2, w_db=0.1).w[0] > 0) == turns
        assert after("moving_dead_band", v, 0.048, v_db=0.2, w_db=0.1).w[0] == 0
    assert after("moving_dead_band", 1.0, 0.052, v_db=0.2, w_db=0.1).w[0] > 0
    assert after("moving_dead_band", 0.11, 0.08, v_db=0.2, w_db=0.1).w[0] > 0
    assert after("moving_dead_band", 0.15, 0.3, v_db=0.2, w_db=0.1).v[0] == 0


def _of_both_wheels(name, axis):
    """Straight on, each wheel is the whole robot; turning on the spot, each has w track / 2."""
    ramp = np.linspace(-1, 1, ROWS)
    straight = after(name, ramp, v_db=0.2, track=0.4)
    turning = after(name, 0, ramp / 0.2, v_db=0.2, track=0.4)
    expected = after(axis, ramp, v_db=0.2, w_db=1.0).v
    assert np.allclose(straight.v, expected) and np.allclose(straight.w, 0)
    assert np.allclose(0.2 * turning.w, expected, atol=2e-3) and np.allclose(turning.v, 0, atol=2e-3)


for _wheel, _axis in (
    ("smooth_wheel_dead_band", "smooth_dead_band"),
    ("offset_wheel_dead_band", "offset_dead_band"),
    ("hysteresis_wheel_dead_band", "hysteresis_dead_band"),
):
    of(_wheel)(lambda wheel=_wheel, axis=_axis: _of_both_wheels(wheel, axis))


# ---- backlash ----------------------------------------------------------------------------------


@of("spread_backlash")
def _():
    """The plays are half_width on average, so a large swing comes out smaller by that."""
    m = after("spread_backlash", 0, np.sin(T), half_width=0.1)
    assert m.w[T > 5].max() == near(0.9, rel=1e-4) and m.w[T > 5].min() == near(-0.9, rel=1e-4)


@of("angle_backlash")
def _():
    """10 s to the left and 10 s back: half the play is lost on the way out and all of it on the way back."""
    turned = np.cumsum(after("angle_backlash", 0, step(1, -1, 10), half_width=0.1).w) * PART
    assert turned.max() == near(9.9) and turned[-1] == near(9.9 - 9.8)


@of("wheel_angle_backlash")
def _():
    m = after("wheel_angle_backlash", step(1, -1, 10), half_width=0.1)
    way = np.cumsum(m.v) * PART
    assert way.max() == near(10 - 0.04) and way[-1] == near(0.04) and np.allclose(m.w, 0)


@of("wheel_speed_backlash")
def _():
    m = after("wheel_speed_backlash", 0, np.sin(T), half_width=0.1)
    assert m.w[T > 5].max() == near(0.9, rel=1e-4) and np.allclose(m.v, 0)


# ---- acceleration ------------------------------------------------------------------------------


@of("wheel_acceleration_limit")
def _():
    m = after("wheel_acceleration_limit", step(0, 1), a=0.5, alpha=9.0)
    assert first(m.v > 1 - 1e-9) == near(4, abs=PART) and np.allclose(m.w, 0)
    turning = after("wheel_acceleration_limit", 0, step(0, 4), a=0.5, alpha=9.0)
    assert first(turning.w > 4 - 1e-9) == near(2 + 4 * forms.TRACK / 2 / 0.5, abs=PART)


@of("braking_acceleration_limit")
def _():
    m = after("braking_acceleration_limit", np.where(T < 2, 0, np.where(T < 10, 1, 0)), a=0.5, alpha=0.3)
    assert first(m.v > 1 - 1e-9) == near(2 + 1 / 0.4, abs=2 * PART) and first((T > 10) & (m.v < 1e-9)) == near(11, abs=2 * PART)


@of("fading_acceleration_limit")
def _():
    """v' = 1.3 a (1 - v / 3): the speed comes up as an exponential until it is there."""
    m = after("fading_acceleration_limit", step(0, 1), a=0.5, alpha=0.3)
    rise = -3 * np.log(1 - 1 / 3) / 0.65
    assert first(m.v > 1 - 1e-9) == near(2 + rise, abs=2 * PART)
    half = (T > 2) & (2 + rise > T)
    assert np.allclose(m.v[half], 3 * -np.expm1(-0.65 * (T[half] - 2) / 3), atol=0.01)
    m = after("fading_acceleration_limit", 0, step(0, 1), a=0.5, alpha=0.3)
    assert first(m.w > 0.5) == near(2 - 1.5 * np.log(1 - 0.5 / 1.5) / 0.39, abs=2 * PART)
    fast = after("fading_acceleration_limit", step(2.5, 9), a=0.5, alpha=0.3).v
    assert np.diff(fast)[ROWS // 5] == near(0.3 * 0.65 * PART)  # 30 % of the torque stay


# ---- lag ---------------------------------------------------------------------------------------

TAU, S = 0.4, T[T >= 2] - 2 + PART / 2


def response(form, axis="v", low=0.0, high=1.0):
    m = after(form, step(low, high), step(low, high), tau=TAU)
    return getattr(m, axis)[T >= 2 - 1e-9]


def rise(tau):
    return -np.expm1(-S / tau)


def two_lags():
    a, b = 0.6 * TAU, 0.4 * TAU
    return 1 - (a * np.exp(-S / a) - b * np.exp(-S / b)) / (a - b)


def swings(form, axis):
    """Damping 0.5: it overshoots by exp(-pi 0.5 / sqrt(0.75)), half a damped period after the step."""
    y = response(form, axis)
    assert y.max() == near(1 + np.exp(-np.pi * 0.5 / np.sqrt(0.75)), rel=1e-3)
    assert S[np.argmax(y)] == near(np.pi * TAU / np.sqrt(0.75), rel=0.02)
    assert np.sum(1 - y) * PART == near(TAU, rel=0.02)  # late by tau


def uneven(form, axis):
    assert np.allclose(response(form, axis), rise(1.3 * TAU), atol=0.01)
    assert np.allclose(response(form, axis, 1.0, 0.0), np.exp(-S / (0.5 * TAU)), atol=0.01)


def lags_alone(form, other):
    """The other axis is not late."""
    assert np.array_equal(response(form, other), np.ones_like(S))


for _name, _axes in (("", "vw"), ("speed_", "v"), ("yaw_", "w")):
    of(f"second_order_{_name}lag")(
        lambda name=_name, axes=_axes: [
            np.testing.assert_allclose(response(f"second_order_{name}lag", axis), two_lags(), atol=0.01) for axis in axes
        ]
    )
    of(f"swinging_{_name}lag")(lambda name=_name, axes=_axes: [swings(f"swinging_{name}lag", axis) for axis in axes])
    of(f"uneven_{_name}lag")(lambda name=_name, axes=_axes: [uneven(f"uneven_{name}lag", axis) for axis in axes])


@pytest.mark.parametrize("kind", ["second_order", "swinging", "uneven"])
def test_lag_of_one_axis_leaves_the_other(kind):
    lags_alone(f"{kind}_speed_lag", "w")
    lags_alone(f"{kind}_yaw_lag", "v")


@of("axis_lag")
def _():
    assert np.allclose(response("axis_lag", "v"), rise(TAU), atol=0.01) and np.allclose(
        response("axis_lag", "w"), rise(0.4 * TAU), atol=0.02
    )


@of("wheel_lag")
def _():
    m = after("wheel_lag", step(0, 1), tau=TAU)
    left, right = (rim[T >= 2 - 1e-9] for rim in rims(m, forms.TRACK))
    assert np.allclose(left, rise(TAU), atol=0.01) and np.allclose(right, rise(0.8 * TAU), atol=0.01)
    m = after("wheel_lag", 0, step(0, 1), tau=TAU)
    assert m.w[-1] == near(1) and np.allclose(rims(m, forms.TRACK)[0][T >= 2 - 1e-9], -forms.TRACK / 2 * rise(TAU), atol=0.01)


# ---- gains and offsets -------------------------------------------------------------------------


def share(form, key, v, w, **parameters):
    return getattr(after(form, v, w, **parameters), key)[0] / {"v": v, "w": w}[key] - 1


@of("speed_gain_with_speed")
def _():
    low, mid, high = (share("speed_gain_with_speed", "v", v, 0.5, a=0.1) for v in (0.2, 1.0, 2.0))
    assert mid == near(0.1) and low == near(0.08) and high == near(0.125)


@of("speed_gain_with_turn")
def _():
    assert share("speed_gain_with_turn", "v", 1.0, 0.0, a=0.1) == near(0.1)
    assert share("speed_gain_with_turn", "v", 1.0, -1.0, a=0.1) == near(0.06)


@of("speed_gain_by_direction")
def _():
    assert share("speed_gain_by_direction", "v", 1.0, 0.0, a=0.1) == near(0.13)
    assert share("speed_gain_by_direction", "v", -1.0, 0.0, a=0.1) == near(0.07)


def sagging(form):
    loss = 1 - after(form, 1.0, loss_at_end=0.2).v
    assert loss[0] == near(0, abs=1e-4) and loss[-1] == near(0.2) and np.all(np.diff(loss) >= -1e-12)
    return loss[ROWS // 2]


of("early_sag")(lambda: None if sagging("early_sag") > 0.13 else pytest.fail("as late as linear"))


@of("late_sag")
def _():
    """Half of the time, a quarter of the loss; the last tenth of the time takes a quarter of it, too."""
    assert sagging("late_sag") == near(0.2 * (0.2 + 0.6 / 16), rel=1e-3)
    assert 1 - after("late_sag", 1.0, loss_at_end=0.2).v[ROWS * 9 // 10] == near(0.2 * (0.36 + 0.6 * 0.6561), rel=1e-3)


@of("energy_sag")
def _():
    """A robot that stands in the second half loses nothing in it."""
    m = after("energy_sag", np.where(T < 10, 1.0, 1e-12), loss_at_end=0.2)
    assert m.v[ROWS // 4] == near(0.9, rel=1e-3) and m.v[ROWS // 2 - 1] == near(0.8) and m.v[-1] == near(0.8e-12, abs=1e-15)


@of("yaw_gain_with_rate")
def _():
    assert share("yaw_gain_with_rate", "w", 1.0, 0.5, b=0.1) == near(0.1) and share("yaw_gain_with_rate", "w", 1.0, -1.0, b=0.1) == near(
        0.125
    )


@of("yaw_gain_with_speed")
def _():
    assert share("yaw_gain_with_speed", "w", -1.0, 0.5, b=0.1) == near(0.1) and share("yaw_gain_with_speed", "w", 2.0, 0.5, b=0.1) == near(
        0.13
    )


@of("asymmetry_with_speed")
def _():
    turns = [after("asymmetry_with_speed", v, c=0.04).w[0] / v for v in (-1.0, 2.0)]
    assert turns == [near(0.04), near(0.05)]


@of("radius_asymmetry")
def _():
    """The right wheel is larger by a share of c track / 2 and the left one smaller."""
    m = after("radius_asymmetry", 1.2, 0.7, c=0.04)
    left, right = rims(m, forms.TRACK)
    assert left[0] == near((1.2 - 0.175) * 0.99) and right[0] == near((1.2 + 0.175) * 1.01)


def one_wave(values):
    """Mean over the log, and size of the wave that has one period in it."""
    spectrum = np.abs(np.fft.rfft(values)) / len(values)
    assert np.max(spectrum[2:]) < 2e-3 * spectrum[1]
    return spectrum[0], 2 * spectrum[1]


@of("wandering_bias")
def _():
    m = signals(0)
    m.t = T * 37 / 20  # one period
    forms.wandering_bias(m, d=0.05)
    assert one_wave(m.w) == (near(0.05, rel=1e-3), near(0.3 * 0.05, rel=1e-3))


@of("moving_bias")
def _():
    assert after("moving_bias", 0.0, d=0.05).w[0] == 0 and after("moving_bias", -1.0, d=0.05).w[0] == near(0.05)


@of("wandering_clock")
def _():
    m = signals(0)
    m.t = T * 45 / 20
    forms.wandering_clock(m, kappa=0.05)
    assert one_wave(m.h / PART - 1) == (near(0.05, rel=1e-3), near(0.3 * 0.05, rel=1e-3))


@of("drifting_clock")
def _():
    m = after("drifting_clock", 0, kappa=0.05)
    assert np.sum(m.h) == near(1.05 * 20) and np.all(np.diff(m.h) > 0)


# ---- slip --------------------------------------------------------------------------------------


def lost(form, v, w, **changes):
    """(share of the speed lost, share of the turn lost, sideways over speed) of a steady drive."""
    m = after(form, v, w, **(SLIP | changes))
    return 1 - m.forward[0] / v if v else 0.0, 1 - m.turn[0] / w if w else 0.0, m.left[0] / v if v else m.left[0]


def no_load_no_slip(form):
    assert lost(form, 1.5, 0.0) == (near(0), near(0), near(0)) and lost(form, 0.0, 1.0)[:2] == (near(0), near(0))


@of("exponential_slip")
def _():
    no_load_no_slip("exponential_slip")
    assert lost("exponential_slip", 20.0, 20.0) == (near(0.06), near(0.14), near(0.09))
    slope = lost("exponential_slip", 0.01, 0.01)[1]
    assert slope == near(0.7 * 0.2 * 1.6 * 1.8e-4, rel=1e-3)


@of("hill_slip")
def _():
    no_load_no_slip("hill_slip")
    top, half = lost("hill_slip", 100.0, 100.0)[1], lost("hill_slip", 1.0, 0.6 / 1.8)[1]
    assert top == near(0.7 * 0.24, rel=1e-5) and half == near(top / 2, rel=1e-4)
    assert lost("hill_slip", 1.0, 0.2 / 1.8)[1] == near(top / 10, rel=1e-4)  # a third of that load, 1 / (1 + 9)


@of("threshold_slip")
def _():
    assert lost("threshold_slip", 1.0, 0.29 / 1.8) == (near(0), near(0), near(0))
    assert lost("threshold_slip", 1.0, 0.5 / 1.8)[1] == near(0.7 * 1.5 * 0.2 * 0.2)
    assert lost("threshold_slip", 10.0, 10.0)[1] == near(0.7 * 0.9)


@of("understeer")
def _():
    """The radius of the circle grows by a share of D v^2, however small it is."""
    for v, w in ((1.0, 0.2), (1.0, 0.9), (2.0, 0.2)):
        m = after("understeer", v, w, **SLIP)
        assert m.forward[0] / m.turn[0] == near(v / w * (1 + 0.2 * v**2)) and m.forward[0] == v


@of("wheel_slip")
def _():
    """Straight on both wheels lose alike; in a turn the outer one loses more; no wheel gains."""
    speed, turn, _ = lost("wheel_slip", 1.5, 0.0)
    assert speed == near(0.2 * np.tanh(0.4 * 2.25)) and turn == 0
    m = after("wheel_slip", 1.0, 1.0, **SLIP)
    left, right = (m.forward[0] + side * m.turn[0] * forms.TRACK / 2 for side in (-1, 1))
    assert 0.75 > left > 0.75 * 0.8 and 1.25 > right > 1.25 * 0.8 and 1 - right / 1.25 > 1 - left / 0.75


@of("skid_steer")
def _():
    """The tracks' centres of rotation end 1 + 2 D apart, and the body's in front of it."""
    no_load_no_slip("skid_steer")
    m = after("skid_steer", 10.0, 10.0, **SLIP)
    assert 10 / m.turn[0] == near(1.4) and m.left[0] / m.turn[0] == near(0.45 * 0.2) and m.forward[0] == near(10 * (1 - 0.2 * 0.2))
    right = after("skid_steer", 10.0, -10.0, **SLIP)
    assert right.left[0] == near(-m.left[0]) and right.turn[0] == near(-m.turn[0])


@of("saturating_skid")
def _():
    assert after("saturating_skid", 1e-3, 1e-3, k=0.1).left[0] == near(1e-7, rel=1e-5)
    assert after("saturating_skid", 1e4, -1e4, k=0.1).left[0] == near(-0.2, rel=1e-5)


@of("threshold_skid")
def _():
    assert after("threshold_skid", 0.3, 0.3, k=0.1).left[0] == 0 and after("threshold_skid", 1.0, -0.3, k=0.1).left[0] == near(-0.03)


@of("lagging_skid")
def _():
    m = after("lagging_skid", step(0, 1), 0.5, k=0.1)
    assert np.allclose(m.left[T >= 2 - 1e-9], 0.05 * rise(0.5), atol=1e-3)


# ---- friction ----------------------------------------------------------------------------------


@of("smooth_friction")
def _():
    """Fs at a crawl, Fc and the viscous part at speed; the turn's friction goes through zero smoothly."""
    for v, left in ((1e-6, 1 - 0.4), (100.0, 1 - 0.2 - 0.05 * 100)):
        assert after("smooth_friction", v, **RUB).forward[0] / v == near(left, rel=1e-3)
    assert np.max(np.abs(np.diff(after("smooth_friction", 0, np.linspace(-1, 1, ROWS), **RUB).turn))) < 3 * 2 / ROWS
    losses = [w - after("smooth_friction", 0, w, **RUB).turn[0] for w in (0.05, 1e3)]
    assert losses[0] == near(0.1 * (0.2 + 0.2 / 1.0025 + 0.0025) * np.tanh(1)) and losses[1] == near(0.1 * (0.2 + 0.05 * 1e3), rel=1e-3)


@of("lost_speed_friction")
def _():
    m = after("lost_speed_friction", np.linspace(-2, 2, ROWS), 0.015, **RUB)
    assert m.forward[-1] == near(0.95 * 1.9) and m.forward[0] == near(-0.95 * 1.9) and m.turn[0] == 0
    assert np.mean(m.forward == 0) == near(0.05, rel=0.02)
    assert after("lost_speed_friction", 0, -0.5, **RUB).turn[0] == near(-0.95 * 0.48)


@of("quadratic_friction")
def _():
    losses = [1 - after("quadratic_friction", v, **RUB).forward[0] / v for v in (0.01, 0.02)]
    assert losses[1] == near(2 * losses[0], rel=0.01) and losses[0] == near(0.2 * 0.01, rel=0.01)
    assert 1 - after("quadratic_friction", 0, 0.01, **RUB).turn[0] / 0.01 == near(0.06 * 0.01, rel=0.01)


@of("wheel_friction")
def _():
    m = after("wheel_friction", 1.0, **RUB)
    assert m.forward[0] == near(1 - 0.08) and m.turn[0] == near(0)
    pivot = after("wheel_friction", 0.05, 1.0, **RUB)  # the left wheel turns at -0.2, the right one at 0.3
    assert pivot.forward[0] == near((-0.12 + 0.22) / 2) and pivot.turn[0] == near(0.34 / forms.TRACK)
    assert after("wheel_friction", 0.07, **RUB).forward[0] == 0


@of("presliding_friction")
def _():
    """Steady motion loses 0.6 Fc; after a reversal what is lost changes over some 0.1 m of way, as in LuGre's model."""
    m = after("presliding_friction", step(1, -1, 10), **RUB)
    assert m.forward[ROWS // 2 - 1] == near(1 - 0.12) and m.forward[-1] == near(-1 + 0.12)
    way = (np.arange(ROWS // 2) + 1) * PART
    felt = (-1 - m.forward[ROWS // 2 :]) / 0.12
    assert np.allclose(felt, -1 + 2 * np.exp(-way / 0.1), atol=1e-6)
    m = after("presliding_friction", 0, step(0, 0.5, 10), **RUB)
    turned = (np.arange(ROWS // 2) + 1) * PART * 0.5
    assert np.allclose((0.5 - m.turn[ROWS // 2 :]) / 0.03, -np.expm1(-turned / 0.1), atol=1e-6) and np.all(m.turn[: ROWS // 2] == 0)


# ---- wind and sensors --------------------------------------------------------------------------


@of("wandering_drift")
def _():
    """Its strength has a period of 53 s and its direction one of 41 s."""
    m = signals(0)
    m.t = T * 53 / 20
    forms.wandering_drift(m, wx=0.03, wy=0.04)
    assert one_wave(np.abs(m.wind)) == (near(0.05, rel=1e-3), near(0.3 * 0.05, rel=1e-3))
    m = signals(0)
    m.t = T * 41 / 20
    forms.wandering_drift(m, wx=0.03, wy=0.04)
    assert one_wave(np.angle(m.wind / m.wind[0])) == (near(0, abs=1e-3), near(1 / 3, rel=1e-3))


@of("growing_drift")
def _():
    wind = after("growing_drift", 0, wx=0.03, wy=0.04).wind
    assert np.mean(wind) == near(0.03 + 0.04j) and wind[-1] == near(3 * wind[0])


def sensed(form, **parameters):
    s = SimpleNamespace(t=T, passed=T / T[-1], z=np.full(ROWS, 1 + 2j), theta=2 * np.pi * T / T[-1], dt=DT)
    getattr(forms, form)(s, **parameters)
    return s


@of("swaying_arm")
def _():
    s = SimpleNamespace(t=T * 31 / 20, z=np.full(ROWS, 1 + 2j), theta=np.full(ROWS, 0.7))
    forms.swaying_arm(s, lx=0.3, ly=0.4)
    arm = (s.z - 1 - 2j) * np.exp(-0.7j)
    assert np.allclose(np.angle(arm), np.angle(0.3 + 0.4j))
    assert one_wave(np.abs(arm)) == (near(0.5, rel=1e-3), near(0.15 * 0.5, rel=1e-3))


@of("yielding_arm")
def _():
    arm = (sensed("yielding_arm", lx=0.3, ly=0.4).z - 1 - 2j) * np.exp(-2j * np.pi * T / T[-1])
    assert arm[0] == near(0.8 * (0.3 + 0.4j)) and arm[-1] == near(1.2 * (0.3 + 0.4j))


def compass(form, waves):
    """Over a full turn the bias is delta on average, and a wave with so many periods."""
    wave = sensed(form, delta=0.1).theta - 2 * np.pi * T / T[-1]
    spectrum = np.abs(np.fft.rfft(wave[:-1])) / (ROWS - 1)
    assert spectrum[0] == near(0.1, rel=1e-3) and 2 * spectrum[waves] == near(0.03, rel=1e-2)


of("compass_bias")(lambda: compass("compass_bias", 1))
of("soft_iron_bias")(lambda: compass("soft_iron_bias", 2))


# ---- all ---------------------------------------------------------------------------------------

ALL = {form: name for name, choice in plant.OTHER.items() for form in choice}


def test_every_form_is_checked():
    assert set(CHECKS) == set(ALL)


@pytest.mark.parametrize("form", CHECKS)
def test_form(form):
    CHECKS[form]()


def test_families_have_several_forms():
    counts = {}
    for name, choice in plant.OTHER.items():
        counts[plant.family(name)] = counts.get(plant.family(name), 0) + len(choice)
    assert all(counts[kind] >= 3 for kind in ("slip", "friction", "dead_band", "saturation", "backlash", "lag"))
    assert all(count >= 2 for count in counts.values())


@pytest.mark.parametrize("form", ALL)
def test_other_form_acts_and_is_not_the_plain_one(form):
    name, random = ALL[form], np.random.default_rng(1)
    u = drives.rich(random, 1200, DT)[0]
    parameters = tiers.known(random, name, u)
    other, plain = (plant.simulate(u, DT, [Cause(name, parameters, shape, form=form)], random=np.random.default_rng(0))
                    for shape in ("other", "plain"))  # fmt: skip
    assert np.all(np.isfinite(other)) and tiers.gap(other, u, DT)["50"] > 2e-3 and np.max(np.abs(other - plain)) > 1e-3


@pytest.mark.parametrize(
    "name", [name for name in plant.OTHER if name in bridge.effects() and name not in (*tiers.TYPICAL, "wheel_dead_band")]
)
def test_plain_form_explains_the_first_other_one(name):
    """In the size that both share; the other forms may need another size."""
    u = drives.rich(np.random.default_rng(1), 1200, DT)[0]
    usual = {row[0]: row[4] for row in bridge.effects()[name][1]} | {"wheel_dead_band": {"v_db": 0.4}}.get(name, {})
    x = plant.simulate(u, DT, [Cause(name, usual, "other")], (0.3, -0.2, 2.0), np.random.default_rng(0))
    explained = tiers.gap(x, u, DT, active=[bridge.Effect(name, tuple(usual.values()))])["50"]
    assert 1e-4 < explained < 0.75 * tiers.gap(x, u, DT)["50"]
