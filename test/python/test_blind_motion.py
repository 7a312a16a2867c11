"""The blind check's robots that slip at random, and its logs with odometry."""

import numpy as np
import pytest
from tinykoop import blind, bridge
from tinykoop.blind import drives, motion, odometry, plant, tiers
from tinykoop.blind.plant import Cause

DT = 0.05


def straight(rows, v=1.0, w=0.0):
    return np.tile([v, w], (rows, 1))


# ---- random slip -------------------------------------------------------------------------------


def test_slip_has_the_size_and_the_correlation_time_that_it_is_given():
    e = motion.ar1(np.random.default_rng(0), 3, 400000, 0.005, 0.3)
    assert np.allclose(np.std(e, axis=1), 1, atol=0.03)
    assert np.allclose(np.mean(e[:, 60:] * e[:, :-60], axis=1), np.exp(-1), atol=0.04)
    assert np.max(np.abs(np.corrcoef(e) - np.eye(3))) < 0.04
    starts = [motion.ar1(np.random.default_rng(seed), 3, 1, 0.005, 0.3) for seed in range(2000)]
    assert np.std(starts) == pytest.approx(1, abs=0.03)  # from the first row


def test_each_wheel_slips_by_a_share_of_its_own_speed():
    """A robot that turns about its left wheel: that wheel stands still and does not slip."""
    v = motion.TRACK / 2
    m = plant._body(straight(4000, v, 1.0), DT, (), (0, 0, 0), np.random.default_rng(0), {"size": 0.05, "tau": 0.2})
    left, right = m.forward - m.turn * v, m.forward + m.turn * v
    assert np.allclose(left, 0, atol=1e-12) and np.std(right) == pytest.approx(0.05 * 2 * v, rel=0.1)
    assert np.std(m.left) == pytest.approx(0.05 * motion.SIDEWAYS * v, rel=0.1)


def test_robot_that_stands_does_not_slip():
    x = plant.simulate(np.zeros((200, 2)), DT, (), random=np.random.default_rng(0), motion={"size": 0.1, "tau": 0.3})
    assert np.all(x == 0)


def test_floor_of_a_straight_drive_is_that_of_integrated_noise():
    """Turn and sideways slip with a short memory: the variance of the place at T is S_w v^2 T^3 / 3 + (S_v + S_y) T."""
    size, tau, steps = 0.03, 0.02, 50
    found = tiers.wandering(straight(4000), DT, (), (0, 0, 0.4), {"size": size, "tau": tau}, np.random.default_rng(0), 8)
    ahead, spread = steps * DT, 2 * tau * size**2
    turn, along, side = spread * 2 / motion.TRACK**2, spread / 2, spread * motion.SIDEWAYS**2
    assert found["50"] == pytest.approx(np.sqrt(turn * ahead**3 / 3 + (along + side) * ahead), rel=0.1)


@pytest.mark.parametrize("name", ["world_drift", "sensor_lever_arm", "heading_bias", "pacejka_slip", "yaw_gain"])
def test_floor_is_what_the_true_robot_leaves(name):
    """The simulator with the true effect, against a robot that slips at random, leaves the floor: whatever the effect."""
    u = drives.rich(np.random.default_rng(2), 2400, DT)[0]
    parameters, shaken = {row[0]: row[4] for row in bridge.effects()[name][1]}, {"size": 0.05, "tau": 0.3}
    acting, x0 = [Cause(name, parameters)], (1.0, -2.0, 0.7)
    least = tiers.wandering(u[:-1], DT, acting, x0, shaken, np.random.default_rng(0), 6)["50"]
    left = [
        tiers.gap(plant.simulate(u[:-1], DT, acting, x0, np.random.default_rng(seed), shaken), u, DT, active=[bridge.usual_effect(name)])
        for seed in range(1, 7)
    ]
    assert np.sqrt(np.mean([gap["50"] ** 2 for gap in left])) == pytest.approx(least, rel=0.15)


def test_tiers_with_random_slip():
    sizes = [tiers.draw("none_slip", 4, k, 600)[0]["motion"] for k in range(3)]
    assert [m["size"] for m in sizes] == [0.01, 0.03, 0.1] and all(0.1 <= m["tau"] <= 1 for m in sizes)
    label, (x, u, _), _ = tiers.draw("none_slip", 4, 2, 1200)
    assert label["truth"] == [] and label["families"] == []
    assert 0.5 * label["floor"]["50"] < tiers.gap(x, u, label["dt"])["50"] < 2 * label["floor"]["50"]
    label = tiers.draw("slipping", 4, 1, 1200)[0]
    assert 0.01 <= label["motion"]["size"] <= 0.05 and len(label["truth"]) == 1 and label["causes"][0]["shape"] == "plain"
    assert label["gap"]["50"] > 1.5 * label["floor"]["50"]


# ---- tiers of forms and lags ---------------------------------------------------------------------


def test_other_forms_take_turns_and_no_effect_comes_twice_before_all_came():
    drawn = [tiers.cast("single_other", 3, k)[0] for k in range(sum(map(len, plant.OTHER.values())))]
    assert set(drawn) == {(name, form) for name, choice in plant.OTHER.items() for form in choice}
    assert len({name for name, _ in drawn[: len(plant.OTHER)]}) == len(plant.OTHER)


def test_label_says_cause_family_and_form():
    for k in range(6):
        label, _, _ = tiers.draw("single_other", 3, k, 1200)
        (cause,) = label["causes"]
        assert (cause["name"], cause["form"]) == tiers.cast("single_other", 3, k)[0] and cause["shape"] == "other"
        assert label["families"] == [cause["family"]] == [plant.family(cause["name"])]


def test_lags_come_alone_differently_on_both_axes_and_with_a_gain():
    drawn = [set(tiers.members("lags", 3, k)) for k in range(5)]
    assert all(names in drawn for names in ({"speed_lag"}, {"yaw_lag"}, {"speed_lag", "yaw_lag"}))
    assert sum(bool(names & {"speed_gain", "yaw_gain"}) for names in drawn) == 2
    k = next(k for k in range(5) if drawn[k] == {"speed_lag", "yaw_lag"})
    one, other = (cause["parameters"]["tau"] for cause in tiers.draw("lags", 3, k, 1200)[0]["causes"])
    assert one != other


def test_who_leaves_out_an_effect_leaves_out_its_family():
    deck = [tiers.draw("left_out", 3, k, 700)[0] for k in range(len(tiers.VOCABULARY))]
    (skid,) = (label for label in deck if label["truth"] == ["lateral_skid"])
    assert set(skid["without"]) >= {"lateral_skid", "pacejka_slip"}
    assert all(set(label["without"]) <= set(bridge.effects()) for label in deck)


def test_family_of_an_effect_that_the_table_lacks_is_what_the_report_says():
    assert plant.family("speed_lag") == plant.family("actuator_lag") == "lag"
    assert plant.family("speed_lag", "delay") == "lag"  # the name counts
    assert plant.family("tyre_curve", "slip") == plant.family("tyre_curve", "pacejka_slip") == "slip"
    assert plant.family("tyre_curve") == "tyre_curve" and plant.family("tyre_curve", "tyres") == "tyres"


# ---- odometry ----------------------------------------------------------------------------------

QUIET = dict.fromkeys(odometry.COLUMNS, (0.0, 0.0))


def seen(cause, u):
    """Odometry without noise, and the robot."""
    robot = plant.drive(u, DT, [cause], random=np.random.default_rng(0))
    return odometry.measured(np.random.default_rng(0), robot, QUIET), robot


def test_odometry_shows_the_actuator_and_not_the_ground():
    u = drives.rich(np.random.default_rng(2), 600, DT)[0]
    columns, robot = seen(Cause("speed_gain", {"a": -0.1}), u)
    assert np.allclose(columns["v_odo"][:-1], 0.9 * u[:, 0]) and np.allclose(columns["omega_odo"][:-1], u[:, 1])
    columns, robot = seen(Cause("pacejka_slip", {"B": 10, "C": 1.6, "D": 0.2, "E": 0.3, "lat": 0.45}), u)
    assert np.allclose(columns["v_odo"][:-1], u[:, 0]) and np.allclose(columns["omega_odo"][:-1], u[:, 1])
    turned = np.diff(robot.poses[:, 2]) / DT
    assert np.allclose(columns["omega_imu"][:-1], turned) and np.max(np.abs(turned - u[:, 1])) > 0.01
    columns, robot = seen(Cause("heading_bias", {"delta": 0.1}), u)
    assert np.allclose(columns["omega_imu"][:-1], u[:, 1])


def test_without_traction_the_wheels_turn_and_nothing_else():
    columns, robot = seen(Cause("no_traction"), straight(200, 1.0, 0.5))
    assert np.all(columns["v_odo"] == 1) and np.all(columns["omega_odo"] == 0.5)
    assert np.all(columns["omega_imu"] == 0) and np.all(robot.poses == 0)


def test_odometry_has_noise_and_a_scale_of_its_own():
    sensors = odometry.settings(np.random.default_rng(3))
    robot = plant.drive(straight(50000), DT)
    for name, true in (("v_odo", 1.0), ("omega_odo", 0.0), ("omega_imu", 0.0)):
        scale, noise = sensors[name]
        found = odometry.measured(np.random.default_rng(0), robot, sensors)[name]
        assert np.mean(found) == pytest.approx((1 + scale) * true, abs=1e-3) and np.std(found) == pytest.approx(noise, rel=0.02)
        assert 0 < abs(scale) <= 0.01


def test_odometry_tier_takes_turns_and_has_no_traction_once():
    there = [name for name in (*tiers.VOCABULARY, "no_traction") if name != "clock_scale"]
    drawn = [tiers.cast("odometry", 5, k)[0] for k in range(2 * len(there))]
    assert [name for name, _ in drawn[: len(there)]].count("no_traction") == 1
    assert sorted(name for name, _ in drawn) == sorted(2 * there)
    assert all(form in plant.OTHER[name] for name, form in drawn if form) and any(form for _, form in drawn)
    names = {"command-wheel": "backlash", "wheel-ground": "pacejka_slip", "gyro-heading": "heading_bias"}
    assert {link: plant.link(name) for link, name in names.items()} == {link: link for link in names}
    assert plant.link("clock_scale") is None


def test_log_with_odometry_is_one_that_can_be_read(tmp_path):
    label, (x, u, columns), (_, _, fresh) = tiers.draw("odometry", 5, 1, 700)
    blind._write(tmp_path / "log.csv", x, u, columns, label["dt"])
    log = bridge.read_log(tmp_path / "log.csv")
    assert np.allclose(log.x, x, atol=1e-6) and np.allclose(log.u, u, atol=1e-6)
    table = np.genfromtxt(tmp_path / "log.csv", delimiter=",", names=True)
    assert table.dtype.names == ("t", "px", "py", "theta", "v", "omega", *odometry.COLUMNS)
    assert all(np.allclose(table[name], columns[name], atol=1e-6) for name in columns) and set(fresh) == set(columns)
    assert label["causes"][0]["link"] in plant.LINKS and set(label["odometry"]) == set(odometry.COLUMNS)
