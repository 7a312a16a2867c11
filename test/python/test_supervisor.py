"""The supervisor over the simulated robot: no run is lost, and it costs little where it is not needed."""

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.experiments import control, scenario, supervisor
from tinykoop.plumbing.errors import UserError

PRECISIONS = (64, 32)


@pytest.mark.parametrize("number", range(24))
def test_no_run_is_lost(number):
    """One run of every dictionary, regulator and precision, on seeds of its own."""
    run = supervisor.draw(number, 30000)
    trace = supervisor.drive(run, "supervised")
    assert np.all(np.isfinite(trace["u"]))
    assert np.all((trace["u"] >= np.float32(supervisor.MPC.u_min)) & (trace["u"] <= np.float32(supervisor.MPC.u_max)))
    assert trace["error"].mean() < supervisor.LOST
    assert np.mean(trace["model"] == bridge.MODELS.index("online")) > 0.1


@pytest.mark.parametrize("method", supervisor.WORKS)
def test_price_where_the_method_works(method):
    row = supervisor.price(method)
    assert row["mean_error_supervised"] < 1.05 * row["mean_error_without_supervisor"]


@pytest.mark.parametrize("precision", PRECISIONS)
def test_ruined_learner_is_used_again(precision):
    """Vanilla RBF after the one-step run: lost without the supervisor, and learning again with it."""
    path = control.reference_path()
    error = {}
    for name, supervised in (("supervised", bridge.Supervisor(supervisor.theta_of_many_drives("rbf"))), ("without_supervisor", None)):
        estimator = supervisor.start("rbf", "ef", precision, "plain", "carried over")
        trace = estimator.control(supervisor.MPC, path, scenario.DT, 600, path[0], scenario.effects(control.EDGES), supervisor=supervised)
        error[name] = np.linalg.norm(trace["x"][1:] - path[1:601], axis=1).mean()
        if supervised:
            assert trace["resets"][-1] >= 1
            assert np.any(trace["model"] == bridge.MODELS.index("online"))
    assert error["supervised"] < supervisor.LOST < error["without_supervisor"]


def test_reference_family_is_within_the_box():
    for number in range(40):
        path = supervisor.draw(number, 30000)["reference"]
        speed = np.hypot(*np.diff(path[:, :2], axis=0).T) / scenario.DT
        turn = np.abs(np.diff(path[:, 2])) / scenario.DT
        assert speed.max() < 2.0 and speed.min() > 0.5
        assert turn.max() < 0.75
        assert np.abs(path[:, 2]).max() <= supervisor.HEADING + 1e-9


def test_draws_repeat_and_differ():
    one, same, other = supervisor.draw(3, 1), supervisor.draw(3, 1), supervisor.draw(3, 2)
    assert np.array_equal(one["reference"], same["reference"]) and one["effects"] == same["effects"]
    assert not np.array_equal(one["x0"], other["x0"])


def test_bad_offline_model_is_refused():
    estimator = bridge.Estimator("poly_ddr", "sift", 64)
    run = supervisor.draw(0, 1)

    def attempt(theta, **rest):
        estimator.control(supervisor.MPC, run["reference"], scenario.DT, 10, run["x0"], supervisor=bridge.Supervisor(theta), **rest)

    with pytest.raises(ValueError, match="shape"):
        attempt(np.zeros((3, 3)))
    with pytest.raises(UserError, match="supervisor"):
        attempt(np.full((7, 9), np.nan))
    with pytest.raises(UserError, match="supervisor"):
        attempt(np.zeros((7, 9)))  # no input acts on it
    with pytest.raises(UserError, match="solver"):
        attempt(supervisor.theta_of_many_drives("poly"), solver=lambda theta, psi, reference: (0.0, 0.0))
