"""The guard over the simulated robot: no run is lost, and it costs little where it is not needed."""

import numpy as np
import pytest

from tinykoop import bridge
from tinykoop.experiments import control, guard, scenario
from tinykoop.plumbing.errors import UserError

PRECISIONS = (64, 32)


@pytest.mark.parametrize("number", range(24))
def test_no_run_is_lost(number):
    """One run of every dictionary, regulator and precision, on seeds of its own."""
    run = guard.draw(number, 30000)
    trace = guard.drive(run, "guarded")
    assert np.all(np.isfinite(trace["u"]))
    assert np.all((trace["u"] >= np.float32(guard.MPC.u_min)) & (trace["u"] <= np.float32(guard.MPC.u_max)))
    assert trace["error"].mean() < guard.LOST
    assert np.mean(trace["model"] == bridge.MODELS.index("online")) > 0.1


@pytest.mark.parametrize("method", guard.WORKS)
def test_price_where_the_method_works(method):
    row = guard.price(method)
    assert row["mean_error_guarded"] < 1.05 * row["mean_error_unguarded"]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_ruined_learner_is_used_again(precision):
    """Vanilla RBF after the one-step run: lost without the guard, and learning again with it."""
    path = control.reference_path()
    error = {}
    for name, guarded in (("guarded", bridge.Guard(guard.theta_of_many_drives("rbf"))), ("unguarded", None)):
        estimator = guard.start("rbf", "ef", precision, "plain", "carried over")
        trace = estimator.control(
            guard.MPC, path, scenario.DT, 600, path[0], scenario.effects(control.EDGES), guard=guarded
        )
        error[name] = np.linalg.norm(trace["x"][1:] - path[1:601], axis=1).mean()
        if guarded:
            assert trace["resets"][-1] >= 1
            assert np.any(trace["model"] == bridge.MODELS.index("online"))
    assert error["guarded"] < guard.LOST < error["unguarded"]


def test_reference_family_is_within_the_box():
    for number in range(40):
        path = guard.draw(number, 30000)["reference"]
        speed = np.hypot(*np.diff(path[:, :2], axis=0).T) / scenario.DT
        turn = np.abs(np.diff(path[:, 2])) / scenario.DT
        assert speed.max() < 2.0 and speed.min() > 0.5
        assert turn.max() < 0.75
        assert np.abs(path[:, 2]).max() <= guard.HEADING + 1e-9


def test_draws_repeat_and_differ():
    one, same, other = guard.draw(3, 1), guard.draw(3, 1), guard.draw(3, 2)
    assert np.array_equal(one["reference"], same["reference"]) and one["effects"] == same["effects"]
    assert not np.array_equal(one["x0"], other["x0"])


def test_bad_offline_model_is_refused():
    estimator = bridge.Estimator("poly_ddr", "sift", 64)
    run = guard.draw(0, 1)

    def attempt(theta, **rest):
        estimator.control(guard.MPC, run["reference"], scenario.DT, 10, run["x0"], guard=bridge.Guard(theta), **rest)

    with pytest.raises(ValueError, match="shape"):
        attempt(np.zeros((3, 3)))
    with pytest.raises(UserError, match="guard"):
        attempt(np.full((7, 9), np.nan))
    with pytest.raises(UserError, match="guard"):
        attempt(np.zeros((7, 9)))  # no input acts on it
    with pytest.raises(UserError, match="solver"):
        attempt(guard.theta_of_many_drives("poly"), solver=lambda theta, psi, reference: (0.0, 0.0))
