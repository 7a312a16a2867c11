/* Theta goes in, comes out, predicts, and what an update reports is true. */
#include "support.h"

enum { N = 5, M = 2, D = N + M };

static estimator e, other; /* of all tests: of two more, double precision would exceed the Cortex-M4F's RAM */

static void test_starts_from_nothing(void) {
	for (int f = 0; f < FORMS; f++) {
		learned start;
		estimator_settings(&e, N, M, &KOOP(reg_ef), all_forms[f]);
		e.config.p0 = 16; /* its root is exact */
		estimator_start(&e);
		learned_take(&start, &e);
		for (size_t i = 0; i < N * D; i++) { TEST_ASSERT_TRUE(fabs((double)start.theta[i]) <= 0); }
		for (size_t i = 0; i < D * D; i++) {
			const double expected = i % (D + 1) == 0 ? 16 : 0;
			TEST_ASSERT_TRUE(fabs((double)start.covariance[i] - expected) <= 0);
		}
	}
}

static void test_theta_round_trip(void) {
	random_source random = random_seed(21);
	for (int f = 0; f < FORMS; f++) {
		real theta[N * D], back[N * D];
		learned before, after;
		estimator_default(&e, N, M, &KOOP(reg_ef), all_forms[f]);
		learned_take(&before, &e);
		random_fill(&random, theta, N * D, -100, 100);
		theta[3] = -REAL_MIN / 4; /* a subnormal too */
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&e.rls, back));
		TEST_ASSERT_EQUAL_MEMORY(theta, back, sizeof theta);
		learned_take(&after, &e);
		TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
	}
}

static void test_theta_of_another_estimator(void) {
	random_source random = random_seed(23);
	real theta[N * D], back[N * D];
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	estimator_default(&other, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	random_fill(&random, theta, N * D, -100, 100);
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&other.rls, theta));
	CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&e.rls, other.rls.theta));
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&e.rls, back));
	TEST_ASSERT_EQUAL_MEMORY(theta, back, sizeof theta);
	TEST_ASSERT_TRUE(e.rls.theta_bound >= other.rls.theta_bound);
	other.rls.theta[D - 1] = (real)NAN;
	CHECK_STATUS(KOOP_E_INPUT, KOOP(rls_copy_theta)(&e.rls, other.rls.theta));
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&e.rls, back));
	TEST_ASSERT_EQUAL_MEMORY(theta, back, sizeof theta);
}

/* Wherever it is and whatever its sign; numbers that follow Theta in memory do not count. */
static void test_bound_of_theta_is_its_largest_element(void) {
	random_source random = random_seed(26);
	for (size_t at = 0; at < N * D; at++) {
		real theta[N * D + 1];
		const real size = (real)ldexp(1, (int)(at % 9) - 4);
		estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
		random_fill(&random, theta, N * D, -(double)size, (double)size);
		theta[at] = at % 2 ? 2 * size : -2 * size;
		theta[N * D] = 1000;
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		TEST_ASSERT_TRUE(e.rls.theta_bound >= 2 * size && e.rls.theta_bound <= 2 * size);
		e.rls.theta_bound = 0;
		CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&e.rls, e.rls.theta));
		TEST_ASSERT_TRUE(e.rls.theta_bound >= 2 * size && e.rls.theta_bound <= 2 * size);
	}
}

/* What stands in the padding of a copied Theta is not learned on: the fuzzer found that it grew until the
 * gate could not bring Theta back. */
static void test_padding_of_a_copy_is_zero(void) {
	random_source random = random_seed(23);
	real theta[3 * 4];
	estimator_default(&e, 1, 2, &KOOP(reg_ef), &KOOP(form_sqrt));
	TEST_ASSERT_EQUAL_size_t(4, e.rls.n_lifted_padded);
	random_fill(&random, theta, 3 * 4, 1, 2);
	CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&e.rls, theta));
	for (int k = 0; k < 10; k++) {
		real zeta[3];
		random_fill(&random, zeta, 3, -1, 1);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, zeta, NULL));
		for (int i = 0; i < 3 * 4; i++) { TEST_ASSERT_TRUE(i % 4 == 0 || fabs((double)e.rls.theta[i]) <= 0); }
	}
}

static void test_theta_that_is_not_finite_is_refused(void) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	real theta[N * D] = {0};
	learned before, after;
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	theta[4] = 7;
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
	learned_take(&before, &e);
	for (size_t i = 0; i < N * D; i++) {
		for (int v = 0; v < 3; v++) {
			real bad[N * D] = {0};
			bad[i] = (real)values[v];
			CHECK_STATUS(KOOP_E_INPUT, KOOP(rls_set_theta)(&e.rls, bad));
		}
	}
	learned_take(&after, &e);
	TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e));
}

static void test_predicts_theta_times_zeta(void) {
	random_source random = random_seed(22);
	for (size_t n_lifted = 1; n_lifted <= 13; n_lifted++) {
		const size_t m = 1 + n_lifted % 3, d = n_lifted + m;
		real theta[MAX_N * MAX_D], zeta[MAX_D], psi_next[MAX_N];
		estimator_default(&e, n_lifted, m, &KOOP(reg_ef), &KOOP(form_plain));
		random_fill(&random, theta, n_lifted * d, -2, 2);
		random_fill(&random, zeta, d, -2, 2);
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + n_lifted, psi_next));
		for (size_t i = 0; i < n_lifted; i++) {
			wide expected = 0;
			for (size_t j = 0; j < d; j++) { expected += (wide)theta[i * d + j] * (wide)zeta[j]; }
			/* d products of at most 4, each off by epsilon of the running sum */
			const wide tolerance = 4 * (wide)(d * d) * (wide)REAL_EPSILON;
			CHECK(fabs((wide)psi_next[i] - expected) <= tolerance, "%g instead of %g", (double)psi_next[i],
			      (double)expected);
		}
		/* in place */
		CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + n_lifted, zeta));
		TEST_ASSERT_EQUAL_MEMORY(psi_next, zeta, n_lifted * sizeof(real));
	}
}

static void test_prediction_refuses(void) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	real theta[N * D];
	for (size_t i = 0; i < N * D; i++) { theta[i] = 2; }
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
	for (size_t i = 0; i < D; i++) {
		real zeta[D] = {0}, psi_next[N] = {1, 2, 3, 4, 5};
		const real untouched[N] = {1, 2, 3, 4, 5};
		for (int v = 0; v < 3; v++) {
			zeta[i] = (real)values[v];
			CHECK_STATUS(KOOP_E_INPUT, KOOP(rls_predict)(&e.rls, zeta, zeta + N, psi_next));
		}
		zeta[i] = REAL_MAX;
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(rls_predict)(&e.rls, zeta, zeta + N, psi_next));
		TEST_ASSERT_EQUAL_MEMORY(untouched, psi_next, sizeof untouched);
	}
}

static void test_prediction_changes_nothing(void) {
	random_source random = random_seed(23);
	learned before, after;
	real zeta[D], psi_next[N];
	estimator_default(&e, N, M, &KOOP(reg_sift), &KOOP(form_sqrt));
	for (int k = 0; k < 10; k++) {
		random_fill(&random, zeta, D, -1, 1);
		random_fill(&random, psi_next, N, -1, 1);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	}
	learned_take(&before, &e);
	CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + N, psi_next));
	learned_take(&after, &e);
	TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e));
	TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
}

static void test_reset_keeps_theta(void) {
	random_source random = random_seed(24);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			learned before, after, start;
			real zeta[D], psi_next[N];
			estimator_default(&e, N, M, all_regulators[r], all_forms[f]);
			for (int k = 0; k < 30; k++) {
				random_fill(&random, zeta, D, -1, 1);
				random_fill(&random, psi_next, N, -1, 1);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			}
			learned_take(&before, &e);
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, e.config.p0));
			learned_take(&after, &e);
			TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e));

			/* from here on it is a new estimator that was given this Theta */
			estimator_default(&other, N, M, all_regulators[r], all_forms[f]);
			CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&other.rls, before.theta));
			for (int k = 0; k < 10; k++) {
				learned_take(&start, &other);
				CHECK(learned_same_covariance(&start, &after, &e), "%s step %d", estimator_name(&e), k);
				CHECK(learned_same_theta(&start, &after, &e), "%s step %d", estimator_name(&e), k);
				random_fill(&random, zeta, D, -1, 1);
				random_fill(&random, psi_next, N, -1, 1);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
				CHECK_STATUS(KOOP_OK, estimator_update(&other, zeta, psi_next, NULL));
				learned_take(&after, &e);
			}
		}
	}
}

static void test_health_of_an_accepted_sample(void) {
	random_source random = random_seed(25);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			int gated_count = 0;
			estimator_default(&e, N, M, all_regulators[r], all_forms[f]);
			for (int k = 0; k < 100; k++) {
				real zeta[D], psi_next[N], error[N];
				KOOP(health) health;
				learned before, after;
				const double scale = k % 4 == 0 ? 0.01 : 1;
				random_fill(&random, zeta, D, -scale, scale);
				random_fill(&random, psi_next, N, -0.1 * scale, 0.1 * scale);
				learned_take(&before, &e);
				CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
				learned_take(&after, &e);

				wide size = 0;
				for (size_t i = 0; i < N; i++) {
					wide predicted = 0;
					for (size_t j = 0; j < D; j++) {
						predicted += (wide)before.theta[i * D + j] * (wide)zeta[j];
					}
					error[i] = (real)((wide)psi_next[i] - predicted);
					size = fmax(size, fabs(predicted));
				}
				const wide tolerance = 8 * D * (wide)REAL_EPSILON * (size + norm(psi_next, N));
				CHECK(fabs((wide)health.innovation - norm(error, N)) <= tolerance, "%g instead of %g",
				      (double)health.innovation, (double)norm(error, N));

				const wide trace = trace_of(after.covariance, D);
				CHECK(fabs((wide)health.trace - trace) <= D * (wide)REAL_EPSILON * trace, "%g, not %g",
				      (double)health.trace, (double)trace);
				real least = after.covariance[0];
				for (size_t i = 0; i < D; i++) {
					if (after.covariance[i * D + i] < least) { least = after.covariance[i * D + i]; }
				}
				TEST_ASSERT_TRUE(memcmp(&least, &health.min_diagonal, sizeof least) == 0);
				TEST_ASSERT_EQUAL_INT(1, health.finite);
				TEST_ASSERT_EQUAL_INT(1, health.positive_definite);

				const int dead_zone =
				    e.config.regulator == &KOOP(reg_dz_cs) || e.config.regulator == &KOOP(reg_dz_ks);
				TEST_ASSERT_EQUAL_INT(dead_zone && health.innovation <= e.dead_zone.delta, health.frozen);
				TEST_ASSERT_EQUAL_INT(health.frozen, learned_same_covariance(&before, &after, &e));
				gated_count += health.frozen;
				if (!dead_zone) { continue; }
				CHECK(k < 99 || (gated_count > 10 && gated_count < 90), "gated %d", gated_count);
			}
		}
	}
}

/* What is given out ends where it should. */
static void test_nothing_is_written_behind_what_is_asked_for(void) {
	enum { BEHIND = MAX_D };
	for (size_t n_lifted = 1; n_lifted <= 9; n_lifted++) {
		const size_t m = 1 + n_lifted % 2, d = n_lifted + m;
		real theta[MAX_N * MAX_D], covariance[MAX_D * MAX_D], psi_next[MAX_N + BEHIND], zeta[MAX_D] = {0};
		estimator_default(&e, n_lifted, m, &KOOP(reg_ef), all_forms[n_lifted % FORMS]);
		for (size_t i = 0; i < BEHIND; i++) {
			theta[n_lifted * d + i] = covariance[d * d + i] = psi_next[n_lifted + i] = 7;
		}
		CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&e.rls, theta));
		CHECK_STATUS(KOOP_OK, KOOP(rls_get_covariance)(&e.rls, covariance));
		CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + n_lifted, psi_next));
		for (size_t i = 0; i < BEHIND; i++) {
			const real *const behind[] = {theta + n_lifted * d, covariance + d * d, psi_next + n_lifted};
			for (size_t k = 0; k < 3; k++) { TEST_ASSERT_TRUE(behind[k][i] >= 7 && behind[k][i] <= 7); }
		}
	}
}

/* Theta' as it is kept, with nothing but zeros in its padding, whatever lies behind what is given. */
static void test_theta_is_kept_with_zeros_in_its_padding(void) {
	random_source random = random_seed(27);
	for (size_t n_lifted = 1; n_lifted <= 9; n_lifted++) {
		const size_t m = 1 + n_lifted % 2, d = n_lifted + m, row = (n_lifted + 3) / 4 * 4;
		real theta[MAX_N * MAX_D];
		estimator_default(&e, n_lifted, m, &KOOP(reg_ef), &KOOP(form_sqrt));
		random_fill(&random, theta, MAX_N * MAX_D, 1, 2);
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
		for (size_t i = 0; i < (d + 1) / 2 * 2 * row; i++) {
			const size_t j = i / row, k = i % row;
			const real expected = j < d && k < n_lifted ? theta[k * d + j] : 0;
			TEST_ASSERT_EQUAL_MEMORY(&expected, &e.rls.theta[i], sizeof expected);
		}
	}
}

/* What is outside its storage, too. */
static void test_an_estimator_that_begins_again_is_as_a_new_one(void) {
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			random_source random = random_seed(26);
			estimator_default(&other, N, M, all_regulators[r], all_forms[f]);
			estimator_default(&e, N, M, all_regulators[r], all_forms[f]);
			e.dead_zone.delta = (real)0.01;
			estimator_teach(&e, &random, 30);
			e.rls.positive_definite = 0;
			e.rls.repaired = 5;
			e.rls.covariance_scale = 3;
			e.dead_zone.delta = other.dead_zone.delta;
			estimator_start(&e);
			TEST_ASSERT_EQUAL_MEMORY(other.rls.theta, e.rls.theta, e.rls.kept * sizeof(real));
			TEST_ASSERT_EQUAL_MEMORY(&other.rls.theta_bound, &e.rls.theta_bound, sizeof(real));
			TEST_ASSERT_EQUAL_MEMORY(&other.rls.covariance_bound, &e.rls.covariance_bound, sizeof(real));
			TEST_ASSERT_EQUAL_MEMORY(&other.rls.covariance_scale, &e.rls.covariance_scale, sizeof(real));
			TEST_ASSERT_EQUAL_INT(1, e.rls.positive_definite);
			TEST_ASSERT_EQUAL_size_t(0, e.rls.repaired);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_starts_from_nothing);
	RUN_TEST(test_theta_round_trip);
	RUN_TEST(test_theta_of_another_estimator);
	RUN_TEST(test_bound_of_theta_is_its_largest_element);
	RUN_TEST(test_padding_of_a_copy_is_zero);
	RUN_TEST(test_theta_that_is_not_finite_is_refused);
	RUN_TEST(test_predicts_theta_times_zeta);
	RUN_TEST(test_prediction_refuses);
	RUN_TEST(test_prediction_changes_nothing);
	RUN_TEST(test_reset_keeps_theta);
	RUN_TEST(test_health_of_an_accepted_sample);
	RUN_TEST(test_an_estimator_that_begins_again_is_as_a_new_one);
	RUN_TEST(test_nothing_is_written_behind_what_is_asked_for);
	RUN_TEST(test_theta_is_kept_with_zeros_in_its_padding);
	return UNITY_END();
}
