/* Both forms of P against what the header says a step does to it, written out with full matrices in wide
 * arithmetic: one update at a time from what P is, with steps that no regulator of the library asks for, and
 * sizes of P all over the range. */
#include "support.h"

enum { UPDATES = 12, ESTIMATORS = 300 / TEST_SHARE, MOST_N = 11, MOST_M = 3, MOST_D = MOST_N + MOST_M };

static estimator e;
static KOOP(step) wanted; /* set before each update */

static int decide_as_wanted(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls, (void)innovation;
	*step = wanted;
	return KOOP_OK;
}

static const KOOP(regulator) as_wanted = {.name = "as wanted", .decide = decide_as_wanted};

/* What an update should do, and what there was. */
typedef struct {
	wide before[MOST_D][MOST_D], P[MOST_D][MOST_D]; /* P before and after */
	wide sizes[MOST_D];                             /* of what the rounding of row i is a part: its root */
	wide scale, bound;                              /* of P, of the elements of what is kept */
	wide denominator;
	int any_sign; /* 1: P may be indefinite, and its elements beyond the size that its diagonal tells */
} expectation;

static size_t regressors(void) {
	return e.rls.n_regressors;
}

static int is_root(void) {
	return e.config.form == &KOOP(form_sqrt);
}

/* ---- P as it is kept ------------------------------------------------------------ */

/* Element (i, j), j <= i, of what is kept: of P or of the transpose of its root. */
static wide kept(size_t i, size_t j) {
	return e.config.form->get(&e.rls, 0, i, j);
}

static wide element(size_t i, size_t j) {
	wide sum = 0;
	if (!is_root()) { return i < j ? kept(j, i) : kept(i, j); }
	for (size_t k = i < j ? j : i; k < regressors(); k++) { sum += kept(k, i) * kept(k, j); }
	return sum;
}

static wide largest_kept(void) {
	wide most = 0;
	for (size_t i = 0; i < regressors(); i++) {
		for (size_t j = 0; j <= i; j++) { most = fmax(most, fabs(kept(i, j))); }
	}
	return most;
}

/* ---- What it should become --------------------------------------------------------- */

/* g = (P + inflate zeta zeta') zeta; returns zeta' g */
static wide write_gain(const expectation *x, const real *zeta, wide *g) {
	wide sum = 0;
	for (size_t i = 0; i < regressors(); i++) {
		g[i] = 0;
		for (size_t j = 0; j < regressors(); j++) { g[i] += x->before[i][j] * zeta[j]; }
		for (size_t j = 0; j < regressors(); j++) {
			g[i] += (wide)wanted.inflate * zeta[i] * zeta[j] * zeta[j];
		}
		sum += zeta[i] * g[i];
	}
	return sum;
}

/* From what it was: an element of u u' is at most u' u, and what a rotation by w adds to one of the root is
 * at most the largest of w. */
static void write_bound(expectation *x, const real *zeta, const wide *g, wide denominator) {
	const wide was = (wide)e.rls.covariance_bound * e.rls.covariance_scale;
	wide growth = 0, largest = 0;
	for (size_t i = 0; i < regressors(); i++) {
		growth += g[i] * (g[i] / fabs(denominator)) + (wide)wanted.inflate * zeta[i] * zeta[i];
		largest = fmax(largest, fabs((wide)zeta[i]));
	}
	x->bound = (was + growth) * x->scale;
	if (is_root()) { x->bound = sqrt((wide)wanted.scale) * (was + sqrt((wide)wanted.inflate) * largest); }
	if (is_root() && wanted.trace > 0) { x->bound = 2 * sqrt((wide)wanted.trace); }
}

static void write_step(expectation *x, const real *zeta) {
	const size_t d = regressors();
	wide g[MOST_D], trace = 0;
	const wide denominator = x->denominator = wanted.noise + write_gain(x, zeta, g);
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j < d; j++) {
			const wide inflated = x->before[i][j] + (wide)wanted.inflate * zeta[i] * zeta[j];
			x->P[i][j] = inflated - g[i] * (g[j] / denominator);
			if (i == j) { x->sizes[i] = fabs(inflated) + g[i] * (g[i] / fabs(denominator)); }
		}
		trace += x->P[i][i];
	}
	x->scale = wanted.trace > 0 ? wanted.trace / trace : wanted.scale;
	write_bound(x, zeta, g, denominator);
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j < d; j++) { x->P[i][j] *= x->scale; }
		x->sizes[i] = sqrt(x->sizes[i] * x->scale);
	}
	for (size_t i = 0; x->any_sign && i < d; i++) { x->sizes[i] = sqrt(x->bound); }
}

static void expect(expectation *x, const real *zeta) {
	for (size_t i = 0; i < regressors(); i++) {
		for (size_t j = 0; j < regressors(); j++) { x->before[i][j] = element(i, j); }
	}
	write_step(x, zeta);
}

static void check_covariance(const expectation *x, int round) {
	for (size_t i = 0; i < regressors(); i++) {
		for (size_t j = 0; j < regressors(); j++) {
			const wide off = fabs(element(i, j) - x->P[i][j]) / (x->sizes[i] * x->sizes[j]);
			CHECK(off <= 40 * REAL_EPSILON, "%s round %d: P[%zu][%zu] %g, not %g", estimator_name(&e), round,
			      i, j, (double)element(i, j), (double)x->P[i][j]);
			const wide told = e.config.form->element(&e.rls, i, j), size = x->sizes[i] * x->sizes[j];
			CHECK(fabs(told - element(i, j)) <= 40 * REAL_EPSILON * size, "%s round %d: told %g, is %g",
			      estimator_name(&e), round, (double)told, (double)element(i, j));
		}
	}
}

/* ---- Side by side --------------------------------------------------------------------- */

static void check_bound(const expectation *x, int round) {
	const wide bound = (wide)e.rls.covariance_bound * e.rls.covariance_scale;
	CHECK(bound >= largest_kept() * (1 - 4 * REAL_EPSILON), "%s round %d: %g beyond %g", estimator_name(&e),
	      round, (double)largest_kept(), (double)bound);
	CHECK(fabs(bound / x->bound - 1) <= 100 * REAL_EPSILON, "%s round %d: bound %g, not %g",
	      estimator_name(&e), round, (double)bound, (double)x->bound);
	CHECK(e.rls.covariance_scale > (real)1 / 1024 && e.rls.covariance_scale < 1024, "scale %g",
	      (double)e.rls.covariance_scale);
}

static void check_health(const expectation *x, const KOOP(health) *health, int round) {
	wide trace = 0, least = x->P[0][0], size = 0;
	for (size_t i = 0; i < regressors(); i++) {
		trace += x->P[i][i];
		least = fmin(least, x->P[i][i]);
		size += x->sizes[i] * x->sizes[i];
	}
	CHECK(fabs(health->trace - trace) <= 40 * REAL_EPSILON * size, "%s round %d: trace %g, not %g",
	      estimator_name(&e), round, (double)health->trace, (double)trace);
	CHECK(fabs(health->min_diagonal - least) <= 40 * REAL_EPSILON * size, "%s round %d: least %g, not %g",
	      estimator_name(&e), round, (double)health->min_diagonal, (double)least);
}

/* All that was learned, but for the numbers of scratch behind it. */
typedef struct {
	real kept[sizeof e.storage / sizeof *e.storage], scale, bound;
} snapshot;

static void take(snapshot *s) {
	memset(s, 0, sizeof *s);
	memcpy(s->kept, e.storage, e.rls.kept * sizeof *s->kept);
	s->scale = e.rls.covariance_scale;
	s->bound = e.rls.covariance_bound;
}

static void check_same(const snapshot *before, int round) {
	static snapshot after;
	take(&after);
	CHECK(memcmp(before, &after, sizeof after) == 0, "%s round %d: changed", estimator_name(&e), round);
}

/* Learns one sample; P becomes what it should, or stays as it was. The regressor is not touched. */
static int check_update(expectation *x, const real *zeta, int round) {
	static snapshot before;
	const real psi_next[MOST_N] = {0};
	KOOP(health) health;
	take(&before);
	expect(x, zeta);
	const int status = estimator_update(&e, zeta, psi_next, &health);
	TEST_ASSERT_EQUAL_MEMORY(zeta, e.rls.zeta, regressors() * sizeof *zeta);
	if (status != KOOP_OK) {
		check_same(&before, round);
		return status;
	}
	check_covariance(x, round);
	check_bound(x, round);
	check_health(x, &health, round);
	return KOOP_OK;
}

static wide largest_diagonal(void) {
	wide most = 0;
	for (size_t i = 0; i < regressors(); i++) { most = fmax(most, element(i, i)); }
	return most;
}

/* 10 to a power between the two */
static double decades(random_source *random, double from, double to) {
	return pow(10, (double)random_uniform(random, from, to));
}

/* A regressor of about the size that P calls for, and a step of which each part may be next to nothing or the
 * most of it. */
static void random_sample(random_source *random, real *zeta) {
	const double P = (double)largest_diagonal(), size = decades(random, -1, 0.5) / sqrt(P);
	random_fill(random, zeta, regressors(), -size, size);
	if (random_below(random, 3) == 0) { zeta[random_below(random, regressors())] = 0; }
	wanted = (KOOP(step)){(real)decades(random, -1, 1), 1, 0, 0, 0, 1, 1, 1};
	const size_t kind = random_below(random, 4), inflated = random_below(random, 2);
	if (kind == 0) { wanted.scale = (real)pow(2, (double)random_uniform(random, -4, 6)); }
	if (kind == 1) { wanted.trace = (real)(P * decades(random, -4, 4)); }
	if (inflated) { wanted.inflate = (real)(P / size / size * decades(random, -3, 1)); }
}

static void any_estimator(random_source *random, int check) {
	const int orders = (TEST_DOUBLE ? DBL_MAX_EXP : FLT_MAX_EXP) / 4;
	estimator_settings(&e, 1 + random_below(random, MOST_N), 1 + random_below(random, MOST_M), &as_wanted,
	                   all_forms[random_below(random, FORMS)]);
	e.config.check = check;
	e.config.p0 = (real)ldexp(1, (int)random_below(random, 2 * (size_t)orders) - orders);
	estimator_start(&e);
}

static void test_every_step_makes_of_the_covariance_what_the_header_says(void) {
	random_source random = random_seed(81);
	int taken = 0;
	for (int round = 0; round < ESTIMATORS; round++) {
		any_estimator(&random, round % 3);
		for (int k = 0; k < UPDATES; k++) {
			static expectation x;
			real zeta[MOST_D];
			random_sample(&random, zeta);
			const int status = check_update(&x, zeta, round);
			CHECK(status == KOOP_OK || status == KOOP_E_INDEFINITE, "%s round %d: status %d",
			      estimator_name(&e), round, status);
			taken += status == KOOP_OK;
		}
	}
	CHECK(taken > ESTIMATORS * UPDATES * 9 / 10, "%d taken", taken);
}

/* The diagonal, and what stands behind it. */
static void check_diagonal(int round) {
	const size_t d = regressors(), rows = KOOP_PAD(d);
	real diagonal[KOOP_PAD(MOST_D) + 8];
	for (size_t i = 0; i < sizeof diagonal / sizeof *diagonal; i++) { diagonal[i] = 7; }
	e.config.form->diagonal(&e.rls, diagonal);
	for (size_t i = 0; i < rows; i++) {
		const wide right = i < d ? element(i, i) : 0;
		CHECK(fabs(diagonal[i] - right) <= 40 * REAL_EPSILON * right, "%s round %d: %zu", estimator_name(&e),
		      round, i);
	}
	for (size_t i = rows; i < rows + 8; i++) { TEST_ASSERT_TRUE(diagonal[i] >= 7 && diagonal[i] <= 7); }
}

static void test_the_diagonal_is_padded_with_zeros(void) {
	random_source random = random_seed(84);
	for (int round = 0; round < ESTIMATORS; round++) {
		any_estimator(&random, KOOP_CHECK_REFUSE);
		real zeta[MOST_D], psi_next[MOST_N] = {0};
		random_sample(&random, zeta);
		(void)estimator_update(&e, zeta, psi_next, NULL);
		check_diagonal(round);
	}
}

/* Another number to start from leaves nothing of what was learned, in P^-1 neither. */
static void test_a_covariance_that_is_started_again_is_as_at_the_start(void) {
	for (int r = 0; r < REGULATORS * FORMS; r++) {
		static snapshot fresh;
		random_source random = random_seed(85);
		estimator_settings(&e, 5, 2, all_regulators[r / FORMS], all_forms[r % FORMS]);
		e.config.p0 = 3;
		estimator_start(&e);
		take(&fresh);
		const size_t mirrored = e.rls.mirrored;
		estimator_teach(&e, &random, 20);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 3));
		memset(e.rls.theta, 0, KOOP_EVEN(7) * KOOP_PAD(5) * sizeof(real));
		check_same(&fresh, r);
		TEST_ASSERT_TRUE(e.rls.mirrored == mirrored);
	}
}

/* ---- The ends of the range ------------------------------------------------------------- */

static void begin(const KOOP(form) *form, real p0, size_t N) {
	estimator_settings(&e, N, 1, &as_wanted, form);
	e.config.p0 = p0;
	e.config.check = KOOP_CHECK_DIAGONAL;
	estimator_start(&e);
	wanted = (KOOP(step)){1, 1, 0, 0, 0, 1, 1, 1};
}

static int update(real first, real second) {
	const real zeta[MOST_D] = {first, second}, psi_next[MOST_D] = {0};
	return estimator_update(&e, zeta, psi_next, NULL);
}

/* The least number of the range is taken, and nothing less: of P, and of what is kept of it. */
static void test_diagonal_of_the_plain_form_may_be_the_least_number(void) {
	begin(&KOOP(form_plain), REAL_MIN, 1);
	CHECK_STATUS(KOOP_OK, update(0, 0));
	wanted.scale = (real)0.75;
	CHECK_STATUS(KOOP_E_INDEFINITE, update(0, 0));
	for (int half = 0; half < 2; half++) { /* noise and zeta' P zeta are 2: half of it is left */
		begin(&KOOP(form_plain), (real)(2 - half) * REAL_MIN, 1);
		wanted = (KOOP(step)){(real)(2 - half), 4, 0, 0, 0, 1, 1, 1};
		CHECK_STATUS(half ? KOOP_E_INDEFINITE : KOOP_OK, update((real)(1 / sqrt((double)REAL_MIN)), 0));
	}
}

/* What is kept is 1 and -1. */
static void test_no_trace_cannot_be_brought_to_one(void) {
	begin(&KOOP(form_plain), 1, 1);
	e.config.form->set(&e.rls, 0, 1, 1, -1);
	wanted.trace = 1;
	CHECK_STATUS(KOOP_E_INDEFINITE, update(0, 0));
}

/* From 1/1024 or 1024 on it is worked into P, so that neither leaves the range before the other. */
static void test_scale_of_the_plain_form_stays_near_one(void) {
	for (int shrinks = 0; shrinks < 2; shrinks++) {
		begin(&KOOP(form_plain), 1, 1);
		wanted.scale = shrinks ? (real)0.5 : 2;
		for (int k = 1; k <= 25; k++) {
			const wide right = exp2((wide)(shrinks ? -k : k));
			CHECK_STATUS(KOOP_OK, update(0, 0));
			CHECK(e.rls.covariance_scale > (real)1 / 1024 && e.rls.covariance_scale < 1024, "step %d: %g", k,
			      (double)e.rls.covariance_scale);
			CHECK(element(0, 0) >= right && element(0, 0) <= right, "step %d: %g", k, (double)element(0, 0));
		}
	}
}

static void test_elements_are_below_half_of_the_range(void) {
	const real half = REAL_MAX / 2, below = nextafter(half, (real)0);
	for (int f = 0; f < FORMS; f++) {
		begin(all_forms[f], 1, 3);
		for (size_t i = 0; i < 4; i++) { e.config.form->set(&e.rls, 0, i, i, below); }
		e.rls.covariance_bound = below;
		CHECK_STATUS(KOOP_OK, update(0, 0));
		e.rls.covariance_bound = half;
		CHECK_STATUS(f ? KOOP_E_OVERFLOW : KOOP_OK, update(0, 0));
		e.config.form->set(&e.rls, 0, 3, 3, half);
		e.rls.covariance_bound = half;
		CHECK_STATUS(KOOP_E_OVERFLOW, update(0, 0));
	}
}

/* A row of the root may be twice as long as its largest element where it has four of them. */
static void test_bound_of_the_root_that_is_too_loose_is_found_again(void) {
	for (int over = 0; over < 2; over++) {
		begin(&KOOP(form_sqrt), 1, 3);
		e.config.form->set(&e.rls, 0, 2, 1, over ? REAL_MAX / 4 : nextafter(REAL_MAX / 4, (real)0));
		e.rls.covariance_bound = REAL_MAX;
		CHECK_STATUS(over ? KOOP_E_OVERFLOW : KOOP_OK, update(0, 0));
		TEST_ASSERT_TRUE(over || e.rls.covariance_bound < REAL_MAX / 2);
	}
}

/* By the largest element as it is, and what this update can add to it. */
static void test_bound_that_is_found_again_is_one_after_the_update(void) {
	for (int f = 0; f < FORMS; f++) {
		begin(all_forms[f], 1, 3);
		e.rls.covariance_bound = REAL_MAX;
		wanted = (KOOP(step)){1, 4, 9, 0, 0, 1, 1, 1};
		CHECK_STATUS(KOOP_OK, update(1, 0));
		/* the root: twice 2, of four elements of 1, and 3; P: 4 times 1, and 9, and 10 10 / (1 + 10) */
		const wide right = f ? 2 * (2 + 3) : 4 * (1 + 9 + 100 / (wide)11);
		const wide bound = (wide)e.rls.covariance_bound * e.rls.covariance_scale;
		CHECK(fabs(bound / right - 1) < 8 * REAL_EPSILON, "%s: %g, not %g", estimator_name(&e), (double)bound,
		      (double)right);
	}
}

/* A regressor of three elements may leave a quarter of P and half of its root. Whichever element of the
 * diagonal is the least of the range then, it is taken, and what is less is not. */
static int update_without(size_t j, real size) {
	real zeta[MOST_D] = {0}, psi_next[MOST_N] = {0};
	const size_t d = regressors();
	for (size_t i = 1; i < 4; i++) { zeta[(j + i) % d] = size; }
	return estimator_update(&e, zeta, psi_next, NULL);
}

static void test_diagonal_of_the_root_may_be_the_least_number(void) {
	for (size_t j = 0; j < 9; j++) {
		for (int below = 0; below < 2; below++) {
			begin(&KOOP(form_sqrt), 1, 8);
			e.config.form->set(&e.rls, 0, j, j, REAL_MIN * (below ? (real)1.99 : 2));
			CHECK_STATUS(below ? KOOP_E_INDEFINITE : KOOP_OK, update_without(j, 1));
			begin(&KOOP(form_sqrt), 1, 8); /* and less by the trace: 8, to be 8 / 2^20 */
			e.config.form->set(&e.rls, 0, j, j, REAL_MIN * (below ? (real)2047 : 2048));
			wanted.trace = (real)exp2(-17);
			CHECK_STATUS(below ? KOOP_E_INDEFINITE : KOOP_OK, update_without(j, 1));
		}
	}
}

/* The trace comes to 4 and is 2^-6 before, of which a quarter may be left: by 2^10 times what it is to be. */
static void test_factor_of_the_trace_fits_the_range(void) {
	const int most = TEST_DOUBLE ? DBL_MAX_EXP : FLT_MAX_EXP;
	for (int over = 0; over < 2; over++) {
		begin(&KOOP(form_sqrt), (real)exp2(-8), 3);
		wanted.trace = (real)((over ? 1.01 : 0.99) * exp2(most - 8));
		CHECK_STATUS(over ? KOOP_E_OVERFLOW : KOOP_OK, update_without(0, 16));
	}
	begin(&KOOP(form_sqrt), 1, 3); /* the trace itself does not */
	e.config.form->set(&e.rls, 0, 3, 3, (real)exp2(most / 2));
	wanted.trace = 1;
	CHECK_STATUS(KOOP_E_OVERFLOW, update(0, 0));
	begin(&KOOP(form_sqrt), (real)0.25, 3); /* a trace of 1 */
	wanted.trace = REAL_MAX;
	CHECK_STATUS(KOOP_E_OVERFLOW, update(0, 0));
}

/* What is left of a trace is the sum of up to 16 squares, each of which is 0 below the least number: four
 * times all of that is enough. */
static void test_trace_is_large_enough_to_be_summed(void) {
	const real p0 = 64 * REAL_MIN;
	for (int below = 0; below < 2; below++) {
		begin(&KOOP(form_sqrt), p0, 3);
		if (below) { e.config.form->set(&e.rls, 0, 0, 0, (real)(0.99 * sqrt((double)p0))); }
		wanted.trace = 256 * REAL_MIN;
		CHECK_STATUS(below ? KOOP_E_INDEFINITE : KOOP_OK, update_without(0, (real)(1 / sqrt((double)p0))));
	}
}

/* P is definite by three quarters of d epsilon, which is not enough, or by five. */
static void test_every_pair_of_regressors_is_told_from_one_by_d_roundings(void) {
	enum { D = 14 };
	for (size_t pair = 0; pair < D * D; pair++) {
		const size_t i = pair / D, j = pair % D;
		for (int enough = 0; j < i && enough < 2; enough++) {
			begin(&KOOP(form_plain), 1, D - 1);
			e.config.check = KOOP_CHECK_REPORT;
			estimator_start(&e);
			e.config.form->set(&e.rls, 0, i, j, 1 - (real)(enough ? 1.25 : 0.75) * D * REAL_EPSILON);
			CHECK_STATUS(KOOP_OK, update(0, 0));
			CHECK(e.rls.positive_definite == enough, "%zu and %zu", i, j);
		}
	}
}

/* And by d epsilon themselves, so that without them nothing is left. */
static void test_definite_by_d_roundings_is_not_enough(void) {
	const real diagonal = 1 + 2 * REAL_EPSILON;
	begin(&KOOP(form_plain), diagonal, 1);
	e.config.check = KOOP_CHECK_REPORT;
	estimator_start(&e);
	e.config.form->set(&e.rls, 0, 1, 0, 1);
	CHECK_STATUS(KOOP_OK, update(0, 0));
	TEST_ASSERT_EQUAL_INT(0, e.rls.positive_definite);
}

/* ---- Indefinite ------------------------------------------------------------------------ */

/* L L' less some of w w', times p0. */
static void make_indefinite(random_source *random) {
	const size_t d = regressors();
	real L[MOST_D * MOST_D], w[MOST_D];
	const wide part = random_uniform(random, 0, random_below(random, 3) ? 1 : 5);
	random_fill(random, L, d * d, -1, 1);
	random_fill(random, w, d, -1, 1);
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			wide sum = -part * w[i] * w[j];
			for (size_t k = 0; k < d; k++) { sum += (wide)L[i * d + k] * L[j * d + k]; }
			e.config.form->set(&e.rls, 0, i, j, (real)(e.config.p0 * sum));
		}
	}
	e.rls.covariance_bound = (real)largest_kept();
}

/* 1: positive, -1: not, 0: by too little to be told */
static int sign_of(wide x, wide size) {
	return (x > size / 10000) - (x < -size / 10000);
}

/* Of what P should become: that it is positive definite, or has a positive diagonal. */
static int sign_of_result(const expectation *x, int diagonal) {
	const size_t d = regressors();
	real P[MOST_D * MOST_D];
	double least = 0, largest = 0;
	for (size_t i = 0; i < d * d; i++) { P[i] = (real)(x->P[i / d][i % d] / x->bound); }
	eigenvalue_range(P, d, &least, &largest);
	for (size_t i = 0; diagonal && i < d; i++) { least = i > 0 ? fmin(least, P[i * (d + 1)]) : (double)P[0]; }
	return sign_of(least, 1);
}

/* Refused or reported, as the header says; returns 1 where nothing can be told. */
static int check_indefinite(random_source *random, int round) {
	static expectation x;
	real zeta[MOST_D];
	const double size = 1 / sqrt((double)e.config.p0);
	random_fill(random, zeta, regressors(), -size, size);
	wanted = (KOOP(step)){(real)0.5, (real)random_uniform(random, 0.5, 2), 0, 0, 0, 1, 1, 1};
	const double p0 = (double)e.config.p0;
	if (round % 2) { wanted.inflate = (real)(p0 * p0 * (double)random_uniform(random, 0, 1)); }
	x.any_sign = 1;
	const int status = check_update(&x, zeta, round), report = e.config.check == KOOP_CHECK_REPORT;
	const int denominator = sign_of(x.denominator, 1);
	const int result = sign_of_result(&x, e.config.check == KOOP_CHECK_DIAGONAL);
	if (denominator * result == 0) { return 1; }
	const int definite = denominator > 0 && result > 0;
	CHECK_STATUS(report || definite ? KOOP_OK : KOOP_E_INDEFINITE, status);
	if (report) { TEST_ASSERT_EQUAL_INT(result > 0, e.rls.positive_definite); }
	return 0;
}

static void test_covariance_that_is_indefinite_is_refused_or_reported(void) {
	random_source random = random_seed(82);
	int open = 0;
	for (int round = 0; round < 3 * ESTIMATORS; round++) {
		do { any_estimator(&random, round % 3); } while (is_root());
		make_indefinite(&random);
		open += check_indefinite(&random, round);
	}
	CHECK(open < 3 * ESTIMATORS / 20, "%d", open);
}

/* ---- Information -------------------------------------------------------------------------- */

/* zeta' P^-1 zeta */
static wide information(const real *zeta) {
	static wide M[MOST_D * MOST_D], y[MOST_D];
	const size_t d = regressors();
	wide sum = 0;
	for (size_t i = 0; i < d * d; i++) { M[i] = element(i / d, i % d); }
	for (size_t i = 0; i < d; i++) { y[i] = zeta[i]; }
	solve_positive_definite(M, d, y, 1);
	for (size_t i = 0; i < d; i++) { sum += zeta[i] * y[i]; }
	return sum;
}

static void test_information_is_that_of_the_inverse_of_the_covariance(void) {
	random_source random = random_seed(83);
	for (int round = 0; round < ESTIMATORS; round++) {
		const size_t N = 1 + random_below(&random, MOST_N), m = 1 + random_below(&random, MOST_M);
		estimator_settings(&e, N, m, &KOOP(reg_sift), all_forms[round % 2]);
		e.config.p0 = (real)decades(&random, -6, 6);
		estimator_start(&e);
		for (int k = 0; k < UPDATES; k++) {
			real zeta[MOST_D], psi_next[MOST_N] = {0};
			const double size = 1 / sqrt((double)largest_diagonal());
			random_fill(&random, zeta, regressors(), -size, size);
			memcpy(e.rls.zeta, zeta, regressors() * sizeof *zeta);
			const wide right = information(zeta), found = e.config.form->information(&e.rls);
			CHECK(fabs(found / right - 1) < 2000 * REAL_EPSILON, "%s round %d: %g, not %g",
			      estimator_name(&e), round, (double)found, (double)right);
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_the_diagonal_is_padded_with_zeros);
	RUN_TEST(test_a_covariance_that_is_started_again_is_as_at_the_start);
	RUN_TEST(test_diagonal_of_the_plain_form_may_be_the_least_number);
	RUN_TEST(test_no_trace_cannot_be_brought_to_one);
	RUN_TEST(test_scale_of_the_plain_form_stays_near_one);
	RUN_TEST(test_elements_are_below_half_of_the_range);
	RUN_TEST(test_bound_of_the_root_that_is_too_loose_is_found_again);
	RUN_TEST(test_bound_that_is_found_again_is_one_after_the_update);
	RUN_TEST(test_diagonal_of_the_root_may_be_the_least_number);
	RUN_TEST(test_factor_of_the_trace_fits_the_range);
	RUN_TEST(test_trace_is_large_enough_to_be_summed);
	RUN_TEST(test_every_pair_of_regressors_is_told_from_one_by_d_roundings);
	RUN_TEST(test_definite_by_d_roundings_is_not_enough);
	RUN_TEST(test_covariance_that_is_indefinite_is_refused_or_reported);
	RUN_TEST(test_information_is_that_of_the_inverse_of_the_covariance);
	RUN_TEST(test_every_step_makes_of_the_covariance_what_the_header_says);
	return UNITY_END();
}
