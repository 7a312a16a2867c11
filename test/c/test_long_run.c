/* A million steps per precision through everything that ends recursions in
 * practice. Each step is judged by a Cholesky of the test's own. */
#include "support.h"

#include <stdio.h>

enum { MOST_N = 4, M = 1, MOST_D = MOST_N + M, STEPS_PER_RUN = 9300, LAMBDAS = 3 };

static estimator e;
static size_t N, D;

typedef struct {
	int accepted, indefinite, overflow, resets, reported;
} tally;

enum { RICH, NOTHING, CONSTANT, DUPLICATED, TINY, PHASES };

static void next_regressor(random_source *random, int phase, int first, real *zeta) {
	switch (phase) {
	case NOTHING: memset(zeta, 0, D * sizeof(real)); break;
	case CONSTANT:
		if (first) { random_fill(random, zeta, D, -1, 1); }
		break;
	case DUPLICATED:
		random_fill(random, zeta, D, -1, 1);
		zeta[2] = zeta[1];
		zeta[3] = -zeta[1];
		break;
	case TINY: random_fill(random, zeta, D, -1e-6, 1e-6); break;
	default: random_fill(random, zeta, D, -1, 1); break;
	}
}

/* What must hold after a sample that was taken. */
static void check_accepted(const learned *now, const KOOP(health) *health, int step) {
	const int is_root = e.config.form == &KOOP(form_sqrt);
	TEST_ASSERT_EQUAL_INT(1, health->finite);
	for (size_t i = 0; i < N * D; i++) {
		CHECK(isfinite(now->theta[i]), "%s step %d", estimator_name(&e), step);
	}
	/* the root holds a P that has no room in this precision: then the getter says so */
	if (!now->covariance_fits) {
		CHECK(isinf(health->trace), "%s step %d: trace %g", estimator_name(&e), step, (double)health->trace);
		return;
	}
	CHECK(learned_is_finite(now, &e), "%s step %d: P is not finite", estimator_name(&e), step);

	/* rounding P = S S' to this precision may cost what S itself cannot lose */
	const int definite = is_root || is_positive_definite(now->covariance, D);
	if (is_root || e.config.check != KOOP_CHECK_REPORT) {
		for (size_t i = 0; i < D; i++) {
			CHECK(now->covariance[i * D + i] > 0, "%s step %d: diagonal", estimator_name(&e), step);
		}
	}
	if (e.config.check == KOOP_CHECK_REFUSE) {
		CHECK(definite, "%s step %d: P was lost unseen", estimator_name(&e), step);
		TEST_ASSERT_EQUAL_INT(1, health->positive_definite);
	}
	if (e.config.check == KOOP_CHECK_REPORT && !definite) {
		CHECK(!health->positive_definite, "%s step %d: the loss was not reported", estimator_name(&e), step);
	}
}

static void run(uint64_t seed, double lambda, tally *counts) {
	random_source random = random_seed(seed);
	real zeta[MOST_D], psi_next[MOST_N], theta_true[MOST_N * MOST_D];
	static learned states[2];
	learned *now = &states[0], *before = &states[1];
	int in_a_row = 0;

	e.config.lambda = (real)lambda;
	estimator_start(&e);
	learned_take(now, &e);
	random_fill(&random, theta_true, N * D, -1, 1);
	for (int k = 0, left = 0, phase = 0; k < STEPS_PER_RUN; k++, left--) {
		const int first = left == 0;
		if (first) {
			phase = (int)random_below(&random, PHASES);
			left = 50 + (int)random_below(&random, 1500);
		}
		next_regressor(&random, phase, first, zeta);
		for (size_t i = 0; i < N; i++) {
			psi_next[i] = random_uniform(&random, -0.01, 0.01);
			for (size_t j = 0; j < D; j++) { psi_next[i] += theta_true[i * D + j] * zeta[j]; }
		}

		KOOP(health) health;
		learned *const old = before;
		before = now;
		now = old;
		const int status = estimator_update(&e, zeta, psi_next, &health);
		learned_take(now, &e);
		if (status == KOOP_OK) {
			in_a_row = 0;
			counts->accepted++;
			counts->reported += !health.positive_definite;
			check_accepted(now, &health, k);
			continue;
		}
		CHECK(status == KOOP_E_INDEFINITE || status == KOOP_E_OVERFLOW, "%s step %d: status %d",
		      estimator_name(&e), k, status);
		CHECK(learned_same_theta(before, now, &e), "%s step %d", estimator_name(&e), k);
		CHECK(learned_same_covariance(before, now, &e), "%s step %d", estimator_name(&e), k);
		TEST_ASSERT_EQUAL_INT(status != KOOP_E_OVERFLOW, health.finite);
		if (status == KOOP_E_INDEFINITE) { TEST_ASSERT_EQUAL_INT(0, health.positive_definite); }
		counts->indefinite += status == KOOP_E_INDEFINITE;
		counts->overflow += status == KOOP_E_OVERFLOW;

		/* what the header recommends when refusals do not stop */
		if (++in_a_row == 30) {
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, e.config.p0));
			learned_take(now, &e);
			counts->resets++;
			in_a_row = 0;
		}
	}
}

static void run_all(int form, int check, tally total[REGULATORS]) {
	static const double lambdas[LAMBDAS] = {0.8, 0.95, 0.995};
	for (int r = 0; r < REGULATORS; r++) {
		memset(&total[r], 0, sizeof total[r]);
		for (int l = 0; l < (TEST_SHARE > 1 ? 1 : LAMBDAS); l++) {
			N = l == 0 ? 3 : 4; /* d = 4 fills its rows, 5 leaves padding */
			D = N + M;
			estimator_settings(&e, N, M, all_regulators[r], all_forms[form]);
			e.config.check = check;
			e.dead_zone.delta = (real)0.005;
			run((uint64_t)(60 + l), lambdas[l], &total[r]);
		}
		printf("%-22s accepted %5d, indefinite %5d, overflow %5d, resets %3d, reported lost %5d\n",
		       estimator_name(&e), total[r].accepted, total[r].indefinite, total[r].overflow, total[r].resets,
		       total[r].reported);
	}
}

enum { EF = 1 };

static void test_plain_refusing(void) {
	tally total[REGULATORS];
	run_all(0, KOOP_CHECK_REFUSE, total);
	/* or the run was too kind to prove anything */
	TEST_ASSERT_TRUE(total[EF].indefinite > 0);
	for (int r = 0; r < REGULATORS; r++) { TEST_ASSERT_EQUAL_INT(0, total[r].reported); }
}

static void test_plain_reporting(void) {
	tally total[REGULATORS];
	run_all(0, KOOP_CHECK_REPORT, total);
	TEST_ASSERT_TRUE(total[EF].reported > 0);
}

static void test_plain_watching_the_diagonal(void) {
	tally total[REGULATORS];
	run_all(0, KOOP_CHECK_DIAGONAL, total);
	TEST_ASSERT_TRUE(total[EF].accepted > 0);
}

static void test_sqrt(void) {
	for (int check = 0; check < 3; check++) {
		tally total[REGULATORS];
		run_all(1, check, total);
		for (int r = 0; r < REGULATORS; r++) { TEST_ASSERT_EQUAL_INT(0, total[r].reported); }
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_plain_refusing);
	RUN_TEST(test_plain_reporting);
	RUN_TEST(test_plain_watching_the_diagonal);
	RUN_TEST(test_sqrt);
	return UNITY_END();
}
