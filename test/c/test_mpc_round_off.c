/* What rounding leaves of a plan: a start so far away that the first steps leave much, tolerances that cannot
 * be met. */
#include "problem.h"

static KOOP(mpc) mpc;
static real
    storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_m, MOST_H) + KOOP_MPC_REALS_RATE(MOST_m, MOST_H)];

#define FAR (1 / (256 * REAL_EPSILON)) /* inputs of this size are rounded to 1/256 */

/* A model near one that keeps its state, inputs that cost about as much as what they do. Limits are far away,
 * and so is the safe input. */
static void far_problem(random_source *random, problem *p) {
	memset(p, 0, sizeof *p);
	p->N = p->n = p->m = 1 + random_below(random, 2);
	p->H = 1 + random_below(random, 6);
	for (size_t i = 0; i < p->N; i++) {
		random_fill(random, p->theta + i * KOOP_PAD(p->N), p->N, -0.7, 0.7);
		random_fill(random, p->theta + (p->N + i) * KOOP_PAD(p->N), p->N, -1, 1);
		p->Q[i * (p->n + 1)] = p->R[i * (p->m + 1)] = 1;
		p->high[i] = FAR;
		p->low[i] = -FAR;
		p->safe[i] = random_uniform(random, -1, 1) * FAR;
	}
	random_fill(random, p->psi, p->N, -1, 1);
	random_fill(random, p->reference, p->H * p->n, -1, 1);
}

static void start(const problem *p, real tolerance, int method) {
	const KOOP(mpc_config) config = problem_settings(p, tolerance, method);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
}

static void solve(const problem *p, KOOP(mpc_result) *result) {
	real u[MOST_m];
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, result));
}

/* What the header calls the residual, in wide arithmetic. */
static double residual_of(const problem *p) {
	real plan[MOST_V];
	wide gradient[MOST_V], diagonal[MOST_V], largest = 0;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	costate_gradient(p, plan, gradient);
	hessian_diagonal(p, diagonal);
	for (size_t q = 0; q < p->H * p->m; q++) {
		const wide low = p->low[q % p->m], high = p->high[q % p->m], to = plan[q] - gradient[q] / diagonal[q];
		largest = fmax(largest, fabs((to < low ? low : to > high ? high : to) - plan[q]));
	}
	return (double)largest;
}

/* The first step leaves what rounding makes of inputs of that size. One more corrects it, and is not looked
 * at: the residual told is that before. */
static void test_newton_corrects_what_the_way_from_far_away_has_left(void) {
	random_source random = random_seed(95);
	const real tolerance = 32 * REAL_EPSILON;
	for (int i = 0; i < 200; i++) {
		problem p;
		KOOP(mpc_result) result;
		far_problem(&random, &p);
		start(&p, tolerance, KOOP_MPC_NEWTON);
		solve(&p, &result);
		CHECK(result.iterations == 2, "%d: %zu steps", i, result.iterations);
		CHECK(result.residual > tolerance && result.residual < mpc.noise, "%d: %g", i,
		      (double)result.residual);
		CHECK(residual_of(&p) <= 4 * (double)REAL_EPSILON, "%d: residual %g", i, residual_of(&p));
	}
}

/* Three states far from where they are to be, in the one direction in which the two inputs do nothing: the
 * gradient is what rounding leaves of large numbers, and that is more than the inputs' range makes up for. */
static void out_of_reach(random_source *random, problem *p) {
	memset(p, 0, sizeof *p);
	p->N = p->n = 3;
	p->m = 2;
	p->H = 1;
	real *const b = p->theta + 3 * KOOP_PAD(3), *const c = b + KOOP_PAD(3);
	const real far = random_uniform(random, 0.0005, 0.02) / REAL_EPSILON;
	random_fill(random, b, 3, -1, 1);
	random_fill(random, c, 3, -1, 1);
	for (size_t i = 0; i < 3; i++) {
		const size_t k = (i + 1) % 3, l = (i + 2) % 3;
		p->theta[i * (KOOP_PAD(3) + 1)] = p->Q[4 * i] = 1;
		p->psi[i] = far * (real)((wide)b[k] * c[l] - (wide)b[l] * c[k]);
	}
	for (size_t j = 0; j < 2; j++) {
		p->R[3 * j] = (real)0.1;
		p->high[j] = 1;
		p->low[j] = -1;
	}
	random_fill(random, p->reference, 3, -0.7, 0.7);
}

/* Two inputs that do nearly the same and cost little: what rounding has left of the gradient is small, but
 * the way to where it vanishes is far, and so is looked at. */
static void test_correction_that_goes_far_is_taken_where_it_leaves_less(void) {
	random_source random = random_seed(102);
	int far = 0;
	for (int i = 0; i < 200; i++) {
		problem p;
		KOOP(mpc_result) result;
		do { far_problem(&random, &p); } while (p.m < 2);
		p.n = p.H = 1;
		p.Q[0] = 1;
		for (size_t j = 0; j < 2; j++) {
			p.theta[(p.N + j) * KOOP_PAD(p.N)] = random_uniform(&random, 0.9, 1.1);
			p.R[3 * j] = (real)0.002;
		}
		start(&p, 32 * REAL_EPSILON, KOOP_MPC_NEWTON);
		solve(&p, &result);
		if (!(result.residual < mpc.noise) || result.iterations != 2) { continue; }
		far++;
		CHECK(residual_of(&p) <= (double)result.residual / 4, "%d: residual %g, was %g", i, residual_of(&p),
		      (double)result.residual);
	}
	CHECK(far > 50, "%d", far);
}

/* A residual that is just the tolerance is enough: before the first step, and after any of Newton's, each of
 * which evaluates the gradient. */
static void test_tolerance_that_is_just_met_ends_the_steps(void) {
	random_source random = random_seed(103);
	for (int i = 0; i < 100; i++) {
		problem p;
		KOOP(mpc_result) none, some, again;
		out_of_reach(&random, &p);
		start(&p, REAL_MAX, i % 2);
		solve(&p, &none);
		start(&p, none.residual, i % 2);
		solve(&p, &again);
		CHECK(none.iterations == 0 && again.iterations == 0, "%d: %zu steps", i, again.iterations);
		start(&p, none.residual * (1 - REAL_EPSILON), i % 2);
		solve(&p, &some);
		start(&p, some.residual, i % 2);
		solve(&p, &again);
		if (i % 2 || !(some.residual > 0)) { continue; }
		CHECK(some.iterations > 0 && again.iterations == some.iterations, "%d: %zu steps, not %zu", i,
		      again.iterations, some.iterations);
	}
}

/* A look at the gradient shows what is left; as long as that is less than half of what it was, the way goes
 * on. */
static void test_gradient_goes_on_until_the_way_from_far_away_leaves_nothing(void) {
	random_source random = random_seed(96);
	const real tolerance = 32 * REAL_EPSILON;
	for (int i = 0; i < 200; i++) {
		problem p;
		KOOP(mpc_result) result;
		far_problem(&random, &p);
		start(&p, tolerance, KOOP_MPC_GRADIENT);
		solve(&p, &result);
		CHECK(result.residual <= tolerance, "%d: told %g", i, (double)result.residual);
		CHECK(residual_of(&p) <= 2 * (double)tolerance, "%d: residual %g", i, residual_of(&p));
		CHECK(result.iterations <= 100, "%d: %zu steps", i, result.iterations);
	}
}

/* The residual after one step: with the widest tolerance that is not met by none. */
static real residual_of_one_step(const problem *p) {
	for (real tolerance = 1; tolerance >= REAL_MIN; tolerance /= 2) {
		KOOP(mpc_result) result;
		start(p, tolerance, KOOP_MPC_NEWTON);
		solve(p, &result);
		if (result.iterations > 0) { return result.residual; }
	}
	return 0;
}

/* Where only round-off is left, what a step leaves may be more than before: then it is not taken. */
static void test_further_newton_steps_never_leave_more_than_the_first(void) {
	random_source random = random_seed(100);
	int less = 0;
	for (int i = 0; i < 200; i++) {
		problem p;
		KOOP(mpc_result) result;
		out_of_reach(&random, &p);
		start(&p, REAL_MIN, KOOP_MPC_NEWTON);
		solve(&p, &result);
		const real first = residual_of_one_step(&p);
		CHECK(result.residual <= first, "%d: %g, after one step %g", i, (double)result.residual,
		      (double)first);
		less += result.residual < first;
	}
	CHECK(less > 80, "less after %d", less); /* and where it is less it is taken */
}

/* Of one step, so that a solve begins with the plan that the last has ended with. */
static void test_best_plan_takes_few_steps_to_be_found_the_best(void) {
	random_source random = random_seed(101);
	for (int i = 0; i < 300; i++) {
		problem p;
		wide diagonal[MOST_V];
		do {
			random_problem(&random, &p);
			p.H = 1;
			hessian_diagonal(&p, diagonal);
		} while (condition_bound(&p, diagonal) > 1e6);
		start(&p, REAL_MIN, KOOP_MPC_NEWTON);
		for (int warm = 0; warm < 4; warm++) {
			KOOP(mpc_result) result;
			solve(&p, &result);
			CHECK(result.iterations <= 10, "%d: %zu steps", i, result.iterations);
		}
	}
}

/* Neither method goes on for long where only round-off is left. */
static void check_end(random_source *random, int method, size_t most) {
	problem p;
	wide diagonal[MOST_V];
	do {
		random_problem(random, &p);
		hessian_diagonal(&p, diagonal);
	} while (condition_bound(&p, diagonal) > 1e4);
	start(&p, REAL_MIN, method);
	for (int warm = 0; warm < 2; warm++) {
		KOOP(mpc_result) result;
		solve(&p, &result);
		CHECK(result.iterations <= most, "%zu steps", result.iterations);
		CHECK(residual_of(&p) <= 1e-3, "residual %g", residual_of(&p));
	}
}

static void test_tolerance_that_cannot_be_met_is_given_up(void) {
	random_source random = random_seed(97);
	for (int i = 0; i < 100; i++) {
		check_end(&random, KOOP_MPC_NEWTON, 20);
		check_end(&random, KOOP_MPC_GRADIENT, 500);
	}
}

/* While steps go on the gradient is updated, and only every hundredth step looks at what it is: that is where
 * slow ways to where nothing is left end. */
static void test_every_hundredth_step_looks_at_the_gradient(void) {
	random_source random = random_seed(99);
	int slow = 0, at_looks = 0;
	for (int i = 0; i < 900 / TEST_SHARE; i++) {
		problem p;
		KOOP(mpc_result) result;
		wide diagonal[MOST_V];
		random_problem(&random, &p);
		hessian_diagonal(&p, diagonal);
		const wide condition = condition_bound(&p, diagonal);
		if (condition < 1e4 || condition > 1e8) { continue; }
		start(&p, REAL_MIN, KOOP_MPC_GRADIENT);
		solve(&p, &result);
		const int ended = result.residual > REAL_MIN && result.iterations < KOOP_MPC_MAX_GRADIENT;
		const size_t steps = result.iterations + 1; /* the one that round-off has ended is not counted */
		slow += ended && steps >= 100;
		at_looks += ended && steps >= 100 && steps % 100 == 0;
	}
	CHECK(slow >= 10 / TEST_SHARE && at_looks * 6 + 6 >= slow, "%d of %d", at_looks, slow);
}

/* A flipped bit in how many rows the factor has: it is made anew, as where the limits that hold inputs are
 * others. */
static void test_number_of_rows_that_is_not_that_of_the_factor(void) {
	random_source random = random_seed(98);
	for (size_t bit = 0; bit < 5; bit++) {
		problem p;
		KOOP(mpc_result) result;
		do { far_problem(&random, &p); } while (p.H < 5);
		memset(p.safe, 0, sizeof p.safe);
		start(&p, 0, KOOP_MPC_NEWTON);
		solve(&p, &result);
		TEST_ASSERT_TRUE(mpc.factored == 1 && mpc.n_free == p.H * p.m);
		mpc.n_free ^= (size_t)1 << bit;
		p.reference[0] += 1;
		solve(&p, &result);
		TEST_ASSERT_TRUE(mpc.factored == 1 && mpc.fresh == 1 && mpc.n_free == p.H * p.m);
		CHECK(residual_of(&p) <= 1e-4, "residual %g", residual_of(&p));
		p.reference[0] += 1;
		solve(&p, &result);
		TEST_ASSERT_TRUE(mpc.factored == 1 && mpc.fresh == 0);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_newton_corrects_what_the_way_from_far_away_has_left);
	RUN_TEST(test_correction_that_goes_far_is_taken_where_it_leaves_less);
	RUN_TEST(test_tolerance_that_is_just_met_ends_the_steps);
	RUN_TEST(test_gradient_goes_on_until_the_way_from_far_away_leaves_nothing);
	RUN_TEST(test_further_newton_steps_never_leave_more_than_the_first);
	RUN_TEST(test_best_plan_takes_few_steps_to_be_found_the_best);
	RUN_TEST(test_tolerance_that_cannot_be_met_is_given_up);
	RUN_TEST(test_every_hundredth_step_looks_at_the_gradient);
	RUN_TEST(test_number_of_rows_that_is_not_that_of_the_factor);
	return UNITY_END();
}
