"""Quadrotors before and after a change: what the table has, and that learning pays, on short simulated flights."""

import json
from types import SimpleNamespace

import pytest
from test_quadrotor_learning import CRAZYFLIE, without
from tinykoop import bridge
from tinykoop.experiments import scenario, transfer
from tinykoop.experiments import transfer_quadrotor as changed
from tinykoop.experiments.flights import data
from tinykoop.logs import replay
from tinykoop.plumbing.errors import UserError


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """transfer_quadrotor.json of short simulated flights and labelled ones, which are simulated, too, without pitch and gyro."""
    weak = [bridge.Effect("rotor3_thrust", (-0.25,))]
    flights = [
        data.Flight(f"d{k}", "E8", family, rotors, size, without(bridge.quadrotor("mixed", 8, 20 + k, active)[0], CRAZYFLIE))
        for k, (family, rotors, size, active) in enumerate(
            [("none", "", "", []), ("rotor", "M3", "6", weak), ("rotor", "M3", "1", []), ("payload", "M3", "W1", [])]
        )
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changed, "SECONDS", 10)
        patch.setattr(changed, "FLIGHTS", 1)
        patch.setattr(changed, "CHANGES", {"weak": "rotor3_thrust=-0.25"})
        patch.setattr(transfer, "INVERSE_RIDGES", (1.0, 100.0))
        patch.setattr(data, "load", lambda folder: flights)
        folder = tmp_path_factory.mktemp("transfer")
        changed.run(folder, folder / "mine")
    return json.loads((folder / "transfer_quadrotor.json").read_text())


def test_transfer_has_every_method_direction_and_precision(rows):
    keys = {(r["source"], r["change"], r["dictionary"], r["regulator"], r["direction"], r["precision"]) for r in rows}
    assert len(keys) == len(rows) == 2 * len(scenario.METHODS) * 4 * 2
    assert {(r["source"], r["change"]) for r in rows} == {("synthetic", "weak"), ("mine", "E8, rotor M3, 6 mm")}
    assert all((r["delta"] is not None) == (r["regulator"] in bridge.dead_zones()) for r in rows)


def test_after_a_change_learning_is_better_than_the_healthy_vehicles_model(rows):
    for change in {row["change"] for row in rows}:
        seen = {
            (r["dictionary"], r["regulator"]): r for r in rows if (r["change"], r["direction"], r["precision"]) == (change, "H->C", "f64")
        }
        offline = seen.pop(("rbf", "offline"))
        assert all(row["mean_error"] < offline["mean_error"] for row in seen.values())
        assert min(row["mean_error"] for row in seen.values()) < offline["stays"]


def test_precisions_agree_on_changed_vehicles(rows):
    for wide, narrow in zip(rows[::2], rows[1::2]):
        assert (wide["precision"], narrow["precision"]) == ("f64", "f32") and wide["regulator"] == narrow["regulator"]
        assert narrow["mean_error"] == pytest.approx(wide["mean_error"], rel=0.03)


def test_the_page_has_errors_before_and_after(rows):
    title, headers, lines = changed._table([row for row in rows if row["source"] == "synthetic"])
    assert "simulated" in title and headers[1:3] == ["weak: before", "weak: after"]
    assert [line[0] for line in lines] == [replay.NOTHING, *(method.label for method in scenario.METHODS)]


def test_flights_without_a_cut_are_one_line(monkeypatch):
    whole = data.Flight("d0", "E8", "none", "", "", SimpleNamespace())
    monkeypatch.setattr(data, "load", lambda folder: [whole])
    with pytest.raises(UserError, match="no vehicle has both healthy flights"):
        changed.labelled("mine")
