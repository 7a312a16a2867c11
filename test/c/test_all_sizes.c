/* The estimator from one lifted state to many: sizes decide which loops of the kernels run. */
#include "reference.h"

static estimator e;

/* psi_next follows zeta, and the step is compared with the literal recursion. */
static void check_step(random_source *random, reference *paper, size_t d) {
	real zeta[MAX_D], psi_next[MAX_N];
	learned now;
	random_fill(random, zeta, d, -1, 1);
	random_fill(random, psi_next, e.dictionary.n_lifted, -1, 1);
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	(void)reference_update(paper, zeta, psi_next);
	learned_take(&now, &e);
	const double theta = relative_difference(now.theta, paper->theta, e.dictionary.n_lifted * d);
	const double P = relative_difference(now.covariance, paper->P, d * d);
	CHECK(theta <= 100 * (double)REAL_EPSILON, "%s, N %zu, d %zu: Theta %g", estimator_name(&e),
	      e.dictionary.n_lifted, d, theta);
	CHECK(P <= 300 * (double)REAL_EPSILON, "%s, N %zu, d %zu: P %g", estimator_name(&e),
	      e.dictionary.n_lifted, d, P);
}

static void test_every_size_follows_the_paper(void) {
	static reference paper;
	random_source random = random_seed(61);
	for (size_t N = 1; N <= MAX_N; N++) {
		for (size_t k = 0; k < MAX_M * FORMS * 2; k++) {
			const size_t m = 1 + k % MAX_M;
			estimator_default(&e, N, m, k < MAX_M * FORMS ? &KOOP(reg_ef) : &KOOP(reg_sift),
			                  all_forms[k / MAX_M % FORMS]);
			reference_start(&paper, &e);
			for (int step = 0; step < 3; step++) { check_step(&random, &paper, N + m); }
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_every_size_follows_the_paper);
	return UNITY_END();
}
