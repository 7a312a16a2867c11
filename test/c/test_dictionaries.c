/* Lifted values against the formulas, computed in wide arithmetic. */
#include "support.h"

/* relative to 1, the size of the sines and Gaussians */
static void check_value(size_t index, real value, wide expected) {
	const wide tolerance = 8 * (wide)REAL_EPSILON * fmax(1, fabs(expected));
	CHECK(fabs((wide)value - expected) <= tolerance, "psi[%u] = %.17g instead of %.17g", (unsigned)index,
	      (double)value, (double)expected);
}

static wide gaussian(real a, real b, wide center_a, wide center_b, wide sigma) {
	const wide da = (wide)a - center_a, db = (wide)b - center_b;
	return exp(-(da * da + db * db) / (2 * sigma * sigma));
}

/* the centers of a 4 x 4 grid over [-reach, reach]: first coordinate slow, second fast */
static size_t expect_grid(real a, real b, wide reach, wide sigma, wide *out) {
	size_t count = 0;
	for (int i = 0; i < 4; i++) {
		for (int j = 0; j < 4; j++) {
			const wide center_a = -reach + 2 * reach * i / 3, center_b = -reach + 2 * reach * j / 3;
			out[count++] = gaussian(a, b, center_a, center_b, sigma);
		}
	}
	return count;
}

static void expect_poly_ddr(const real *x, wide *psi) {
	for (int i = 0; i < 3; i++) { psi[i] = (wide)x[i]; }
	psi[3] = pow((wide)x[0], 2);
	psi[4] = pow((wide)x[1], 2);
	psi[5] = sin((wide)x[2]);
	psi[6] = cos((wide)x[2]);
}

static void expect_rbf_ddr(const real *x, wide *psi) {
	for (int i = 0; i < 3; i++) { psi[i] = (wide)x[i]; }
	expect_grid(x[0], x[1], 3, 1.5L, psi + 3);
	psi[19] = sin((wide)x[2]);
	psi[20] = cos((wide)x[2]);
	/* atan2(sin, cos) is the angle wrapped to (-pi, pi] */
	const wide turn = 8 * atan((wide)1);
	psi[21] = remainder((wide)x[2], turn);
}

static void expect_poly_fwmav(const real *x, wide *psi) {
	size_t k = 10;
	for (int i = 0; i < 10; i++) { psi[i] = (wide)x[i]; }
	for (int i = 0; i < 3; i++) { psi[k++] = (wide)x[i] * (wide)x[i]; }
	for (int i = 0; i < 3; i++) { psi[k++] = (wide)x[i] * (wide)x[(i + 1) % 3]; }
	for (int angle = 6; angle <= 7; angle++) {
		psi[k++] = sin((wide)x[angle]);
		psi[k++] = cos((wide)x[angle]);
	}
}

static void expect_rbf_fwmav(const real *x, wide *psi) {
	size_t k = 10;
	for (int i = 0; i < 10; i++) { psi[i] = (wide)x[i]; }
	k += expect_grid(x[6], x[7], (wide)0.6L, (wide)0.3L, psi + k);
	for (int angle = 6; angle <= 7; angle++) {
		psi[k++] = sin((wide)x[angle]);
		psi[k++] = cos((wide)x[angle]);
	}
}

static void check_dictionary(const KOOP(dictionary) *dictionary, const char *name, size_t n, size_t N,
                             void (*expect)(const real *, wide *)) {
	random_source random = random_seed(N);
	TEST_ASSERT_EQUAL_STRING(name, dictionary->name);
	TEST_ASSERT_TRUE(dictionary->n_states == n);
	TEST_ASSERT_TRUE(dictionary->n_lifted == N);
	for (int k = 0; k < 500; k++) {
		real x[10], psi[31];
		wide expected[30];
		random_fill(&random, x, n, -3.5, 3.5);
		if (k == 0) { memset(x, 0, sizeof x); }
		psi[N] = 77; /* nothing is written beyond N */
		CHECK_STATUS(KOOP_OK, KOOP(lift)(dictionary, x, psi));
		expect(x, expected);
		for (size_t i = 0; i < N; i++) { check_value(i, psi[i], expected[i]); }
		TEST_ASSERT_TRUE(memcmp(x, psi, n * sizeof(real)) == 0);
		TEST_ASSERT_TRUE(psi[N] > 76 && psi[N] < 78);
	}
}

static void test_poly_ddr(void) {
	check_dictionary(&KOOP(poly_ddr), "poly", 3, 7, expect_poly_ddr);
}

static void test_rbf_ddr(void) {
	check_dictionary(&KOOP(rbf_ddr), "rbf", 3, 22, expect_rbf_ddr);
}

static void test_poly_fwmav(void) {
	check_dictionary(&KOOP(poly_fwmav), "poly", 10, 20, expect_poly_fwmav);
}

static void test_rbf_fwmav(void) {
	check_dictionary(&KOOP(rbf_fwmav), "rbf", 10, 30, expect_rbf_fwmav);
}

/* far from the grid every Gaussian underflows: to zero, not to an error */
static void test_far_state_is_lifted(void) {
	const real x[3] = {1000, -1000, 1};
	real psi[22];
	CHECK_STATUS(KOOP_OK, KOOP(lift)(&KOOP(rbf_ddr), x, psi));
	for (int i = 3; i < 19; i++) { TEST_ASSERT_TRUE(!(psi[i] > 0) && !(psi[i] < 0)); }
}

/* ---- A user's own -------------------------------------------------------------- */

typedef struct {
	real gain;
	real last; /* what psi[2] becomes */
} own_settings;

static void lift_own(const KOOP(dictionary) *self, const real *x, real *psi) {
	const own_settings *settings = self->context;
	psi[0] = x[0];
	psi[1] = settings->gain * x[0];
	psi[2] = settings->last;
}

static void test_own_dictionary_sees_its_context(void) {
	own_settings settings = {3, 5};
	const KOOP(dictionary) own = {"own", 1, 3, lift_own, &settings};
	const real x = 7;
	real psi[3];
	CHECK_STATUS(KOOP_OK, KOOP(lift)(&own, &x, psi));
	check_value(1, psi[1], 21);
	check_value(2, psi[2], 5);
}

static void test_result_that_is_not_finite_is_refused(void) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	const real x = 7;
	real psi[3];
	for (int i = 0; i < 3; i++) {
		own_settings settings = {3, (real)values[i]};
		const KOOP(dictionary) own = {"own", 1, 3, lift_own, &settings};
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&own, &x, psi));
	}
	own_settings steep = {REAL_MAX, 0};
	const KOOP(dictionary) own = {"own", 1, 3, lift_own, &steep};
	CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&own, &x, psi));

	/* a square of the library's own that overflows */
	const real large[3] = {REAL_MAX, 0, 0};
	real lifted[7];
	CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&KOOP(poly_ddr), large, lifted));
}

/* ---- From one value to the most there may be ------------------------------------- */

static const real marked = 77;

/* Beyond what is lifted stands NaN; `context` says which value is infinite. */
static void lift_many(const KOOP(dictionary) *self, const real *x, real *psi) {
	for (size_t i = 0; i < self->n_lifted; i++) { psi[i] = x[i % self->n_states]; }
	if (self->context) { psi[*(const size_t *)self->context] = (real)INFINITY; }
}

/* psi is written only where the sizes are right; nothing beyond the n and N of them is looked at. */
static int lift_sizes(size_t n, size_t N, const size_t *infinite) {
	static real x[KOOP_MAX_DIM + 2], psi[KOOP_MAX_DIM + 2];
	const KOOP(dictionary) many = {"many", n, N, lift_many, infinite};
	for (size_t i = 0; i < KOOP_MAX_DIM + 2; i++) {
		x[i] = i < n ? 1 : (real)NAN;
		psi[i] = i == 0 || i < N ? marked : (real)NAN;
	}
	const int status = KOOP(lift)(&many, x, psi);
	const int untouched = memcmp(psi, &marked, sizeof marked) == 0;
	CHECK(untouched == (status == KOOP_E_SIZE), "n %zu, N %zu", n, N);
	return status;
}

static void test_sizes_of_a_dictionary(void) {
	static const size_t states[] = {1, 2, KOOP_MAX_DIM};
	for (size_t i = 0; i < sizeof states / sizeof *states; i++) {
		const size_t n = states[i];
		CHECK_STATUS(KOOP_OK, lift_sizes(n, n, NULL));
		CHECK_STATUS(KOOP_OK, lift_sizes(n, KOOP_MAX_DIM, NULL));
		CHECK_STATUS(KOOP_E_SIZE, lift_sizes(n, KOOP_MAX_DIM + 1, NULL));
		CHECK_STATUS(KOOP_E_SIZE, lift_sizes(n, n - 1, NULL));
		CHECK_STATUS(KOOP_E_SIZE, lift_sizes(0, n, NULL));
	}
	CHECK_STATUS(KOOP_E_SIZE, lift_sizes(KOOP_MAX_DIM + 1, KOOP_MAX_DIM + 1, NULL));
}

static void test_each_value_that_is_not_finite_is_seen(void) {
	for (size_t infinite = 0; infinite < 9; infinite++) {
		CHECK_STATUS(KOOP_E_OVERFLOW, lift_sizes(1, infinite + 1, &infinite));
		CHECK_STATUS(KOOP_E_OVERFLOW, lift_sizes(1, 9, &infinite));
	}
}

static void test_state_that_is_not_finite_is_refused(void) {
	const KOOP(dictionary) *const all[] = {&KOOP(poly_ddr), &KOOP(rbf_ddr), &KOOP(poly_fwmav),
	                                       &KOOP(rbf_fwmav)};
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	for (int k = 0; k < 4; k++) {
		for (size_t i = 0; i < all[k]->n_states; i++) {
			for (int v = 0; v < 3; v++) {
				real x[10] = {0}, psi[30];
				x[i] = (real)values[v];
				CHECK_STATUS(KOOP_E_INPUT, KOOP(lift)(all[k], x, psi));
			}
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_poly_ddr);
	RUN_TEST(test_rbf_ddr);
	RUN_TEST(test_poly_fwmav);
	RUN_TEST(test_rbf_fwmav);
	RUN_TEST(test_far_state_is_lifted);
	RUN_TEST(test_own_dictionary_sees_its_context);
	RUN_TEST(test_result_that_is_not_finite_is_refused);
	RUN_TEST(test_sizes_of_a_dictionary);
	RUN_TEST(test_each_value_that_is_not_finite_is_seen);
	RUN_TEST(test_state_that_is_not_finite_is_refused);
	return UNITY_END();
}
