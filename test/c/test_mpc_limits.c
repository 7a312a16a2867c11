/* Limits that are others at every solve, as those of a rate limiter, a battery or a fixed input are: every
 * input of every plan is inside those of its own solve, and the plan is optimal in them. The random problems
 * change from solve to solve as a robot's do; plans are carried over. A first argument is the number of solves. */
#include "problem.h"

#include <stdlib.h>

enum { WARM_SOLVES = 25 }; /* of one problem before the next */

static KOOP(mpc) mpc;
static real
    storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_m, MOST_H) + KOOP_MPC_REALS_RATE(MOST_m, MOST_H)];
static size_t solves = 4000;

/* Which limits were seen to hold an input of a plan. */
enum { RATE, FIXED, OPEN_ABOVE, OPEN_BELOW, OPEN, REDRAWN, KINDS };
typedef struct {
	size_t drawn[KINDS], at_limit[KINDS];
	size_t unfinished; /* the bound on iterations came first, as result.residual tells */
	double worst;
} tally;

/* New limits of input j, of a random kind; `u` is what was applied last. */
static size_t redraw(random_source *random, problem *p, size_t j, real u, double box) {
	const size_t kind = random_below(random, KINDS);
	const real low = random_uniform(random, -box, box), width = random_uniform(random, 0, box);
	p->low[j] = kind == RATE ? u - (real)(0.1 * box) : low;
	p->high[j] = kind == RATE ? u + (real)(0.1 * box) : low + width;
	if (kind == FIXED) { p->high[j] = p->low[j]; }
	if (kind == OPEN_ABOVE || kind == OPEN) { p->high[j] = (real)INFINITY; }
	if (kind == OPEN_BELOW || kind == OPEN) { p->low[j] = -(real)INFINITY; }
	return kind;
}

static KOOP(mpc_config) settings(const problem *p, int method) {
	return problem_settings(p, TEST_DOUBLE && method == KOOP_MPC_GRADIENT ? (real)1e-7 : 0, method);
}

/* The largest step that a gradient step scaled by the diagonal makes inside the limits, over the size of u. */
static double residual_of(const problem *p, const real *plan) {
	static wide gradient[MOST_V], diagonal[MOST_V];
	wide residual = 0, size = 1;
	costate_gradient(p, plan, gradient);
	hessian_diagonal(p, diagonal);
	for (size_t q = 0; q < p->H * p->m; q++) {
		const wide low = p->low[q % p->m], high = p->high[q % p->m];
		wide step = plan[q] - gradient[q] / diagonal[q];
		step = step < low ? low : step > high ? high : step;
		residual = fmax(residual, fabs(step - plan[q]));
		size = fmax(size, fabs(plan[q]));
	}
	return (double)(residual / size);
}

/* Solves, and holds every input against the limits. */
static void check_solve(const problem *p, const size_t *kinds, real *u, double allowed, tally *seen) {
	real plan[MOST_V];
	KOOP(mpc_result) result;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, &result));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	TEST_ASSERT_TRUE(memcmp(u, plan, p->m * sizeof *u) == 0);
	for (size_t q = 0; q < p->H * p->m; q++) {
		const size_t j = q % p->m;
		CHECK(plan[q] >= p->low[j] && plan[q] <= p->high[j], "input %zu of the plan: %g is not in [%g, %g]", q,
		      (double)plan[q], (double)p->low[j], (double)p->high[j]);
		seen->at_limit[kinds[j]] += !(plan[q] > p->low[j] && plan[q] < p->high[j]);
	}
	if (result.iterations == (mpc.config.method == KOOP_MPC_NEWTON ? KOOP_MPC_MAX_NEWTON : KOOP_MPC_MAX_GRADIENT)) {
		seen->unfinished++;
		return;
	}
	const double residual = residual_of(p, plan);
	CHECK(residual <= allowed, "N %zu n %zu m %zu H %zu: residual %g after %zu steps, told %g", p->N, p->n, p->m,
	      p->H, residual, result.iterations, (double)result.residual);
	seen->worst = fmax(seen->worst, residual);
}

/* One problem, its limits redrawn at every solve; state and model change a little. */
static void check_problem(random_source *random, problem *p, int method, double allowed, tally *seen) {
	const KOOP(mpc_config) config = settings(p, method);
	real u[MOST_m] = {0};
	const double box = decades(random, -2, 1);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	for (size_t solve = 0; solve < WARM_SOLVES; solve++) {
		size_t kinds[MOST_m];
		for (size_t j = 0; j < p->m; j++) {
			kinds[j] = redraw(random, p, j, u[j], box);
			seen->drawn[kinds[j]]++;
			p->before[j] = u[j];
		}
		for (size_t i = 0; i < p->N; i++) { p->psi[i] *= random_uniform(random, 0.9, 1.1); }
		for (size_t i = 0; i < (p->N + p->m) * KOOP_PAD(p->N); i++) {
			p->theta[i] *= random_uniform(random, 0.999, 1.001);
		}
		check_solve(p, kinds, u, allowed, seen);
	}
}

static void campaign(uint64_t seed, int method, double allowed, double condition) {
	random_source random = random_seed(seed);
	tally seen = {{0}, {0}, 0, 0};
	for (size_t done = 0; done < solves / TEST_SHARE; done += WARM_SOLVES) {
		problem p;
		wide diagonal[MOST_V];
		do {
			random_problem(&random, &p);
			hessian_diagonal(&p, diagonal);
		} while (condition_bound(&p, diagonal) > (wide)condition);
		check_problem(&random, &p, method, allowed, &seen);
	}
	printf("%zu solves, none outside its limits, largest residual %.2g, %zu unfinished\n", solves / TEST_SHARE,
	       seen.worst, seen.unfinished);
	TEST_ASSERT_TRUE(seen.unfinished <= solves / 1000);
	for (size_t kind = 0; kind < KINDS; kind++) {
		TEST_ASSERT_TRUE(seen.drawn[kind] > 0);
		TEST_ASSERT_TRUE((seen.at_limit[kind] > 0) == (kind != OPEN));
	}
}

static void test_limits_that_move_between_solves_hold_with_newton(void) {
	campaign(21, KOOP_MPC_NEWTON, TEST_DOUBLE ? 1e-8 : 1e-3, TEST_DOUBLE ? 1e8 : 1e4);
}

static void test_limits_that_move_between_solves_hold_with_the_gradient(void) {
	campaign(22, KOOP_MPC_GRADIENT, TEST_DOUBLE ? 1e-6 : 5e-3, TEST_DOUBLE ? 1e5 : 1e4);
}

/* ---- one problem by hand: x+ = x + u, to be brought to 10 ------------------------- */

static const real one[1] = {1}, theta[2 * 4] = {1, 0, 0, 0, 1, 0, 0, 0}, here[1] = {0};
static const real reference[8] = {10, 10, 10, 10, 10, 10, 10, 10};
static real low[1], high[1], safe[1];

static void start(int method) {
	const KOOP(mpc_config) config = {1, 1, 1, 8, one, one, NULL, low, high, safe, 0, method};
	low[0] = -1;
	high[0] = 1;
	safe[0] = 0;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
}

static int solve(real *u) {
	return KOOP(mpc_solve)(&mpc, theta, here, reference, NULL, u, NULL);
}

static void test_crossed_limits_are_refused_and_the_last_plan_is_kept(void) {
	static const real bad[][2] = {
	    {2, 1}, {(real)NAN, 1}, {0, (real)NAN}, {(real)INFINITY, (real)INFINITY}, {-(real)INFINITY, -(real)INFINITY}};
	static const int status[] = {KOOP_E_RANGE, KOOP_E_INPUT, KOOP_E_INPUT, KOOP_E_RANGE, KOOP_E_RANGE};
	for (int method = KOOP_MPC_NEWTON; method <= KOOP_MPC_GRADIENT; method++) {
		real u[1], before[8], after[8];
		start(method);
		CHECK_STATUS(KOOP_OK, solve(u));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, before));
		for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
			low[0] = bad[i][0];
			high[0] = bad[i][1];
			CHECK_STATUS(status[i], solve(u));
			TEST_ASSERT_TRUE(u[0] >= 0 && u[0] <= 0); /* the safe input */
			CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, after));
			TEST_ASSERT_TRUE(memcmp(before, after, sizeof before) == 0);
		}
		low[0] = -2;
		high[0] = 2;
		CHECK_STATUS(KOOP_OK, solve(u));
		TEST_ASSERT_TRUE(u[0] >= 2 && u[0] <= 2);
	}
}

static void test_safe_input_is_brought_inside_the_limits_of_the_solve(void) {
	const real lost[1] = {(real)NAN};
	real u[1], plan[8];
	start(KOOP_MPC_NEWTON);
	low[0] = (real)0.25;
	CHECK_STATUS(KOOP_E_INPUT, KOOP(mpc_solve)(&mpc, theta, lost, reference, NULL, u, NULL));
	TEST_ASSERT_TRUE(u[0] >= low[0] && u[0] <= low[0]);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	for (size_t k = 0; k < 8; k++) { TEST_ASSERT_TRUE(plan[k] >= low[0] && plan[k] <= low[0]); }
	safe[0] = (real)NAN;
	CHECK_STATUS(KOOP_E_INPUT, solve(u));
	TEST_ASSERT_TRUE(u[0] >= low[0] && u[0] <= low[0]);
}

/* A flipped bit in what says which limit holds an input. */
static void test_what_holds_an_input_may_be_unknown(void) {
	static const signed char flipped[] = {5, -5, 64, -128, 3, -3};
	for (size_t i = 0; i < sizeof flipped / sizeof *flipped; i++) {
		real u[1], before[8], after[8];
		start(KOOP_MPC_NEWTON);
		CHECK_STATUS(KOOP_OK, solve(u));
		CHECK_STATUS(KOOP_OK, solve(u));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, before));
		mpc.set[i] = flipped[i];
		CHECK_STATUS(KOOP_OK, solve(u));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, after));
		for (size_t k = 0; k < 8; k++) { CHECK(fabs((double)(before[k] - after[k])) < 1e-5, "%g", (double)after[k]); }
	}
}

/* It is free, and where it is: here, where each step is brought to the same place by itself, the best. */
static void test_input_held_by_no_limit_stays_where_it_is(void) {
	static const signed char flipped[] = {5, -5, 64, -128, 3, -3, 4, -4};
	static const real apart[2 * 4] = {0, 0, 0, 0, 1, 0, 0, 0}, near[8] = {1, 1, 1, 1, 1, 1, 1, 1};
	for (size_t i = 0; i < sizeof flipped / sizeof *flipped; i++) {
		real u[1];
		KOOP(mpc_result) result;
		start(KOOP_MPC_NEWTON);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, apart, here, near, NULL, u, &result));
		TEST_ASSERT_TRUE(result.iterations > 0);
		mpc.set[i] = flipped[i];
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, apart, here, near, NULL, u, &result));
		CHECK(result.iterations == 0, "%zu steps", result.iterations);
		for (size_t q = 0; q < 8; q++) { TEST_ASSERT_TRUE(mpc.set[q] == 0); }
	}
}

/* Without limits the optimum is that of a linear system: the gradient vanishes. */
static void test_infinite_means_no_limit(void) {
	for (int method = KOOP_MPC_NEWTON; method <= KOOP_MPC_GRADIENT; method++) {
		real u[1], plan[8];
		start(method);
		low[0] = -(real)INFINITY;
		high[0] = (real)INFINITY;
		CHECK_STATUS(KOOP_OK, solve(u));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
		for (size_t k = 0; k < 8; k++) {
			wide gradient = plan[k];
			for (size_t i = k; i < 8; i++) {
				wide x = -10;
				for (size_t j = 0; j <= i; j++) { x += plan[j]; }
				gradient += x;
			}
			CHECK(fabs(gradient) < 2000 * (double)REAL_EPSILON, "gradient %g", (double)gradient);
		}
		TEST_ASSERT_TRUE(u[0] > 6); /* far beyond the limits before */
	}
}

/* An input that costs next to nothing, with no upper limit: the step to the optimum is beyond range. */
static void test_optimum_beyond_range_is_refused(void) {
	const real weak = (real)sqrt((double)REAL_MIN) / 16, cheap[1] = {4 * REAL_MIN};
	const real model[2 * 4] = {1, 0, 0, 0, weak, 0, 0, 0}, far[1] = {1000 / weak};
	for (int method = KOOP_MPC_NEWTON; method <= KOOP_MPC_GRADIENT; method++) {
		const KOOP(mpc_config) config = {1, 1, 1, 1, one, cheap, NULL, low, high, safe, 0, method};
		real u[1];
		low[0] = safe[0] = -1;
		high[0] = (real)INFINITY;
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(mpc_solve)(&mpc, model, here, far, NULL, u, NULL));
		TEST_ASSERT_TRUE(u[0] >= -1 && u[0] <= -1);
	}
}

static void test_weights_may_change_but_not_into_what_is_none(void) {
	static real Q[4] = {1, 0, 0, 1}, R[1] = {1};
	static const real A[3 * 4] = {1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0}, psi[2] = {0, 0};
	static const real goal[16] = {10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10};
	real u[1];
	const KOOP(mpc_config) config = {2, 2, 1, 8, Q, R, NULL, low, high, safe, 0, KOOP_MPC_NEWTON};
	low[0] = -1;
	high[0] = 1;
	safe[0] = 0;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	Q[1] = Q[2] = 4; /* indefinite */
	CHECK_STATUS(KOOP_E_INDEFINITE, KOOP(mpc_solve)(&mpc, A, psi, goal, NULL, u, NULL));
	TEST_ASSERT_TRUE(u[0] >= 0 && u[0] <= 0);
	Q[1] = Q[2] = (real)0.5;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, A, psi, goal, NULL, u, NULL));
	TEST_ASSERT_TRUE(u[0] >= 1);
}

int main(int count, char **arguments) {
	const long wanted = count > 1 ? atol(arguments[1]) : 0; /* an emulator gives arguments of its own */
	if (wanted > 0) { solves = (size_t)wanted; }
	UNITY_BEGIN();
	RUN_TEST(test_limits_that_move_between_solves_hold_with_newton);
	RUN_TEST(test_limits_that_move_between_solves_hold_with_the_gradient);
	RUN_TEST(test_crossed_limits_are_refused_and_the_last_plan_is_kept);
	RUN_TEST(test_safe_input_is_brought_inside_the_limits_of_the_solve);
	RUN_TEST(test_what_holds_an_input_may_be_unknown);
	RUN_TEST(test_input_held_by_no_limit_stays_where_it_is);
	RUN_TEST(test_infinite_means_no_limit);
	RUN_TEST(test_optimum_beyond_range_is_refused);
	RUN_TEST(test_weights_may_change_but_not_into_what_is_none);
	return UNITY_END();
}
