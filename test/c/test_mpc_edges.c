/* The controller at the edges: inputs that stand on a bound from the start, models that differ from one solve
 * to the next. */
#include "support.h"

enum { N = 2, M = 2, H = 12, PADDED = KOOP_PAD(N) };

static real storage[KOOP_MPC_REALS_NEWTON(N, M, M, H)], fresh_storage[KOOP_MPC_REALS_NEWTON(N, M, M, H)];
static KOOP(mpc) mpc, fresh;

static const real Q[N * N] = {1, 0, 0, 1}, R[M * M] = {(real)0.1, 0, 0, (real)0.1};
static const real low[M] = {-1, -2}, high[M] = {1, 2}, middle[M] = {0, 0};

static KOOP(mpc_config) settings(void) {
	return (KOOP(mpc_config)){
	    .n_lifted = N,
	    .n_states = N,
	    .n_inputs = M,
	    .horizon = H,
	    .Q = Q,
	    .R = R,
	    .u_min = low,
	    .u_max = high,
	    .u_safe = middle,
	};
}

static void start(KOOP(mpc) *controller, real *where, const KOOP(mpc_config) *config) {
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(controller, config, where, sizeof storage / sizeof *storage));
}

/* A safe input may be on a bound, and a box may have no width. */
static void test_safe_input_on_a_bound(void) {
	const real *const boxes[][3] = {{low, high, low}, {low, high, high}, {low, low, low}};
	const real theta[(N + M) * PADDED] = {1, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1}, psi[N] = {0, 0},
	                           reference[H * N] = {0};
	for (size_t i = 0; i < sizeof boxes / sizeof *boxes; i++) {
		real u[M];
		KOOP(mpc_config) config = settings();
		config.u_min = boxes[i][0];
		config.u_max = boxes[i][1];
		config.u_safe = boxes[i][2];
		start(&mpc, storage, &config);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL));
		for (size_t j = 0; j < M; j++) {
			CHECK(u[j] >= config.u_min[j] && u[j] <= config.u_max[j], "%zu", j);
		}
	}
}

/* A model that has nothing to do with the one before is planned on as if it were the first. */
static void test_model_that_changes_at_every_solve(void) {
	random_source random = random_seed(21);
	KOOP(mpc_config) config = settings();
	config.tolerance = 8 * REAL_EPSILON; /* so that both are at the optimum, but for round-off */
	start(&mpc, storage, &config);
	for (int k = 0; k < 200; k++) {
		real theta[(N + M) * PADDED] = {0}, psi[N], reference[H * N], u[M], expected[M];
		for (size_t row = 0; row < N + M; row++) { random_fill(&random, theta + row * PADDED, N, -1, 1); }
		random_fill(&random, psi, N, -1, 1);
		random_fill(&random, reference, H * N, -1, 1);
		start(&fresh, fresh_storage, &config);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&fresh, theta, psi, reference, NULL, expected, NULL));
		for (size_t j = 0; j < M; j++) {
			CHECK(fabs((double)(u[j] - expected[j])) < (TEST_DOUBLE ? 1e-8 : 1e-3),
			      "solve %d: u[%zu] %g, not %g", k, j, (double)u[j], (double)expected[j]);
		}
	}
}

/* What the controller's memory holds before does not matter. */
static void test_controller_in_memory_that_is_not_empty(void) {
	random_source random = random_seed(22);
	for (int round = 0; round < 40; round++) {
		real theta[(N + M) * PADDED] = {0}, psi[N], reference[H * N], u[M], expected[M];
		KOOP(mpc_config) config = settings();
		config.method = round % 2;
		for (size_t row = 0; row < N + M; row++) { random_fill(&random, theta + row * PADDED, N, -1, 1); }
		random_fill(&random, psi, N, -1, 1);
		random_fill(&random, reference, H * N, -1, 1);
		memset(&mpc, 0xff, sizeof mpc);
		memset(storage, 0xff, sizeof storage);
		memset(&fresh, 0, sizeof fresh);
		memset(fresh_storage, 0, sizeof fresh_storage);
		start(&mpc, storage, &config);
		start(&fresh, fresh_storage, &config);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&fresh, theta, psi, reference, NULL, expected, NULL));
		TEST_ASSERT_EQUAL_MEMORY(expected, u, sizeof u);
	}
}

/* A state without a weight may leave the range of numbers: the plan is that of the other state. */
static void test_state_without_a_weight_may_overflow(void) {
	const real one[N * N] = {1, 0, 0, 0};
	const real theta[(N + M) * PADDED] = {[0] = 1, [2 * PADDED] = 1, [2 * PADDED + 1] = REAL_MAX / 4};
	const real most[M] = {100, 100}, least[M] = {-100, -100};
	real psi[N] = {0, 0}, reference[H * N] = {0}, u[M];
	for (size_t k = 0; k < H; k++) { reference[k * N] = 50; }
	for (int method = 0; method < 2; method++) {
		KOOP(mpc_config) config = settings();
		config.method = method;
		config.Q = one;
		config.u_min = least;
		config.u_max = most;
		start(&mpc, storage, &config);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL));
		CHECK(u[0] > 30, "method %d: u %g", method, (double)u[0]);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_safe_input_on_a_bound);
	RUN_TEST(test_model_that_changes_at_every_solve);
	RUN_TEST(test_controller_in_memory_that_is_not_empty);
	RUN_TEST(test_state_without_a_weight_may_overflow);
	return UNITY_END();
}
