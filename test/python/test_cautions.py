"""What a report says of a log that is closed loop, short or steady, and that it says so of no other."""

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.blind import drives, plant
from tinykoop.diagnose import cautions
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.prediction_errors import noise
from tinykoop.diagnose.prediction_errors.fit import Fitter

DT, ROWS, NOISE = 0.05, 600, np.array([0.004, 0.004, 0.004])
KINDS = {**drives.FAMILIES, "rich": lambda random, t: drives.rich(random, len(t), DT)[0].T}


def as_log(x, u, dt=DT, gaps=()):
    usable = np.ones(len(x) - 1, bool)
    usable[list(gaps)] = False
    return bridge.Log(np.arange(len(x)) * dt, x, u, usable, dt)


def open_loop(u, seed=0, kind="white", motion=None, dt=DT, gaps=()):
    """A healthy robot under commands that know nothing of its pose."""
    random = np.random.default_rng(seed)
    x = plant.simulate(u[:-1], dt, random=random, motion=motion)
    return as_log(x + plant.noise(random, kind, len(x), *NOISE[1:], rho=0.7), u, dt, gaps)


def steered(controller, seed=0, rows=ROWS, every=1):
    """A healthy robot whose controller sees the noisy pose, each so many rows."""
    random, pose, x, u = np.random.default_rng(seed), np.array([0.3, -0.2, 2.0]), [], []
    for k in range(rows):
        x.append(pose + NOISE * random.standard_normal(3))
        u.append(controller(k * DT, x[-1]) if k % every == 0 else u[-1])
        pose = plant.simulate(np.array([u[-1]]), DT, x0=pose)[1]
    return as_log(np.array(x), np.array(u))


def _bearing(target, pose):
    return np.angle(np.exp(1j * (np.arctan2(*(target - pose[:2])[::-1]) - pose[2])))


def to_moving_goal(t, pose):
    goal = 3 * np.array([np.cos(0.2 * t), np.sin(0.46 * t)])
    turn = _bearing(goal, pose)
    return np.clip(1.5 * np.hypot(*(goal - pose[:2])) * np.cos(turn), 0, 2), np.clip(2.5 * turn, -1.5, 1.5)


def pure_pursuit(t, pose):
    """Of a circle about the origin, at constant speed, from 1 m ahead."""
    ahead = np.arctan2(pose[1], pose[0]) + 0.4
    return 1.0, np.clip(2 * np.sin(_bearing(2.5 * np.array([np.cos(ahead), np.sin(ahead)]), pose)), -1.5, 1.5)


def waypoints(t, pose):
    """A new corner of a square every 4 s: the command jumps."""
    corner = np.array([(3, 3), (-3, 3), (-3, -3), (3, -3)][int(t / 4) % 4])
    turn = _bearing(corner, pose)
    return 0.8 * max(np.cos(turn), 0.1), np.clip(1.5 * turn, -1, 1)


def heading_hold(t, pose):
    return 0.9, np.clip(2 * np.angle(np.exp(1j * (np.sin(0.7 * t) + 0.5 * np.sign(np.sin(0.25 * t)) - pose[2]))), -1.5, 1.5)


def feedback(log):
    """The caution of a closed loop, from a filter with the first noise and no effects."""
    path = ddr.Path(log)
    innovations = Fitter(path, noise.first(path)).fit_of(()).left.reshape(path.present.shape)
    return cautions.closed_loop(path, innovations)


# ---- closed loop ---------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_open_loop_is_not_called_closed(kind):
    for seed in range(6):
        random = np.random.default_rng([seed, 3])
        u = np.clip(np.stack(KINDS[kind](random, np.arange(ROWS) * DT), 1), (-drives.V, -drives.W), (drives.V, drives.W))
        noise_kind, motion = ("white", "coloured", "heavy")[seed % 3], {"size": 0.03, "tau": 0.3} if seed % 2 else None
        assert feedback(open_loop(u, seed, noise_kind, motion)) == [], seed


@pytest.mark.parametrize("controller", [to_moving_goal, pure_pursuit, waypoints, heading_hold], ids=lambda c: c.__name__)
def test_feedback_is_called_closed_loop(controller):
    for seed in range(2):
        (caution,) = feedback(steered(controller, seed))
        assert "omega" in caution["share"] and caution["share"]["omega"] > 0.1 and caution["p"]["omega"] < 1e-5


def test_commands_recorded_in_a_closed_loop_and_sent_again_are_open_loop():
    """The same commands: what matters is whether this log's noise is in them."""
    for seed in range(3):
        assert feedback(open_loop(steered(waypoints, seed).u, seed + 10)) == []


def test_few_changes_of_a_command_are_no_proof():
    u = np.repeat(np.random.default_rng(1).uniform(-1, 1, (ROWS // 20, 2)), 20, axis=0)
    assert feedback(open_loop(u)) == []


def test_false_alarms_are_as_rare_as_the_threshold_says():
    """The p-values of independent innovations and commands are uniform."""
    random, p = np.random.default_rng(0), []
    for _ in range(150):
        u = np.cumsum(random.standard_normal((400, 2)), axis=0)
        p.append(cautions._feedback(u, 0, random.standard_normal((400, 3)), np.arange(13, 400))[0])
    assert abs(np.mean(np.array(p) < 0.1) - 0.1) < 0.07 and abs(np.mean(p) - 0.5) < 0.08


# ---- short, steady -------------------------------------------------------------------------------


def rich(rows, dt=DT):
    return drives.rich(np.random.default_rng(2), rows, dt)[0]


@pytest.mark.parametrize(
    ("rows", "dt", "gaps", "predictions"),
    [(300, 0.05, (), 5), (600, 0.02, (), 11), (500, 0.05, range(0, 499, 40), 0), (402, 0.05, (), None), (900, 0.02, (), None)],
)
def test_short(rows, dt, gaps, predictions):
    """Too few stretches of 50 rows, too few seconds for four held-out blocks, and none of these."""
    found = cautions.short(open_loop(rich(rows, dt), dt=dt, gaps=gaps))
    assert [caution["predictions"] for caution in found] == ([] if predictions is None else [predictions])


@pytest.mark.parametrize(
    ("u", "held"),
    [((1.0, 0.4), ["v", "omega"]), ((1.0, None), ["v"]), ((None, 0.0), ["omega"]), ((None, None), [])],
)
def test_steady(u, held):
    commands = np.column_stack([column if one is None else np.full(ROWS, one) for one, column in zip(u, rich(ROWS).T)])
    found = cautions.steady(ddr.Path(open_loop(commands)))
    assert [list(caution["variation"]) for caution in found] == ([held] if held else [])


# ---- reports -------------------------------------------------------------------------------------


def told(log):
    result = ddr.diagnose(log)
    kinds = [caution["kind"] for caution in result.report["log"]["cautions"]]
    return kinds, " ".join(ddr.Teller(result).story().asides)


def test_the_report_tells_each_caution_with_a_remedy():
    kinds, said = told(steered(pure_pursuit, rows=350))
    assert kinds == ["steady", "short", "closed_loop"]
    for words in ("v hardly varies", "steps of several sizes", "6 separate predictions of 50 steps", "longer", "past commands", "dither"):
        assert words in said


def test_an_open_loop_of_good_length_has_no_caution():
    kinds, said = told(open_loop(rich(ROWS)))
    assert kinds == [] and not any(word in said for word in ("Steady", "Short", "Closed loop"))


def test_a_robot_that_does_not_answer_is_not_called_steady():
    u = rich(ROWS)
    log = open_loop(np.zeros_like(u))
    assert told(as_log(log.x, u))[0] == []
