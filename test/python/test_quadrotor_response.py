"""How late a quadrotor answers: of a double integrator behind a known lag and delay, and of simulated flights."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter
from tinykoop import bridge
from tinykoop.diagnose.platforms.quadrotor import features
from tinykoop.diagnose.platforms.quadrotor.response import response

DT, FINE = 0.01, 20


def answering(lag, delay, seconds=30.0, gain=300.0, seed=0):
    """A log of a vehicle without a controller that rolls and pitches by itself: steps of the requests, to and fro."""
    rng, rows = np.random.default_rng(seed), round(seconds / DT)
    x, u, log = np.zeros((rows, 15)), np.full((rows, 5), 0.6), None
    for rate, angle, pattern in ((12, 9, [-1, -1, 1, 1]), (13, 10, [-1, 1, 1, -1])):
        asked = 0.02 * np.repeat(rng.standard_normal(rows // 5), 5)
        asked -= np.convolve(asked, np.ones(40) / 40, "full")[: len(asked)]  # so that it does not wander off
        held = np.repeat(asked, FINE)
        late = np.concatenate([np.zeros(round(delay / DT * FINE)), held])[: len(held)]
        kept = np.exp(-DT / FINE / lag)
        spin = np.cumsum(gain * lfilter([0, 1 - kept], [1, -kept], late)) * DT / FINE
        x[:, rate], x[:, angle] = spin[::FINE], (np.cumsum(spin) * DT / FINE)[::FINE]
        u[:, :4] += np.outer(asked, pattern)
    x += np.repeat([4e-4, 1.5e-3, 0.07, 4e-4, 0.02], 3) * rng.standard_normal(x.shape)
    log = SimpleNamespace(t=np.arange(rows) * DT, x=x, u=u, usable=np.ones(rows - 1, bool), dt=DT)
    return log, np.ones(rows, bool)


@pytest.mark.parametrize("lag, delay", [(0.06, 0.0), (0.06, 0.01), (0.1, 0.0), (0.04, 0.02)])
def test_lag_and_delay_of_a_known_answer_are_found(lag, delay):
    found = response(*answering(lag, delay))
    assert found["lag"][0] == pytest.approx(lag, abs=0.01) and found["delay"][0] == pytest.approx(delay, abs=0.0025)


def of_flight(effects, seed=3):
    log, _ = bridge.quadrotor("mixed", 20, seed, effects)
    return response(log, features.steady(log))


def test_a_flight_with_a_delay_answers_later_than_a_healthy_one():
    healthy, late = of_flight([]), of_flight([bridge.Effect("transport_delay", (0.01,))])
    assert late["delay"][0] - healthy["delay"][0] == pytest.approx(0.01, abs=0.004)


def test_a_calm_controller_asks_for_enough_to_know_the_delay():
    calm = bridge.quadrotor_vehicle() | {"rate_gain": 40.0}
    logs = [bridge.quadrotor("mixed", 20, seed, vehicle=calm)[0] for seed in (1, 2, 3)]
    assert np.abs([response(log, features.steady(log))["delay"][0] for log in logs]).max() < 5e-4


def test_a_log_without_gyro_or_without_manoeuvres_does_not_tell():
    log, rows = answering(0.06, 0.0)
    still = SimpleNamespace(**{**vars(log), "x": log.x * 0.01})
    assert response(still, rows) == {}
    log.x[:, 12:] = np.nan
    assert response(log, rows) == {}
