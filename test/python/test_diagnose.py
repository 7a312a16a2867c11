"""The gap diagnoser: its statistics computed another way, what its answer must not depend on, and known answers."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.diagnose import elsewhere
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr import diagnose
from tinykoop.diagnose.prediction_errors import judge
from tinykoop.diagnose.prediction_errors.fit import Cause
from tinykoop.plumbing.errors import UserError

DT, START = 0.05, (0.3, -0.2, 2.0)
SP, ST = 0.004, 0.004  # m, rad
# the forms of these have tests of their own, test_effect_forms.py
VOCABULARY = [name for name, (_, reported) in bridge.families().items() if name == reported and name != "measurement_noise"]
SHORT, LONG = 450, 900  # rows
ENOUGH = {"dead_band": 600}  # rows in which an effect shows often enough, where SHORT is too few
PARAMETERS = {name: effect.parameters for name, effect in ddr.effects(np.ones((2, 2))).items()}


# ---- logs ----------------------------------------------------------------------------------------


def drive(rows=SHORT, seed=0):
    """Commands of either sign, held or ramped for half a second to two, every fourth stretch slow."""
    rng, parts = np.random.default_rng(seed), []
    while sum(map(len, parts)) < rows:
        begin, end = rng.uniform((-0.8, -1.2), (2.2, 1.2), (2, 2))
        shape = rng.integers(4)
        begin = 0.15 * begin if shape == 0 else begin
        parts.append(np.linspace(begin, end if shape == 1 else begin, rng.integers(10, 45)))
    return np.concatenate(parts)[:rows]


def noise_of(kind, shape, seed):
    """Of unit variance, outliers apart."""
    rng = np.random.default_rng(1000 + seed)
    e = rng.standard_normal(shape)
    if kind == "coloured":
        for k in range(1, len(e)):
            e[k] = 0.8 * e[k - 1] + 0.6 * e[k]
    elif kind == "heavy":
        e = rng.standard_t(3, shape) / np.sqrt(3)
        bad = rng.choice(len(e), len(e) // 100, replace=False)
        e[bad] += 30 * rng.standard_normal((len(bad), 3))
    return e


def as_log(x, u, usable=None, dt=DT):
    return bridge.Log(np.arange(len(x)) * dt, x, u, np.ones(len(x) - 1, bool) if usable is None else usable, dt)


def log_of(u, active=(), kind="white", seed=0, integrator=bridge.ARC, size=1.0):
    """What a robot with these effects measures."""
    x = bridge.simulate(u[:-1], DT, START, list(active), integrator)
    return as_log(x + size * noise_of(kind, x.shape, seed) * (SP, SP, ST), u)


def usual(*names):
    return [bridge.usual_effect(name) for name in names]


def rows_of(name):
    return ENOUGH.get(name, SHORT)


@functools.lru_cache(None)
def single(name):
    """The diagnosis of a log with one effect, and of a fresh log."""
    rows = rows_of(name)
    return diagnose(log_of(drive(rows), usual(name)), fresh=log_of(drive(rows, 50), usual(name), seed=9))


def effects_of(report):
    return {effect["name"]: effect for effect in report["effects"]}


def said(report, name):
    """Whether an effect is named, first or as one that may be it."""
    return name in effects_of(report) or any(name in others for others in report["ambiguous_with"].values())


def surest(report):
    return max((effect["confidence"] for effect in report["effects"]), default=0.0)


def recorded(report):
    """The effects of a report as the simulator takes them."""
    found = []
    for effect in report["effects"]:
        for t0, t1 in effect["segments"]:
            whole = [t0, t1] == [0.0, report["log"]["seconds"]]
            found.append(bridge.Effect(effect.get("form", effect["name"]), tuple(effect["params"].values()), t0, np.inf if whole else t1))
    return found


# ---- what the answer must not depend on ----------------------------------------------------------

MIXED = ("wheel_asymmetry", "world_drift")


@functools.lru_cache(None)
def mixed():
    return diagnose(log_of(drive(), usual(*MIXED))).report


def variant(change):
    log = log_of(drive(), usual(*MIXED))
    x, u = log.x.copy(), log.u.copy()
    change(x, u)
    return diagnose(as_log(x, u)).report


def same_answer(report, expected, params=None):
    """Verdict, names, parameters within a tenth of their intervals, gaps within 1 %."""
    assert report["verdict"] == expected["verdict"] == "known"
    assert [e["name"] for e in report["effects"]] == [e["name"] for e in expected["effects"]]
    assert report["ambiguous_with"] == expected["ambiguous_with"]
    for ours, theirs in zip(report["effects"], expected["effects"]):
        for name, value in (params or (lambda effect: effect["params"]))(theirs).items():
            low, high = theirs["params_ci95"][name]
            assert abs(ours["params"][name] - value) < 0.1 * (high - low), (name, ours["params"], value)
    for key in ("before", "after", "noise_floor"):
        for H in ("1", "10", "50"):
            assert report["gap"][key][H] == pytest.approx(expected["gap"][key][H], rel=0.01)


def test_mixed_log_is_understood():
    assert set(effects_of(mixed())) == set(MIXED)


def test_place_and_direction_do_not_matter():
    turn = 1.1

    def move(x, u):
        x[:, :2] = x[:, :2] @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + (800.0, -300.0)
        x[:, 2] += turn

    def expected(effect):
        if effect["name"] != "world_drift":
            return effect["params"]
        wind = complex(*effect["params"].values()) * np.exp(1j * turn)
        return {"wx": wind.real, "wy": wind.imag}

    same_answer(variant(move), mixed(), expected)


def test_left_and_right_do_not_matter():
    def mirror(x, u):
        x[:, 1:] *= -1
        u[:, 1] *= -1

    flipped = {"c": -1, "wy": -1}
    same_answer(variant(mirror), mixed(), lambda e: {k: v * flipped.get(k, 1) for k, v in e["params"].items()})


def test_wrapping_the_heading_does_not_matter():
    def wrap(x, u):
        x[:, 2] = np.mod(x[:, 2] + np.pi, 2 * np.pi) - np.pi

    same_answer(variant(wrap), mixed())


def test_seed_does_not_matter():
    same_answer(diagnose(log_of(drive(), usual(*MIXED)), seed=1).report, mixed())


def test_same_log_same_bytes():
    again = diagnose(log_of(drive(), usual(*MIXED))).report
    assert json.dumps(again) == json.dumps(mixed())


def test_steps_are_the_same_whether_they_are_kept(monkeypatch):
    """However long the log: at least those asked for last are kept, of the variant that they are of."""
    trials, log = [(), (Cause("yaw_gain", (0.1,)),)], log_of(drive())
    kept = ddr.Path(log)
    arc = kept.steps(trials)[0]
    kept.step_by(1)
    euler = kept.steps(trials)[0]
    assert (arc != euler).any()
    monkeypatch.setattr(ddr.path, "KEPT", 1.0)
    path = ddr.Path(log)
    for variant, steps in ((0, arc), (1, euler), (0, arc)):
        for same in (kept, path):
            same.step_by(variant)
            np.testing.assert_array_equal(same.steps(trials)[0], steps)


def test_masked_poses_do_not_matter():
    """Whatever stands in rows that are masked, the answer is the same."""
    reports = []
    for absurd in (0.0, 1e6):
        log = log_of(drive(), usual(*MIXED))
        bad = np.random.default_rng(1).uniform(size=len(log.x)) < 0.01
        log.x[bad] = absurd
        reports.append(diagnose(as_log(log.x, log.u, ~(bad[1:] | bad[:-1]))).report)
    same_answer(*reports)


# ---- answers -------------------------------------------------------------------------------------


def path_error(name, params, u):
    """How far the fitted effect's path is from the true one, as a share of how far the effect moves it."""
    true, fitted, nominal = (
        bridge.windows(bridge.simulate(u, DT, START, usual(name), bridge.ARC), u, DT, range(50, len(u) - 50, 5), [50], a, integrator=bridge.ARC)[0]
        for a in (usual(name), [bridge.Effect(name, tuple(params.values()))], [])
    )  # fmt: skip
    return np.sqrt(np.mean((fitted - true)[..., :2] ** 2) / np.mean((nominal - true)[..., :2] ** 2))


@pytest.mark.parametrize("name", VOCABULARY)
def test_single_effect(name):
    report = single(name).report
    assert report["verdict"] == "known" and list(effects_of(report)) == [name] and report["ranking"][0]["name"] == name
    effect = report["effects"][0]
    assert effect["segments"] == [[0.0, report["log"]["seconds"]]] and effect["confidence"] > 0.9
    assert path_error(name, effect["params"], drive(rows_of(name))) < 0.05
    if len(effect["params"]) <= 2:  # of curves with more, the path is the judge
        for value, true, commanded in zip(effect["params"].values(), bridge.usual_effect(name).parameters, np.abs(drive(rows_of(name))).T):
            if name == "dead_band":  # between commanded levels it may lie anywhere
                assert np.sum((commanded > min(value, true)) & (commanded < max(value, true))) <= 2
            else:
                assert value == pytest.approx(true, rel=0.05), effect


def test_intervals_hold_the_truth_mostly():
    inside = []
    for name in VOCABULARY:
        effect = effects_of(single(name).report)[name]
        for (low, high), true in zip(effect["params_ci95"].values(), bridge.usual_effect(name).parameters):
            assert low <= high
            inside.append(low <= true <= high)
    assert np.mean(inside) > 0.8, inside


@pytest.mark.parametrize("names", [("actuator_lag", "wheel_asymmetry"), ("dead_band", "lateral_skid"), ("speed_gain", "transport_delay")])
def test_pair(names):
    report = diagnose(log_of(drive(SHORT, 3), usual(*names))).report
    assert report["verdict"] == "known" and set(effects_of(report)) == set(names)


def test_lag_beside_delay_may_be_of_second_order():
    """The best-known approximation of slow actuators is no proof of either."""
    result = diagnose(log_of(drive(SHORT, 4), usual("actuator_lag", "transport_delay")))
    assert set(effects_of(result.report)) == {"actuator_lag", "transport_delay"}
    assert surest(result.report) <= 0.8 and "second order" in " ".join(ddr.Teller(result).cannot_tell())


def test_soft_limit_is_a_form_of_saturation():
    """A speed limit with a soft knee, sharper than that of the library."""
    u = drive(LONG, 7)
    v = u[:, 0] / (1 + np.abs(u[:, 0] / 1.2) ** 12) ** (1 / 12)
    x = bridge.simulate(np.column_stack([v, u[:, 1]])[:-1], DT, START, [], bridge.ARC)
    report = diagnose(as_log(x + noise_of("white", x.shape, 3) * (SP, SP, ST), u)).report
    assert report["verdict"] == "known" and report["unexplained"]["share"] < 0.1
    assert effects_of(report)["saturation"]["form"] == "saturation_soft"


def test_clock_is_said_to_be_both_gains():
    assert set(single("clock_scale").report["ambiguous_with"]["clock_scale"]) >= {"speed_gain", "yaw_gain"}


@pytest.mark.parametrize("kind, rows", [("white", SHORT), ("heavy", SHORT), ("coloured", LONG), ("coloured", SHORT)])
def test_healthy(kind, rows):
    for seed in range(3):
        report = diagnose(log_of(drive(rows, seed), (), kind, seed)).report
        assert report["verdict"] == "none" and not report["effects"], seed


@pytest.mark.parametrize("integrator", [bridge.EULER, bridge.MIDPOINT, bridge.ARC, bridge.SEMI_IMPLICIT])
def test_stepping_is_no_effect(integrator):
    assert diagnose(log_of(drive(), integrator=integrator)).report["verdict"] == "none"
    report = diagnose(log_of(drive(seed=2), usual("speed_gain"), integrator=integrator)).report
    assert list(effects_of(report)) == ["speed_gain"]


def test_gap_too_small_to_matter():
    report = diagnose(log_of(drive(LONG), [bridge.Effect("heading_bias", (0.0015,))])).report
    assert report["verdict"] == "none" and not report["effects"]


def test_noise_that_doubles_is_no_effect():
    u = drive(LONG)
    x = bridge.simulate(u[:-1], DT, START, integrator=bridge.ARC)
    x += noise_of("white", x.shape, 0) * SP * np.where(np.arange(len(x)) < len(x) // 2, 1, 2)[:, None]
    assert diagnose(as_log(x, u)).report["verdict"] == "none"


# ---- what the log cannot tell --------------------------------------------------------------------


STEADY = ["speed_gain", "yaw_gain", "yaw_bias", "lateral_skid", "heading_bias", "stribeck_friction",
          "sensor_lever_arm", "pacejka_slip"]  # fmt: skip


@pytest.mark.parametrize("name", STEADY)
def test_steady_drive_is_no_proof(name):
    """One command throughout: whatever it is, others would look the same."""
    report = diagnose(log_of(np.tile([1.0, 0.4], (400, 1)), usual(name))).report
    assert said(report, name)
    assert any(report["ambiguous_with"].values()) or surest(report) < 0.9, report["effects"]


@pytest.mark.parametrize("name", ["actuator_lag", "transport_delay", "dead_band", "backlash"])
def test_steady_drive_does_not_test_what_acts_on_changes(name):
    report = diagnose(log_of(np.tile([1.0, 0.4], (400, 1)), usual(name))).report
    assert report["verdict"] == "none" and name in report["not_testable"]


def test_lag_or_delay_on_a_slow_drive():
    """Two paths of 50 rows that no noise lets apart: both are said."""
    t = np.arange(SHORT) * DT
    u = np.stack([1 + 0.3 * np.sin(0.1 * t), 0.3 * np.sin(0.1 * t + 1)], axis=1)
    both = [[bridge.Effect(name, (0.3,))] for name in ("transport_delay", "actuator_lag")]
    log = log_of(u, both[0])
    late, lagging, prompt = (
        bridge.windows(log.x, u, DT, range(50, SHORT - 50, 50), range(1, 50), active, integrator=bridge.ARC)[0]
        for active in (*both, [])
    )  # fmt: skip
    assert (((late - lagging) / (SP, SP, ST)) ** 2).sum() < 6 < (((late - prompt) / (SP, SP, ST)) ** 2).sum() / 100
    report = diagnose(log).report
    assert said(report, "transport_delay") and said(report, "actuator_lag")


def slipping(u, share, seed):
    """What the wheels do of commands (K, 2): each slips at random by a share of its speed, AR(1) of 0.3 s, half a metre apart."""
    rng, keeps, slip = np.random.default_rng(seed), np.exp(-DT / 0.3), np.zeros((len(u), 2))
    for k in range(1, len(u)):
        slip[k] = keeps * slip[k - 1] + share * np.sqrt(1 - keeps**2) * rng.normal(size=2)
    left, right = ((u[:, 0] + side * 0.25 * u[:, 1]) * (1 + slip[:, i]) for i, side in enumerate((-1, 1)))
    return np.stack([(left + right) / 2, (right - left) / 0.5], axis=1)


@pytest.mark.parametrize("names", [(), ("yaw_gain",)])
def test_random_slip_is_noise_on_the_log_and_on_a_fresh_one(names):
    logs = []
    for seed in (5, 6):
        u = drive(1500, seed)
        x = bridge.simulate(slipping(u, 0.03, seed)[:-1], DT, START, usual(*names), bridge.ARC)
        logs.append(as_log(x + noise_of("white", x.shape, seed) * (SP, SP, ST) / 4, u))
    report = diagnose(logs[0], fresh=logs[1]).report
    assert report["verdict"] == ("known" if names else "none") and tuple(effects_of(report)) == names
    for part in (report, report["fresh"]):
        floor, after = part["gap"]["noise_floor"]["50"], part["gap"]["after"]["50"]
        assert 0.5 * after < floor <= after * 1.001
    assert report["noise"]["process"]["longitudinal"]["share"] == pytest.approx(0.03 / np.sqrt(2), rel=0.3)


def test_delay_taken_out_looks_like_a_lag_of_second_order():
    result = diagnose(log_of(drive(SHORT), usual("transport_delay")), without=("transport_delay",))
    assert "transport_delay" not in {row["name"] for row in result.report["ranking"]} and surest(result.report) < 0.9
    assert "may as well be a delay" in " ".join(ddr.Teller(result).cannot_tell())


@pytest.mark.parametrize("name", ["world_drift", "heading_bias", "yaw_bias"])
def test_effect_taken_out_is_unknown(name):
    report = diagnose(log_of(drive(SHORT), usual(name)), without=(name,)).report
    assert report["verdict"] == "unknown" and name not in {row["name"] for row in report["ranking"]}
    assert surest(report) < 0.9


def test_parameter_beyond_its_bound_is_said():
    """A lever arm of 5 m, of which the vocabulary takes 3."""
    log = log_of(drive(400))
    log.x[:, :2] += 5 * np.stack([np.cos(log.x[:, 2]), np.sin(log.x[:, 2])], axis=1)
    report = diagnose(log).report
    arm = effects_of(report).get("sensor_lever_arm")
    assert report["verdict"] == "unknown" or "lx" in arm["at_bound"]


def test_threshold_that_was_not_reached_is_left_open():
    """The yaw rate never comes near its saturation: its interval must not end above the commands."""
    u = drive(LONG) * (1, 0.3)
    report = diagnose(log_of(u, [bridge.Effect("saturation", (1.2, 2.0))])).report
    effect = effects_of(report)["saturation"]
    assert effect["params"]["v_max"] == pytest.approx(1.2, rel=0.02)
    low, high = effect["params_ci95"]["w_max"]
    assert high > 2.0 and high - low > 1.0, effect


# ---- logs as they come -----------------------------------------------------------------------------


def test_spinning_robot_and_wrapped_yaw():
    u = np.column_stack([0.3 + 0 * np.arange(SHORT), np.where(np.arange(SHORT) // 40 % 2, 4.0, 2.5)])
    log = log_of(u, usual("yaw_gain"))
    log.x[:, 2] = np.angle(np.exp(1j * log.x[:, 2]))
    report = diagnose(log).report
    effect = effects_of(report)["yaw_gain"]
    assert report["verdict"] == "known" and effect["params"]["b"] == pytest.approx(-0.12, rel=0.05)


@pytest.mark.parametrize("names", [(), ("yaw_gain",), ("speed_gain",)])
def test_closed_loop(names):
    """Commands that follow from the noisy measured pose."""
    rng, pose = np.random.default_rng(4), np.array(START)
    x, u = [], []
    for k in range(SHORT):
        seen = pose + rng.normal(0, (SP, SP, ST))
        goal = 3 * np.array([np.cos(0.01 * k), np.sin(0.023 * k)])
        off = goal - seen[:2]
        turn = np.angle(np.exp(1j * (np.arctan2(off[1], off[0]) - seen[2])))
        command = np.array([np.clip(1.5 * np.hypot(*off) * np.cos(turn), 0, 2.0), np.clip(2.5 * turn, -1.5, 1.5)])
        x.append(seen)
        u.append(command)
        pose = bridge.simulate(command[None], DT, pose, usual(*names), bridge.ARC)[1]
    report = diagnose(as_log(np.array(x), np.array(u))).report
    assert report["verdict"] == ("known" if names else "none") and tuple(effects_of(report)) == names


def test_commands_stamped_a_row_early_look_like_a_delay_of_a_row():
    u = drive()
    log = log_of(u)
    report = diagnose(as_log(log.x[:-1], u[1:])).report
    assert effects_of(report)["transport_delay"]["params"]["delay"] == pytest.approx(DT, rel=0.05)


def test_commands_stamped_a_row_late_have_no_cause_here():
    """Poses that move before the command: no effect of the vocabulary does that."""
    u = drive(400)
    log = log_of(u)
    report = diagnose(as_log(log.x[1:], u[:-1])).report
    assert report["verdict"] == "unknown" and surest(report) < 0.9


def test_gaps_and_a_robot_that_was_carried():
    u = drive(LONG)
    log = log_of(u, usual("actuator_lag"))
    for row in (300, 700):
        log.x[row:] += (5.0, -3.0, 0.0)
    usable = log.usable.copy()
    usable[[299, 699]] = False
    report = diagnose(as_log(log.x, u, usable)).report
    assert list(effects_of(report)) == ["actuator_lag"]
    assert effects_of(report)["actuator_lag"]["params"]["tau"] == pytest.approx(0.3, rel=0.05)


def outlying(active=()):
    """A hundredth of the rows a hundred times the noise off."""
    log = log_of(drive(), active)
    rng = np.random.default_rng(5)
    bad = rng.choice(len(log.x), len(log.x) // 100, replace=False)
    log.x[bad] += rng.normal(0, (100 * SP, 100 * SP, 100 * ST), (len(bad), 3))
    return diagnose(log).report


def test_outliers():
    assert outlying()["verdict"] == "none"
    report = outlying(usual("yaw_gain"))
    assert list(effects_of(report)) == ["yaw_gain"]
    assert report["effects"][0]["params"]["b"] == pytest.approx(-0.12, rel=0.05)
    assert report["effects"][0]["confidence"] > 0.5


def test_effect_that_switches_on():
    onset = 31.0
    effect = bridge.Effect("yaw_gain", bridge.usual_effect("yaw_gain").parameters, onset)
    report = diagnose(log_of(drive(LONG, 6), [effect])).report
    assert list(effects_of(report)) == ["yaw_gain"]
    ((t0, t1),) = report["effects"][0]["segments"]
    assert abs(t0 - onset) < 1.0 and t1 == pytest.approx(report["log"]["seconds"], abs=1.0)


# ---- how much --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["speed_gain", "dead_band", "pacejka_slip"])
def test_fresh_log(name):
    """Nothing is fitted there, and its gap is what bridge.windows gives."""
    rows = rows_of(name)
    report, u = single(name).report, drive(rows, 50)
    assert report["effects"] == diagnose(log_of(drive(rows), usual(name))).report["effects"]
    fresh = log_of(u, usual(name), seed=9)
    gap = report["fresh"]["gap"]
    for key, active in (("before", ()), ("after", recorded(report))):
        _, off = bridge.windows(fresh.x, u, DT, range(50, rows - 50), [1, 10, 50], active, integrator=bridge.ARC)
        for H, expected in zip(("1", "10", "50"), np.sqrt((off[..., :2] ** 2).sum(-1).mean(0))):
            assert gap[key][H] == pytest.approx(expected, rel=0.03)


def test_confidence_falls_where_a_fresh_log_is_missed_by_more_than_its_noise():
    """Three quarters of the gap close there: the same effect, of another size, or another effect."""
    larger = bridge.Effect("speed_gain", (1.3 * usual("speed_gain")[0].parameters[0],))
    fresh = log_of(drive(SHORT, 50), [larger], seed=9)
    (sure,) = single("speed_gain").report["effects"]
    (doubted,) = diagnose(log_of(drive(SHORT), usual("speed_gain")), fresh=fresh).report["effects"]
    assert sure["confidence"] > 0.99 and doubted["confidence"] == judge.DOUBT
    assert doubted["params"] == sure["params"]


@pytest.mark.parametrize("acts", [True, False], ids=["still there", "gone"])
def test_effect_of_a_part_acts_on_a_fresh_log_all_along_or_not_at_all(acts):
    """The fresh log is shorter than the log was when the effect set in."""
    late = bridge.Effect("yaw_gain", bridge.usual_effect("yaw_gain").parameters, 31.0)
    there = usual("yaw_gain") if acts else []
    fresh = log_of(drive(500, 7), there, seed=3)
    result = diagnose(log_of(drive(LONG, 6), [late]), fresh=fresh)
    report = result.report
    (effect,) = report["fresh"]["effects"]
    assert (effect["name"], effect["acts"], effect["params"]) == ("yaw_gain", acts, report["effects"][0]["params"])
    found = [bridge.Effect("yaw_gain", tuple(effect["params"].values()))] if acts else []
    _, off = bridge.windows(fresh.x, fresh.u, DT, range(450), [50], found, integrator=bridge.ARC)
    assert report["fresh"]["gap"]["after"]["50"] == pytest.approx(np.sqrt((off[..., :2] ** 2).sum(-1).mean()), rel=0.03)
    assert report["fresh"]["gap"]["after"]["50"] < 1.1 * report["fresh"]["gap"]["noise_floor"]["50"]
    said = " ".join(ddr.Teller(result).asides())
    assert f"On the fresh log yaw gain is assumed {'to act throughout' if acts else 'not to act'}" in said


@pytest.mark.parametrize("changed", [True, False])
def test_what_the_healthy_robot_has_belongs_to_the_simulator(changed):
    """A robot that always lagged: the question is what has changed since."""
    lag = bridge.Effect("actuator_lag", (0.25,))
    before = [log_of(drive(500, seed), [lag], seed=seed) for seed in (3, 4)]
    result = diagnose(log_of(drive(SHORT, 5), [lag, *([bridge.Effect("yaw_gain", (0.12,))] * changed)], seed=5), healthy=before)
    (known,) = result.report["healthy"]["effects"]
    assert known["name"] == "actuator_lag" and abs(known["params"]["tau"] - 0.25) < 0.01
    said = ddr.Teller(result).sentence()
    if changed:
        assert list(effects_of(result.report)) == ["yaw_gain"] and "since the healthy logs" in said
        assert result.report["gap"]["before"]["50"] < 0.5 * diagnose(result.log).report["gap"]["before"]["50"]
    else:
        assert result.report["verdict"] == "none" and "nothing has changed since the healthy logs" in said


def test_healthy_logs_of_another_rate_are_refused():
    other = replace(log_of(drive(300)), dt=0.1)
    with pytest.raises(UserError, match="every 0.1 s there and every 0.05 s in the log"):
        diagnose(log_of(drive(300)), healthy=[other])


def test_battery_sags_as_fast_on_a_fresh_log_of_another_length():
    loss, rows = 0.2, 500
    fresh = log_of(drive(rows, 7), [bridge.Effect("battery_sag", (loss * (rows - 1) / (LONG - 1),))], seed=3)
    result = diagnose(log_of(drive(LONG, 6), [bridge.Effect("battery_sag", (loss,))]), fresh=fresh)
    report = result.report
    assert effects_of(report)["battery_sag"]["params"]["loss_at_end"] == pytest.approx(loss, rel=0.02)
    assert report["fresh"]["effects"][0]["params"]["loss_at_end"] == pytest.approx(loss * (rows - 1) / (LONG - 1), rel=0.02)
    assert report["fresh"]["gap"]["closed_fraction"]["50"] > 0.9
    assert "taken to grow as fast, to 11 % at its end" in " ".join(ddr.Teller(result).asides())


def test_loss_on_a_fresh_log_goes_with_the_time_it_acted_and_stays_in_bounds():
    def carried(segments, own, other, loss=0.1):
        logs = [as_log(np.zeros((rows, 3)), np.zeros((rows, 2)), dt=0.1) for rows in (own, other)]
        ((cause, acts),) = elsewhere.carry([Cause("battery_sag", (loss,), segments)], PARAMETERS, logs, lambda causes: -len(causes))
        assert acts and cause.segments == ((-np.inf, np.inf),)
        return cause.params[0]

    assert carried(((-np.inf, np.inf),), 201, 201) == 0.1
    assert carried(((-np.inf, np.inf),), 201, 101) == pytest.approx(0.05)
    assert carried(((5.0, 15.0),), 201, 101) == pytest.approx(0.1)
    assert carried(((12.0, np.inf),), 201, 201) == pytest.approx(0.25)
    assert carried(((5.0, 6.0),), 201, 1001) == 0.9


def test_every_effect_of_a_part_is_tried_on_and_off_on_a_fresh_log():
    causes = [Cause("speed_gain", (0.1,), ((1.0, 2.0),)), Cause("yaw_bias", (0.1,)), Cause("yaw_gain", (0.1,), ((3.0, np.inf),))]
    tried, log = [], as_log(np.zeros((100, 3)), np.zeros((100, 2)))

    def cost(some):
        tried.append({c.name for c in some})
        return len({"speed_gain"} ^ tried[-1])

    carried = elsewhere.carry(causes, PARAMETERS, (log, log), cost)
    assert [acts for _, acts in carried] == [True, True, False]
    assert len(tried) == 4 and all("yaw_bias" in names for names in tried)


@pytest.mark.parametrize("name", VOCABULARY)
def test_claim_is_realised(name):
    """The closed share of the log that was fitted, against that of a fresh log."""
    report = single(name).report
    claimed, realised = (gap["closed_fraction"]["50"] for gap in (report["gap"], report["fresh"]["gap"]))
    assert claimed == pytest.approx(realised, abs=0.05) and realised > 0.9


def test_noise_floor_is_what_the_noise_leaves():
    """Against predictions with the true effect."""
    log = log_of(drive(), usual("speed_gain"))
    _, off = bridge.windows(log.x, log.u, DT, range(50, SHORT - 50), [1, 10, 50], usual("speed_gain"), integrator=bridge.ARC)
    floor = single("speed_gain").report["gap"]["noise_floor"]
    for H, expected in zip(("1", "10", "50"), np.sqrt((off[..., :2] ** 2).sum(-1).mean(0))):
        assert floor[H] == pytest.approx(expected, rel=0.08)
