"""`import tinykoop`: the library's own bits, in Python and in firmware; errors; scikit-learn's conventions."""

import copy
import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest
import tinykoop as tk
from scipy import optimize
from tinykoop import bridge, dictionaries
from tinykoop.experiments import scenario
from tinykoop.logs import fit, replay

ROOT = Path(__file__).resolve().parents[2]
K, DT = 400, 0.05


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform((0, -1), (1, 1), (K // 20, 2)), 20, axis=0)
    return tk.simulate(u, DT), u


def grid():
    return np.stack(np.meshgrid(np.linspace(-3, 3, 4), np.linspace(-3, 3, 4)), -1).reshape(-1, 2)


def with_sines(X):
    return np.column_stack([X, np.sin(X[:, 2]), np.cos(X[:, 2])])


DICTIONARIES = {
    "built in": "rbf_ddr",
    "parts": tk.RBF(grid(), 1.5) + tk.Angles([2], wrapped=True),
    "polynomials": tk.Poly(3) + tk.Constant() + tk.Products([(0, 2)]),
    "function": with_sines,
}


def textbook(psi, u, lam, p0):
    """Theta by recursive least squares as the paper writes it, eq. (4), in float64."""
    N, d = psi.shape[1], psi.shape[1] + u.shape[1]
    theta, P = np.zeros((N, d)), p0 * np.eye(d)
    for k in range(len(u)):
        zeta = np.concatenate([psi[k], u[k]])
        g = P @ zeta
        theta += np.outer(psi[k + 1] - theta @ zeta, g) / (lam + zeta @ g)
        P = (P - np.outer(g, g) / (lam + zeta @ g)) / lam
    return theta


# ---- learning ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DICTIONARIES)
def test_theta_is_that_of_the_textbook(drive, name):
    x, u = drive
    model = tk.RLS(DICTIONARIES[name], 2, regulator="ef", precision="f64", lam=0.99, p0=10.0).fit(x, u)
    expected = textbook(model.lift(x), u, 0.99, 10.0)
    probe = np.hstack([model.lift(x[:-1]), u])
    np.testing.assert_allclose(probe @ model.theta.T, probe @ expected.T, atol=1e-7)


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("name", DICTIONARIES)
def test_updates_one_by_one_and_a_series_give_the_same_bits(drive, name, precision):
    x, u = drive
    whole = tk.RLS(DICTIONARIES[name], 2, precision=precision, settings={"delta": 0.02}).fit(x, u)
    steps = tk.RLS(DICTIONARIES[name], 2, precision=precision, settings={"delta": 0.02})
    healths = [steps.update(x[k], u[k], x[k + 1]) for k in range(K)]
    parts = tk.RLS(DICTIONARIES[name], 2, precision=precision, settings={"delta": 0.02})
    parts.partial_fit(x[:201], u[:200]).partial_fit(x[200:], u[200:])
    for other in (steps, parts):
        np.testing.assert_array_equal(whole.theta, other.theta)
        np.testing.assert_array_equal(whole.P, other.P)
    assert any(h.frozen for h in healths) and not all(h.frozen for h in healths) and healths[-1].trust is None


def test_paper_dictionary_of_parts_is_the_built_in_one(drive):
    x, u = drive
    built_in, parts = (tk.RLS(DICTIONARIES[name], 2, precision="f64").fit(x, u) for name in ("built in", "parts"))
    gaussians = np.abs(parts.lift(x)[:, 3:19, None] - built_in.lift(x)[:, None, 3:19]).max(0)
    columns = [*range(3), *(3 + gaussians.argmin(0)), *range(19, 22)]
    np.testing.assert_allclose(parts.lift(x)[:, columns], built_in.lift(x), atol=1e-14)


@pytest.mark.parametrize("regulator", tk.regulators())
@pytest.mark.parametrize("form", ["plain", "sqrt"])
def test_every_regulator_learns_from_python(drive, regulator, form):
    x, u = drive
    model = tk.RLS("poly_ddr", 2, regulator=regulator, form=form, precision="f64").fit(x, u)
    core = bridge.Estimator("poly_ddr", regulator, 64, form=form, check=bridge.CHECK_REFUSE)
    core.replay(x, u, traces=())
    np.testing.assert_array_equal(model.theta, core.theta)
    np.testing.assert_array_equal(model.P, core.covariance)


def test_rows_that_are_not_usable_may_hold_nan(drive):
    x, u = drive
    broken, usable = x.copy(), np.ones(K, bool)
    broken[100], usable[99:101] = np.nan, False
    for name in ("built in", "function"):
        model, other = (tk.RLS(DICTIONARIES[name], 2) for _ in range(2))
        model.fit(broken, u, usable)
        other.fit(x, u, usable)
        np.testing.assert_array_equal(model.theta, other.theta)
    with pytest.raises(ValueError, match="mask it by `usable`"):
        model.fit(broken, u)


def test_gate_refuses_an_outlier_without_an_exception(drive):
    x, u = drive
    model = tk.RLS("poly_ddr", 2, gate=tk.Gate(multiple=6)).fit(x[:300], u[:300])
    theta, spike, refused = model.theta, x[301] + 5.0, model.n_refused_
    health = model.update(x[300], u[300], spike)
    assert health.status == -9 and health.trust == "doubtful" and model.n_refused_ == refused + 1
    np.testing.assert_array_equal(model.theta, theta)


def test_refused_sample_raises_its_message_and_changes_nothing(drive):
    x, u = drive
    model = tk.RLS("poly_ddr", 2).fit(x, u)
    theta, P = model.theta, model.P
    with pytest.raises(tk.Refused, match="NaN or infinite") as refused:
        model.update([np.nan, 0, 0], u[0], x[1])
    assert refused.value.status == -5
    np.testing.assert_array_equal(model.theta, theta)
    np.testing.assert_array_equal(model.P, P)


@pytest.mark.parametrize("kwargs, message", [
    ({"regulator": "none at all"}, "no regulator named"), ({"form": "round"}, "no covariance form"), ({"precision": "f16"}, "precision is 'f16'"),
    ({"settings": {"sigma": 1.0}}, "no setting sigma"), ({"settings": {"delta": -1.0}}, "range"), ({"lam": 0.0}, "range"),
    ({"gate": tk.Gate(multiple=0.5)}, "gate: a setting is outside its range"),
])  # fmt: skip
def test_bad_parameters_are_refused_at_fit(drive, kwargs, message):
    with pytest.raises((ValueError, tk.UserError), match=message):
        tk.RLS("poly_ddr", 2, **kwargs).fit(*drive)


@pytest.mark.parametrize("dictionary, message", [
    (lambda X: X[:, :2], "must be \\(K, N\\)"), (lambda X: np.ones((len(X), 5)), "must begin with the state"), ("rbf_dd", "no dictionary named"),
    (tk.RBF([[0.0, 0.0]], 0.0), "range"), (tk.RBF([[0.0, 0.0]], 1.0, kernel="box"), "kernel is 'box'"), (tk.Poly(9), "range"),
    (tk.Products([(0, 3)]), "range"), (tk.Poly(8) + tk.Poly(8), "dimension"), (17, "dictionary is 17"), (tk.Angles([-1]), "indices from 0 on"),
])  # fmt: skip
def test_bad_dictionaries_are_refused(drive, dictionary, message):
    with pytest.raises((ValueError, TypeError, tk.UserError), match=message):
        tk.RLS(dictionary, 2).fit(*drive)


# ---- predictions and control -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", DICTIONARIES)
def test_predictions_and_rollouts_are_those_of_theta(drive, name):
    x, u = drive
    model = tk.RLS(DICTIONARIES[name], 2, precision="f64").fit(x, u)
    psi = model.lift(x)
    A, B = model.theta[:, : psi.shape[1]], model.theta[:, psi.shape[1] :]
    np.testing.assert_allclose(model.predict(x[:-1], u), (psi[:-1] @ A.T + u @ B.T)[:, :3], atol=1e-11)
    state, states = psi[7], [psi[7]]
    for k in range(7, 27):
        state = A @ state + B @ u[k]
        states.append(state)
    np.testing.assert_allclose(model.rollout(x[7], u[7:27]), np.array(states)[:, :3], atol=1e-10)
    left = ((x[1:] - model.predict(x[:-1], u)) ** 2).sum(0) / ((x[1:] - x[1:].mean(0)) ** 2).sum(0)
    assert model.score(x, u) == pytest.approx(np.mean(1 - left), abs=1e-12)


@pytest.mark.parametrize("method, rates", [("newton", None), ("gradient", None), ("newton", [0.5, 0.2])])
def test_mpc_plans_what_a_general_solver_plans(drive, method, rates):
    x, u = drive
    model = tk.RLS("poly_ddr", 2, regulator="none", precision="f64", lam=1.0).fit(x, u)
    H, Q, R, low, high = 8, np.array([5.0, 5.0, 1.0]), np.array([0.1, 0.2]), np.array([-0.3, -1.0]), np.array([0.8, 1.0])
    mpc = tk.MPC(H, Q, R, low, high, S=rates, method=method)
    goal, before = x[50] + (0.5, -0.2, 0.3), np.array([0.1, 0.0])

    def cost(flat):
        plan = flat.reshape(H, 2)
        states = model.rollout(x[50], plan)[1:]
        change = np.diff(np.vstack([before, plan]), axis=0)
        return ((states - goal) ** 2 @ Q).sum() + (plan**2 @ R).sum() + (0 if rates is None else (change**2 @ rates).sum())

    found = optimize.minimize(
        cost, np.zeros(2 * H), method="L-BFGS-B", bounds=list(zip(low, high)) * H, options={"ftol": 1e-15, "gtol": 1e-10}
    )
    first = mpc.solve(model, x[50], goal, before)
    assert mpc.status_ == 0 and cost(mpc.plan_.ravel()) <= found.fun * (1 + 1e-6)
    np.testing.assert_allclose(first, found.x[:2], atol=2e-3)
    made, mpc.u_max = mpc._made[1], np.array([0.05, 0.05])
    assert (mpc.solve(model, x[50], goal, before) <= 0.05).all() and mpc._made[1] is made  # warm
    other = copy.deepcopy(mpc)
    np.testing.assert_allclose(other.solve(model, x[50], goal, before), mpc.solve(model, x[50], goal, before), atol=1e-6)


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("gate", [None, True])
def test_guard_plans_offline_while_the_learned_model_is_wrong_and_online_after(drive, precision, gate):
    x, u = drive
    offline = tk.RLS("poly_ddr", 2, regulator="none", lam=1.0, precision="f64").fit(x, u).theta
    model = tk.RLS("poly_ddr", 2, precision=precision, gate=gate).begin(3)
    model.theta = -offline
    guard = tk.Guard(model, tk.MPC(10, [20, 20, 3], [0.05, 0.08], [0, -1.2], [1.2, 1.2]), offline)
    used, state = [], x[0]
    for k in range(250):
        v = guard.solve(state, state + [0.3, 0.1, 0.0])
        after = tk.simulate(np.array([v]), DT, x0=state)[-1]
        guard.update(state, v, after)
        used.append(guard.model_)
        state = after
    assert used[0] == "offline" and "online" in used and guard.mpc.status_ == 0 and guard.resets_ >= 0


def test_guard_plans_what_the_controller_plans_on_a_good_model(drive):
    x, u = drive
    model = tk.RLS("poly_ddr", 2, regulator="none", lam=1.0, precision="f64").fit(x, u)
    mpc = tk.MPC(10, [20, 20, 3], [0.05, 0.08], [0, -1.2], [1.2, 1.2])
    guard = tk.Guard(model, mpc, model.theta)
    first = guard.solve(x[9], x[9] + [0.3, 0.1, 0.0])
    assert guard.model_ in ("online", "offline")
    np.testing.assert_allclose(first, mpc.solve(model, x[9], x[9] + [0.3, 0.1, 0.0]), atol=1e-9)
    with pytest.raises(ValueError, match="offline model of shape"):
        tk.Guard(model, mpc, model.theta[:, :-1])


def test_guard_refuses_a_model_that_was_fitted_again(drive):
    x, u = drive
    model = tk.RLS("poly_ddr", 2, regulator="none", lam=1.0, precision="f64").fit(x, u)
    guard = tk.Guard(model, tk.MPC(10, [20, 20, 3], [0.05, 0.08], [0, -1.2], [1.2, 1.2]), model.theta)
    model.fit(x, u)
    for call in (lambda: guard.solve(x[0], x[0]), lambda: guard.update(x[0], u[0], x[1])):
        with pytest.raises(ValueError, match="make another Guard for it"):
            call()


def test_parameters_that_change_after_a_fit_do_not_reach_its_export(drive, tmp_path):
    model = tk.RLS(tk.Poly(2), 2, precision="f32").fit(*drive)
    model.export(tmp_path / "before.h")
    model.set_params(precision="f64", dictionary=tk.Poly(3)).export(tmp_path / "after.h")
    assert (tmp_path / "before.h").read_text() == (tmp_path / "after.h").read_text()


# ---- the model, in files and in firmware ---------------------------------------------------------------------


@pytest.mark.parametrize("name", DICTIONARIES)
@pytest.mark.parametrize("ending", [".h", ".bin"])
def test_what_is_exported_is_loaded(drive, name, ending, tmp_path):
    x, u = drive
    model = tk.RLS(DICTIONARIES[name], 2).fit(x, u)
    model.export(tmp_path / f"m{ending}", covariance=True)
    other = tk.RLS(DICTIONARIES[name], 2).load(tmp_path / f"m{ending}", 3)
    np.testing.assert_array_equal(other.theta, model.theta)
    np.testing.assert_array_equal(other.P, model.P)
    with pytest.raises(tk.UserError, match="another size, precision or dictionary"):
        tk.RLS(tk.Poly(2), 2).load(tmp_path / f"m{ending}", 3)


FIRMWARE = r"""
#include <stdio.h>
#include "tinykoop.h"
#include "model.h"
#define KOOP(name) KOOP_##name
static REAL storage[4000];
int main(void) {
	PREFIX(dictionary) dictionary;
	if (koop_model_dictionary(&dictionary) != KOOP_OK) { return 1; }
	const PREFIX(config) config = {.dictionary = &dictionary, .n_inputs = 2, .regulator = &PREFIX(reg_dz_cs),
		.form = &PREFIX(form_sqrt), .lambda = (REAL)0.98, .p0 = 100};
	PREFIX(rls) rls;
	if (PREFIX(rls_init)(&rls, &config, storage, sizeof storage / sizeof *storage) != KOOP_OK) { return 2; }
	if (PREFIX(model_load)(&rls, koop_model, sizeof koop_model) != KOOP_OK) { return 3; }
	double read[5];
	while (scanf("%lf %lf %lf %lf %lf", read, read + 1, read + 2, read + 3, read + 4) == 5) {
		REAL x[3], u[2], psi[KOOP_MAX_DIM], next[KOOP_MAX_DIM];
		for (int i = 0; i < 3; i++) { x[i] = (REAL)read[i]; }
		for (int i = 0; i < 2; i++) { u[i] = (REAL)read[3 + i]; }
		if (PREFIX(lift)(&dictionary, x, psi) != KOOP_OK) { return 4; }
		if (PREFIX(rls_predict)(&rls, psi, u, next) != KOOP_OK) { return 5; }
		printf("%a %a %a\n", (double)next[0], (double)next[1], (double)next[2]);
	}
	return 0;
}
"""


@pytest.mark.parametrize("precision", ["f32", "f64"])
@pytest.mark.parametrize("name", ["parts", "polynomials"])
def test_firmware_predicts_the_same_bits(drive, name, precision, tmp_path, firmware):
    x, u = drive
    model = tk.RLS(DICTIONARIES[name], 2, precision=precision).fit(x, u)
    model.export(tmp_path / "model.h")
    (tmp_path / "main.c").write_text(FIRMWARE)
    koop, real = ("koopf", "float") if precision == "f32" else ("koopd", "double")
    subprocess.run(
        ["gcc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", f"-DREAL={real}", f"-DPREFIX(name)={koop}_##name", f"-I{tmp_path}",
         f"-I{ROOT / 'lib/include'}", f"-I{ROOT / 'lib/src'}", tmp_path / "main.c", firmware(koop), "-lm", "-o", tmp_path / "main"],
        check=True,
    )  # fmt: skip
    rows = "\n".join(" ".join(float(v).hex() for v in (*a, *b)) for a, b in zip(x[:50], u[:50]))
    said = subprocess.run([tmp_path / "main"], input=rows, text=True, capture_output=True, check=True).stdout
    flown = np.array([[float.fromhex(v) for v in line.split()] for line in said.splitlines()])
    np.testing.assert_array_equal(flown, model.predict(x[:50], u[:50]))


def test_names_of_dictionaries_differ_with_their_settings():
    some = [
        tk.Poly(2),
        tk.Poly(3),
        tk.RBF(grid(), 1.5),
        tk.RBF(grid(), 1.6),
        tk.RBF(grid() + 1e-9, 1.5),
        tk.RBF(grid(), 1.5, kernel="multiquadric"),
    ]
    some += [tk.Angles([2]), tk.Angles([2], wrapped=True), tk.Angles([1]), tk.Products([(0, 1)]), tk.Products([(0, 2)])]
    assert len({one.name(3) for one in some}) == len(some)
    assert tk.Poly(np.int64(2), low=np.int64(2)).name(3) == tk.Poly(2).name(3)
    assert (tk.Poly(2) + tk.Angles([2])).name(3) == (tk.Poly(2) + tk.Angles([2])).name(3)


OWN = """
import numpy as np
from tinykoop import RBF, Angles

parts = RBF([[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]], 1.5) + Angles([2])

def lifted(X):
    return np.column_stack([X, np.sin(X[:, 2]), np.cos(X[:, 2])])

number = 17
"""


@pytest.fixture(scope="module")
def own(drive, tmp_path_factory):
    """Folder with a log and a Python file that defines dictionaries."""
    folder, (x, u) = tmp_path_factory.mktemp("own"), drive
    (folder / "own.py").write_text(OWN)
    bridge.write_log(folder / "log.csv", x, np.vstack([u, u[-1:]]), DT)
    return folder


@pytest.mark.parametrize("name", ["parts", "lifted"])
def test_fit_takes_a_dictionary_of_a_file(own, name):
    fit.run(own / "log.csv", own / "model.h", f"{own / 'own.py'}:{name}")
    given = dictionaries.from_file(f"{own / 'own.py'}:{name}")
    loaded = tk.RLS(given, 2, regulator="none").load(own / "model.h", 3)
    log = bridge.read_log(own / "log.csv")
    assert loaded.score(log.x, log.u) > 0.99
    assert ("koop_model_dictionary(" in (own / "model.h").read_text()) == (name == "parts")


@pytest.mark.parametrize("name", ["parts", "lifted"])
def test_replay_takes_a_dictionary_of_a_file(own, name):
    rows = [row for row in replay.run_log(own / "log.csv", own / "out", dictionary=f"{own / 'own.py'}:{name}") if "regulator" in row]
    assert {row["regulator"] for row in rows} == {"offline", *scenario.REGULATORS} and all(row["method"].find(name) >= 0 for row in rows)
    assert np.isfinite([row["mean_error"] for row in rows if row["precision"] == "f64"]).all()
    assert all(row["delta"] > 0 for row in rows if row["delta"] is not None) and (own / "out" / "replay_log.png").exists()


@pytest.mark.parametrize("text, message", [
    ("own.txt:parts", "FILE.py:NAME"), ("own.py", "FILE.py:NAME"), ("none.py:parts", "No such file"), ("own.py:absent", "defines no 'absent'"),
    ("own.py:number", "dictionary is 17"), ("broken.py:parts", "failed with ZeroDivisionError"),
])  # fmt: skip
def test_file_without_the_dictionary_is_refused_in_one_line(own, text, message):
    (own / "broken.py").write_text("1 / 0")
    with pytest.raises(tk.UserError, match=message) as error:
        dictionaries.from_file(str(own / text))
    assert "\n" not in str(error.value)


# ---- copies, and scikit-learn's conventions ---------------------------------------------------------------------


@pytest.mark.parametrize("name", ["built in", "parts", "polynomials"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_copies_go_on_learning_alike(drive, name, copied):
    x, u = drive
    for form in ("plain", "sqrt"):
        model = tk.RLS(DICTIONARIES[name], 2, form=form, regulator="sift", precision="f64").fit(x[:200], u[:200])
        other = copied(model)
        for one in (model, other):
            one.partial_fit(x[200:], u[200:])
        np.testing.assert_array_equal(other.theta, model.theta)


def test_parameters_are_read_and_set():
    model = tk.RLS("poly_ddr", 2)
    assert model.get_params()["regulator"] == "dz_cs" and model.set_params(lam=0.9).lam == 0.9 and "lam=0.9" in repr(model)
    with pytest.raises(ValueError, match="no parameter 'lambda'"):
        model.set_params(**{"lambda": 0.9})
    for call in (model.predict, model.lift):
        with pytest.raises(ValueError, match="has learned nothing yet"):
            call(np.zeros((1, 3)))


@pytest.mark.filterwarnings("ignore")
def test_scikit_learn_checks_find_nothing_but_the_name_of_an_argument():
    checks = pytest.importorskip("sklearn.utils.estimator_checks")
    found = checks.check_estimator(tk.RLS(tk.Poly(2), 1, regulator="ef"), on_skip=None, on_fail=None)
    failed = {one["check_name"] for one in found if one["status"] == "failed"}
    assert failed == {"check_fit_score_takes_y", "check_n_features_in_after_fitting"}  # both call the second argument y, not U
    assert sum(one["status"] == "passed" for one in found) > 30


def test_import_loads_nothing_until_a_name_is_used():
    code = "import sys, tinykoop; assert 'numpy' not in sys.modules; tinykoop.RLS; assert 'numpy' in sys.modules; assert 'RLS' in dir(tinykoop)"
    subprocess.run([__import__("sys").executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="no attribute 'rls'"):
        tk.rls  # noqa: B018


def test_diagnose_returns_the_report(drive, tmp_path):
    x, u = drive
    measured = x + np.random.default_rng(1).normal(size=x.shape) * 0.003
    bridge.write_log(tmp_path / "log.csv", measured, np.vstack([1.1 * u, u[-1:]])[: len(x)], DT)
    report = tk.diagnose(tmp_path / "log.csv", robot="ddr")
    assert (
        report["verdict"] in ("known", "partly", "unknown")
        and report["log_file"].endswith("log.csv")
        and not (tmp_path / "report.json").exists()
    )


def test_every_public_name_is_there():
    assert all(getattr(tk, name) is not None for name in tk.__all__)
    assert dictionaries.KERNELS and {"RLS", "MPC", "Gate", "Health", "RBF", "Poly"} <= set(tk.__all__)
