/* A bad sample is refused with the right status, leaves no trace, and shows in the health. */
#include "support.h"

enum { N = 4, M = 2, D = N + M };

/* both see the same samples, but only `seen` the bad ones */
static estimator seen, twin;

static void good_sample(random_source *random, real *zeta, real *psi_next) {
	random_fill(random, zeta, D, -1, 1);
	for (int i = 0; i < N; i++) { psi_next[i] = zeta[i + 1] / 2 - zeta[i]; }
}

static void both_learn(random_source *random, int steps) {
	for (int k = 0; k < steps; k++) {
		real zeta[D], psi_next[N];
		good_sample(random, zeta, psi_next);
		const int status = estimator_update(&seen, zeta, psi_next, NULL);
		const int twins = estimator_update(&twin, zeta, psi_next, NULL);
		CHECK(status == twins, "%s: %d, its twin %d", estimator_name(&seen), status, twins);
		CHECK(status == KOOP_OK, "%s: good sample refused with %d", estimator_name(&seen), status);
	}
}

static void check_twins(const char *when) {
	learned a, b;
	learned_take(&a, &seen);
	learned_take(&b, &twin);
	CHECK(learned_same_theta(&a, &b, &seen), "%s: Theta, %s", estimator_name(&seen), when);
	CHECK(learned_same_covariance(&a, &b, &seen), "%s: P, %s", estimator_name(&seen), when);
}

static void start_twins(random_source *random, int r, int f, int check) {
	estimator_settings(&seen, N, M, all_regulators[r], all_forms[f]);
	seen.config.check = check;
	estimator_start(&seen);
	estimator_settings(&twin, N, M, all_regulators[r], all_forms[f]);
	twin.config.check = check;
	estimator_start(&twin);
	both_learn(random, 20);
}

static void check_health_of_refusal(const KOOP(health) *health, int finite, int positive_definite) {
	learned now;
	learned_take(&now, &seen);
	const wide trace = trace_of(now.covariance, D);
	TEST_ASSERT_EQUAL_INT(finite, health->finite);
	TEST_ASSERT_EQUAL_INT(positive_definite, health->positive_definite);
	TEST_ASSERT_EQUAL_INT(0, health->frozen);
	/* of P as it was kept */
	CHECK(fabs((wide)health->trace - trace) <= D * (wide)REAL_EPSILON * trace, "%g", (double)health->trace);
	real least = now.covariance[0];
	for (int i = 0; i < D; i++) {
		if (now.covariance[i * D + i] < least) { least = now.covariance[i * D + i]; }
	}
	TEST_ASSERT_TRUE(memcmp(&least, &health->min_diagonal, sizeof least) == 0);
}

static void test_input_that_is_not_finite(void) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	random_source random = random_seed(51);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			start_twins(&random, r, f, KOOP_CHECK_REFUSE);
			for (int position = 0; position < D + N; position++) {
				for (int v = 0; v < 3; v++) {
					real sample[D + N];
					KOOP(health) health;
					good_sample(&random, sample, sample + D);
					sample[position] = (real)values[v];
					CHECK_STATUS(KOOP_E_INPUT, estimator_update(&seen, sample, sample + D, &health));
					check_health_of_refusal(&health, 0, 1);
					TEST_ASSERT_TRUE(!isfinite(health.innovation));
					check_twins("at once");
				}
				both_learn(&random, 2);
				check_twins("later");
			}
		}
	}
}

/* A bad value that a zero column of Theta would hide from the innovation. */
static void test_input_that_theta_does_not_see(void) {
	for (int f = 0; f < FORMS; f++) {
		real zeta[D] = {0}, psi_next[N] = {0};
		estimator_default(&seen, N, M, &KOOP(reg_dz_ks), all_forms[f]);
		for (int i = 0; i < D; i++) {
			zeta[i] = (real)INFINITY;
			CHECK_STATUS(KOOP_E_INPUT, estimator_update(&seen, zeta, psi_next, NULL));
			zeta[i] = (real)NAN;
			CHECK_STATUS(KOOP_E_INPUT, estimator_update(&seen, zeta, psi_next, NULL));
			zeta[i] = 0;
		}
	}
}

/* Huge values in any place: taken if the result is finite, else refused without
 * a trace. A huge regressor that was taken must not cost the samples after it;
 * a huge psi_next may, since it makes Theta huge. */
static void test_huge_input(void) {
	random_source random = random_seed(52);
	const double root = sqrt((double)REAL_MAX);
	const double values[] = {
	    1e4, root / 1e4, root / 30, root / 2, root, 1e4 * root, (double)REAL_MAX / 1e4, (double)REAL_MAX};
	int refused = 0, taken = 0;
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			for (int check = 0; check < 3; check++) {
				for (int v = 0; v < 8; v++) {
					for (int position = 0; position <= D + N; position++) {
						real sample[D + N];
						KOOP(health) health;
						learned now;
						start_twins(&random, r, f, check);
						good_sample(&random, sample, sample + D);
						if (position < D + N) {
							sample[position] = (real)(position % 2 ? -values[v] : values[v]);
						} else { /* every regressor */
							for (int i = 0; i < D; i++) { sample[i] *= (real)(values[v] / 4); }
						}
						const int status = estimator_update(&seen, sample, sample + D, &health);
						learned_take(&now, &seen);
						CHECK(learned_is_finite(&now, &seen), "%s, %g at %d", estimator_name(&seen),
						      values[v], position);
						if (status == KOOP_OK) {
							taken++;
							TEST_ASSERT_EQUAL_INT(1, health.finite);
							const int in_psi_next = position >= D && position < D + N;
							for (int k = 0; k < 3 && !in_psi_next; k++) {
								good_sample(&random, sample, sample + D);
								const int next = estimator_update(&seen, sample, sample + D, NULL);
								CHECK(next != KOOP_E_OVERFLOW, "%s, after %g at %d", estimator_name(&seen),
								      values[v], position);
							}
							continue;
						}
						refused++;
						CHECK(status == KOOP_E_OVERFLOW || status == KOOP_E_INDEFINITE, "%s: %d",
						      estimator_name(&seen), status);
						check_health_of_refusal(&health, status != KOOP_E_OVERFLOW,
						                        status != KOOP_E_INDEFINITE);
						check_twins("at once");
						both_learn(&random, 3);
						check_twins("later");
					}
				}
			}
		}
	}
	CHECK(refused > 1000 && taken > 1000, "%d refused, %d taken", refused, taken);
}

/* Largest values everywhere: nothing in between may turn into NaN unseen. */
static void test_largest_input(void) {
	random_source random = random_seed(53);
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			real sample[D + N];
			start_twins(&random, r, f, KOOP_CHECK_REFUSE);
			for (int i = 0; i < D + N; i++) { sample[i] = i % 2 ? REAL_MAX : -REAL_MAX; }
			CHECK_STATUS(KOOP_E_OVERFLOW, estimator_update(&seen, sample, sample + D, NULL));
			check_twins("at once");
			both_learn(&random, 5);
			check_twins("later");
		}
	}
}

/* SIFt in the plain form keeps P^-1 beside P. It grows where P shrinks, and
 * must not overflow unseen either. */
static void test_information_does_not_overflow(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(54);
		estimator_settings(&seen, N, M, &KOOP(reg_sift), all_forms[f]);
		seen.config.lambda = (real)0.98;
		seen.config.p0 = 1;
		estimator_start(&seen);
		real zeta[D] = {0}, psi_next[N] = {0};
		int refused = 0, taken = 0;
		/* step by step, since round-off ends the plain form if P shrinks at once */
		const double top = sqrt((double)REAL_MAX);
		for (double large = 1; large < top; large *= 2) {
			for (int i = 0; i < D; i++) {
				zeta[i] = (real)large;
				const int status = estimator_update(&seen, zeta, psi_next, NULL);
				CHECK(status == KOOP_OK || status == KOOP_E_OVERFLOW, "%d", status);
				refused += status != KOOP_OK;
				taken += status == KOOP_OK;
				zeta[i] = 0;
			}
		}
		CHECK(refused > 10 && taken > 10, "%d refused, %d taken", refused, taken);
		good_sample(&random, zeta, psi_next);
		const int status = estimator_update(&seen, zeta, psi_next, NULL);
		CHECK(status == KOOP_OK, "%s: %d after %d refusals", estimator_name(&seen), status, refused);
	}
}

/* A covariance at the ends of the range, after a reset: refused or right, never zero or infinite. */
static void test_reset_to_the_ends_of_the_range(void) {
	const double starts[] = {(double)REAL_MAX / 2.5, (double)REAL_MAX / 1e3, (double)REAL_MIN * 1e3,
	                         (double)REAL_MIN};
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			for (int check = 0; check < 3; check++) {
				for (int s = 0; s < 4; s++) {
					const real zeta[D] = {(real)1e-3, (real)-1e-3, (real)2e-3, 0, (real)1e-3, 0};
					const real psi_next[N] = {1, 1, 1, 1};
					learned now;
					estimator_settings(&seen, N, M, all_regulators[r], all_forms[f]);
					seen.config.check = check;
					estimator_start(&seen);
					CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, (real)starts[s]));
					for (int k = 0; k < 3; k++) {
						const int status = estimator_update(&seen, zeta, psi_next, NULL);
						learned_take(&now, &seen);
						TEST_ASSERT_TRUE(now.covariance_fits);
						CHECK(learned_is_finite(&now, &seen), "%s from %g: status %d, P[0][0] = %g",
						      estimator_name(&seen), starts[s], status, (double)now.covariance[0]);
						/* one that adds to P^-1 beyond what the plain form can resolve has it reported */
						const int reported = check == KOOP_CHECK_REPORT && !seen.rls.positive_definite;
						for (int i = 0; i < D; i++) {
							CHECK(reported || now.covariance[i * D + i] > 0, "%s from %g: status %d, P[%d][%d] = %g",
							      estimator_name(&seen), starts[s], status, i, i,
							      (double)now.covariance[i * D + i]);
						}
					}
				}
			}
		}
	}
}

/* A constant regressor under exponential forgetting ends the plain form. */
static void test_loss_of_positive_definiteness(void) {
	random_source random = random_seed(55);
	for (int check = 0; check < 2; check++) {
		int status = KOOP_OK, k = 0;
		KOOP(health) health;
		learned before, after;
		real zeta[D], psi_next[N];
		start_twins(&random, 1, 0, check);
		good_sample(&random, zeta, psi_next);
		for (; k < 3000; k++) {
			learned_take(&before, &seen);
			status = estimator_update(&seen, zeta, psi_next, &health);
			if (!health.positive_definite) { break; }
			CHECK_STATUS(KOOP_OK, status);
			CHECK_STATUS(KOOP_OK, estimator_update(&twin, zeta, psi_next, NULL));
		}
		CHECK(k < 3000, "never lost in %d steps", k);
		if (check == KOOP_CHECK_REPORT) {
			CHECK_STATUS(KOOP_OK, status);
			TEST_ASSERT_EQUAL_INT(1, health.finite);
			learned_take(&after, &seen);
			TEST_ASSERT_TRUE(!learned_same_covariance(&before, &after, &seen));
		} else {
			CHECK_STATUS(KOOP_E_INDEFINITE, status);
			check_health_of_refusal(&health, 1, 0);
			check_twins("at once");
		}
		/* the way on */
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, seen.config.p0));
		CHECK_STATUS(KOOP_OK, estimator_update(&seen, zeta, psi_next, &health));
		TEST_ASSERT_EQUAL_INT(1, health.positive_definite);
	}
}

/* Theta at the top of the range and an error that pushes it over. */
static void test_theta_does_not_overflow(void) {
	const double root = sqrt((double)REAL_MAX);
	for (int f = 0; f < FORMS; f++) {
		const real zeta[D] = {(real)(4 / root)}, psi_next[N] = {(real)(4.25 * root)};
		real theta[N * D] = {REAL_MAX};
		KOOP(health) health;
		learned before, after;
		estimator_default(&seen, N, M, &KOOP(reg_ef), all_forms[f]);
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&seen.rls, theta));
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, REAL_MAX / 16));
		learned_take(&before, &seen);
		CHECK_STATUS(KOOP_E_OVERFLOW, estimator_update(&seen, zeta, psi_next, &health));
		learned_take(&after, &seen);
		TEST_ASSERT_TRUE(isfinite(health.innovation));
		TEST_ASSERT_EQUAL_INT(0, health.finite);
		TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &seen));
		TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &seen));
	}
}

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form, double lambda, double tau0) {
	estimator_settings(&seen, N, M, regulator, form);
	seen.config.lambda = (real)lambda;
	seen.trace.tau0 = (real)tau0;
	estimator_start(&seen);
}

/* The sample along the first regressor is refused and leaves storage as it was, scratch aside. */
static void check_refused(int status, real regressor) {
	const real zeta[D] = {regressor}, psi_next[N] = {1};
	learned before, after;
	KOOP(health) health;
	learned_take(&before, &seen);
	CHECK_STATUS(status, estimator_update(&seen, zeta, psi_next, &health));
	TEST_ASSERT_EQUAL_INT(status != KOOP_E_OVERFLOW, health.finite);
	TEST_ASSERT_EQUAL_INT(status != KOOP_E_INDEFINITE, health.positive_definite);
	learned_take(&after, &seen);
	CHECK(learned_same_theta(&before, &after, &seen), "%s: Theta", estimator_name(&seen));
	CHECK(learned_same_covariance(&before, &after, &seen), "%s: P", estimator_name(&seen));
}

/* Forgetting without excitation: P grows until it is refused. The root goes on for as long again. */
static void test_covariance_that_outgrows_the_range(void) {
	int updates[FORMS];
	for (int f = 0; f < FORMS; f++) {
		const real zeta[D] = {0}, psi_next[N] = {0};
		real covariance[D * D];
		int status = KOOP_OK;
		start(&KOOP(reg_ef), all_forms[f], 0.01, 0);
		for (updates[f] = 0; status == KOOP_OK && updates[f] < 1000; updates[f]++) {
			status = estimator_update(&seen, zeta, psi_next, NULL);
		}
		CHECK_STATUS(KOOP_E_OVERFLOW, status);
		check_refused(KOOP_E_OVERFLOW, 0);
		for (size_t i = 0; i < KOOP_TRIANGLE(D); i++) { TEST_ASSERT_TRUE(isfinite(seen.rls.covariance[i])); }
		CHECK_STATUS(all_forms[f] == &KOOP(form_sqrt) ? KOOP_E_OVERFLOW : KOOP_OK,
		             KOOP(rls_get_covariance)(&seen.rls, covariance));
	}
	CHECK(updates[1] > 2 * updates[0] - 4, "%d updates, root %d", updates[0], updates[1]);
}

/* The root would shrink by lambda over a denominator that it vanishes in. */
static void test_forgetting_factor_lost_in_the_denominator(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt), (double)REAL_MIN, 0);
	check_refused(KOOP_E_INDEFINITE, (real)1e10);
}

/* A constant trace so far below that of P that to scale P to it would leave nothing. */
static void test_trace_far_below_that_of_the_covariance(void) {
	for (int f = 0; f < FORMS; f++) {
		const double trace = 1e4 * (double)REAL_MIN; /* Helium's vectors know no denormal numbers */
		start(&KOOP(reg_ct), all_forms[f], 0.95, trace);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, REAL_MAX / 16));
		check_refused(KOOP_E_INDEFINITE, 0);
		check_refused(KOOP_E_INDEFINITE, (real)1e-3);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, (real)trace));
		const real zeta[D] = {1}, psi_next[N] = {1};
		CHECK_STATUS(KOOP_OK, estimator_update(&seen, zeta, psi_next, NULL));
	}
}

/* A trace near the bottom of the range, once all of it lies along a regressor that is then excited: the
 * squares of the root that is left underflow. The fuzzer found it: P became NaN. */
static void test_trace_that_underflows(void) {
	for (int f = 0; f < FORMS; f++) {
		for (int exponent = ilogb((double)REAL_MAX); exponent > 0; exponent--) {
			start(&KOOP(reg_ct), all_forms[f], 0.95, 1e4 * (double)REAL_MIN);
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, seen.rls.nominal_trace));
			for (int i = D; i-- > 0;) {
				real zeta[D] = {0};
				const real psi_next[N] = {0};
				zeta[i] = (real)ldexp(1, exponent);
				for (int k = 0; k < 5; k++) {
					learned now;
					const int status = estimator_update(&seen, zeta, psi_next, NULL);
					learned_take(&now, &seen);
					CHECK(learned_is_finite(&now, &seen), "%s, regressor %d of 2^%d: status %d",
					      estimator_name(&seen), i, exponent, status);
				}
			}
		}
	}
}

/* A fault of memory that turns P over: the sample is refused, whatever the check, since no trace can be kept.
 */
static void test_trace_that_is_negative(void) {
	for (int check = 0; check < 3; check++) {
		estimator_settings(&seen, N, M, &KOOP(reg_ct), &KOOP(form_plain));
		seen.config.check = check;
		estimator_start(&seen);
		for (size_t i = 0; i < KOOP_SYMMETRIC(D); i++) { seen.rls.covariance[i] *= -1; }
		check_refused(KOOP_E_INDEFINITE, (real)1e-3);
	}
}

/* What a sample tells underflows, beside a P at the top of the range: SIFt cannot divide by that. */
static void test_information_does_not_underflow(void) {
	for (int f = 0; f < FORMS; f++) {
		estimator_settings(&seen, N, M, &KOOP(reg_sift), all_forms[f]);
		seen.floor.eps_sift = REAL_MIN;
		estimator_start(&seen);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, REAL_MAX / 4));
		check_refused(KOOP_E_INDEFINITE, (real)1e-12);
	}
}

/* A gated sample says of P what is known of it, and a reset clears that. */
static void test_reset_clears_the_report(void) {
	random_source random = random_seed(56);
	real zeta[D], psi_next[N] = {0};
	KOOP(health) health = {.positive_definite = 1, .finite = 1};
	estimator_settings(&seen, N, M, &KOOP(reg_dz_ks), &KOOP(form_plain));
	seen.config.check = KOOP_CHECK_REPORT;
	estimator_start(&seen);
	random_fill(&random, zeta, D, -1, 1);
	for (int k = 0; k < 3000 && health.positive_definite; k++) {
		psi_next[0] = k % 2 ? 9 : -9; /* never within the dead zone */
		CHECK_STATUS(KOOP_OK, estimator_update(&seen, zeta, psi_next, &health));
	}
	TEST_ASSERT_EQUAL_INT(0, health.positive_definite);

	CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&seen.rls, zeta, zeta + N, psi_next));
	CHECK_STATUS(KOOP_OK, estimator_update(&seen, zeta, psi_next, &health));
	TEST_ASSERT_EQUAL_INT(1, health.frozen);
	TEST_ASSERT_EQUAL_INT(0, health.positive_definite);

	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&seen.rls, 1));
	CHECK_STATUS(KOOP_OK, estimator_update(&seen, zeta, psi_next, &health));
	TEST_ASSERT_EQUAL_INT(1, health.frozen);
	TEST_ASSERT_EQUAL_INT(1, health.positive_definite);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_input_that_is_not_finite);
	RUN_TEST(test_input_that_theta_does_not_see);
	RUN_TEST(test_huge_input);
	RUN_TEST(test_largest_input);
	RUN_TEST(test_information_does_not_overflow);
	RUN_TEST(test_reset_to_the_ends_of_the_range);
	RUN_TEST(test_loss_of_positive_definiteness);
	RUN_TEST(test_theta_does_not_overflow);
	RUN_TEST(test_covariance_that_outgrows_the_range);
	RUN_TEST(test_forgetting_factor_lost_in_the_denominator);
	RUN_TEST(test_trace_far_below_that_of_the_covariance);
	RUN_TEST(test_trace_that_underflows);
	RUN_TEST(test_trace_that_is_negative);
	RUN_TEST(test_information_does_not_underflow);
	RUN_TEST(test_reset_clears_the_report);
	return UNITY_END();
}
