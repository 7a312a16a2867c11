/* Many random problems of the controller, up to the size of the paper's and beyond what
 * its models lead to: Hessians with condition numbers up to 1e8, boxes that hold all
 * inputs or none, horizon 1, one lifted state, models that no input moves. What is
 * checked is optimality itself: the gradient by a costate recursion in wide arithmetic,
 * which shares nothing with condensing. */
#include "problem.h"

static KOOP(mpc) mpc;
static real
    storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_m, MOST_H) + KOOP_MPC_REALS_RATE(MOST_m, MOST_H)];

typedef struct {
	int solves, none, all;
	double worst, largest_condition;
} tally;

static void check_plan(const problem *p, const wide *diagonal, int round, double allowed, tally *seen) {
	real u[MOST_m], plan[MOST_V];
	wide gradient[MOST_V];
	KOOP(mpc_result) result;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, &result));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	costate_gradient(p, plan, gradient);
	size_t held = 0;
	wide residual = 0, width = 0;
	for (size_t q = 0; q < p->H * p->m; q++) {
		const wide low = p->low[q % p->m], high = p->high[q % p->m];
		CHECK(plan[q] >= low && plan[q] <= high, "round %d: outside the box", round);
		wide step = plan[q] - gradient[q] / diagonal[q];
		step = step < low ? low : step > high ? high : step;
		if (fabs(step - plan[q]) > residual) { residual = fabs(step - plan[q]); }
		if (high - low > width) { width = high - low; }
		held += plan[q] <= low || plan[q] >= high;
	}
	CHECK(residual <= allowed * (1 + (double)width),
	      "round %d: N %zu n %zu m %zu H %zu: residual %g after %zu steps, told %g", round, p->N, p->n, p->m,
	      p->H, (double)residual, result.iterations, (double)result.residual);
	seen->solves++;
	seen->none += held == 0;
	seen->all += held == p->H * p->m;
	if (residual > seen->worst) { seen->worst = (double)residual; }
}

static void campaign(uint64_t seed, int method, int problems, double tolerance, double allowed,
                     double condition) {
	random_source random = random_seed(seed);
	tally seen = {0, 0, 0, 0, 0};
	for (int round = 0; round < problems / TEST_SHARE;) {
		problem p;
		wide diagonal[MOST_V];
		random_problem(&random, &p);
		hessian_diagonal(&p, diagonal);
		const wide bound = condition_bound(&p, diagonal);
		if (bound > condition) { continue; }
		if (bound > seen.largest_condition) { seen.largest_condition = (double)bound; }
		const KOOP(mpc_config) config = {
		    .n_lifted = p.N,
		    .n_states = p.n,
		    .n_inputs = p.m,
		    .horizon = p.H,
		    .Q = p.Q,
		    .R = p.R,
		    .S = p.rate ? p.S : NULL,
		    .u_min = p.low,
		    .u_max = p.high,
		    .u_safe = p.safe,
		    .tolerance = (real)tolerance,
		    .method = method,
		};
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
		check_plan(&p, diagonal, round, allowed, &seen);
		for (size_t i = 0; i < p.N; i++) { p.psi[i] *= (real)random_uniform(&random, 0.9, 1.1); }
		check_plan(&p, diagonal, round, allowed, &seen); /* warm */
		round++;
	}
	printf("%d solves, condition numbers up to %.1g, no bound active %d, all %d, largest residual %.2g\n",
	       seen.solves, seen.largest_condition, seen.none, seen.all, seen.worst);
	TEST_ASSERT_TRUE(seen.none > 0 && seen.all > 0);
}

static void test_newton(void) {
	if (TEST_DOUBLE) {
		campaign(11, KOOP_MPC_NEWTON, 50000, 0, 1e-8, 1e8);
	} else {
		campaign(12, KOOP_MPC_NEWTON, 10000, 0, 1e-3, 1e4);
	}
}

static void test_gradient(void) {
	if (TEST_DOUBLE) {
		campaign(13, KOOP_MPC_GRADIENT, 10000, 1e-7, 1e-6, 1e6);
	} else {
		campaign(14, KOOP_MPC_GRADIENT, 5000, 0, 1e-3, 1e4);
	}
}

/* ---- Hessians that are singular but for round-off ----------------------------- */

/* Small sizes, and an R that is next to nothing. */
static void singular_problem(random_source *random, problem *p) {
	memset(p, 0, sizeof *p);
	p->N = 1 + random_below(random, 6);
	p->n = 1 + random_below(random, p->N < MOST_n ? p->N : MOST_n);
	p->m = 1 + random_below(random, MOST_m);
	p->H = 1 + random_below(random, 12);
	const size_t rows = KOOP_PAD(p->N);
	for (size_t j = 0; j < p->N + p->m; j++) {
		const double size = j < p->N ? 1.6 / sqrt((double)p->N) : 1;
		random_fill(random, p->theta + j * rows, p->N, -size, size);
	}
	real L[MOST_n * MOST_n];
	const double r = pow((double)REAL_EPSILON, (double)random_uniform(random, 0, 2)),
	             box = decades(random, -3, 1);
	random_fill(random, L, p->n * p->n, -1, 1);
	for (size_t i = 0; i < p->n * p->n; i++) {
		for (size_t k = 0; k < p->n; k++) { p->Q[i] += L[i / p->n * p->n + k] * L[i % p->n * p->n + k]; }
	}
	random_fill(random, L, p->m * p->m, -1, 1);
	for (size_t i = 0; i < p->m * p->m; i++) {
		p->R[i] = i % (p->m + 1) ? 0 : (real)(r * 0.05);
		for (size_t k = 0; k < p->m; k++) {
			p->R[i] += (real)r * L[i / p->m * p->m + k] * L[i % p->m * p->m + k];
		}
	}
	for (size_t j = 0; j < p->m; j++) {
		p->low[j] = random_uniform(random, -box, 0);
		p->high[j] = random_uniform(random, 0, box);
	}
	random_fill(random, p->psi, p->N, -1, 1);
	random_fill(random, p->reference, p->H * p->n, -1, 1);
}

/* What inputs (H rows of m) cost. */
static wide cost_of(const problem *p, const real *u) {
	wide x[MOST_N], next[MOST_N], sum = 0;
	for (size_t i = 0; i < p->N; i++) { x[i] = p->psi[i]; }
	for (size_t k = 0; k < p->H; k++, u += p->m) {
		for (size_t i = 0; i < p->N; i++) {
			next[i] = 0;
			for (size_t j = 0; j < p->N; j++) { next[i] += model(p, i, j) * x[j]; }
			for (size_t j = 0; j < p->m; j++) { next[i] += model(p, i, p->N + j) * u[j]; }
		}
		memcpy(x, next, sizeof x);
		for (size_t i = 0; i < p->n * p->n; i++) {
			const size_t a = i / p->n, b = i % p->n;
			const real *r = p->reference + k * p->n;
			sum += (wide)p->Q[i] * (x[a] - r[a]) * (x[b] - r[b]);
		}
		for (size_t i = 0; i < p->m * p->m; i++) { sum += (wide)p->R[i] * u[i / p->m] * u[i % p->m]; }
	}
	return sum;
}

/* From the plan before, or safe inputs, to one that costs no more, or safe inputs. Then the model changes. */
static int check_singular(random_source *random, problem *p, int round) {
	real from[MOST_V] = {0}, plan[MOST_V], u[MOST_m];
	int refused = 0;
	for (int warm = 0; warm < 4; warm++) {
		KOOP(mpc_result) result;
		const int status = KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, &result);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
		TEST_ASSERT_TRUE(memcmp(u, plan, p->m * sizeof *u) == 0);
		for (size_t q = 0; q < p->H * p->m; q++) {
			CHECK(plan[q] >= p->low[q % p->m] && plan[q] <= p->high[q % p->m], "round %d: outside the box",
			      round);
		}
		TEST_ASSERT_TRUE(result.iterations <= KOOP_MPC_MAX_NEWTON);
		if (status == KOOP_OK) {
			const wide cost = cost_of(p, plan), before = cost_of(p, from);
			/* the states are rounded, and the errors that cost are what is left of them */
			const wide rounding = (wide)REAL_EPSILON * 1000 * (sqrt(before) + before);
			CHECK(cost <= before + rounding, "round %d: cost %g, was %g", round, (double)cost,
			      (double)before);
		} else {
			CHECK_STATUS(KOOP_E_INDEFINITE, status);
			for (size_t q = 0; q < p->H * p->m; q++) { TEST_ASSERT_TRUE(plan[q] == 0); }
			refused++;
		}
		memcpy(from, plan + p->m, (p->H - 1) * p->m * sizeof *from);
		memcpy(from + (p->H - 1) * p->m, plan + (p->H - 1) * p->m, p->m * sizeof *from);
		const double change = decades(random, -4, 0);
		for (size_t i = 0; i < (p->N + p->m) * KOOP_PAD(p->N); i++) {
			p->theta[i] *= (real)(1 + change * (double)random_uniform(random, -1, 1));
		}
	}
	return refused;
}

static int singular_campaign(uint64_t seed) {
	random_source random = random_seed(seed);
	int refused = 0;
	for (int round = 0; round < 600; round++) {
		problem p;
		singular_problem(&random, &p);
		const KOOP(mpc_config) config = {
		    .n_lifted = p.N,
		    .n_states = p.n,
		    .n_inputs = p.m,
		    .horizon = p.H,
		    .Q = p.Q,
		    .R = p.R,
		    .u_min = p.low,
		    .u_max = p.high,
		    .u_safe = p.safe,
		    .tolerance = random_below(&random, 2) ? REAL_MIN : 0,
		};
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
		refused += check_singular(&random, &p, round);
	}
	return refused;
}

/* Seeds that between them end in every way there is: up to all steps taken, as one problem in thousands. */
static void test_nearly_singular(void) {
	static const uint64_t seeds[] = {32, 69, 87, 98, 153, 177};
	for (size_t i = 0; i < sizeof seeds / sizeof *seeds; i++) {
		TEST_ASSERT_TRUE(singular_campaign(seeds[i]) > 0);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_newton);
	RUN_TEST(test_gradient);
	RUN_TEST(test_nearly_singular);
	return UNITY_END();
}
