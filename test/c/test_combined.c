/* Dictionaries from parts: against formulas in wide arithmetic, against the paper's dictionaries, and what is refused. */
#include "support.h"

static KOOP(dictionary) dictionary;
static real x[10], psi[300], expected[300];

static void combine(size_t n, const KOOP(part) *parts, size_t n_parts) {
	static KOOP(combination) combination;
	combination.parts = parts;
	combination.n_parts = n_parts;
	CHECK_STATUS(KOOP_OK, KOOP(combine)(&dictionary, "own", n, &combination));
}

static void lift(void) {
	psi[dictionary.n_lifted] = 77; /* nothing is written behind */
	CHECK_STATUS(KOOP_OK, KOOP(lift)(&dictionary, x, psi));
	TEST_ASSERT_TRUE(psi[dictionary.n_lifted] > 76 && psi[dictionary.n_lifted] < 78);
	TEST_ASSERT_EQUAL_MEMORY(x, psi, dictionary.n_states * sizeof(real));
}

static void near(size_t i, wide value) {
	const wide off = fabs((wide)psi[i] - value);
	CHECK(off <= 16 * (wide)REAL_EPSILON * fmax(1, fabs(value)), "psi[%zu] = %.17g instead of %.17g", i, (double)psi[i],
	      (double)value);
}

/* The paper's polynomials are an instance of the parts, bit for bit. */
static void test_polynomials_of_the_drive_are_an_instance(void) {
	static const unsigned char squares[] = {0, 0, 1, 1}, heading[] = {2};
	static const KOOP(products) products = {squares, 2};
	static const KOOP(angles) angles = {heading, 1, 0};
	static const KOOP(part) parts[] = {{&KOOP(part_products), &products}, {&KOOP(part_angles), &angles}};
	random_source random = random_seed(91);
	combine(3, parts, 2);
	TEST_ASSERT_EQUAL_size_t(7, dictionary.n_lifted);
	for (int k = 0; k < 200; k++) {
		random_fill(&random, x, 3, -4, 4);
		lift();
		CHECK_STATUS(KOOP_OK, KOOP(lift)(&KOOP(poly_ddr), x, expected));
		TEST_ASSERT_EQUAL_MEMORY(expected, psi, 7 * sizeof(real));
	}
}

static void test_polynomials_of_the_flapping_wing_are_an_instance(void) {
	static const unsigned char pairs[] = {0, 0, 1, 1, 2, 2, 0, 1, 1, 2, 2, 0}, tilt[] = {6, 7};
	static const KOOP(products) products = {pairs, 6};
	static const KOOP(angles) angles = {tilt, 2, 0};
	static const KOOP(part) parts[] = {{&KOOP(part_products), &products}, {&KOOP(part_angles), &angles}};
	random_source random = random_seed(92);
	combine(10, parts, 2);
	for (int k = 0; k < 200; k++) {
		random_fill(&random, x, 10, -2, 2);
		lift();
		CHECK_STATUS(KOOP_OK, KOOP(lift)(&KOOP(poly_fwmav), x, expected));
		TEST_ASSERT_EQUAL_MEMORY(expected, psi, 20 * sizeof(real));
	}
}

/* So are its Gaussians; the built-in ones are products of two, which saves half of the exponentials and rounds
 * differently. */
static void check_gaussians(const KOOP(dictionary) *paper, size_t n, const unsigned char *states, real reach, real sigma,
                            const unsigned char *turned, size_t n_turned, int wrapped_too) {
	static real centers[32], widths[16];
	for (size_t i = 0; i < 16; i++) {
		centers[2 * i] = -reach + 2 * reach * (real)(i / 4) / 3;
		centers[2 * i + 1] = -reach + 2 * reach * (real)(i % 4) / 3;
		widths[i] = sigma;
	}
	const KOOP(rbf) rbf = {states, 2, 16, centers, widths, &KOOP(gaussian)};
	const KOOP(angles) angles = {turned, n_turned, wrapped_too};
	const KOOP(part) parts[] = {{&KOOP(part_rbf), &rbf}, {&KOOP(part_angles), &angles}};
	random_source random = random_seed(93);
	combine(n, parts, 2);
	TEST_ASSERT_EQUAL_size_t(paper->n_lifted, dictionary.n_lifted);
	for (int k = 0; k < 200; k++) {
		random_fill(&random, x, n, -3 * reach / 2, 3 * reach / 2);
		lift();
		CHECK_STATUS(KOOP_OK, KOOP(lift)(paper, x, expected));
		for (size_t i = 0; i < paper->n_lifted; i++) { near(i, (wide)expected[i]); }
	}
}

static void test_gaussians_of_the_paper_are_instances(void) {
	static const unsigned char position[] = {0, 1}, heading[] = {2}, tilt[] = {6, 7};
	check_gaussians(&KOOP(rbf_ddr), 3, position, 3, (real)1.5, heading, 1, 1);
	check_gaussians(&KOOP(rbf_fwmav), 10, tilt, (real)0.6, (real)0.3, tilt, 2, 0);
}

/* Every kernel, of one to nine centres, so that the last four are full or not. */
static void test_kernels(void) {
	static const KOOP(kernel) *const kernels[] = {&KOOP(gaussian), &KOOP(inverse_quadratic), &KOOP(inverse_multiquadric),
	                                              &KOOP(multiquadric), &KOOP(thin_plate)};
	static const unsigned char states[] = {2, 0};
	random_source random = random_seed(94);
	for (size_t k = 0; k < 5 * 9; k++) {
		real centers[18], widths[9];
		const size_t count = 1 + k / 5;
		const KOOP(rbf) rbf = {states, 2, count, centers, widths, kernels[k % 5]};
		const KOOP(part) parts[] = {{&KOOP(part_rbf), &rbf}, {&KOOP(part_constant), NULL}};
		random_fill(&random, centers, 18, -2, 2);
		random_fill(&random, widths, 9, 0.5, 2);
		combine(3, parts, 2);
		for (int round = 0; round < 50; round++) {
			random_fill(&random, x, 3, -3, 3);
			if (round == 0) { x[2] = centers[0], x[0] = centers[1]; } /* at a centre */
			lift();
			for (size_t i = 0; i < count; i++) {
				const wide a = ((wide)x[2] - (wide)centers[2 * i]) / (wide)widths[i];
				const wide b = ((wide)x[0] - (wide)centers[2 * i + 1]) / (wide)widths[i];
				const wide s = a * a + b * b, log_part = s > 0 ? s * log((double)s) / 2 : 0;
				const wide values[] = {exp(-s / 2), 1 / (1 + s), 1 / sqrt(1 + s), sqrt(1 + s), log_part};
				near(3 + i, values[k % 5]);
			}
			near(3 + count, 1);
		}
		real five[5] = {1, 2, 3, 4, 5}; /* a kernel changes four of them */
		kernels[k % 5]->values(five);
		TEST_ASSERT_TRUE(five[4] > (real)4.9 && five[4] < (real)5.1);
	}
}

/* Over the whole range, against the logarithm of the C library in double. */
static void test_thin_plate_over_the_range(void) {
	random_source random = random_seed(95);
	for (int k = 0; k < 4000; k++) {
		real square[4];
		const double range = TEST_DOUBLE ? 1000 : 120;
		for (int i = 0; i < 4; i++) { square[i] = (real)exp2((double)random_uniform(&random, -range, range)); }
		if (k == 0) { square[0] = 0, square[1] = REAL_MIN / 2, square[2] = 1, square[3] = REAL_MIN; }
		real value[4];
		memcpy(value, square, sizeof value);
		KOOP(thin_plate).values(value);
		for (int i = 0; i < 4; i++) {
			const double s = (double)square[i], right = s >= (double)REAL_MIN ? s * (log(s) / 2) : 0;
			CHECK(fabs((double)value[i] - right) <= 4 * (double)REAL_EPSILON * fabs(right), "%g: %g instead of %g", s,
			      (double)value[i], right);
		}
	}
}

/* All monomials, each once: of three states up to degree 4, in the stated order. */
static void test_polynomials_of_a_degree(void) {
	static const unsigned char states[] = {2, 0, 1};
	for (size_t low = 0; low <= 4; low++) {
		for (size_t high = low; high <= 4; high++) {
			const KOOP(polynomials) own = {states, 3, low, high};
			const KOOP(part) part = {&KOOP(part_polynomials), &own};
			size_t at = 3;
			combine(3, &part, 1);
			x[0] = 3, x[1] = (real)-0.5, x[2] = 2;
			lift();
			const wide v[3] = {2, 3, -0.5L};
			for (int degree = (int)low; degree <= (int)high; degree++) {
				for (int a = degree; a >= 0; a--) {
					for (int b = degree - a; b >= 0; b--) { near(at++, pow(v[0], a) * pow(v[1], b) * pow(v[2], degree - a - b)); }
				}
			}
			TEST_ASSERT_EQUAL_size_t(at, dictionary.n_lifted);
		}
	}
}

static void refused(int status, size_t n, const KOOP(part_kind) *kind, const void *context) {
	const KOOP(part) part = {kind, context};
	const KOOP(combination) combination = {&part, 1};
	static KOOP(dictionary) before;
	before = dictionary;
	CHECK_STATUS(status, KOOP(combine)(&dictionary, "own", n, &combination));
	TEST_ASSERT_EQUAL_MEMORY(&before, &dictionary, sizeof before);
}

static size_t count_200(const void *context, size_t n_states) {
	(void)context;
	return 200 + 0 * n_states;
}

static real *lift_200(const void *context, const real *state, real *out) {
	(void)context;
	for (int i = 0; i < 200; i++) { *out++ = state[0]; }
	return out;
}

static void test_refused_settings(void) {
	static const unsigned char good[] = {0, 1, 2, 1}, bad[] = {0, 3};
	const KOOP(part_kind) *const angle = &KOOP(part_angles), *const product = &KOOP(part_products),
	                      *const poly = &KOOP(part_polynomials), *const rbf = &KOOP(part_rbf);
	const KOOP(angles) angles[] = {{NULL, 1, 0}, {good, 0, 0}, {bad, 2, 0}, {good, 1, 2}, {good, 1, -1}, {good, 256, 0}};
	const KOOP(products) products[] = {{NULL, 1}, {good, 0}, {bad, 1}, {good, 256}};
	const KOOP(polynomials) polynomials[] = {{NULL, 1, 1, 2}, {good, 0, 1, 2}, {bad, 2, 1, 2}, {good, 3, 3, 2},
	                                         {good, 3, 1, KOOP_MAX_DEGREE + 1}, {good, 256, 1, 1}};
	static const unsigned char five[] = {0, 1, 2, 0, 1};
	const KOOP(polynomials) many = {good, 4, 1, 8}, more = {five, 5, 1, 8};
	for (size_t i = 0; i < sizeof angles / sizeof *angles; i++) { refused(KOOP_E_RANGE, 3, angle, &angles[i]); }
	for (size_t i = 0; i < sizeof products / sizeof *products; i++) { refused(KOOP_E_RANGE, 3, product, &products[i]); }
	for (size_t i = 0; i < sizeof polynomials / sizeof *polynomials; i++) { refused(KOOP_E_RANGE, 3, poly, &polynomials[i]); }
	refused(KOOP_E_SIZE, 3, poly, &many); /* 494 */
	refused(KOOP_E_SIZE, 3, poly, &more); /* 495 of degree 8 alone */
	refused(KOOP_E_RANGE, 3, angle, NULL);
	refused(KOOP_E_RANGE, 3, product, NULL);
	refused(KOOP_E_RANGE, 3, poly, NULL);
	refused(KOOP_E_RANGE, 3, rbf, NULL);

	const real centers[] = {0, 1}, lost[] = {0, (real)NAN}, widths[] = {1, 2}, none[] = {1, 0}, endless[] = {1, (real)INFINITY};
	const KOOP(kernel) idle = {NULL};
	const KOOP(rbf) functions[] = {
	    {NULL, 1, 2, centers, widths, &KOOP(gaussian)}, {good, 0, 2, centers, widths, &KOOP(gaussian)},
	    {bad, 2, 1, centers, widths, &KOOP(gaussian)},  {good, 1, 0, centers, widths, &KOOP(gaussian)},
	    {good, 1, 2, NULL, widths, &KOOP(gaussian)},    {good, 1, 2, centers, NULL, &KOOP(gaussian)},
	    {good, 1, 2, lost, widths, &KOOP(gaussian)},    {good, 1, 2, centers, none, &KOOP(gaussian)},
	    {good, 1, 2, centers, endless, &KOOP(gaussian)}, {good, 1, 2, centers, widths, NULL}, {good, 1, 2, centers, widths, &idle},
	    {good, 256, 1, centers, widths, &KOOP(gaussian)}, {good, 1, 256, centers, widths, &KOOP(gaussian)}};
	for (size_t i = 0; i < sizeof functions / sizeof *functions; i++) { refused(KOOP_E_RANGE, 3, rbf, &functions[i]); }
}

static void test_refused_combinations(void) {
	static const KOOP(part_kind) many = {count_200, lift_200}, countless = {NULL, lift_200}, idle = {count_200, NULL};
	const KOOP(part) parts[] = {{&many, NULL}, {&many, NULL}};
	const KOOP(combination) twice = {parts, 2}, once = {parts, 1}, no_parts = {NULL, 0}, empty = {parts, 0};
	CHECK_STATUS(KOOP_E_NULL, KOOP(combine)(NULL, "own", 3, &once));
	CHECK_STATUS(KOOP_E_NULL, KOOP(combine)(&dictionary, NULL, 3, &once));
	CHECK_STATUS(KOOP_E_NULL, KOOP(combine)(&dictionary, "own", 3, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(combine)(&dictionary, "own", 3, &no_parts));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(combine)(&dictionary, "own", 0, &once));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(combine)(&dictionary, "own", KOOP_MAX_DIM + 1, &once));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(combine)(&dictionary, "own", 3, &twice));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(combine)(&dictionary, "own", 56, &once));
	CHECK_STATUS(KOOP_OK, KOOP(combine)(&dictionary, "own", 55, &once));
	TEST_ASSERT_EQUAL_size_t(KOOP_MAX_DIM, dictionary.n_lifted);
	CHECK_STATUS(KOOP_OK, KOOP(combine)(&dictionary, "own", 3, &once));
	lift(); /* your own kind */
	CHECK_STATUS(KOOP_OK, KOOP(combine)(&dictionary, "own", 3, &empty));
	TEST_ASSERT_EQUAL_size_t(3, dictionary.n_lifted);
	lift();
	refused(KOOP_E_NULL, 3, NULL, NULL);
	refused(KOOP_E_NULL, 3, &countless, NULL);
	refused(KOOP_E_NULL, 3, &idle, NULL);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_polynomials_of_the_drive_are_an_instance);
	RUN_TEST(test_polynomials_of_the_flapping_wing_are_an_instance);
	RUN_TEST(test_gaussians_of_the_paper_are_instances);
	RUN_TEST(test_kernels);
	RUN_TEST(test_thin_plate_over_the_range);
	RUN_TEST(test_polynomials_of_a_degree);
	RUN_TEST(test_refused_settings);
	RUN_TEST(test_refused_combinations);
	return UNITY_END();
}
