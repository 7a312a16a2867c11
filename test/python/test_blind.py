"""The blind check by itself: its plant against host_sim, its seal, and its scorer on reports of known worth."""

import json
import sys

import numpy as np
import pytest
from tinykoop import blind, bridge
from tinykoop.blind import drives, plant, score, tiers
from tinykoop.blind.plant import Cause
from tinykoop.plumbing.errors import UserError

DT, START = 0.05, (0.3, -0.2, 2.0)


def commands(rows=400, seed=1):
    return drives.rich(np.random.default_rng(seed), rows, DT)[0]


def usual(name):
    reached = {"wheel_saturation": {"v_max": 0.7}}.get(name, {})
    return {row[0]: row[4] for row in bridge.effects()[name][1]} | reached


def test_effect_named_without_parameters_is_no_failure():
    """SINDy names thresholds and slip without fitting them: right names, no parameter error."""
    for name in ("saturation", "pacejka_slip"):
        cause = {"name": name, "parameters": usual(name)}
        assert score.parameter_errors({"name": name, "params": {}}, cause, commands()) == ({}, {})


# ---- plant -------------------------------------------------------------------------------------


EXEMPT = {  # effects of the contract's vocabulary that only one side writes, and why
    "measurement_noise": "plant.noise() draws the noise",
    "no_traction": "the diagnoser tests whether the pose answers, and simulates nothing",
}
SHARED = [name for name in plant.PLAIN if name in bridge.effects()]


def test_vocabulary_is_host_sims():
    reported = list(dict.fromkeys(name for _, name in bridge.families().values()))
    assert set(reported) ^ set(plant.PLAIN) == set(EXEMPT)
    assert set(plant.OTHER) == set(plant.PLAIN) - {"no_traction"} and len(plant.NEVER) >= 10
    assert not set(plant.NEVER) & set(bridge.effects())


@pytest.mark.parametrize("name", SHARED)
@pytest.mark.parametrize("span", [(0.0, np.inf), (3.0, 15.5)])
def test_plain_effect_is_host_sims_at_small_steps(name, span):
    u, fine = commands(), 20
    ours = plant.simulate(u, DT, [Cause(name, usual(name), "plain", *span)], START)
    active = [bridge.Effect(name, tuple(usual(name).values()), *span)]
    theirs = bridge.simulate(np.repeat(u, fine, axis=0), DT / fine, START, active, bridge.ARC)[::fine]
    nominal = bridge.simulate(u, DT, START, integrator=bridge.ARC)
    assert np.max(np.abs(ours - theirs)) < 1e-4
    assert np.max(np.abs(theirs - nominal)) > 5e-3


def test_all_effects_compose_in_host_sims_order():
    u, fine = commands(), 50
    mixed = np.random.default_rng(0).permutation(SHARED)
    ours = plant.simulate(u, DT, [Cause(str(name), usual(name)) for name in mixed], START)
    active = [bridge.Effect(name, tuple(usual(name).values())) for name in SHARED]
    theirs = bridge.simulate(np.repeat(u, fine, axis=0), DT / fine, START, active, bridge.ARC)[::fine]
    assert np.max(np.abs(ours - theirs)) < 3e-3


def moved(cause, v, w, rows=400, dt=DT):
    """Wheels' speed and turn, and poses, under constant commands after a second of standstill."""
    u = np.where(np.arange(rows)[:, None] < 1 / dt, 0.0, [[v, w]])
    return plant.drive(u, dt, [cause])


def test_later_effects_do_what_the_contract_says():
    t = np.arange(400) * DT - 1
    slow = moved(Cause("speed_lag", {"tau": 0.5}), 1.0, 0.5)
    assert np.allclose(slow.v[30:], 1 - np.exp(-(t[30:] + DT / 2) / 0.5), atol=1e-3) and slow.w[20] == 0.5
    slow = moved(Cause("yaw_lag", {"tau": 0.5}), 1.0, 0.5)
    assert np.allclose(slow.w[30:], 0.5 - 0.5 * np.exp(-(t[30:] + DT / 2) / 0.5), atol=1e-3) and slow.v[20] == 1
    slow = moved(Cause("acceleration_limit", {"a": 0.4, "alpha": 0.1}), 1.0, 0.5)
    assert np.allclose(slow.v, np.clip(0.4 * (t + DT / 2), 0, 1), atol=0.01)
    assert np.allclose(slow.w, np.clip(0.1 * (t + DT / 2), 0, 0.5), atol=0.01)
    still = moved(Cause("no_traction"), 1.0, 0.5)
    assert np.all(still.poses == 0) and still.v[-1] == 1 and still.turn[-1] == 0


@pytest.mark.parametrize("v, w, limit, band", [(1.0, 1.0, (0.8, 0.0), (1.0, 1.0)), (0.1, 1.0, (0.1, 1.0), (0.15, 0.75))])
def test_wheels_limit_and_stand_still_at_the_rim(v, w, limit, band):
    """Track 0.4 m: the rims are commanded at v -+ 0.2 w; the limit is 0.8 and the dead band 0.15."""
    found = moved(Cause("wheel_saturation", {"v_max": 0.8, "track": 0.4}), v, w)
    assert (found.v[-1], found.w[-1]) == (pytest.approx(limit[0]), pytest.approx(limit[1]))
    found = moved(Cause("wheel_dead_band", {"v_db": 0.15, "track": 0.4}), v, w)
    assert (found.v[-1], found.w[-1]) == (pytest.approx(band[0]), pytest.approx(band[1]))


@pytest.mark.parametrize("name", plant.NEVER)
def test_unseen_effect_acts_and_stays_finite(name):
    u = commands(1200)
    p = tiers.unseen(np.random.default_rng(0), name, u, 60.0)
    x = plant.simulate(u, DT, [Cause(name, p, "never")], START, np.random.default_rng(0))
    assert np.all(np.isfinite(x)) and tiers.gap(x, u, DT)["50"] > 0.01


def test_noise_is_what_it_says():
    for kind in ("white", "coloured", "heavy"):
        e = plant.noise(np.random.default_rng(0), kind, 200000, 0.004, 0.007, 0.8)
        core = np.diff(np.quantile(e, (0.25, 0.75), axis=0), axis=0)[0] / (0.004, 0.004, 0.007)
        expected = 2 * 0.740697 / np.sqrt(2) if kind == "heavy" else 1.349  # quartiles of t(4) and of the Gaussian
        assert np.allclose(core, expected, rtol=0.03)
        assert np.allclose(np.mean(e[1:] * e[:-1], axis=0) / np.var(e, axis=0), 0.8 * (kind == "coloured"), atol=0.03)
        assert (np.max(np.abs(e)) > 0.05) == (kind == "heavy")


# ---- drives and labels -------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(8))
def test_rich_drives_cross_zero_and_reach_small_and_large(seed):
    u = commands(2000, seed)
    size = np.abs(u)
    assert np.all(size <= (drives.V, drives.W)) and np.all(size.max(axis=0) > (0.8, 0.4))
    for column in u.T:
        assert np.any(column < 0) and np.any(column > 0)
        assert 0 < np.quantile(np.abs(column[column != 0]), 0.1) < 0.25 * np.max(np.abs(column))


@pytest.mark.parametrize("tier", tiers.TIERS)
def test_same_seed_same_log(tier):
    one, other, third = (tiers.draw(tier, seed, 3) for seed in (1, 1, 2))
    assert json.dumps(one[0]) == json.dumps(other[0])
    assert all(np.array_equal(a, b) for i in (1, 2) for a, b in zip(one[i][:2], other[i][:2]))
    assert json.dumps(one[1][2], default=list) == json.dumps(other[1][2], default=list)
    assert not np.array_equal(one[1][0], third[1][0]) and not np.array_equal(one[1][0], one[2][0])


@pytest.mark.parametrize("tier", ["single", "pair", "triple", "never"])
def test_effects_take_turns(tier):
    deck = tiers.UNSEEN if tier == "never" else tiers.VOCABULARY
    drawn = [tiers.members(tier, 7, k) for k in range(2 * len(deck))]
    assert all(len(set(map(plant.family, names))) == len(names) for names in drawn)
    assert all(len(set(names)) == len(names) for names in drawn)
    firsts = [names[0] for names in drawn]
    assert all(firsts.count(name) == 2 for name in deck)
    assert not any(len(set(names) & set(tiers.EXACT)) > 1 for names in drawn)


def test_label_says_what_the_log_holds():
    """The gap and floor of the label against the log itself, with the true effect and without."""
    label, (x, u, _), _ = tiers.draw("single", 3, tiers_index("speed_gain", 3))
    assert label["truth"] == ["speed_gain"] and label["gap"]["50"] > 2 * label["floor"]["50"]
    true = [bridge.Effect("speed_gain", (label["causes"][0]["parameters"]["a"],))]
    measured = tiers.gap(x, u, label["dt"], active=true)
    for h in ("1", "10", "50"):
        assert measured[h] == pytest.approx(label["floor"][h], rel=0.02)
        both = np.hypot(label["gap"][h], label["floor"][h])
        assert tiers.gap(x, u, label["dt"])[h] == pytest.approx(both, rel=0.1)


@pytest.mark.parametrize("name", ["speed_gain", "battery_sag"])
def test_effect_that_switches_acts_on_the_fresh_log_all_along(name):
    """What is left of the fresh log with it is noise, though it switched on the log; a battery sags as fast on both."""
    k = next(k for k in range(len(tiers.VOCABULARY)) if tiers.members("switch", 3, k) == [name])
    label, _, (x, u, _) = tiers.draw("switch", 3, k)
    (cause,) = label["causes"]
    assert 0 < cause["t0"] < cause["t1"] < (len(x) - 1) * label["dt"]
    (size,) = cause["parameters"].values()
    faster = (len(x) - 1) * label["dt"] / (cause["t1"] - cause["t0"]) if name == "battery_sag" else 1
    left = tiers.gap(x, u, label["dt"], active=[bridge.Effect(name, (size * faster,))])
    assert left["50"] == pytest.approx(label["fresh"]["floor"]["50"], rel=0.03)
    assert label["fresh"]["gap"]["50"] > 2 * left["50"]


def tiers_index(name, seed):
    return next(k for k in range(len(tiers.VOCABULARY)) if tiers.members("single", seed, k) == [name])


# ---- scorer ------------------------------------------------------------------------------------


def label(tier="single", truth=("yaw_bias",), **more):
    causes = [
        {"name": name, "parameters": {"d": 0.02} if name == "yaw_bias" else {"tau": 0.3}, "shape": "plain",
         "t0": 0.0, "t1": 100.0} for name in truth
    ]  # fmt: skip
    gaps = {"1": 0.1, "10": 0.2, "50": 0.5}, {"1": 0.01, "10": 0.02, "50": 0.05}
    both = dict(zip(("gap", "floor"), gaps))
    return {"tier": tier, "truth": list(truth), "alias": False, "causes": causes, "dt": 0.05, "rows": 2001,
            **both, "fresh": both, **more}  # fmt: skip


def report(*names, verdict="known", ambiguous=(), confidence=0.95, after=0.1, claimed=0.9, segments=()):
    effects = [{"name": name, "confidence": confidence, "segments": list(segments),
                "params": {"d": 0.021, "tau": 0.3}, "params_ci95": {"d": [0.0205, 0.0215], "tau": [0.2, 0.4]}}
               for name in names]  # fmt: skip
    gap = {"before": {"10": 0.22, "50": 0.55}, "after": {"10": 0.03, "50": after},
           "noise_floor": {"10": 0.02, "50": 0.05}, "closed_fraction": {"10": 0.9, "50": claimed}}  # fmt: skip
    ranking = [{"name": name, "score": 1.0} for name in (*names, "speed_gain", "yaw_gain", "dead_band")]
    return {"verdict": verdict, "effects": effects, "ranking": ranking, "ambiguous_with": dict(ambiguous),
            "gap": gap, "fresh": {"gap": gap}}  # fmt: skip


def marks(label, report, error=None):
    return score.judge(label, {"report": report, "error": error, "seconds": 1.0})


def test_right_answer():
    m = marks(label(), report("yaw_bias"))
    assert m["strict1"] and m["top1"] and m["top3"] and m["found"] and m["f1"] == 1 and m["failure"] is None
    assert not m["confident_wrong"] and not m["false_unknown"] and m["statements"] == [(0.95, True)]
    assert m["parameter_errors"] == {"yaw_bias.d": pytest.approx(0.05)} and m["covered_rest"] == {"yaw_bias.d": False}
    assert m["realised_50"] == pytest.approx(0.9) and m["claim_error_50"] == pytest.approx(0)
    assert m["realised_10"] == pytest.approx(0.95) and not m["overclaims_50"] and m["set_size"] == 1


def test_family_comes_before_the_name_and_the_form():
    """A robot whose axes lag differently, called one lag of both: right in its family, not in its names."""
    lags = label("lags", ("speed_lag", "yaw_lag"))
    m = marks(lags, report("actuator_lag"))
    assert m["family1"] and m["family_set"] and m["family_f1"] == 1 and m["statements"] == [(0.95, True)]
    assert not m["top1"] and not m["found"] and m["f1"] == 0 and not m["confident_wrong"]
    m = marks(lags, report("yaw_lag", "speed_lag", "yaw_gain"))
    assert m["family1"] and not m["family_set"] and m["family_f1"] == pytest.approx(2 / 3) and m["found"]
    assert m["statements"] == [(0.95, True), (0.95, True), (0.95, False)]
    m = marks(lags, report("dead_band"))
    assert not m["family1"] and not m["family_set"] and m["family_f1"] == 0 and m["confident_wrong"]


def test_report_may_say_form_and_family_or_only_them():
    slips = label("single_other", ("pacejka_slip",))
    for effect in ({"name": "turning_loss", "family": "slip"}, {"form": "hill_slip", "family": "slip"}, {"family": "slip"},
                   {"name": "pacejka_slip", "form": "wheel_slip", "family": "traction"}):  # fmt: skip
        said = report() | {"ranking": [effect], "effects": [effect | {"confidence": 0.7}], "verdict": "partly"}
        m = marks(slips, said)
        assert m["family1"] and m["family_set"] and m["statements"] == [(0.7, True)] and m["partly"], effect
    assert not marks(slips, said | {"ranking": [{"name": "x", "family": "drag"}], "effects": []})["family1"]
    guess = report(verdict="unknown") | {"ranking": [], "best_fit": ["lateral_skid"]}
    m = marks(slips, guess)
    assert m["family1"] and not m["family_set"] and m["statements"] == [] and m["false_unknown"]


def test_ambiguity_sets_count_between_families_too():
    m = marks(label(), report("wheel_asymmetry", ambiguous={"wheel_asymmetry": ["yaw_bias"]}))
    assert m["family1"] and m["family_set"] and not m["strict1"]


def test_verdict_partly_is_no_alarm_of_unknown_and_is_one_on_a_healthy_robot():
    assert not marks(label(), report("yaw_bias", verdict="partly"))["false_unknown"]
    assert marks(label("none_slip", ()), report("yaw_bias", verdict="partly"))["false_alarm"]
    assert not marks(label("never", ("camber",)), report("yaw_bias", verdict="partly"))["unknown"]


def test_overclaiming_is_signed():
    m = marks(label(), report("yaw_bias", after=0.3, claimed=0.9))
    assert m["overclaims_50"] and m["claim_excess_50"] == pytest.approx(0.9 - 0.5)
    m = marks(label(), report("yaw_bias", after=0.05, claimed=0.6))
    assert not m["overclaims_50"] and m["claim_excess_50"] == pytest.approx(-0.4)


def test_intervals_of_curves_are_counted_apart():
    curve, rest = label(truth=("pacejka_slip",)), label()
    curve["causes"][0]["parameters"] = usual("pacejka_slip")
    said = report("pacejka_slip")
    said["effects"][0] |= {"params": usual("pacejka_slip"), "params_ci95": {"B": [9, 11], "D": [0.2, 0.3]}}
    m = score.judge(curve, {"report": said, "error": None, "seconds": 1.0}, commands())
    assert m["covered_curves"] == {"pacejka_slip.B": True, "pacejka_slip.D": False} and m["covered_rest"] == {}
    assert marks(rest, report("yaw_bias"))["covered_curves"] == {}


def test_bands_of_curves_are_counted_by_the_share_of_commands():
    """A band that holds the true friction at two commands of four; one of another form is not looked at."""
    there, u = label(truth=("stribeck_friction",)), np.array([[0.5, 0.2], [1.0, 0.0], [1.5, 0.3], [2.0, -0.4]])
    there["causes"][0]["parameters"] = usual("stribeck_friction")
    taken = score.curve("stribeck_friction", usual("stribeck_friction"), u)
    band = np.stack([taken - 0.01, taken + 0.01], -1)
    band[:2] += 1.0
    said = report("stribeck_friction")
    said["effects"][0] |= {"params": usual("stribeck_friction"), "curve": {"commands": u.tolist(), "takes_ci95": band.tolist()}}
    assert score.judge(there, {"report": said, "error": None, "seconds": 1.0}, u)["covered_bands"] == {"stribeck_friction": 0.5}
    said["effects"][0]["form"] = "friction_general"
    assert score.judge(there, {"report": said, "error": None, "seconds": 1.0}, u)["covered_bands"] == {}


def test_link_counts_where_a_report_has_one():
    there = label("odometry")
    there["causes"][0]["link"] = "command-wheel"
    said = report("yaw_bias")
    assert marks(there, said)["link"] == {}
    for link, right in (("command-wheel", True), ("wheel-ground", False)):
        said["effects"][0]["link"] = link
        assert marks(there, said)["link"] == {"yaw_bias": right}


def test_calibration_error_is_that_of_every_effect_named():
    """Half of what is said at 0.9 is right, all that is said at 0.3 is: |0.9 - 0.5| and |0.3 - 1|, 20 and 10 times."""
    rows = [{"statements": [(0.9, True), (0.9, False), (0.3, True)]} for _ in range(10)]
    found = score.calibration_error(rows)
    assert found["value"] == pytest.approx((20 * 0.4 + 10 * 0.7) / 30) and found["n"] == 30
    assert found["excess"] == pytest.approx((20 * 0.4 - 10 * 0.7) / 30) and found["ci95"][0] < found["value"] < found["ci95"][1]
    assert score.calibration_error([{"statements": []}])["value"] is None


def test_wrong_answer_and_ambiguity_in_either_direction():
    m = marks(label(), report("wheel_asymmetry"))
    assert not m["top1"] and not m["top3"] and m["confident_wrong"] and m["f1"] == 0
    for sets in ({"wheel_asymmetry": ["yaw_bias"]}, {"yaw_bias": ["wheel_asymmetry"]}):
        m = marks(label(), report("wheel_asymmetry", ambiguous=sets))
        assert m["top1"] and m["found"] and not m["strict1"] and not m["confident_wrong"] and m["f1"] == 1
    assert not marks(label(), report("wheel_asymmetry", confidence=0.89))["confident_wrong"]
    later = report("backlash", "wheel_asymmetry", "yaw_bias")
    later["effects"] = []
    m = marks(label(), later)
    assert m["top3"] and not m["top1"] and not m["found"] and m.get("overclaims_50") is None


def test_sets_are_paired_one_to_one():
    pair = label("pair", ("yaw_bias", "actuator_lag"))
    one = report("yaw_bias", ambiguous={"yaw_bias": ["actuator_lag"]})
    assert marks(pair, one)["f1"] == pytest.approx(2 / 3) and not marks(pair, one)["found"]
    # "backlash" can stand for either, "yaw_bias" for itself alone
    both = report("backlash", "yaw_bias", ambiguous={"backlash": ["yaw_bias", "actuator_lag"]})
    assert marks(pair, both)["f1"] == 1
    assert marks(pair, report("yaw_bias", "backlash", "dead_band"))["f1"] == pytest.approx(2 / 5)


def test_healthy_and_open_tiers():
    healthy = label("none_white", ())
    assert not marks(healthy, report(verdict="none"))["false_alarm"]
    assert marks(healthy, report("yaw_bias"))["false_alarm"] and marks(healthy, report("yaw_bias"))["confident_wrong"]
    assert marks(healthy, report(verdict="unknown"))["false_alarm"]
    never = label("never", ("camber",))
    assert marks(never, report(verdict="unknown"))["unknown"]
    m = marks(never, report("yaw_bias", verdict="unknown"))
    assert m["unknown"] and m["confident_wrong"] and "top1" not in m
    left = label("left_out", ("speed_gain",), alias=True)
    assert not marks(left, report("yaw_gain", "clock_scale"))["confident_wrong"]
    assert score.of([marks(left, report(verdict="known"))], "left_out") == []


def test_segments():
    switch = label("switch")
    switch["causes"][0] |= {"t0": 20.0, "t1": 60.0}
    m = marks(switch, report("yaw_bias", segments=[[30, 60], [90, 100]]))
    assert m["iou"] == pytest.approx(0.6) and m["onset"] == pytest.approx(10)
    assert marks(switch, report("yaw_bias"))["iou"] == pytest.approx(0.4)
    m = marks(switch, report("backlash"))
    assert m["iou"] == 0 and m["onset"] == np.inf
    five = label("five_phase", ("yaw_bias",))
    five["causes"] = [five["causes"][0] | {"t0": t0, "t1": t0 + 20.0} for t0 in (20.0, 60.0)]
    assert marks(five, report("yaw_bias", segments=[[20, 40], [60, 80]]))["iou"] == 1


def test_curve_error_of_slip_and_friction():
    u = commands()
    for name, key in (("pacejka_slip", "D"), ("stribeck_friction", "Fc")):
        cause, found = {"name": name, "parameters": usual(name)}, usual(name)
        assert score.parameter_errors({"params": found}, cause, u) == ({"curve": 0.0}, {})
        assert 0.01 < score.parameter_errors({"params": found | {key: 1.1 * found[key]}}, cause, u)[0]["curve"] < 0.2


def test_claims_are_checked_by_the_simulator_too():
    u = commands(1500)
    x = plant.simulate(u[:-1], DT, [Cause("yaw_bias", {"d": 0.021})])
    fresh = bridge.Log(np.arange(1500) * DT, x, u, np.ones(1499, bool), DT)
    quiet = label(fresh={"gap": {"10": 0.2, "50": 0.5}, "floor": {"10": 1e-3, "50": 1e-3}})
    right, half, wrong = (report(name) for name in ("yaw_bias", "yaw_bias", "yaw_gain"))
    half["effects"][0]["params"]["d"] = 0.0105
    least = 1e-3 / tiers.gap(x, u, DT)["50"]
    for said, expected in ((right, 1 / (1 - least)), (half, 0.5 / (1 - least)), (wrong, None)):  # yaw_gain needs a "b"
        found = score.judge(quiet, {"report": said, "seconds": 1.0, "error": None}, fresh=fresh)["recomputed_50"]
        assert found == (None if expected is None else pytest.approx(expected, rel=0.01))
    assert marks(label(), report("yaw_bias", after=0.3))["overclaims_50"]
    assert not marks(label(), report("yaw_bias", after=0.3, claimed=0.55))["overclaims_50"]
    assert marks(label(), report("yaw_bias", claimed=None)).get("overclaims_50") is None


@pytest.mark.parametrize("bad", [None, {}, {"verdict": "maybe"}, {"verdict": "known", "effects": [{}]}, [], "none"])
def test_a_failed_run_is_wrong(bad):
    m = marks(label(), bad, "exit status 1")
    assert m["failure"] and not m["top1"] and m["false_unknown"] and m["f1"] == 0
    assert marks(label("never", ("camber",)), bad, "x")["unknown"] is False
    assert marks(label("none_white", ()), bad, "x")["false_alarm"]
    rows = [
        m | {"log": "0000", "who": score.OURS},
        marks(label(), report("yaw_bias")) | {"log": "1", "who": score.OURS},
    ]
    results = score.summary({score.OURS: rows})
    assert [failure["log"] for failure in results["failures"]] == ["0000"]
    assert results["must_hold"][0]["line"].startswith("single: family")
    assert results["must_hold"][0]["value"] == 0.5 and results["must_hold"][0]["met"] is False


def test_figures():
    rows = [{"top1": value, "onset": onset} for value, onset in ((True, 0.1), (True, 0.2), (False, np.inf))]
    assert score.figure(rows, "top1")["value"] == pytest.approx(2 / 3)
    assert score.figure(rows, "onset")["value"] == 0.2 and score.figure(rows, "onset")["ci95"][1] == np.inf
    assert score.figure(rows, "iou") == {"value": None, "ci95": [None, None], "n": 0}
    stated = [{"statements": [(0.92, True), (0.94, False), (0.3, False)]}]
    assert [(b["n"], b["right"]) for b in score.calibration(stated)] == [(1, 0.0), (2, 0.5)]


# ---- a campaign --------------------------------------------------------------------------------

STAND_IN = """
import json, pathlib, sys
from tinykoop import bridge
log, _, fresh, _, out, *rest = sys.argv[1:]
assert sorted(p.name for p in pathlib.Path(log).parent.iterdir()) == ["fresh.csv", "log.csv"]
K = len(bridge.read_log(log).x), len(bridge.read_log(fresh).x)
if rest:
    sys.exit("no " + rest[1])
pathlib.Path(out).mkdir()
pathlib.Path(out, "report.json").write_text(json.dumps({"verdict": "none", "effects": [], "ranking": []}))
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    pytest.importorskip("joblib", reason="joblib is missing: make blind installs it")
    out = tmp_path_factory.mktemp("blind")
    (out / "stand_in.py").write_text(STAND_IN)
    who = {score.OURS: blind.Command((sys.executable, out / "stand_in.py"))}
    return out, blind.run(out, 1, 4, jobs=1, which=["single", "none_white", "left_out"], diagnosers=who)


def test_campaign(campaign):
    out, results = campaign
    stored = json.loads((out / "blind.json").read_text())
    assert stored["seal"]["sha256"] == score.digest(out / "blind/labels.json")
    verdicts = {row["tier"]: row["verdict"] for row in results["rows"]}
    assert verdicts == {"single": "none", "none_white": "none", "left_out": "failed"}
    assert "exit status 1: no " in results["failures"][0]["failure"]
    names = sorted(path.stem for path in (out / "blind/logs").iterdir())
    assert names == ["0000", "0001", "0002"] == sorted(path.stem for path in (out / "blind/fresh").iterdir())
    assert len(list(out.glob("blind_*.png"))) == 5
    assert all(row["rows"] <= blind.SHORT for row in results["rows"])


def test_strange_tier_is_refused_and_the_table_needs_all(tmp_path):
    with pytest.raises(UserError, match="--tier gusty: no such tier; there are single, "):
        blind.run(tmp_path, 1, 1, which=["single", "gusty"])
    with pytest.raises(UserError, match="leave out --tier"):
        blind.run(tmp_path, 1, 1, which=["single"], update=True)
    assert not list(tmp_path.iterdir())


def test_broken_seal_and_half_campaign_are_refused(campaign):
    out, results = campaign
    assert score.run(out)["must_hold"] == results["must_hold"]
    report = out / "blind/reports/tinykoop/0001.json"
    kept = report.read_bytes()
    report.unlink()
    with pytest.raises(UserError, match="0001.json: missing"):
        score.run(out)
    report.write_bytes(kept)
    labels = out / "blind/labels.json"
    labels.write_text(labels.read_text().replace('"none_white"', '"none_heavy"'))
    with pytest.raises(UserError, match="not the sealed one"):
        score.run(out)


def test_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "blind").mkdir()
    (tmp_path / "blind/thesis.tex").write_text("x")
    with pytest.raises(UserError, match="not the folder of a blind evaluation"):
        blind.generate(tmp_path, 1, 1, {}, ["single"])
    assert (tmp_path / "blind/thesis.tex").exists()
