/* How far P may grow and shrink, and how close it may come to being singular: then an update is refused. */
#include "support.h"

static estimator e;

/* As many updates with this regressor as are taken, up to `most`; the innovation is nothing. */
static int updates_taken(real psi, real u, int most, int *status) {
	const real zeta[2] = {psi, u}, psi_next[1] = {0};
	int taken = 0;
	do { *status = estimator_update(&e, zeta, psi_next, NULL); } while (*status == KOOP_OK && ++taken < most);
	return taken;
}

static void begin(const KOOP(regulator) *regulator, const KOOP(form) *form, real lambda, real p0, int check) {
	estimator_settings(&e, 1, 1, regulator, form);
	e.config.lambda = lambda;
	e.config.p0 = p0;
	e.trace.tau0 = 1;
	e.config.check = check;
	estimator_start(&e);
}

/* Forgetting makes P four times as large where nothing is excited, and its root twice. */
static void test_unexcited_covariance_grows_to_half_of_the_range(void) {
	const int exponent = TEST_DOUBLE ? DBL_MAX_EXP : FLT_MAX_EXP;
	int status;
	begin(&KOOP(reg_ef), &KOOP(form_sqrt), (real)0.25, 1, KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(exponent - 2, updates_taken(1, 0, 5000, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	for (int odd = 0; odd < 2; odd++) {
		begin(&KOOP(reg_ef), &KOOP(form_plain), (real)0.25, (real)(1 + odd), KOOP_CHECK_DIAGONAL);
		TEST_ASSERT_EQUAL_INT(exponent / 2 - 1 - odd, updates_taken(1, 0, 5000, &status));
		TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	}
}

/* One element of the root is at the end of the range after the first sample, and beyond it after the second.
 */
static void test_root_does_not_underflow(void) {
	int status;
	const real far = (real)(exp2(-0.4) / (double)REAL_MIN);
	begin(&KOOP(reg_none), &KOOP(form_sqrt), 1, REAL_MIN, KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(1, updates_taken(far, 0, 10, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
	begin(&KOOP(reg_none), &KOOP(form_sqrt), 1, REAL_MIN, KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(1, updates_taken(0, far, 10, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
}

/* SIFt adds to P: as much again as it was, and the bound of what becomes of it is four times that. */
static void test_covariance_that_forgetting_would_lift_beyond_half_of_the_range(void) {
	int status;
	begin(&KOOP(reg_sift), &KOOP(form_plain), (real)0.5, REAL_MAX / 7, KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(0, updates_taken((real)0.9, 0, 1, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	begin(&KOOP(reg_sift), &KOOP(form_plain), (real)0.5, REAL_MAX / 9, KOOP_CHECK_DIAGONAL);
	(void)updates_taken((real)0.9, 0, 1, &status);
	TEST_ASSERT_TRUE(status != KOOP_E_OVERFLOW);
}

/* What a sample leaves of P's largest element is less than a rounding of it, and so nothing. */
static void test_diagonal_that_cancels_is_refused(void) {
	int status;
	begin(&KOOP(reg_none), &KOOP(form_plain), 1, (real)exp2(60), KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(0, updates_taken(1, 0, 1, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
}

/* After one sample of two equal regressors P is close to singular. What is taken stays positive definite with
 * a rounding less of its diagonal: so it is by itself, and not by the luck of how it was rounded. */
static void test_definite_by_less_than_a_rounding_is_refused(void) {
	int refused = 0;
	for (double part = 0.01; part < 100; part *= 1.03) {
		int status;
		real P[4];
		begin(&KOOP(reg_none), &KOOP(form_plain), 1, (real)(part / (double)REAL_EPSILON), KOOP_CHECK_REFUSE);
		(void)updates_taken(1, 1, 1, &status);
		CHECK(status == KOOP_OK || part > 0.1, "%g / epsilon: status %d", part, status);
		refused += status == KOOP_E_INDEFINITE;
		CHECK_STATUS(KOOP_OK, KOOP(rls_get_covariance)(&e.rls, P));
		P[0] *= 1 - REAL_EPSILON;
		P[3] *= 1 - REAL_EPSILON;
		CHECK(is_positive_definite(P, 2), "%g / epsilon", part);
	}
	CHECK(refused > 10, "%d", refused);
}

/* Each update makes the bound of P looser, until it is looked at again: no sample is refused for that. */
static void test_loose_bound_refuses_nothing(void) {
	for (int f = 0; f < FORMS; f++) {
		begin(&KOOP(reg_ef), all_forms[f], (real)0.25, 1, KOOP_CHECK_DIAGONAL);
		for (int k = 0; k < 3000; k++) {
			int status;
			CHECK(updates_taken(k % 2 ? 1 : (real)0.3, k % 2 ? (real)0.2 : 1, 1, &status) == 1,
			      "%s step %d: status %d", estimator_name(&e), k, status);
		}
	}
	const real p0 = (real)((double)REAL_MAX / 4.5), psi = (real)sqrt(10 / (double)p0);
	int status;
	begin(&KOOP(reg_none), &KOOP(form_plain), 1, p0, KOOP_CHECK_DIAGONAL);
	TEST_ASSERT_EQUAL_INT(1, updates_taken(psi, 0, 1, &status));
	TEST_ASSERT_EQUAL_INT(1, updates_taken(0, psi, 1, &status));
}

/* zeta' P zeta may be a quarter of the range. */
static void test_denominator_at_the_end_of_the_range(void) {
	for (int k = 0; k < 10; k++) {
		const double part = 0.2 + 0.01 * k + 0.001;
		int status;
		begin(&KOOP(reg_none), &KOOP(form_sqrt), 1, 1, KOOP_CHECK_DIAGONAL);
		(void)updates_taken((real)sqrt(part * (double)REAL_MAX), 0, 1, &status);
		CHECK_STATUS(part < 0.25 ? KOOP_OK : KOOP_E_OVERFLOW, status);
	}
}

/* P as it should never be: a sample that would divide by nothing tells that P is indefinite. */
static void test_denominator_of_nothing(void) {
	int status;
	begin(&KOOP(reg_none), &KOOP(form_plain), 1, 1, KOOP_CHECK_DIAGONAL);
	e.rls.covariance[0] = -1;
	TEST_ASSERT_EQUAL_INT(0, updates_taken(1, 0, 1, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
}

/* An indefinite P whose denominator is negative: refused, but where the caller wants the paper's recursion.
 */
static void test_negative_denominator_is_refused_or_reported(void) {
	for (int check = 0; check < 3; check++) {
		const real zeta[2] = {1, 0}, psi_next[1] = {2};
		begin(&KOOP(reg_none), &KOOP(form_plain), 1, 1, check);
		e.rls.covariance[0] = -3;
		const int status = estimator_update(&e, zeta, psi_next, NULL);
		CHECK_STATUS(check == KOOP_CHECK_REPORT ? KOOP_OK : KOOP_E_INDEFINITE, status);
		const double expected =
		    status == KOOP_OK ? 2 * -3 / (1 - 3.0) : 0; /* by hand: error P zeta / (1 + s) */
		CHECK(fabs((double)e.rls.theta[0] - expected) <= 4 * (double)REAL_EPSILON * expected, "check %d: %g",
		      check, (double)e.rls.theta[0]);
	}
}

/* The factor that brings the trace back is in range, but not what it has to make up for besides. */
static void test_trace_that_cannot_be_brought_back(void) {
	const double range = TEST_DOUBLE ? DBL_MAX_EXP : FLT_MAX_EXP;
	for (int far = 0; far < 2; far++) {
		int status;
		estimator_settings(&e, 1, 1, &KOOP(reg_ct), &KOOP(form_sqrt));
		e.config.p0 = (real)exp2(range / 6);
		e.trace.tau0 = (real)exp2(range - 5);
		estimator_start(&e);
		(void)updates_taken(far ? (real)exp2(range / 12) : (real)exp2(-range / 6), 0, 1, &status);
		CHECK_STATUS(far ? KOOP_E_OVERFLOW : KOOP_OK, status);
	}
}

/* The trace is kept whatever is forgotten: 1 / lambda is no part of it, and need not fit the range. */
static void test_constant_trace_with_strong_forgetting(void) {
	for (int f = 0; f < FORMS; f++) {
		const real zeta[2] = {(real)0.001, 0}, psi_next[1] = {0};
		KOOP(health) health;
		estimator_settings(&e, 1, 1, &KOOP(reg_ct), all_forms[f]);
		e.config.lambda = 1 / REAL_MAX * 4096;
		e.config.p0 = 8192;
		estimator_start(&e);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
		CHECK(fabs((double)health.trace / 16384 - 1) < 1e-4, "%s: trace %g", estimator_name(&e),
		      (double)health.trace);
	}
}

/* From a trace of nine tenths of the range, as a reset may leave it: it is not scaled by anything before. */
static void test_constant_trace_from_the_end_of_the_range(void) {
	for (int f = 0; f < FORMS; f++) {
		const real zeta[2] = {0}, psi_next[1] = {0};
		KOOP(health) health;
		estimator_settings(&e, 1, 1, &KOOP(reg_ct), all_forms[f]);
		e.trace.tau0 = 100;
		estimator_start(&e);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, (real)0.45 * REAL_MAX));
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
		CHECK(fabs((double)health.trace / 100 - 1) < 1e-5, "%s: trace %g", estimator_name(&e),
		      (double)health.trace);
	}
}

/* P's scale in the plain form may be the least number of the range, and no less. */
static void test_scale_at_the_end_of_the_range(void) {
	for (int below = 0; below < 2; below++) {
		const real zeta[2] = {REAL_EPSILON, 0}, psi_next[1] = {0};
		estimator_settings(&e, 1, 1, &KOOP(reg_ct), &KOOP(form_plain));
		e.config.p0 = 4;
		e.trace.tau0 = 8 * REAL_MIN * (below ? (real)0.75 : 1);
		estimator_start(&e);
		CHECK_STATUS(below ? KOOP_E_INDEFINITE : KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	}
}

/* A trace that is to be kept, and P's at the start where none is given, are below an eighth of the range. */
static void test_settings_at_the_end_of_the_range(void) {
	static const struct {
		double p0, tau0;
		int status;
	} cases[] = {
	    {1, 1.0 / 8, KOOP_E_RANGE}, {1, 1.0 / 8.5, KOOP_OK},          {1.0 / 16, 0, KOOP_E_RANGE},
	    {1.0 / 17, 0, KOOP_OK},     {1.0 / 2, 1.0 / 9, KOOP_E_RANGE}, {1.0 / 2.5, 1.0 / 9, KOOP_OK},
	};
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		estimator_settings(&e, 1, 1, &KOOP(reg_ct), &KOOP(form_sqrt));
		e.config.p0 = cases[i].p0 < 1 ? (real)(cases[i].p0 * (double)REAL_MAX) : 1;
		e.trace.tau0 = (real)(cases[i].tau0 * (double)REAL_MAX);
		CHECK_STATUS(cases[i].status,
		             KOOP(rls_init)(&e.rls, &e.config, e.storage, sizeof e.storage / sizeof *e.storage));
	}
}

static void check_start(real p0, int status) {
	estimator_settings(&e, 1, 1, &KOOP(reg_ct), &KOOP(form_sqrt));
	e.trace.tau0 = 1;
	estimator_start(&e);
	CHECK_STATUS(status, KOOP(rls_reset_covariance)(&e.rls, p0));
	e.config.p0 = p0;
	CHECK_STATUS(status, KOOP(rls_init)(&e.rls, &e.config, e.storage, sizeof e.storage / sizeof *e.storage));
}

/* The first number of either end, and the one next to it. */
static void test_covariance_begins_between_the_least_number_and_half_of_the_range(void) {
	check_start(REAL_MIN, KOOP_OK);
	check_start(REAL_MIN * (1 - REAL_EPSILON), KOOP_E_RANGE);
	check_start(REAL_MAX / 2 * (1 - REAL_EPSILON), KOOP_OK);
	check_start(REAL_MAX / 2, KOOP_E_RANGE);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_unexcited_covariance_grows_to_half_of_the_range);
	RUN_TEST(test_covariance_that_forgetting_would_lift_beyond_half_of_the_range);
	RUN_TEST(test_diagonal_that_cancels_is_refused);
	RUN_TEST(test_definite_by_less_than_a_rounding_is_refused);
	RUN_TEST(test_loose_bound_refuses_nothing);
	RUN_TEST(test_denominator_at_the_end_of_the_range);
	RUN_TEST(test_denominator_of_nothing);
	RUN_TEST(test_trace_that_cannot_be_brought_back);
	RUN_TEST(test_constant_trace_with_strong_forgetting);
	RUN_TEST(test_scale_at_the_end_of_the_range);
	RUN_TEST(test_settings_at_the_end_of_the_range);
	RUN_TEST(test_covariance_begins_between_the_least_number_and_half_of_the_range);
	RUN_TEST(test_root_does_not_underflow);
	RUN_TEST(test_negative_denominator_is_refused_or_reported);
	RUN_TEST(test_constant_trace_from_the_end_of_the_range);
	return UNITY_END();
}
