"""The links of a drive: each effect is found where it acts, and a robot that does not answer is not taken for a slow one."""

import functools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr import diagnose, links, odometry, told_links, traction
from tinykoop.diagnose.report.html import html
from tinykoop.plumbing.errors import UserError

DT, ROWS, START = 0.05, 600, (0.3, -0.2, 2.0)
NOISE, WHEEL_NOISE, GYRO_NOISE = 0.004, 0.002, 0.005  # m and rad; m/s and rad/s; rad/s
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "norlab_drive"


# ---- logs ----------------------------------------------------------------------------------------


def drive(seed=0):
    """Commands of either sign, held for half a second to two."""
    rng, parts = np.random.default_rng(seed), []
    while sum(map(len, parts)) < ROWS:
        parts.append(np.tile(rng.uniform((-0.8, -1.2), (2.2, 1.2)), (rng.integers(10, 45), 1)))
    return np.concatenate(parts)[:ROWS]


def moved(u, active):
    """Speeds (K, 2) in each step of a robot with these effects, from its poses: an arc of turn d has a chord of sin(d/2) / (d/2)."""
    x = bridge.simulate(u, DT, active=active, integrator=bridge.ARC)
    turn = np.diff(np.unwrap(x[:, 2]))
    middle = x[:-1, 2] + turn / 2
    chord = np.diff(x[:, 0]) * np.cos(middle) + np.diff(x[:, 1]) * np.sin(middle)
    return np.stack([chord / np.sinc(turn / 2 / np.pi), turn], 1) / DT


def log_of(wheels=(), ground=(), seed=0, gyro=1.0):
    """A log with odometry, which the effects of the wheels change, and a pose, which those on the ground change too."""
    u, rng = drive(seed), np.random.default_rng(100 + seed)
    x = bridge.simulate(u[:-1], DT, START, [*wheels, *ground], bridge.ARC) + NOISE * rng.standard_normal((ROWS, 3))
    odo = moved(u, wheels) + WHEEL_NOISE * rng.standard_normal((ROWS, 2))
    turns = gyro * moved(u, [*wheels, *ground])[:, 1] + GYRO_NOISE * rng.standard_normal(ROWS)
    return as_log(x, u, {"v_odo": odo[:, 0], "omega_odo": odo[:, 1], "omega_imu": turns})


def as_log(x, u, extra=()):
    return bridge.Log(np.arange(len(x)) * DT, x, u, np.ones(len(x) - 1, bool), DT, dict(extra))


def usual(*names):
    return [bridge.usual_effect(name) for name in names]


def in_the_air(seed=0):
    """A pose of noise only, under commands."""
    return as_log(np.array(START) + NOISE * np.random.default_rng(seed).standard_normal((ROWS, 3)), drive(seed))


@functools.cache
def diagnosed(wheels=(), ground=(), gyro=1.0):
    return diagnose(log_of(usual(*wheels), usual(*ground), gyro=gyro))


def found(result):
    """{link: {effect: its parameters}}."""
    return {link["link"]: {e["name"]: e["params"] for e in link["effects"]} for link in result.report["where"]["links"]}


def shares(result):
    return {link["link"]: link["share"] for link in result.report["where"]["links"]}


# ---- links ---------------------------------------------------------------------------------------


def test_a_lag_of_the_wheels_and_a_slip_on_the_ground_are_found_each_at_its_link():
    at = found(diagnosed(("actuator_lag",), ("pacejka_slip",)))
    assert set(at["command to wheel"]) == {"actuator_lag"} and set(at["wheel to ground"]) == {"pacejka_slip"}
    assert at["command to wheel"]["actuator_lag"]["tau"] == pytest.approx(usual("actuator_lag")[0].parameters[0], rel=0.02)
    assert at["gyro to heading"] == {}


def test_effects_of_the_whole_log_say_at_which_link_they_act():
    effects = {e["name"]: e.get("link") for e in diagnosed(("actuator_lag",), ("pacejka_slip",)).report["effects"]}
    assert effects["actuator_lag"] == "command to wheel" and effects["pacejka_slip"] == "wheel to ground"


def test_links_of_a_healthy_robot_have_no_effects():
    assert all(not effects for effects in found(diagnosed()).values())


@pytest.mark.parametrize("name, wheels, ground", [("command to wheel", ("speed_gain",), ()), ("wheel to ground", (), ("speed_gain",))])
def test_the_same_gain_is_found_at_the_link_at_which_it_acts(name, wheels, ground):
    result = diagnosed(wheels, ground)
    at, (gain,) = found(result), usual("speed_gain")[0].parameters
    assert [link for link, effects in at.items() if effects] == [name]
    assert at[name]["speed_gain"]["a"] == pytest.approx(gain, rel=0.05) and shares(result)[name] == pytest.approx(1, abs=0.02)


def test_shares_are_those_of_predictions_made_another_way_and_add_up():
    result = diagnosed(("actuator_lag",), ("pacejka_slip",))
    log, rows = result.log, result.path.rows[result.found.starts]
    pose = lambda u, row: bridge.simulate(u[row : row + 50], DT, log.x[row], integrator=bridge.ARC)[-1, :2]  # noqa: E731
    wheels = np.stack([log.extra["v_odo"], log.extra["omega_odo"]], 1)
    by_command, by_wheels = (np.array([pose(u, row) for row in rows]) for u in (log.u, wheels))
    whole = log.x[rows + 50, :2] - by_command
    noise = np.mean(result.found.floor["position"][:, -1] ** 2)
    at_wheels = (whole * (by_wheels - by_command)).sum(1).mean() / ((whole**2).sum(1).mean() - noise)
    assert shares(result)["command to wheel"] == pytest.approx(at_wheels, rel=1e-6)
    assert shares(result)["command to wheel"] + shares(result)["wheel to ground"] == pytest.approx(1)


def test_a_gyro_with_a_wrong_scale_is_found_and_does_not_touch_the_other_links():
    at = found(diagnosed(gyro=0.9))
    assert at["gyro to heading"]["yaw_gain"]["b"] == pytest.approx(1 / 0.9 - 1, rel=0.02)
    assert at["command to wheel"] == at["wheel to ground"] == {}


def test_columns_change_nothing_else_in_the_report():
    log = log_of(usual("actuator_lag"))
    plain, linked = diagnose(replace(log, extra={})).report, json.loads(json.dumps(diagnose(log).report))
    del linked["where"]["links"]
    for effect in linked["effects"]:
        effect.pop("link", None)
    assert json.dumps(plain) == json.dumps(linked)


@pytest.mark.parametrize("when", ["at the begin", "in the middle", "at the end"])
def test_odometry_may_be_read_anywhere_in_a_step(when):
    log = log_of(usual("actuator_lag"))
    mean = moved(log.u, usual("actuator_lag"))
    between = [mean[0]]  # speeds in the rows: those of two neighbours average to the mean of the step
    for k in range(len(mean) - 1):
        between.append(2 * mean[k] - between[k])
    values = {"at the begin": mean, "in the middle": np.array(between), "at the end": np.vstack([mean[:1], mean[:-1]])}[when]
    read, _ = odometry.read(replace(log, extra=dict(zip(odometry.WHEELS, values.T))))
    assert np.abs(read["wheels"].u[:-1] - mean[:-1]).max() < 1e-9


# ---- columns that cannot be used -----------------------------------------------------------------


def test_columns_are_read_from_the_file_and_what_is_no_number_is_missing(tmp_path):
    file = tmp_path / "log.csv"
    rows = ["0,0,0,0,1,0,1.5,", "0.1,0.1,0,0,1,0,nan,2", "0.2,0.2,0,0,1,0,x,inf", "0.3,0.3,0,0,1,0,-2,4"]
    file.write_text("\n".join(["t,px,py,theta,v,omega, v_odo ,omega_imu", *rows]) + "\n")
    assert len(bridge.read_log(file).x) == 4
    columns = bridge.read_columns(file, odometry.COLUMNS)
    assert list(columns) == ["v_odo", "omega_imu"]
    np.testing.assert_array_equal(columns["v_odo"], [1.5, np.nan, np.nan, -2])
    np.testing.assert_array_equal(columns["omega_imu"], [np.nan, 2, np.nan, 4])


def _without(name):
    return lambda extra: {key: values for key, values in extra.items() if key != name}


BAD = {
    "there is no column omega_odo": _without("omega_odo"),
    "v_odo and omega_odo are not used: only 25 %": lambda extra: extra | {"v_odo": np.where(np.arange(ROWS) < ROWS / 4, extra["v_odo"], np.nan)},
    "v_odo and omega_odo are not used: they do not answer": lambda extra: extra | dict.fromkeys(odometry.WHEELS, np.zeros(ROWS)),
    "omega_imu is not used: it is constant": lambda extra: extra | {"omega_imu": np.full(ROWS, 0.01)},
    "omega_imu is not used: it does not show": lambda extra: (
        extra | {"omega_imu": GYRO_NOISE * np.random.default_rng(0).standard_normal(ROWS)}
    ),
}  # fmt: skip


@pytest.mark.parametrize("said", BAD)
def test_a_column_that_cannot_be_true_is_not_used_and_one_sentence_says_why(said):
    log = log_of()
    speeds, ignored = odometry.read(replace(log, extra=BAD[said](log.extra)))
    assert len(ignored) == 1 and said in ignored[0]
    assert list(speeds) == (["wheels"] if "imu" in said else ["gyro"])


def test_rows_without_a_number_are_not_compared():
    log = log_of(usual("speed_gain"))
    holes = log.extra["v_odo"].copy()
    holes[200:260] = np.nan
    log = replace(log, extra={"v_odo": holes, "omega_odo": log.extra["omega_odo"]})
    assert not odometry.read(log)[0]["wheels"].usable[199:260].any()
    at = found(diagnose(log))
    assert set(at["command to wheel"]) == {"speed_gain"} and not at["wheel to ground"]


# ---- no traction ---------------------------------------------------------------------------------


def stands(where):
    """A robot that does not move, and where the motion ends."""
    log, rng = in_the_air(), np.random.default_rng(3)
    still = {key: 0.001 * rng.standard_normal(ROWS) for key in odometry.WHEELS}
    turning = {key: log_of().extra[key] for key in odometry.WHEELS}
    return replace(log, extra={"command to ground": {}, "command to wheel": still, "wheel to ground": turning}[where])


@pytest.mark.parametrize("where", told_links.DEAD)
def test_a_robot_that_does_not_answer_has_no_traction_and_no_other_effect(where):
    result = diagnose(stands(where))
    report, story = result.report, ddr.Teller(result).story()
    assert report["verdict"] == "known" and [(e["name"], e["params"], e["link"]) for e in report["effects"]] == [("no_traction", {}, where)]
    assert report["suggested_excitation"] == "" and not report["ambiguous_with"] and not report["not_testable"]
    assert report["gap"]["after"]["50"] < 0.02 * report["gap"]["before"]["50"]
    assert (
        "do not answer the commands" if where == "command to wheel" else "does not move: check that it is on the ground"
    ) in story.sentence
    page = html(story).decode()
    assert "no traction" in page and "ramp" not in page and "faster than" not in page


def test_a_robot_without_traction_is_checked_on_a_fresh_log():
    stuck = diagnose(in_the_air(), in_the_air(seed=7)).report
    assert stuck["verdict"] == "known" and stuck["effects"][0]["confidence"] > 0.9
    assert stuck["fresh"]["gap"]["closed_fraction"]["50"] > 0.98 and stuck["fresh"]["effects"] == [
        {"name": "no_traction", "params": {}, "acts": True}
    ]
    result = diagnose(in_the_air(), log_of(seed=7))
    driving = result.report
    assert driving["verdict"] == "unknown" and not driving["effects"]
    assert driving["fresh"]["gap"]["after"]["50"] > 10 * driving["fresh"]["gap"]["before"]["50"]
    assert "make the gap larger" in html(ddr.Teller(result).story()).decode()


LIVING = {
    "turns a tenth": [("yaw_gain", (-0.9,))], "drives a tenth": [("speed_gain", (-0.9,))],
    "does a tenth of both": [("speed_gain", (-0.9,)), ("yaw_gain", (-0.9,))],
    "lags by 3 s": [("actuator_lag", (3.0,))], "is 2 s late": [("transport_delay", (2.0,))],
    "lags, is late, and turns a tenth": [("actuator_lag", (3.0,)), ("transport_delay", (2.0,)), ("yaw_gain", (-0.9,))],
    "is cut at 0.1": [("saturation", (0.1, 0.1))], "moves at large commands only": [("dead_band", (1.7, 1.0))],
    "slips": [("pacejka_slip", (10.0, 1.6, 0.9, 0.3, 0.45))], "is held back by friction": [("stribeck_friction", (0.9, 0.9, 0.3, 3.0))],
    "has much play": [("backlash", (1.0,)), ("yaw_gain", (-0.9,))], "drifts": [("world_drift", (0.3, 0.3)), ("speed_gain", (-0.9,))],
    "is healthy": [],
}  # fmt: skip


@pytest.mark.parametrize("robot", LIVING)
def test_a_robot_that_answers_badly_answers(robot):
    for seed in range(6):
        log = log_of(ground=[bridge.Effect(*effect) for effect in LIVING[robot]], seed=seed)
        assert not traction.dead(log, log.u) and links.dead(log, odometry.read(log)[0]) is None


def test_commands_of_zero_and_a_pose_too_noisy_to_tell_are_no_missing_traction():
    log = in_the_air()
    assert traction.dead(log, log.u)
    assert not traction.dead(log, np.zeros_like(log.u))
    loud = replace(log, x=log.x + 0.5 * np.random.default_rng(1).standard_normal(log.x.shape))
    assert not traction.dead(loud, log.u)


def test_readings_that_are_off_are_no_answer():
    log = in_the_air()
    x, rows = log.x.copy(), np.random.default_rng(3).choice(len(log.x), len(log.x) // 50, replace=False)
    x[rows, 2] += 0.6
    assert traction.dead(replace(log, x=x), log.u)


def test_commands_in_another_unit_are_answered():
    log = log_of()
    assert not traction.dead(log, 1000 * log.u)


def test_no_traction_can_be_ruled_out_and_no_simulator_is_patched_with_it(tmp_path):
    from tinykoop.diagnose import patch

    log = in_the_air()
    assert "no_traction" not in {e["name"] for e in diagnose(log, without=["no_traction"]).report["effects"]}
    (tmp_path / "report.json").write_text(json.dumps(diagnose(log).report))
    with pytest.raises(UserError, match="fault of the robot"):
        patch.run(tmp_path / "report.json", tmp_path / "controller.yaml")


@pytest.mark.skipif(not REAL.is_dir(), reason="the real logs are not here")
@pytest.mark.parametrize("name", ["warthog_grass", "warthog_gravel", "warthog_asphalt"])
def test_real_drives_answer_and_their_columns_are_used(name):
    log = ddr.load(REAL / f"{name}.csv")
    speeds, ignored = odometry.read(log)
    assert list(speeds) == ["wheels", "gyro"] and not ignored and links.dead(log, speeds) is None


# ---- what people read ----------------------------------------------------------------------------


def test_an_effect_with_a_link_is_told_as_established_beside_one_that_is_not():
    """The best fit has it without its link."""
    result = diagnosed(("actuator_lag",), ("pacejka_slip",))
    (first, *_), report = result.report["effects"], result.report
    plain = {key: value for key, value in first.items() if key != "link"}
    other = plain | {"name": "lateral_skid", "params": {"k": 0.1}, "units": {"k": "s"}, "confidence": 0.1}
    told = ddr.Teller(replace(result, report=report | {"effects": [first], "best_fit": [plain, other]})).head().sentences
    assert "link" in first and [", not established" in sentence for sentence in told] == [False, True]


def test_the_page_has_a_table_and_bars_of_the_links():
    result = diagnosed(("actuator_lag",), ("pacejka_slip",))
    section = next(s for s in ddr.Teller(result).story().sections if s.heading == "Where and when")
    table = next(t for t in section.tables if t.caption.startswith("Links"))
    assert [row[0] for row in table.rows] == ["command to wheel", "wheel to ground", "gyro to heading"]
    assert [row[-1] for row in table.rows] == ["actuator lag", "pacejka slip", "-"]
    caption, svg = section.figures[-1]
    assert "between command and wheel (actuator lag)" in caption and {"bar-before", "bar-after", "bar-floor"} <= set(svg.split('"'))


def test_the_report_of_a_file_has_links_in_the_times_of_the_log(tmp_path, tinykoop_in):
    log = log_of([bridge.usual_effect("speed_gain", 10.0)])
    columns = np.column_stack([log.t + 1000, log.x, log.u, *log.extra.values()])
    header = ",".join(["t", "px", "py", "theta", "v", "omega", *log.extra])
    np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header=header, comments="")
    assert tinykoop_in(tmp_path, "diagnose", "log.csv", "--out", "out").returncode == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    wheel = report["where"]["links"][0]
    assert wheel["link"] == "command to wheel" and [e["name"] for e in wheel["effects"]] == ["speed_gain"]
    assert wheel["effects"][0]["segments"][0][0] == pytest.approx(1010, abs=0.2)
