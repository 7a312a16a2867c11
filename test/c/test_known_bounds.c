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
	static real storage[KOOP_GATE_REALS_PLAIN(MAX_N, MAX_M)];
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

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_no_element_is_beyond_its_bound);
	RUN_TEST(test_a_gate_keeps_the_bounds_too);
	return UNITY_END();
}
