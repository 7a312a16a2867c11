/* What the controller takes and what it refuses: every element of every argument, every size at its bound,
 * and what a refusal and a reset leave. */
#include "support.h"

enum { N = 3, M = 2, H = 4, V = H * M, PADDED = KOOP_PAD(N), MANY_M = 85 };

static real storage[KOOP_MPC_REALS_NEWTON(N, N, M, H) + KOOP_MPC_REALS_RATE(M, H)];
static KOOP(mpc) mpc;

/* All arguments of one problem; behind each array there is an element more, which is not read. */
typedef struct {
	real theta[(N + M) * PADDED];
	real psi[N + 1], reference[H * 2 + 1], before[M + 1];
	real Q[2 * 2 + 1], R[M * M + 1], S[M * M + 1], low[M + 1], high[M + 1], safe[M + 1];
	KOOP(mpc_config) config;
} arguments;

static void set_config(arguments *a, int method, int rate) {
	a->config = (KOOP(mpc_config)){
	    .n_lifted = N,
	    .n_states = 2,
	    .n_inputs = M,
	    .horizon = H,
	    .Q = a->Q,
	    .R = a->R,
	    .S = rate ? a->S : NULL,
	    .u_min = a->low,
	    .u_max = a->high,
	    .u_safe = a->safe,
	    .method = method,
	};
}

static void fill(random_source *random, arguments *a, int method, int rate) {
	memset(a, 0, sizeof *a);
	for (size_t row = 0; row < N + M; row++) { random_fill(random, a->theta + row * PADDED, N, -1, 1); }
	random_fill(random, a->psi, N, -1, 1);
	random_fill(random, a->reference, H * 2, -1, 1);
	random_fill(random, a->before, M, -1, 1);
	for (size_t j = 0; j < 2; j++) {
		a->Q[3 * j] = a->R[3 * j] = a->S[3 * j] = 1;
		a->low[j] = -(real)0.5;
		a->high[j] = (real)0.5;
		a->safe[j] = (real)0.125;
	}
	real *const ends[] = {a->psi + N,   a->reference + H * 2, a->before + M, a->Q + 4,   a->R + M * M,
	                      a->S + M * M, a->low + M,           a->high + M,   a->safe + M};
	for (size_t i = 0; i < sizeof ends / sizeof *ends; i++) { *ends[i] = (real)NAN; }
	set_config(a, method, rate);
}

static int start(const arguments *a) {
	return KOOP(mpc_init)(&mpc, &a->config, storage, sizeof storage / sizeof *storage);
}

static int solve(const arguments *a, real *u, KOOP(mpc_result) *result) {
	return KOOP(mpc_solve)(&mpc, a->theta, a->psi, a->reference, a->before, u, result);
}

/* ---- Elements that are no number ---------------------------------------------------------------------- */

static void check_elements_of_init(const arguments *a, real *x, size_t count) {
	for (size_t i = 0; i < count; i++) {
		const real kept = x[i];
		x[i] = (real)NAN;
		CHECK_STATUS(KOOP_E_INPUT, start(a));
		x[i] = kept;
	}
	CHECK_STATUS(KOOP_OK, start(a));
}

static void test_every_element_of_the_configuration_must_be_a_number(void) {
	random_source random = random_seed(71);
	for (int method = 0; method < 2; method++) {
		arguments a;
		fill(&random, &a, method, 1);
		check_elements_of_init(&a, a.Q, 4);
		check_elements_of_init(&a, a.R, M * M);
		check_elements_of_init(&a, a.S, M * M);
		check_elements_of_init(&a, a.low, M);
		check_elements_of_init(&a, a.high, M);
		check_elements_of_init(&a, a.safe, M);
	}
}

/* Each element in turn NaN or infinite: the safe input, and a plan of nothing else. */
static void check_elements_of_solve(const arguments *a, real *x, size_t count) {
	for (size_t i = 0; i < 2 * count; i++) {
		real u[M] = {0}, plan[V];
		const real kept = x[i / 2];
		CHECK_STATUS(KOOP_OK, solve(a, u, NULL));
		x[i / 2] = i % 2 ? (real)NAN : -(real)INFINITY;
		CHECK_STATUS(KOOP_E_INPUT, solve(a, u, NULL));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
		TEST_ASSERT_EQUAL_MEMORY(a->safe, u, sizeof u);
		for (size_t q = 0; q < V; q += M) { TEST_ASSERT_EQUAL_MEMORY(a->safe, plan + q, sizeof u); }
		x[i / 2] = kept;
	}
}

static void test_every_element_of_a_solve_must_be_finite(void) {
	random_source random = random_seed(72);
	for (int method = 0; method < 2; method++) {
		arguments a;
		fill(&random, &a, method, 1);
		CHECK_STATUS(KOOP_OK, start(&a));
		check_elements_of_solve(&a, a.psi, N);
		check_elements_of_solve(&a, a.reference, H * 2);
		check_elements_of_solve(&a, a.before, M);
	}
}

/* Each element in turn: the plan is kept, and nothing of the limits is taken over. */
static void check_elements_of_limits(arguments *a, real *x, real bad, int status) {
	for (size_t j = 0; j < M; j++) {
		real u[M], before[V], after[V];
		const real kept = x[j], other = a->high[1 - j];
		CHECK_STATUS(KOOP_OK, solve(a, u, NULL));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, before));
		x[j] = bad;
		a->high[1 - j] = other + 1;
		CHECK_STATUS(status, solve(a, u, NULL));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, after));
		TEST_ASSERT_EQUAL_MEMORY(before, after, sizeof after);
		TEST_ASSERT_TRUE(mpc.u_max[1 - j] >= other && mpc.u_max[1 - j] <= other);
		for (size_t i = 0; i < M; i++) { TEST_ASSERT_TRUE(u[i] >= (real)0.125 && u[i] <= (real)0.125); }
		a->high[1 - j] = other;
		x[j] = kept;
	}
}

static void test_limits_are_taken_over_all_or_none(void) {
	random_source random = random_seed(73);
	const real infinite = (real)INFINITY, none = (real)NAN;
	for (int method = 0; method < 2; method++) {
		arguments a;
		fill(&random, &a, method, 0);
		CHECK_STATUS(KOOP_OK, start(&a));
		check_elements_of_limits(&a, a.low, none, KOOP_E_INPUT);
		check_elements_of_limits(&a, a.high, none, KOOP_E_INPUT);
		check_elements_of_limits(&a, a.safe, none, KOOP_E_INPUT);
		check_elements_of_limits(&a, a.safe, infinite, KOOP_E_INPUT);
		check_elements_of_limits(&a, a.low, 1, KOOP_E_RANGE);
		check_elements_of_limits(&a, a.low, infinite, KOOP_E_RANGE);
		check_elements_of_limits(&a, a.high, -1, KOOP_E_RANGE);
		check_elements_of_limits(&a, a.high, -infinite, KOOP_E_RANGE);
	}
}

/* The safe input is brought inside each of the limits as they are now. */
static void test_each_safe_input_follows_its_limits(void) {
	random_source random = random_seed(74);
	for (size_t j = 0; j < M; j++) {
		arguments a;
		fill(&random, &a, KOOP_MPC_NEWTON, 0);
		CHECK_STATUS(KOOP_OK, start(&a));
		a.psi[0] = (real)NAN;
		for (int upper = 0; upper < 2; upper++) {
			real u[M];
			(upper ? a.high : a.low)[j] = upper ? -(real)0.25 : (real)0.25;
			const real expected = upper ? -(real)0.25 : (real)0.25;
			CHECK_STATUS(KOOP_E_INPUT, solve(&a, u, NULL));
			TEST_ASSERT_TRUE(u[j] >= expected && u[j] <= expected);
			TEST_ASSERT_TRUE(u[1 - j] >= (real)0.125 && u[1 - j] <= (real)0.125);
			a.low[j] = -(real)0.5;
		}
	}
}

/* ---- Settings at their bounds ------------------------------------------------------------------------- */

/* One past the last number is infinite, which is no number that an input could be given. */
static void test_limits_may_be_as_large_as_numbers_are(void) {
	const real most[] = {REAL_MAX, -REAL_MAX};
	random_source random = random_seed(75);
	for (size_t i = 0; i < 2 * M; i++) {
		arguments a;
		fill(&random, &a, KOOP_MPC_NEWTON, 0);
		a.low[i / 2] = a.high[i / 2] = a.safe[i / 2] = most[i % 2];
		CHECK_STATUS(KOOP_OK, start(&a));
		a.low[i / 2] = a.high[i / 2] = most[i % 2] * 2;
		CHECK_STATUS(KOOP_E_RANGE, start(&a));
	}
}

/* Each input in turn at a limit, and one ulp outside. */
static void test_safe_input_must_be_inside_its_limits(void) {
	random_source random = random_seed(76);
	for (size_t j = 0; j < M; j++) {
		arguments a;
		fill(&random, &a, KOOP_MPC_NEWTON, 0);
		a.safe[j] = a.low[j];
		CHECK_STATUS(KOOP_OK, start(&a));
		a.safe[j] = a.low[j] * (1 + REAL_EPSILON);
		CHECK_STATUS(KOOP_E_RANGE, start(&a));
		a.safe[j] = a.high[j];
		CHECK_STATUS(KOOP_OK, start(&a));
		a.safe[j] = a.high[j] * (1 + REAL_EPSILON);
		CHECK_STATUS(KOOP_E_RANGE, start(&a));
	}
}

static void test_each_input_must_cost_something(void) {
	static const real none[] = {0, -1};
	random_source random = random_seed(77);
	for (size_t i = 0; i < 2 * M; i++) {
		arguments a;
		fill(&random, &a, KOOP_MPC_GRADIENT, 0);
		a.R[i / 2 * (M + 1)] = none[i % 2];
		CHECK_STATUS(KOOP_E_RANGE, start(&a));
		a.R[i / 2 * (M + 1)] = REAL_MIN;
		CHECK_STATUS(KOOP_OK, start(&a));
	}
}

static void test_methods_and_tolerances(void) {
	random_source random = random_seed(78);
	arguments a;
	fill(&random, &a, KOOP_MPC_NEWTON, 0);
	for (int method = -1; method <= 2; method++) {
		a.config.method = method;
		CHECK_STATUS(method < 0 || method > 1 ? KOOP_E_RANGE : KOOP_OK, start(&a));
	}
	a.config.method = KOOP_MPC_NEWTON;
	const real wanted[] = {REAL_MAX, REAL_MIN, 1};
	for (size_t i = 0; i < 3; i++) {
		a.config.tolerance = wanted[i];
		CHECK_STATUS(KOOP_OK, start(&a));
		TEST_ASSERT_TRUE(mpc.config.tolerance >= wanted[i] && mpc.config.tolerance <= wanted[i]);
	}
	a.config.tolerance = 0;
	CHECK_STATUS(KOOP_OK, start(&a));
	const double usual = TEST_DOUBLE ? 1e-9 : 1e-5;
	CHECK(fabs((double)mpc.config.tolerance - usual) < 1e-6 * usual, "%g", (double)mpc.config.tolerance);
}

/* ---- Sizes -------------------------------------------------------------------------------------------- */

/* Sizes that are none are told before storage that does not suffice. */
static void test_every_size_has_its_bounds(void) {
	static real many_Q[4], many_R[MANY_M * MANY_M], low[KOOP_MAX_DIM], high[KOOP_MAX_DIM], safe[KOOP_MAX_DIM];
	static const struct {
		size_t N, n, m, H;
		int status;
	} sizes[] = {
	    {254, 1, 1, 1, KOOP_E_STORAGE},  {255, 1, 1, 1, KOOP_E_SIZE},   {255, 1, 0, 1, KOOP_E_SIZE},
	    {170, 1, 85, 1, KOOP_E_STORAGE}, {171, 1, 85, 1, KOOP_E_SIZE},  {256, 1, 1, 1, KOOP_E_SIZE},
	    {2, 2, 1, 1, KOOP_E_STORAGE},    {2, 3, 1, 1, KOOP_E_SIZE},     {2, 0, 1, 1, KOOP_E_SIZE},
	    {1, 1, 1, 1, KOOP_E_STORAGE},    {0, 0, 1, 1, KOOP_E_SIZE},     {1, 1, 1, 0, KOOP_E_SIZE},
	    {1, 1, 1, 1000, KOOP_E_STORAGE}, {1, 1, 1, 1001, KOOP_E_SIZE},  {1, 1, 2, 1000, KOOP_E_STORAGE},
	    {1, 1, 85, 771, KOOP_E_STORAGE}, {1, 1, 128, 512, KOOP_E_SIZE}, {1, 1, 85, 772, KOOP_E_SIZE},
	};
	for (size_t j = 0; j < MANY_M; j++) { many_R[j * (MANY_M + 1)] = 1; }
	for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
		const size_t m = sizes[i].m, two = m == 2 ? 1 : 0;
		many_R[3] = two ? 1 : 0; /* the unit matrix of that size */
		const KOOP(mpc_config) config = {sizes[i].N, sizes[i].n, m,    sizes[i].H, many_Q, many_R,
		                                 NULL,       low,        high, safe,       0,      (int)(i % 2)};
		CHECK(KOOP(mpc_init)(&mpc, &config, storage, 0) == sizes[i].status, "sizes %zu", i);
	}
}

/* What is refused before it is begun leaves the controller and its storage bit for bit. */
static void test_refused_configuration_leaves_everything(void) {
	static KOOP(mpc) kept;
	static real kept_storage[sizeof storage / sizeof *storage];
	random_source random = random_seed(79);
	arguments a;
	real u[M];
	fill(&random, &a, KOOP_MPC_NEWTON, 1);
	CHECK_STATUS(KOOP_OK, start(&a));
	CHECK_STATUS(KOOP_OK, solve(&a, u, NULL));
	memcpy(&kept, &mpc, sizeof mpc);
	memcpy(kept_storage, storage, sizeof storage);
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(mpc_init)(&mpc, &a.config, storage, 20));
	a.safe[0] = 1;
	CHECK_STATUS(KOOP_E_RANGE, start(&a));
	a.config.horizon = 0;
	CHECK_STATUS(KOOP_E_SIZE, start(&a));
	TEST_ASSERT_EQUAL_MEMORY(&kept, &mpc, sizeof mpc);
	TEST_ASSERT_EQUAL_MEMORY(kept_storage, storage, sizeof storage);
}

/* ---- A plan forgotten --------------------------------------------------------------------------------- */

static void check_same_as_fresh(const arguments *a) {
	static real fresh_storage[sizeof storage / sizeof *storage];
	static KOOP(mpc) fresh;
	KOOP(mpc_result) result, expected;
	real u[M], plan[V], v[M], fresh_plan[V];
	const size_t reals = sizeof storage / sizeof *storage;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&fresh, &a->config, fresh_storage, reals));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&fresh, a->theta, a->psi, a->reference, a->before, v, &expected));
	CHECK_STATUS(KOOP_OK, solve(a, u, &result));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&fresh, fresh_plan));
	TEST_ASSERT_EQUAL_MEMORY(fresh_plan, plan, sizeof plan);
	TEST_ASSERT_EQUAL_MEMORY(v, u, sizeof u);
	CHECK(result.iterations == expected.iterations, "%zu steps, not %zu", result.iterations,
	      expected.iterations);
	TEST_ASSERT_EQUAL_MEMORY(&expected.residual, &result.residual, sizeof result.residual);
}

static void check_nothing_is_known(const arguments *a) {
	real plan[V];
	TEST_ASSERT_TRUE(mpc.factored == 0 && mpc.planned == 0 && mpc.n_free == 0);
	TEST_ASSERT_TRUE(mpc.max_eigenvalue >= 1 && mpc.max_eigenvalue <= 1);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	for (size_t q = 0; q < V; q++) {
		TEST_ASSERT_TRUE(mpc.set[q] == 0);
		TEST_ASSERT_TRUE(plan[q] >= a->safe[q % M] && plan[q] <= a->safe[q % M]);
	}
}

/* After a reset, and after a solve without a plan, the next is as if it were the first. */
static void test_forgotten_plan_leaves_no_trace(void) {
	random_source random = random_seed(80);
	for (int round = 0; round < 60; round++) {
		arguments a;
		real u[M];
		fill(&random, &a, round % 2, round / 2 % 2);
		a.safe[1] = -(real)0.25;
		CHECK_STATUS(KOOP_OK, start(&a));
		check_nothing_is_known(&a);
		for (int k = 0; k < 3; k++) {
			random_fill(&random, a.psi, N, -2, 2);
			CHECK_STATUS(KOOP_OK, solve(&a, u, NULL));
		}
		if (round / 4 % 2) {
			CHECK_STATUS(KOOP_OK, KOOP(mpc_reset)(&mpc));
		} else {
			a.psi[0] = (real)NAN;
			CHECK_STATUS(KOOP_E_INPUT, solve(&a, u, NULL));
			a.psi[0] = 1;
		}
		check_nothing_is_known(&a);
		check_same_as_fresh(&a);
	}
}

/* Without S the input before is not read. */
static void test_input_before_is_read_only_with_a_rate(void) {
	random_source random = random_seed(81);
	arguments a;
	real u[M];
	fill(&random, &a, KOOP_MPC_NEWTON, 0);
	for (size_t j = 0; j < M; j++) { a.before[j] = (real)NAN; }
	CHECK_STATUS(KOOP_OK, start(&a));
	CHECK_STATUS(KOOP_OK, solve(&a, u, NULL));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, a.theta, a.psi, a.reference, NULL, u, NULL));
}

/* A plan that is the best already takes no step. */
static void test_nothing_to_do_takes_no_step(void) {
	random_source random = random_seed(82);
	for (int method = 0; method < 2; method++) {
		arguments a;
		real u[M];
		KOOP(mpc_result) result = {7, 7};
		fill(&random, &a, method, 0);
		memset(a.psi, 0, sizeof a.psi);
		memset(a.reference, 0, sizeof a.reference);
		memset(a.safe, 0, sizeof a.safe);
		CHECK_STATUS(KOOP_OK, start(&a));
		CHECK_STATUS(KOOP_OK, solve(&a, u, &result));
		TEST_ASSERT_TRUE(result.iterations == 0 && result.residual >= 0 && result.residual <= 0);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_every_element_of_the_configuration_must_be_a_number);
	RUN_TEST(test_every_element_of_a_solve_must_be_finite);
	RUN_TEST(test_limits_are_taken_over_all_or_none);
	RUN_TEST(test_each_safe_input_follows_its_limits);
	RUN_TEST(test_limits_may_be_as_large_as_numbers_are);
	RUN_TEST(test_safe_input_must_be_inside_its_limits);
	RUN_TEST(test_each_input_must_cost_something);
	RUN_TEST(test_methods_and_tolerances);
	RUN_TEST(test_every_size_has_its_bounds);
	RUN_TEST(test_refused_configuration_leaves_everything);
	RUN_TEST(test_forgotten_plan_leaves_no_trace);
	RUN_TEST(test_input_before_is_read_only_with_a_rate);
	RUN_TEST(test_nothing_to_do_takes_no_step);
	return UNITY_END();
}
