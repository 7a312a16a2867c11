"""The diagnosis of a quadrotor's flight: its features, the probabilities of causes against sums over a grid, and known answers."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from tinykoop import bridge
from tinykoop.diagnose.platforms import quadrotor
from tinykoop.diagnose.platforms.quadrotor import advise, baseline, causes, changes, features, path
from tinykoop.plumbing.errors import UserError

DT, MEAN, SECONDS = 0.01, 0.6, 20
BALANCE = [features.NAMES.index(name) for name in causes.BLOCKS["balance"][:4]]
S = np.diag([0.009, 0.008, 0.007, 0.012]) ** 2
VEHICLE = bridge.quadrotor_vehicle()


def requests(seconds=(1.0, 8.0, 1.0), level=MEAN, rotors=(0.0, 0.0, 0.0, 0.0), volts=3.5, noise=0.03, seed=0):
    """A log of requests alone: take-off that asks for more, a steady part, a landing that asks for less."""
    rng, parts = np.random.default_rng(seed), []
    for duration, share in zip(seconds, (1.3, 1.0, 0.7)):
        parts.append(np.full((round(duration / DT), 4), share * level) + rotors)
    u = np.concatenate([np.zeros((100, 4)), *parts, np.zeros((100, 4))])
    u[100:-100] += noise * rng.standard_normal((len(u) - 200, 4))
    K = len(u)
    return SimpleNamespace(
        t=np.arange(K) * DT, u=np.column_stack([u, np.full(K, volts)]), x=np.full((K, 15), np.nan), usable=np.ones(K - 1, bool), dt=DT,
        path="flight.csv",
    )  # fmt: skip


def asks(sizes):
    """What causes ask for in thrust, roll, pitch and yaw (4,), from the requests of the rotors, written without MIX."""
    m1, m2, m3, m4 = (sizes.get(i, 0.0) for i in (1, 2, 3, 4))
    return np.array([m1 + m2 + m3 + m4, m3 + m4 - m1 - m2, m1 + m4 - m2 - m3, m1 + m3 - m2 - m4]) / 4


@cache
def flown(name=None, kind="mixed", seed=5, **more):
    """A simulated flight with an effect of its usual size, or with these parameters."""
    active = []
    if name:
        rows = bridge.quadrotor_effects()[name][1]
        active = [bridge.Effect(name, tuple(more.get(row[0], row[4]) for row in rows))]
    return bridge.quadrotor(kind, SECONDS, seed, active)[0]


@pytest.fixture
def tinykoop(tinykoop_in):
    return lambda *arguments: tinykoop_in(".", *arguments)


def names_of(result):
    return [effect["name"] for effect in result.report["effects"]]


# ---- features --------------------------------------------------------------------------------------


def test_only_steady_flight_counts():
    log = requests()
    rows = np.flatnonzero(features.steady(log))
    assert 200 <= rows[0] and rows[-1] < 1000 and len(rows) > 600
    found = features.of(log)
    assert found.asked == pytest.approx([MEAN, 0, 0, 0], abs=0.006)
    assert found.volts == pytest.approx(3.5) and found.seconds == pytest.approx(len(rows) * DT)


def test_requests_of_the_rotors_are_given_back():
    more = np.array([0.02, -0.01, 0.05, 0.0])
    found = features.of(requests(rotors=more, noise=0.0))
    assert found.rotors == pytest.approx(MEAN + more, abs=1e-9)
    assert found.asked == pytest.approx(asks(dict(zip(features.ROTORS, MEAN + more))), abs=1e-9)


def test_a_log_of_requests_alone_has_their_features_and_no_others():
    found = features.of(requests())
    known = {name for name, value in zip(features.NAMES, found.values) if np.isfinite(value)}
    assert known == {"thrust", "roll", "pitch", "yaw", "drift", "roll drift", "pitch drift", "yaw drift"}


def test_a_flight_without_a_steady_part_is_refused():
    with pytest.raises(UserError, match=r"flight.csv: nowhere is the thrust steady for 1 s; record"):
        features.of(requests((0.4, 0.4, 0.4)))


def test_rows_without_a_request_do_not_count():
    log = requests()
    log.u[500:520, 2] = np.nan
    assert not features.steady(log)[500:520].any() and np.isfinite(features.of(log).asked).all()


def test_the_drift_is_the_slope_of_the_mean_request():
    log = requests((1.0, 18.0, 1.0), noise=0.005)
    log.u[:, :4] += 0.02 * (log.t / log.t[-1])[:, None] * (log.u[:, :4] > 0)
    found = features.of(log)
    assert found.values[features.NAMES.index("drift")] == pytest.approx(0.02, abs=0.003)


def test_the_drift_of_a_fading_rotor_is_a_quarter_of_its_rise_about_each_axis():
    log = requests((1.0, 18.0, 1.0), noise=0.005)
    log.u[:, 0] += 0.04 * log.t / log.t[-1] * (log.u[:, 0] > 0)
    found = features.of(log)
    drifts = [found.values[features.NAMES.index(f"{axis}drift")] for axis in ("", "roll ", "pitch ", "yaw ")]
    assert drifts == pytest.approx([0.01, -0.01, 0.01, 0.01], abs=0.002)


def test_biases_of_sensors_are_told():
    for name, first, sizes in (("gyro_bias", "gyro x", (0.05, -0.06, 0.07)), ("accel_bias", "acceleration x", (0.5, -0.4, 0.6))):
        biased = features.of(flown(name, bx=sizes[0], by=sizes[1], bz=sizes[2]))
        at = features.NAMES.index(first)
        assert biased.values[at : at + 3] - features.of(flown()).values[at : at + 3] == pytest.approx(sizes, rel=0.15)


def test_drag_and_delay_are_told():
    plain, braked, late = (features.of(log) for log in (flown(), flown("drag", k=0.5), flown("transport_delay", delay=0.008)))
    drag, delay = features.NAMES.index("drag"), features.NAMES.index("delay")
    assert plain.values[drag] == pytest.approx(VEHICLE["drag_xy"], abs=0.08)
    assert braked.values[drag] - plain.values[drag] == pytest.approx(0.5, abs=0.1)
    assert late.values[delay] - plain.values[delay] == pytest.approx(0.008, abs=0.003)


# ---- explanations ----------------------------------------------------------------------------------


def like(flight=None):
    return causes.Healthy(MEAN, np.full(4, MEAN), VEHICLE, flight or features.of(requests()))


def rotor_sets(*rotors, sign=1):
    names = tuple(map(causes.rotor, rotors))
    return next(e for e in causes.explanations(like(), "balance") if e.causes == names and np.sign(e.H[0, 0]) == sign)


def found_in(d, covariance=S, without=()):
    every = [e for e in causes.explanations(like(), "balance") if not set(e.causes) & set(without)]
    return causes.posterior(every, [(np.asarray(d), covariance)], BALANCE)


def density(d, covariance=S):
    """Student's t of this covariance as a sum over the same normals."""
    spreads = (causes.FREEDOM - 2) / (2 * stats.gamma.ppf((np.arange(causes.SCALES) + 0.5) / causes.SCALES, causes.FREEDOM / 2))
    return np.mean([stats.multivariate_normal.pdf(d, np.zeros(4), covariance * k) for k in spreads], axis=0)


def by_grid(d, rotors, scales):
    """Marginal likelihood of weak rotors by a sum over their sizes, half-normal."""
    steps = np.linspace(0, 5, 121) + 2.5 / 120
    grid = np.stack(np.meshgrid(*[steps] * len(rotors), indexing="ij"), -1).reshape(-1, len(rotors))
    patterns = np.stack([asks({i: 1.0}) for i in rotors])
    weights = np.prod(2 * stats.norm.pdf(grid), axis=1) * (steps[1] - steps[0]) ** len(rotors)
    return np.mean([(weights * density(d - scale * MEAN * grid @ patterns)).sum() for scale in scales])


@pytest.mark.parametrize("rotors", [(3,), (1, 2)])
@pytest.mark.parametrize("d", [(0.0, 0.0, 0.0, 0.0), (0.013, 0.012, -0.01, 0.02), (0.03, -0.02, 0.0, 0.01)])
def test_marginal_likelihood_is_the_sum_over_all_sizes(rotors, d):
    likelihood, _, _ = causes._sized(rotor_sets(*rotors), [(np.array(d), S)], BALANCE)
    assert likelihood == pytest.approx(by_grid(np.array(d), rotors, causes.ROTOR), rel=0.05)


def test_probabilities_add_up():
    found = found_in([0.01, 0.01, -0.01, 0.0])
    assert found.healthy + sum(s.probability for s in found.sized) == pytest.approx(1)


@pytest.mark.parametrize("rotor", features.ROTORS)
def test_a_weak_rotor_is_found_with_its_size(rotor):
    found = found_in(asks({rotor: 0.2 * MEAN}))
    name = causes.rotor(rotor)
    assert found.sized[0].causes == (name,) and found.healthy < 1e-3 and found.of(name) > 0.9
    value, (low, high) = found.sized[0].params()[name]["a"]
    assert low < 1 / 1.2 - 1 < high and value == pytest.approx(1 / 1.2 - 1, abs=0.03)


def test_a_weight_between_two_rotors_is_a_payload_at_its_place():
    found = found_in(MEAN * np.array([0.1, 0.0, 0.04, 0.0]), S / 4)
    assert set(found.sized[0].causes) <= {causes.PAYLOAD, causes.SLUNG}
    params = found.sized[0].params()[found.sized[0].causes[0]]
    lever = VEHICLE["arm"] / np.sqrt(2)
    assert params["mass"][0] == pytest.approx(0.1 * VEHICLE["mass"], rel=0.1)
    assert (params["x"][0], params["y"][0]) == pytest.approx((0.4 * lever, 0.0), abs=0.1 * lever)


def test_what_no_cause_explains_is_something_else():
    far = found_in(MEAN * np.array([-0.2, 0.1, 0.1, -0.1]), S / 100)
    assert far.sized[0].causes == (causes.OTHER,) and far.healthy < 1e-6


def test_an_effect_that_is_ruled_out_explains_nothing():
    found = found_in(asks({3: 0.2 * MEAN}), without=(causes.rotor(3),))
    assert found.of(causes.rotor(3)) == 0


def test_half_the_noise_makes_the_same_difference_more_certain():
    d = asks({2: 0.06 * MEAN})
    rare, often = (found_in(d, S * k).of(causes.rotor(2)) for k in (4.0, 0.25))
    assert often > 0.8 > rare


# ---- beside healthy flights ------------------------------------------------------------------------


def beside(flight, *healthy, **more):
    return changes.Changes(flight, baseline.of_vehicle(healthy), VEHICLE, **more)


def other(flight, **values):
    changed = flight.values.copy()
    for name, value in values.items():
        changed[features.NAMES.index(name)] += value
    return replace(flight, values=changed)


def test_less_voltage_lowers_the_expected_thrust():
    low, usual = (features.of(requests(volts=volts, noise=0.0)) for volts in (3.3, 3.5))
    d, variances = beside(low, usual).difference(usual)
    assert d[0] == pytest.approx(0.2 * baseline.VOLTS * MEAN, abs=1e-9) and d[1:4] == pytest.approx(0, abs=1e-9)
    assert variances[0] > beside(usual, usual).difference(usual)[1][0]
    unknown = replace(low, volts=np.nan)
    assert np.isfinite(beside(unknown, usual).difference(usual)[0][:4]).all()


def test_a_flight_that_resembles_any_healthy_one_is_healthy():
    usual = features.of(requests())
    far = other(usual, **dict(zip(("thrust", "roll", "pitch", "yaw"), asks({3: 0.15 * MEAN}))))
    assert not beside(usual, usual).best and beside(far, usual).best and not beside(far, usual, far).best


def test_a_weak_rotor_names_the_weight_above_it_and_is_not_sure():
    usual = features.of(requests())
    found = beside(other(usual, **dict(zip(("thrust", "roll", "pitch", "yaw"), asks({3: 0.25 * MEAN})))), usual)
    (cause,) = found.named
    assert cause.name == "rotor3_thrust" and causes.PAYLOAD in found.rivals(cause.name) and found.confidence(cause) == changes.SURE
    assert len(found.rivals(cause.name)) < changes.MOST


def test_a_healthy_flight_says_what_would_have_shown():
    usual = features.of(requests())
    smallest = beside(usual, usual).smallest()
    for i in features.ROTORS:
        more = smallest[causes.rotor(i)] / (1 - smallest[causes.rotor(i)]) * MEAN
        for share, shows in ((0.7, False), (1.5, True)):
            d = asks({i: share * more})
            assert bool(beside(other(usual, **dict(zip(("thrust", "roll", "pitch", "yaw"), d))), usual).best) == shows
    assert 0 < smallest[causes.PAYLOAD] < 0.2 * VEHICLE["mass"]


# ---- whole flights ---------------------------------------------------------------------------------


def test_a_healthy_simulated_flight_has_no_gap():
    report = quadrotor.diagnose(flown()).report
    assert report["verdict"] == "none" and report["effects"] == [] and report["unchanged"] > 0.5


SHOWN = {  # effect: parameter, size, tolerance
    "rotor1_thrust": ("a", -0.12, 0.02), "rotor4_thrust": ("a", -0.15, 0.02), "payload": ("mass", 0.003, 0.0006), "trim": ("roll", 4e-4, 1e-4),
    "thrust_gain": ("a", -0.1, 0.02), "battery_sag": ("loss_at_end", 0.12, 0.04), "wind": ("wx", 1.5, 0.5), "drag": ("k", 0.5, 0.1),
    "gyro_bias": ("by", 0.05, 0.01), "accel_bias": ("bz", 0.4, 0.1), "vibration": ("a", 1.0, 0.3), "transport_delay": ("delay", 0.008, 0.003),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_an_effect_is_named_first_with_its_size(name):
    parameter, size, tolerance = SHOWN[name]
    result = quadrotor.diagnose(flown(name, **{parameter: size}))
    assert names_of(result)[:1] == [name], result.report["ranking"][:3]
    effect = result.report["effects"][0]
    assert effect["params"][parameter] == pytest.approx(size, abs=tolerance)
    low, high = effect["params_ci95"][parameter]
    assert low < effect["params"][parameter] < high


def test_adding_the_cause_closes_the_gap_also_on_a_fresh_flight():
    log, fresh = flown("rotor3_thrust", a=-0.15), flown("rotor3_thrust", a=-0.15, seed=6)
    gap = quadrotor.diagnose(log, fresh=fresh).report
    assert gap["gap"]["closed_fraction"]["10"] > 0.7 and gap["fresh"]["gap"]["closed_fraction"]["10"] > 0.7
    assert gap["verdict"] == "known"


@pytest.mark.parametrize("name", ["rotor2_thrust", "gyro_bias"])
def test_an_effect_left_out_is_unknown(name):
    report = quadrotor.diagnose(flown(name, **{"a": -0.15} if name != "gyro_bias" else {}), without=(name,)).report
    assert report["verdict"] in ("unknown", "partly") and report["unexplained"]["matters"]


def test_columns_that_are_not_needed_may_be_absent():
    log = flown("rotor2_thrust", a=-0.15)
    lacking = replace(log, x=np.where(np.isin(np.arange(15), [2, 5, 8, 9, 11]), log.x, np.nan))
    report = quadrotor.diagnose(lacking).report
    assert [e["name"] for e in report["effects"]][:1] == ["rotor2_thrust"]
    assert {"gyro_bias", "wind", "drag", "motor_lag"} <= set(report["not_testable"])


def test_healthy_flights_of_a_vehicle_are_its_own_zero():
    """A vehicle whose first rotor has always been weak, and whose third one gets weak."""
    worn = bridge.Effect("rotor1_thrust", (-0.1,))
    healthy = [bridge.quadrotor("legs", SECONDS, seed, [worn])[0] for seed in (1, 2)]
    log = bridge.quadrotor("legs", SECONDS, 3, [worn, bridge.Effect("rotor3_thrust", (-0.2,))])[0]
    report = quadrotor.diagnose(log, healthy=healthy).report
    (effect,) = report["effects"]
    assert effect["name"] == "rotor3_thrust" and effect["params"]["a"] == pytest.approx(-0.2, abs=0.04)
    assert report["ambiguous_with"]["rotor3_thrust"][0] == "payload" and report["healthy"]["logs"] == 2
    again = bridge.quadrotor("legs", SECONDS, 4, [worn])[0]
    assert quadrotor.diagnose(again, healthy=healthy).report["verdict"] == "none"


def test_the_base_makes_the_vehicle_hover_at_the_requests_of_healthy_flights():
    asked, volts = np.array([0.66, 0.54, 0.69, 0.55]), 3.4
    flight = replace(features.of(requests()), values=np.r_[features.MIX @ asked, features.of(requests()).values[4:]], volts=volts)
    base = path.base_of([flight], "crazyflie")
    state = bridge.quadrotor_hover()
    state[bridge.QUADROTOR_STATE["rotors"]] = asked
    states = bridge.quadrotor_roll(state, np.tile([*asked, volts], (30, 1)), DT, base)
    assert np.abs(states[-1, bridge.QUADROTOR_STATE["velocity"]]).max() < 5e-3
    assert np.abs(states[-1, bridge.QUADROTOR_STATE["spin"]]).max() < 5e-3


def test_the_noise_floor_of_another_day_is_what_a_trim_of_that_size_makes():
    """Of half a second of roll: no more than with nothing against the trim, no less than with air that the observer takes it for."""
    log, sd, t, lasts = flown(kind="hover"), np.array([0.0, 0.02, 0.0, 0.0]), 50 * DT, 0.3
    found = np.median(path.of_days(path.Path(log), sd)["attitude"][:, -1])
    moment = VEHICLE["mass"] * features.GRAVITY * VEHICLE["arm"] / np.sqrt(2) * 0.02
    free, held = t**2 / 2, t**2 / 2 - lasts * t + lasts**2 * (1 - np.exp(-t / lasts))
    assert held < found / (moment / VEHICLE["inertia_x"]) < free
    assert np.median(path.of_days(path.Path(log), 2 * sd)["attitude"][:, -1]) == pytest.approx(2 * found, rel=0.1)
    assert path.of_days(path.Path(log), 0 * sd)["attitude"].max() == 0


def test_turning_by_steps_separates_a_weak_rotor_from_a_weight_and_hovering_does_not():
    lever = VEHICLE["arm"] / np.sqrt(2)
    weight = ("payload", (("mass", 0.003), ("x", -lever), ("y", lever)))
    still, moving = (advise._separation(drive, ("rotor3_thrust", (("a", -0.2),)), weight, "crazyflie") for drive in advise.MENU)
    assert moving > 3 and moving > still


def test_the_page_shows_the_vehicle_from_above_and_what_to_fly_next(tinykoop, tmp_path):
    for i, seed in enumerate((1, 2)):
        bridge.write_log(tmp_path / f"healthy{i}.csv", *_parts(bridge.quadrotor("legs", SECONDS, seed)[0]))
    bridge.write_log(tmp_path / "log.csv", *_parts(flown("rotor3_thrust", kind="legs", a=-0.2)))
    healthy = [str(tmp_path / f"healthy{i}.csv") for i in range(2)]
    done = tinykoop("diagnose", tmp_path / "log.csv", "--robot", "quadrotor", "--healthy", *healthy, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "rotor 3 (rear left) gives" in said and "less thrust than it did" in said and "Fly mixed" in said
    page = (tmp_path / "report.html").read_text()
    assert "The vehicle from above" in page and page.count("<circle") == 4
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["advice"]["drive"] == "mixed" and report["platform"] == "quadrotor"


def _parts(log):
    return log.x, log.u, log.dt, "quadrotor"


def test_another_vehicle_is_compared_with_its_own_healthy_flights(tinykoop, tmp_path):
    log = bridge.quadrotor("mixed", SECONDS, 3, [bridge.Effect("rotor2_thrust", (-0.15,))], vehicle="iris")[0]
    bridge.write_log(tmp_path / "iris.csv", *_parts(log))
    done = tinykoop("diagnose", tmp_path / "iris.csv", "--robot", "quadrotor:iris", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    effect, *_ = json.loads((tmp_path / "report.json").read_text())["effects"]
    assert effect["name"] == "rotor2_thrust" and effect["params"]["a"] == pytest.approx(-0.15, abs=0.03)
    done = tinykoop("diagnose", tmp_path / "iris.csv", "--robot", "quadrotor:other", "--out", tmp_path)
    assert done.returncode == 2 and "there is no vehicle 'other'" in done.stderr


def test_what_needs_predictions_row_by_row_is_refused(tinykoop, tmp_path):
    bridge.write_log(tmp_path / "log.csv", *_parts(flown("rotor2_thrust", a=-0.15)))
    log, out = tmp_path / "log.csv", ("--robot", "quadrotor", "--out", tmp_path)
    for case in (("--mcap", tmp_path / "log.mcap"), (log, "--pool")):
        done = tinykoop("diagnose", log, *case, *out)
        assert done.returncode == 2 and "not for a quadrotor" in done.stderr and len(done.stderr.splitlines()) == 1
    assert tinykoop("diagnose", log, *out).returncode == 0
    (tmp_path / "vehicle.toml").write_text("mass = 1.0\n")
    done = tinykoop("patch", tmp_path / "report.json", "--into", tmp_path / "vehicle.toml")
    assert done.returncode == 2 and "by hand" in done.stderr


def test_bad_flights_are_refused_in_one_line(tinykoop, tmp_path):
    log = flown()
    for case, x, u, dt, words in (
        ("slow", log.x[::10], log.u[::10], 10 * log.dt, "at 20 Hz at least"),
        ("still", log.x, np.tile(log.u[500], (len(log.u), 1)), log.dt, "m1 to m4 never change"),
    ):
        bridge.write_log(tmp_path / f"{case}.csv", x, u, dt, "quadrotor")
        done = tinykoop("diagnose", tmp_path / f"{case}.csv", "--robot", "quadrotor", "--out", tmp_path)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and words in done.stderr


def _damaged(random, log):
    """A log with something wrong, as columns that are absent, stuck, scaled, late or cut off, and requests that are lost or loud."""
    x, u = log.x.copy(), log.u.copy()
    kind, column, rotor, k = random.integers(8), random.integers(15), random.integers(4), random.integers(max(len(x) - 300, 1))
    if kind == 0:
        x[:, random.random(15) < 0.5] = np.nan
    elif kind == 1:
        x[:, column] *= random.choice([0, 1e3, 1e6, -1])
    elif kind == 2:
        u[:, rotor] = random.choice([0, 0.5, 1])
    elif kind == 3:
        u[:, :4] = np.clip(u[:, :4] + random.normal(0, 0.3, (len(u), 4)), 0, 1)
    elif kind == 4:
        x[k : k + 100], u[k + 150 : k + 160, :4] = np.nan, np.nan
    elif kind == 5:
        x, u = x[k : k + 300], u[k : k + 300]
    elif kind == 6:
        x = np.roll(x, 7, axis=0)
    else:
        u[:, :4], u[:, 4] = np.clip(1.4 * u[:, :4], 0, 1), np.nan
    return replace(log, t=log.t[: len(x)], x=x, u=u, usable=log.usable[: len(x) - 1])


@pytest.mark.parametrize("seed", range(16))
def test_a_damaged_log_gives_a_report_or_one_line(seed):
    random = np.random.default_rng(seed)
    log = flown(kind=("mixed", "legs")[seed % 2])
    for _ in range(2):
        log = _damaged(random, log)
    healthy = [flown(kind="legs")] if seed % 3 == 0 else []
    try:
        result = quadrotor.diagnose(log, healthy=healthy)
    except UserError as refused:
        assert "record a flight" in str(refused)
    else:
        told = quadrotor.Teller(result).story()
        assert told.sentence and result.report["verdict"] in ("none", "known", "partly", "unknown")
