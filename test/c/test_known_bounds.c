/* The bounds that an estimator keeps of what it has learned, by which it sees an overflow before it comes: no
 * element is ever beyond them, and they do not run away from what is there. */
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
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			const size_t N = 5, m = 2;
			estimator_settings(&e, N, m, all_regulators[r], all_forms[f]);
			e.config.lambda = (real)0.6;
			e.config.check = KOOP_CHECK_DIAGONAL;
			estimator_start(&e);
			for (int k = 0; k < 60; k++) {
				real zeta[MAX_D], psi_next[MAX_N];
				random_fill(&random, zeta, N + m, -3, 3);
				random_fill(&random, psi_next, N, -50, 50);
				estimator_update(&e, zeta, psi_next, NULL);
				check_bounds(k);
			}
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_no_element_is_beyond_its_bound);
	return UNITY_END();
}
