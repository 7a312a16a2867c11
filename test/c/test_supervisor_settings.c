/* What the supervisor takes where a setting is 0, and which responses it judges. */
#include "tinykoop_supervisor.h"

#include "support.h"

enum { N = 2, M = 2, H = 4, PADDED = KOOP_PAD(N) };

static real mpc_storage[KOOP_MPC_REALS_NEWTON(N, N, M, H)], storage[KOOP_SUPERVISOR_REALS(N, N, M, H)];
static KOOP(mpc) mpc;
static KOOP(supervisor) supervisor;

/* Over a robot at rest, x = x + B u; `gain` by columns of B. */
static int start(const KOOP(supervisor_config) *config, const real *gain, const real *low, const real *high) {
	static const real Q[N * N] = {1, 0, 0, 1}, R[M * M] = {1, 0, 0, 1};
	real theta[(N + M) * PADDED] = {0};
	for (size_t i = 0; i < N; i++) {
		theta[i * PADDED + i] = 1;
		for (size_t j = 0; j < M; j++) { theta[(N + j) * PADDED + i] = gain[j * N + i]; }
	}
	const KOOP(mpc_config) mpc_config = {
	    .n_lifted = N,
	    .n_states = N,
	    .n_inputs = M,
	    .horizon = H,
	    .Q = Q,
	    .R = R,
	    .u_min = low,
	    .u_max = high,
	    .u_safe = low,
	};
	CHECK_STATUS(KOOP_OK,
	             KOOP(mpc_init)(&mpc, &mpc_config, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage));
	return KOOP(supervisor_init)(&supervisor, config, &mpc, theta, storage, sizeof storage / sizeof *storage);
}

static const real own_state_each[N * M] = {1, 0, 0, 1}, low[M] = {-1, -1}, high[M] = {1, 1};

static void test_defaults_are_those_of_the_header(void) {
	CHECK_STATUS(KOOP_OK, start(NULL, own_state_each, low, high));
	const KOOP(supervisor_config) *c = &supervisor.config;
	TEST_ASSERT_TRUE(c->min_cosine == (real)0.7 && c->min_gain == (real)0.2 && c->max_gain == 3);
	TEST_ASSERT_TRUE(c->max_error_ratio == 4 && c->max_residual == (real)0.01 && c->max_tracking_ratio == 3);
	TEST_ASSERT_TRUE(c->patience == 15 && c->renewal == 100);
}

static void test_settings_are_taken(void) {
	const KOOP(supervisor_config) mine = {1, 2, 3, 4, 5, 6, 7, 8, NULL};
	CHECK_STATUS(KOOP_OK, start(&mine, own_state_each, low, high));
	TEST_ASSERT_EQUAL_MEMORY(&mine, &supervisor.config, sizeof mine);
}

/* Both inputs act on the first state. It is left out of what the second input is judged by where that input
 * has little range and acts on its own state above all; where it starts from does not matter. */
static void test_range_of_an_input_decides_what_is_judged(void) {
	const real gain[N * M] = {1, 0, (real)0.2, 1};
	const real wide_low[M] = {10, 20}, wide_high[M] = {11, 21}, far_high[M] = {11, 80};
	CHECK_STATUS(KOOP_OK, start(NULL, gain, wide_low, wide_high));
	TEST_ASSERT_TRUE(supervisor.judged[0] > 0 && supervisor.judged[2 * 0 + 1] == 0 &&
	                 supervisor.judged[3] > 0);
	CHECK_STATUS(KOOP_OK, start(NULL, gain, wide_low, far_high));
	TEST_ASSERT_TRUE(supervisor.judged[0] > 0 && supervisor.judged[1] > 0 && supervisor.judged[3] > 0);
}

static int first_state_is_judged_for_first_input(real own, real on_second, real by_second) {
	const real gain[N * M] = {own, on_second, by_second, 0};
	const real little_less = own - 64 * REAL_EPSILON;
	const real less[N * M] = {little_less, on_second, by_second, 0};
	CHECK_STATUS(KOOP_OK, start(NULL, less, low, high));
	TEST_ASSERT_TRUE(supervisor.judged[0] >= 0 && supervisor.judged[0] <= 0);
	CHECK_STATUS(KOOP_OK, start(NULL, gain, low, high));
	return supervisor.judged[0] > 0;
}

/* Exactly a tenth of what the input does, 1 of 1 + 3^2, or nine tenths of what is done to the state, 3^2 of
 * 3^2 + 1, is enough; a little less of either is not. */
static void test_a_tenth_or_nine_tenths_of_a_response_are_judged(void) {
	TEST_ASSERT_TRUE(first_state_is_judged_for_first_input(1, 3, 100));
	TEST_ASSERT_TRUE(first_state_is_judged_for_first_input(3, 100, 1));
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_defaults_are_those_of_the_header);
	RUN_TEST(test_settings_are_taken);
	RUN_TEST(test_range_of_an_input_decides_what_is_judged);
	RUN_TEST(test_a_tenth_or_nine_tenths_of_a_response_are_judged);
	return UNITY_END();
}
