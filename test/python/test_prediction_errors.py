"""The engine of the diagnoser: its filter against dense covariance matrices, noise that is known, edges, thresholds."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg, stats
from test_diagnose import DT, SP, ST, START, as_log, drive, log_of, noise_of, usual
from tinykoop import bridge
from tinykoop.bridge.whitening import Deviances, Filter
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.prediction_errors import ahead, judge, noise, simpler, spans, weighed
from tinykoop.diagnose.prediction_errors.fit import SPREAD, Cause, Fit, Fitter
from tinykoop.diagnose.prediction_errors.noise import Noise
from tinykoop.diagnose.prediction_errors.profiles import Profile
from tinykoop.diagnose.prediction_errors.search import Search

SHORT, LONG = 600, 1200  # rows: effects here come and go, the last of them after 50 s

WHITE = Noise(np.array([SP, SP, ST]), np.zeros(3), np.full(3, 1e-4), np.full(3, 0.85))


def fitter_of(log, told=WHITE):
    return Fitter(ddr.Path(log), told)


def patched(log):
    """The log with a hundredth of its transitions masked and two gaps."""
    usable = np.random.default_rng(3).uniform(size=len(log.usable)) > 0.01
    usable[200:240] = usable[400] = False
    return as_log(log.x, log.u, usable)


# ---- the filter ----------------------------------------------------------------------------------


class Small:
    """A filter of random numbers: two runs of rows, a channel that is missing now and then."""

    def __init__(self, tint, n=3, r=2, c=2, rows=(7, 5), drive=False):
        rng = np.random.default_rng(8)
        K = sum(rows)
        self.rows, self.shape = rows, (n, r, c)
        self.begins = np.zeros(K, np.int32)
        self.begins[[0, rows[0]]] = 1
        self.A = np.eye(n) + 0.3 * rng.normal(size=(K, n, n))
        self.G, self.C = rng.normal(size=(K, n, r)), rng.normal(size=(c, n))
        self.variance = rng.uniform(0.5, 2, (K, c))
        self.variance[[2, 3, 8], [0, 1, 1]] = np.inf
        self.start, self.push, self.keeps = rng.uniform(0.5, 2, n), rng.uniform(0.2, 1, r), rng.uniform(0.1, 0.9, r)
        self.tint, self.tint_rho = tint * rng.uniform(0.5, 1, c), rng.uniform(0.1, 0.9, c)
        self.D, self.E = rng.normal(size=(K, n, 15)), rng.normal(size=(K, c, 15))
        if drive:  # as small as it is: each channel is a state
            self.C, self.A = np.eye(n), np.eye(n) + 0.03 * rng.normal(size=(K, n, n))

    def arguments(self):
        return (
            self.begins,
            self.A,
            self.G,
            self.variance,
            self.start,
            self.C,
            self.push,
            self.keeps,
            self.tint,
            self.tint_rho,
        )

    def dense(self):
        """[(what is seen of all columns, their covariance)] of each run: from what makes each of them, row by row."""
        n, r, c = self.shape
        for first, last in ((0, self.rows[0]), (self.rows[0], sum(self.rows))):
            count = n + (r + 2 * c) * (last - first)
            part = lambda at, size: np.eye(count)[at : at + size]  # noqa: E731
            state, mean = self.start[:, None] * part(0, n), np.zeros((n, self.D.shape[2]))
            slip, tint, seen, made, at = np.zeros((r, count)), np.zeros((c, count)), [], [], n
            for k in range(first, last):
                fresh = [part(at, r), part(at + r, c), part(at + r + c, c)]
                at += r + 2 * c
                old = 0.0 if k == first else 1.0
                slip = old * self.keeps[:, None] * slip + np.sqrt(1 - old * self.keeps**2)[:, None] * fresh[0]
                own = np.sqrt(1 - old * self.tint_rho**2) * self.tint
                tint = old * self.tint_rho[:, None] * tint + own[:, None] * fresh[1]
                for i in np.flatnonzero(np.isfinite(self.variance[k])):
                    made.append(self.C[i] @ state + tint[i] + np.sqrt(self.variance[k, i]) * fresh[2][i])
                    seen.append(self.E[k, i] - self.C[i] @ mean)
                state = self.A[k] @ state + self.G[k] @ (self.push[:, None] * slip)
                mean = self.A[k] @ mean + self.D[k]
            yield np.array(seen), np.array(made) @ np.array(made).T


DRIVE = {"r": 3, "c": 3, "rows": (70, 5), "drive": True}  # more rows than all columns go along at once
BOTH = pytest.mark.parametrize("shape", [{}, DRIVE], ids=["any", "drive"])


@BOTH
@pytest.mark.parametrize("tint", [0.0, 1.0], ids=["white", "coloured"])
def test_filter_whitens_as_the_factor_of_the_whole_covariance_does(tint, shape):
    small = Small(tint, **shape)
    filter = Filter(*small.arguments())
    ours, log_det = filter.whiten(small.D, small.E), filter.log_det
    expected, determinants = [], []
    for seen, covariance in small.dense():
        lower = linalg.cholesky(covariance, lower=True)
        expected.append(linalg.solve_triangular(lower, seen, lower=True))
        determinants.append(2 * np.log(np.diag(lower)).sum())
    np.testing.assert_allclose(ours[np.isfinite(small.variance)], np.concatenate(expected), rtol=1e-8, atol=1e-9)
    assert not ours[~np.isfinite(small.variance)].any() and log_det == pytest.approx(sum(determinants), rel=1e-9)


@pytest.mark.parametrize("tint", [0.0, 1.0], ids=["white", "coloured"])
def test_columns_are_whitened_alike_however_many_there_are(tint):
    """Bit for bit: they go along the path in parts."""
    small = Small(tint, **DRIVE)
    filter = Filter(*small.arguments())
    whole = filter.whiten(small.D, small.E)
    for count in range(1, 15):
        assert np.array_equal(filter.whiten(small.D[..., :count], small.E[..., :count]), whole[..., :count])


@BOTH
@pytest.mark.parametrize("tint", [0.0, 1.0], ids=["white", "coloured"])
def test_likelihoods_of_nine_noises_are_those_of_normal_distributions(tint, shape):
    small = Small(tint, **shape)
    scales, expected = np.linspace(0.5, 2, 9), []
    rows = lambda values: scales[:, None] * values  # noqa: E731
    keeps = [np.tile(k, (len(scales), 1)) for k in (small.keeps, small.tint_rho)]
    white = np.tile(scales[:, None] ** 2, (1, small.shape[2]))
    path = small.begins, small.A, small.G, small.variance, small.start, small.C
    noises = rows(small.push), keeps[0], white, rows(small.tint), keeps[1]
    residual = Deviances(*path, small.D[..., 0], small.E[..., 0])
    ours = residual.under(*noises)
    variance, push, sd = small.variance, small.push, small.tint
    for s in scales:
        small.variance, small.push, small.tint = s**2 * variance, s * push, s * sd
        dense = list(small.dense())
        expected.append(sum(-2 * stats.multivariate_normal(cov=c).logpdf(y[:, 0]) - len(y) * np.log(2 * np.pi) for y, c in dense))
    np.testing.assert_allclose(ours, expected, rtol=1e-9)
    for count in range(1, 9):
        np.testing.assert_allclose(residual.under(*(values[:count] for values in noises)), ours[:count], rtol=1e-13)


def test_filter_of_too_many_states_is_refused():
    small = Small(0.0, n=60)
    with pytest.raises(Exception, match="62 states: at most 48"):
        Filter(*small.arguments())


# ---- the path of the drive -------------------------------------------------------------------------


def test_one_step_is_the_simulators():
    """Every step by itself, from its measured pose, through bridge.simulate."""
    active = usual("speed_gain", "pacejka_slip", "world_drift", "sensor_lever_arm")
    path = ddr.Path(log_of(drive(SHORT), usual("yaw_gain")))
    D = path.steps([tuple(Cause(e.name, e.parameters) for e in active)])[0][..., 0]
    arm = active[3].parameters
    for k in range(60, 300, 7):
        pose = path.measured[k]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        base = pose - (c * arm[0] - s * arm[1], s * arm[0] + c * arm[1], 0)
        off = bridge.simulate(path.u[k : k + 1], DT, base, active, bridge.ARC)[1] - path.measured[k + 1]
        c, s = np.cos(path.measured[k + 1, 2]), np.sin(path.measured[k + 1, 2])
        assert D[k] == pytest.approx([c * off[0] + s * off[1], c * off[1] - s * off[0], off[2]], abs=1e-9)


@pytest.mark.parametrize("rho, kind", [(0.0, "white"), (0.8, "coloured")])
@pytest.mark.parametrize("change", [lambda log: log, patched], ids=["whole", "patched"])
def test_what_is_left_at_the_truth_is_white_and_of_unit_variance(rho, kind, change):
    truth = [Cause(e.name, e.parameters) for e in usual("speed_gain", "actuator_lag")]
    total = count = ahead_of = 0
    for seed in range(4):
        log = change(log_of(drive(LONG, seed), usual("speed_gain", "actuator_lag"), kind, seed))
        fitter = fitter_of(log, Noise(WHITE.sensor, np.full(3, rho), WHITE.process, WHITE.process_rho))
        left = fitter.fit_of(truth).left.reshape(-1, 3)
        free = 3 * int(fitter.path.begins.sum())  # rows that settle where a run begins
        total, count = total + (left**2).sum(), count + np.isfinite(fitter.path.present).sum() - free
        ahead_of += (left[1:] * left[:-1]).sum() / (left**2).sum() / 4
    assert abs(total / count - 1) < 4 * np.sqrt(2 / count) and abs(ahead_of) < 0.05


@pytest.mark.parametrize("kind, rho", [("white", 0.0), ("coloured", 0.8)])
@pytest.mark.parametrize("active", [(), ("wheel_asymmetry",)], ids=["healthy", "with a gap"])
def test_noise_is_told(kind, rho, active):
    """Standard deviations within 8 % (white) or 15 % (rho 0.8), rho within 0.08; mean of three logs."""
    found = []
    for seed in range(3):
        search = Search(ddr.Path(log_of(drive(LONG, seed), usual(*active), kind, seed)))
        causes = [Cause(e.name, e.parameters) for e in usual(*active)]
        n = search.with_coloured_noise(search.likeliest(search.fitter.fit_of(causes))).noise
        found.append([n.sensor[0] / SP, n.sensor[2] / ST, n.sensor_rho[0], n.sensor_rho[2]])
    sp, st, rho_p, rho_t = np.mean(found, axis=0)
    assert max(abs(sp - 1), abs(st - 1)) < (0.15 if rho else 0.08) and max(abs(rho_p - rho), abs(rho_t - rho)) < 0.08, found


@pytest.mark.parametrize("share", [0.01, 0.03, 0.1])
def test_random_motion_is_told_from_the_sensors_noise(share):
    """A robot that slips at random: AR(1) of 0.3 s, along and in yaw. Mean of three logs within 15 %."""
    found = []
    for seed in range(3):
        u, rng = drive(LONG, seed), np.random.default_rng(70 + seed)
        keep, slip = np.exp(-DT / 0.3), np.zeros((LONG, 2))
        for k in range(1, LONG):
            slip[k] = keep * slip[k - 1] + np.sqrt(1 - keep**2) * rng.normal(size=2)
        moved = u + share * np.sqrt(np.mean(u**2, axis=0)) * slip
        x = bridge.simulate(moved[:-1], DT, START, [], bridge.ARC)
        search = Search(ddr.Path(as_log(x + noise_of("white", x.shape, seed) * (SP, SP, ST), u)))
        n = search.likeliest(search.fitter.fit_of(())).noise
        found.append([*(n.process / search.path.usual)[[0, 2]] / share, n.sensor[0] / SP, n.sensor[2] / ST])
    assert np.abs(np.mean(found, axis=0) - 1).max() < 0.15, found


def test_floor_holds_random_motion():
    """RMS errors of perfect predictions of a robot that slips at random, against what the noise says; 30 drives."""
    errors, told = [], None
    for seed in range(30):
        u, rng = drive(SHORT, 3), np.random.default_rng(seed)
        keep, slip = np.exp(-DT / 0.3), rng.normal(size=(SHORT, 2))
        for k in range(1, SHORT):
            slip[k] = keep * slip[k - 1] + np.sqrt(1 - keep**2) * slip[k]
        usual_speed = np.sqrt(np.mean(u**2, axis=0))
        x = bridge.simulate((u + 0.05 * usual_speed * slip)[:-1], DT, START, [], bridge.ARC)
        path = ddr.Path(as_log(x + noise_of("white", x.shape, seed) * (SP, SP, ST), u))
        starts = ahead.starts_of(path)
        process = 0.05 * path.usual * (1, 1e-4, 1)
        told = ahead.floor(path, Noise(WHITE.sensor, np.zeros(3), process, np.full(3, keep)), starts)
        errors.append(ahead.rms(ahead.errors(path, (), starts)["position"]))
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), ahead.rms(told["position"]), rtol=0.1)


# ---- edges and thresholds ----------------------------------------------------------------------------


def test_onset_and_size_make_up_for_one_another():
    """A sag that is taken to begin too late is also taken to be too small; both are found."""
    (found,) = Search(ddr.Path(log_of(drive(LONG, 6), [bridge.Effect("battery_sag", (0.21,), 12.0, 50.0)]))).run().fit.causes
    assert found.segments[0] == pytest.approx((12.0, 50.0), abs=2 * DT)
    assert found.params[0] == pytest.approx(0.21, rel=0.02)


def test_edge_seconds_away_is_found():
    """At 50 Hz: an onset six seconds late is three hundred rows off."""
    rng, dt = np.random.default_rng(5), 0.02
    u = np.repeat(rng.uniform((0.2, -1.0), (1.8, 1.0), (50, 2)), 40, axis=0)
    x = bridge.simulate(u[:-1], dt, START, [bridge.Effect("clock_scale", (-0.06,), 11.7, 27.5)], bridge.ARC)
    fitter = fitter_of(as_log(x + noise_of("white", x.shape, 5) * (SP, SP, ST), u, dt=dt))
    (found,) = spans.edges_settled(fitter, fitter.fit_of([Cause("clock_scale", (-0.06,), ((18.0, 27.4),))])).causes
    assert found.segments[0] == pytest.approx((11.7, 27.5), abs=0.2)


def test_threshold_that_is_off_wakes_up():
    """A limit of zero means none and has no slope: only a scan finds out that the yaw rate is limited too."""
    fitter = fitter_of(log_of(drive(LONG, 6), [bridge.Effect("saturation", (1.1, 0.6), 15.0, 45.0)]))
    asleep = fitter.fit_of([Cause("saturation", (1.1, 0.0), ((15.0, 45.0),))])
    (found,) = fitter.refine(asleep).causes
    assert found.params == pytest.approx((1.1, 0.6), rel=0.02)


def test_stretch_that_takes_most_is_the_one_of_all():
    """Against every stretch tried by itself."""
    rng = np.random.default_rng(4)
    columns, left, edges = rng.normal(size=(50, 9)), rng.normal(size=50), np.arange(10) * 20
    gain, (a, b), scale = spans.best_stretch(columns, left, edges)
    every = {}
    for i in range(9):
        for j in range(i + 1, 10):
            c = columns[:, i:j].sum(1)
            s = np.clip(-(c @ left) / (c @ c), -4, 4)
            every[i, j] = left @ left - ((left + s * c) ** 2).sum()
    assert every[a, b] == pytest.approx(max(every.values())) and gain == pytest.approx(every[a, b])


def test_folds_do_not_jump_over_a_threshold():
    """A command held just above a dead band: a step that ends beyond it would throw that stretch away."""
    u = drive(LONG, 9)
    u[100:400:3, 1] = 0.2001
    fitter = fitter_of(log_of(u, [bridge.Effect("dead_band", (0.1, 0.2))]))
    fit = fitter.fit_of([Cause("dead_band", (0.1, 0.2000999))])
    folds = np.repeat(ahead.folds(fitter.path), 3)
    for fold, causes in enumerate(ahead.held_out(fitter, fit)):
        rest = folds != fold
        assert np.sum(fitter.fit_of(causes).left[rest] ** 2) <= np.sum(fit.left[rest] ** 2) + 1e-9


def test_strong_effect_is_not_traded_for_one_at_its_bounds():
    """A robot that turns half as far as told, sluggishly: slip at its bounds does about the same."""
    log = log_of(drive(SHORT, 8), [bridge.Effect("yaw_gain", (-0.55,)), bridge.Effect("actuator_lag", (0.9,))])
    assert set(Search(ddr.Path(log)).run().fit.names) == {"yaw_gain", "actuator_lag"}


def test_stepping_that_made_up_for_a_cause_goes_with_it():
    """A robot that hardly changes how it turns: steps of another kind set it aside as a skid does, and its size would be a quarter too large."""
    effect, u = usual("lateral_skid")[0], np.tile((0.9, 0.3), (200, 1))
    u[100:, 1] = -0.3
    path = ddr.Path(log_of(u, [effect]), variant=1)
    search = Search(path)
    state = search.likeliest(search.fitter.refine(search.fitter.fit_of([Cause("lateral_skid", effect.parameters)])))
    assert abs(state.causes[0].params[0] / effect.parameters[0] - 1) > 0.1
    better = simpler.stepped(search, state)
    assert better.variant == 0 and better.causes[0].params == pytest.approx(effect.parameters, rel=0.05)


def test_first_noise_is_that_of_the_sensor():
    path = ddr.Path(log_of(drive(LONG, 2), usual("actuator_lag")))
    first = noise.first(path)
    assert first.sensor == pytest.approx([SP, SP, ST], rel=0.1) and not first.sensor_rho.any()


# ---- how sure a size is ------------------------------------------------------------------------------


class Line:
    """A fitter of residuals noise + J (z - truth): what there is to be said of it is known. fit() is where it costs least."""

    block = SPREAD

    def __init__(self, J, noise):
        self.J, self.noise, self.truth = J, noise, np.ones(J.shape[1])
        self.path = SimpleNamespace(present=np.ones((len(J), 1)), doubt=lambda causes: 0.0)

    def vector(self, causes):
        return np.array(causes), None, None, None

    def split(self, causes, z):
        return tuple(z)

    def fit_of(self, causes):
        left = self.noise + self.J @ (np.array(causes) - self.truth)
        return Fit(causes, float(left @ left), left)

    def jacobian(self, fit):
        return self.J

    def fit(self):
        return self.fit_of(tuple(self.truth - np.linalg.lstsq(self.J, self.noise, rcond=None)[0]))


def test_intervals_of_few_blocks_that_differ_hold_the_truth():
    """A log of six blocks, of which each is as loud as chance has it: 95 % hold the truth, within three standard errors."""
    rng, runs = np.random.default_rng(6), 1500
    J, held = rng.normal(size=(6 * SPREAD, 2)) * np.repeat(rng.uniform(0.5, 2, 6), SPREAD)[:, None], 0
    for _ in range(runs):
        common = np.repeat(0.3 * rng.normal(size=(6, 2)), SPREAD, axis=0)
        line = Line(J, rng.normal(size=len(J)) + (J * common).sum(1))
        low, high = judge.intervals(line, line.fit()).T
        held += ((low < line.truth) & (line.truth < high)).sum()
    assert held / runs / 2 > 0.95 - 3 * np.sqrt(0.95 * 0.05 / runs)


def test_intervals_of_a_long_log_are_those_of_least_squares():
    rng = np.random.default_rng(7)
    line = Line(rng.normal(size=(3000, 2)), rng.normal(size=3000))
    half = np.diff(judge.intervals(line, line.fit()))[:, 0] / 2
    np.testing.assert_allclose(half, 1.96 * np.sqrt(np.diag(np.linalg.inv(line.J.T @ line.J))), rtol=0.25)


def test_what_only_a_sum_tells_is_left_open():
    """Two sizes of which the log shows the sum alone: neither is known, though a pseudoinverse says half of it each."""
    rng = np.random.default_rng(8)
    J = rng.normal(size=(600, 2))
    J[:, 1] = J[:, 0]
    line = Line(J, rng.normal(size=600))
    assert (np.diff(judge.intervals(line, line.fit())) > 1e3).all()


def test_limit_of_one_size_allows_for_the_other():
    """Slopes that are alike: where the cost of one rises while the other makes up for it, as a dense covariance has it."""
    rng = np.random.default_rng(9)
    J = rng.normal(size=(800, 2))
    J[:, 1] = 0.95 * J[:, 0] + 0.3 * J[:, 1]
    line = Line(J, rng.normal(size=800))
    fit = line.fit()
    half = 1.96 * np.sqrt(np.linalg.inv(J.T @ J)[0, 0])
    low, high = judge.threshold_interval(line, fit, 0)
    assert low < fit.causes[0] - half and fit.causes[0] + half < high and high - low < 5 * half


# ---- intervals by profiles -------------------------------------------------------------------------


def test_profile_of_what_is_linear_is_the_interval_by_slopes():
    fitter = fitter_of(log_of(drive(SHORT), usual("speed_gain", "yaw_bias")))
    fit = fitter.refine(fitter.fit_of([Cause(e.name, e.parameters) for e in usual("speed_gain", "yaw_bias")]))
    J = fitter.jacobian(fit)
    half = 1.96 * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    for index, z in enumerate(fitter.vector(fit.causes)[0]):
        assert Profile(fitter, fit).interval(index) == pytest.approx((z - half[index], z + half[index]), abs=0.1 * half[index])


def test_profiles_of_a_curve_hold_the_truth():
    """The four sizes of a friction make up for one another: 95 % of 24 would be 23, and by slopes some are too narrow."""
    held = []
    for seed in range(6):
        (true,) = usual("stribeck_friction")
        fitter = fitter_of(log_of(drive(LONG, seed), [true], "white", seed))
        fit = fitter.refine(fitter.fit_of([Cause(true.name, true.parameters)]))
        for i, (interval, value) in enumerate(zip(judge.intervals(fitter, fit), true.parameters)):
            low, high = judge.limits(fitter, fit, 0, i, i, interval)
            held.append(low <= value <= high)
    assert sum(held) >= 21, held


def test_profiles_of_two_thresholds_hold_the_truth():
    """A rim limit and its track width: the track by slopes alone would be certain."""
    held = []
    for seed in range(5):
        u = drive(LONG, seed)
        true = bridge.Effect("wheel_saturation", (float(np.quantile(np.abs(u[:, 0]), 0.7)), 0.55))
        fitter = fitter_of(log_of(u, [true], "white", seed))
        fit = fitter.refine(fitter.fit_of([Cause(true.name, true.parameters)]))
        limits = [judge.limits(fitter, fit, 0, i, i, interval) for i, interval in enumerate(judge.intervals(fitter, fit))]
        held += [low <= value <= high for (low, high), value in zip(limits, true.parameters)]
        assert all(high - low < 0.1 * value for (low, high), value in zip(limits, true.parameters))
    assert sum(held) >= 8, held


# ---- sizes by predictions many steps ahead ------------------------------------------------------------


def slipping_log(active, share, seed=0, rows=LONG):
    """A robot with effects that also slips at random, AR(1) of 0.3 s."""
    u, rng = drive(rows, seed), np.random.default_rng(40 + seed)
    keep, slip = np.exp(-DT / 0.3), np.zeros((rows, 2))
    for k in range(1, rows):
        slip[k] = keep * slip[k - 1] + np.sqrt(1 - keep**2) * rng.normal(size=2)
    moved = u + share * np.sqrt(np.mean(u**2, axis=0)) * slip
    x = bridge.simulate(moved[:-1], DT, START, active, bridge.ARC)
    return as_log(x + noise_of("white", x.shape, seed) * (SP, SP, ST), u)


def weighed_of(log, cause):
    search = Search(ddr.Path(log))
    state = search.settled(search.likeliest(search.fitter.fit_of(())), search.fitter.fit_of([cause]))
    return search, state, ahead.starts_of(search.path)


def test_sizes_that_serve_many_steps_are_those_of_one_where_the_form_is_right():
    true = bridge.Effect("actuator_lag", (0.4,))
    search, state, starts = weighed_of(slipping_log([true], 0.05), Cause(true.name, (0.3,)))
    fitter = weighed.Ahead(search.at(state).path, state.noise, starts)
    found = fitter.refine(fitter.fit_of(state.causes)).causes[0].params[0]
    assert found == pytest.approx(0.4, abs=0.03) and state.causes[0].params[0] == pytest.approx(0.4, abs=0.03)


def test_sizes_that_serve_many_steps_are_taken_where_they_predict_better():
    """A second-order actuator taken for a lag: one step tells another time constant than fifty do."""
    true = bridge.Effect("second_order_lag", (0.35, 0.35))
    search, state, starts = weighed_of(slipping_log([true], 0.03), Cause("actuator_lag", (0.3,)))
    fitter, fit = weighed.sized(search, state, starts)
    before, after = (ahead.rms(ahead.errors(search.path, causes, starts)["position"])[-1] for causes in (state.causes, fit.causes))
    assert fitter.smooth and after < 0.98 * before


def test_sizes_are_left_alone_where_the_robot_does_not_move_at_random():
    true = bridge.Effect("actuator_lag", (0.4,))
    search, state, starts = weighed_of(log_of(drive(SHORT), [true]), Cause(true.name, (0.3,)))
    assert weighed.sized(search, state, starts) == (search.fitter, state.fit) and weighed.chosen(search, state, starts) is state


def test_noise_of_headings_makes_sizes_no_larger():
    """Speed gain under 10 mm and 10 mrad: slopes at measured headings would have it larger by half a standard error."""
    off = []
    for seed in range(12):
        true = bridge.Effect("speed_gain", (0.1,))
        u = drive(LONG, seed)
        x = bridge.simulate(u[:-1], DT, START, [true], bridge.ARC)
        search = Search(ddr.Path(as_log(x + 0.01 * np.random.default_rng(seed).normal(size=x.shape), u)))
        state = search.settled(search.likeliest(search.fitter.fit_of(())), search.fitter.fit_of([Cause(true.name, (0.1,))]))
        off.append([some.causes[0].params[0] - 0.1 for some in (state, search.smoothed(state))])
    before, after = np.mean(off, axis=0)
    assert before > 0 and abs(after) < before / 3 and np.std(np.transpose(off)[1]) < 1.1 * np.std(np.transpose(off)[0])
