/* Regulators from other papers: what each one bounds, over long runs with and without excitation. */
#include "reference.h"

enum { N = 3, M = 2, D = N + M, STEPS = TEST_SHARE > 1 ? 300 : 3000 };

static estimator e, other; /* of all tests: of two more, double precision would exceed the Cortex-M4F's RAM */

/* How a run is excited: not at all, along one direction, in a plane, in all directions, and each of them in turn. */
enum { NONE, ONE, PLANE, ALL, TURNS, EXCITATIONS };

static void excite(random_source *random, int excitation, int k, real *zeta) {
	const int now = excitation == TURNS ? k / (STEPS / 12) % TURNS : excitation;
	random_fill(random, zeta, D, -1, 1);
	for (int i = 0; i < D; i++) {
		if (now == NONE || (now == PLANE && i > 1)) { zeta[i] = 0; }
		if (now == ONE) { zeta[i] = (real)(0.1 * (i + 1)); }
	}
}

/* Round-off, relative to a bound that holds in exact arithmetic. */
static const double slack = 1 + 1000 * (double)REAL_EPSILON;

/* Eigenvalues of P, and how much its trace, |zeta|^2 and |K| have been at most, from the start on. */
typedef struct {
	double least, largest; /* of all samples */
	double now_least, now_largest, trace;
	double most_trace, beta, gain;
	int steps;
} seen;

static void look(seen *s) {
	learned now;
	learned_take(&now, &e);
	eigenvalue_range(now.covariance, D, &s->now_least, &s->now_largest);
	s->trace = (double)trace_of(now.covariance, D);
	s->least = fmin(s->least, s->now_least);
	s->largest = fmax(s->largest, s->now_largest);
	s->most_trace = fmax(s->most_trace, s->trace);
}

/* Learns one sample of noise, and looks. With P <= p I, |K| = |P zeta| / (c + zeta' P zeta) <= sqrt(p / c) / 2. */
static void learn_and_look(const real *zeta, random_source *random, seen *s) {
	const int takes_lambda = strcmp(e.config.regulator->name, "vrf") == 0 || strcmp(e.config.regulator->name, "bgf") == 0;
	const double before = s->steps > 0 ? s->now_largest : (double)e.config.p0;
	const double most = sqrt(before / (takes_lambda ? (double)e.config.lambda : 1)) / 2;
	real psi_next[N];
	random_fill(random, psi_next, N, -1, 1);
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	const double gain = (double)norm(e.rls.gain, D);
	CHECK(gain <= most * slack, "%s: |K| %g of %g", estimator_name(&e), gain, most);
	s->beta = fmax(s->beta, pow((double)norm(zeta, D), 2));
	s->gain = fmax(s->gain, gain);
	s->steps++;
	look(s);
}

static void step(random_source *random, int excitation, seen *s) {
	real zeta[D];
	excite(random, excitation, s->steps, zeta);
	learn_and_look(zeta, random, s);
}

static seen start(const KOOP(regulator) *regulator, const KOOP(form) *form, double lambda, const double *own) {
	const seen nothing = {.least = 1e300};
	estimator_settings(&e, N, M, regulator, form);
	e.config.lambda = (real)lambda;
	for (size_t i = 0; i < regulator->n_settings && own; i++) { e.own[i] = (real)own[i]; }
	estimator_start(&e);
	return nothing;
}

#define FOR_ALL_RUNS(f, excitation)                                                                          \
	for (int f = 0; f < FORMS; f++)                                                                          \
		for (int excitation = 0; excitation < EXCITATIONS; excitation++)

/* ---- Covariance resetting ------------------------------------------------------------ */

static void test_reset_bounds_p_from_both_sides(void) {
	const double own[] = {40, 0.05}, p0 = 10;
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(91);
		seen s = start(&KOOP(reg_reset), all_forms[f], 0.5, own); /* lambda is ignored */
		for (int k = 0; k < STEPS; k++) {
			step(&random, excitation, &s);
			CHECK(s.now_largest <= p0 * slack, "%s: %g", estimator_name(&e), s.now_largest);
			CHECK(s.trace >= 0.05 * p0 * D / slack, "%s: %g", estimator_name(&e), s.trace);
			CHECK(s.now_least >= 1 / (1 / p0 + 40 * s.beta) / slack, "%s: %g", estimator_name(&e), s.now_least);
		}
		CHECK(excitation != NONE || s.least >= p0 / slack, "nothing is learned without excitation: %g", s.least);
		CHECK(s.gain <= sqrt(p0) / 2 * slack, "%s: |K| %g", estimator_name(&e), s.gain);
	}
}

/* By the period alone, and by the trace alone. */
static void test_reset_is_due_by_either_setting(void) {
	static const double period[] = {5, 0}, trace[] = {0, 0.3}, never[] = {0, 0};
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(92);
		seen s = start(&KOOP(reg_reset), all_forms[f], 1, period);
		for (int k = 1; k <= 25; k++) {
			step(&random, ALL, &s);
			CHECK((s.now_least > 9.99) == (k % 5 == 0), "%s, sample %d: %g", estimator_name(&e), k, s.now_least);
		}
		int resets = 0;
		s = start(&KOOP(reg_reset), all_forms[f], 1, trace);
		for (int k = 0; k < 100; k++) {
			step(&random, ALL, &s);
			resets += s.now_least > 9.99;
		}
		CHECK(resets > 5 && resets < 50, "%s: %d", estimator_name(&e), resets);
		s = start(&KOOP(reg_reset), all_forms[f], 1, never);
		for (int k = 0; k < 100; k++) { step(&random, ALL, &s); }
		CHECK(s.now_largest < 0.1, "%s: %g", estimator_name(&e), s.now_largest);
	}
}

/* Goodwin and others: with resets, least squares follows a parameter that has changed; without, its gain is gone. */
static void test_reset_follows_a_change(void) {
	for (int f = 0; f < FORMS; f++) {
		double error[2];
		for (int resets = 0; resets < 2; resets++) {
			random_source random = random_seed(93);
			const double own[] = {100, 0};
			start(resets ? &KOOP(reg_reset) : &KOOP(reg_none), all_forms[f], 1, resets ? own : NULL);
			learned now;
			for (int k = 0; k < 2000; k++) {
				real zeta[D], psi_next[N] = {0};
				random_fill(&random, zeta, D, -1, 1);
				psi_next[0] = k < 1500 ? zeta[0] : -zeta[0];
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			}
			learned_take(&now, &e);
			error[resets] = fabs((double)now.theta[0] + 1);
		}
		CHECK(error[1] < 0.01 && error[0] > 1, "%g with resets, %g without", error[1], error[0]);
	}
}

/* ---- Factors between lambda and 1: P lies between that of none and that of ef --------------- */

/* b - a has no negative eigenvalue, but for round-off */
static void check_ordered(const estimator *a, const estimator *b, int k) {
	static learned low, high;
	double least, largest, scale;
	learned_take(&low, a), learned_take(&high, b);
	scale = (double)trace_of(high.covariance, D);
	for (int i = 0; i < D * D; i++) { low.covariance[i] = high.covariance[i] - low.covariance[i]; }
	eigenvalue_range(low.covariance, D, &least, &largest);
	CHECK(least >= -(slack - 1) * scale, "%s, sample %d: %g of %g", estimator_name(a), k, least, scale);
}

/* P is not below that of `none`, whose neighbour it is, or not above that of `ef`. */
static void check_beside(const KOOP(regulator) *regulator, const KOOP(regulator) *neighbour, uint64_t seed) {
	const int below = neighbour == &KOOP(reg_none);
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(seed);
		start(regulator, all_forms[f], 0.97, NULL);
		estimator_settings(&other, N, M, neighbour, all_forms[f]);
		other.config.lambda = e.config.lambda;
		estimator_start(&other);
		for (int k = 0; k < 300; k++) {
			real zeta[D], psi_next[N];
			excite(&random, excitation, k, zeta);
			random_fill(&random, psi_next, N, -1, 1);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			CHECK_STATUS(KOOP_OK, estimator_update(&other, zeta, psi_next, NULL));
			check_ordered(below ? &other : &e, below ? &e : &other, k);
		}
	}
}

static void test_factors_stay_between_lambda_and_one(void) {
	check_beside(&KOOP(reg_vrf), &KOOP(reg_none), 94);
	check_beside(&KOOP(reg_vrf), &KOOP(reg_ef), 94);
	check_beside(&KOOP(reg_bgf), &KOOP(reg_none), 95);
	check_beside(&KOOP(reg_bgf), &KOOP(reg_ef), 95);
}

/* ---- Variable-rate forgetting --------------------------------------------------------- */

/* Without excitation P grows by 1 / lambda_k: not while the innovation keeps its size, then at most by 1 / lambda. */
static void test_vrf_forgets_only_when_the_innovation_grows(void) {
	for (int f = 0; f < FORMS; f++) {
		const real zeta[D] = {0}, innovation[] = {(real)0.5, (real)0.25, 100, (real)(0.99 * sqrt((double)REAL_MAX))};
		KOOP(health) health;
		start(&KOOP(reg_vrf), all_forms[f], 0.9, NULL);
		double before = 10 * D;
		for (int k = 0; k < 400; k++) {
			const real psi_next[N] = {innovation[k / 100]};
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			const double growth = (double)health.trace / before;
			before = (double)health.trace;
			const int larger = k % 100 < 10 && k >= 200;
			CHECK(growth >= 1 / slack && growth <= slack / 0.9, "%s, sample %d: %g", estimator_name(&e), k, growth);
			CHECK(!larger || growth > 1.001, "%s, sample %d: %g", estimator_name(&e), k, growth);
			CHECK(k >= 200 || growth <= slack, "%s, sample %d: %g", estimator_name(&e), k, growth);
		}
	}
}

/* While the last Q samples excite all directions, by alpha at least, P <= lambda^(1 - Q) / alpha I. */
static void test_vrf_bounds_p_while_all_is_excited(void) {
	enum { Q = 2 * D };
	const double lambda = 0.9;
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(103);
		real last[Q][D], gram[D * D];
		seen s = start(&KOOP(reg_vrf), all_forms[f], lambda, NULL);
		for (int k = 0; k < 500; k++) {
			double alpha, most;
			excite(&random, ALL, k, last[k % Q]);
			learn_and_look(last[k % Q], &random, &s);
			if (k + 1 < Q) { continue; }
			memset(gram, 0, sizeof gram);
			for (int i = 0; i < Q * D * D; i++) {
				gram[i % (D * D)] += last[i / (D * D)][i / D % D] * last[i / (D * D)][i % D];
			}
			eigenvalue_range(gram, D, &alpha, &most);
			CHECK(s.now_largest <= pow(lambda, 1 - Q) / alpha * slack, "%s, sample %d: %g, alpha %g", estimator_name(&e), k,
			      s.now_largest, alpha);
		}
	}
}

static void test_vrf_needs_a_faster_and_a_slower_mean(void) {
	static const double same[] = {10, 10, 1}, fits[] = {10, 11, 1};
	for (int fit = 0; fit < 2; fit++) {
		size_t reals;
		start(&KOOP(reg_vrf), &KOOP(form_sqrt), 0.9, NULL);
		for (int i = 0; i < 3; i++) { e.own[i] = (real)(fit ? fits : same)[i]; }
		CHECK_STATUS(fit ? KOOP_OK : KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
	}
}

/* Bruce and others: after a change of the parameters it converges faster than lambda = 1 does; before the change it
 * has not forgotten, and so averages more of the noise than a constant lambda. */
static void test_vrf_follows_a_change_and_averages_before_it(void) {
	const KOOP(regulator) *const compared[] = {&KOOP(reg_vrf), &KOOP(reg_none), &KOOP(reg_ef)};
	for (int f = 0; f < FORMS; f++) {
		double before[3] = {0}, after[3];
		for (int r = 0; r < 3; r++) {
			const double own[] = {5, 200, 1};
			random_source random = random_seed(96);
			learned now;
			start(compared[r], all_forms[f], 0.9, r == 0 ? own : NULL);
			for (int k = 0; k < 2000; k++) {
				real zeta[D], psi_next[N] = {0};
				random_fill(&random, zeta, D, -1, 1);
				psi_next[0] = (k < 1500 ? zeta[0] : -zeta[0]) + random_uniform(&random, -0.1, 0.1);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
				learned_take(&now, &e);
				if (k >= 1000 && k < 1500) { before[r] += fabs((double)now.theta[0] - 1) / 500; }
			}
			after[r] = fabs((double)now.theta[0] + 1);
		}
		CHECK(after[0] < 0.1 && after[1] > 1, "%g, none %g", after[0], after[1]);
		CHECK(before[0] < before[2], "%g, ef %g", before[0], before[2]);
	}
}

/* ---- Exponential and cyclic resetting ----------------------------------------------------- */

static void check_resetting(const KOOP(regulator) *regulator, double p_inf) {
	const double own[] = {p_inf}, p0 = 10, lambda = 0.9, p = fmax(p0, p_inf);
	const int cyclic = regulator == &KOOP(reg_cr);
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(97);
		seen s = start(regulator, all_forms[f], lambda, own);
		for (int k = 0; k < STEPS; k++) {
			step(&random, excitation, &s);
			const double most = cyclic ? p * pow(lambda, 1 - D) : p;
			const double least = cyclic ? 1 / fmax(1 / p0, ((1 - pow(lambda, D)) / p_inf + lambda * s.beta) / (1 - lambda))
			                            : 1 / fmax(1 / p0, 1 / p_inf + lambda * s.beta / (1 - lambda));
			CHECK(s.now_largest <= most * slack, "%s: %g of %g", estimator_name(&e), s.now_largest, most);
			CHECK(s.now_least >= least / slack, "%s: %g of %g", estimator_name(&e), s.now_least, least);
			CHECK(s.gain <= sqrt(most) / 2 * slack, "%s: |K| %g", estimator_name(&e), s.gain);
		}
	}
}

static void test_resetting_bounds_p_from_both_sides(void) {
	for (int cyclic = 0; cyclic < 2; cyclic++) {
		check_resetting(cyclic ? &KOOP(reg_cr) : &KOOP(reg_er), 0.5);
		check_resetting(cyclic ? &KOOP(reg_cr) : &KOOP(reg_er), 40);
	}
}

/* Lai and Bernstein: without excitation P^-1 - I / p_inf shrinks by lambda per sample; that of cr ends in a cycle. */
static void test_resetting_converges_without_excitation(void) {
	const double own[] = {2}, lambda = 0.9;
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(98);
		seen s = start(&KOOP(reg_er), all_forms[f], lambda, own);
		for (int k = 1; k <= 200; k++) {
			step(&random, NONE, &s);
			const double expected = 1 / (1 / 2.0 + pow(lambda, k) * (1 / 10.0 - 1 / 2.0));
			CHECK(fabs(s.now_largest / expected - 1) < slack - 1 && fabs(s.now_least / expected - 1) < slack - 1,
			      "%s, sample %d: %g", estimator_name(&e), k, s.now_largest);
		}
		s = start(&KOOP(reg_cr), all_forms[f], lambda, own);
		for (int k = 0; k < 60 * D; k++) { step(&random, NONE, &s); }
		const double widest = 2 * pow(lambda, 1 - D);
		CHECK(fabs(s.now_least / 2 - 1) < 0.01 && fabs(s.now_largest / widest - 1) < 0.01, "%s: %g to %g",
		      estimator_name(&e), s.now_least, s.now_largest);
	}
}

/* lambda = 1 is least squares, whatever p_inf; and settings that leave the range are refused before the first sample. */
static void test_resetting_without_forgetting_and_out_of_range(void) {
	const KOOP(regulator) *const both[] = {&KOOP(reg_er), &KOOP(reg_cr)};
	for (int r = 0; r < 2; r++) {
		random_source random = random_seed(99);
		const double own[] = {3};
		size_t reals;
		learned a, b;
		start(both[r], &KOOP(form_sqrt), 1, own);
		estimator_default(&other, N, M, &KOOP(reg_none), &KOOP(form_sqrt));
		for (int k = 0; k < 20; k++) {
			real zeta[D], psi_next[N];
			excite(&random, ALL, k, zeta);
			random_fill(&random, psi_next, N, -1, 1);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			CHECK_STATUS(KOOP_OK, estimator_update(&other, zeta, psi_next, NULL));
		}
		learned_take(&a, &e), learned_take(&b, &other);
		CHECK(relative_difference_real(a.covariance, b.covariance, D * D) < slack - 1, "%s", estimator_name(&e));
		e.own[0] = REAL_MIN / 4;
		CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reals));
		e.config.lambda = (real)0.9;
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
		e.own[0] = REAL_MAX / 9;
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
		e.config.lambda = 1;
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
	}
}

/* A sample that is refused while P is being reset leaves P and the memory: here round-off of the plain form, from a P
 * far beyond p_inf, costs P its positive definiteness. */
static void test_resetting_is_refused_as_a_whole(void) {
	const KOOP(regulator) *const both[] = {&KOOP(reg_er), &KOOP(reg_cr)};
	for (int r = 0; r < 2; r++) {
		int refused = 0;
		for (int i = 0; i < 40; i++) {
			const real zeta[D] = {0}, psi_next[N] = {0};
			learned before, after;
			start(both[r], &KOOP(form_plain), 0.9, NULL);
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, REAL_MAX / (real)(3 + i)));
			learned_take(&before, &e);
			if (estimator_update(&e, zeta, psi_next, NULL) == KOOP_OK) { continue; }
			refused++;
			learned_take(&after, &e);
			TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
			for (int k = 0; k <= D; k++) { TEST_ASSERT_TRUE(e.rls.memory[k] >= 0 && e.rls.memory[k] <= 0); }
		}
		CHECK(refused > 0, "%s: nothing was refused", estimator_name(&e));
	}
}

/* ---- Directional forgetting ------------------------------------------------------------- */

static double quotient(const real *zeta) {
	learned now;
	double s = 0;
	learned_take(&now, &e);
	for (int i = 0; i < D * D; i++) { s += (double)zeta[i / D] * (double)now.covariance[i] * (double)zeta[i % D]; }
	return s;
}

static void test_kulhavy_forgets_along_the_regressor_only(void) {
	const double lambda = 0.95, limit = (1 - lambda) / lambda;
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(100);
		seen s = start(&KOOP(reg_kulhavy), all_forms[f], lambda, NULL);
		for (int k = 0; k < STEPS; k++) {
			real zeta[D];
			excite(&random, excitation, k, zeta);
			const double before = quotient(zeta), trace = k > 0 ? s.trace : 10 * D;
			learn_and_look(zeta, &random, &s);
			const double after = quotient(zeta), expected = before / (lambda * (1 + before));
			CHECK(s.trace <= trace / lambda * slack, "%s: trace %g after %g", estimator_name(&e), s.trace, trace);
			CHECK(fabs(after - expected) <= expected * (slack - 1), "%s: %g of %g", estimator_name(&e), after, expected);
			CHECK(after <= fmax(before, limit) * slack, "%s: %g", estimator_name(&e), after);
		}
		/* what is not excited keeps its p0 of 10, and nothing exceeds it */
		CHECK(excitation == ALL || excitation == TURNS || fabs(s.now_largest / 10 - 1) < 1e-3, "%s, run %d: %g",
		      estimator_name(&e), excitation, s.now_largest);
		CHECK(s.largest < 10.01 && s.least > 1e-3, "%s: %g to %g", estimator_name(&e), s.least, s.largest);
	}
}

/* Where all that is learned is forgotten, where nothing is, and where zeta is too small. */
static void test_kulhavy_where_p_stays(void) {
	for (int f = 0; f < FORMS; f++) {
		for (int which = 0; which < 4; which++) {
			const double own[] = {which == 2 ? 1e-3 : 0};
			const real zeta[D] = {which == 1 ? 0 : which == 2 ? (real)0.01 : (real)0.5}, psi_next[N] = {1};
			KOOP(health) health;
			learned before, after;
			start(&KOOP(reg_kulhavy), all_forms[f], 0.5, own);
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, which == 3 ? 5 : 4)); /* s = 1, and lambda (1 + s) = 1 */
			learned_take(&before, &e);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			learned_take(&after, &e);
			TEST_ASSERT_EQUAL_INT(which != 3, health.frozen);
			TEST_ASSERT_EQUAL_INT(which != 3, learned_same_covariance(&before, &after, &e));
			TEST_ASSERT_EQUAL_INT(which == 1, learned_same_theta(&before, &after, &e));
		}
	}
}

/* Cao and Schwartz, "A directional forgetting algorithm based on the decomposition of the information matrix",
 * Automatica 36, 2000: of R = P^-1, the part R zeta (zeta' R zeta)^-1 zeta' R is forgotten. For one regressor per
 * sample this is sift, which is therefore not listed a second time. */
static void test_sift_is_the_decomposition_of_cao_and_schwartz(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(101);
		wide R[D * D] = {0};
		start(&KOOP(reg_sift), all_forms[f], 0.9, NULL);
		for (int i = 0; i < D; i++) { R[i * D + i] = 1 / (wide)e.config.p0; }
		for (int k = 0; k < 200; k++) {
			real zeta[D], psi_next[N];
			wide part[D] = {0}, size = 0, copied[D * D], P[D * D] = {0};
			learned now;
			excite(&random, k % 3 ? ALL : ONE, k, zeta);
			random_fill(&random, psi_next, N, -1, 1);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			for (int i = 0; i < D * D; i++) { part[i / D] += R[i] * (wide)zeta[i % D]; }
			for (int i = 0; i < D; i++) { size += part[i] * (wide)zeta[i]; }
			for (int i = 0; i < D * D; i++) {
				R[i] -= (1 - (wide)e.config.lambda) * part[i / D] * part[i % D] / size;
				R[i] += (wide)zeta[i / D] * (wide)zeta[i % D];
			}
			memcpy(copied, R, sizeof R);
			for (int i = 0; i < D; i++) { P[i * D + i] = 1; }
			solve_positive_definite(copied, D, P, D);
			learned_take(&now, &e);
			CHECK(relative_difference(now.covariance, P, D * D) < slack - 1, "%s, sample %d", estimator_name(&e), k);
		}
	}
}

/* ---- Bounded-gain forgetting -------------------------------------------------------------- */

static void test_bgf_bounds_the_trace(void) {
	const double own[] = {80}, lambda = 0.9;
	FOR_ALL_RUNS(f, excitation) {
		random_source random = random_seed(102);
		seen s = start(&KOOP(reg_bgf), all_forms[f], lambda, own);
		for (int k = 1; k <= STEPS; k++) {
			step(&random, excitation, &s);
			CHECK(s.trace <= 80 * slack, "%s: %g", estimator_name(&e), s.trace);
			const double logistic = 80 / (1 + (80 / 50.0 - 1) * pow(lambda, k)); /* from p0 d = 50 */
			CHECK(excitation != NONE || fabs(s.trace / logistic - 1) < slack - 1, "%s: %g", estimator_name(&e), s.trace);
		}
		CHECK(s.gain <= sqrt(80 / lambda) / 2 * slack, "%s: |K| %g", estimator_name(&e), s.gain);
		const double rate = (1 - lambda) * (1 - fmin(fmax(s.most_trace, 50) / 80, 1));
		CHECK(s.least >= fmin(10, rate / s.beta) / slack, "%s: %g of %g", estimator_name(&e), s.least, rate / s.beta);
		/* under persistent excitation P is as that of ef, far below the bound */
		CHECK(excitation != ALL || (s.trace < 8 && s.now_least > 0.01), "%s: %g", estimator_name(&e), s.trace);
		/* without it, the trace ends at the bound */
		CHECK((excitation != ONE && excitation != PLANE) || s.trace > 79, "%s: %g", estimator_name(&e), s.trace);
	}
}

/* The bound may not be below the trace at the start; beyond it, P that has been reset to more does not grow. */
static void test_bgf_from_beyond_its_bound(void) {
	const real zeta[D] = {0}, psi_next[N] = {0};
	KOOP(health) health;
	size_t reals;
	start(&KOOP(reg_bgf), &KOOP(form_sqrt), 0.9, NULL);
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 100));
	for (int k = 0; k < 10; k++) { CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health)); }
	CHECK((double)health.trace <= 500 * slack, "%g", (double)health.trace);
	e.own[0] = 49;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
	e.own[0] = 51;
	CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reals));
	e.own[0] = 0;
	e.config.p0 = REAL_MAX / 9;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reals)(&e.config, &reals));
}

/* Of a P that KOOP_CHECK_REPORT let become indefinite, with a trace below 0, lambda_k is lambda and not less. */
static void test_bgf_of_a_negative_trace(void) {
	const real zeta[D] = {0}, psi_next[N] = {0};
	KOOP(health) health;
	start(&KOOP(reg_bgf), &KOOP(form_plain), 0.9, NULL);
	e.config.check = KOOP_CHECK_REPORT;
	estimator_start(&e);
	for (size_t i = 0; i < e.config.form->reals(&e.rls); i++) { e.rls.covariance[i] *= -100; }
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
	CHECK(fabs((double)health.trace * 0.9 / (-1000 * D) - 1) < slack - 1, "%g", (double)health.trace);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_reset_bounds_p_from_both_sides);
	RUN_TEST(test_reset_is_due_by_either_setting);
	RUN_TEST(test_reset_follows_a_change);
	RUN_TEST(test_factors_stay_between_lambda_and_one);
	RUN_TEST(test_vrf_forgets_only_when_the_innovation_grows);
	RUN_TEST(test_vrf_bounds_p_while_all_is_excited);
	RUN_TEST(test_vrf_needs_a_faster_and_a_slower_mean);
	RUN_TEST(test_vrf_follows_a_change_and_averages_before_it);
	RUN_TEST(test_resetting_bounds_p_from_both_sides);
	RUN_TEST(test_resetting_converges_without_excitation);
	RUN_TEST(test_resetting_without_forgetting_and_out_of_range);
	RUN_TEST(test_resetting_is_refused_as_a_whole);
	RUN_TEST(test_kulhavy_forgets_along_the_regressor_only);
	RUN_TEST(test_kulhavy_where_p_stays);
	RUN_TEST(test_sift_is_the_decomposition_of_cao_and_schwartz);
	RUN_TEST(test_bgf_bounds_the_trace);
	RUN_TEST(test_bgf_from_beyond_its_bound);
	RUN_TEST(test_bgf_of_a_negative_trace);
	return UNITY_END();
}
