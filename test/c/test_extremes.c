/* Settings and samples from both ends of the range, at random: a sample is learned or refused, and whichever,
 * Theta stays finite and P's diagonal positive. What no trajectory of a robot reaches, a broken sensor or a
 * wrong unit does. */
#include "support.h"

enum { ESTIMATORS = 20000 / TEST_SHARE, SAMPLES = 40, MOST_N = 8, MOST_M = 2, MOST_D = MOST_N + MOST_M };

static random_source random;
static estimator e;

#define ANY_OF(...)                                                                                          \
	any_of((const double[]){__VA_ARGS__}, sizeof((const double[]){__VA_ARGS__}) / sizeof(double))

static real any_of(const double *values, size_t count) {
	return (real)values[random_below(&random, count)];
}

/* All binary orders of magnitude alike. */
static real any_magnitude(void) {
	const int lowest = ilogb((double)REAL_MIN), orders = ilogb((double)REAL_MAX) - lowest;
	const int exponent = lowest + (int)random_below(&random, (size_t)orders);
	return (real)ldexp((double)random_uniform(&random, -2, 2), exponent);
}

/* Ordinary, of one magnitude, each of its own, or one alone. */
static void any_vector(real *x, size_t count) {
	const size_t kind = random_below(&random, 4), chosen = random_below(&random, count);
	const real magnitude = any_magnitude();
	random_fill(&random, x, count, -1, 1);
	for (size_t i = 0; i < count && kind > 0; i++) {
		const real alone = i == chosen ? magnitude : 0;
		x[i] = kind == 1 ? x[i] * magnitude : kind == 2 ? any_magnitude() : alone;
	}
}

static void any_estimator(void) {
	estimator_settings(&e, 1 + random_below(&random, MOST_N), 1 + random_below(&random, MOST_M),
	                   all_regulators[random_below(&random, REGULATORS)],
	                   all_forms[random_below(&random, FORMS)]);
	e.config.check = (int)random_below(&random, 3);
	e.config.lambda = ANY_OF(1, 0.98, 0.5, 1e-3, (double)REAL_MIN, (double)REAL_MIN / 8);
	e.config.p0 = ANY_OF(1, 1e3, 1e-6, 1e6, 1e-30, 1e30, (double)REAL_MIN, (double)REAL_MAX / 9000);
	e.trace.tau0 = ANY_OF(0, 1, 1e-6, 1e6, 1e-30, 1e30, (double)REAL_MIN / 8, (double)REAL_MAX / 9);
	e.dead_zone.delta = ANY_OF(0, 0.1, 1e6);
	e.floor.eps_sift = ANY_OF(1e-20, 1e-10, 1, (double)REAL_MIN / 8);
	size_t reals; /* exponential resetting refuses a lambda that does not go with p0 */
	if (e.config.regulator->check && KOOP(rls_reals)(&e.config, &reals) != KOOP_OK) { e.config.lambda = 1; }
	estimator_start(&e);
}

/* All that is stored of Theta and P: P itself need not fit where its root does. */
static int all_finite(void) {
	const size_t theta = e.rls.n_regressors * e.rls.n_lifted_padded,
	             covariance = e.config.form->reals(&e.rls);
	for (size_t i = 0; i < theta; i++) {
		if (!isfinite(e.rls.theta[i])) { return 0; }
	}
	for (size_t i = 0; i < covariance && e.config.form == &KOOP(form_sqrt); i++) {
		if (!isfinite(e.rls.covariance[i])) { return 0; }
	}
	return 1;
}

/* Overflow is refused by these bounds: of the elements of M, where P is a scale times M, and of those of the root. */
static void check_bound(int is_root) {
	const double scale = is_root ? 1 : (double)e.rls.covariance_scale, round_off = 1000 * (double)REAL_EPSILON;
	const double most = (double)e.rls.covariance_bound * scale * (1 + round_off) + (double)REAL_MIN;
	for (size_t i = 0; i < e.rls.n_regressors; i++) {
		for (size_t j = 0; j <= i; j++) {
			const double size = fabs((double)e.config.form->get(&e.rls, 0, i, j));
			CHECK(size <= most, "%s: %g, bound %g", estimator_name(&e), size, most);
		}
	}
}

static void check_state(int status, const KOOP(health) *health) {
	const int is_root = e.config.form == &KOOP(form_sqrt);
	real P[MOST_D * MOST_D];
	const int fits = KOOP(rls_get_covariance)(&e.rls, P) == KOOP_OK;
	CHECK(all_finite() && (fits || is_root), "%s: status %d", estimator_name(&e), status);
	check_bound(is_root);
	CHECK(!isnan(health->trace), "%s: status %d, trace %g", estimator_name(&e), status,
	      (double)health->trace);
	for (size_t i = 0; i < e.rls.n_regressors && (is_root || e.config.check != KOOP_CHECK_REPORT); i++) {
		const real diagonal = is_root ? e.config.form->get(&e.rls, 0, i, i) : P[i * e.rls.n_regressors + i];
		CHECK(diagonal > 0, "%s: status %d, P[%d][%d] %g", estimator_name(&e), status, (int)i, (int)i,
		      (double)diagonal);
	}
}

static void test_both_ends_of_the_range(void) {
	long taken = 0, refused = 0;
	random = random_seed(2026);
	for (int k = 0; k < ESTIMATORS; k++) {
		any_estimator();
		for (int s = 0; s < SAMPLES; s++) {
			const size_t again = 1 + random_below(&random, 4) / 3 * random_below(&random, 16);
			real zeta[MOST_D], psi_next[MOST_N];
			any_vector(zeta, e.rls.n_regressors);
			any_vector(psi_next, e.rls.n_lifted);
			for (size_t i = 0; i < again; i++) {
				KOOP(health) health;
				const int status = estimator_update(&e, zeta, psi_next, &health);
				*(status == KOOP_OK ? &taken : &refused) += 1;
				check_state(status, &health);
			}
		}
	}
	CHECK(taken > ESTIMATORS && refused > ESTIMATORS, "%ld taken, %ld refused", taken, refused);
	printf("%ld samples taken, %ld refused\n", taken, refused);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_both_ends_of_the_range);
	return UNITY_END();
}
