/* The estimator from one lifted state to many: sizes decide which loops of the kernels run. */
#include "reference.h"

static estimator e;

static int same_bits(real a, real b) {
	return memcmp(&a, &b, sizeof a) == 0;
}

static int is_zero(real a) {
	return fabs(a) <= 0;
}

/* ---- Content of the storage --------------------------------------------------------------------- */

/* Index of element (i, j) of a triangle in tiles of 4 x 4, as the header describes the storage. */
static size_t triangle_at(size_t i, size_t j) {
	const size_t tiles_before = i / 4 * (i / 4 + 1) / 2 + j / 4;
	return 16 * tiles_before + 4 * (i % 4) + j % 4;
}

/* Element (i, j) of a symmetric matrix, or null where only (j, i) is stored. */
static real *symmetric_element(real *M, size_t i, size_t j) {
	if (KOOP_VECTORS) { return M + i * e.rls.n_regressors_padded + j; }
	return j / 4 <= i / 4 ? M + triangle_at(i, j) : NULL;
}

/* The same bits on both sides of the diagonal, and nothing beyond d. */
static void check_symmetric(real *M) {
	const size_t d = e.rls.n_regressors, rows = e.rls.n_regressors_padded;
	for (size_t k = 0; k < rows * rows; k++) {
		const real *one = symmetric_element(M, k / rows, k % rows);
		const real *other = symmetric_element(M, k % rows, k / rows);
		if (!one) { continue; }
		const int inside = k / rows < d && k % rows < d;
		const int right = inside ? !other || same_bits(*one, *other) : is_zero(*one);
		CHECK(right, "%s, d %zu: (%zu, %zu)", estimator_name(&e), d, k / rows, k % rows);
	}
}

/* A positive diagonal, and nothing above it or beyond d. */
static void check_root(const real *S) {
	const size_t d = e.rls.n_regressors, rows = e.rls.n_regressors_padded;
	for (size_t i = 0; i < rows; i++) {
		for (size_t j = 0; j < i / 4 * 4 + 4; j++) {
			const real value = S[triangle_at(i, j)];
			const int right = i >= d || j > i ? is_zero(value) : i != j || value > 0;
			CHECK(right, "%s, d %zu: (%zu, %zu)", estimator_name(&e), d, i, j);
		}
	}
}

static void check_padding_of_theta(void) {
	const size_t rows = e.rls.n_lifted_padded;
	for (size_t k = 0; k < KOOP_EVEN(e.rls.n_regressors) * rows; k++) {
		const int inside = k / rows < e.rls.n_regressors && k % rows < e.rls.n_lifted;
		CHECK(inside || is_zero(e.rls.theta[k]), "%s, N %zu: %zu", estimator_name(&e), e.rls.n_lifted, k);
	}
}

/* Nothing is written behind the storage that is asked for. */
static void check_fence(void) {
	const real untouched = (real)NAN;
	size_t reals;
	CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reals));
	for (; reals < sizeof e.storage / sizeof *e.storage; reals++) {
		CHECK(same_bits(e.storage[reals], untouched), "%s, N %zu", estimator_name(&e), e.rls.n_lifted);
	}
}

static void check_storage(void) {
	const int inverse = e.config.regulator == &KOOP(reg_sift);
	if (e.config.form == &KOOP(form_sqrt)) { check_root(e.rls.covariance); }
	if (e.config.form == &KOOP(form_plain)) {
		check_symmetric(e.rls.covariance);
		if (inverse) { check_symmetric(e.rls.covariance + KOOP_SYMMETRIC(e.rls.n_regressors)); }
	}
	check_padding_of_theta();
	check_fence();
}

/* ---- What comes out -------------------------------------------------------------------------- */

/* Theta zeta */
static void predict(const reference *paper, const real *zeta, wide *psi_next) {
	for (size_t i = 0; i < paper->N; i++) {
		psi_next[i] = 0;
		const wide *row = paper->theta + i * paper->d;
		for (size_t j = 0; j < paper->d; j++) { psi_next[i] += row[j] * (wide)zeta[j]; }
	}
}

static wide innovation_of(const reference *paper, const real *zeta, const real *psi_next) {
	wide predicted[MAX_N], sum = 0;
	predict(paper, zeta, predicted);
	for (size_t i = 0; i < paper->N; i++) { sum += pow((wide)psi_next[i] - predicted[i], 2); }
	return sqrt(sum);
}

static void check_close(real value, wide expected, const char *what) {
	CHECK(fabs((wide)value - expected) <= 300 * (wide)REAL_EPSILON * fmax(1, fabs(expected)),
	      "%s, N %zu, d %zu: %s %g instead of %g", estimator_name(&e), e.rls.n_lifted, e.rls.n_regressors,
	      what, (double)value, (double)expected);
}

static void check_health(const KOOP(health) *health, const reference *paper, wide innovation) {
	const size_t d = paper->d;
	wide trace = 0, least = paper->P[0];
	for (size_t i = 0; i < d; i++) {
		trace += paper->P[i * d + i];
		least = fmin(least, paper->P[i * d + i]);
	}
	check_close(health->innovation, innovation, "innovation");
	check_close(health->trace, trace, "trace");
	check_close(health->min_diagonal, least, "diagonal");
}

static void check_prediction(const reference *paper, const real *zeta) {
	real psi_next[MAX_N];
	wide expected[MAX_N];
	predict(paper, zeta, expected);
	CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + paper->N, psi_next));
	for (size_t i = 0; i < paper->N; i++) { check_close(psi_next[i], expected[i], "prediction"); }
}

/* psi_next follows zeta, and the step is compared with the literal recursion. */
static void check_step(random_source *random, reference *paper, size_t d) {
	real zeta[MAX_D], psi_next[MAX_N];
	KOOP(health) health;
	learned now;
	random_fill(random, zeta, d, -1, 1);
	random_fill(random, psi_next, e.dictionary.n_lifted, -1, 1);
	const wide innovation = innovation_of(paper, zeta, psi_next);
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
	(void)reference_update(paper, zeta, psi_next);
	learned_take(&now, &e);
	const double theta = relative_difference(now.theta, paper->theta, e.dictionary.n_lifted * d);
	const double P = relative_difference(now.covariance, paper->P, d * d);
	CHECK(theta <= 100 * (double)REAL_EPSILON, "%s, N %zu, d %zu: Theta %g", estimator_name(&e),
	      e.dictionary.n_lifted, d, theta);
	CHECK(P <= 300 * (double)REAL_EPSILON, "%s, N %zu, d %zu: P %g", estimator_name(&e),
	      e.dictionary.n_lifted, d, P);
	check_health(&health, paper, innovation);
	check_prediction(paper, zeta);
	check_storage();
}

static void test_every_size_follows_the_paper(void) {
	static reference paper;
	random_source random = random_seed(61);
	for (size_t N = 1; N <= MAX_N; N++) {
		for (size_t k = 0; k < MAX_M * FORMS * 2; k++) {
			const size_t m = 1 + k % MAX_M;
			estimator_default(&e, N, m, k < MAX_M * FORMS ? &KOOP(reg_ef) : &KOOP(reg_sift),
			                  all_forms[k / MAX_M % FORMS]);
			check_storage();
			reference_start(&paper, &e);
			for (int step = 0; step < 3; step++) { check_step(&random, &paper, N + m); }
		}
	}
}

/* ---- Bits that differ on either side of the diagonal --------------------------------------------- */

/* Every element above the diagonal that is stored there is off by a thousandth. */
static void spoil_upper_half(real *M) {
	const size_t d = e.rls.n_regressors;
	for (size_t k = 0; k < d * d; k++) {
		real *element = symmetric_element(M, k / d, k % d);
		if (k % d > k / d && element) { *element *= (real)1.001; }
	}
}

static int row_is_symmetric(real *M, size_t i) {
	for (size_t j = 0; j < i; j++) {
		const real *other = symmetric_element(M, j, i);
		if (other && !same_bits(*symmetric_element(M, i, j), *other)) { return 0; }
	}
	return 1;
}

/* A sample makes the next row symmetric, the last is followed by the first, and d of them all. */
static void check_rows_become_symmetric(random_source *random, int matrices) {
	real *M[2] = {e.rls.covariance, e.rls.covariance + KOOP_SYMMETRIC(e.rls.n_regressors)};
	const size_t d = e.rls.n_regressors, first = e.rls.mirrored;
	for (int k = 0; k < matrices; k++) { spoil_upper_half(M[k]); }
	for (size_t step = 1; step <= d; step++) {
		estimator_teach(&e, random, 1);
		TEST_ASSERT_EQUAL_size_t((first + step) % d, e.rls.mirrored);
		for (int k = 0; k < matrices; k++) {
			CHECK(row_is_symmetric(M[k], e.rls.mirrored), "%s, d %zu, step %zu", estimator_name(&e), d, step);
		}
	}
	for (int k = 0; k < matrices; k++) { check_symmetric(M[k]); }
}

static void test_plain_form_becomes_symmetric_row_by_row(void) {
	random_source random = random_seed(62);
	for (size_t N = 1; N <= MAX_N; N += N < 10 ? 1 : 4) {
		for (size_t k = 0; k < REGULATORS; k++) {
			const int matrices = all_regulators[k] == &KOOP(reg_sift) ? 2 : 1;
			estimator_settings(&e, N, 1 + (N + k) % MAX_M, all_regulators[k], &KOOP(form_plain));
			e.dead_zone.delta = 0; /* no sample is gated */
			estimator_start(&e);
			TEST_ASSERT_EQUAL_size_t(0, e.rls.mirrored);
			if (all_regulators[k]->extension && all_regulators[k]->extension->reshape) { continue; } /* more than a row */
			estimator_teach(&e, &random, 3);
			check_rows_become_symmetric(&random, matrices);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_every_size_follows_the_paper);
	RUN_TEST(test_plain_form_becomes_symmetric_row_by_row);
	return UNITY_END();
}
