"""Flapping wing across regimes: the filter, the parts of a flight, and what the table says."""

import functools

import numpy as np
import pytest
from scipy import signal
from tinykoop import bridge
from tinykoop.experiments import scenario, transfer
from tinykoop.plumbing.errors import UserError


@pytest.mark.parametrize(("precision", "bound"), [(32, 1e-5), (64, 1e-13)])
def test_lowpass_is_butterworths(precision, bound):
    x = np.cumsum(np.random.default_rng(0).normal(size=(2000, 7)), axis=0)
    b, a = signal.butter(2, 5, fs=100)
    start = signal.lfilter_zi(b, a)
    expected = np.stack([signal.lfilter(b, a, column, zi=start * column[0])[0] for column in x.T], axis=1)
    assert np.abs(bridge.lowpass(x, 5, 100, precision) - expected).max() < bound * np.abs(expected).max()


def test_lowpass_begins_anew_after_a_gap_and_leaves_bad_rows_out():
    x = np.random.default_rng(1).normal(size=(40, 2))
    usable = np.ones(39, bool)
    usable[19] = False
    both = bridge.lowpass(x, 5, 100, usable=usable)
    assert np.array_equal(both[20:], bridge.lowpass(x[20:], 5, 100))
    spoilt = x.copy()
    spoilt[30] = np.nan
    seen = bridge.lowpass(spoilt, 5, 100)
    assert np.isnan(seen[30]).all() and np.isfinite(np.delete(seen, 30, axis=0)).all()


def test_lowpass_refuses_a_cut_off_beyond_the_sampling():
    with pytest.raises(UserError, match="60 Hz at 100 Hz"):
        bridge.lowpass(np.zeros((5, 1)), 60, 100)


def test_parts_of_a_flight_share_its_usable_steps():
    usable = np.random.default_rng(2).random(1000) > 0.3
    flight = transfer.Flight(np.zeros((1001, 10)), np.zeros((1001, 1)), usable, 0.01)
    parts = [flight.part(a, b) for a, b in ((0, 0.2), (0.2, 0.4), (0.4, 1))]
    assert np.array_equal(sum(part.astype(int) for part in parts), usable.astype(int))
    assert parts[0].sum() == pytest.approx(0.2 * usable.sum(), abs=1)


@functools.cache
def table():
    return transfer.transfers("synthetic", transfer.synthetic())[0]


def test_skipping_the_covariance_is_never_worse_than_skipping_all():
    """Paper: in all eight comparisons."""
    for dictionary in ("poly", "rbf"):
        for calibrated in (False, True):
            cs, ks = (transfer.chosen(table(), scenario.Method(dictionary, r), calibrated=calibrated) for r in ("dz_cs", "dz_ks"))
            assert all(a["mean_error"] <= b["mean_error"] for a, b in zip(cs, ks))


def test_precisions_agree():
    for method in scenario.METHODS:
        for wide, narrow in zip(transfer.chosen(table(), method), transfer.chosen(table(), method, "f32")):
            assert narrow["mean_error"] == pytest.approx(wide["mean_error"], rel=0.03)


def test_regulated_covariance_stays_bounded_where_vanilla_winds_up():
    largest = {m: max(row["final_P_fro"] for row in transfer.chosen(table(), m)) for m in scenario.METHODS if m.regulator != "offline"}
    assert all(P < 1e4 for m, P in largest.items() if m.regulator not in ("ef", "vrf"))
    assert all(P < 1e6 for m, P in largest.items() if m.regulator == "vrf")  # it slows the windup, and does not bound P
    assert all(P > 1e8 for m, P in largest.items() if m.regulator == "ef")


def test_a_folder_without_flights_is_one_line(tmp_path):
    with pytest.raises(UserError, match="no log of pitch"):
        transfer.read(tmp_path)
