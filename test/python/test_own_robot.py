"""Your own robot: its simulator and its log go in; the plant of these tests is another program than the simulator."""

import csv
import dataclasses
import importlib.util
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import processes
import pytest
from tinykoop.bridge import followers
from tinykoop.diagnose import several
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.platforms.own import Path as LogPath
from tinykoop.diagnose.prediction_errors import judge
from tinykoop.diagnose.prediction_errors import noise as noises
from tinykoop.diagnose.prediction_errors.fit import Cause, Fitter
from tinykoop.diagnose.prediction_errors.search import Search
from tinykoop.diagnose.report.html import html
from tinykoop.diagnose.robot import Work
from tinykoop.diagnose.robots import check, toml
from tinykoop.diagnose.robots.log import read
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
CAR = ROOT / "examples/own_robot/car"


def example():
    """make_log.py of the example, as a module: the true car, which is not the simulator."""
    spec = importlib.util.spec_from_file_location("make_log", CAR / "make_log.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def written(path, rows):
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "y", "psi", "v_cmd", "delta"), *rows])
    return path


@pytest.fixture(scope="module")
def car():
    return toml.read(CAR / "car.toml")


def log_of(car, folder, seed, lag=1e-9, rate=None, rows=None):
    """A log of the true car; rate: another law of motion; rows: of a shorter log."""
    true = example()
    true.LAG, true.ROWS = lag, rows or true.ROWS
    true.rate = rate or true.rate
    return read(written(folder / "car.csv", true.drive(seed)), car)


@pytest.fixture(scope="module")
def healthy(car, tmp_path_factory):
    return log_of(car, tmp_path_factory.mktemp("healthy"), 11)


# ---- what is found -----------------------------------------------------------------------------------------


def test_a_healthy_robot_is_recognised(car, healthy):
    report = own.diagnose(healthy, car).report
    assert report["verdict"] == "none" and not report["effects"]
    assert report["gap"]["before"]["50"] < 1.1 * report["gap"]["noise_floor"]["50"]
    assert report["passes"] <= 200


def test_the_lag_of_the_example_is_found_and_closes_the_gap(car, tmp_path):
    result = own.diagnose(log_of(car, tmp_path, 12, lag=0.12), car, fresh=log_of(car, tmp_path, 13, lag=0.12))
    report = result.report
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == ["lag:steering"]
    assert abs(report["effects"][0]["params"]["tau"] - 0.12) < 0.006
    assert report["gap"]["closed_fraction"]["50"] > 0.9 and report["fresh"]["gap"]["closed_fraction"]["50"] > 0.9
    assert report["passes"] <= 200
    page = html(own.Teller(result).story()).decode()
    assert "lag:steering" in page and page.count("<svg") >= 4
    low, high = re.search(r"tau = 0.1\d+ s</td>.*?\[([\d.]+), ([\d.]+)\]", page, re.S).groups()
    assert float(low) < float(high) and "1 step ahead" in page


def test_a_wrong_parameter_is_named_with_what_does_the_same(car, tmp_path):
    def longer(pose, speed, steering):
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * np.tan(steering) / 0.38

    report = own.diagnose(log_of(car, tmp_path, 14, rate=longer), car).report
    (effect,) = report["effects"]
    assert effect["name"] == "parameter:wheelbase" and abs(effect["params"]["change"] - 0.05) < 0.004


def test_sensors_that_are_all_late_may_be_late_commands(car, healthy):
    """Nobody can tell one from the other: what is left of the library is named, and is not sure."""
    rows = {name: getattr(healthy, name)[:600] for name in ("t", "x", "y")}
    late = dataclasses.replace(healthy, **rows, u=healthy.u[3:603], usable=healthy.usable[:599], work=Work())
    result = own.diagnose(late, car, without=("delay:all", "delay:speed", "delay:steering"))
    named = {e["name"]: e["confidence"] for e in result.report["effects"]}
    assert set(named) == {"sensor_delay:px", "sensor_delay:py", "sensor_delay:yaw"} and max(named.values()) <= 0.8
    assert "may as well be commands that come late" in " ".join(own.Teller(result).cannot_tell())


def test_effects_act_in_one_order_whichever_was_found_first(car, healthy):
    """A drive that sags and one that is off do not commute: (u - sag u) + bias is not (u + bias) less the sag of both."""
    path = LogPath(car, healthy)
    causes = Cause("sag:speed", (0.3,)), Cause("bias:speed", (0.5,))
    u = path.action(causes).u
    np.testing.assert_array_equal(u, path.action(causes[::-1]).u)
    t = (healthy.t - healthy.t[0]) / np.ptp(healthy.t)
    np.testing.assert_allclose(u[:, 0], healthy.u[:, 0] * (1 - 0.3 * t) + 0.5, rtol=1e-12)


class Counting:
    """A simulator that counts the rows it is asked for."""

    def __init__(self, simulator):
        self.simulator, self.rows = simulator, 0

    def step(self, x, u, dt, params):
        self.rows += len(x)
        return self.simulator.step(x, u, dt, params)


def test_passes_are_all_rows_that_the_simulator_was_asked_for(car, tmp_path):
    counting, log = Counting(car.simulator), log_of(car, tmp_path, 17, lag=0.12)
    report = own.diagnose(log, replace(car, simulator=counting)).report
    assert report["passes"] == round(counting.rows / (len(log.t) - 1)) <= 200


class Hasty:
    """Euler steps, `parts` in each row: the car's simulator in a plain hand."""

    def __init__(self, parts):
        self.parts = parts

    def step(self, x, u, dt, params):
        for _ in range(self.parts):
            rate = np.stack([u[:, 0] * np.cos(x[:, 2]), u[:, 0] * np.sin(x[:, 2]), u[:, 0] * np.tan(u[:, 1]) / 0.33], 1)
            x = x + dt / self.parts * rate
        return x


def test_how_much_shorter_steps_the_log_speaks_for_is_found(car, healthy):
    """Euler's error goes with the step: two in a row take away half of it, of which the four that are tried take three quarters."""
    x, parts = [healthy.x[0]], Hasty(2)
    for u in healthy.u[:-1]:
        x.append(parts.step(x[-1][None], u[None], healthy.dt, [])[0])
    x = np.array(x) + np.random.default_rng(5).normal(0, 1e-4, np.shape(x))
    report = own.diagnose(replace(healthy, x=x, y=x), replace(car, simulator=Hasty(1))).report
    assert report["verdict"] == "none" and abs(report["time_step"]["share"] - 2 / 3) < 0.02


@pytest.fixture
def quadrotor():
    """(make_log.py of the quadrotor, its Robot)."""
    spec = importlib.util.spec_from_file_location("fly", CAR.parent / "quadrotor/make_log.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, toml.read(CAR.parent / "quadrotor/quadrotor.toml")


def test_a_name_that_does_the_same_in_another_way_is_found_however_far_it_is(quadrotor, tmp_path):
    """Mass lessened by a sixth is thrust increased by a fifth: one is not the other times a number."""
    true, robot = quadrotor
    true.PAYLOAD = -0.13
    with open(tmp_path / "log.csv", "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "z", "pitch", "thrust", "torque"), *true.fly(31)])
    report = own.diagnose(read(tmp_path / "log.csv", robot), robot).report
    assert report["effects"][0]["name"] == "parameter:mass" and "gain:thrust" in report["ambiguous_with"]["parameter:mass"]
    assert abs(report["effects"][0]["params"]["change"] / -0.13 - 1) < 0.02


def test_what_no_effect_explains_is_unknown(car, tmp_path):
    def understeers(pose, speed, steering):
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * np.tan(steering) / 0.33 / (1 + 0.25 * speed**2)

    report = own.diagnose(log_of(car, tmp_path, 15, rate=understeers), car).report
    assert report["verdict"] in ("unknown", "partly") and report["unexplained"]["matters"]
    assert not report["effects"] or max(e["confidence"] for e in report["effects"]) < 0.9


def test_what_looks_random_is_no_proof_of_an_effect_that_does_nearly_the_same(car, tmp_path):
    """A steering that is cut at 0.2 rad, without cuts in the library: a gain takes half of it, and random motion the rest."""

    def stops(pose, speed, steering):
        turn = np.tan(np.clip(steering, -0.2, 0.2)) / 0.33
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * turn

    log = log_of(car, tmp_path, 16, rate=stops, rows=800)
    report = own.diagnose(log, replace(car, use=("gain", "bias", "lag", "delay", "parameter"))).report
    assert report["verdict"] == "unknown" and not report["effects"] and report["best_fit"]
    assert report["shares"]["random"] > 0.1 and report["unexplained"]["matters"]


@pytest.mark.parametrize(
    "rest, confidence, word", [(0.0, 0.9, "known"), (0.15, 0.68, "partly"), (0.25, 0.6, "unknown"), (0.0, 0.4, "unknown")]
)
def test_a_part_of_the_gap_is_explained_if_not_more_than_a_fifth_of_it_is_left(car, healthy, rest, confidence, word):
    left = judge.Left(gap=rest, of=1.0, smallest=0.01, unit="m")
    proof = judge.Proof(1e4, confidence, (), None, {}, confidence)
    assert judge.verdict(LogPath, [proof], left) == word


OWN_EFFECT = '''
import numpy as np


def understeer(x, u, k: ("s2/m2", 0.0, 1.0, 0.2)):
    """turns less the faster it goes"""
    turn = u[:, 0] * np.tan(u[:, 1]) / 0.33
    return np.stack([0 * turn, 0 * turn, turn / (1 + k * u[:, 0] ** 2) - turn], 1)


def nothing_to_fit(x, u):
    return 0 * x
'''


def with_own_effect(folder, name):
    (folder / "car.py").write_text((CAR / "car.py").read_text())
    (folder / "my_effects.py").write_text(OWN_EFFECT)
    (folder / "car.toml").write_text((CAR / "car.toml").read_text() + f'\n[effects]\nown = ["my_effects.py:{name}"]\n')
    return toml.read(folder / "car.toml")


def test_an_effect_of_the_user_s_own_is_found(car, tmp_path):
    def understeers(pose, speed, steering):
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * np.tan(steering) / 0.33 / (1 + 0.25 * speed**2)

    report = own.diagnose(log_of(car, tmp_path, 15, rate=understeers), with_own_effect(tmp_path, "understeer")).report
    (effect,) = report["effects"]
    assert report["verdict"] == "known" and effect["name"] == "understeer" and effect["formula"] == "turns less the faster it goes"
    assert abs(effect["params"]["k"] - 0.25) < 0.01 and effect["params_ci95"]["k"][0] < 0.25 < effect["params_ci95"]["k"][1]


def test_an_effect_of_the_user_s_own_without_a_range_gets_one_line(car, healthy, tmp_path):
    with pytest.raises(UserError, match="a range for each parameter"):
        own.diagnose(healthy, with_own_effect(tmp_path, "nothing_to_fit"))


def test_an_effect_that_comes_and_goes_is_found_with_its_times(car, tmp_path):
    def drags(pose, speed, steering):
        speed = 0.8 * speed if 10.0 <= drags.t < 20.0 else speed
        drags.t += 0.02 / 10 / 2  # Heun's method asks twice in each of ten steps
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * np.tan(steering) / 0.33

    drags.t = 0.0
    report = own.diagnose(log_of(car, tmp_path, 18, rate=drags), car).report
    (effect,) = report["effects"]
    assert effect["name"] == "gain:speed" and abs(effect["params"]["a"] + 0.2) < 0.01
    np.testing.assert_allclose(effect["segments"], [[10.0, 20.0]], atol=0.1)


def test_what_changed_since_healthy_logs_is_asked_of_them(car, tmp_path):
    """The simulator lacks a lag; later the steering turns too far, and only that is new."""

    def turned(pose, speed, steering):
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * np.tan(1.1 * steering) / 0.33

    before = [log_of(car, tmp_path, seed, lag=0.12, rows=600) for seed in (21, 22)]
    report = own.diagnose(log_of(car, tmp_path, 23, lag=0.12, rate=turned, rows=900), car, healthy=before).report
    assert [e["name"] for e in report["healthy"]["effects"]] == ["lag:steering"] and report["healthy"]["logs"] == 2
    assert [e["name"] for e in report["effects"]] == ["gain:steering"] or "gain:steering" in report["ambiguous_with"][
        report["effects"][0]["name"]
    ]
    assert own.diagnose(log_of(car, tmp_path, 24, lag=0.12, rows=900), car, healthy=before).report["verdict"] == "none"


def test_an_effect_that_is_too_small_to_matter_is_no_verdict(car, tmp_path):
    def hardly(pose, speed, steering):
        return 1.004 * speed * np.cos(pose[2]), 1.004 * speed * np.sin(pose[2]), 1.004 * speed * np.tan(steering) / 0.33

    true = example()
    true.LAG, true.rate, true.NOISE = 1e-9, hardly, (1e-4, 1e-4, 1e-4)
    report = own.diagnose(read(written(tmp_path / "car.csv", true.drive(25)), car), car).report
    assert report["verdict"] == "none" and not report["effects"]
    assert [e["name"] for e in report["small"]] == ["gain:speed"] and abs(report["small"][0]["params"]["a"] - 0.004) < 4e-4


def test_a_steering_that_turned_before_the_log_began_is_no_effect(car, tmp_path):
    """What acted in the first window depends on commands that nobody knows."""
    report = own.diagnose(log_of(car, tmp_path, 2, lag=0.12), car).report
    assert [e["name"] for e in report["effects"]] == ["lag:steering"]


def test_the_table_of_several_logs_has_a_dash_where_nothing_could_be_measured():
    nothing = dict.fromkeys(("1", "10", "50"))
    gap = {"before": nothing | {"1": 0.0123}, "after": nothing | {"1": 0.01}, "closed_fraction": nothing}
    assert several._line("a/b.csv", {"verdict": "none", "effects": [], "gap": gap}) == ("b.csv", "none", "-", "0.0123", "0.0100", "-")
    empty = {"before": nothing, "after": nothing, "closed_fraction": nothing}
    assert several._line("b.csv", {"verdict": "none", "effects": [], "gap": empty})[3:] == ("-", "-", "-")


def test_several_logs_get_a_report_each_and_one_table(car, tmp_path):
    true = example()
    true.ROWS = 600
    for name, lag in (("well", 1e-9), ("slow", 0.12)):
        true.LAG = lag
        written(tmp_path / f"{name}.csv", true.drive(26))
    logs = "well.csv", "slow.csv", "missing.csv"
    done = processes.tinykoop("diagnose", *logs, "--robot", CAR / "car.toml", "--out", "out", cwd=tmp_path)
    assert done.returncode == 2 and "missing.csv" in done.stderr and "Traceback" not in done.stderr
    assert "2 of 3 logs" in done.stdout and "lag:steering" in done.stdout
    found = json.loads((tmp_path / "out/diagnoses.json").read_text())
    assert [f["report"] and f["report"]["verdict"] for f in found] == ["none", "known", None]
    assert (tmp_path / "out/slow/report.html").exists()


# ---- the path, and columns that cost no pass ----------------------------------------------------------------


def fitted(path):
    return Fitter(path, noises.first(path))


def test_columns_are_what_simulation_gives(car, healthy):
    """Each effect, a little of it, against steps with and without it."""
    path = LogPath(car, healthy)
    fitter = fitted(path)
    for name, effect in path.effects.items():
        params = tuple(float(np.clip(0.1 * p.usual if not effect.threshold else 0.8 * p.usual, p.low, p.high)) for p in effect.parameters)
        trial = (Cause(name, params),)
        path.about(())
        base, column = fitter.lefts([(), trial]).T
        path.about(trial)
        seen = fitter.lefts([trial])[:, 0] - base
        assert np.linalg.norm(seen - (column - base)) < 0.15 * np.linalg.norm(seen) + 1e-3, name  # 1e-3: of the noise, in all


def test_play_and_limited_rate_follow_their_laws():
    """Play: never further from the command than its half, and still while that lets it. Rate: the mean of 1,000 short steps in each row."""
    rng = np.random.default_rng(5)
    u = np.cumsum(rng.normal(size=300)) * rng.choice((0.0, 1.0), 300, p=(0.3, 0.7))
    y = followers.play(u, 0.7)
    moved = np.diff(y, prepend=u[0])
    assert np.abs(y - u).max() <= 0.7 + 1e-12
    np.testing.assert_allclose(np.abs(u - y)[moved != 0], 0.7, atol=1e-12)
    assert (np.sign(moved) == np.sign(u - y))[moved != 0].all() and (moved == 0).sum() > 50
    n, most, at, means = 1000, 0.9, u[0], []
    for wanted in u:
        steps = at + np.sign(wanted - at) * np.minimum((np.arange(n) + 0.5) / n * most, abs(wanted - at))
        means.append(steps.mean())
        at += np.clip(wanted - at, -most, most)
    np.testing.assert_allclose(followers.limited_rate(u, most), means, atol=1e-6)


def test_zero_of_every_effect_changes_nothing(car, healthy):
    path = LogPath(car, healthy)
    for name, effect in path.effects.items():
        if effect.kind in ("rate_limit", "saturation"):  # nothing is what a limit does not reach
            params = tuple(p.high for p in effect.parameters)
        else:
            params = (0.0,) * len(effect.parameters)
        for trial, base in zip(path.steps([(Cause(name, params),)]), path.steps([()])):
            np.testing.assert_allclose(trial, base, atol=1e-13, err_msg=name)


def test_an_effect_acts_in_its_stretch_of_time_alone(car, healthy):
    path = LogPath(car, healthy)
    inside = (path.t >= 10.0 - 1e-9) & (path.t < 20.0 - 1e-9)
    for name in ("gain:speed", "lag:steering", "parameter:wheelbase", "clock", "scale:px", "sensor_bias:yaw"):
        usual = tuple(p.usual for p in path.effects[name].parameters)
        whole, part, none = (path.steps([causes]) for causes in ((Cause(name, usual),), (Cause(name, usual, ((10.0, 20.0),)),), ()))
        for all_along, sometimes, never in zip(whole, part, none):
            np.testing.assert_array_equal(sometimes[inside], all_along[inside], err_msg=name)
            np.testing.assert_array_equal(sometimes[~inside], never[~inside], err_msg=name)
    path.about((Cause("parameter:wheelbase", (0.05,), ((10.0, 20.0),)),))
    moved = np.abs(path.steps([path.at_causes])[0] - none[0])[..., 0].max(1)
    assert moved[inside].max() > 1e-4 and moved[~inside].max() == 0


def test_the_path_is_the_same_from_wherever_it_is_looked_for(car, healthy):
    path = LogPath(car, healthy)
    noise = noises.first(path)
    path.refer((), noise)
    there = path.X
    path.X = path.X + [0.02, -0.03, 0.01]
    path.refer((), noise)
    assert (np.abs(path.X - there) < 0.2 * noise.sensor).all()


def test_the_path_is_nearer_to_the_truth_than_what_was_measured(quadrotor, tmp_path):
    """Of a quadrotor that nothing measures the speeds of: they come out as well."""
    module, robot = quadrotor
    module.PAYLOAD = 0.0
    states, fly = [], module.fly
    seen = list(fly(7))
    with open(tmp_path / "log.csv", "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "z", "pitch", "thrust", "torque"), *seen])
    log = read(tmp_path / "log.csv", robot)
    path = LogPath(robot, log)
    steps = np.diff(path.X[100:-100, :3], axis=0) / log.dt
    between = (path.X[100:-100, 3:] + np.roll(path.X[100:-100, 3:], -1, 0))[:-1] / 2
    assert states == [] and np.sqrt(np.mean((steps - between) ** 2)) < 0.05 * np.sqrt(np.mean(steps**2))


def test_slopes_to_where_the_car_stands_are_those_of_a_change_that_stays(car, healthy):
    """They are taken once: all later slopes are the same."""
    path = LogPath(car, healthy)
    assert path.still == [0, 1]
    kept, path.still = path.A, []
    path._slope()
    np.testing.assert_allclose(kept, path.A, atol=1e-8)


def test_a_stretch_in_which_nothing_is_measured_does_no_harm(car, healthy):
    blind = replace(healthy, x=healthy.x.copy(), y=healthy.y.copy())
    blind.x[200:320] = blind.y[200:320] = np.nan
    path = LogPath(car, blind)
    search = Search(path)
    state = search.run()
    assert np.isfinite(path.X).all() and state.causes == () and abs(state.fit.cost / search.fitter.degrees - 1) < 0.05


def test_the_interval_of_a_threshold_holds_its_size_however_well_the_log_tells_it(car, tmp_path):
    def stops(pose, speed, steering):
        turn = np.tan(np.clip(steering, -0.25, 0.25)) / 0.33
        return speed * np.cos(pose[2]), speed * np.sin(pose[2]), speed * turn

    path = LogPath(car, log_of(car, tmp_path, 16, rate=stops))
    trial = (Cause("saturation:steering", (0.25,)),)
    path.about(trial)
    noise = noises.first(path)
    fitter = Fitter(path, replace(noise, sensor=noise.sensor / 100))
    low, high = judge.limits(fitter, fitter.fit_of(trial), 0, 0, 0, np.full(2, np.nan))
    assert low <= 0.25 <= high and low < high < 1.05 * low


def test_an_extra_effect_must_pay(car, healthy):
    assert Search(LogPath(car, healthy)).run().causes == ()


# ---- the check before a search ------------------------------------------------------------------------------

MISTAKES = {
    "time is in ms": lambda log: replace(log, t=log.t * 1e3, dt=log.dt * 1e3),
    "yaw is in degrees": lambda log: states(log, lambda x: x * [1, 1, 180 / np.pi]),
    "px is in millimetres": lambda log: states(log, lambda x: x * [1000, 1, 1]),
    "yaw has the other sign": lambda log: states(log, lambda x: x * [1, 1, -1]),
    "px has the other sign": lambda log: states(log, lambda x: x * [-1, 1, 1]),
    "px and py are swapped": lambda log: states(log, lambda x: x[:, [1, 0, 2]]),
    "steering has the other sign": lambda log: replace(log, u=log.u * [1, -1]),
    "steering is in degrees": lambda log: replace(log, u=log.u * [1, 180 / np.pi]),
    "speed and steering are swapped": lambda log: replace(log, u=log.u[:, ::-1].copy()),
    "py never changes": lambda log: states(log, lambda x: x * [1, 0, 1]),
    "commands stand one row too early": lambda log: replace(log, u=np.concatenate([log.u[1:], log.u[-1:]])),
    "py does not answer the commands": lambda log: states(
        log, lambda x: np.stack([x[:, 0], 0.005 * np.sin(37.0 * np.arange(len(x)) ** 1.5), x[:, 2]], 1)
    ),
}


def states(log, change):
    x = change(log.x)
    return replace(log, x=x, y=x)


def findings(robot, log):
    found = check.mistaken(robot, log)
    return found if any(f.wrong for f in found) else found + check.along(LogPath(robot, log))


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_of_the_log_is_named(car, healthy, what):
    found = findings(car, MISTAKES[what](healthy))
    assert any(f.text.startswith(what) for f in found), [f.text for f in found]


def test_a_right_log_is_let_through(car, healthy):
    assert findings(car, healthy) == []


def test_a_jump_by_a_turn_that_is_not_declared_is_named(car, healthy):
    plain = replace(car, states=(*car.states[:2], replace(car.states[2], wraps=False)))
    turned = states(healthy, lambda x: x.copy())
    turned.x[:, 2] = np.linspace(0, 20, len(turned.x)) % (2 * np.pi)
    assert any("wraps = true" in f.remedy for f in check.mistaken(plain, turned))


# ---- files that cannot be used --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "old, new, said",
    [
        ('name = "car"', "name = ", "Invalid value"),
        ('python = "car.py:step"', 'python = "car.py:stap"', "has no function stap"),
        ('python = "car.py:step"', 'python = "nothing.py:step"', "there is no file"),
        ('python = "car.py:step"', "", "exactly one of python, library"),
        ("low = 0.2", "low = 0.9", "low < high"),
        ('unit = "deg", wraps', 'unit = "deg", wrapped', "unknown key wrapped"),
        ('states = ["yaw"]', 'states = ["pitch"]', "there is no state pitch"),
        ("[report]", "[reports]", "unknown key reports"),
        ('column = "psi"', "column = 3", "column must be a text"),
        ('name = "steering"', 'name = "speed"', "duplicate signal name speed"),
    ],
)
def test_a_robot_s_file_that_is_wrong_gets_one_line(tmp_path, old, new, said):
    text = (CAR / "car.toml").read_text()
    assert old in text
    (tmp_path / "car.toml").write_text(text.replace(old, new))
    (tmp_path / "car.py").write_text((CAR / "car.py").read_text())
    with pytest.raises(UserError, match=said):
        toml.read(tmp_path / "car.toml")


def test_a_robot_without_commands_gets_one_line(tmp_path):
    text = (CAR / "car.toml").read_text()
    start = text.index("command = [")
    (tmp_path / "car.toml").write_text(text[:start] + "command = []\n" + text[text.index("]", text.index("delta")) + 2 :])
    (tmp_path / "car.py").write_text((CAR / "car.py").read_text())
    with pytest.raises(UserError, match="command must list at least one"):
        toml.read(tmp_path / "car.toml")


@pytest.mark.parametrize(
    "body, said",
    [
        ("raise ValueError('no')", "raises ValueError: no"),
        ("return x[:, :2]", r"returns shape \(\d+, 2\)"),
        ("return np.full_like(x, np.nan)", "not finite"),
        ("return x * 1e6", "runs away from the log"),
        ("return x + np.random.normal(size=x.shape)", "not deterministic"),
    ],
)
def test_a_simulator_that_misbehaves_gets_one_line(tmp_path, healthy, body, said):
    (tmp_path / "car.toml").write_text((CAR / "car.toml").read_text())
    (tmp_path / "car.py").write_text(f"import numpy as np\n\n\ndef step(x, u, dt, params):\n    {body}\n")
    with pytest.raises(UserError, match=said):
        own.diagnose(healthy, toml.read(tmp_path / "car.toml"))


@pytest.mark.parametrize(
    "text, said",
    [
        ("t,x,y,psi,v_cmd\n0,0,0,0,0\n", "has no column delta"),
        ("t,x,y,psi,v_cmd,delta\n", "has no rows"),
        ("t,x,y,psi,v_cmd,delta\n0,0,0,0,0,0\n0.1,0,zero,0,0,0\n", ":3: y: zero is not a number"),
        ("t,x,y,psi,v_cmd,delta\n0,0,0,0,0,0\n0,0,0,0,0,0\n", ":3: every row needs a time"),
    ],
)
def test_a_log_that_is_wrong_gets_one_line(car, tmp_path, text, said):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(UserError, match=said):
        read(tmp_path / "log.csv", car)


# ---- simulators -------------------------------------------------------------------------------------------------

C = """
#include <math.h>
int step(const double *x, const double *u, double dt, const double *params, double *next) {
	next[0] = x[0] + dt * u[0] * cos(x[2]);
	next[1] = x[1] + dt * u[0] * sin(x[2]);
	next[2] = x[2] + dt * u[0] * tan(u[1]) / params[0];
	return 0;
}
"""


def test_a_c_function_is_the_same_simulator(car, tmp_path):
    (tmp_path / "car.c").write_text(C)
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "car.c", "-o", "car.so", "-lm"], cwd=tmp_path, check=True)
    (tmp_path / "car.toml").write_text((CAR / "car.toml").read_text().replace('python = "car.py:step"', 'library = "car.so:step"'))
    rng = np.random.default_rng(3)
    x, u = rng.normal(size=(40, 3)), rng.uniform(-0.5, 0.5, (40, 2))
    other = toml.read(tmp_path / "car.toml").simulator
    np.testing.assert_allclose(other.step(x, u, 0.02, [0.33]), car.simulator.step(x, u, 0.02, [0.33]), rtol=1e-12)


# ---- as a newcomer does it ----------------------------------------------------------------------------------------


def test_a_newcomer_s_path(tmp_path, tinykoop_in):
    """`robot new`, a log, `robot check`, `diagnose`: four commands and no edit."""

    def tinykoop(*arguments):
        return tinykoop_in(tmp_path, *arguments)

    assert tinykoop("robot", "new", "bot").returncode == 0
    rng = np.random.default_rng(5)
    pose, rows = np.array([0.0, 0.0, 0.1]), []
    for k in range(800):
        if k % 20 == 0:
            speed, turn = rng.uniform(0.2, 1.0), rng.uniform(-1, 1)
        seen = pose + rng.normal(0, (0.003, 0.003, 0.002))
        rows.append([0.02 * k, seen[0], seen[1], (seen[2] + np.pi) % (2 * np.pi) - np.pi, speed, turn])
        pose = pose + 0.02 * np.array([1.1 * speed * np.cos(pose[2]), 1.1 * speed * np.sin(pose[2]), turn])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,x,y,yaw,v_cmd,w_cmd", comments="")
    assert tinykoop("robot", "check", "bot.toml", "log.csv").returncode == 0
    done = tinykoop("diagnose", "log.csv", "--robot", "bot.toml", "--out", "out")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == ["gain:speed"]
    assert abs(report["effects"][0]["params"]["a"] - 0.1) < 0.005
    again = tinykoop("robot", "new", "bot")
    assert again.returncode == 2 and "already exists" in again.stderr
    assert "gain:speed" in tinykoop("effects", "--robot", "bot.toml").stdout
