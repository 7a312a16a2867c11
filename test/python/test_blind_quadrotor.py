"""The blind evaluation of the quadrotor: its second vehicle against free-body diagrams, what is drawn, and how reports are scored."""

import json

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.blind.quadrotor import campaign, draw
from tinykoop.platforms import COLUMNS
from tinykoop.plumbing.errors import UserError

pytest.importorskip("mujoco", reason="needs `make build/venv/simulators-ready`")
from tinykoop.blind.quadrotor import flight, vehicle  # noqa: E402

N = bridge.quadrotor_vehicle()
LEVER, HOVER, WEIGHT = N["arm"] * np.sqrt(0.5), bridge.hover_request(), N["mass"] * 9.81
SECONDS = 8.0


def settled(effects, kind="hover", seconds=SECONDS):
    """Mean requests (4,) and mean state (15,) of the second half of a flight in still air with perfect sensors, at the nominal voltage."""
    log = flight.fly(kind, 1, effects, noise=0.0, seconds=seconds)
    half = len(log.u) // 2
    voltage = 1 + N["voltage_slope"] * (log.u[half:, 4:].mean(0) - N["voltage"])
    return log.u[half:, :4].mean(0) * voltage, log.x[half:].mean(0)


def moments(asked):
    """Thrust (N), roll and pitch moments (N m) and yaw moment (N m) that the rotors give when asked for this, from their places."""
    f1, f2, f3, f4 = N["thrust_full"] * asked
    return f1 + f2 + f3 + f4, LEVER * (f3 + f4 - f1 - f2), LEVER * (f2 + f3 - f1 - f4), N["torque_per_thrust"] * (f2 + f4 - f1 - f3)


# ---- the vehicle -------------------------------------------------------------------------------------


def test_it_hovers_where_it_should_at_the_thrust_of_its_weight():
    asked, x = settled({})
    assert asked == pytest.approx(np.full(4, HOVER), rel=2e-3)
    assert x[:3] == pytest.approx([0, 0, 0.8], abs=0.01) and x[3:] == pytest.approx(np.zeros(12), abs=0.01)


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_a_weak_rotor_is_asked_for_what_it_lacks(rotor):
    asked, _ = settled({f"rotor{rotor}_thrust": {"a": -0.1}})
    wanted = np.full(4, HOVER)
    wanted[rotor - 1] /= 0.9
    assert asked == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("name, sizes", [("payload", {}), ("slung_load", {"length": 0.3})])
def test_a_weight_is_carried_where_it_is(name, sizes):
    mass, x, y = 0.003, 0.02, 0.01
    thrust, roll, pitch, yaw = moments(settled({name: {"mass": mass, "x": x, "y": y} | sizes})[0])
    assert thrust == pytest.approx(WEIGHT + 9.81 * mass, rel=5e-3)
    assert (roll, pitch) == pytest.approx((9.81 * mass * y, -9.81 * mass * x), rel=0.05)
    assert yaw == pytest.approx(0, abs=2e-6)


def test_a_moment_is_answered_by_the_opposite_one():
    trim = {"roll": 4e-4, "pitch": -3e-4, "yaw": 5e-5}
    thrust, *given = moments(settled({"trim": trim})[0])
    assert given == pytest.approx([-value for value in trim.values()], rel=0.03) and thrust == pytest.approx(WEIGHT, rel=5e-3)


def test_less_thrust_of_all_rotors_is_made_up_for_and_a_sagging_battery_ever_more():
    assert settled({"thrust_gain": {"a": -0.08}})[0] == pytest.approx(np.full(4, HOVER / 0.92), rel=5e-3)
    sagging, _ = settled({"battery_sag": {"loss_at_end": 0.1}})
    assert sagging == pytest.approx(np.full(4, HOVER / 0.925), rel=5e-3)  # mean of the second half


def test_wind_is_leaned_against():
    _, x = settled({"wind": {"wx": 1.0, "wy": 0.5}})
    roll, pitch = x[9], x[10]
    assert pitch == pytest.approx(-N["drag_xy"] * 1.0 / 9.81, rel=0.15) and roll == pytest.approx(N["drag_xy"] * 0.5 / 9.81, rel=0.15)


def test_wind_that_grows_with_height_is_leaned_against_more_higher_up():
    _, x = settled({"wind_shear": {"x": 2.0, "y": 0.0}})  # 1.6 m/s at 0.8 m
    assert x[10] == pytest.approx(-N["drag_xy"] * 1.6 / 9.81, rel=0.2)


def test_drag_slows_a_vehicle_down():
    def speeds(effects):
        v = vehicle.Vehicle(effects, 50.0, 10.0, numbers=N)
        v.data.qvel[0] = 1.0
        for _ in range(200):
            v.step([HOVER] * 4)
        return v.velocity[0]

    assert speeds({"drag": {"k": 0.3}}) / speeds({}) == pytest.approx(np.exp(-0.3 * 200 * vehicle.STEP), rel=0.01)


def thrusts(effects, steps=100):
    """Shares of full thrust after a step of the requests from hover by 0.1."""
    v, out = vehicle.Vehicle(effects, 50.0, 10.0, numbers=N), []
    for _ in range(steps):
        v.step([HOVER + 0.1] * 4)
        out.append(v.thrust[0])
    return (np.array(out) - HOVER) / 0.1


def test_rotors_follow_with_their_lag_and_later_with_more():
    t = vehicle.STEP * np.arange(1, 101)
    assert thrusts({}) == pytest.approx(1 - np.exp(-t / N["motor_lag"]), abs=1e-9)
    late = np.where(t > 0.01, 1 - np.exp(-(t - 0.01) / N["motor_lag"]), 0)
    assert thrusts({"transport_delay": {"delay": 0.01}}) == pytest.approx(late, abs=1e-9)
    a, b = N["motor_lag"], 0.02
    assert thrusts({"motor_lag": {"tau": b}}) == pytest.approx(1 - (a * np.exp(-t / a) - b * np.exp(-t / b)) / (a - b), abs=0.01)
    assert max(thrusts({"stuck_motor": {"most1": HOVER + 0.05}})) == pytest.approx(0.5, rel=0.05)


def test_biases_are_added_and_vibration_multiplies_the_noise():
    _, x = settled({"gyro_bias": {"bx": 0.04, "by": -0.03, "bz": 0.02}, "accel_bias": {"bx": 0.4, "by": 0.3, "bz": -0.3}}, seconds=4.0)
    assert x[6:9] == pytest.approx([0.4, 0.3, -0.3], abs=0.05)
    quiet, shaken = (flight.fly("hover", 1, {"vibration": {"a": a}}, seconds=2.0).x for a in (0.0, 1.0))
    assert np.diff(shaken[:, 12:], 2, axis=0).std() == pytest.approx(2 * np.diff(quiet[:, 12:], 2, axis=0).std(), rel=0.1)


def test_the_air_is_as_rough_as_documented():
    air = flight.gusts(np.random.default_rng(3), 40_000)
    assert air.std(0) == pytest.approx(flight.GUSTS, rel=0.1)


# ---- what is drawn -----------------------------------------------------------------------------------


def test_same_seed_gives_the_same_flight_and_another_seed_another():
    one, again, other = (draw.draw("single", seed, 3) for seed in (1, 1, 2))
    assert one[0] == again[0] and np.array_equal(one[1].x, again[1].x) and np.array_equal(one[1].u, again[1].u)
    assert one[0] != other[0]


def test_each_effect_is_drawn_as_often_as_asked_for_within_its_bounds():
    assert sum(tier == "single" for tier, _ in draw.wanted(2)) == 2 * len(draw.effects())
    random = np.random.default_rng(1)
    for name in draw.effects():
        for (parameter, value), (_, _, low, high, usual) in zip(draw.sized(random, name).items(), bridge.effects("quadrotor")[name][1]):
            assert low <= value <= high
            assert value in (low, high) or draw.LEAST <= abs(value / usual) <= draw.MOST, (name, parameter)


def test_a_log_lacks_the_columns_of_its_label_and_a_withheld_effect_comes_with_what_does_the_same():
    label, log = draw.draw("lacking", 1, 0)
    gone = {name for name, column in zip(COLUMNS["quadrotor"][5:], log.x.T) if np.isnan(column).all()}
    assert gone == set(label["lacks"]) and gone
    label, _ = draw.draw("left_out", 1, draw.effects().index("payload"))
    assert {"payload", "slung_load"} <= set(label["without"])


# ---- the score ---------------------------------------------------------------------------------------


def scored(tier="single", truth=None, verdict="known", effects=(), also=None, hidden=(), acts=None):
    """The row of a report with effects [(name, confidence)]."""
    truth = {"rotor3_thrust": {"a": -0.1}} if truth is None else truth
    listed = [{"name": n, "confidence": c, "params": {"a": -0.1}, "params_ci95": {"a": [-0.12, -0.08]}} for n, c in effects]
    report = {"verdict": verdict, "effects": listed, "ranking": [], "ambiguous_with": also or {}, "not_testable": list(hidden)}
    label = {"tier": tier, "kind": "steps", "lacks": [], "effects": truth, "acts": list(truth) if acts is None else acts, "without": []}
    return campaign.row_of(label, {"report": report, "error": None, "seconds": 1.0})


@pytest.mark.parametrize(
    "effects, also, right, strict",
    [
        ([("rotor3_thrust", 0.8)], {}, True, True),
        ([("payload", 0.8)], {"payload": ["rotor3_thrust"]}, True, False),
        ([("payload", 0.8), ("rotor3_thrust", 0.7)], {}, False, False),
        ([], {}, False, False),
    ],
)
def test_an_effect_counts_if_it_comes_first_or_is_declared_beside_the_first(effects, also, right, strict):
    row = scored(effects=effects, also=also)
    assert (row["right"], row["strict"]) == (right, strict)


def test_healthy_withheld_and_hidden_effects_are_judged_by_the_verdict():
    assert scored("none", {}, "none")["right"] and not scored("none", {}, "unknown")["right"]
    assert scored("left_out", verdict="unknown")["right"] and not scored("left_out", effects=[("trim", 0.5)])["right"]
    assert scored("lacking", verdict="none", hidden=["rotor3_thrust"])["right"] and not scored("lacking", verdict="none")["right"]
    assert not scored("lacking", hidden=["rotor3_thrust"], effects=[("trim", 0.5)])["right"]


def test_statements_are_wrong_strictly_even_if_the_true_effect_is_declared_beside_them():
    rows = [
        scored(effects=[("rotor3_thrust", 0.95)]),
        scored(effects=[("payload", 0.95)], also={"payload": ["rotor3_thrust"]}),
        scored(effects=[("trim", 0.9)]),
        scored("unknown", {"wind_shear": {"x": 2.0, "y": 0.0}}, effects=[("wind", 0.95)], acts=["wind"]),
    ]
    found = campaign.figures(rows)
    assert found["statements with confidence over 0.9 that are wrong"] == (1, 3)
    assert found["reports with such a statement"] == (1, 4)
    assert found["effect that was never in it: `unknown`"] == (0, 1)


def test_sizes_are_counted_inside_their_intervals_if_the_effect_acts():
    truth = {"rotor3_thrust": {"a": -0.2}}
    rows = [scored(effects=[("rotor3_thrust", 0.8)]), scored(truth=truth, effects=[("rotor3_thrust", 0.8), ("trim", 0.5)])]
    assert campaign.figures(rows)["sizes inside their 95 % interval"] == (1, 2)


def test_a_failed_diagnosis_is_never_right():
    label = {"tier": "none", "kind": "legs", "lacks": [], "effects": {}, "acts": [], "without": []}
    row = campaign.row_of(label, {"report": None, "error": "RuntimeError: no", "seconds": 1.0})
    assert row["verdict"] == "failed" and not row["right"]


def test_the_page_gets_one_number_per_cell(monkeypatch):
    written = {}
    monkeypatch.setattr(campaign.pages, "update", lambda page, name, contents: written.update({(page, name): contents}))
    campaign.page([scored(effects=[("rotor3_thrust", 0.95)]), scored("none", {}, "none")], 1, 7)
    text = written["docs/quadrotor-blind.md", "blind-quadrotor"]
    lines = {line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")[1:] for line in text.splitlines() if line.startswith("|")}
    assert lines["one effect: itself named first"][:2] == ["1", "1"] and lines["healthy recognised as healthy"][:2] == ["1", "1"]
    assert lines["`rotor3_thrust`"] == ["1", "1", "1", "0", "0", "1", "1", "0", "0"] and "N=1 SEED=7" in text
    failed = campaign.row_of(
        {"tier": "none", "kind": "legs", "lacks": [], "effects": {}, "acts": []}, {"report": None, "error": "no", "seconds": 0}
    )
    with pytest.raises(UserError, match="every diagnosis failed"):
        campaign.page([failed], 1, 7)


def test_labels_are_sealed_before_any_diagnosis_and_diagnoses_see_the_log_alone(tmp_path, monkeypatch):
    seen = []

    def diagnosed(key, diagnoser, log, fresh, without):
        seal = json.loads((tmp_path / "blind_quadrotor/seal.json").read_text())
        seen.append((fresh, seal["sha256"] == campaign.score.digest(tmp_path / "blind_quadrotor/labels.json"), log.splitlines()[0]))
        return key, {"report": None, "error": "not run", "seconds": 0.0}

    monkeypatch.setattr(campaign, "each", lambda function, calls, _: [function(*call) for call in calls])
    monkeypatch.setattr(campaign, "diagnose", diagnosed)
    rows = campaign.run(tmp_path, 1, 1, which=("none",))
    assert len(rows) == len(seen) == 2 and all(fresh is None and sealed and b"m1" in header for fresh, sealed, header in seen)
    assert json.loads((tmp_path / "blind_quadrotor.json").read_text()) == rows


def test_unknown_tiers_and_no_flights_are_refused(tmp_path):
    with pytest.raises(UserError, match="no such tier"):
        campaign.run(tmp_path, 1, 1, which=("pair",))
    with pytest.raises(UserError, match="at least 1"):
        campaign.run(tmp_path, 0, 1)
