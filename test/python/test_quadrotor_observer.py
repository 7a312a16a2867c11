"""The quadrotor's observer against the simulator that it comes from, and what it must be indifferent to."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tinykoop import bridge
from tinykoop.diagnose.platforms.quadrotor import vehicle
from tinykoop.plumbing.errors import UserError

S = bridge.QUADROTOR_STATE
LACKING = {  # columns of x: as on the labelled flights, and further ones
    "nothing": [],
    "pitch and gyro": [10, 12, 13, 14],
    "place": [0, 1, 2],
    "all but velocity and yaw": [0, 1, 2, 6, 7, 8, 9, 10, 12, 13, 14],
    "all but attitude": [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14],
}


def angles(states):
    """Roll, pitch, yaw (K, 3) of true states."""
    return Rotation.from_quat(np.roll(states[:, S["attitude"]], -1, axis=1)).as_euler("ZYX")[:, ::-1]


def held(active=(), rows=60, lacks=()):
    """A log of the vehicle without controller, each request held for a row: it hovers, then tips slowly."""
    random = np.random.default_rng(1)
    hover = bridge.hover_request()
    u = np.column_stack([hover + 0.002 * random.standard_normal((rows, 4)), np.linspace(3.6, 3.5, rows)])
    u[:5, :4], u[:5, 4] = hover, 3.5
    start = bridge.quadrotor_hover()
    start[2] = 0  # an observer begins there if the log has no place
    states = bridge.quadrotor_roll(start, u, 0.01, active)[:-1]
    velocity = states[:, S["velocity"]]
    x = np.column_stack([states[:, :3], velocity, np.gradient(velocity, 0.01, axis=0), angles(states), states[:, S["spin"]]])
    x[:, list(lacks)] = np.nan
    return bridge.Log(np.arange(rows) * 0.01, x, u, np.ones(rows - 1, bool), 0.01), states


def flown(manoeuvre="hover", lacks=(), active=(), seed=2, seconds=20):
    log, states = bridge.quadrotor(manoeuvre, seconds, seed, active)
    log.x[:, list(lacks)] = np.nan
    return log, states


def weight(log, active, gain):
    """Sum of the squares of the innovations of the rows that the observer knows, each channel in its own deviation."""
    missed = vehicle.follower(log, gain)(active)[0][vehicle.settled(log)]
    return np.nansum(missed**2 / vehicle.noise_of(log), axis=0).sum()


EFFECTS = [name for name, (block, _) in bridge.effects("quadrotor").items() if block != "sensor"]


@pytest.mark.parametrize("lacks", LACKING.values(), ids=LACKING)
@pytest.mark.parametrize("name", [None, *EFFECTS])
def test_it_misses_nothing_of_the_simulated_vehicle(name, lacks):
    """Whatever the log lacks: places, velocities, angles and rates are predicted as they come."""
    rows = bridge.effects("quadrotor")[name][1] if name else ()
    active = [bridge.Effect(name, tuple(0.1 * row[4] if row[0] != "length" else row[4] for row in rows))] if name else []
    log, states = held(active, lacks=lacks)
    gain = vehicle.observer_gain(flown(lacks=lacks, seconds=4)[0])
    gain[:, 6:9] = 0  # accelerations of the log are differences here
    predicted, _ = bridge.quadrotor_follow(log, gain, active)
    truth = np.column_stack([states[:, :6], angles(states), states[:, S["spin"]]])[1:]
    assert np.abs(predicted[1:, [*range(6), *range(9, 15)]] - truth).max() < 1e-5
    assert np.isnan(predicted[0]).all() and np.abs(truth[-1]).max() > 0.02


def test_accelerations_are_those_of_the_flight():
    log, _ = held()
    predicted, _ = bridge.quadrotor_follow(log, np.zeros((22, 15)))
    assert np.abs(predicted[6:-1, 6:9] - log.x[6:-1, 6:9]).max() < 0.02 and np.ptp(log.x[:, 8]) > 0.04


@pytest.mark.parametrize("lacks", LACKING.values(), ids=LACKING)
def test_innovations_of_a_nominal_flight_are_white_and_a_gain_is_of_what_there_is(lacks):
    log, _ = flown(lacks=lacks)
    gain = vehicle.observer_gain(log)
    assert np.all(gain[:, lacks] == 0) and np.isfinite(gain).all() and np.abs(gain).max() > 0.01
    missed = vehicle.follower(log, gain)()[0][vehicle.settled(log)]
    assert np.isnan(missed[:, lacks]).all()
    kept = np.delete(missed, lacks, axis=1)
    for lag in (1, 2, 5):
        assert max(abs(np.corrcoef(c[lag:], c[:-lag])[0, 1]) for c in kept.T) < 0.25
    A, C = vehicle._linear(log.dt, "crazyflie")
    assert np.abs(np.linalg.eigvals(A @ (np.eye(22) - gain @ C))).max() < 1


def test_pitch_and_rates_that_the_log_lacks_are_estimated():
    log, states = flown("mixed", LACKING["pitch and gyro"])
    estimated = bridge.quadrotor_follow(log, vehicle.observer_gain(log), states=True)[2]
    known = vehicle.settled(log)
    off = np.std((angles(estimated) - angles(states))[known], axis=0)
    moved = np.std(angles(states)[known], axis=0)
    assert off[1] < 0.02 and moved[1] > 3 * off[1]
    spin = np.std((estimated - states)[known, 10:13], axis=0)
    assert np.all(spin < 0.5 * np.std(states[known, 10:13], axis=0))


@pytest.mark.parametrize("name", ["rotor3_thrust", "payload", "thrust_gain", "trim"])
def test_what_acts_is_missed_less_by_the_observer_that_knows_it(name):
    active = [bridge.usual_effect(name, platform="quadrotor")]
    for lacks in (LACKING["nothing"], LACKING["pitch and gyro"]):
        log, _ = flown("mixed", lacks, active)
        gain = vehicle.observer_gain(log)
        without, knowing = weight(log, [], gain), weight(log, active, gain)
        others = [weight(log, [bridge.usual_effect(other, platform="quadrotor")], gain) for other in ("rotor1_thrust", "motor_lag")]
        assert knowing < 0.97 * without and knowing < min(others)


def test_the_heading_of_the_world_does_not_matter():
    """A flight turned about the vertical is predicted as turned."""
    log, _ = flown("mixed", seconds=6)
    gain, turn = vehicle.observer_gain(log), Rotation.from_euler("Z", 2.0)
    x = np.column_stack([*(turn.apply(log.x[:, i : i + 3]) for i in (0, 3, 6)), log.x[:, 9:11], log.x[:, 11] + 2.0, log.x[:, 12:]])
    there = bridge.Log(log.t, x, log.u, log.usable, log.dt)
    ours, theirs = (vehicle.follower(each, gain)(starts=[200], steps=[10, 50]) for each in (log, there))
    for a, b in zip(ours, theirs):
        a, b = (v.reshape(-1, 15)[np.isfinite(v.reshape(-1, 15)).all(axis=1)] for v in (a, b))
        turned = np.column_stack([*(turn.apply(a[:, i : i + 3]) for i in (0, 3, 6)), a[:, 9:]])
        assert len(a) and np.abs(turned - b).max() < 1e-8


def test_predictions_ahead_begin_like_the_next_rows_and_end_with_the_log():
    log, states = flown(seconds=6)
    log.usable[400] = False
    gain = vehicle.observer_gain(log)
    predicted, ahead = bridge.quadrotor_follow(log, gain, starts=[100, 380, 595], steps=[1, 10, 50])
    assert np.allclose(ahead[:, 0], predicted[[101, 381, 596]], atol=1e-12)
    assert np.isfinite(ahead[0]).all() and np.isfinite(ahead[1, 1]).all() and np.isnan(ahead[1, 2]).all() and np.isnan(ahead[2, 1:]).all()
    assert np.isnan(predicted[[0, 401]]).all() and np.isfinite(predicted[402]).all()
    assert np.abs(ahead[0, 1, :3] - states[110, :3]).max() < 0.01
    assert not vehicle.settled(log)[[0, 402]].any() and vehicle.settled(log)[[100, 500]].all()
    assert vehicle.predictable(log).max() <= 550


def test_a_push_accelerates_the_body():
    log, _ = held()
    log.u[:] = log.u[0]
    push = np.tile([0.2, -0.1, 0.3, 0, 0, 0.5], (60, 1))
    still, pushed = (bridge.quadrotor_follow(log, np.zeros((22, 15)), push=p)[0] for p in (None, push))
    moved = (pushed - still)[59]
    assert np.allclose(moved[3:5], [0.118, -0.059], rtol=0.2) and moved[5] == pytest.approx(0.3 * 0.59, rel=0.1)
    assert moved[14] == pytest.approx(0.5 * 0.59, rel=0.01)


@pytest.mark.parametrize(
    "given, message",
    [
        ({"starts": [5, 3], "steps": [1]}, "starts must rise"),
        ({"starts": [900], "steps": [1]}, "starts must rise, within"),
        ({"starts": [5], "steps": [0]}, "steps must rise, from 1"),
        ({"active": [bridge.Effect("payload", (1.0, 0, 0))]}, "mass is 1, it must be between"),
        ({"vehicle": "kite"}, "no vehicle 'kite'"),
    ],
)
def test_bad_following_is_refused(given, message):
    log, _ = held(rows=30)
    with pytest.raises(UserError, match=message):
        bridge.quadrotor_follow(log, np.zeros((22, 15)), **given)
