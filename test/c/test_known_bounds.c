/* The bounds that an estimator keeps of what it has learned, by which it sees an overflow before it comes: no
 * element is ever beyond them. */
#include "support.h"

static estimator e;

static double largest(const real *x, size_t count) {
	double most = 0;
	for (size_t i = 0; i < count; i++) { most = fmax(most, (double)fabs(x[i])); }
	return most;
}

/* How many reals the form keeps of P itself. */
static size_t kept_of_covariance(void) {
	return e.config.form == &KOOP(form_sqrt) ? KOOP_TRIANGLE(e.rls.n_regressors)
	                                         : KOOP_SYMMETRIC(e.rls.n_regressors);
}

static void check_bounds(int step) {
	const double allowed = 1 + 100 * (double)REAL_EPSILON;
	const double theta = largest(e.rls.theta, e.rls.n_regressors * e.rls.n_lifted_padded);
	const double covariance = largest(e.rls.covariance, kept_of_covariance());
	CHECK(theta <= (double)e.rls.theta_bound * allowed, "%s step %d: Theta %g beyond %g", estimator_name(&e),
	      step, theta, (double)e.rls.theta_bound);
	CHECK(covariance <= (double)e.rls.covariance_bound * allowed, "%s step %d: P %g beyond %g",
	      estimator_name(&e), step, covariance, (double)e.rls.covariance_bound);
}

static void test_no_element_is_beyond_its_bound(void) {
	random_source random = random_seed(41);
	for (int r = 0; r < 4 * REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			const size_t N = 5, m = 2;
			estimator_settings(&e, N, m, all_regulators[r / 4], all_forms[f]);
			e.config.lambda = r % 2 ? (real)0.6 : (real)0.02;
			e.config.p0 = r / 2 % 2 ? 10 : (real)1e-4;
			e.config.check = KOOP_CHECK_DIAGONAL;
			estimator_start(&e);
			for (int k = 0; k < 60; k++) {
				real zeta[MAX_D], psi_next[MAX_N];
				/* SIFt's P grows where it is small */
				const double size = exp2(random_uniform(&random, -9, 4)) / sqrt((double)e.config.p0);
				random_fill(&random, zeta, N + m, -size, size);
				random_fill(&random, psi_next, N, -50, 50);
				estimator_update(&e, zeta, psi_next, NULL);
				check_bounds(k);
			}
		}
	}
}

/* A gate keeps the bounds with what it keeps of the learner. */
static void test_a_gate_keeps_the_bounds_too(void) {
	static real storage[KOOP_GATE_REALS_PLAIN(MAX_N, MAX_M) + KOOP_EXTENSION_REALS_PLAIN(MAX_N, MAX_M)];
	random_source random = random_seed(42);
	for (int f = 0; f < FORMS; f++) {
		KOOP(gate) gate;
		estimator_settings(&e, 5, 2, &KOOP(reg_ef), all_forms[f]);
		e.config.check = KOOP_CHECK_REPORT;
		estimator_start(&e);
		for (int k = 0; k < 20; k++) {
			real zeta[MAX_D], psi_next[MAX_N];
			random_fill(&random, zeta, 7, -1, 1);
			random_fill(&random, psi_next, 5, -1, 1);
			estimator_update(&e, zeta, psi_next, NULL);
		}
		CHECK_STATUS(KOOP_OK,
		             KOOP(gate_init)(&gate, NULL, &e.rls, storage, sizeof storage / sizeof *storage));
		TEST_ASSERT_TRUE(gate.saved.theta_bound == e.rls.theta_bound);
		TEST_ASSERT_TRUE(gate.saved.covariance_bound == e.rls.covariance_bound);
		TEST_ASSERT_TRUE(gate.saved.covariance_scale == e.rls.covariance_scale);
		TEST_ASSERT_TRUE(gate.saved.positive_definite == e.rls.positive_definite);
	}
}

/* Theta that is set is as large as it is said to be, and what leaves it alone leaves its bound. */
static void test_bound_of_a_theta_that_is_set(void) {
	static estimator other;
	random_source random = random_seed(43);
	real theta[15];
	estimator_default(&e, 3, 2, &KOOP(reg_dz_ks), &KOOP(form_sqrt));
	estimator_default(&other, 3, 2, &KOOP(reg_ef), &KOOP(form_sqrt));
	TEST_ASSERT_TRUE(e.rls.theta_bound >= 0 && e.rls.theta_bound <= 0);
	for (size_t at = 0; at < 15; at++) {
		random_fill(&random, theta, 15, -1, 1);
		theta[at] = (real)(at % 2 ? -2 : 2);
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		TEST_ASSERT_TRUE(e.rls.theta_bound >= 2 && e.rls.theta_bound <= 2);
		CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&other.rls, e.rls.theta));
		TEST_ASSERT_TRUE(other.rls.theta_bound >= 2 && other.rls.theta_bound <= 2);
	}
}

static int decide_covariance_alone(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	step->update_theta = 0;
	return KOOP_OK;
}

static void test_theta_that_is_left_alone_keeps_its_bound(void) {
	const KOOP(regulator) own = {.name = "own", .decide = decide_covariance_alone, .forgets = 1};
	const real zeta[2] = {1, 2}, psi_next[1] = {100};
	for (int f = 0; f < FORMS; f++) {
		estimator_default(&e, 1, 1, &own, all_forms[f]);
		const real theta[2] = {3, 4};
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		for (int k = 0; k < 5; k++) {
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			TEST_ASSERT_TRUE(e.rls.theta_bound >= 4 && e.rls.theta_bound <= 4);
		}
	}
}

/* The largest element of Theta may come to just below half of the range. */
static void test_theta_may_be_below_half_of_the_range(void) {
	for (int half = 0; half < 2; half++) {
		for (int f = 0; f < FORMS; f++) {
			const real zeta[2] = {0}, psi_next[1] = {0};
			real theta[2] = {1, REAL_MAX / 2};
			if (!half) { theta[1] *= 1 - REAL_EPSILON; }
			estimator_default(&e, 1, 1, &KOOP(reg_ef), all_forms[f]);
			CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
			CHECK_STATUS(half ? KOOP_E_OVERFLOW : KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
		}
	}
}

/* A bound that has come to exactly that, of a Theta that is far from it. */
static void test_bound_at_half_of_the_range_is_looked_at(void) {
	const real zeta[2] = {0}, psi_next[1] = {0}, theta[2] = {1, -2};
	estimator_default(&e, 1, 1, &KOOP(reg_ef), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
	e.rls.theta_bound = REAL_MAX / 2;
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	TEST_ASSERT_TRUE(e.rls.theta_bound >= 2 && e.rls.theta_bound <= 2);
}

/* Theta goes to and fro by a twentieth of the range, and its bound grows with every step until it is looked
 * at again: no sample is refused for that. In the dead zone P, and with it the gain, stays as it is. */
static void test_loose_bound_of_theta_refuses_nothing(void) {
	const double root = sqrt((double)REAL_MAX);
	for (int f = 0; f < FORMS; f++) {
		estimator_settings(&e, 1, 1, &KOOP(reg_dz_cs), all_forms[f]);
		e.dead_zone.delta = (real)root;
		estimator_start(&e);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, REAL_MAX / 16));
		double travelled = 0, before = 0;
		for (int k = 0; k < 100; k++) {
			const real zeta[2] = {(real)(1 / root), 0},
			           psi_next[1] = {(real)(k % 2 ? -0.8 * root : 0.8 * root)};
			CHECK(estimator_update(&e, zeta, psi_next, NULL) == KOOP_OK, "%s step %d", estimator_name(&e), k);
			TEST_ASSERT_TRUE(e.rls.theta_bound < REAL_MAX / 2);
			check_bounds(k);
			travelled += fabs((double)e.rls.theta[0] / (double)REAL_MAX - before);
			before = (double)e.rls.theta[0] / (double)REAL_MAX;
		}
		CHECK(travelled > 4, "by %g of the range: the test is void", travelled);
	}
}

/* Far from the end of the range all of Theta is never looked at, which would take its time at every sample:
 * the bound only grows, while Theta goes to and fro. */
static void test_bound_of_theta_grows_by_each_step_alone(void) {
	for (int f = 0; f < FORMS; f++) {
		estimator_settings(&e, 1, 1, &KOOP(reg_ef), all_forms[f]);
		e.config.lambda = (real)0.5;
		estimator_start(&e);
		for (int k = 0; k < 50; k++) {
			const real zeta[2] = {1, (real)(k % 3)}, psi_next[1] = {(real)(k % 2 ? -1 : 1)},
			           before = e.rls.theta_bound;
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			TEST_ASSERT_TRUE(e.rls.theta_bound >= before);
		}
		const double theta = largest(e.rls.theta, e.rls.n_regressors * e.rls.n_lifted_padded);
		CHECK((double)e.rls.theta_bound > 4 * theta, "%g, Theta %g", (double)e.rls.theta_bound, theta);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_no_element_is_beyond_its_bound);
	RUN_TEST(test_a_gate_keeps_the_bounds_too);
	RUN_TEST(test_bound_of_a_theta_that_is_set);
	RUN_TEST(test_theta_that_is_left_alone_keeps_its_bound);
	RUN_TEST(test_theta_may_be_below_half_of_the_range);
	RUN_TEST(test_loose_bound_of_theta_refuses_nothing);
	RUN_TEST(test_bound_at_half_of_the_range_is_looked_at);
	RUN_TEST(test_bound_of_theta_grows_by_each_step_alone);
	return UNITY_END();
}
