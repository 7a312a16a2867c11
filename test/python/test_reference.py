"""lib/ and host_sim/ against reference.py: another author's reading of the paper, in many decimals.

Tolerances are those that the project promises; the agreement found is noted beside them.
"""

import numpy as np
import pytest
import reference
from tinykoop import bridge
from tinykoop.plumbing.errors import UserError

K = 500
CELLS = [(d, r) for d in reference.DICTIONARIES for r in reference.REGULATORS]

paper_effects = [
    bridge.Effect("pacejka_slip", (10, 1.6, 0.11, 0.3, 0.45), 50, 100),
    bridge.Effect("pacejka_slip", (10, 1.6, 0.11, 0.3, 0.45), 150, 200),
    bridge.Effect("stribeck_friction", (0.40, 0.12, 0.08, 1.0), 100, 200),
]


def relative(a, b):
    return np.linalg.norm(a - b) / np.linalg.norm(b)


# ---- plant -----------------------------------------------------------------------------------


def test_plant_is_the_papers_over_all_five_phases():
    """Euler steps, Pacejka and Stribeck by C and by NumPy, 250 s; found 9e-16."""
    u = reference.commands()
    ours = bridge.simulate(u, reference.DT, active=paper_effects)
    theirs = reference.drive(u, *reference.phases())
    assert np.max(np.abs(ours - theirs)) < 1e-12
    assert ours[-1, :2] == pytest.approx([320.3, 3.5], abs=0.1)  # as the prototype of test_bands.py


def test_plant_without_effects_is_nominal():
    u, nothing = reference.commands(), np.zeros(reference.STEPS, bool)
    x0 = (1.0, -2.0, 0.7)
    ours = bridge.simulate(u, 0.02, x0)
    assert np.max(np.abs(ours - reference.drive(u, nothing, nothing, x0, 0.02))) < 1e-12


def test_plant_turns_and_backs_up_as_the_formulas_say():
    """Random commands of either sign, where sign(omega), |v omega| and |mu| matter."""
    u = np.random.default_rng(0).normal(0, 1.5, (2000, 2))
    u[::7, 1] = 0.0
    always = np.ones(len(u), bool)
    names = ("pacejka_slip", "stribeck_friction")
    ours = bridge.simulate(u, 0.05, active=[bridge.usual_effect(n) for n in names])
    assert np.max(np.abs(ours - reference.drive(u, always, always))) < 1e-12


@pytest.mark.parametrize("name", bridge.effects())
def test_effect_with_all_zero_parameters_changes_no_bit(name):
    u = np.random.default_rng(1).normal(0, 1, (500, 2))
    zero = bridge.Effect(name, (0.0,) * len(bridge.effects()[name][1]))
    assert np.array_equal(bridge.simulate(u, 0.05, active=[zero]), bridge.simulate(u, 0.05))


def test_order_of_effects_given_by_the_caller_does_not_matter():
    u = reference.commands(1500)
    active = [bridge.usual_effect(name) for name in bridge.effects()]
    expected = bridge.simulate(u, 0.05, active=active)
    shuffle = np.random.default_rng(2).permutation
    for _ in range(5):
        mixed = [active[i] for i in shuffle(len(active))]
        assert np.array_equal(bridge.simulate(u, 0.05, active=mixed), expected)


@pytest.mark.parametrize("name", ["pacejka_slip", "stribeck_friction"])
@pytest.mark.parametrize("dt", [0.05, 0.01, 0.03])
def test_effect_acts_on_t0_up_to_but_not_at_t1(name, dt):
    """For every pair of grid times, and between them, exactly the steps with t0 <= k dt < t1 are changed."""
    u = reference.commands(40)
    nothing = np.zeros(len(u), bool)
    edges = [(a, b) for a in range(0, 40, 3) for b in range(a, 41, 3)]
    for first, last in edges:
        acting = nothing.copy()
        acting[first:last] = True
        which = (acting, nothing) if name == "pacejka_slip" else (nothing, acting)
        expected = reference.drive(u, *which, dt=dt)
        # as products, as decimals (which differ in the last bit), and between two samples
        decimals = (round(first * dt, 2), round(last * dt, 2))
        early = (first * dt - 0.4 * dt, last * dt - 0.4 * dt)
        for t0, t1 in ((first * dt, last * dt), decimals, early):
            effect = bridge.usual_effect(name, t0, t1)
            assert np.max(np.abs(bridge.simulate(u, dt, active=[effect]) - expected)) < 1e-13


@pytest.mark.parametrize("name", bridge.effects())
def test_effect_changes_nothing_before_t0(name):
    u = np.random.default_rng(3).uniform(-3, 3, (200, 2))
    late = bridge.usual_effect(name, 5.0, 7.5)
    ours, nominal = bridge.simulate(u, 0.05, active=[late]), bridge.simulate(u, 0.05)
    assert np.array_equal(ours[:100], nominal[:100])
    assert not np.array_equal(ours, nominal)


def test_plant_refuses_what_it_cannot_simulate():
    u = np.zeros((5, 2))
    with pytest.raises(UserError, match="warp_drive"):
        bridge.simulate(u, 0.05, active=[bridge.Effect("warp_drive", ())])
    for dt in (0.0, -1.0, float("nan")):
        with pytest.raises(UserError, match="dt"):
            bridge.simulate(u, dt)
    u[3] = np.inf
    with pytest.raises(UserError, match="diverged"):
        bridge.simulate(u, 0.05)


# ---- dictionaries ------------------------------------------------------------------------------


@pytest.mark.parametrize("dictionary", reference.DICTIONARIES)
def test_dictionary(dictionary):
    """Found: poly bit for bit, rbf 2e-16 (another exp); float32 within its round-off."""
    x = np.random.default_rng(4).uniform(-6, 6, (500, 3))
    x[:, 2] = np.clip(x[:, 2], -3, 3)
    expected = reference.lift(dictionary, x)
    scale = np.maximum(np.abs(expected), 1)
    for precision, tolerance in ((64, 1e-15), (32, 2e-6)):
        ours = bridge.Estimator(dictionary, "ef", precision).lift(x)
        assert np.max(np.abs(ours - expected) / scale) < tolerance


# ---- recursions --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def states():
    return bridge.simulate(reference.commands(K), reference.DT)


@pytest.fixture(scope="module")
def exact(states):
    """{(dictionary, regulator): (Theta, P, predicted states)} after 500 samples, computed when asked for."""
    known = {}

    def get(dictionary, regulator):
        if (dictionary, regulator) not in known:
            psi = reference.lift(dictionary, states)
            known[dictionary, regulator] = reference.learn(psi, reference.commands(K), regulator)
        return known[dictionary, regulator]

    return get


def agreement(estimator, states, reference_run):
    """Largest pointwise relative prediction error, and norm-wise errors of Theta and P."""
    theta, P, predicted = reference_run
    traces = estimator.replay(states, reference.commands(len(states) - 1))
    assert not traces["status"].any()
    predicted = predicted[1:, : estimator.n]  # the first is zero for everyone: Theta starts as zero
    assert not traces["predicted"][0].any()
    off = np.linalg.norm(traces["predicted"][1:] - predicted, axis=1) / np.linalg.norm(predicted, axis=1)
    return off.max(), relative(estimator.theta, theta), relative(estimator.covariance, P)


@pytest.mark.parametrize("form", ["plain", "sqrt"])
@pytest.mark.parametrize("dictionary, regulator", CELLS)
def test_float64_recursion_is_the_papers(dictionary, regulator, form, states, exact):
    """Every regulator and dictionary, vanilla RBF too: in 500 steps its chaos has not set in.

    Found: predictions 5e-15 (vanilla RBF 2e-14), Theta 3e-11, P 5e-13.
    """
    ours = bridge.Estimator(dictionary, regulator, 64, form=form)
    off, theta, P = agreement(ours, states, exact(dictionary, regulator))
    assert off < (1e-9 if dictionary == "rbf_ddr" else 1e-6)
    assert theta < 1e-6
    assert P < 1e-6


@pytest.mark.parametrize("form", ["plain", "sqrt"])
@pytest.mark.parametrize("dictionary, regulator", CELLS)
def test_float32_predicts_as_the_paper(dictionary, regulator, form, states, exact):
    """Found: 1.3e-5 for vanilla RBF in the plain form, 2e-6 and less elsewhere."""
    off, _, _ = agreement(bridge.Estimator(dictionary, regulator, 32, form=form), states, exact(dictionary, regulator))
    assert off < 1e-3


OTHER_SETTINGS = [
    ("ef", {"lam": 0.9, "p0": 3.0}),
    ("none", {"lam": 0.9, "p0": 3.0}),
    ("dz_cs", {"delta": 0.1, "lam": 0.95}),
    ("dz_ks", {"delta": 0.1, "lam": 0.95}),
    ("ct", {"tau0": 50.0, "p0": 7.0}),
    ("sift", {"eps_sift": 6.0, "lam": 0.9}),
]


@pytest.mark.parametrize("form", ["plain", "sqrt"])
@pytest.mark.parametrize("regulator, settings", OTHER_SETTINGS)
def test_settings_reach_the_recursion(regulator, settings, form, states):
    """lambda, P0, delta, tau0 and eps each away from its usual value; SIFt drops the first samples."""
    u = reference.commands(K)[:100]
    run = reference.learn(reference.lift("poly_ddr", states[:101]), u, regulator, **settings)
    usual = reference.learn(reference.lift("poly_ddr", states[:101]), u, regulator)
    assert regulator == "none" or relative(run[0], usual[0]) > 1e-4
    ours = bridge.Estimator("poly_ddr", regulator, 64, form=form, **settings)
    ours.replay(states[:101], u)
    assert relative(ours.theta, run[0]) < 1e-6
    assert relative(ours.covariance, run[1]) < 1e-6


# ---- replay ------------------------------------------------------------------------------------


def test_replay_skips_what_is_not_usable(states):
    """Transitions on masked rows, which may hold NaN, are neither learned from nor scored.

    The judge is the same estimator fed with the lifted rows of the usable transitions only.
    """
    x, u = states[:201].copy(), reference.commands(200)
    masked = np.zeros(201, bool)
    masked[[0, 50, 51, 52, 120, 200]] = True
    x[masked] = np.nan
    usable = ~(masked[:-1] | masked[1:])
    ours = bridge.Estimator("rbf_ddr", "ct", 64)
    traces = ours.replay(x, u, usable)

    psi = reference.lift("rbf_ddr", states[:201])
    pairs = bridge.Estimator("rbf_ddr", "ct", 64)
    pairs.soak(np.concatenate([psi[:-1], u], axis=1)[usable], psi[1:][usable], 1)
    assert relative(ours.theta, pairs.theta) < 1e-9
    assert np.array_equal(np.isfinite(traces["error"]), usable)
    assert np.array_equal(np.isfinite(traces["predicted"][:, 0]), usable)
    assert np.array_equal(traces["status"] == 0, usable)


@pytest.mark.parametrize("form", ["plain", "sqrt"])
@pytest.mark.parametrize("precision, tolerance", [(64, 1e-12), (32, 1e-5)])
def test_traces_are_what_they_say(states, form, precision, tolerance):
    """Norms, trace, least diagonal, innovation and error, each from the recorded Theta and P."""
    x, u = states[:101], reference.commands(100)
    estimator = bridge.Estimator("poly_ddr", "ef", precision, form=form)
    traces = estimator.replay(x, u, every=1)
    theta = np.concatenate([traces["theta"], estimator.theta[None]])
    P = np.concatenate([traces["covariance"], estimator.covariance[None]])
    psi = estimator.lift(x)
    zeta = np.concatenate([psi[:-1], u], axis=1)
    missed = psi[1:] - np.einsum("kij,kj->ki", theta[:-1], zeta)
    diagonal = np.diagonal(P[1:], axis1=1, axis2=2)
    expected = {
        "norm_a": np.linalg.norm(theta[1:, :, :7], axis=(1, 2)),
        "norm_b": np.linalg.norm(theta[1:, :, 7:], axis=(1, 2)),
        "norm_p": np.linalg.norm(P[1:], axis=(1, 2)),
        "trace": diagonal.sum(axis=1),
        "min_diagonal": diagonal.min(axis=1),
    }
    for name, value in expected.items():
        assert np.max(np.abs(traces[name] / value - 1)) < tolerance, name
    assert np.max(np.abs(traces["innovation"] - np.linalg.norm(missed, axis=1))) < 100 * tolerance
    assert np.max(np.abs(traces["error"] - np.linalg.norm(missed[:, :3], axis=1))) < 100 * tolerance
    assert np.all(np.linalg.eigvalsh(P)[:, 0] > 0) and traces["positive_definite"].all()


@pytest.mark.parametrize("p0", [1e-200, 1e200])
def test_norm_whose_squares_leave_the_range(p0):
    estimator = bridge.Estimator("poly_ddr", "none", 64, p0=p0)
    trace = estimator.replay(np.zeros((2, 3)), np.zeros((1, 2)), learn=False, traces=("norm_p", "norm_a", "error"))
    np.testing.assert_allclose(trace["norm_p"], 3 * p0, rtol=1e-14)  # of p0 I, nine regressors
    assert trace["norm_a"] == 0 and trace["error"] == 0
