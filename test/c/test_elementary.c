/* The library's own exp, sine, cosine and the atan2 of these two, seen through the dictionaries, against long
 * double. All numbers between: `tinykoop determinism`. */
#include "support.h"

static const wide TURN = (wide)6.28318530717958647692528676655900577L;

/* beyond FAR the angle's own last place is the larger error; beyond LARGEST it has no sine */
#if TEST_DOUBLE
#define FAR 1e6
#define LARGEST 1073741824.0
#else
#define FAR 1e4
#define LARGEST 1048576.0
#endif

/* distance in units of the last place of `unit` */
static double units(real value, wide expected, wide unit) {
	int exponent;
	frexpl(unit, &exponent);
	return (double)(fabs((wide)value - expected) / ldexp((wide)REAL_EPSILON, exponent - 1));
}

static void lift_angle(real angle, real *psi) {
	const real x[3] = {0, 0, angle};
	CHECK_STATUS(KOOP_OK, KOOP(lift)(&KOOP(rbf_ddr), x, psi));
}

static void check_angle(real angle) {
	real psi[22];
	lift_angle(angle, psi);
	const wide sine = sin((wide)angle), cosine = cos((wide)angle);
	CHECK(units(psi[19], sine, sine) < 1, "sin(%.17g) = %.17g", (double)angle, (double)psi[19]);
	CHECK(units(psi[20], cosine, cosine) < 1, "cos(%.17g) = %.17g", (double)angle, (double)psi[20]);
	const wide wrapped = atan2((wide)psi[19], (wide)psi[20]);
	CHECK(units(psi[21], wrapped, wrapped) < 1, "%.17g wrapped to %.17g", (double)angle, (double)psi[21]);
}

static void test_angles_are_right_to_the_last_place(void) {
	random_source random = random_seed(1);
	for (int k = 0; k < 5000; k++) {
		check_angle(random_uniform(&random, -4, 4));
		check_angle(random_uniform(&random, -FAR, FAR));
	}
}

/* where sine or cosine is all cancellation, and where the wrapped angle jumps */
static void test_angles_next_to_quarter_turns(void) {
	for (int k = -2000; k <= 2000; k++) {
		const real at = (real)(k * TURN / 4);
		check_angle(at);
		check_angle(at * (1 + REAL_EPSILON));
		check_angle(at * (1 - REAL_EPSILON));
	}
}

/* where what is left of an angle is largest, and the series of sine and cosine end latest */
static void test_angles_between_quarter_turns(void) {
	random_source random = random_seed(3);
	for (int k = 0; k < 20000 / TEST_SHARE; k++) {
		const wide between = TURN / 8 * (1 + 2 * (wide)(k % 8 - 4));
		check_angle((real)(between * (wide)random_uniform(&random, 0.99, 1.01)));
	}
}

static void test_small_angles_are_their_own_sine(void) {
	real psi[22];
	for (int exponent = -30; exponent > -120; exponent--) {
		const real angle = (real)ldexp(-1.25, exponent);
		lift_angle(angle, psi);
		TEST_ASSERT_TRUE(memcmp(&psi[19], &angle, sizeof angle) == 0);
		TEST_ASSERT_TRUE(memcmp(&psi[21], &angle, sizeof angle) == 0);
	}
}

/* as if the angle were off by less than its own last place */
static void test_far_angles_lose_their_last_place_only(void) {
	random_source random = random_seed(2);
	for (int k = 0; k < 5000; k++) {
		const real angle = random_uniform(&random, -LARGEST, LARGEST);
		real psi[22];
		lift_angle(angle, psi);
		const wide off = remainder((wide)psi[21] - (wide)angle, TURN);
		CHECK(units(psi[19], sin((wide)angle), (wide)angle) < 1, "sin(%.17g)", (double)angle);
		CHECK(units(psi[20], cos((wide)angle), (wide)angle) < 1, "cos(%.17g)", (double)angle);
		CHECK(units(0, off, (wide)angle) < 1, "%.17g wrapped", (double)angle);
		TEST_ASSERT_TRUE(psi[19] >= -1 && psi[19] <= 1 && psi[20] >= -1 && psi[20] <= 1);
	}
}

static void test_angles_without_a_sine_are_refused(void) {
	const real inside[] = {(real)LARGEST, (real)-LARGEST};
	const real outside[] = {(real)LARGEST * (1 + REAL_EPSILON), (real)-LARGEST * (1 + REAL_EPSILON),
	                        REAL_MAX};
	real x[10] = {0}, psi[30];
	for (size_t i = 0; i < sizeof inside / sizeof *inside; i++) { lift_angle(inside[i], psi); }
	for (size_t i = 0; i < sizeof outside / sizeof *outside; i++) {
		x[2] = x[6] = outside[i];
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&KOOP(rbf_ddr), x, psi));
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&KOOP(poly_ddr), x, psi));
		x[2] = 0;
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lift)(&KOOP(rbf_fwmav), x, psi));
	}
}

/* A Gaussian with its other coordinate on the centre. Its exponent is rounded as the dictionary's is, so that
 * only the exponential counts. */
static void test_exponential_from_one_to_nothing(void) {
	const real sigma = (real)1.5, factor = 1 / (2 * sigma * sigma);
	for (int k = 0; k <= 20000; k++) {
		const real x[3] = {(real)(k / 256.0), -3, 0}, away = x[0] + 3;
		const real exponent = factor * away * away;
		const wide expected = exp(-(wide)exponent);
		real psi[22];
		CHECK_STATUS(KOOP_OK, KOOP(lift)(&KOOP(rbf_ddr), x, psi));
		if (expected < (wide)REAL_MIN) {
			TEST_ASSERT_TRUE(psi[3] >= 0 && psi[3] <= REAL_MIN);
		} else {
			CHECK(units(psi[3], expected, expected) < 1, "exp(-%.17g) = %.17g", (double)exponent,
			      (double)psi[3]);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_angles_are_right_to_the_last_place);
	RUN_TEST(test_angles_next_to_quarter_turns);
	RUN_TEST(test_angles_between_quarter_turns);
	RUN_TEST(test_small_angles_are_their_own_sine);
	RUN_TEST(test_far_angles_lose_their_last_place_only);
	RUN_TEST(test_angles_without_a_sine_are_refused);
	RUN_TEST(test_exponential_from_one_to_nothing);
	return UNITY_END();
}
