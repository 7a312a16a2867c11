/* Each regulator against the paper's equations, and what each one promises. */
#include "reference.h"

static estimator e;

/* psi_next = Theta_true zeta + noise */
static void respond(random_source *random, const real *theta_true, const real *zeta, size_t N, size_t d,
                    double noise, real *psi_next) {
	for (size_t i = 0; i < N; i++) {
		wide sum = (wide)random_uniform(random, -noise, noise);
		for (size_t j = 0; j < d; j++) { sum += (wide)theta_true[i * d + j] * (wide)zeta[j]; }
		psi_next[i] = (real)sum;
	}
}

/* Every regulator in both forms follows the literal recursion, step by step.
 *
 * The bound of P, relative to its largest element: an element takes three roundings per step, of the
 * product, the difference and the scaling. The recursion amplifies none of them, since adding the same
 * information to two covariances brings them no farther apart (in Thompson's metric, of their relative
 * eigenvalues). So their sum bounds it, where P is as well conditioned as it is here. */
static void test_follow_the_paper(void) {
	enum { STEPS = 100, ROUNDINGS = 3 };
	static reference paper;
	random_source random = random_seed(31);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			for (int round = 0; round < 8; round++) {
				const size_t N = 1 + random_below(&random, 8), m = 1 + random_below(&random, 3), d = N + m;
				int gated_count = 0;
				real theta_true[8 * 11];
				random_fill(&random, theta_true, N * d, -1, 1);
				estimator_settings(&e, N, m, all_regulators[r], all_forms[f]);
				e.config.lambda = random_uniform(&random, 0.9, 1);
				e.floor.eps_sift = round % 2 ? (real)0.3 : (real)1e-10;
				e.trace.tau0 = round % 2 ? 3 : 0;
				estimator_start(&e);
				reference_start(&paper, &e);
				for (int k = 0; k < STEPS; k++) {
					real zeta[MAX_D], psi_next[MAX_N];
					KOOP(health) health;
					learned now;
					random_fill(&random, zeta, d, -1, 1);
					respond(&random, theta_true, zeta, N, d, 0.1, psi_next);
					CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
					const int gated = reference_update(&paper, zeta, psi_next);
					CHECK(health.frozen == gated, "%s step %d", estimator_name(&e), k);
					gated_count += gated;

					learned_take(&now, &e);
					const double theta = relative_difference(now.theta, paper.theta, N * d);
					const double P = relative_difference(now.covariance, paper.P, d * d);
					CHECK(theta <= 50 * (double)REAL_EPSILON, "%s step %d: %.2g epsilon", estimator_name(&e),
					      k, theta / (double)REAL_EPSILON);
					CHECK(P <= STEPS * ROUNDINGS * (double)REAL_EPSILON, "%s step %d: %.2g epsilon",
					      estimator_name(&e), k, P / (double)REAL_EPSILON);
				}
				const int gates = strncmp(e.config.regulator->name, "dz_", 3) == 0;
				CHECK(gates || round % 2 || gated_count == 0, "%s", estimator_name(&e));
			}
		}
	}
}

static void check_reference(const reference *paper) {
	const size_t d = paper->d;
	for (size_t i = 0; i < d * d; i++) {
		const size_t mirrored = i % d * d + i / d;
		wide product = 0;
		for (size_t k = 0; k < d; k++) { product += paper->P[i / d * d + k] * paper->R[k * d + i % d]; }
		CHECK(paper->P[i] == paper->P[mirrored] && paper->R[i] == paper->R[mirrored], "%s", paper->regulator);
		CHECK(fabs(product - (i % (d + 1) == 0)) < 1e-11, "%s: P R is %g", paper->regulator, (double)product);
	}
}

/* Whatever long double is: what is not symmetric in it would be taken for an error of the library. P and R follow
 * from two different formulas of each paper. */
static void test_reference_stays_symmetric_and_p_the_inverse_of_r(void) {
	enum { N = 4, M = 2, D = N + M };
	static reference paper;
	random_source random = random_seed(35);
	for (int r = 0; r < REGULATORS; r++) {
		estimator_default(&e, N, M, all_regulators[r], all_forms[0]);
		reference_start(&paper, &e);
		for (int k = 0; k < 10; k++) {
			real zeta[D], psi_next[N];
			random_fill(&random, zeta, D, -1, 1);
			random_fill(&random, psi_next, N, -1, 1);
			reference_update(&paper, zeta, psi_next);
			check_reference(&paper);
		}
	}
}

/* Forgetting so strong that what it adds to P exceeds P. */
static void test_sift_forgets_strongly(void) {
	enum { N = 3, M = 1, D = N + M };
	static reference paper;
	random_source random = random_seed(33);
	for (int f = 0; f < FORMS; f++) {
		estimator_settings(&e, N, M, &KOOP(reg_sift), all_forms[f]);
		e.config.lambda = (real)0.3;
		estimator_start(&e);
		reference_start(&paper, &e);
		for (int k = 0; k < 20; k++) {
			real zeta[D], psi_next[N];
			learned now;
			random_fill(&random, zeta, D, -1, 1);
			random_fill(&random, psi_next, N, -1, 1);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			reference_update(&paper, zeta, psi_next);
			learned_take(&now, &e);
			const double P = relative_difference(now.covariance, paper.P, D * D);
			CHECK(P <= 1000 * (double)REAL_EPSILON, "%s step %d: %.2g epsilon", estimator_name(&e), k,
			      P / (double)REAL_EPSILON);
		}
	}
}

static int decide_covariance_alone(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	step->update_theta = 0;
	return KOOP_OK;
}

/* Your own regulator that leaves Theta alone: P goes on as by exponential forgetting. */
static void test_covariance_without_theta(void) {
	enum { N = 3, M = 2, D = N + M };
	const KOOP(regulator) own = {.name = "own", .decide = decide_covariance_alone, .forgets = 1};
	static estimator twin;
	random_source random = random_seed(34);
	for (int f = 0; f < FORMS; f++) {
		learned before, after, twins;
		estimator_default(&e, N, M, &own, all_forms[f]);
		estimator_default(&twin, N, M, &KOOP(reg_ef), all_forms[f]);
		real theta[N * D];
		random_fill(&random, theta, N * D, -1, 1);
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		learned_take(&before, &e);
		for (int k = 0; k < 10; k++) {
			real zeta[D], psi_next[N];
			KOOP(health) health;
			random_fill(&random, zeta, D, -1, 1);
			random_fill(&random, psi_next, N, -1, 1);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			CHECK_STATUS(KOOP_OK, estimator_update(&twin, zeta, psi_next, NULL));
			TEST_ASSERT_EQUAL_INT(0, health.frozen);
		}
		learned_take(&after, &e);
		learned_take(&twins, &twin);
		TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e));
		TEST_ASSERT_TRUE(learned_same_covariance(&twins, &after, &e));
	}
}

/* Theta after k samples solves the weighted normal equations with ridge lambda^k / p0. */
static void check_batch(const KOOP(regulator) *regulator, const KOOP(form) *form, double lambda_given,
                        double lambda_meant) {
	enum { N = 4, M = 2, D = N + M, STEPS = 150 };
	random_source random = random_seed(32);
	wide information[D * D] = {0}, moments[D * N] = {0}, theta[N * D];
	real theta_true[N * D];
	learned now;

	random_fill(&random, theta_true, N * D, -1, 1);
	estimator_settings(&e, N, M, regulator, form);
	e.config.lambda = (real)lambda_given;
	e.dead_zone.delta = 0;
	estimator_start(&e);
	const wide lambda = lambda_meant < 1 ? (wide)e.config.lambda : 1;
	for (size_t i = 0; i < D; i++) { information[i * D + i] = 1 / (wide)e.config.p0; }
	for (int k = 0; k < STEPS; k++) {
		real zeta[D], psi_next[N];
		random_fill(&random, zeta, D, -1, 1);
		respond(&random, theta_true, zeta, N, D, 0.3, psi_next);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
		for (size_t i = 0; i < D; i++) {
			for (size_t j = 0; j < D; j++) {
				information[i * D + j] = lambda * information[i * D + j] + (wide)zeta[i] * (wide)zeta[j];
			}
			for (size_t j = 0; j < N; j++) {
				moments[i * N + j] = lambda * moments[i * N + j] + (wide)zeta[i] * (wide)psi_next[j];
			}
		}
	}

	wide factor[D * D], inverse[D * D] = {0};
	for (size_t i = 0; i < D; i++) { inverse[i * D + i] = 1; }
	memcpy(factor, information, sizeof factor);
	solve_positive_definite(factor, D, inverse, D);
	memcpy(factor, information, sizeof factor);
	solve_positive_definite(factor, D, moments, N);
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < D; j++) { theta[i * D + j] = moments[j * N + i]; }
	}
	learned_take(&now, &e);
	const double off = relative_difference(now.theta, theta, N * D);
	const double P_off = relative_difference(now.covariance, inverse, D * D);
	CHECK(off <= 500 * (double)REAL_EPSILON, "%s: %.2g epsilon", estimator_name(&e),
	      off / (double)REAL_EPSILON);
	CHECK(P_off <= 500 * (double)REAL_EPSILON, "%s: P %.2g epsilon", estimator_name(&e),
	      P_off / (double)REAL_EPSILON);
}

static void test_equal_batch_least_squares(void) {
	for (int f = 0; f < FORMS; f++) {
		check_batch(&KOOP(reg_none), all_forms[f], 1, 1);
		check_batch(&KOOP(reg_none), all_forms[f], 0.5, 1); /* `none` ignores lambda */
		check_batch(&KOOP(reg_ef), all_forms[f], 1, 1);
		check_batch(&KOOP(reg_dz_cs), all_forms[f], 1, 1);
		check_batch(&KOOP(reg_dz_ks), all_forms[f], 1, 1);
		check_batch(&KOOP(reg_sift), all_forms[f], 1, 1);
		check_batch(&KOOP(reg_ef), all_forms[f], 0.95, 0.95);
		check_batch(&KOOP(reg_dz_cs), all_forms[f], 0.95, 0.95);
	}
}

/* At the threshold itself the sample is gated, just above it is not. */
static void test_dead_zones_gate_at_delta(void) {
	enum { N = 3, M = 1, D = N + M };
	for (int ks = 0; ks < 2; ks++) {
		for (int f = 0; f < FORMS; f++) {
			for (int above = 0; above < 2; above++) {
				const real zeta[D] = {1, (real)0.5, -1, 2};
				real psi_next[N] = {0, (real)0.25, 0};
				learned before, after;
				KOOP(health) health;
				estimator_settings(&e, N, M, ks ? &KOOP(reg_dz_ks) : &KOOP(reg_dz_cs), all_forms[f]);
				e.dead_zone.delta = (real)0.25;
				estimator_start(&e);
				if (above) { psi_next[1] *= 1 + 4 * REAL_EPSILON; }
				learned_take(&before, &e);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
				learned_take(&after, &e);
				TEST_ASSERT_EQUAL_INT(!above, health.frozen);
				TEST_ASSERT_EQUAL_INT(!above, learned_same_covariance(&before, &after, &e));
				TEST_ASSERT_EQUAL_INT(!above && ks, learned_same_theta(&before, &after, &e));
			}
		}
	}
}

static void test_constant_trace(void) {
	random_source random = random_seed(33);
	for (int f = 0; f < FORMS; f++) {
		for (int round = 0; round < 20; round++) {
			const size_t N = 1 + random_below(&random, MAX_N), m = 1 + random_below(&random, MAX_M),
			             d = N + m;
			estimator_settings(&e, N, m, &KOOP(reg_ct), all_forms[f]);
			e.trace.tau0 = round % 2 ? random_uniform(&random, 0.01, 1000) : 0;
			estimator_start(&e);
			const wide tau0 = round % 2 ? (wide)e.trace.tau0 : (wide)e.config.p0 * (wide)d;
			/* plain: one sum of d elements and one scaling. sqrt: a sum of d squares
			 * of each of d elements, four at a time; up to these d it stays within too */
			const wide tolerance = 4 * (wide)d * (wide)REAL_EPSILON * tau0;
			for (int k = 0; k < 200; k++) {
				real zeta[MAX_D], psi_next[MAX_N];
				learned now;
				random_fill(&random, zeta, d, -1, 1);
				if (k % 3 == 0) { memset(zeta, 0, sizeof zeta); } /* nothing to learn from */
				random_fill(&random, psi_next, N, -1, 1);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
				learned_take(&now, &e);
				const wide off = fabs(trace_of(now.covariance, d) - tau0);
				CHECK(off <= tolerance, "%s step %d: off by %.3g epsilon", estimator_name(&e), k,
				      (double)(off / tau0 / (wide)REAL_EPSILON));
			}
		}
	}
}

/* The two bounds of the paper's remark. Constant regressors drive P into both. */
/* A trace so far below that of P that P would underflow to 0 and never learn again. */
static void test_constant_trace_far_below_p(void) {
	for (int f = 0; f < FORMS; f++) {
		learned before, after;
		const real zeta[3] = {1, 1, 1}, psi_next[2] = {1, 1};
		estimator_settings(&e, 2, 1, &KOOP(reg_ct), all_forms[f]);
		e.config.p0 = REAL_MAX / 1000;
		e.trace.tau0 = REAL_MIN;
		estimator_start(&e);
		learned_take(&before, &e);
		CHECK_STATUS(KOOP_E_INDEFINITE, estimator_update(&e, zeta, psi_next, NULL));
		learned_take(&after, &e);
		TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
		TEST_ASSERT_TRUE(after.covariance[0] > 0);
	}
}

static void test_sift_keeps_eigenvalues_bounded(void) {
	enum { N = 4, M = 1, D = N + M };
	const double eps_sift = 0.05, beta = 4, p0 = 1, lambda = 0.9;
	const double highest = fmax((1 - lambda) / eps_sift, p0), lowest = fmin((1 - lambda) / beta, p0);
	const double margin = 64 * (double)REAL_EPSILON; /* round-off; the bounds hold in exact arithmetic */
	random_source random = random_seed(34);
	for (int f = 0; f < FORMS; f++) {
		double largest_seen = 0, least_seen = 1e9;
		estimator_settings(&e, N, M, &KOOP(reg_sift), all_forms[f]);
		e.config.lambda = (real)lambda;
		e.config.p0 = (real)p0;
		e.floor.eps_sift = (real)eps_sift;
		estimator_start(&e);
		for (int phase = 0; phase < (TEST_SHARE > 1 ? 12 : 60); phase++) {
			real zeta[D], psi_next[N] = {1, -1, 1, -1};
			for (int k = 0; k < 100; k++) {
				learned now;
				double least, largest;
				if (k == 0 || phase % 3 == 0) {
					random_fill(&random, zeta, D, -1, 1);
					const double square = phase % 3 == 1   ? eps_sift * (1 + 1e-5)
					                      : phase % 3 == 2 ? beta * (1 - 1e-5)
					                                       : (double)random_uniform(&random, eps_sift, beta);
					const double scale = sqrt(square) / (double)norm(zeta, D);
					for (int i = 0; i < D; i++) { zeta[i] = (real)((double)zeta[i] * scale); }
				}
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
				learned_take(&now, &e);
				eigenvalue_range(now.covariance, D, &least, &largest);
				CHECK(largest <= highest * (1 + margin), "%s: %.9g", estimator_name(&e), largest);
				CHECK(least >= lowest * (1 - margin), "%s: %.9g", estimator_name(&e), least);
				largest_seen = fmax(largest_seen, largest);
				least_seen = fmin(least_seen, least);
			}
		}
		CHECK(largest_seen > 0.99 * highest, "the upper bound was not put to the test: %g", largest_seen);
		CHECK(least_seen < 1.01 * lowest, "the lower bound was not put to the test: %g", least_seen);
	}
}

static void test_sift_ignores_what_carries_no_information(void) {
	enum { N = 3, M = 1, D = N + M };
	for (int f = 0; f < FORMS; f++) {
		for (int enough = 0; enough < 2; enough++) {
			/* zeta' zeta is 0.25 exactly */
			const real zeta[D] = {(real)0.25, (real)0.25, (real)0.25, (real)0.25}, psi_next[N] = {5, 5, 5};
			learned before, after;
			KOOP(health) health;
			estimator_settings(&e, N, M, &KOOP(reg_sift), all_forms[f]);
			e.floor.eps_sift = (real)0.25 * (enough ? 1 : 1 + REAL_EPSILON);
			estimator_start(&e);
			learned_take(&before, &e);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			learned_take(&after, &e);
			TEST_ASSERT_EQUAL_INT(!enough, health.frozen);
			TEST_ASSERT_EQUAL_INT(!enough, learned_same_theta(&before, &after, &e));
			TEST_ASSERT_EQUAL_INT(!enough, learned_same_covariance(&before, &after, &e));
		}
	}
}

/* What was learned along one direction outlives any number of samples along another. */
static void test_sift_does_not_forget_what_is_not_excited(void) {
	enum { N = 2, M = 1, D = N + M };
	for (int f = 0; f < FORMS; f++) {
		const real first[D] = {1, 0, 0}, second[D] = {0, 0, 1}, psi_next[N] = {1, 1};
		learned before, after;
		estimator_default(&e, N, M, &KOOP(reg_sift), all_forms[f]);
		for (int k = 0; k < 50; k++) { CHECK_STATUS(KOOP_OK, estimator_update(&e, first, psi_next, NULL)); }
		learned_take(&before, &e);
		for (int k = 0; k < 5000 / TEST_SHARE; k++) {
			CHECK_STATUS(KOOP_OK, estimator_update(&e, second, psi_next, NULL));
		}
		learned_take(&after, &e);
		CHECK(relative_difference_real(after.covariance, before.covariance, 1) <= 4 * (double)REAL_EPSILON,
		      "P[0][0] went from %g to %g", (double)before.covariance[0], (double)after.covariance[0]);
	}
}

/* ---- warnings ---------------------------------------------------------------------------- */

/* 1 / (1 - lambda) samples against d unknowns, for regulators that forget everything by lambda. */
static void test_memory_shorter_than_the_unknowns_is_told(void) {
	static const struct {
		double lambda;
		int told;
	} cases[] = {{1, 0}, {0.98, 0}, {0.88, 0}, {0.875, 0}, {0.87, 1}, {0.5, 1}}; /* d = 8: 1 / 8 = 0.125 */
	for (size_t r = 0; r < REGULATORS; r++) {
		for (size_t c = 0; c < sizeof cases / sizeof *cases; c++) {
			KOOP(health) health;
			const real zeta[8] = {1}, psi_next[6] = {0};
			estimator_settings(&e, 6, 2, all_regulators[r], &KOOP(form_sqrt));
			e.config.lambda = (real)cases[c].lambda;
			estimator_start(&e);
			const int forgets = all_regulators[r]->forgets;
			CHECK(e.rls.short_memory == (cases[c].told && forgets), "%s, lambda %g", estimator_name(&e),
			      cases[c].lambda);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			TEST_ASSERT_EQUAL_INT(e.rls.short_memory, health.short_memory);
		}
	}
}

static void test_no_memory_is_short_where_only_a_part_is_forgotten(void) {
	const KOOP(regulator) *const partial[] = {&KOOP(reg_none), &KOOP(reg_sift), &KOOP(reg_kulhavy), &KOOP(reg_vrf),
	                                          &KOOP(reg_reset)};
	for (size_t r = 0; r < sizeof partial / sizeof *partial; r++) {
		estimator_settings(&e, 6, 2, partial[r], &KOOP(form_sqrt));
		e.config.lambda = (real)0.5;
		estimator_start(&e);
		CHECK(!e.rls.short_memory, "%s", estimator_name(&e));
	}
}

/* Without excitation the trace grows by 1 / lambda per sample, but where the regulator bounds it. */
static void test_winding_up_is_told(void) {
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t r = 0; r < REGULATORS; r++) {
			KOOP(health) health = {.winding_up = 7};
			const real zeta[6] = {1}, psi_next[4] = {1};
			const int winds = all_regulators[r] == &KOOP(reg_ef);
			estimator_settings(&e, 4, 2, all_regulators[r], all_forms[f]);
			e.config.lambda = (real)0.95;
			estimator_start(&e);
			for (int k = 0; k < 200; k++) {
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
				const int told = winds && health.trace > 100 * e.rls.nominal_trace;
				CHECK(health.winding_up == told, "%s, sample %d", estimator_name(&e), k);
			}
			TEST_ASSERT_EQUAL_INT(winds, health.winding_up);
		}
	}
}

/* Over a hundred times, and not at it. The root of this trace is exact too. */
static void test_a_hundred_times_the_trace_is_not_winding_up_yet(void) {
	for (size_t f = 0; f < FORMS; f++) {
		for (int over = 0; over < 2; over++) {
			KOOP(health) health;
			const real zeta[4] = {0}, psi_next[3] = {0};
			estimator_settings(&e, 3, 1, &KOOP(reg_dz_ks), all_forms[f]);
			e.config.p0 = (real)0.25; /* a trace of 1 */
			estimator_start(&e);
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, over ? (real)25.1 : 25));
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			TEST_ASSERT_EQUAL_INT(over, health.winding_up);
		}
	}
}

/* Where none is given, the least zeta' zeta that carries information is 1e-10. */
static void test_sift_takes_what_is_above_the_least_information_by_default(void) {
	for (int f = 0; f < FORMS; f++) {
		for (int enough = 0; enough < 2; enough++) {
			const real zeta[2] = {(real)(enough ? 1.1e-5 : 0.9e-5), 0}, psi_next[1] = {1};
			KOOP(health) health;
			estimator_default(&e, 1, 1, &KOOP(reg_sift), all_forms[f]);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			TEST_ASSERT_EQUAL_INT(!enough, health.frozen);
			const real nothing[2] = {0};
			CHECK_STATUS(KOOP_OK, estimator_update(&e, nothing, psi_next, &health));
			TEST_ASSERT_EQUAL_INT(1, health.frozen);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_memory_shorter_than_the_unknowns_is_told);
	RUN_TEST(test_no_memory_is_short_where_only_a_part_is_forgotten);
	RUN_TEST(test_winding_up_is_told);
	RUN_TEST(test_follow_the_paper);
	RUN_TEST(test_reference_stays_symmetric_and_p_the_inverse_of_r);
	RUN_TEST(test_sift_forgets_strongly);
	RUN_TEST(test_covariance_without_theta);
	RUN_TEST(test_equal_batch_least_squares);
	RUN_TEST(test_dead_zones_gate_at_delta);
	RUN_TEST(test_constant_trace);
	RUN_TEST(test_constant_trace_far_below_p);
	RUN_TEST(test_sift_keeps_eigenvalues_bounded);
	RUN_TEST(test_sift_ignores_what_carries_no_information);
	RUN_TEST(test_sift_does_not_forget_what_is_not_excited);
	RUN_TEST(test_a_hundred_times_the_trace_is_not_winding_up_yet);
	RUN_TEST(test_sift_takes_what_is_above_the_least_information_by_default);
	return UNITY_END();
}
