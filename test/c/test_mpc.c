/* The controller against the quadratic program written out: a dense Hessian from
 * simulated unit inputs, solved by coordinate descent in wide arithmetic. */
#include "support.h"

enum { MOST_LIFTED = 6, MOST_STATES = 3, MOST_INPUTS = 2, MOST_H = 12, MOST_V = MOST_H * MOST_INPUTS };

/* One random problem. Theta is laid out as rls.theta is. */
typedef struct {
	size_t N, n, m, H;
	real theta[(MOST_LIFTED + MOST_INPUTS) * KOOP_PAD(MOST_LIFTED)];
	real Q[MOST_STATES * MOST_STATES], R[MOST_INPUTS * MOST_INPUTS], S[MOST_INPUTS * MOST_INPUTS];
	real low[MOST_INPUTS], high[MOST_INPUTS], safe[MOST_INPUTS];
	real psi[MOST_LIFTED], reference[MOST_H * MOST_STATES], before[MOST_INPUTS];
	KOOP(mpc_config) config;
} problem;

static real storage[KOOP_MPC_REALS_NEWTON(MOST_LIFTED, MOST_STATES, MOST_INPUTS, MOST_H) +
                    KOOP_MPC_REALS_RATE(MOST_INPUTS, MOST_H)];
static KOOP(mpc) mpc;

/* M = L L' + floor I, symmetric, full */
static void random_weight(random_source *random, real *M, size_t n, double floor) {
	real L[MOST_STATES * MOST_STATES];
	random_fill(random, L, n * n, -1, 1);
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j <= i; j++) {
			wide sum = i == j ? (wide)floor : 0;
			for (size_t k = 0; k < n; k++) { sum += (wide)L[i * n + k] * (wide)L[j * n + k]; }
			M[i * n + j] = M[j * n + i] = (real)sum;
		}
	}
}

static void random_problem(random_source *random, problem *p, int method) {
	memset(p, 0, sizeof *p);
	p->N = 1 + random_below(random, MOST_LIFTED);
	p->n = 1 + random_below(random, p->N < MOST_STATES ? p->N : MOST_STATES);
	p->m = 1 + random_below(random, MOST_INPUTS);
	p->H = 1 + random_below(random, MOST_H);
	const size_t rows = KOOP_PAD(p->N);
	const int no_input = random_below(random, 20) == 0; /* B = 0 */
	for (size_t j = 0; j < p->N + p->m; j++) {
		/* spectral radius about 1: longer horizons of unstable models are ill-conditioned beyond float */
		const double size = j < p->N ? 1.6 / sqrt((double)p->N) : no_input ? 0 : 1;
		random_fill(random, p->theta + j * rows, p->N, -size, size);
	}
	random_weight(random, p->Q, p->n, 0);
	random_weight(random, p->R, p->m, 0.05);
	random_weight(random, p->S, p->m, 0);
	const double box = random_below(random, 3) == 0 ? 10 : random_below(random, 2) ? 0.5 : 0.02;
	for (size_t j = 0; j < p->m; j++) {
		p->low[j] = random_uniform(random, -box, 0);
		p->high[j] = random_uniform(random, 0, box);
	}
	random_fill(random, p->psi, p->N, -1, 1);
	random_fill(random, p->reference, p->H * p->n, -2, 2);
	random_fill(random, p->before, p->m, -box, box);
	p->config = (KOOP(mpc_config)){
	    .n_lifted = p->N,
	    .n_states = p->n,
	    .n_inputs = p->m,
	    .horizon = p->H,
	    .Q = p->Q,
	    .R = p->R,
	    .S = random_below(random, 2) ? p->S : NULL,
	    .u_min = p->low,
	    .u_max = p->high,
	    .u_safe = p->safe,
	    .method = method,
	};
}

/* The first n lifted states at steps 1..H under u (H rows of m), from the problem's psi or from 0. */
static void simulate(const problem *p, const wide *u, int from_psi, wide *x) {
	wide z[MOST_LIFTED] = {0}, next[MOST_LIFTED];
	for (size_t i = 0; from_psi && i < p->N; i++) { z[i] = p->psi[i]; }
	for (size_t k = 0; k < p->H; k++) {
		for (size_t i = 0; i < p->N; i++) {
			next[i] = 0;
			for (size_t j = 0; j < p->N; j++) { next[i] += (wide)p->theta[j * KOOP_PAD(p->N) + i] * z[j]; }
			for (size_t j = 0; j < p->m; j++) {
				next[i] += (wide)p->theta[(p->N + j) * KOOP_PAD(p->N) + i] * u[k * p->m + j];
			}
		}
		memcpy(z, next, sizeof z);
		memcpy(x + k * p->n, z, p->n * sizeof *x);
	}
}

/* half gradient of the cost: sum over i of X[i]' Q e[i] + R u + rate terms, for X the response to each input
 */
typedef struct {
	size_t V;
	wide hessian[MOST_V][MOST_V], linear[MOST_V];
} dense;

static void write_out(const problem *p, dense *d) {
	static wide response[MOST_V][MOST_H * MOST_STATES];
	wide u[MOST_V] = {0}, error[MOST_H * MOST_STATES];
	const size_t n = p->n, m = p->m, V = p->H * m;
	d->V = V;
	simulate(p, u, 1, error);
	for (size_t i = 0; i < p->H * n; i++) { error[i] -= p->reference[i]; }
	for (size_t q = 0; q < V; q++) {
		u[q] = 1;
		simulate(p, u, 0, response[q]);
		u[q] = 0;
	}
	for (size_t q = 0; q < V; q++) {
		wide weighted[MOST_H * MOST_STATES]; /* Q times the response */
		for (size_t i = 0; i < p->H * n; i++) {
			weighted[i] = 0;
			for (size_t j = 0; j < n; j++) {
				weighted[i] += (wide)p->Q[j * n + i % n] * response[q][i - i % n + j];
			}
		}
		d->linear[q] = 0;
		for (size_t i = 0; i < p->H * n; i++) { d->linear[q] += weighted[i] * error[i]; }
		for (size_t r = 0; r < V; r++) {
			wide sum = q / m == r / m ? (wide)p->R[q % m * m + r % m] : 0;
			for (size_t i = q / m * n; i < p->H * n; i++) { sum += weighted[i] * response[r][i]; }
			d->hessian[q][r] = sum;
		}
	}
	if (!p->config.S) { return; }
	/* |u[k] - u[k-1]|^2_S */
	for (size_t k = 0; k < p->H; k++) {
		for (size_t i = 0; i < m; i++) {
			for (size_t j = 0; j < m; j++) {
				const wide s = p->S[i * m + j];
				d->hessian[k * m + i][k * m + j] += s;
				if (k == 0) {
					d->linear[i] -= s * p->before[j];
				} else {
					d->hessian[(k - 1) * m + i][(k - 1) * m + j] += s;
					d->hessian[(k - 1) * m + i][k * m + j] -= s;
					d->hessian[k * m + i][(k - 1) * m + j] -= s;
				}
			}
		}
	}
}

static wide clipped(const problem *p, size_t q, wide v) {
	const wide low = p->low[q % p->m], high = p->high[q % p->m];
	return v < low ? low : v > high ? high : v;
}

static wide dense_gradient(const dense *d, const wide *v, size_t q) {
	wide sum = d->linear[q];
	for (size_t r = 0; r < d->V; r++) { sum += d->hessian[q][r] * v[r]; }
	return sum;
}

/* The inputs that no bound holds, from linear equations with the others as they are; nothing if that leads
 * out of the box. */
static void solve_for_free(const problem *p, const dense *d, wide *v) {
	static wide A[MOST_V][MOST_V], b[MOST_V];
	size_t index[MOST_V], count = 0;
	for (size_t q = 0; q < d->V; q++) {
		if (v[q] > p->low[q % p->m] && v[q] < p->high[q % p->m]) { index[count++] = q; }
	}
	for (size_t i = 0; i < count; i++) {
		b[i] = -dense_gradient(d, v, index[i]);
		for (size_t j = 0; j < count; j++) { A[i][j] = d->hessian[index[i]][index[j]]; }
	}
	for (size_t k = 0; k < count; k++) {
		for (size_t i = k + 1; i < count; i++) {
			const wide factor = A[i][k] / A[k][k];
			for (size_t j = k + 1; j < count; j++) { A[i][j] -= factor * A[k][j]; }
			b[i] -= factor * b[k];
		}
	}
	int inside = 1;
	for (size_t k = count; k-- > 0;) {
		for (size_t j = k + 1; j < count; j++) { b[k] -= A[k][j] * b[j]; }
		b[k] /= A[k][k];
		const wide next = v[index[k]] + b[k];
		inside = inside && next == clipped(p, index[k], next);
	}
	for (size_t k = 0; inside && k < count; k++) { v[index[k]] += b[k]; }
}

/* Coordinate descent until nothing moves, which the equations bring about sooner. */
static void solve_slowly(const problem *p, const dense *d, wide *v) {
	for (size_t q = 0; q < d->V; q++) { v[q] = clipped(p, q, 0); }
	wide largest = 1;
	for (int sweep = 1; sweep <= 200000 && largest > (wide)1e-15L; sweep++) {
		largest = 0;
		for (size_t q = 0; q < d->V; q++) {
			const wide next = clipped(p, q, v[q] - dense_gradient(d, v, q) / d->hessian[q][q]);
			const wide change = next > v[q] ? next - v[q] : v[q] - next;
			if (change > largest) { largest = change; }
			v[q] = next;
		}
		if (sweep % 5 == 0) { solve_for_free(p, d, v); }
	}
}

/* What the header calls the residual, from the dense problem. */
static wide dense_residual(const problem *p, const dense *d, const wide *v) {
	wide largest = 0;
	for (size_t q = 0; q < d->V; q++) {
		const wide step = clipped(p, q, v[q] - dense_gradient(d, v, q) / d->hessian[q][q]) - v[q];
		if (fabs(step) > largest) { largest = fabs(step); }
	}
	return largest;
}

static void check_problem(const problem *p, int round, double allowed) {
	static dense d;
	real u[MOST_INPUTS], plan[MOST_V];
	wide best[MOST_V], got[MOST_V];
	KOOP(mpc_result) result;
	write_out(p, &d);
	solve_slowly(p, &d, best);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p->config, storage, sizeof storage / sizeof *storage));
	for (int warm = 0; warm < 2; warm++) {
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, &result));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
		for (size_t q = 0; q < d.V; q++) {
			got[q] = plan[q];
			CHECK(fabs(got[q] - best[q]) <= allowed,
			      "round %d: N %zu n %zu m %zu H %zu: u[%zu] %.12g, not %.12g", round, p->N, p->n, p->m, p->H,
			      q, (double)got[q], (double)best[q]);
			CHECK(plan[q] >= p->low[q % p->m] && plan[q] <= p->high[q % p->m], "round %d: outside the box",
			      round);
		}
		TEST_ASSERT_TRUE(memcmp(u, plan, p->m * sizeof *u) == 0);
		const wide residual = dense_residual(p, &d, got);
		CHECK(fabs(residual - result.residual) <= 2000 * REAL_EPSILON, "round %d: residual %g, is %g", round,
		      (double)result.residual, (double)residual);
	}
}

static void test_newton(void) {
	random_source random = random_seed(1);
	for (int round = 0; round < 1500; round++) {
		problem p;
		random_problem(&random, &p, KOOP_MPC_NEWTON);
		check_problem(&p, round, TEST_DOUBLE ? 1e-8 : 1e-3);
	}
}

static void test_gradient(void) {
	random_source random = random_seed(2);
	for (int round = 0; round < 500; round++) {
		problem p;
		random_problem(&random, &p, KOOP_MPC_GRADIENT);
		p.config.tolerance = (real)(TEST_DOUBLE ? 1e-11 : 1e-6);
		check_problem(&p, round, TEST_DOUBLE ? 1e-8 : 1e-3);
	}
}

/* A tolerance that round-off does not let be met: the solver sees that, and what it gives is as good as can
 * be. */
static void test_tolerance_beyond_round_off(void) {
	random_source random = random_seed(5);
	for (int round = 0; round < 400; round++) {
		problem p;
		random_problem(&random, &p, round % 2 ? KOOP_MPC_NEWTON : KOOP_MPC_GRADIENT);
		p.config.tolerance = REAL_MIN;
		check_problem(&p, round, TEST_DOUBLE ? 1e-8 : 1e-3);
	}
}

/* A model that cannot be used gives the safe input and a status, and no trace of it stays. */
static void test_unusable_model(void) {
	random_source random = random_seed(3);
	for (int method = 0; method < 2; method++) {
		static const double bad[] = {NAN, INFINITY, 0, 0};
		for (size_t k = 0; k < 4; k++) {
			problem p;
			real u[MOST_INPUTS], again[MOST_INPUTS], expected[MOST_INPUTS];
			do { random_problem(&random, &p, method); } while (p.H < 4);
			const real before = p.theta[0];
			CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.config, storage, sizeof storage / sizeof *storage));
			CHECK_STATUS(KOOP_OK,
			             KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, expected, NULL));
			p.theta[0] = k < 2 ? (real)bad[k] : k == 2 ? REAL_MAX : -REAL_MAX;
			CHECK_STATUS(KOOP_E_OVERFLOW,
			             KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, NULL));
			for (size_t j = 0; j < p.m; j++) { TEST_ASSERT_TRUE(u[j] == p.safe[j]); }
			p.theta[0] = before;
			CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, again, NULL));
			for (size_t j = 0; j < p.m; j++) {
				CHECK(fabs((double)(again[j] - expected[j])) < 1e-3, "%g after %g", (double)again[j],
				      (double)expected[j]);
			}
		}
	}
}

/* A robot at rest that every input pushes: A = I, B as given, Q = I, R = I / 10, inputs within +-1. */
static void simple_problem(problem *p, size_t N, size_t m, size_t H, int method) {
	memset(p, 0, sizeof *p);
	p->N = p->n = N;
	p->m = m;
	p->H = H;
	for (size_t i = 0; i < N; i++) { p->theta[i * KOOP_PAD(N) + i] = p->Q[i * (N + 1)] = 1; }
	for (size_t j = 0; j < m; j++) {
		p->R[j * (m + 1)] = (real)0.1;
		p->low[j] = -1;
		p->high[j] = 1;
	}
	p->config = (KOOP(mpc_config)){
	    .n_lifted = N,
	    .n_states = N,
	    .n_inputs = m,
	    .horizon = H,
	    .Q = p->Q,
	    .R = p->R,
	    .u_min = p->low,
	    .u_max = p->high,
	    .u_safe = p->safe,
	    .method = method,
	};
}

static real *input_gain(problem *p, size_t i, size_t j) {
	return p->theta + (p->N + j) * KOOP_PAD(p->N) + i;
}

static int solve(const problem *p, real *u, KOOP(mpc_result) *result) {
	return KOOP(mpc_solve)(&mpc, p->theta, p->psi, p->reference, p->before, u, result);
}

static void start(const problem *p) {
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p->config, storage, sizeof storage / sizeof *storage));
}

/* From a fresh start: the status, and the safe input. */
static void check_refused(const problem *p, int status) {
	real u[MOST_INPUTS];
	start(p);
	CHECK_STATUS(status, solve(p, u, NULL));
	for (size_t j = 0; j < p->m; j++) { TEST_ASSERT_TRUE(u[j] == p->safe[j]); }
}

static void test_prediction_beyond_range(void) {
	for (int method = 0; method < 2; method++) {
		problem p;
		simple_problem(&p, 1, 1, 3, method);
		*input_gain(&p, 0, 0) = 1;
		p.theta[0] = 2;
		p.psi[0] = REAL_MAX / 4;
		check_refused(&p, KOOP_E_OVERFLOW);
		p.psi[0] = 0;
		p.reference[0] = REAL_MAX;
		p.reference[1] = -REAL_MAX;
		p.Q[0] = 20; /* the errors fit, what they cost does not */
		check_refused(&p, KOOP_E_OVERFLOW);
	}
}

/* What one input costs is beyond range and the other meets its bound in it: no plan, though nothing is seen
 * to be left to do. */
static void test_gradient_that_is_not_a_number(void) {
	for (int method = 0; method < 2; method++) {
		problem p;
		simple_problem(&p, 1, 2, 2, method);
		*input_gain(&p, 0, 1) = 1;
		p.safe[1] = p.low[1];
		p.reference[0] = p.reference[1] = -REAL_MAX / 10;
		p.Q[0] = 20;
		check_refused(&p, KOOP_E_OVERFLOW);
	}
}

/* Weights are taken as positive semidefinite up to round-off; a model can bring out that they are not. */
static void test_hessian_that_is_not_positive(void) {
	for (int method = 0; method < 2; method++) {
		problem p;
		simple_problem(&p, 2, 1, 2, method);
		*input_gain(&p, 1, 0) = 1;
		p.Q[3] = -(real)sqrt((double)REAL_EPSILON) / 2;
		p.R[0] = REAL_EPSILON;
		check_refused(&p, KOOP_E_INDEFINITE);
	}
}

/* Half of what the plan u (H rows of m) costs, less what is the same for all. */
static wide dense_cost(const dense *d, const wide *u) {
	wide sum = 0;
	for (size_t q = 0; q < d->V; q++) { sum += u[q] * (dense_gradient(d, u, q) + d->linear[q]) / 2; }
	return sum;
}

/* Weights that are indefinite by as much as is let pass: the way down has no end but the box. */
static void test_projected_gradient_goes_downhill(void) {
	static dense d;
	problem p;
	real u[MOST_INPUTS], plan[MOST_V];
	wide start_cost, v[MOST_V] = {0};
	KOOP(mpc_result) result;
	simple_problem(&p, 2, 2, 1, KOOP_MPC_GRADIENT);
	for (size_t j = 0; j < 2; j++) {
		*input_gain(&p, j, j) = p.psi[j] = 1;
		p.R[3 * j] = REAL_EPSILON;
	}
	p.Q[1] = p.Q[2] = -1 - (real)sqrt((double)REAL_EPSILON) / 4;
	write_out(&p, &d);
	start_cost = dense_cost(&d, v);
	start(&p);
	CHECK_STATUS(KOOP_OK, solve(&p, u, &result));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	for (size_t q = 0; q < d.V; q++) { v[q] = plan[q]; }
	CHECK(dense_cost(&d, v) < start_cost, "cost %g, safe %g", (double)dense_cost(&d, v), (double)start_cost);
	CHECK(result.residual <= mpc.config.tolerance, "residual %g", (double)result.residual);
}

/* An input that does nothing and costs next to nothing, beside one that does cost. */
static void test_input_without_effect_or_cost(void) {
	problem p;
	simple_problem(&p, 1, 2, 3, KOOP_MPC_NEWTON);
	*input_gain(&p, 0, 0) = 1;
	p.psi[0] = (real)0.5;
	p.R[3] = REAL_EPSILON / 10;
	check_refused(&p, KOOP_E_INDEFINITE);
}

/* Two inputs that do the same and cost next to nothing. A bound holds one of them at the end of the horizon.
 */
static void test_inputs_that_cannot_be_told_apart(void) {
	problem p;
	simple_problem(&p, 1, 2, 4, KOOP_MPC_NEWTON);
	for (size_t j = 0; j < p.m; j++) {
		*input_gain(&p, 0, j) = 1;
		p.R[j * (p.m + 1)] = REAL_EPSILON * REAL_EPSILON;
	}
	p.safe[0] = p.low[0];
	for (size_t k = 0; k < p.H; k++) { p.reference[k] = -(real)k - (k < 3 ? 0 : (real)1.1); }
	check_refused(&p, KOOP_E_INDEFINITE);
}

/* Inputs that do nothing: the plan is what costs least, one at its bound and the other held down by it. */
static void test_inputs_without_effect(void) {
	problem p;
	real u[2], plan[MOST_V];
	simple_problem(&p, 1, 2, 5, KOOP_MPC_NEWTON);
	p.R[0] = p.R[3] = 1;
	p.R[1] = p.R[2] = (real)0.75;
	p.low[0] = p.safe[0] = (real)0.5;
	start(&p);
	CHECK_STATUS(KOOP_OK, solve(&p, u, NULL));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	for (size_t k = 0; k < p.H; k++) {
		TEST_ASSERT_TRUE(plan[2 * k] == (real)0.5);
		CHECK(fabs((double)plan[2 * k + 1] + 0.375) <= 1e-5, "%g", (double)plan[2 * k + 1]);
	}
}

/* Errors so large that round-off in them is above the tolerance, and above what the inputs' range makes up
 * for: the gradient is followed for as long as is allowed, and the residual says so. */
static void test_all_gradient_steps(void) {
	problem p;
	real u[1];
	KOOP(mpc_result) result;
	simple_problem(&p, 2, 1, 1, KOOP_MPC_GRADIENT);
	p.config.tolerance = REAL_MIN;
	*input_gain(&p, 0, 0) = *input_gain(&p, 1, 0) = 1;
	p.psi[0] = (real)0.1 / REAL_EPSILON;
	p.psi[1] = (real)0.3 - p.psi[0];
	start(&p);
	CHECK_STATUS(KOOP_OK, solve(&p, u, &result));
	CHECK(result.iterations == KOOP_MPC_MAX_GRADIENT, "%zu steps", result.iterations);
	CHECK(result.residual > p.config.tolerance && result.residual < 1, "residual %g",
	      (double)result.residual);
	TEST_ASSERT_TRUE(u[0] >= -1 && u[0] <= 1);
}

static void test_weights(void) {
	static const struct {
		real M[4];
		int status;
	} cases[] = {
	    {{1, 0, 0, 1}, KOOP_OK},        {{1, 1, 1, 1}, KOOP_OK}, /* of rank one */
	    {{1, 0, 0, -1}, KOOP_E_RANGE},  {{1, 2, 2, 1}, KOOP_E_RANGE},
	    {{1, 1, 0, 1}, KOOP_E_RANGE}, /* not symmetric */
	    {{-1, 0, 0, -1}, KOOP_E_RANGE}, {{0, 0, 0, 0}, KOOP_OK},
	};
	const size_t reals = sizeof storage / sizeof *storage;
	for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
		problem p;
		real u[MOST_INPUTS];
		simple_problem(&p, 2, 2, 3, KOOP_MPC_NEWTON);
		for (int which = 0; which < 3; which++) {
			KOOP(mpc_config) c = p.config;
			*(which == 0 ? &c.Q : which == 1 ? &c.R : &c.S) = cases[i].M;
			const int status = which == 1 && !(cases[i].M[0] > 0) ? KOOP_E_RANGE : cases[i].status;
			CHECK_STATUS(status, KOOP(mpc_init)(&mpc, &c, storage, reals));
			if (status == KOOP_OK || !(c.R[0] > 0)) { continue; }
			/* it can do nothing until it is made anew */
			CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, NULL));
			CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_reset)(&mpc));
		}
	}
}

/* What an input does k + 1 steps later, C A^k B. */
static void test_sensitivity(void) {
	problem p;
	real u[2], G[4] = {7, 7, 7, 7};
	simple_problem(&p, 2, 2, 3, KOOP_MPC_NEWTON);
	p.theta[0] = 2; /* A = [2 0; 0 1], B = [1 0; 3 4] */
	*input_gain(&p, 0, 0) = 1;
	*input_gain(&p, 1, 0) = 3;
	*input_gain(&p, 1, 1) = 4;
	start(&p);
	CHECK_STATUS(KOOP_OK, solve(&p, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_sensitivity)(NULL, 0, G));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_sensitivity)(&mpc, 0, NULL));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(mpc_sensitivity)(&mpc, 3, G));
	for (size_t i = 0; i < 4; i++) { TEST_ASSERT_TRUE(G[i] == 7); }
	for (size_t k = 0; k < 3; k++) {
		CHECK_STATUS(KOOP_OK, KOOP(mpc_sensitivity)(&mpc, k, G));
		const real expected[4] = {(real)(1 << k), 0, 3, 4};
		TEST_ASSERT_EQUAL_MEMORY(expected, G, sizeof G);
	}
}

static void test_controller_that_was_never_made(void) {
	KOOP(mpc) empty;
	real u[MOST_INPUTS], plan[MOST_V];
	problem p;
	simple_problem(&p, 1, 1, 2, KOOP_MPC_NEWTON);
	memset(&empty, 0, sizeof empty);
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_reset)(&empty));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&empty, p.theta, p.psi, p.reference, p.before, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_plan)(&empty, plan));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_sensitivity)(&empty, 0, plan));
}

/* One sample of the reference is so large that the gradient is not finite: bounds were looked for without
 * end. */
static void test_gradient_beyond_range(void) {
	random_source random = random_seed(5);
	int refused = 0, planned = 0;
	for (int k = 0; k < 2000 / TEST_SHARE; k++) {
		problem p;
		real u[MOST_INPUTS];
		KOOP(mpc_result) result;
		random_problem(&random, &p, k % 2);
		const double most = log2((double)REAL_MAX), size = exp2(random_uniform(&random, most - 8, most));
		p.reference[random_below(&random, p.H * p.n)] = (real)size;
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.config, storage, sizeof storage / sizeof *storage));
		const int status = KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, &result);
		CHECK(status == KOOP_OK || status == KOOP_E_OVERFLOW || status == KOOP_E_INDEFINITE, "%d", status);
		for (size_t j = 0; j < p.m; j++) {
			CHECK(u[j] >= p.low[j] && u[j] <= p.high[j], "u[%u] = %g", (unsigned)j, (double)u[j]);
			if (status != KOOP_OK) { TEST_ASSERT_TRUE(u[j] == p.safe[j]); }
		}
		refused += status == KOOP_E_OVERFLOW;
		planned += status == KOOP_OK;
	}
	CHECK(refused > 20 / TEST_SHARE && planned > 200 / TEST_SHARE, "%d refused, %d planned", refused, planned);
}

static void test_arguments(void) {
	random_source random = random_seed(4);
	problem p;
	real u[MOST_INPUTS];
	const size_t reals = sizeof storage / sizeof *storage;
	do { random_problem(&random, &p, KOOP_MPC_NEWTON); } while (p.m < 2 || !p.config.S);
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_init)(NULL, &p.config, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_init)(&mpc, NULL, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_init)(&mpc, &p.config, NULL, reals));

	const size_t exact = KOOP_MPC_REALS_NEWTON(p.N, p.n, p.m, p.H) + KOOP_MPC_REALS_RATE(p.m, p.H);
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(mpc_init)(&mpc, &p.config, storage, exact - 1));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.config, storage, exact));

#define REFUSED(status, change)                                                                              \
	do {                                                                                                     \
		KOOP(mpc_config) c = p.config;                                                                       \
		c.change;                                                                                            \
		CHECK_STATUS(status, KOOP(mpc_init)(&mpc, &c, storage, reals));                                      \
	} while (0)
	real bad[MOST_STATES * MOST_STATES] = {0};
	REFUSED(KOOP_E_NULL, Q = NULL);
	REFUSED(KOOP_E_NULL, R = NULL);
	REFUSED(KOOP_E_NULL, u_min = NULL);
	REFUSED(KOOP_E_NULL, u_max = NULL);
	REFUSED(KOOP_E_NULL, u_safe = NULL);
	REFUSED(KOOP_E_SIZE, n_lifted = 0);
	REFUSED(KOOP_E_SIZE, n_lifted = KOOP_MAX_DIM + 1);
	REFUSED(KOOP_E_SIZE, n_states = 0);
	REFUSED(KOOP_E_SIZE, n_states = p.N + 1);
	REFUSED(KOOP_E_SIZE, n_inputs = 0);
	REFUSED(KOOP_E_SIZE, n_inputs = KOOP_MAX_DIM);
	REFUSED(KOOP_E_SIZE, horizon = 0);
	REFUSED(KOOP_E_SIZE, horizon = KOOP_MPC_MAX_HORIZON + 1);
	REFUSED(KOOP_E_SIZE, n_lifted = c.n_states = 1; c.n_inputs = 128; c.horizon = 512); /* 32 bits overflow */
	REFUSED(KOOP_E_RANGE, R = bad);
	REFUSED(KOOP_E_RANGE, u_max = p.low);
	p.safe[0] = p.high[0] + 1;
	REFUSED(KOOP_E_RANGE, u_safe = p.safe);
	p.safe[0] = p.low[0] - 1;
	REFUSED(KOOP_E_RANGE, u_safe = p.safe);
	p.safe[0] = 0;
	REFUSED(KOOP_E_RANGE, tolerance = (real)INFINITY);
	REFUSED(KOOP_E_RANGE, tolerance = -1);
	REFUSED(KOOP_E_RANGE, tolerance = (real)NAN);
	REFUSED(KOOP_E_RANGE, method = 2);
	bad[0] = (real)NAN;
	REFUSED(KOOP_E_INPUT, Q = bad);
	REFUSED(KOOP_E_INPUT, S = bad);
	REFUSED(KOOP_E_INPUT, R = bad);
	REFUSED(KOOP_E_INPUT, u_min = bad);
	REFUSED(KOOP_E_INPUT, u_max = bad);

	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.config, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(NULL, p.theta, p.psi, p.reference, p.before, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, NULL, p.psi, p.reference, p.before, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, p.theta, NULL, p.reference, p.before, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, p.theta, p.psi, NULL, p.before, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, NULL, u, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, NULL, NULL));
	real *const inputs[] = {p.psi, p.reference, p.before};
	for (size_t i = 0; i < 3; i++) {
		const real kept = *inputs[i];
		*inputs[i] = (real)NAN;
		CHECK_STATUS(KOOP_E_INPUT, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, NULL));
		for (size_t j = 0; j < p.m; j++) { TEST_ASSERT_TRUE(u[j] == p.safe[j]); }
		*inputs[i] = kept;
	}
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_plan)(NULL, u));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_plan)(&mpc, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(mpc_reset)(NULL));
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_newton);
	RUN_TEST(test_gradient);
	RUN_TEST(test_tolerance_beyond_round_off);
	RUN_TEST(test_unusable_model);
	RUN_TEST(test_prediction_beyond_range);
	RUN_TEST(test_gradient_that_is_not_a_number);
	RUN_TEST(test_hessian_that_is_not_positive);
	RUN_TEST(test_projected_gradient_goes_downhill);
	RUN_TEST(test_input_without_effect_or_cost);
	RUN_TEST(test_inputs_that_cannot_be_told_apart);
	RUN_TEST(test_inputs_without_effect);
	RUN_TEST(test_all_gradient_steps);
	RUN_TEST(test_weights);
	RUN_TEST(test_sensitivity);
	RUN_TEST(test_controller_that_was_never_made);
	RUN_TEST(test_gradient_beyond_range);
	RUN_TEST(test_arguments);
	return UNITY_END();
}
