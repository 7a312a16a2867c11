"""The flapping-wing diagnoser: its observer against the simulator it comes from, its noise, its answers."""

import numpy as np
import pytest
from scipy import linalg, signal
from tinykoop import bridge
from tinykoop.diagnose.platforms.fwmav import diagnosis, vehicle
from tinykoop.diagnose.platforms.fwmav.baseline import of_vehicle, simulated
from tinykoop.diagnose.platforms.fwmav.path import Path
from tinykoop.diagnose.prediction_errors import ahead
from tinykoop.diagnose.prediction_errors.healthy import LAGS, Whitener
from tinykoop.plumbing.errors import UserError

STILL = bridge.Effect("vibration", (-1.0,))  # a body that does not shake
NOISY = bridge.fwmav("hover", 10, 1)[0]  # whose noise the observer's gain is made for


def still(manoeuvre, active=(), seconds=12, seed=3):
    """A flight without noise or shaking, of which an observer ought to miss nothing."""
    return bridge.fwmav(manoeuvre, seconds, seed, [STILL, *active], noise=0.0)[0]


def missed(log, active=(), **more):
    return vehicle.follower(log, vehicle.observer_gain(NOISY))(active, **more)


# ---- the observer ------------------------------------------------------------------------------


@pytest.mark.parametrize("manoeuvre", ["hover", "yaw"])
def test_observer_misses_nothing_of_its_own_vehicle(manoeuvre):
    left, _ = missed(still(manoeuvre))
    assert np.abs(left[100:, :3]).max() < 2e-3  # rad/s
    assert np.abs(left[100:, 6:]).max() < 2e-5  # rad


EFFECTS = {
    "delay": (0.008,), "lag": (0.012,), "gain": (-0.25,), "trim_bias": (0.03, -0.02), "asymmetry": (0.04,),
    "damping": (0.5,), "gyro_bias": (0.02, 0.03, -0.02),
}  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_observer_with_an_effect_follows_a_vehicle_that_has_it(name):
    effect = bridge.Effect(name, EFFECTS[name])
    log = still("yaw", [effect])
    with_it, without = (np.sqrt(np.nanmean(missed(log, active)[0][100:] ** 2, axis=0)) for active in ([effect], ()))
    # the flight is logged at 100 Hz and flown at 500 Hz: between rows u is not known
    assert np.all(with_it < [8e-3] * 3 + [0.03] * 3 + [8e-5] * 3)
    assert without[:3].max() > 3 * with_it[:3].max()


def test_gust_is_told_when_it_sets_in():
    gust = bridge.Effect("gust", (0.5, -0.3), 6.0)
    log = still("hover", [gust])
    without, with_it = missed(log)[0], missed(log, [gust])[0]
    assert abs(np.nanargmax(np.abs(without[:, 3])) - 601) <= 1
    assert np.nanmax(np.abs(with_it[100:, 3])) < 0.05 * np.nanmax(np.abs(without[100:, 3]))


def test_first_step_ahead_is_the_next_prediction():
    log = bridge.fwmav("pitch", 5, 2)[0]
    starts = np.arange(100, 400, 7)
    left, ahead = missed(log, starts=starts, steps=[1, 10])
    np.testing.assert_allclose(ahead[:, 0], left[starts + 1], atol=1e-12)
    assert np.isfinite(ahead).all()


def test_gap_in_the_log_begins_anew():
    log = bridge.fwmav("hover", 6, 2)[0]
    whole = missed(log)[0]
    log.usable[300] = False
    log.x[301, 6:9] += 0.3  # whatever happened there
    broken, ahead = missed(log, starts=[295], steps=[1, 10])
    np.testing.assert_array_equal(broken[1:301], whole[1:301])
    assert np.isnan(broken[301]).all() and np.isfinite(broken[302:]).all()
    assert np.isfinite(ahead[0, 0]).all() and np.isnan(ahead[0, 1]).all()


def test_push_is_an_acceleration():
    log, push = still("hover"), np.zeros((1200, 6))
    push[600, 4] = 10.0  # rad/s^2 about y for one row: 0.1 rad/s
    change = missed(log, push=push)[0] - missed(log)[0]
    np.testing.assert_allclose(change[601, 1], -0.1, rtol=0.1)
    assert np.abs(change[:601][1:]).max() == 0


@pytest.mark.parametrize(
    "more, says",
    [
        ({"starts": [5, 3], "steps": [1]}, "must rise"),
        ({"starts": [5000], "steps": [1]}, "within the log"),
        ({"starts": [5], "steps": [10, 1]}, "steps must rise"),
    ],
)
def test_observer_refuses(more, says):
    with pytest.raises(UserError, match=says):
        missed(NOISY, **more)


def test_gain_is_that_of_the_riccati_recursion():
    A, C = vehicle._linear(0.01)
    K = vehicle.observer_gain(NOISY)
    assert np.abs(linalg.eigvals(A - A @ K @ C)).max() < 1
    lost = -np.expm1(-0.02 / np.r_[np.full(6, vehicle.LASTING), vehicle.CLIMBING])
    Q = np.diag(np.r_[np.full(9, 1e-10), np.square([*vehicle.AIR, vehicle.LIFT]) * lost])
    y = vehicle.measured(NOISY)
    R = np.diag(np.r_[np.diff(y[:, :6], axis=0).var(0) / 2, np.diff(y[:, 6:], n=2, axis=0).var(0) / 2])
    P = np.eye(16) * 1e-2
    for _ in range(20000):
        gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        P = A @ (P - gain @ C @ P) @ A.T + Q
    np.testing.assert_allclose(K, gain, atol=2e-4 * np.abs(K).max())


@pytest.mark.parametrize("manoeuvre", ["hover", "pitch", "yaw"])
def test_axis_of_the_command(manoeuvre):
    for seed in range(5):
        assert vehicle.turns_yaw(bridge.fwmav(manoeuvre, 8, 40 + seed)[0]) == (manoeuvre == "yaw")


# ---- noise --------------------------------------------------------------------------------------


def test_whitener_undoes_a_vector_autoregression():
    rng = np.random.default_rng(1)
    mix = np.eye(9) + 0.3 * rng.normal(size=(9, 9))
    series = []
    for _ in range(3):
        x = signal.lfilter([1], [1, -0.6, 0.3], rng.normal(size=(4000, 9)), axis=0) @ mix.T + 2.0
        series.append(x)
    w = Whitener.fitted(series[:2])(series[2])[LAGS:]
    np.testing.assert_allclose(np.cov(w.T), np.eye(9), atol=0.12)
    for lag in (1, 2, 5):
        assert np.abs(w[lag:].T @ w[:-lag] / len(w)).max() < 0.08


def test_sensor_bias_of_usual_size_counts_little():
    """The covariance with a bias taken in, against what it is by definition."""
    log = bridge.fwmav("hover", 3, 5)[0]
    path = simulated().path(log)
    U, shrunk = path.noises._own, path.noises._shrunk
    s2 = 1 / (1 - shrunk) ** 2 - 1
    w = np.random.default_rng(0).normal(size=len(U))
    direct = w @ np.linalg.solve(np.eye(len(U)) + (U * s2) @ U.T, w)
    white = w - U @ (shrunk * (U.T @ w))
    np.testing.assert_allclose(white @ white, direct, rtol=1e-9)


def test_noise_is_never_less_than_that_of_healthy_flights():
    path = simulated().path(bridge.fwmav("hover", 8, 6)[0])
    first = path.noises.first(path)
    D = np.random.default_rng(0).normal(size=(*path.present.shape, 1))
    for size in (0.1, 3.0):
        D *= size / np.sqrt((path.noises.whitened(path, first, D, D) ** 2).sum() / np.isfinite(path.present).sum())
        noise, deviance = path.noises.likeliest(path, first, D, D)
        n, least = np.isfinite(path.present).sum(), max(size, 1.0)
        np.testing.assert_allclose(noise.sensor, least)
        # -2 log likelihood of independent normal values, but for n log 2 pi
        np.testing.assert_allclose(deviance, n * (size / least) ** 2 + 2 * n * np.log(least))


def test_whitening_is_linear():
    """Columns of effects are whitened by themselves, so the whole must be the sum of its parts."""
    path = simulated().path(bridge.fwmav("yaw", 8, 6)[0])
    rng, first = np.random.default_rng(0), path.noises.first(path)
    D = rng.normal(size=(*path.present.shape, 2))
    both = path.noises.whitened(path, first, D @ [[2.0], [-0.5]], D[..., :1])[..., 0]
    parts = path.noises.whitened(path, first, D, D)
    np.testing.assert_allclose(both, 2 * parts[..., 0] - 0.5 * parts[..., 1], atol=1e-9)


def test_innovations_are_the_same_whether_they_are_kept(monkeypatch):
    """However long the log: at least those asked for last are kept."""
    from tinykoop.diagnose.platforms.fwmav import path as fwmav
    from tinykoop.diagnose.prediction_errors.fit import Cause

    log = bridge.fwmav("hover", 5, 5)[0]
    causes = (Cause("gain", (0.1,)),)
    kept = simulated().path(log).innovations(causes)
    monkeypatch.setattr(fwmav, "KEPT", 1.0)
    path = simulated().path(log)
    path.innovations(())
    np.testing.assert_array_equal(path.innovations(causes), kept)
    np.testing.assert_array_equal(path.innovations(causes), kept)


# ---- answers ------------------------------------------------------------------------------------


def answer(manoeuvre, seed, *active, without=(), seconds=14):
    return diagnosis.diagnose(bridge.fwmav(manoeuvre, seconds, seed, list(active))[0], without=without).report


def named(report):
    return {effect["name"]: effect for effect in report["effects"]}


def test_healthy_flight():
    report = answer("pitch", 501)
    assert report["verdict"] == "none" and report["effects"] == []
    assert "battery_sag" in report["not_testable"]


def test_lag_is_found_or_its_look_alike():
    report = answer("pitch", 502, bridge.Effect("lag", (0.018,)))
    (found,) = report["effects"]
    assert report["verdict"] == "known" and {found["name"], *report["ambiguous_with"].get(found["name"], ())} >= {"lag"}
    assert 0.008 < next(iter(found["params"].values())) < 0.025
    low, high = next(iter(found["params_ci95"].values()))
    assert 0 < low < high


def test_trim_that_jumps():
    report = answer("hover", 503, bridge.Effect("trim_bias", (0.03, -0.03), 9.0))
    found = named(report)["trim_bias"]
    assert abs(found["segments"][0][0] - 9.0) < 0.3 and abs(found["segments"][0][1] - 13.99) < 0.02
    assert abs(found["params"]["pitch"] - 0.03) < 0.01 and abs(found["params"]["yaw"] + 0.03) < 0.01
    gone = report["gap"]
    assert gone["after"]["50"] < gone["before"]["50"]
    assert report["contributions"]["trim_bias"]["50"] > 0.05


def test_gust_is_named_from_the_row_on_that_it_sets_in():
    (found,) = answer("hover", 507, bridge.Effect("gust", (0.6, -0.4), 9.0))["effects"]
    assert found["name"] == "gust" and abs(found["segments"][0][0] - 9.0) < 0.05
    for name, true in (("wx", 0.6), ("wy", -0.4)):
        low, high = found["params_ci95"][name]
        assert low < true < high and high - low < 0.5


def test_vibration_is_measured():
    report = answer("yaw", 504, bridge.Effect("vibration", (0.5,)))
    (found,) = report["effects"]
    assert found["name"] == "vibration" and abs(found["params"]["a"] - 0.5) < 0.05


def test_vibration_of_a_part_is_not_another_vehicle():
    report = answer("hover", 506, bridge.Effect("vibration", (0.8,), 8.0))
    (found,) = report["effects"]
    assert report["verdict"] == "known" and not report["unexplained"]["another_vehicle"]
    assert found["name"] == "vibration" and abs(found["params"]["a"] - 0.8) < 0.1
    assert abs(found["segments"][0][0] - 8.0) <= 1.0


def test_cause_out_of_the_library_is_not_known():
    report = answer("hover", 505, bridge.Effect("trim_bias", (0.04, 0.04)), without=["trim_bias"])
    assert "trim_bias" not in named(report)
    assert report["verdict"] == "unknown" or report["effects"][0]["confidence"] < 0.9


def test_attitude_error_is_the_angle():
    """First order against the rotation between two attitudes."""
    from scipy.spatial.transform import Rotation

    small = np.array([0.02, -0.01, 0.015])  # roll, pitch, yaw
    missed_ = np.zeros((1, 1, 9))
    missed_[..., 6:] = small
    angle = Rotation.from_euler("ZYX", small[::-1]).magnitude()
    np.testing.assert_allclose(ahead.sizes(Path, missed_)["attitude"][0, 0], angle, rtol=2e-2)


# ---- bad input ----------------------------------------------------------------------------------


def written(path, log):
    bridge.write_log(path, log.x, log.u, log.dt, "fwmav")
    return path


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda log: (log.x[:300], log.u[:300], 0.01), "record 6 s at least"),
        (lambda log: (log.x, log.u, 0.02), "100 Hz"),
        (lambda log: (log.x, np.full_like(log.u, 0.1), 0.01), "u never changes"),
    ],
)
def test_bad_flight_is_refused_with_one_line(tmp_path, change, says):
    x, u, dt = change(NOISY)
    path = tmp_path / "flight.csv"
    bridge.write_log(path, x, u, dt, "fwmav")
    with pytest.raises(UserError, match=says) as refused:
        diagnosis.load(path)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


def test_flight_in_shreds_is_refused(tmp_path):
    path = written(tmp_path / "flight.csv", NOISY)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header + ",seg", *(f"{row},{i // 90}" for i, row in enumerate(rows))]) + "\n")
    with pytest.raises(UserError, match="nowhere are 1.5 s in a row usable"):
        diagnosis.load(path)


def test_parts_of_all_healthy_flights_show_the_noise():
    logs = [bridge.fwmav(manoeuvre, 14, seed)[0] for manoeuvre, seed in (("hover", 61), ("pitch", 62))]
    each, both = [of_vehicle([log], ()) for log in logs], of_vehicle(logs, ())
    assert len(both.flights) == sum(len(one.flights) for one in each) >= 4
    mean = np.sqrt(np.mean([one.shaking**2 for one in each], axis=0))
    np.testing.assert_allclose(both.shaking, mean, rtol=0.02)


def test_unknown_effect_is_refused():
    with pytest.raises(UserError, match="there is no such effect"):
        diagnosis.diagnose(NOISY, without=["slip"])


def test_log_behind_the_healthy_one_is_not_taken_for_another():
    from tinykoop import cli
    from tinykoop.blind import DIAGNOSE, injected

    given = cli.parser().parse_args([*injected._command("healthy.csv")[len(DIAGNOSE) - 1 :], "log.csv"])
    assert given.log == ["log.csv"] and given.healthy == ["healthy.csv"]
