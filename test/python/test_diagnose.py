"""The gap diagnoser: its statistics computed another way, what its answer must not depend on, and known answers."""

import functools
import json

import numpy as np
import pytest
from scipy import linalg, stats
from tinykoop import bridge
from tinykoop.diagnose import diagnose, elsewhere, measure, noise, phases, verdict, words
from tinykoop.diagnose.features import Generic
from tinykoop.diagnose.fit import Cause, Fitter
from tinykoop.diagnose.noise import estimate, third_differences
from tinykoop.diagnose.pieces import Noise, Pieces
from tinykoop.diagnose.platform import Ddr
from tinykoop.diagnose.search import Search

DT, START = 0.05, (0.3, -0.2, 2.0)
SP, ST = 0.004, 0.004  # m, rad
VOCABULARY = [name for name in bridge.effects() if name != "measurement_noise"]
ARC = Ddr.integrators[0]
SHORT, LONG = 600, 1200  # rows


# ---- logs ----------------------------------------------------------------------------------------


def drive(rows=SHORT, seed=0):
    """Commands of either sign, held or ramped for half a second to two, every fourth stretch slow."""
    rng, parts = np.random.default_rng(seed), []
    while sum(map(len, parts)) < rows:
        begin, end = rng.uniform((-0.8, -1.2), (2.2, 1.2), (2, 2))
        shape = rng.integers(4)
        begin = 0.15 * begin if shape == 0 else begin
        parts.append(np.linspace(begin, end if shape == 1 else begin, rng.integers(10, 45)))
    return np.concatenate(parts)[:rows]


def noise_of(kind, shape, seed):
    """Of unit variance, outliers apart."""
    rng = np.random.default_rng(1000 + seed)
    e = rng.standard_normal(shape)
    if kind == "coloured":
        for k in range(1, len(e)):
            e[k] = 0.8 * e[k - 1] + 0.6 * e[k]
    elif kind == "heavy":
        e = rng.standard_t(3, shape) / np.sqrt(3)
        bad = rng.choice(len(e), len(e) // 100, replace=False)
        e[bad] += 30 * rng.standard_normal((len(bad), 3))
    return e


def as_log(x, u, usable=None, dt=DT):
    return bridge.Log(np.arange(len(x)) * dt, x, u, np.ones(len(x) - 1, bool) if usable is None else usable, dt)


def log_of(u, active=(), kind="white", seed=0, integrator=bridge.ARC, size=1.0):
    """What a robot with these effects measures."""
    x = bridge.simulate(u[:-1], DT, START, list(active), integrator)
    return as_log(x + size * noise_of(kind, x.shape, seed) * (SP, SP, ST), u)


def usual(*names):
    return [bridge.usual_effect(name) for name in names]


@functools.lru_cache(None)
def single(name, rows=SHORT, seed=0):
    """The diagnosis of a log with one effect, and of a fresh log."""
    return diagnose(log_of(drive(rows, seed), usual(name)), fresh=log_of(drive(rows, seed + 50), usual(name), seed=9))


def effects_of(report):
    return {effect["name"]: effect for effect in report["effects"]}


def said(report, name):
    """Whether an effect is named, first or as one that may be it."""
    return name in effects_of(report) or any(name in others for others in report["ambiguous_with"].values())


def surest(report):
    return max((effect["confidence"] for effect in report["effects"]), default=0.0)


def recorded(report):
    """The effects of a report as the simulator takes them."""
    found = []
    for effect in report["effects"]:
        for t0, t1 in effect["segments"]:
            whole = [t0, t1] == [0.0, report["log"]["seconds"]]
            found.append(bridge.Effect(effect["name"], tuple(effect["params"].values()), t0, np.inf if whole else t1))
    return found


# ---- statistics ----------------------------------------------------------------------------------


def patched(log):
    """The log with a tenth of its rows masked and two gaps."""
    usable = np.random.default_rng(3).uniform(size=len(log.usable)) > 0.01
    usable[200:240] = usable[400] = False
    return as_log(log.x, log.u, usable)


@pytest.mark.parametrize("rho, kind", [(0.0, "white"), (0.8, "coloured")])
@pytest.mark.parametrize("change", [lambda log: log, patched], ids=["whole", "patched"])
def test_what_is_left_at_the_truth_is_white_and_of_unit_variance(rho, kind, change):
    total = free = 0
    ahead = []
    for seed in range(4):
        truth = usual("speed_gain", "actuator_lag")
        pieces = Pieces(Ddr(), change(log_of(drive(LONG, seed), truth, kind, seed)), ARC)
        pieces.set_noise(Noise(SP, ST, rho, rho))
        white = pieces.whiten(pieces.residual(truth))
        total, free = total + (white**2).sum(), free + pieces.degrees
        white = white.reshape(len(white), -1, 3)
        ahead.append((white[:, 1:] * white[:, :-1]).sum() / (white**2).sum())
    assert abs(total / free - 1) < 4 * np.sqrt(2 / free)
    assert abs(np.mean(ahead)) < 0.08  # a fitted start takes a little off


def test_likelihood_of_the_noise_is_the_restricted_one():
    """Against that of the whole covariance matrix (Patterson and Thompson 1971), in pieces of different lengths."""
    rng = np.random.default_rng(5)
    lengths, c = (9, 6, 8), 2
    inside = np.arange(max(lengths)) < np.array(lengths)[:, None]
    r, free, columns = (rng.normal(size=(*shape, len(lengths), max(lengths), c)) * inside[..., None] for shape in ((), (2,), (3,)))
    every = [*columns, *(f * (np.arange(3) == s)[:, None, None] for f in free for s in range(3))]
    X = np.stack([column[inside].ravel() for column in every], 1)
    at = noise._restricted(r, np.moveaxis(free, 0, -1), columns, inside)

    def dense(rho):
        V = linalg.block_diag(*(np.kron(rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))), np.eye(c)) for n in lengths))
        inverse, y = np.linalg.inv(V), r[inside].ravel()
        gram = X.T @ inverse @ X
        left = y - X @ np.linalg.solve(gram, X.T @ inverse @ y)
        degrees = len(y) - X.shape[1]
        variance = left @ inverse @ left / degrees
        return degrees * np.log(variance) + np.linalg.slogdet(V)[1] + np.linalg.slogdet(gram)[1], variance

    none, ours = dense(0.0), at(0.0)
    for rho in (-0.5, 0.3, 0.9):
        np.testing.assert_allclose(at(rho)[0] - ours[0], dense(rho)[0] - none[0], rtol=1e-9)
        np.testing.assert_allclose(at(rho)[1], dense(rho)[1], rtol=1e-9)


def test_noise_of_a_short_coloured_log():
    found = []
    for seed in range(6):
        n = settled(log_of(drive(SHORT, seed), (), "coloured", seed)).noise
        found.append((n.sp / SP, n.st / ST))
    assert np.all(np.abs(np.mean(found, axis=0) - 1) < 0.1), found


@pytest.mark.parametrize("active", [(), ("wheel_asymmetry", "pacejka_slip")], ids=["healthy", "with a gap"])
@pytest.mark.parametrize("rho, kind", [(0.0, "white"), (0.8, "coloured")])
@pytest.mark.parametrize("change", [lambda log: log, patched], ids=["whole", "patched"])
def test_noise_is_told_without_the_cause(active, rho, kind, change):
    """Standard deviations within 8 % (white) or 15 % (rho 0.8), rho within 0.08; mean of two logs."""
    found = []
    for seed in range(2):
        log = change(log_of(drive(LONG, seed), usual(*active), kind, seed))
        pieces = Pieces(Ddr(), log, ARC)
        pieces.set_noise(third_differences(log))
        estimate(pieces)
        n = pieces.noise
        found.append((n.sp / SP, n.st / ST, n.rho_p, n.rho_t))
    sp, st, rho_p, rho_t = np.mean(found, axis=0)
    assert abs(sp - 1) < (0.15 if rho else 0.08) and abs(st - 1) < (0.15 if rho else 0.08), found
    assert abs(rho_p - rho) < 0.08 and abs(rho_t - rho) < 0.08, found


def settled(log, active=()):
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(third_differences(log))
    estimate(pieces, active, weigh=False)
    return pieces


def p_values(kind, rows, told=None, logs=20):
    """Of healthy logs, with the noise that is `told`, or else estimated."""
    found = []
    for seed in range(100, 100 + logs):
        pieces = settled(log_of(drive(rows, seed), (), kind, seed))
        if told:
            pieces.set_noise(told)
        found.append(Generic(pieces).significance())
    return np.array(found)


@pytest.mark.parametrize("rho, kind", [(0.0, "white"), (0.8, "coloured")])
def test_nothing_is_significant_where_the_noise_is_known(rho, kind):
    p = p_values(kind, SHORT, Noise(SP, ST, rho, rho))
    assert p.min() > 1e-5 and stats.kstest(p, "uniform", alternative="greater").pvalue > 1e-3, p


@pytest.mark.parametrize("kind, rows", [("white", SHORT), ("coloured", SHORT)])
def test_nothing_is_significant_where_the_noise_is_estimated(kind, rows):
    p = p_values(kind, rows)
    assert p.min() > 1e-5 and stats.kstest(p, "uniform", alternative="greater").pvalue > 1e-3, p


@pytest.mark.parametrize("name", ["speed_gain", "yaw_bias", "lateral_skid", "actuator_lag"])
@pytest.mark.parametrize("H", [10, 40])
def test_generic_model_measures_the_gap(name, H):
    """Against the difference of two simulations without noise, from the same poses."""
    u, truth = drive(LONG, 1), usual(name)
    pieces = settled(log_of(u, truth))
    clean = bridge.simulate(u[:-1], DT, START, truth, bridge.ARC)
    _, off = bridge.windows(clean, u, DT, pieces.starts, [H], (), integrator=bridge.ARC)
    expected = np.sqrt((off[..., :2] ** 2).sum(-1).mean())
    assert Generic(pieces).gap(H) == pytest.approx(expected, rel=0.1)


def test_generic_model_measures_nothing_on_healthy_logs():
    gaps = [Generic(settled(log_of(drive(SHORT, s), seed=s))).gap(40) for s in range(6)]
    assert max(gaps) < SP


def test_errors_of_a_start_change_nothing():
    """A wrong start moves the residual by many standard deviations, what is left after whitening hardly at all."""
    log = log_of(drive(), usual("speed_gain"))
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST, 0.5, 0.5))
    before = pieces.residual(usual("speed_gain"))
    white = pieces.whiten(before)
    pieces.begin_at(pieces.start_pose + np.random.default_rng(0).normal(0, (0.02, 0.02, 0.005), pieces.start_pose.shape))
    after = pieces.residual(usual("speed_gain"))
    assert np.sqrt(np.mean(np.square((after - before) / (SP, SP, ST))[pieces.inside])) > 1
    assert np.sqrt(np.mean((pieces.whiten(after) - white) ** 2)) < 0.02


def test_residual_is_the_simulators():
    """Every piece by itself, from its start, through bridge.simulate."""
    u, active = drive(), usual("speed_gain", "pacejka_slip", "world_drift", "sensor_lever_arm")
    pieces = Pieces(Ddr(), log_of(u, usual("yaw_gain")), ARC)
    r = pieces.residual(active)
    for start, n, pose, ours in zip(pieces.starts, pieces.lengths, pieces.start_pose, r):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        arm = active[3].parameters
        base = pose - (c * arm[0] - s * arm[1], s * arm[0] + c * arm[1], 0)
        off = pieces.log.x[start : start + n] - bridge.simulate(u[start : start + n - 1], DT, base, active, bridge.ARC)
        expected = np.stack([c * off[:, 0] + s * off[:, 1], c * off[:, 1] - s * off[:, 0], off[:, 2]], axis=1)
        assert np.allclose(ours[1:n], expected[1:], atol=1e-9) and not ours[n:].any()


# ---- what the answer must not depend on ----------------------------------------------------------

MIXED = ("wheel_asymmetry", "world_drift")


@functools.lru_cache(None)
def mixed():
    return diagnose(log_of(drive(), usual(*MIXED))).report


def variant(change):
    log = log_of(drive(), usual(*MIXED))
    x, u = log.x.copy(), log.u.copy()
    change(x, u)
    return diagnose(as_log(x, u)).report


def same_answer(report, expected, params=None):
    """Verdict, names, parameters within a tenth of their intervals, gaps within 1 %."""
    assert report["verdict"] == expected["verdict"] == "known"
    assert [e["name"] for e in report["effects"]] == [e["name"] for e in expected["effects"]]
    assert report["ambiguous_with"] == expected["ambiguous_with"]
    for ours, theirs in zip(report["effects"], expected["effects"]):
        for name, value in (params or (lambda effect: effect["params"]))(theirs).items():
            low, high = theirs["params_ci95"][name]
            assert abs(ours["params"][name] - value) < 0.1 * (high - low), (name, ours["params"], value)
    for key in ("before", "after", "noise_floor"):
        for H in ("1", "10", "50"):
            assert report["gap"][key][H] == pytest.approx(expected["gap"][key][H], rel=0.01)


def test_mixed_log_is_understood():
    assert set(effects_of(mixed())) == set(MIXED)


def test_place_and_direction_do_not_matter():
    turn = 1.1

    def move(x, u):
        x[:, :2] = x[:, :2] @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + (800.0, -300.0)
        x[:, 2] += turn

    def expected(effect):
        if effect["name"] != "world_drift":
            return effect["params"]
        wind = complex(*effect["params"].values()) * np.exp(1j * turn)
        return {"wx": wind.real, "wy": wind.imag}

    same_answer(variant(move), mixed(), expected)


def test_left_and_right_do_not_matter():
    def mirror(x, u):
        x[:, 1:] *= -1
        u[:, 1] *= -1

    flipped = {"c": -1, "wy": -1}
    same_answer(variant(mirror), mixed(), lambda e: {k: v * flipped.get(k, 1) for k, v in e["params"].items()})


def test_wrapping_the_heading_does_not_matter():
    def wrap(x, u):
        x[:, 2] = np.mod(x[:, 2] + np.pi, 2 * np.pi) - np.pi

    same_answer(variant(wrap), mixed())


def test_seed_does_not_matter():
    same_answer(diagnose(log_of(drive(), usual(*MIXED)), seed=1).report, mixed())


def test_same_log_same_bytes():
    again = diagnose(log_of(drive(), usual(*MIXED))).report
    assert json.dumps(again) == json.dumps(mixed())


def test_masked_poses_do_not_matter():
    """Whatever stands in rows that are masked, the answer is the same."""
    reports = []
    for absurd in (0.0, 1e6):
        log = log_of(drive(), usual(*MIXED))
        bad = np.random.default_rng(1).uniform(size=len(log.x)) < 0.01
        log.x[bad] = absurd
        reports.append(diagnose(as_log(log.x, log.u, ~(bad[1:] | bad[:-1]))).report)
    same_answer(*reports)


# ---- answers -------------------------------------------------------------------------------------


def path_error(name, params, u):
    """How far the fitted effect's path is from the true one, as a share of how far the effect moves it."""
    true, fitted, nominal = (
        bridge.windows(bridge.simulate(u, DT, START, usual(name), bridge.ARC), u, DT, range(50, len(u) - 50, 5), [50], a, integrator=bridge.ARC)[0]
        for a in (usual(name), [bridge.Effect(name, tuple(params.values()))], [])
    )  # fmt: skip
    return np.sqrt(np.mean((fitted - true)[..., :2] ** 2) / np.mean((nominal - true)[..., :2] ** 2))


@pytest.mark.parametrize("name", VOCABULARY)
def test_single_effect(name):
    report = single(name).report
    assert report["verdict"] == "known" and list(effects_of(report)) == [name] and report["ranking"][0]["name"] == name
    effect = report["effects"][0]
    assert effect["segments"] == [[0.0, report["log"]["seconds"]]] and effect["confidence"] > 0.9
    assert path_error(name, effect["params"], drive(SHORT)) < 0.05
    if len(effect["params"]) <= 2:  # of curves with more, the path is the judge
        for value, true, commanded in zip(
            effect["params"].values(), bridge.usual_effect(name).parameters, np.abs(drive(SHORT)).T
        ):
            if name == "dead_band":  # between commanded levels it may lie anywhere
                assert np.sum((commanded > min(value, true)) & (commanded < max(value, true))) <= 2
            else:
                assert value == pytest.approx(true, rel=0.05), effect


def test_intervals_hold_the_truth_mostly():
    inside = []
    for name in VOCABULARY:
        effect = effects_of(single(name).report)[name]
        for (low, high), true in zip(effect["params_ci95"].values(), bridge.usual_effect(name).parameters):
            assert low <= high
            inside.append(low <= true <= high)
    assert np.mean(inside) > 0.8, inside


@pytest.mark.parametrize(
    "names", [("actuator_lag", "wheel_asymmetry"), ("dead_band", "lateral_skid"), ("speed_gain", "transport_delay")]
)
def test_pair(names):
    report = diagnose(log_of(drive(SHORT, 3), usual(*names))).report
    assert report["verdict"] == "known" and set(effects_of(report)) == set(names)


def test_lag_beside_delay_may_be_of_second_order():
    """The best-known approximation of slow actuators is no proof of either."""
    report = diagnose(log_of(drive(SHORT, 4), usual("actuator_lag", "transport_delay"))).report
    assert set(effects_of(report)) == {"actuator_lag", "transport_delay"}
    assert surest(report) <= 0.8 and "second order" in " ".join(words.cannot_tell(report))


def test_form_of_another_kind_is_not_sure():
    """A speed limit with a soft knee: the hard one explains most of it, but is not it."""
    u = drive(LONG, 7)
    v = u[:, 0] / (1 + np.abs(u[:, 0] / 1.2) ** 12) ** (1 / 12)
    x = bridge.simulate(np.column_stack([v, u[:, 1]])[:-1], DT, START, [], bridge.ARC)
    report = diagnose(as_log(x + noise_of("white", x.shape, 3) * (SP, SP, ST), u)).report
    assert "saturation" in effects_of(report) and report["unexplained"]["share"] < 0.2
    assert report["unexplained"]["p"] < 1e-4 and surest(report) <= 0.8


def test_strong_effect_is_not_traded_for_one_at_its_bounds():
    """A robot that turns half as far as told, sluggishly: slip at its bounds does about the same."""
    u = drive(SHORT, 8)
    log = log_of(u, [bridge.Effect("yaw_gain", (-0.55,)), bridge.Effect("actuator_lag", (0.9,))])
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST))
    search = Search(pieces)
    search.singles()
    fitter = search.fitter
    worse = fitter.refine(
        fitter.fit_of([Cause("actuator_lag", (0.9,)), Cause("pacejka_slip", (30.0, 1.0, 0.9, 1.0, 0.0))])
    )
    assert fitter.held(worse.causes[1])
    assert set(search.swap(search.keep(worse)).names) == {"yaw_gain", "actuator_lag"}


def test_clock_is_said_to_be_both_gains():
    assert set(single("clock_scale").report["ambiguous_with"]["clock_scale"]) >= {"speed_gain", "yaw_gain"}


@pytest.mark.parametrize("kind, rows", [("white", SHORT), ("heavy", SHORT), ("coloured", LONG), ("coloured", SHORT)])
def test_healthy(kind, rows):
    for seed in range(3):
        report = diagnose(log_of(drive(rows, seed), (), kind, seed)).report
        assert report["verdict"] == "none" and not report["effects"], seed


@pytest.mark.parametrize("integrator", [bridge.EULER, bridge.MIDPOINT, bridge.ARC, bridge.SEMI_IMPLICIT])
def test_stepping_is_no_effect(integrator):
    assert diagnose(log_of(drive(), integrator=integrator)).report["verdict"] == "none"
    report = diagnose(log_of(drive(seed=2), usual("speed_gain"), integrator=integrator)).report
    assert list(effects_of(report)) == ["speed_gain"]


def test_gap_too_small_to_matter():
    report = diagnose(log_of(drive(LONG), [bridge.Effect("heading_bias", (0.0015,))])).report
    assert report["verdict"] == "none" and not report["effects"]


def test_noise_that_doubles_is_no_effect():
    u = drive(LONG)
    x = bridge.simulate(u[:-1], DT, START, integrator=bridge.ARC)
    x += noise_of("white", x.shape, 0) * SP * np.where(np.arange(len(x)) < len(x) // 2, 1, 2)[:, None]
    assert diagnose(as_log(x, u)).report["verdict"] == "none"


# ---- what the log cannot tell --------------------------------------------------------------------


STEADY = ["speed_gain", "yaw_gain", "yaw_bias", "lateral_skid", "heading_bias", "stribeck_friction",
          "sensor_lever_arm", "pacejka_slip"]  # fmt: skip


@pytest.mark.parametrize("name", STEADY)
def test_steady_drive_is_no_proof(name):
    """One command throughout: whatever it is, others would look the same."""
    report = diagnose(log_of(np.tile([1.0, 0.4], (400, 1)), usual(name))).report
    assert said(report, name)
    assert any(report["ambiguous_with"].values()) or surest(report) < 0.9, report["effects"]


@pytest.mark.parametrize("name", ["actuator_lag", "transport_delay", "dead_band", "backlash"])
def test_steady_drive_does_not_test_what_acts_on_changes(name):
    report = diagnose(log_of(np.tile([1.0, 0.4], (400, 1)), usual(name))).report
    assert report["verdict"] == "none" and name in report["not_testable"]


def test_lag_or_delay_on_a_slow_drive():
    """Two paths of 50 rows that no noise lets apart: both are said."""
    t = np.arange(SHORT) * DT
    u = np.stack([1 + 0.3 * np.sin(0.1 * t), 0.3 * np.sin(0.1 * t + 1)], axis=1)
    both = [[bridge.Effect(name, (0.3,))] for name in ("transport_delay", "actuator_lag")]
    log = log_of(u, both[0])
    late, lagging, prompt = (
        bridge.windows(log.x, u, DT, range(50, SHORT - 50, 50), range(1, 50), active, integrator=bridge.ARC)[0]
        for active in (*both, [])
    )  # fmt: skip
    assert (((late - lagging) / (SP, SP, ST)) ** 2).sum() < 6 < (((late - prompt) / (SP, SP, ST)) ** 2).sum() / 100
    report = diagnose(log).report
    assert said(report, "transport_delay") and said(report, "actuator_lag")


@pytest.mark.parametrize("name", ["world_drift", "heading_bias", "transport_delay"])
def test_effect_taken_out_is_unknown(name):
    report = diagnose(log_of(drive(SHORT), usual(name)), without=(name,)).report
    assert report["verdict"] == "unknown" and name not in {row["name"] for row in report["ranking"]}
    assert surest(report) < 0.9


def test_parameter_beyond_its_bound_is_said():
    """A lever arm of 5 m, of which the vocabulary takes 3."""
    log = log_of(drive(400))
    log.x[:, :2] += 5 * np.stack([np.cos(log.x[:, 2]), np.sin(log.x[:, 2])], axis=1)
    report = diagnose(log).report
    arm = effects_of(report).get("sensor_lever_arm")
    assert report["verdict"] == "unknown" or "lx" in arm["at_bound"]


def test_threshold_that_was_not_reached_is_left_open():
    """The yaw rate never comes near its saturation: its interval must not end above the commands."""
    u = drive(LONG) * (1, 0.3)
    report = diagnose(log_of(u, [bridge.Effect("saturation", (1.2, 2.0))])).report
    effect = effects_of(report)["saturation"]
    assert effect["params"]["v_max"] == pytest.approx(1.2, rel=0.02)
    low, high = effect["params_ci95"]["w_max"]
    assert high > 2.0 and high - low > 1.0, effect


# ---- logs as they come -----------------------------------------------------------------------------


def test_spinning_robot_and_wrapped_yaw():
    u = np.column_stack([0.3 + 0 * np.arange(SHORT), np.where(np.arange(SHORT) // 40 % 2, 4.0, 2.5)])
    log = log_of(u, usual("yaw_gain"))
    log.x[:, 2] = np.angle(np.exp(1j * log.x[:, 2]))
    report = diagnose(log).report
    effect = effects_of(report)["yaw_gain"]
    assert report["verdict"] == "known" and effect["params"]["b"] == pytest.approx(-0.12, rel=0.05)


@pytest.mark.parametrize("names", [(), ("yaw_gain",), ("speed_gain",)])
def test_closed_loop(names):
    """Commands that follow from the noisy measured pose."""
    rng, pose = np.random.default_rng(4), np.array(START)
    x, u = [], []
    for k in range(SHORT):
        seen = pose + rng.normal(0, (SP, SP, ST))
        goal = 3 * np.array([np.cos(0.01 * k), np.sin(0.023 * k)])
        off = goal - seen[:2]
        turn = np.angle(np.exp(1j * (np.arctan2(off[1], off[0]) - seen[2])))
        command = np.array([np.clip(1.5 * np.hypot(*off) * np.cos(turn), 0, 2.0), np.clip(2.5 * turn, -1.5, 1.5)])
        x.append(seen)
        u.append(command)
        pose = bridge.simulate(command[None], DT, pose, usual(*names), bridge.ARC)[1]
    report = diagnose(as_log(np.array(x), np.array(u))).report
    assert report["verdict"] == ("known" if names else "none") and tuple(effects_of(report)) == names


def test_commands_stamped_a_row_early_look_like_a_delay_of_a_row():
    u = drive()
    log = log_of(u)
    report = diagnose(as_log(log.x[:-1], u[1:])).report
    assert effects_of(report)["transport_delay"]["params"]["delay"] == pytest.approx(DT, rel=0.05)


def test_commands_stamped_a_row_late_have_no_cause_here():
    """Poses that move before the command: no effect of the vocabulary does that."""
    u = drive(400)
    log = log_of(u)
    report = diagnose(as_log(log.x[1:], u[:-1])).report
    assert report["verdict"] == "unknown" and surest(report) < 0.9


def test_gaps_and_a_robot_that_was_carried():
    u = drive(LONG)
    log = log_of(u, usual("actuator_lag"))
    for row in (300, 700):
        log.x[row:] += (5.0, -3.0, 0.0)
    usable = log.usable.copy()
    usable[[299, 699]] = False
    report = diagnose(as_log(log.x, u, usable)).report
    assert list(effects_of(report)) == ["actuator_lag"]
    assert effects_of(report)["actuator_lag"]["params"]["tau"] == pytest.approx(0.3, rel=0.05)


def outlying(active=()):
    """A hundredth of the rows a hundred times the noise off."""
    log = log_of(drive(), active)
    rng = np.random.default_rng(5)
    bad = rng.choice(len(log.x), len(log.x) // 100, replace=False)
    log.x[bad] += rng.normal(0, (100 * SP, 100 * SP, 100 * ST), (len(bad), 3))
    return diagnose(log).report


def test_outliers():
    assert outlying()["verdict"] == "none"
    report = outlying(usual("yaw_gain"))
    assert list(effects_of(report)) == ["yaw_gain"]
    assert report["effects"][0]["params"]["b"] == pytest.approx(-0.12, rel=0.05)
    assert report["effects"][0]["confidence"] > 0.5


def test_effect_that_switches_on():
    onset = 31.0
    effect = bridge.Effect("yaw_gain", bridge.usual_effect("yaw_gain").parameters, onset)
    report = diagnose(log_of(drive(LONG, 6), [effect])).report
    assert list(effects_of(report)) == ["yaw_gain"]
    ((t0, t1),) = report["effects"][0]["segments"]
    assert abs(t0 - onset) < 1.0 and t1 == pytest.approx(report["log"]["seconds"], abs=1.0)


def test_onset_and_size_make_up_for_one_another():
    """A sag that is taken to begin too late is also taken to be too small; both are found from there."""
    truth = Cause("battery_sag", (0.21,), ((12.0, 50.0),))
    log = log_of(drive(LONG, 6), truth.active())
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST))
    fitter = Fitter(pieces)
    begun_late = fitter.fit_of([Cause("battery_sag", (0.18,), ((17.0, 49.0),))])
    (found,) = phases.settle(fitter, begun_late).causes
    assert found.segments[0] == pytest.approx((12.0, 50.0), abs=2 * DT)
    assert found.params[0] == pytest.approx(0.21, rel=0.02)


def test_edge_seconds_away_is_found():
    """At 50 Hz: an onset six seconds late is three hundred rows off."""
    rng, dt = np.random.default_rng(5), 0.02
    u = np.repeat(rng.uniform((0.2, -1.0), (1.8, 1.0), (50, 2)), 40, axis=0)
    x = bridge.simulate(u[:-1], dt, START, Cause("clock_scale", (-0.06,), ((11.7, 27.5),)).active(), bridge.ARC)
    log = as_log(x + noise_of("white", x.shape, 5) * (SP, SP, ST), u, dt=dt)
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST))
    fitter = Fitter(pieces)
    (found,) = phases.settle(fitter, fitter.fit_of([Cause("clock_scale", (-0.06,), ((18.0, 27.4),))])).causes
    assert found.segments[0] == pytest.approx((11.7, 27.5), abs=0.2)


def test_threshold_that_is_off_wakes_up():
    """A limit of zero means none and has no slope: only a scan finds out that the yaw rate is limited too."""
    truth = Cause("saturation", (1.1, 0.6), ((15.0, 45.0),))
    log = log_of(drive(LONG, 6), truth.active())
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST))
    fitter = Fitter(pieces)
    asleep = fitter.refine(fitter.fit_of([Cause("saturation", (1.1, 0.0), truth.segments)]))
    assert asleep.causes[0].params[1] == 0
    (found,) = fitter.refine(fitter.awake(asleep)).causes
    assert found.params == pytest.approx(truth.params, rel=0.02)


# ---- how much --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["speed_gain", "dead_band", "pacejka_slip"])
def test_fresh_log(name):
    """Nothing is fitted there, and its gap is what bridge.windows gives."""
    report, u = single(name).report, drive(SHORT, 50)
    assert report["effects"] == diagnose(log_of(drive(), usual(name))).report["effects"]
    fresh = log_of(u, usual(name), seed=9)
    gap = report["fresh"]["gap"]
    for key, active in (("before", ()), ("after", recorded(report))):
        _, off = bridge.windows(fresh.x, u, DT, range(50, SHORT - 50), [1, 10, 50], active, integrator=bridge.ARC)
        for H, expected in zip(("1", "10", "50"), np.sqrt((off[..., :2] ** 2).sum(-1).mean(0))):
            assert gap[key][H] == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("acts", [True, False], ids=["still there", "gone"])
def test_effect_of_a_part_acts_on_a_fresh_log_all_along_or_not_at_all(acts):
    """The fresh log is shorter than the log was when the effect set in."""
    late = bridge.Effect("yaw_gain", bridge.usual_effect("yaw_gain").parameters, 31.0)
    there = usual("yaw_gain") if acts else []
    fresh = log_of(drive(500, 7), there, seed=3)
    report = diagnose(log_of(drive(LONG, 6), [late]), fresh=fresh).report
    (effect,) = report["fresh"]["effects"]
    assert (effect["name"], effect["acts"], effect["params"]) == ("yaw_gain", acts, report["effects"][0]["params"])
    found = [bridge.Effect("yaw_gain", tuple(effect["params"].values()))] if acts else []
    _, off = bridge.windows(fresh.x, fresh.u, DT, range(450), [50], found, integrator=bridge.ARC)
    assert report["fresh"]["gap"]["after"]["50"] == pytest.approx(np.sqrt((off[..., :2] ** 2).sum(-1).mean()), rel=0.03)
    assert report["fresh"]["gap"]["after"]["50"] < 1.1 * report["fresh"]["gap"]["noise_floor"]["50"]
    said = " ".join(words.asides(report))
    assert f"on the fresh log it is taken {'to act all along' if acts else 'not to act'}" in said


def test_battery_sags_as_fast_on_a_fresh_log_of_another_length():
    loss, rows = 0.2, 500
    fresh = log_of(drive(rows, 7), [bridge.Effect("battery_sag", (loss * (rows - 1) / (LONG - 1),))], seed=3)
    report = diagnose(log_of(drive(LONG, 6), [bridge.Effect("battery_sag", (loss,))]), fresh=fresh).report
    assert effects_of(report)["battery_sag"]["params"]["loss_at_end"] == pytest.approx(loss, rel=0.02)
    assert report["fresh"]["effects"][0]["params"]["loss_at_end"] == pytest.approx(loss * (rows - 1) / (LONG - 1), rel=0.02)
    assert report["fresh"]["gap"]["closed_fraction"]["50"] > 0.9
    assert "taken to grow as fast, to 8.3 % at its end" in " ".join(words.asides(report))


def test_loss_on_a_fresh_log_goes_with_the_time_it_acted_and_stays_in_bounds():
    def carried(segments, own, other, loss=0.1):
        logs = [as_log(np.zeros((rows, 3)), np.zeros((rows, 2)), dt=0.1) for rows in (own, other)]
        ((cause, acts),) = elsewhere.carry([Cause("battery_sag", (loss,), segments)], Ddr().effects(), logs, lambda causes: -len(causes))
        assert acts and cause.segments == ((-np.inf, np.inf),)
        return cause.params[0]

    assert carried(((-np.inf, np.inf),), 201, 201) == 0.1
    assert carried(((-np.inf, np.inf),), 201, 101) == pytest.approx(0.05)
    assert carried(((5.0, 15.0),), 201, 101) == pytest.approx(0.1)
    assert carried(((12.0, np.inf),), 201, 201) == pytest.approx(0.25)
    assert carried(((5.0, 6.0),), 201, 1001) == 0.9


def test_every_effect_of_a_part_is_tried_on_and_off_on_a_fresh_log():
    causes = [Cause("speed_gain", (0.1,), ((1.0, 2.0),)), Cause("yaw_bias", (0.1,)), Cause("yaw_gain", (0.1,), ((3.0, np.inf),))]
    tried, log = [], as_log(np.zeros((100, 3)), np.zeros((100, 2)))

    def cost(some):
        tried.append({c.name for c in some})
        return len({"speed_gain"} ^ tried[-1])

    carried = elsewhere.carry(causes, Ddr().effects(), (log, log), cost)
    assert [acts for _, acts in carried] == [True, True, False]
    assert len(tried) == 4 and all("yaw_bias" in names for names in tried)


@pytest.mark.parametrize("name", VOCABULARY)
def test_claim_is_realised(name):
    """The closed share of the log that was fitted, against that of a fresh log."""
    report = single(name).report
    claimed, realised = (gap["closed_fraction"]["50"] for gap in (report["gap"], report["fresh"]["gap"]))
    assert claimed == pytest.approx(realised, abs=0.05) and realised > 0.9


def test_folds_do_not_jump_over_a_threshold():
    """A command held just above a dead band: a step that ends beyond it would throw that stretch away."""
    u = drive(LONG, 9)
    u[100:400:3, 1] = 0.2001
    log = log_of(u, [bridge.Effect("dead_band", (0.1, 0.2))])
    pieces = Pieces(Ddr(), log, ARC)
    pieces.set_noise(Noise(SP, ST))
    fitter = Fitter(pieces)
    fit = fitter.fit_of([Cause("dead_band", (0.1, 0.2000999))])
    folds, rows = measure.regions(pieces), len(fit.left) // len(pieces.starts)
    for fold, causes in enumerate(measure.held_out(fitter, fit)):
        rest = np.repeat(folds, rows) != fold
        assert np.sum(fitter.left(causes)[rest] ** 2) <= np.sum(fit.left[rest] ** 2) + 1e-9


def test_noise_floor_is_what_the_noise_leaves():
    """Against predictions with the true effect."""
    log = log_of(drive(), usual("speed_gain"))
    _, off = bridge.windows(log.x, log.u, DT, range(50, SHORT - 50), [1, 10, 50], usual("speed_gain"), integrator=bridge.ARC)
    floor = single("speed_gain").report["gap"]["noise_floor"]
    for H, expected in zip(("1", "10", "50"), np.sqrt((off[..., :2] ** 2).sum(-1).mean(0))):
        assert floor[H] == pytest.approx(expected, rel=0.08)


def test_an_effect_at_its_bound_gives_way_to_one_inside():
    """Gravel: slip at the edge of its range, where a yaw gain does the same."""
    search = Search(settled(log_of(drive(SHORT), usual("yaw_gain"))))
    search.price = 10.0

    def fit(name, *params):
        return search.fitter.fit_of((Cause(name, params),))

    def proof(*rivals):
        return [verdict.Evidence(1.0, {}, {}, tuple(r.names[0] for r in rivals), 0.5, search.base, {r.names[0]: r for r in rivals})]

    b_max = search.fitter.effects["pacejka_slip"][1][0].high
    held, plain, plainer = fit("pacejka_slip", b_max, 1.0, 0.5, 0.5, 0.1), fit("yaw_gain", 0.1), fit("yaw_bias", 0.01)
    assert search.fitter.held(held.causes[0]) and not search.fitter.held(plain.causes[0])
    assert verdict.inside(search, held, proof(plain)) is plain
    assert verdict.inside(search, held, proof(plain, plainer)) is min(plain, plainer, key=search.worth)
    assert verdict.inside(search, held, proof()) is held
    assert verdict.inside(search, plain, proof(plainer)) is plain
    assert verdict.inside(search, held, proof(fit("yaw_gain", search.fitter.effects["yaw_gain"][1][0].high))) is held
