"""What explains a difference between flights, block by block, from features made by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.diagnose.platforms.quadrotor import advise, baseline, features
from tinykoop.diagnose.platforms.quadrotor.changes import SURE, Cause, Changes
from tinykoop.diagnose.platforms.quadrotor.features import NAMES, Features

MEAN = 0.6
SPREAD = np.full(len(NAMES), 0.002)
SPREAD[NAMES.index("swing")], SPREAD[NAMES.index("vibration")] = 0.1, 0.03


def changes(without=(), **changed):
    """Changes of a flight that differs from one healthy flight in the features given, by name with underscores."""
    healthy = np.zeros(len(NAMES))
    healthy[0] = MEAN
    values = healthy.copy()
    for name, value in changed.items():
        values[NAMES.index(name.replace("_", " "))] += value
    of = lambda v: Features(v, np.zeros(len(NAMES)), 3.5, 20.0, 0.5)  # noqa: E731
    known = baseline.Baseline((of(healthy),), SPREAD, False, (baseline.VOLTS, baseline.VOLTS_SD))
    return Changes(of(values), known, bridge.quadrotor_vehicle(), tuple(without))


def test_nothing_changed_is_nothing():
    assert not changes().best


@pytest.mark.parametrize("feature", ["drift", "swing"])
def test_what_differs_in_one_feature_as_by_no_cause_is_something_else(feature):
    found = changes(without=("battery_sag", "slung_load"), **{feature: 7 * SPREAD[NAMES.index(feature)]})
    assert found.unexplained == ["balance"] and not found.named


def test_a_moment_without_its_cause_in_the_library_is_something_else_and_no_strong_rotor():
    found = changes(without=("trim",), roll=-0.012, pitch=-0.011, yaw=0.012)
    assert found.unexplained == ["balance"]


def test_a_rotor_whose_loss_grows_over_the_flight_is_known_in_part_and_with_less_confidence():
    rotor = {"thrust": 0.02, "roll": -0.02, "pitch": 0.02, "yaw": 0.02}
    constant, fading = changes(**rotor), changes(**rotor, roll_drift=-0.02, pitch_drift=0.02, yaw_drift=0.02)
    assert not constant.unexplained and constant.confidence(constant.named[0]) > 0.9
    assert fading.unexplained == ["course"] and fading.named[0].name == "rotor1_thrust"
    assert fading.confidence(fading.named[0]) == SURE


def test_hardly_any_vibration_is_less_vibration_and_nothing_unknown():
    (cause,) = changes(vibration=-6).named
    assert cause.name == "vibration" and cause.params["a"][0] == pytest.approx(np.expm1(-6), abs=0.01)


def test_a_late_answer_is_named_though_nothing_rings():
    (cause,) = changes(delay=0.009).named
    assert cause.name in ("motor_lag", "transport_delay")


def weight(**more):
    """A weight of 6 % of the mean request near rotor 4."""
    return changes(thrust=0.04, roll=0.03, pitch=0.02, **more)


def test_a_weight_that_does_not_swing_may_hang_all_the_same():
    found = weight()
    (cause,) = found.named
    assert cause.name == "payload" and found.rivals("payload") == ["slung_load"] and found.confidence(cause) < 0.9


def test_a_weight_that_swings_hangs():
    assert weight(swing=1.0).named[0].name == "slung_load"


def test_a_late_answer_is_less_sure_with_a_weight_on_the_vehicle():
    late = Cause("transport_delay", 0.95, 9.0, {})
    assert (changes().confidence(late), weight().confidence(late)) == (0.95, SURE)


def test_advice_leaves_out_a_rival_that_cannot_be():
    found = changes(thrust=-0.05)
    assert found.posteriors["balance"].of("payload") < 1e-6
    assert advise.advise(found, {"thrust_gain": ["payload"]}, "crazyflie") is None


def test_the_thrust_that_carries_a_tilted_vehicle_is_the_same():
    x = np.zeros((1000, 15))
    x[:, 9:11] = 0.2, -0.1
    upright, tilted = (
        SimpleNamespace(t=np.arange(1000) * 0.01, x=states, usable=np.ones(999, bool), dt=0.01,
                        u=np.column_stack([np.full((1000, 4), asked), np.full(1000, 3.5)]))
        for states, asked in ((np.zeros((1000, 15)), MEAN), (x, MEAN / np.cos(0.2) / np.cos(0.1)))
    )  # fmt: skip
    assert features.of(tilted).asked[0] == pytest.approx(features.of(upright).asked[0], rel=1e-9)


def test_healthy_simulated_flights_differ_little_in_thrust_whatever_is_flown():
    known = baseline.simulated()
    assert known.spread[0] < 0.005 * known.flights[0].values[0]
