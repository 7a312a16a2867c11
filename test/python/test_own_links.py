"""Links of your own robot: each effect is found at the link at which it acts, and an actuator that does not answer is no slow one."""

import csv
import functools
import json
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tinykoop.diagnose import patch
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.platforms.own import Path as LogPath
from tinykoop.diagnose.platforms.own import extras, links
from tinykoop.diagnose.prediction_errors.fit import Cause
from tinykoop.diagnose.prediction_errors.search import Search
from tinykoop.diagnose.report.html import html
from tinykoop.diagnose.robots import toml
from tinykoop.diagnose.robots.log import read
from tinykoop.plumbing.errors import UserError

CAR = Path(__file__).resolve().parents[2] / "examples/own_robot/car"
HEADER = "t", "x", "y", "psi", "v_cmd", "delta", "servo", "compass"
SERVO = '{name = "servo", column = "servo", unit = "rad", measures = "steering"}'
COMPASS = '{name = "compass", column = "compass", unit = "rad", measures = "yaw"}'
ROWS, DT, FINE, BASE, NOISE = 500, 0.02, 10, 0.33, (0.005, 0.005, 0.003)
SERVO_NOISE, COMPASS_NOISE = 0.002, 0.004
USE = '\n[effects]\nuse = ["gain", "bias", "lag", "delay", "parameter", "sensor_bias"]\n'  # fewer are faster
TO_SERVO, TO_COMPASS = "steering command to servo", "yaw to compass"


SIMULATOR = """
import numpy as np


def step(x, u, dt, params):
    speed, steering = u.T
    turn = dt * speed * np.tan(steering) / params[0]
    middle = x[:, 2] + turn / 2
    return x + np.stack([dt * speed * np.cos(middle), dt * speed * np.sin(middle), turn], 1)
"""


# ---- logs ----------------------------------------------------------------------------------------


def drive(seed=5, lag=1e-9, base=BASE, gain=1.0, stuck=None, read_at="middle", turned=0.0):
    """Rows of a car whose servo follows its command by a lag and a gain, or not at all; poses by the midpoint rule in fine steps."""
    chance, pose, servo, rows = random.Random(seed), np.array([0.0, 0.0, 0.3]), 0.0, []
    for k in range(ROWS):
        if k % 25 == 0:
            speed, steering = chance.uniform(0.3, 1.8), chance.uniform(-0.4, 0.4)
        seen, angles = [p + chance.gauss(0, sd) for p, sd in zip(pose, NOISE)], []
        for _ in range(FINE):
            servo = stuck if stuck is not None else servo + (gain * steering - servo) * (1 - np.exp(-DT / FINE / lag))
            angles.append(servo)
            turn = speed * np.tan(servo) / base * DT / FINE
            middle = pose[2] + turn / 2
            pose = pose + [speed * np.cos(middle) * DT / FINE, speed * np.sin(middle) * DT / FINE, turn]
        shown = {"begin": angles[0], "middle": np.mean(angles)}[read_at] + chance.gauss(0, SERVO_NOISE)
        compass = seen[2] + turned + chance.gauss(0, COMPASS_NOISE)
        rows.append([k * DT, *seen[:2], np.degrees((seen[2] + np.pi) % (2 * np.pi) - np.pi), speed, steering, shown, compass])
    return rows


@pytest.fixture(scope="module")
def robots(tmp_path_factory):
    """{name: Robot} of the car with and without its other sensors."""
    place, found, text = tmp_path_factory.mktemp("robots"), {}, (CAR / "car.toml").read_text()
    (place / "car.py").write_text(SIMULATOR)
    for name, extra in {"plain": "", "servo": SERVO, "both": f"{SERVO}, {COMPASS}"}.items():
        (place / f"{name}.toml").write_text(text.replace("\n[simulator]", f"extra = [{extra}]\n\n[simulator]") + USE)
        found[name] = toml.read(place / f"{name}.toml")
    return found


def written(path, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([HEADER, *rows])
    return path


@pytest.fixture(scope="module")
def log_of(robots, tmp_path_factory):
    """log_of(robot's name, changes of the drive) -> RobotLog."""
    place = tmp_path_factory.mktemp("logs")
    return lambda robot="servo", **changes: read(written(place / "log.csv", drive(**changes)), robots[robot])


@pytest.fixture(scope="module")
def diagnosed(robots, log_of):
    return functools.cache(lambda robot="servo", **changes: own.diagnose(log_of(robot, **changes), robots[robot]))


def found(result):
    """{link: {effect: its first parameter}}."""
    linked = result.report["where"]["links"]
    return {link["link"]: {e["name"]: next(iter(e["params"].values())) for e in link["effects"]} for link in linked}


def shares(result):
    return {link["link"]: link["share"] for link in result.report["where"]["links"]}


# ---- links ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("read_at", ["begin", "middle"])
def test_a_lag_of_the_servo_is_found_between_its_command_and_the_servo(diagnosed, read_at):
    result = diagnosed(lag=0.12, read_at=read_at)
    at = found(result)
    assert set(at[TO_SERVO]) == {"lag:steering"} and at[links.MOTION] == {}
    assert at[TO_SERVO]["lag:steering"] == pytest.approx(0.12, rel=0.03) and shares(result)[TO_SERVO] == pytest.approx(1, abs=0.05)
    assert [(e["name"], e["link"]) for e in result.report["effects"]] == [("lag:steering", TO_SERVO)]


def test_a_wrong_wheelbase_is_found_between_servo_and_motion(diagnosed):
    result = diagnosed(base=0.38)
    at = found(result)
    assert at[TO_SERVO] == {} and at[links.MOTION] == {"parameter:wheelbase": pytest.approx(0.05, rel=0.05)}
    assert [(e["name"], e["link"]) for e in result.report["effects"]] == [("parameter:wheelbase", links.MOTION)]


def test_a_lag_and_a_wrong_wheelbase_are_found_each_at_its_link(diagnosed):
    at = found(diagnosed(base=0.38, lag=0.12))
    assert set(at[TO_SERVO]) == {"lag:steering"} and set(at[links.MOTION]) == {"parameter:wheelbase"}


def test_links_of_a_healthy_robot_have_no_effects(diagnosed):
    assert found(diagnosed("both")) == {TO_SERVO: {}, links.MOTION: {}, TO_COMPASS: {}}


def test_a_compass_that_is_turned_is_found_behind_the_motion(diagnosed):
    at = found(diagnosed("both", turned=0.1))
    assert at[TO_COMPASS] == {"sensor_bias:compass": pytest.approx(0.1, rel=0.02)} and at[TO_SERVO] == at[links.MOTION] == {}


def test_shares_are_those_of_predictions_made_another_way_and_add_up(diagnosed, robots):
    result = diagnosed(base=0.38, lag=0.12)
    log, starts = result.log, result.found.starts

    def ends(angles):
        """Positions 50 steps on from the measured poses, headings first."""
        at = starts[:, None] + np.arange(50)
        speed, turn = log.u[at, 0] * DT, log.u[at, 0] * DT * np.tan(angles[at]) / BASE
        heading = log.x[starts, 2:] + np.cumsum(turn, 1) - turn / 2
        return log.x[starts, :2] + np.stack([(speed * np.cos(heading)).sum(1), (speed * np.sin(heading)).sum(1)], 1)

    whole = log.x[starts + 50, :2] - ends(log.u[:, 1])
    noise = np.mean(result.found.floor["position"][:, -1] ** 2)
    part = (whole * (ends(log.y[:, 3]) - ends(log.u[:, 1]))).sum(1).mean() / ((whole**2).sum(1).mean() - noise)
    assert shares(result)[TO_SERVO] == pytest.approx(part, rel=1e-6)
    assert shares(result)[TO_SERVO] + shares(result)[links.MOTION] == pytest.approx(1)


def test_a_log_without_other_sensors_has_no_links(diagnosed):
    assert "links" not in diagnosed("plain").report["where"]


def test_an_effect_that_the_simulator_has_is_no_effect_of_a_link(robots, log_of):
    """The lag of the robot's file acts at its link, and not behind the servo that shows it."""
    robot = replace(robots["servo"], acting=(("lag:steering", {"tau": 0.12}),))
    assert found(own.diagnose(log_of(lag=0.12), robot)) == {TO_SERVO: {}, links.MOTION: {}}


@pytest.mark.parametrize("lag, kept", [(0.12, ("lag:steering",)), (1e-9, ())])
def test_a_search_begins_with_what_the_links_found_and_keeps_it_only_if_it_is_worth_its_price(robots, log_of, monkeypatch, lag, kept):
    path = LogPath(robots["plain"], log_of("plain", lag=lag))
    path.hints = Cause("lag:steering", (0.1,)), Cause("bias:speed", (0.001,))
    monkeypatch.setattr(Search, "widened", lambda self, state: None)  # nothing else comes in
    assert Search(path).run().fit.names == kept


def test_rows_without_a_reading_are_not_compared(robots, log_of):
    log = log_of(gain=1.1)
    holes = log.y.copy()
    holes[200:260, 3] = np.nan
    given = extras.read(robots["servo"], replace(log, y=holes))
    assert not given.actuators[0].usable[200:260].any() and given.actuators[0].usable[261:].all()
    at = found(own.diagnose(replace(log, y=holes), robots["servo"]))
    assert at[TO_SERVO] == {"gain:steering": pytest.approx(0.1, rel=0.05)} and at[links.MOTION] == {}


# ---- columns that cannot be used -----------------------------------------------------------------

BAD = {
    "servo makes no link: only 30 %": lambda y: np.where(np.arange(ROWS) < 0.3 * ROWS, y, np.nan),
    "servo is not used: it does not answer the command steering, but the robot does": lambda y: 0.002 * np.random.default_rng(0).normal(size=ROWS),
    "servo is not used: the simulator follows the log far better with the command steering": lambda y: -y,
}  # fmt: skip


@pytest.mark.parametrize("said", BAD)
def test_a_column_that_cannot_be_true_is_not_used_and_one_sentence_says_why(robots, log_of, said):
    log = log_of()
    y = log.y.copy()
    y[:, 3] = BAD[said](y[:, 3])
    given = extras.read(robots["servo"], replace(log, y=y))
    assert len(given.ignored) == 1 and said in given.ignored[0] and not given.actuators


def test_a_fresh_log_has_the_same_columns_as_the_log(robots, log_of):
    """The servo's column cannot be true, so that the compass is the fourth channel, and no longer the fifth."""
    log, fresh = log_of("both"), log_of("both", seed=6)
    y = log.y * [1, 1, 1, -1, 1]
    given = extras.read(robots["both"], replace(log, y=y))
    assert [channel.name for channel in given.robot.channels] == ["px", "py", "yaw", "compass"] and given.of(None) is None
    np.testing.assert_array_equal(given.of(fresh).y, fresh.y[:, [0, 1, 2, 4]])


def test_a_fresh_log_is_predicted_with_the_effects_of_the_log(robots, log_of):
    log, fresh = log_of(gain=1.1, read_at="begin"), log_of(gain=1.1, read_at="begin", seed=6)
    report = own.diagnose(log, robots["servo"], fresh=fresh).report
    assert report["verdict"] == "known" and report["fresh"]["gap"]["closed_fraction"]["50"] > 0.8


# ---- links that are dead -------------------------------------------------------------------------


def test_a_servo_that_is_stuck_is_told_and_nothing_else_is_looked_for(diagnosed, tmp_path):
    result = diagnosed(stuck=0.03)
    report, story = result.report, own.Teller(result).story()
    assert report["verdict"] == "known" and [(e["name"], e["params"], e["link"]) for e in report["effects"]] == [
        ("no_answer", {}, TO_SERVO)
    ]
    assert story.sentence.startswith("Servo does not answer the steering command: check that the actuator is on")
    assert report["gap"]["after"]["50"] < 0.3 * report["gap"]["before"]["50"] and not report["not_testable"]
    assert "no_answer" in html(story).decode()
    (tmp_path / "report.json").write_text(json.dumps(report))
    with pytest.raises(UserError, match="no_answer is a fault of the robot"):
        patch.run(tmp_path / "report.json", tmp_path / "car.toml")


def standing(log):
    """The log of a robot whose pose is noise only."""
    x = np.array([0.3, 0.2, 1.0]) + NOISE * np.random.default_rng(2).standard_normal((ROWS, 3))
    return replace(log, x=x, y=np.concatenate([x, log.y[:, 3:]], 1))


@pytest.mark.parametrize("name, link, said", [
    ("servo", links.MOTION, "The actuators move, but the robot does not answer"),
    ("plain", links.WHOLE, "The robot does not answer its commands"),
])  # fmt: skip
def test_a_robot_that_does_not_move_is_told(robots, log_of, name, link, said):
    result = own.diagnose(standing(log_of(name)), robots[name])
    (effect,) = result.report["effects"]
    assert (result.report["verdict"], effect["name"], effect["link"]) == ("known", "no_answer", link) and effect["confidence"] > 0.9
    assert own.Teller(result).story().sentence.startswith(said)
    assert result.report["gap"]["after"]["50"] < 0.1 * result.report["gap"]["before"]["50"]


LIVING = {"is healthy": {}, "turns a tenth": {"gain": 0.1}, "lags by 3 s": {"lag": 3.0}, "turns the other way": {"gain": -1.0}}


@pytest.mark.parametrize("robot", LIVING)
def test_a_robot_that_answers_badly_answers(robots, log_of, robot):
    for seed in range(3):
        given = extras.read(robots["servo"], log_of(seed=seed, **LIVING[robot]))
        assert given.actuators and given.dead is None and links.dead(LogPath(given.robot, given.log), given) is None


def test_a_command_that_is_held_is_no_dead_actuator(robots, log_of):
    log = log_of(stuck=0.03)
    held = replace(log, u=np.stack([log.u[:, 0], np.full(ROWS, 0.03)], 1))
    assert extras.read(robots["servo"], held).dead is None


# ---- what people read ----------------------------------------------------------------------------


def test_the_page_has_a_table_and_bars_of_the_links(diagnosed):
    story = own.Teller(diagnosed(lag=0.12, read_at="middle")).story()
    section = next(s for s in story.sections if s.heading == "Where and when")
    table = next(t for t in section.tables if t.caption.startswith("Links"))
    assert [(row[0], row[-1]) for row in table.rows] == [(TO_SERVO, "lag:steering"), (links.MOTION, "-")]
    assert "between steering command and servo (lag:steering)" in section.figures[-1][0] and "bar-before" in section.figures[-1][1]
    assert any("arises between steering command and servo" in said for said in story.asides)


def test_a_report_without_a_gap_names_no_link_in_which_it_arises(diagnosed):
    assert not any("arises" in said for said in own.Teller(diagnosed("both")).story().asides)


def test_the_check_says_what_the_columns_are_used_for(tmp_path, robots, tinykoop_in):
    for seed, changes in {5: {}, 6: {"stuck": 0.03}}.items():
        written(tmp_path / f"{seed}.csv", drive(seed, **changes))
    said = [" ".join(tinykoop_in(tmp_path, "robot", "check", robots["both"].file, f"{seed}.csv").stdout.split()) for seed in (5, 6)]
    assert f"servo measures steering: link '{TO_SERVO}', and input of '{links.MOTION}'" in said[0]
    assert f"compass measures yaw: link '{TO_COMPASS}'" in said[0] and "look:" not in said[0]
    assert "look: Servo does not answer the steering command" in said[1]
