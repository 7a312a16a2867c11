"""The replay and its benchmark: what is asked of a replay does not change what it does, and its figures are what they say."""

import json

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.bench import learners, update
from tinykoop.plumbing.errors import UserError

K = 203


@pytest.fixture(scope="module")
def log():
    """(x, u, usable) of a robot, with a masked row, a command that is not a number and a state beyond float32."""
    k = np.arange(K)
    u = np.stack([1.5 + 0.3 * np.sin(0.1 * k), 0.6 * np.cos(0.08 * k)], axis=1)
    x = bridge.simulate(u, 0.05, active=[bridge.usual_effect("stribeck_friction")])
    usable = np.ones(K, bool)
    x[50], usable[49:51] = np.nan, False
    u[90, 0] = np.nan
    x[120, 1] = 1e200
    return x, u, usable


def replayed(log, form, precision, regulator, rows=K, **asked):
    """(estimator, traces) of the first rows of the log."""
    x, u, usable = log
    estimator = bridge.Estimator("rbf_ddr", regulator, precision, form=form)
    return estimator, estimator.replay(x[: rows + 1], u[:rows], usable[:rows], **asked)


def same_bits(a, b):
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


CELLS = [
    (form, precision, regulator) for form in ("plain", "sqrt", "textbook") for precision in (32, 64) for regulator in ("dz_cs", "sift")
]


@pytest.mark.parametrize("cell", CELLS, ids=lambda cell: "-".join(map(str, cell)))
def test_traces_not_asked_for_change_nothing(log, cell):
    """Each trace alone, and none, bit for bit; Theta and P too. The log has what is skipped, refused and gated."""
    full, everything = replayed(log, *cell, every=40)
    assert set(everything) == {*bridge.TRACES, "theta", "covariance"}
    assert {1, 0, -5, -6} >= set(everything["status"]) >= {1, 0, -5}
    assert cell[2] != "dz_cs" or 0 < everything["frozen"].sum() < K
    for asked in [(), *((name,) for name in bridge.TRACES)]:
        estimator, traces = replayed(log, *cell, traces=asked)
        assert set(traces) == set(asked)
        for name in asked:
            assert same_bits(traces[name], everything[name]), name
        assert same_bits(estimator.theta, full.theta) and same_bits(estimator.covariance, full.covariance), asked


@pytest.mark.parametrize("rows", [1, 7, 8, 9, 16])
def test_a_shorter_log_gives_the_beginning_of_the_traces(log, rows):
    """Norms are taken of several steps at once, and none is forgotten at the end."""
    _, everything = replayed(log, "plain", 64, "ef")
    for name, values in replayed(log, "plain", 64, "ef", rows)[1].items():
        assert same_bits(values, everything[name][:rows]), name


def test_an_unknown_trace_is_refused(log):
    with pytest.raises(ValueError, match="norm_q"):
        replayed(log, "plain", 64, "ef", traces=("error", "norm_q"))


# ---- benchmark ---------------------------------------------------------------------------------


@pytest.mark.parametrize("precision, tolerance", [(32, 1e-6), (64, 1e-15)])
def test_the_wide_dictionary_is_wide(precision, tolerance):
    """N = 40: rbf_fwmav, then every square and product of the four rates once."""
    x = np.random.default_rng(7).normal(size=(20, 10))
    wide, narrow = (bridge.Estimator(name, "ef", precision, n_inputs=1) for name in ("wide_fwmav", "rbf_fwmav"))
    assert (wide.n, wide.N, narrow.N) == (10, 40, 30)
    psi = wide.lift(x)
    assert np.array_equal(psi[:, :30], narrow.lift(x))
    rates = x[:, [0, 1, 2, 9]]
    products = {(i, j): rates[:, i] * rates[:, j] for i in range(4) for j in range(i + 1)}
    assert np.allclose(psi[:, 30:], np.stack(list(products.values()), axis=1), rtol=tolerance, atol=0)


@pytest.fixture(scope="module")
def flight():
    x, u = update.flight()
    return x[: update.NUMPY_ROWS + 101], u[: update.NUMPY_ROWS + 100]


def test_replay_rows(flight, capsys):
    """Every dictionary, regulator and form once; rates, shares and ratios are those of the times and traces beside them."""
    rows = update.replay_rows(*flight, "flags", repeats=1)
    json.dumps(rows, allow_nan=False)
    by_task = {row["task"]: row for row in rows}
    assert len(by_task) == len(rows) == 3 * len(bridge.regulator_names()) * 2
    for row in rows:
        assert row["unit"] == "ns" and row["ours"] > 0
        assert row["samples_per_second"] == pytest.approx(1e9 / row["ours"], rel=1e-3)
        assert (row["peer"] is None) == (row["ratio"] is None)
        assert row["peer"] is None or row["ratio"] == pytest.approx(row["peer"] / row["ours"], rel=1e-2)
    assert [row["task"] for row in rows if row["peer"]] == [f"replay_f32_N{N}_ef_sqrt" for N in (20, 30, 40)]
    assert not any(row["refused"] for task, row in by_task.items() if task.endswith("_sqrt"))

    x, u = flight
    theta, P, gated = np.zeros((40, 41)), 100.0 * np.eye(41), 0
    psi = bridge.Estimator("wide_fwmav", "ef", 64, n_inputs=1).lift(x)
    for z, target in zip(np.column_stack([psi[:-1], u]), psi[1:]):
        missed, g = target - theta @ z, P @ z
        theta += np.outer(missed, g / (0.995 + z @ g))
        if np.linalg.norm(missed) > 1:
            P = (P - np.outer(g, g) / (0.995 + z @ g)) / 0.995
            P = (P + P.T) / 2
        else:
            gated += 1
    assert by_task["replay_f32_N40_dz_cs_sqrt"]["frozen"] == pytest.approx(gated / len(u), abs=0.02)

    update.show_replays(rows)
    shown = capsys.readouterr().out
    assert "N = 40, sqrt" in shown and f"{by_task['replay_f32_N40_none']['samples_per_second'] / 1e6:.2f}" in shown


def test_a_peer_that_learns_something_else_is_refused(flight, monkeypatch):
    class Forgetful(update.NumpyRls):
        def __init__(self, dtype, n_lifted, n_regressors, forgetting, p0):
            super().__init__(dtype, n_lifted, n_regressors, forgetting - 1e-4, p0)

    monkeypatch.setattr(update, "NumpyRls", Forgetful)
    with pytest.raises(UserError, match="NumPy learns something else"):
        update.replay_rows(*flight, "flags", repeats=1)


# ---- learners in Python --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def peers():
    for package in ("padasip", "sklearn", "pykoop", "pysindy", "odmd"):
        pytest.importorskip(package, reason=f"{package} is missing: `make bench` installs it")


def test_learners_give_every_row_once_and_learn_the_same(peers, capsys):
    rows = learners.run(1, learners.FEW_ROWS)
    json.dumps(rows, allow_nan=False)
    at = {row["task"]: row for row in rows}
    names = (*learners.BATCH, *learners.ONLINE, learners.AT_ONCE)
    assert len(at) == len(rows) == 3 * len(names) + 3
    for n in learners.STEPS:
        ours, peer = at[f"python_error_{n}, TinyKoop"], at[f"python_error_{n}, scikit-learn, LinearRegression"]
        assert peer["peer"] == pytest.approx(ours["ours"], rel=1e-3) and ours["ratio"] == 1
    assert all(row["ours"] > 0 and row["ratio"] == pytest.approx(row["peer"] / row["ours"], rel=2e-3) for row in rows)
    shown = capsys.readouterr().out
    assert "pykoop, own polynomials" in shown and "row by row" in shown


def test_errors_of_learners_are_those_of_least_squares():
    """By numpy.linalg.lstsq on features by hand, and an error one and ten steps ahead in a loop."""
    data = learners.drive(learners.FEW_ROWS)
    a, b, c = data.x.T
    psi = np.stack([a, b, c, a * a, a * b, a * c, b * b, b * c, c * c, np.ones(len(a))], axis=1)
    assert psi.shape[1] == learners.SIZE
    fitted = data.fitted
    theta = np.linalg.lstsq(np.hstack([psi[:fitted], data.u[:fitted]]), psi[1 : fitted + 1], rcond=None)[0].T
    for steps in learners.STEPS:
        squares = []
        for start in data.starts:
            z = psi[start]
            for k in range(steps):
                z = theta @ np.concatenate([z, data.u[start + k]])
            squares.append(np.sum((z[:2] - data.x[start + steps, :2]) ** 2))
        fit = learners.BATCH[learners.OURS][1](data)
        assert learners.error(data, learners.linear(data, fit, steps), steps) == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-2)


def test_online_learners_predict_before_they_learn():
    """The model of a start is that of a learner that was given the rows before it alone."""
    data = learners.drive(learners.FEW_ROWS)
    models = learners.models_ahead(data, learners._Tinykoop(data))
    for at in (0, len(data.starts) - 1):
        other = learners._Tinykoop(data)
        for k in range(data.starts[at]):
            other.learn(k)
        np.testing.assert_array_equal(models[at], other.theta)


def test_a_python_peer_that_learns_something_else_is_refused(peers, monkeypatch):
    ours = learners.BATCH[learners.OURS][1]
    monkeypatch.setitem(learners.BATCH, "pykoop, Edmd", ("pykoop", lambda data: 1.001 * ours(data)))
    with pytest.raises(UserError, match="pykoop, Edmd learns something else than TinyKoop"):
        learners.errors_of(learners.drive(learners.FEW_ROWS))
