"""Logs beyond bridge.LONG rows: predictions are as exact as on short ones, and what they cost does not grow with the log."""

import io
import time

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr import diagnose
from tinykoop.diagnose.prediction_errors import ahead
from tinykoop.logs import replay
from tinykoop.plumbing import results
from tinykoop.plumbing.errors import UserError

DT = 0.05
SLOWEST = [
    bridge.Effect("actuator_lag", (3.0,)), bridge.Effect("transport_delay", (0.42,)), bridge.usual_effect("backlash"),
    bridge.usual_effect("battery_sag", 1000.0), bridge.usual_effect("pacejka_slip", 500.0, 2000.0),
]  # fmt: skip


def drive(rows, active=(), seed=1, noise=0.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform((-0.3, -1.0), (2.0, 1.0), (-(-rows // 40), 2)), 40, axis=0)[:rows]
    x = bridge.simulate(u[:-1], DT, active=active, integrator=bridge.ARC)
    return bridge.Log(np.arange(rows) * DT, x + noise * rng.standard_normal(x.shape), u, np.ones(rows - 1, bool), DT)


@pytest.mark.parametrize("order", ["as they follow", "mixed"])
def test_windows_of_a_long_log_are_the_simulation_itself(order):
    """The log is simulated from its first row on, all effects with it, so a perfect prediction leaves nothing.

    What the slowest lag still remembers of the time before its warm-up is a jump of the command by 2 m/s, times exp(-10).
    """
    log, steps = drive(60_000, SLOWEST), [1, 10, 50]
    starts = np.r_[0:2000:100, 2500:50000:2503, len(log.x) - 51]
    starts = np.random.default_rng(0).permutation(starts) if order == "mixed" else starts
    for usable in (None, log.usable):
        predicted, left = bridge.windows(log.x, log.u, DT, starts, steps, SLOWEST, usable, bridge.ARC)
        assert np.abs(left).max() < 2 * np.exp(-10) * 50 * DT
        if order != "mixed":
            assert np.abs(left[starts < 2000]).max() < 1e-9, "these are rolled from the first row"
        assert np.abs(predicted - log.x[starts[:, None] + steps]).max() < 2 * np.exp(-10) * 50 * DT


def test_steps_of_a_long_log_are_the_simulation_itself():
    log = drive(60_000, SLOWEST)
    starts = np.r_[0:2000:100, 2500:50000:2503, len(log.x) - 2]
    steps = bridge.Steps(log.x, log.u, DT, starts, bridge.ARC)
    beside, *again = [steps.beside(SLOWEST) for _ in range(3)]
    assert np.array_equal(again, [beside, beside])
    assert np.abs(beside).max() < 2 * np.exp(-10) * DT and np.abs(beside[:20]).max() < 1e-9


def test_what_lies_between_windows_of_a_long_log_is_not_looked_at():
    log = drive(40_000)
    log.x[20000], log.u[20000] = np.nan, np.nan
    assert np.isfinite(bridge.windows(log.x, log.u, DT, [100, 30000], [50])[1]).all()
    for start in (19980, 20010):  # it lies in the window, or before it
        with pytest.raises(UserError, match="20000 is not finite"):
            bridge.windows(log.x, log.u, DT, [100, start], [50], SLOWEST)


def seconds(rows):
    """Of a prediction over 100 windows, the quickest of some."""
    log = drive(rows)
    rollouts = bridge.Rollouts(log.x, log.u, DT, np.linspace(700, rows - 100, 100).astype(int), [1, 10, 50])

    def once():
        begun = time.perf_counter()
        rollouts.predict(SLOWEST[:1])
        return time.perf_counter() - begun

    return min(once() for _ in range(5))


def test_a_prediction_costs_the_same_in_a_log_ten_times_as_long():
    assert seconds(1_000_000) < 3 * seconds(100_000)


def test_starts_are_those_of_the_rows_counted_one_by_one():
    rng = np.random.default_rng(2)
    for _ in range(200):
        rows = int(rng.integers(4, 300))
        usable = rng.random(rows - 1) < rng.uniform(0.5, 1)
        run = [0] * rows
        for k in range(rows - 2, -1, -1):
            run[k] = run[k + 1] + 1 if usable[k] else 0
        expected = [k for k in range(rows) if run[k] >= min(50, max(run))]
        log = bridge.Log(np.arange(rows) * DT, np.zeros((rows, 3)), np.zeros((rows, 2)), usable, DT)
        assert ahead.starts_of(ddr.Path(log)).tolist() == expected


def test_diagnosis_of_a_long_log_says_what_was_searched():
    effects = [bridge.Effect("actuator_lag", (0.25,))]
    result = diagnose(drive(40_000, effects, noise=0.005))
    (found,) = result.report["effects"]
    assert found["name"] == "actuator_lag" and abs(found["params"]["tau"] - 0.25) < 0.01
    searched = result.report["log"]["searched_rows"]
    assert searched == ddr.MOST < bridge.LONG
    assert f"{searched:,} of its rows" in " ".join(ddr.Teller(result).searched())


def test_diagnosis_of_a_log_that_is_not_long_says_nothing_of_it():
    assert ddr.Teller(diagnose(drive(200, [], noise=0.005))).searched() == []


def test_diagnose_shows_that_it_is_at_work(tmp_path, monkeypatch):
    from tinykoop import diagnose as command

    log, shown = drive(400, noise=0.005), []
    bridge.write_log(tmp_path / "drive.csv", log.x, log.u, DT)
    busy = command.busy
    monkeypatch.setattr(command, "busy", lambda text: shown.append(text) or busy(text))
    command.run(tmp_path / "drive.csv", tmp_path / "out")
    assert shown == ["diagnosing drive.csv"]


@pytest.mark.parametrize("terminal", [True, False])
def test_busy_draws_on_a_terminal_only(terminal, monkeypatch):
    console = results._Console(file=io.StringIO(), force_terminal=terminal, width=80)
    monkeypatch.setattr(results, "console", console)
    with results.busy("diagnosing [x].csv"):
        pass
    assert ("diagnosing [x].csv" in console.file.getvalue()) == terminal


def test_norm_beyond_the_range_of_squares():
    matrix = np.array([[3e200, 0], [0, 4e200]])
    assert replay.norm(matrix) == pytest.approx(5e200, rel=1e-15)
    assert replay.norm(np.full((2, 2), np.inf)) == np.inf
    assert np.isnan(replay.norm(np.full((2, 2), np.nan)))
