/* The controller's prediction far from the origin: what the state changes by in one step is known as well as
 * the state would be near it, in float32 too. */
#include "support.h"

enum { N = 5, PADDED = KOOP_PAD(N) };

static real storage[KOOP_MPC_REALS_NEWTON(N, 1, 1, 1)];
static KOOP(mpc) mpc;

/* One state of N is tracked, one step ahead, and the input costs nearly nothing: it cancels the change. */
static real planned_input(const real *theta, const real *psi) {
	static const real Q = 1, R = (real)1e-12, low = -1000, high = 1000, safe = 0;
	const KOOP(mpc_config) config = {
	    .n_lifted = N,
	    .n_states = 1,
	    .n_inputs = 1,
	    .horizon = 1,
	    .Q = &Q,
	    .R = &R,
	    .u_min = &low,
	    .u_max = &high,
	    .u_safe = &safe,
	    .tolerance = REAL_MIN,
	};
	real u;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, psi, NULL, &u, NULL));
	return u;
}

/* The first row of A, chosen so that psi's first element hardly changes. */
static wide random_row(random_source *random, real *theta, const real *psi) {
	wide change = -(wide)psi[0];
	for (size_t j = 0; j < N; j++) {
		const double last = (double)(-change / (wide)psi[j]) * (1 + 1e-6 * random_uniform(random, 1, 2));
		theta[j * PADDED] = j + 1 < N ? random_uniform(random, -1, 1) : (real)last;
		change += (wide)theta[j * PADDED] * (wide)psi[j];
	}
	return change;
}

static void test_small_change_of_a_large_state(void) {
	random_source random = random_seed(11);
	const double per_change = 4 * (double)REAL_EPSILON, rest = TEST_DOUBLE ? 1e-11 : 1e-9;
	for (int round = 0; round < 500; round++) {
		real theta[(N + 1) * PADDED] = {0}, psi[N];
		for (size_t j = 0; j < N; j++) {
			psi[j] = random_uniform(&random, 500, 1000) * (random_below(&random, 2) ? 1 : -1);
		}
		theta[N * PADDED] = 1;
		const wide change = random_row(&random, theta, psi);
		const double off = (double)fabs((wide)planned_input(theta, psi) + change);
		CHECK(off <= per_change * (double)fabs(change) + rest, "round %d: change %g is off by %g", round,
		      (double)change, off);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_small_change_of_a_large_state);
	return UNITY_END();
}
