/* How far P may grow and shrink: up to half of the range and down to its end, and then it stays as it is. */
#include "support.h"

static estimator e;

/* As many updates with this regressor as are taken, up to `most`; the innovation is nothing. */
static int updates_taken(real psi, real u, int most, int *status) {
	const real zeta[2] = {psi, u}, psi_next[1] = {0};
	int taken = 0;
	do { *status = estimator_update(&e, zeta, psi_next, NULL); } while (*status == KOOP_OK && ++taken < most);
	return taken;
}

static void begin(const KOOP(regulator) *regulator, const KOOP(form) *form, real lambda, real p0) {
	estimator_settings(&e, 1, 1, regulator, form);
	e.config.lambda = lambda;
	e.config.p0 = p0;
	e.config.tau0 = 1;
	e.config.check = KOOP_CHECK_DIAGONAL;
	estimator_start(&e);
}

/* Forgetting makes P four times as large where nothing is excited, and its root twice. */
static void test_unexcited_covariance_grows_to_half_of_the_range(void) {
	const int exponent = TEST_DOUBLE ? DBL_MAX_EXP : FLT_MAX_EXP;
	int status;
	begin(&KOOP(reg_ef), &KOOP(form_sqrt), (real)0.25, 1);
	TEST_ASSERT_EQUAL_INT(exponent - 2, updates_taken(1, 0, 5000, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	for (int odd = 0; odd < 2; odd++) {
		begin(&KOOP(reg_ef), &KOOP(form_plain), (real)0.25, (real)(1 + odd));
		TEST_ASSERT_EQUAL_INT(exponent / 2 - 1 - odd, updates_taken(1, 0, 5000, &status));
		TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	}
}

/* One element of the root is at the end of the range after the first sample, and beyond it after the second. */
static void test_root_does_not_underflow(void) {
	int status;
	const real far = (real)(exp2(-0.4) / (double)REAL_MIN);
	begin(&KOOP(reg_none), &KOOP(form_sqrt), 1, REAL_MIN);
	TEST_ASSERT_EQUAL_INT(1, updates_taken(far, 0, 10, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
	begin(&KOOP(reg_none), &KOOP(form_sqrt), 1, REAL_MIN);
	TEST_ASSERT_EQUAL_INT(1, updates_taken(0, far, 10, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_INDEFINITE, status);
}

/* SIFt adds to P: as much again as it was, and the bound of what becomes of it is four times that. */
static void test_covariance_that_forgetting_would_lift_beyond_half_of_the_range(void) {
	int status;
	begin(&KOOP(reg_sift), &KOOP(form_plain), (real)0.5, REAL_MAX / 7);
	TEST_ASSERT_EQUAL_INT(0, updates_taken((real)0.9, 0, 1, &status));
	TEST_ASSERT_EQUAL_INT(KOOP_E_OVERFLOW, status);
	begin(&KOOP(reg_sift), &KOOP(form_plain), (real)0.5, REAL_MAX / 9);
	(void)updates_taken((real)0.9, 0, 1, &status);
	TEST_ASSERT_TRUE(status != KOOP_E_OVERFLOW);
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
		e.config.tau0 = (real)(cases[i].tau0 * (double)REAL_MAX);
		CHECK_STATUS(cases[i].status,
		             KOOP(rls_init)(&e.rls, &e.config, e.storage, sizeof e.storage / sizeof *e.storage));
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_unexcited_covariance_grows_to_half_of_the_range);
	RUN_TEST(test_covariance_that_forgetting_would_lift_beyond_half_of_the_range);
	RUN_TEST(test_settings_at_the_end_of_the_range);
	RUN_TEST(test_root_does_not_underflow);
	return UNITY_END();
}
