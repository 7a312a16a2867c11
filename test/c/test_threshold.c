/* The interpolated quantile of the paper's remark "Dead-Zone Threshold Selection". */
#include "support.h"

static void check_near(real value, double expected) {
	CHECK(fabs((double)value - expected) <= 4 * (double)REAL_EPSILON * fmax(1, fabs(expected)),
	      "%.9g instead of %.9g", (double)value, expected);
}

static void test_cases_computed_by_hand(void) {
	/* ordered: 1 2 4 8 16; h = 4 eta */
	static const struct {
		double eta, delta;
	} cases[] = {
	    {0, 1},          /* h = 0 */
	    {1, 16},         /* h = 4 */
	    {0.5, 4},        /* h = 2 */
	    {0.75, 8},       /* h = 3 */
	    {0.625, 6},      /* h = 2.5 */
	    {0.0625, 1.25},  /* h = 0.25 */
	    {0.9375, 14},    /* h = 3.75 */
	    {0.40625, 3.25}, /* h = 1.625 */
	};
	for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
		real scores[5] = {8, 1, 16, 2, 4}, delta = -1;
		CHECK_STATUS(KOOP_OK, KOOP(threshold)(scores, 5, (real)cases[i].eta, &delta));
		check_near(delta, cases[i].delta);
	}
}

static void test_one_score(void) {
	for (int i = 0; i <= 4; i++) {
		real score = (real)2.5, delta = -1;
		CHECK_STATUS(KOOP_OK, KOOP(threshold)(&score, 1, (real)i / 4, &delta));
		check_near(delta, 2.5);
	}
}

/* What lies behind the scores does not take part, not even with a weight of nothing. */
static void test_last_score_by_itself(void) {
	real scores[3] = {1, 2, (real)NAN}, delta = -1;
	CHECK_STATUS(KOOP_OK, KOOP(threshold)(scores, 2, 1, &delta));
	check_near(delta, 2);
}

static void test_duplicates(void) {
	/* ordered: 0 1 1 1 3 3; h = 5 eta */
	static const struct {
		double eta, delta;
	} cases[] = {{0, 0}, {0.125, 0.625}, {0.3, 1}, {0.5, 1}, {0.75, 2.5}, {0.9, 3}, {1, 3}};
	for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
		real scores[6] = {3, 1, 0, 1, 3, 1}, delta = -1;
		CHECK_STATUS(KOOP_OK, KOOP(threshold)(scores, 6, (real)cases[i].eta, &delta));
		check_near(delta, cases[i].delta);
	}
}

static void test_refusals(void) {
	const double bad_eta[] = {-0.01, 1.01, (double)NAN, (double)INFINITY, -(double)INFINITY};
	real delta = 42;
	for (size_t i = 0; i < sizeof bad_eta / sizeof bad_eta[0]; i++) {
		real scores[3] = {3, 1, 2};
		CHECK_STATUS(KOOP_E_RANGE, KOOP(threshold)(scores, 3, (real)bad_eta[i], &delta));
	}
	for (int position = 0; position < 3; position++) {
		real scores[3] = {3, 1, 2};
		scores[position] = (real)NAN;
		CHECK_STATUS(KOOP_E_INPUT, KOOP(threshold)(scores, 3, (real)0.5, &delta));
		scores[position] = (real)INFINITY;
		CHECK_STATUS(KOOP_E_INPUT, KOOP(threshold)(scores, 3, (real)0.5, &delta));
	}
	real scores[1] = {3};
	CHECK_STATUS(KOOP_E_SIZE, KOOP(threshold)(scores, 0, (real)0.5, &delta));
	check_near(delta, 42); /* a refusal writes nothing */
}

/* Counts, for each distinct value, that sorting neither lost nor made one. */
static void test_sorts_random_data(void) {
	enum { MOST = 300, VALUES = 40 };
	random_source random = random_seed(6);
	for (size_t count = 1; count <= MOST; count++) {
		real scores[MOST], delta;
		int balance[VALUES] = {0};
		for (size_t i = 0; i < count; i++) {
			const size_t value = random_below(&random, VALUES);
			scores[i] = (real)value;
			balance[value]++;
		}
		CHECK_STATUS(KOOP_OK, KOOP(threshold)(scores, count, (real)0.5, &delta));
		for (size_t i = 0; i < count; i++) {
			if (i > 0) { CHECK(scores[i - 1] <= scores[i], "count %u", (unsigned)count); }
			balance[(int)scores[i]]--;
		}
		for (int v = 0; v < VALUES; v++) { TEST_ASSERT_EQUAL_INT(0, balance[v]); }
	}
}

static void test_quantiles_of_random_data(void) {
	enum { COUNT = 101 };
	random_source random = random_seed(7);
	for (int round = 0; round < 100; round++) {
		real scores[COUNT], delta;
		random_fill(&random, scores, COUNT, 0, 5);
		const real eta = random_uniform(&random, 0, 1);
		CHECK_STATUS(KOOP_OK, KOOP(threshold)(scores, COUNT, eta, &delta));
		const wide h = 100 * (wide)eta, below = floor(h);
		const size_t i = (size_t)below;
		const wide expected = (1 - (h - below)) * (wide)scores[i] + (h - below) * (wide)scores[i + 1];
		/* h carries an error of up to 100 epsilon, the gap between scores is at most 5 */
		CHECK(fabs((wide)delta - expected) <= 500 * (wide)REAL_EPSILON, "eta %g: %g instead of %g",
		      (double)eta, (double)delta, (double)expected);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_cases_computed_by_hand);
	RUN_TEST(test_one_score);
	RUN_TEST(test_last_score_by_itself);
	RUN_TEST(test_duplicates);
	RUN_TEST(test_refusals);
	RUN_TEST(test_sorts_random_data);
	RUN_TEST(test_quantiles_of_random_data);
	return UNITY_END();
}
