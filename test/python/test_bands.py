"""The learning half of the paper's DDR case study, figure by figure: 5000 steps, five phases.

REFERENCE is from one run of an independent float64 NumPy prototype with the same settings, PAPER
from the tables and text of "Covariance-Regulated Recursive Koopman Learning". The bands are as
wide as the figures moved when plant and arithmetic were varied a little, and no wider.
"""

import numpy as np
import pytest
import reference
from tinykoop import bridge

SLIP, FRICTION = (10, 1.6, 0.11, 0.3, 0.45), (0.40, 0.12, 0.08, 1.0)
PHASES = [
    bridge.Effect("pacejka_slip", SLIP, 50, 100),
    bridge.Effect("stribeck_friction", FRICTION, 100, 150),
    bridge.Effect("pacejka_slip", SLIP, 150, 200),
    bridge.Effect("stribeck_friction", FRICTION, 150, 200),
]

# mean error, final norm of P, final norm of A, skipped samples in percent
REFERENCE = {
    ("poly_ddr", "ef"): (1.9561238760680234e-3, 19351.24353544368, 53.89052945157459, 0.0),
    ("poly_ddr", "dz_cs"): (1.9503462552224696e-3, 19420.753350516552, 53.88774760218052, 3.46),
    ("poly_ddr", "dz_ks"): (1.9818546209805455e-3, 19420.753350389678, 53.91728225437671, 3.14),
    ("poly_ddr", "ct"): (4.570273079020862e-3, 899.6093416261792, 596.3118951560076, 0.0),
    ("poly_ddr", "sift"): (4.209846821294131e-3, 64.81576782161547, 79.2504978070699, 0.0),
    ("rbf_ddr", "dz_cs"): (1.1672298153291418e-3, 4773.699046089662, 2.9353272309075025, 97.42),
    ("rbf_ddr", "dz_ks"): (4.953757187739965e-3, 36366.920023728555, 2.9918542145167955, 95.38),
    ("rbf_ddr", "ct"): (5.6552022133564035e-3, 663.536720520733, 2.974296656188471, 0.0),
    ("rbf_ddr", "sift"): (4.181638501474983e-3, 348.0018460302284, 2.918262691019111, 0.0),
}
PAPER = {
    ("poly_ddr", "ef"): (1.96e-3, 1.94e4, 53.2, 0.0),
    ("poly_ddr", "dz_cs"): (1.95e-3, 1.95e4, 53.1, 3.24),
    ("poly_ddr", "dz_ks"): (1.98e-3, 1.94e4, 52.9, 3.02),
    ("poly_ddr", "ct"): (4.47e-3, 900.0, 637.0, 0.0),
    ("poly_ddr", "sift"): (4.24e-3, 64.5, 88.7, 0.0),
    ("rbf_ddr", "dz_cs"): (1.08e-3, 3.47e3, 2.93, 97.74),
    ("rbf_ddr", "dz_ks"): (4.64e-3, 2.39e4, 2.97, 95.8),
    ("rbf_ddr", "ct"): (5.57e-3, 664.0, 2.98, 0.0),
    ("rbf_ddr", "sift"): (4.19e-3, 348.0, 2.92, 0.0),
}

# allowed ratio - 1 of error, norm P, norm A, and percentage points of the skip rate
TO_REFERENCE = dict.fromkeys(REFERENCE, (0.001, 0.001, 0.001, 0.0)) | {
    ("poly_ddr", "dz_cs"): (0.005, 0.02, 0.02, 0.4),
    ("poly_ddr", "dz_ks"): (0.005, 0.02, 0.02, 0.4),
    ("rbf_ddr", "dz_cs"): (0.03, 0.10, 0.03, 0.1),
    ("rbf_ddr", "dz_ks"): (0.03, 0.40, 0.03, 0.3),
}
TO_PAPER = dict.fromkeys(PAPER, (0.05, 0.05, 0.05, 0.0)) | {
    ("poly_ddr", "ct"): (0.05, 0.05, 0.15, 0.0),
    ("poly_ddr", "sift"): (0.05, 0.05, 0.15, 0.0),
    ("poly_ddr", "dz_cs"): (0.03, 0.05, 0.05, 0.5),
    ("poly_ddr", "dz_ks"): (0.03, 0.05, 0.05, 0.5),
    ("rbf_ddr", "dz_cs"): (0.15, 1.0, 0.02, 0.5),  # norm P within a factor of two
    ("rbf_ddr", "dz_ks"): (0.15, 1.0, 0.03, 0.7),
}

# mean error of the state after 1 and 50 steps
ROLLOUT_REFERENCE = {
    ("poly_ddr", "ef"): (1.8554836872247142e-3, 0.3103656244414699),
    ("poly_ddr", "dz_cs"): (1.8369317109013699e-3, 0.2993561202937425),
    ("poly_ddr", "dz_ks"): (1.8627116531702791e-3, 0.30501905446811683),
    ("poly_ddr", "ct"): (4.5414739866049495e-3, 0.21701632217052838),
    ("poly_ddr", "sift"): (4.086686937951551e-3, 0.18171334371844625),
    ("rbf_ddr", "dz_cs"): (1.033309059320618e-3, 0.4119870347826432),
    ("rbf_ddr", "dz_ks"): (5.043246696657481e-3, 0.20860352241376076),
    ("rbf_ddr", "ct"): (5.579276814048535e-3, 0.2370749723098918),
    ("rbf_ddr", "sift"): (4.0487382163081264e-3, 0.1705107790796865),
}
ROLLOUT_PAPER = {  # after 50 steps
    ("rbf_ddr", "dz_cs"): 0.321,
    ("rbf_ddr", "sift"): 0.171,
    ("poly_ddr", "sift"): 0.180,
    ("poly_ddr", "ef"): 0.320,
}


def within(actual, expected, band):
    """Whether actual / expected lies in [1 / (1 + band), 1 + band]."""
    return 1 / (1 + band) <= actual / expected <= 1 + band


@pytest.fixture(scope="session")
def drive():
    """Measured states and commands of the 250 s run, and the nominal states under the same commands."""
    u = reference.commands()
    return bridge.simulate(u, reference.DT, active=PHASES), u, bridge.simulate(u, reference.DT)


@pytest.fixture(scope="session")
def run(drive):
    """run(dictionary, regulator, precision, **settings): figures and traces; each is computed once."""
    known = {}

    def get(dictionary, regulator, precision=64, **settings):
        key = (dictionary, regulator, precision, *settings.items())
        if key not in known:
            x, u, _ = drive
            estimator = bridge.Estimator(dictionary, regulator, precision, **settings)
            traces = estimator.replay(x, u, every=25)
            figures = (
                np.nanmean(traces["error"]), traces["norm_p"][-1], traces["norm_a"][-1],
                100 * traces["frozen"].mean(),
            )  # fmt: skip
            known[key] = figures, traces, estimator
        return known[key]

    return get


def check_row(figures, expected, bands):
    for name, actual, figure, band in zip(("error", "norm P", "norm A"), figures, expected, bands):
        assert within(actual, figure, band), f"{name}: {actual:.6g}, expected {figure:.6g}"
    assert abs(figures[3] - expected[3]) <= bands[3], f"skipped {figures[3]:.2f} %, expected {expected[3]} %"


# ---- Table "Learning Performance of a DDR under Unmodeled Dynamics" -------------------------------


@pytest.mark.parametrize("cell", REFERENCE)
def test_table_against_reference(run, cell):
    """Found: the reference to 1e-11 in every figure."""
    figures, traces, _ = run(*cell)
    check_row(figures, REFERENCE[cell], TO_REFERENCE[cell])
    assert not traces["status"].any()
    assert traces["positive_definite"].all()


@pytest.mark.parametrize("cell", PAPER)
def test_table_against_paper(run, cell):
    check_row(run(*cell)[0], PAPER[cell], TO_PAPER[cell])


def test_vanilla_rbf_winds_up(run):
    """Its error and norm A are round-off chaos, in the paper too; the growth of P is not."""
    figures, traces, _ = run("rbf_ddr", "ef")
    assert within(figures[1], 2.5050340060478524e46, 0.001)
    assert within(figures[1], 2.51e46, 0.01)
    assert figures[2] > 30
    assert not traces["positive_definite"][:2000].all()


def test_offline_rbf(drive):
    """A fit to the nominal run alone (P0 = 1e8 is the ridge of 1e-8), then never updated."""
    x, u, nominal = drive
    estimator = bridge.Estimator("rbf_ddr", "none", 64, p0=1e8)
    estimator.replay(nominal, u)
    theta = estimator.theta
    error = estimator.replay(x, u, learn=False)["error"].mean()
    norm_a = np.linalg.norm(theta[:, :22])
    assert np.array_equal(estimator.theta, theta)
    assert within(error, 0.01282031515515647, 0.001) and within(error, 1.30e-2, 0.03)
    assert within(norm_a, 76.18664476727352, 0.01) and within(norm_a, 76.2, 0.01)


def test_orderings(run):
    error = {cell: run(*cell)[0][0] for cell in REFERENCE}
    assert error["rbf_ddr", "dz_cs"] < 0.3 * error["rbf_ddr", "dz_ks"]
    plain = [error["poly_ddr", regulator] for regulator in ("ef", "dz_cs", "dz_ks")]
    assert max(plain) < 1.03 * min(plain)
    assert max(plain) < error["poly_ddr", "sift"] < error["poly_ddr", "ct"]


# ---- threshold of the dead zone --------------------------------------------------------------------


@pytest.mark.parametrize(
    "delta, reference_row, paper_row, to_reference, to_paper, points",
    [
        (0.01, (1.1672298153291418e-3, 97.42), (1.07e-3, 97.73), 0.03, 0.10, 0.5),
        (0.03, (5.600439693082958e-3, 99.50), (5.58e-3, 99.50), 0.03, 0.10, 0.5),
        # P reaches 1e18 here, so round-off has a say: the reproduction's skip rate itself is 6.6
        # points from the paper's, and its band is on the error alone (a factor of 2)
        (0.003, (2.6995862534694146e-3, 63.26), (1.52e-3, None), 1.0, 1.0, 5.0),
    ],
)
def test_threshold_sweep(run, delta, reference_row, paper_row, to_reference, to_paper, points):
    (error, _, _, skipped), _, _ = run("rbf_ddr", "dz_cs", delta=delta)
    assert within(error, reference_row[0], to_reference) and within(error, paper_row[0], to_paper)
    assert abs(skipped - reference_row[1]) <= points
    assert paper_row[1] is None or abs(skipped - paper_row[1]) <= points


# ---- rollouts --------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def rollout(drive, run):
    """rollout(cell): mean state error after 1 and 50 steps of the lifted model frozen at k = 200, 225, ..

    The lifted state is propagated, not lifted anew; the last window is the last that ends before the log.
    """

    def get(cell):
        x, u, _ = drive
        _, traces, estimator = run(*cell)
        k = np.arange(200, len(u) - 50, 25)
        theta, psi = traces["theta"][k // 25], estimator.lift(x[k])
        error = {}
        for step in range(1, 51):
            psi = np.einsum("kij,kj->ki", theta, np.concatenate([psi, u[k + step - 1]], axis=1))
            error[step] = np.linalg.norm(psi[:, :3] - x[k + step], axis=1).mean()
        return error[1], error[50]

    return get


@pytest.mark.parametrize("cell", ROLLOUT_REFERENCE)
def test_rollout_against_reference(rollout, cell):
    """Found: the reference to 1e-6."""
    band = 0.01 if cell[1] in ("sift", "ct") else 0.10
    for actual, expected in zip(rollout(cell), ROLLOUT_REFERENCE[cell]):
        assert within(actual, expected, band)


@pytest.mark.parametrize("cell", ROLLOUT_PAPER)
def test_rollout_against_paper(rollout, cell):
    assert within(rollout(cell)[1], ROLLOUT_PAPER[cell], 0.05 if cell[1] == "sift" else 0.40)


def test_rollout_reverses_the_ranking(rollout):
    """The paper's point: the best at one step is the worst of the regulated RBF methods at fifty."""
    error = {regulator: rollout(("rbf_ddr", regulator)) for regulator in ("dz_cs", "dz_ks", "ct", "sift")}
    assert min(error, key=lambda r: error[r][0]) == "dz_cs" == max(error, key=lambda r: error[r][1])
    assert min(error, key=lambda r: error[r][1]) == "sift"


# ---- float32 ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["plain", "sqrt"])
@pytest.mark.parametrize("cell", REFERENCE)
def test_float32_learns_as_well(run, cell, form):
    """Found: RBF CT 2.3 %, RBF DZ-CS 2.0 %, the others 0.2 % and less."""
    single, traces, _ = run(*cell, 32, form=form)
    assert within(single[0], run(*cell)[0][0], 0.05 if cell == ("rbf_ddr", "ct") else 0.03)
    assert not traces["status"].any()
    assert traces["positive_definite"].all()


def test_float32_vanilla_rbf_breaks_when_the_reference_does(run):
    """P loses definiteness, then leaves float's range; what is refused leaves Theta and P as they were."""
    _, traces, estimator = run("rbf_ddr", "ef", 32)
    lost = np.flatnonzero(traces["positive_definite"] == 0)
    refused = np.flatnonzero(traces["status"])
    assert 400 <= lost[0] <= 600
    assert 2500 <= refused[0] <= 4200
    assert set(traces["status"][refused]) == {-6}  # KOOP_E_OVERFLOW
    assert np.isfinite(estimator.theta).all() and np.isfinite(estimator.covariance).all()
    assert np.isfinite(traces["error"]).all()


def test_square_root_form_survives_vanilla_rbf(run):
    """Where the plain form breaks, this one gives what 400-bit arithmetic gives: error 2.17e-3, norm P 2.393e46.

    Found: 2.20e-3 in float64; norm P to all digits.
    """
    figures, traces, _ = run("rbf_ddr", "ef", form="sqrt")
    assert within(figures[0], 2.17e-3, 0.15)
    assert within(figures[1], 2.393e46, 0.001)
    assert not traces["status"].any()


def test_square_root_form_survives_vanilla_rbf_in_float32(drive):
    """Here the error is one of round-off: from 2.2e-3 to 5e-3, by last digits of the states. So the median of nine.

    Found: 2.6e-3 (2.5e-3 with glibc's sine and exponential); norm P to all digits.
    """
    x, u, _ = drive
    errors = []
    for seed in range(9):
        estimator = bridge.Estimator("rbf_ddr", "ef", 32, form="sqrt")
        traces = estimator.replay(x + 1e-7 * np.random.default_rng(seed).standard_normal(x.shape), u, every=25)
        assert within(traces["norm_p"][-1], 2.393e46, 0.001)
        assert not traces["status"].any()
        errors.append(np.nanmean(traces["error"]))
    assert within(np.median(errors), 2.17e-3, 0.3), errors
