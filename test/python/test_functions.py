"""Plain functions of a drive: an unknown effect is described by them, and not taken for a known one."""

import functools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_diagnose import DT, drive
from tinykoop import bridge
from tinykoop.blind import plant, tiers
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr import features
from tinykoop.diagnose.platforms.ddr.diagnosis import diagnose
from tinykoop.diagnose.prediction_errors import ahead
from tinykoop.diagnose.prediction_errors.noise import Noise
from tinykoop.diagnose.prediction_errors.search import Search

SEED = 4711
SIZES = {
    "camber": {"k": 0.05},
    "turn_asymmetry": {"e": 0.15},
    "heading_scale": {"e": 0.06},
    "wheel_eccentricity": {"size": 0.15, "radius": 0.3, "phase": 1.0},
    "payload_swing": {"share": 0.3, "frequency": 0.8, "damping": 0.08},
    "caster_kick": {"kick": 0.3, "tau": 0.6},
}
SAID = {
    "camber": "v^2", "turn_asymmetry": "|omega|", "heading_scale": "angle turned through", "wheel_eccentricity": "angle of a wheel",
    "payload_swing": "swings", "caster_kick": "reversals of v",
}  # fmt: skip


def log_of(cause, rows=1500, sp=0.004, st=0.004, seed=SEED):
    """A log of the independent plant with one cause, or none."""
    random = np.random.default_rng(seed)
    u = drive(rows, seed)
    acting = [plant.Cause(cause, SIZES[cause], "never")] if cause else []
    x = plant.drive(u[:-1], DT, acting, (0.0, 0.0, 0.0), random).poses
    x = x + random.normal(size=x.shape) * (sp, sp, st)
    return bridge.Log(np.arange(len(x)) * DT, x, u, np.ones(len(x) - 1, bool), DT)


@functools.cache
def diagnosis(cause):
    return diagnose(log_of(cause))


@pytest.mark.parametrize("cause", SIZES)
def test_effect_in_no_library_is_unknown_and_described(cause):
    report = diagnosis(cause).report
    assert report["verdict"] == "unknown" and not report["effects"]
    assert any(SAID[cause] in part["on"] for part in report["unexplained"]["depends_on"])


def test_radius_of_a_wheel_that_is_not_round_is_told():
    depends = diagnosis("wheel_eccentricity").report["unexplained"]["depends_on"]
    radius = next(float(part["on"].split()[5]) for part in depends if part["on"].startswith("angle of a wheel"))
    assert radius == pytest.approx(SIZES["wheel_eccentricity"]["radius"], abs=0.02)


def test_swing_is_that_of_a_damped_pendulum():
    dt, frequency, c = 0.01, 0.7, np.zeros(400)
    c[50:] = 1.0  # one jump, at 0.5 s
    swing, _ = features._swing(c, frequency, dt).T
    omega, zeta = 2 * np.pi * frequency, features.DAMPING
    t = np.arange(350) * dt
    exact = solve_ivp(lambda _, z: [z[1], -2 * zeta * omega * z[1] - omega**2 * z[0]], (0, t[-1]), [0.0, 1.0], t_eval=t, rtol=1e-9).y[0]
    np.testing.assert_allclose(swing[50:] / (omega * np.sqrt(1 - zeta**2)), exact, atol=1e-6)


def test_functions_are_the_same_whatever_rows_are_looked_at():
    """What a robot remembers is that of the whole log, not of the rows that are looked at."""
    log = log_of("", rows=600)
    rows, left = np.arange(300, 600), np.zeros((600, 3))
    whole, part = (features.functions(log.u, some, log.x[some], DT, left[some]) for some in (np.arange(600), rows))
    for name in (name for name in whole if name.startswith(("swings", "reversals", "use of"))):
        np.testing.assert_array_equal(whole[name][0][rows], part[name][0])


@pytest.mark.parametrize("name", ["speed_gain", "heading_bias", "speed_lag", "yaw_lag", "dead_band"])
def test_known_effects_are_worth_more_than_functions(name):
    random = np.random.default_rng(SEED)
    u = drive(1500, SEED)
    sizes = tiers.known(random, name, u)
    x = plant.drive(u[:-1], DT, [plant.Cause(name, sizes)], (0.0, 0.0, 0.0), random).poses + random.normal(size=(1500, 3)) * 0.004
    found = diagnose(bridge.Log(np.arange(1500) * DT, x, u, np.ones(1499, bool), DT)).found
    assert found.verdict == "known" and found.box.rival() > found.search.price and not found.box.shows


def test_healthy_robot_needs_no_function():
    found = diagnose(log_of("")).found
    assert found.verdict == "none" and not found.box.beside.chosen and isinstance(found.path, ddr.Path)


def test_lag_of_one_axis_is_a_candidate_although_a_lag_of_both_promises_nothing():
    random, rows = np.random.default_rng(SEED), 800
    jumps, slow = np.repeat(random.uniform(-1.5, 1.5, rows // 10), 10), 0.8 * np.sin(1.5 * DT * np.arange(rows))
    u = np.column_stack([jumps, slow])
    x = plant.drive(u[:-1], DT, [plant.Cause("yaw_lag", {"tau": 0.5})], (0.0, 0.0, 0.0), random).poses
    log = bridge.Log(DT * np.arange(rows), x + random.normal(size=x.shape) * (0.004, 0.004, 0.006), u, np.ones(rows - 1, bool), DT)
    search = Search(ddr.Path(log))
    state = search.likeliest(search.fitter.fit_of(()))
    assert search.candidates(search.at(state).fit_of(()))[0][1].name == "yaw_lag"


@pytest.mark.parametrize("track", [0.3, 1.5])
def test_wheels_that_slip_at_random_are_random_whatever_their_track(track):
    """Slips of sd s of two wheels drive by s / sqrt(2) and turn by sqrt(2) s / track; what does one of the two alone is no slip."""
    path, slip = ddr.Path(log_of("", rows=200)), 0.04
    of = lambda *process: Noise(np.full(3, 0.004), np.zeros(3), np.array(process), np.full(3, 0.8))  # noqa: E731
    wheels = of(slip / np.sqrt(2), 0.3 * slip, np.sqrt(2) * slip / track)
    np.testing.assert_allclose(path.random(wheels).process, wheels.process, rtol=1e-12)
    for alone in (of(slip, 0.0, 0.0), of(0.0, slip, 0.0), of(0.0, 0.0, slip)):
        assert not path.random(alone).process.any()


@pytest.mark.parametrize("truth, slips", [("yaw_lag", 0.0), ("yaw_gain", 0.02)])
def test_what_a_form_misses_is_in_no_noise_floor_and_what_slips_at_random_is(truth, slips):
    """A lag that differs for faster and slower turns, beside a gain of a robot that slips: before, after and the floor at 50 steps."""
    random, rows = np.random.default_rng(SEED + 5), 1500
    u = drive(rows, SEED)
    lags = plant.Cause("yaw_lag", {"tau": 0.5}, "other", form="uneven_yaw_lag")
    acting = [plant.Cause("yaw_gain", {"b": 0.15}) if slips else lags]
    robot = {"size": slips, "tau": 0.3} if slips else None
    x = plant.drive(u[:-1], DT, acting, (0.0, 0.0, 0.0), random, robot).poses + random.normal(size=(rows, 3)) * (0.004, 0.004, 0.006)
    found = diagnose(bridge.Log(DT * np.arange(rows), x, u, np.ones(rows - 1, bool), DT)).found
    sensor = ahead.floor(found.path, found.state.noise.quiet(found.path), found.starts)
    after, floor, least = (ahead.rms(errors["position"])[-1] for errors in (found.after, found.floor, sensor))
    assert found.fit.names and after > 1.5 * least
    assert floor > 3 * least if slips else floor < 1.2 * least


@pytest.mark.parametrize("times", [1e3, 1e9, 1e300])
def test_commands_in_another_unit_need_no_more_memory(times):
    log = log_of("", rows=200)
    with np.errstate(over="ignore", invalid="ignore"):
        found = features.functions(times * log.u, np.arange(200), log.x, DT, np.zeros((200, 3)))
    assert not any(name.startswith("angle of a wheel") for name in found) or times * np.abs(log.u[:, 0]).sum() * DT < features.FARTHEST
