/* The low-pass against the analytic response of a Butterworth filter. */
#include "support.h"

static const double PI = 3.14159265358979323846;

static real storage[KOOP_LOWPASS_REALS(3)];

static KOOP(lowpass) filter_of(size_t n, double cutoff, double rate) {
	KOOP(lowpass) filter;
	CHECK_STATUS(KOOP_OK,
	             KOOP(lowpass_init)(&filter, n, (real)cutoff, (real)rate, storage, KOOP_LOWPASS_REALS(3)));
	return filter;
}

/* |H| and phase at f: by the bilinear transform s = i tan(pi f / rate) / tan(pi cutoff / rate), 1 / (s^2 +
 * sqrt(2) s + 1) */
static void response(double f, double cutoff, double rate, double *gain, double *phase) {
	const double w = tan(PI * f / rate) / tan(PI * cutoff / rate);
	*gain = 1 / sqrt(1 + w * w * w * w);
	*phase = -atan2(sqrt(2.0) * w, 1 - w * w);
}

static void test_response_at_many_frequencies(void) {
	static const struct {
		double cutoff, rate;
	} filters[] = {{5, 100}, {40, 100}, {1, 100}, {100, 1000}, {0.0625, 0.25}};
	for (size_t c = 0; c < sizeof filters / sizeof filters[0]; c++) {
		const double cutoff = filters[c].cutoff, rate = filters[c].rate;
		for (int k = 1; k < 10; k++) {
			const double f = 0.05 * k * rate;
			KOOP(lowpass) filter = filter_of(1, cutoff, rate);
			double cosine = 0, sine = 0;
			const int settle = 1000, count = 400; /* f is a multiple of rate / 20: whole periods */
			for (int i = 0; i < settle + count; i++) {
				const double angle = 2 * PI * f / rate * i;
				const real x = (real)sin(angle);
				real y;
				CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
				if (i >= settle) {
					sine += 2 * sin(angle) * (double)y / count;
					cosine += 2 * cos(angle) * (double)y / count;
				}
			}
			double gain, phase;
			response(f, cutoff, rate, &gain, &phase);
			const double error = hypot(sine - gain * cos(phase), cosine - gain * sin(phase));
			CHECK(error <= 2000 * (double)REAL_EPSILON, "cutoff %g of %g Hz, f %g: off by %g", cutoff, rate,
			      f, error);
		}
	}
}

static void test_begins_settled(void) {
	KOOP(lowpass) filter = filter_of(3, 5, 100);
	const real x[3] = {(real)9.81, (real)-0.25, 0};
	for (int i = 0; i < 1000; i++) {
		real y[3];
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, x, y));
		for (int k = 0; k < 3; k++) {
			CHECK(fabs((double)(y[k] - x[k])) <= 200 * (double)REAL_EPSILON * fabs((double)x[k]),
			      "%.9g from %.9g", (double)y[k], (double)x[k]);
		}
	}
}

static void test_reset_begins_settled_again(void) {
	KOOP(lowpass) filter = filter_of(1, 5, 100);
	real x = 1, y;
	CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
	x = -7;
	CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
	CHECK(y > 0, "one sample does not move it all the way: %g", (double)y);
	CHECK_STATUS(KOOP_OK, KOOP(lowpass_reset)(&filter));
	CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
	CHECK(fabs((double)y + 7) <= 100 * (double)REAL_EPSILON, "%g instead of -7", (double)y);
}

static void test_slow_signals_are_late_by_what_is_said(void) {
	KOOP(lowpass) filter = filter_of(1, 5, 100);
	real y = 0;
	for (int i = 0; i < 400; i++) { /* a ramp of 1 a second */
		const real x = (real)(0.01 * i);
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
	}
	const double delay = 3.99 - (double)y;
	CHECK(fabs(delay - 0.225 / 5) < 1e-3, "%g s instead of %g s", delay, 0.225 / 5);
}

static void test_refused_samples_change_nothing(void) {
	static const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	random_source random = random_seed(3);
	KOOP(lowpass) filter = filter_of(3, 8, 100);
	real twin_storage[KOOP_LOWPASS_REALS(3)];
	KOOP(lowpass) twin;
	CHECK_STATUS(KOOP_OK, KOOP(lowpass_init)(&twin, 3, 8, 100, twin_storage, KOOP_LOWPASS_REALS(3)));
	for (int i = 0; i < 300; i++) {
		real x[3], y[3], expected[3], spoilt[3] = {1, 2, 3};
		random_fill(&random, x, 3, -10, 10);
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&twin, x, expected));
		spoilt[i % 3] = (real)bad[i / 3 % 3];
		CHECK_STATUS(KOOP_E_INPUT, KOOP(lowpass_step)(&filter, spoilt, y));
		spoilt[i % 3] = REAL_MAX / (real)(i % 2 ? 8 : 63.5);
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lowpass_step)(&filter, spoilt, y));
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, x, x)); /* in place */
		CHECK(memcmp(x, expected, sizeof x) == 0, "sample %d", i);
	}
}

/* What stands behind them is neither judged nor written. */
static void test_only_the_channels_are_filtered(void) {
	for (size_t n = 1; n <= 3; n++) {
		KOOP(lowpass) filter = filter_of(n, 5, 100);
		const real x[4] = {1, -2, 3, REAL_MAX}, beyond = 7;
		real y[4] = {beyond, beyond, beyond, beyond}, input[4];
		memcpy(input, x, sizeof x);
		input[n] = n % 2 ? REAL_MAX : (real)NAN;
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, input, y));
		for (size_t i = 0; i < n; i++) {
			CHECK(fabs((double)(y[i] - x[i])) < 1e-4, "channel %zu of %zu", i, n);
		}
		for (size_t i = n; i < 4; i++) { TEST_ASSERT_EQUAL_MEMORY(&beyond, &y[i], sizeof beyond); }
	}
}

/* A channel each, of either sign. */
static void test_largest_input_is_one_below_a_64th_of_the_range(void) {
	const real most = REAL_MAX / 64;
	for (size_t k = 0; k < 6; k++) {
		KOOP(lowpass) filter = filter_of(3, 5, 100);
		real x[3] = {1, 2, 3}, y[3];
		x[k / 2] = k % 2 ? -most : most;
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lowpass_step)(&filter, x, y));
		x[k / 2] *= 1 - REAL_EPSILON;
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, x, y));
	}
}

static void test_arguments(void) {
	KOOP(lowpass) filter, unset = {0};
	real x = 1;
	static const struct {
		double cutoff, rate;
	} bad[] = {{0, 100},
	           {-5, 100},
	           {46, 100},
	           {0.09, 100},
	           {5, 0},
	           {5, -100},
	           {-5, -100},
	           {(double)NAN, 100},
	           {5, (double)NAN},
	           {5, (double)INFINITY},
	           {(double)INFINITY, (double)INFINITY}};
	for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
		CHECK_STATUS(KOOP_E_RANGE,
		             KOOP(lowpass_init)(&filter, 1, (real)bad[i].cutoff, (real)bad[i].rate, storage, 2));
	}
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_init)(NULL, 1, 5, 100, storage, 2));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_init)(&filter, 1, 5, 100, NULL, 2));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(lowpass_init)(&filter, 0, 5, 100, storage, 2));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(lowpass_init)(&filter, KOOP_MAX_DIM + 1, 5, 100, storage, 2));
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(lowpass_init)(&filter, 2, 5, 100, storage, 3));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_step)(&unset, &x, &x));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_reset)(&unset));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_step)(NULL, &x, &x));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_reset)(NULL));
	filter = filter_of(1, 5, 100);
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_step)(&filter, NULL, &x));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lowpass_step)(&filter, &x, NULL));
}

/* From a thousandth to 0.45 of the rate, and as many channels as there are lifted states at most. */
static void test_settings_at_their_limits(void) {
	static real many[KOOP_LOWPASS_REALS(KOOP_MAX_DIM)];
	static const double limits[] = {0.001, 0.45};
	KOOP(lowpass) filter;
	for (int i = 0; i < 2; i++) {
		const real within = (real)limits[i], beyond = within * (i ? 1 + REAL_EPSILON : 1 - REAL_EPSILON);
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_init)(&filter, 1, within, 1, many, 2));
		CHECK_STATUS(KOOP_E_RANGE, KOOP(lowpass_init)(&filter, 1, beyond, 1, many, 2));
	}
	CHECK_STATUS(KOOP_OK,
	             KOOP(lowpass_init)(&filter, KOOP_MAX_DIM, 5, 100, many, sizeof many / sizeof *many));
}

/* Two numbers a channel, all of which are used, and nothing behind them. */
static void test_storage_is_exact(void) {
	for (size_t n = 1; n <= 5; n++) {
		real state[2 * 5 + 4], x[5] = {1, 2, 3, 4, 5}, y[5];
		KOOP(lowpass) filter;
		for (size_t i = 0; i < 2 * 5 + 4; i++) { state[i] = (real)NAN; }
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_init)(&filter, n, 5, 100, state, KOOP_LOWPASS_REALS(n)));
		for (int k = 0; k < 3; k++) { CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, x, y)); }
		for (size_t i = 0; i < 2 * 5 + 4; i++) {
			CHECK(isfinite(state[i]) ? i < 2 * n : i >= 2 * n, "%d channels, number %d", (int)n, (int)i);
		}
	}
}

/* A sample is too large from a 64th of the range on, of either sign and in any channel. */
static void test_a_sample_may_be_below_a_64th_of_the_range(void) {
	for (int i = 0; i < 6; i++) {
		KOOP(lowpass) filter = filter_of(3, 5, 100);
		real x[3] = {1, 2, 3}, y[3];
		x[i % 3] = REAL_MAX / 64 * (real)(i < 3 ? 1 : -1);
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(lowpass_step)(&filter, x, y));
		x[i % 3] *= 1 - REAL_EPSILON;
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, x, y));
	}
}

/* Where a thousandth of the rate underflows to 0, a cutoff of 0 is not above it. */
static void test_rate_at_the_end_of_the_range(void) {
	KOOP(lowpass) filter;
	const real rate = REAL_MIN * REAL_EPSILON * 100;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(lowpass_init)(&filter, 1, 0, rate, storage, 2));
	CHECK_STATUS(KOOP_E_RANGE, KOOP(lowpass_init)(&filter, 1, rate, rate, storage, 2));
	CHECK_STATUS(KOOP_E_RANGE, KOOP(lowpass_init)(&filter, 1, REAL_MAX, REAL_MIN, storage, 2));
}

static void test_lasts(void) {
	/* a hundred thousand samples of the largest input allowed, changing sign: the worst for the states */
	KOOP(lowpass) filter = filter_of(1, 0.1, 100);
	for (long i = 0; i < 100000; i++) {
		const real x = (i / 500 % 2 ? 1 : -1) * (REAL_MAX / 65);
		real y;
		CHECK_STATUS(KOOP_OK, KOOP(lowpass_step)(&filter, &x, &y));
		CHECK(y - y == 0, "sample %ld", i);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_response_at_many_frequencies);
	RUN_TEST(test_begins_settled);
	RUN_TEST(test_reset_begins_settled_again);
	RUN_TEST(test_slow_signals_are_late_by_what_is_said);
	RUN_TEST(test_refused_samples_change_nothing);
	RUN_TEST(test_only_the_channels_are_filtered);
	RUN_TEST(test_largest_input_is_one_below_a_64th_of_the_range);
	RUN_TEST(test_arguments);
	RUN_TEST(test_rate_at_the_end_of_the_range);
	RUN_TEST(test_settings_at_their_limits);
	RUN_TEST(test_storage_is_exact);
	RUN_TEST(test_lasts);
	RUN_TEST(test_a_sample_may_be_below_a_64th_of_the_range);
	return UNITY_END();
}
