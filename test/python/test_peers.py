"""The peers of the diagnoser name what is plain to see, say none on a healthy log, and keep to the contract."""

import json

import numpy as np
import pytest
from tinykoop import bridge

for package in ("pysindy", "sklearn", "threadpoolctl"):
    pytest.importorskip(package, reason=f"{package} is missing: `make blind` installs tools/requirements-peers.txt")

from tinykoop.blind.peers import PEERS, boosting, common, library, sindy  # noqa: E402

DT, SP, ST = 0.05, 0.004, 0.004
FIELDS = {"verdict", "effects", "ranking", "ambiguous_with", "gap", "fresh"}


def write(path, active, seed, rows=900):
    """A noisy log, simulated in fifths of a step under held random commands."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform((-0.8, -1), (2, 1), (rows // 30 + 1, 2)), 30, axis=0)[:rows]
    x = bridge.simulate(np.repeat(u, 5, axis=0), DT / 5, (0, 0, 2), active, bridge.ARC)[::5][:rows]
    bridge.write_log(path, x + random.standard_normal(x.shape) * (SP, SP, ST), u, DT)
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """{name: (log, fresh log of the same robot)}"""
    folder = tmp_path_factory.mktemp("logs")
    robots = {
        "none": [],
        "speed_gain": [bridge.Effect("speed_gain", (-0.1,))],
        "actuator_lag": [bridge.Effect("actuator_lag", (0.3,))],
    }
    return {name: tuple(write(folder / f"{name}{seed}.csv", active, seed) for seed in (1, 2)) for name, active in robots.items()}


@pytest.fixture(scope="module", autouse=True)
def small_training(tmp_path_factory):
    """Boosting on few logs, in a folder of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(boosting, "_CACHE", tmp_path_factory.mktemp("cache"))
        patch.setattr(boosting.peer.__wrapped__, "__defaults__", (None, (), boosting.Settings(logs=350, iterations=15)))
        yield


# effects of one axis or of the wheels, which a baseline takes for those of the body
ALIKE = ("speed_lag", "yaw_lag", "acceleration_limit", "wheel_dead_band", "wheel_saturation")


@pytest.mark.parametrize("peer", PEERS)
@pytest.mark.parametrize("name", ["speed_gain", "actuator_lag"])
def test_names_the_effect_and_closes_the_gap(logs, peer, name):
    found = PEERS[peer](*logs[name], without=ALIKE)
    assert set(found) == FIELDS and json.loads(json.dumps(found)) == found
    assert found["ranking"][0]["name"] == name
    scores = [entry["score"] for entry in found["ranking"]]
    assert scores == sorted(scores, reverse=True) and len(scores) == 17
    effect = found["effects"][0]
    assert effect["name"] == name and 0 <= effect["confidence"] <= 1
    true = {"speed_gain": -0.1, "actuator_lag": 0.3}[name]
    # sindy mixes the time constants of its library
    assert list(effect["params"].values())[0] == pytest.approx(true, rel=0.3 if peer == "sindy" else 0.05)
    for gap in (found["gap"], found["fresh"]["gap"]):
        assert gap["before"]["50"] > 3 * gap["noise_floor"]["50"]
        assert gap["closed_fraction"]["50"] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("peer", ["joint_ls", "sindy", "one_step"])  # boosting needs more logs for this
def test_healthy_robot_is_none(logs, peer):
    found = PEERS[peer](*logs["none"])
    assert found["verdict"] == "none" and found["effects"] == []
    assert found["gap"]["before"] == pytest.approx(found["gap"]["after"])


@pytest.mark.parametrize("peer", PEERS)
def test_left_out_effect_is_not_named(logs, peer):
    found = PEERS[peer](logs["actuator_lag"][0], None, ("actuator_lag",))
    assert "actuator_lag" not in json.dumps(found) and "fresh" not in found


def test_noise_and_floor_are_what_was_put_in(logs):
    data = common.Data.read(logs["none"][0])
    noise = common.Noise.of(data, common.simulator(()))
    assert noise.sp == pytest.approx(SP, rel=0.1) and noise.st == pytest.approx(ST, rel=0.1) and noise.rho < 0.1
    gap = common.gap(data, noise, common.simulator(()), data.kept)
    for steps in ("1", "10", "50"):
        assert gap["noise_floor"][steps] == pytest.approx(gap["before"][steps], rel=0.15)


def test_what_is_fitted_is_not_kept_back(logs):
    data = common.Data.read(logs["none"][0])
    assert not np.any(data.fit & data.kept) and np.all(data.fit | data.kept)
    rows = data.starts(data.kept, 50)
    assert len(rows) > 100 and all(data.kept[k : k + 50].all() for k in rows)


def test_sparse_model_without_terms_is_the_nominal_robot(logs):
    data = common.Data.read(logs["speed_gain"][0])
    nothing = sindy._Sparse(np.zeros((3, len(library.functions(data)) + 2)))
    starts = data.starts(data.usable, 50, 7)
    assert np.max(np.abs(nothing(data, starts, 50) - data.residual(starts, 50))) < 1e-9
