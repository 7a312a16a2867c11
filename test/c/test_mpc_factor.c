/* Newton's method against the Hessian written out: the plan after each of its steps, and what its factor
 * stands for, with all choices of inputs that limits hold, all sizes, and weights of all magnitudes. */
#include "support.h"

enum { MOST_N = 6, MOST_n = 4, MOST_M = 5, MOST_V = 30, STEPS = 4, FREE = 0 };

static real storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, 1, MOST_V) +
                    KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_M, MOST_V / MOST_M) +
                    KOOP_MPC_REALS_RATE(MOST_M, MOST_V)];
static KOOP(mpc) mpc;

/* One random problem. */
static struct {
	real theta[(MOST_N + MOST_M) * KOOP_PAD(MOST_N)], psi[MOST_N], reference[MOST_V * MOST_n];
	real Q[MOST_n * MOST_n], R[MOST_M * MOST_M], S[MOST_M * MOST_M];
	real low[MOST_M], high[MOST_M], safe[MOST_M], before[MOST_M];
	KOOP(mpc_config) c;
	wide weight; /* what all weights are multiplied by */
	int rate, guessed;
} p;

/* The same as a quadratic program, half of v' hessian v + 2 linear' v, with the last input first. */
static struct {
	size_t V;
	wide hessian[MOST_V][MOST_V], linear[MOST_V];
} dense;

/* Where Newton's method stands: the plan, which limits hold its inputs, and what is left to do. */
typedef struct {
	wide v[MOST_V], residual;
	signed char set[MOST_V];
} stage;

/* ---- The problem ------------------------------------------------------------- */

/* L L' + floor I of a random rank, times the weight */
static void random_weight(random_source *random, real *M, size_t n, double floor) {
	wide L[MOST_M][MOST_M];
	const size_t rank = random_below(random, 3) ? n : random_below(random, n + 1);
	for (size_t i = 0; i < n; i++) {
		for (size_t k = 0; k < n; k++) { L[i][k] = k < rank ? (wide)random_uniform(random, -1, 1) : 0; }
	}
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j <= i; j++) {
			wide sum = i == j ? (wide)floor : 0;
			for (size_t k = 0; k < n; k++) { sum += L[i][k] * L[j][k]; }
			M[i * n + j] = M[j * n + i] = (real)(sum * p.weight);
		}
	}
}

static void random_model(random_source *random) {
	const size_t N = p.c.n_lifted, m = p.c.n_inputs;
	const double size = (double)random_uniform(random, 0.2, 1.2) / sqrt((double)N);
	for (size_t row = 0; row < N + m; row++) {
		const double most = row < N ? size : random_below(random, 10) ? 1 : 0;
		random_fill(random, p.theta + row * KOOP_PAD(N), N, -most, most);
	}
	random_fill(random, p.psi, N, -1, 1);
	random_fill(random, p.reference, p.c.horizon * p.c.n_states, -2, 2);
}

static void random_limits(random_source *random) {
	const double box = random_uniform(random, 0.2, 2);
	for (size_t j = 0; j < p.c.n_inputs; j++) {
		p.low[j] = random_uniform(random, -box, -0.2 * box);
		p.high[j] = random_uniform(random, 0.2 * box, box);
		p.safe[j] = random_below(random, 2) ? 0 : random_below(random, 2) ? p.low[j] : p.high[j];
		p.before[j] = random_uniform(random, p.low[j], p.high[j]);
	}
}

/* All numbers of inputs and steps, one after the other. */
static void random_problem(random_source *random, size_t round) {
	memset(&p, 0, sizeof p);
	const size_t m = 1 + round % MOST_M, H = 1 + round / MOST_M % (MOST_V / m);
	const size_t N = 1 + random_below(random, MOST_N);
	p.c = (KOOP(mpc_config)){N, 1, m, H, p.Q, p.R, p.S, p.low, p.high, p.safe, 0, KOOP_MPC_NEWTON};
	p.c.n_states += random_below(random, N < MOST_n ? N : MOST_n);
	p.rate = (int)random_below(random, 2);
	if (!p.rate) { p.c.S = NULL; }
	p.weight = (wide)pow(10, (double)random_uniform(random, -6, 6));
	random_weight(random, p.Q, p.c.n_states, 0);
	random_weight(random, p.R, m, 0.1);
	random_weight(random, p.S, m, 0);
	random_model(random);
	random_limits(random);
}

/* ---- Written out ------------------------------------------------------------- */

/* What a unit of each input does, Q times that, and the states' errors without input, step by step */
static wide response[MOST_V][MOST_M][MOST_n], weighted[MOST_V][MOST_M][MOST_n], error[MOST_V][MOST_n];

/* z = A z */
static void advance(wide *z) {
	const size_t N = p.c.n_lifted;
	wide next[MOST_N];
	for (size_t i = 0; i < N; i++) {
		next[i] = 0;
		for (size_t j = 0; j < N; j++) { next[i] += (wide)p.theta[j * KOOP_PAD(N) + i] * z[j]; }
	}
	memcpy(z, next, N * sizeof *z);
}

static void follow_input(size_t j) {
	const size_t N = p.c.n_lifted, n = p.c.n_states;
	wide z[MOST_N] = {0};
	for (size_t i = 0; i < N; i++) { z[i] = p.theta[(N + j) * KOOP_PAD(N) + i]; }
	for (size_t k = 0; k < p.c.horizon; k++, advance(z)) {
		for (size_t i = 0; i < n; i++) {
			response[k][j][i] = z[i];
			weighted[k][j][i] = 0;
			for (size_t e = 0; e < n; e++) { weighted[k][j][i] += p.Q[i * n + e] * z[e]; }
		}
	}
}

static void follow_state(void) {
	wide z[MOST_N] = {0};
	for (size_t i = 0; i < p.c.n_lifted; i++) { z[i] = p.psi[i]; }
	for (size_t k = 0; k < p.c.horizon; k++) {
		advance(z);
		for (size_t i = 0; i < p.c.n_states; i++) { error[k][i] = z[i] - p.reference[k * p.c.n_states + i]; }
	}
}

/* Of input i at step k and input j at step l */
static wide hessian_element(size_t k, size_t i, size_t l, size_t j) {
	const size_t m = p.c.n_inputs, H = p.c.horizon;
	wide sum = 0;
	for (size_t s = k > l ? k : l; s < H; s++) {
		for (size_t e = 0; e < p.c.n_states; e++) { sum += weighted[s - k][i][e] * response[s - l][j][e]; }
	}
	if (k == l) { sum += p.R[i * m + j]; }
	if (k == l && p.rate) { sum += (k + 1 < H ? 2 : 1) * (wide)p.S[i * m + j]; }
	if ((k == l + 1 || l == k + 1) && p.rate) { sum -= p.S[i * m + j]; }
	return sum;
}

static wide linear_element(size_t k, size_t i) {
	const size_t m = p.c.n_inputs;
	wide sum = 0;
	for (size_t s = k; s < p.c.horizon; s++) {
		for (size_t e = 0; e < p.c.n_states; e++) { sum += weighted[s - k][i][e] * error[s][e]; }
	}
	for (size_t j = 0; k == 0 && p.rate && j < m; j++) { sum -= (wide)p.S[i * m + j] * p.before[j]; }
	return sum;
}

static void write_out(void) {
	const size_t m = p.c.n_inputs, last = p.c.horizon - 1;
	dense.V = p.c.horizon * m;
	for (size_t j = 0; j < m; j++) { follow_input(j); }
	follow_state();
	for (size_t q = 0; q < dense.V; q++) {
		dense.linear[q] = linear_element(last - q / m, q % m);
		for (size_t r = 0; r < dense.V; r++) {
			dense.hessian[q][r] = hessian_element(last - q / m, q % m, last - r / m, r % m);
		}
	}
}

static wide slope(const wide *v, size_t q) {
	wide sum = dense.linear[q];
	for (size_t r = 0; r < dense.V; r++) { sum += dense.hessian[q][r] * v[r]; }
	return sum;
}

/* Less what is the same for all plans, for weights of 1. */
static wide cost(const wide *v) {
	wide sum = 0;
	for (size_t q = 0; q < dense.V; q++) { sum += v[q] * (slope(v, q) + dense.linear[q]) / p.weight; }
	return sum;
}

static wide clipped(wide v, size_t q) {
	const wide low = p.low[q % p.c.n_inputs], high = p.high[q % p.c.n_inputs];
	return v < low ? low : v > high ? high : v;
}

/* What the header calls the residual. */
static wide residual_of(const wide *v) {
	wide most = 0;
	for (size_t q = 0; q < dense.V; q++) {
		most = fmax(most, fabs(clipped(v[q] - slope(v, q) / dense.hessian[q][q], q) - v[q]));
	}
	return most;
}

/* ---- Newton's method, slowly ---------------------------------------------------- */

/* Where the slope of input q vanishes once the free ones that come later, which stand before it, have done
 * their best. */
static wide best_input(const stage *s, size_t q) {
	static wide M[MOST_V * MOST_V], step[MOST_V];
	size_t free[MOST_V], count = 0;
	for (size_t r = 0; r <= q; r++) {
		if (s->set[r] == FREE) { free[count++] = r; }
	}
	for (size_t a = 0; a < count; a++) {
		step[a] = -slope(s->v, free[a]);
		for (size_t b = 0; b < count; b++) { M[a * count + b] = dense.hessian[free[a]][free[b]]; }
	}
	solve_positive_definite(M, count, step, 1);
	return s->v[q] + step[count - 1];
}

/* The inputs one after the other, the first step first; one that meets its limit stays there. Returns whether
 * round-off cannot matter for which of them do. */
static int step_slowly(stage *s) {
	int clear = 1;
	for (size_t q = dense.V; q-- > 0;) {
		if (s->set[q] != FREE) { continue; }
		const wide to = best_input(s, q), low = p.low[q % p.c.n_inputs], high = p.high[q % p.c.n_inputs];
		clear = clear && fabs(to - low) > 0.01 && fabs(to - high) > 0.01;
		s->v[q] = clipped(to, q);
	}
	s->residual = residual_of(s->v);
	return clear;
}

/* At a limit and pressed against it: held. Returns whether round-off cannot matter for it. */
static int hold(stage *s) {
	int clear = 1;
	for (size_t q = 0; q < dense.V; q++) {
		const size_t j = q % p.c.n_inputs;
		const wide down = -slope(s->v, q) / dense.hessian[q][q];
		const int upper = s->v[q] >= p.high[j], lower = s->v[q] <= p.low[j];
		if (upper || lower) { clear &= fabs(down) > 0.01; }
		s->set[q] = (signed char)((upper && down > 0) - (lower && down < 0));
	}
	return clear;
}

/* From where the library starts; returns after how many steps, at most, a tolerance makes it end: that the
 * residual falls to, but not before. 0: none. */
static size_t follow_slowly(stage *s, size_t wanted, wide *tolerance) {
	wide least = residual_of(s->v);
	for (size_t k = 1; k <= wanted; k++) {
		const wide before = cost(s->v);
		if (k > 1 || !p.guessed) {
			if (!hold(s)) { return 0; }
		}
		if (!step_slowly(s) || !(cost(s->v) < before - (wide)1e-3)) { return 0; }
		*tolerance = sqrt(least * fmax(s->residual, least / 16));
		const int lower = s->residual < least * (wide)0.8 && least > (wide)0.01;
		if (lower && (k == wanted || s->residual < (wide)0.01)) { return k; }
		least = fmin(least, s->residual);
	}
	return 0;
}

/* ---- Side by side ------------------------------------------------------------------ */

/* The plan of a solve before and what held it, which this one starts from, one step on. */
static void random_guess(random_source *random, stage *s) {
	const size_t m = p.c.n_inputs, V = p.c.horizon * m, part = random_below(random, 4);
	const size_t from = random_below(random, 2) * random_below(random, V);
	for (size_t q = 0; q < V; q++) {
		const int held = q >= from && random_below(random, 3) < part, upper = (int)random_below(random, 2);
		mpc.set[q] = (signed char)(held ? 2 * upper - 1 : FREE);
		mpc.plan[q] = random_uniform(random, p.low[q % m] / 2, p.high[q % m] / 2);
		if (held) { mpc.plan[q] = upper ? p.high[q % m] : p.low[q % m]; }
	}
	mpc.planned = 1;
	for (size_t q = 0; q < V; q++) {
		s->v[q] = mpc.plan[q < m ? q : q - m];
		s->set[q] = mpc.set[q < m ? q : q - m];
	}
}

static void start(random_source *random, stage *s) {
	memset(s, 0, sizeof *s);
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.c, storage, sizeof storage / sizeof *storage));
	for (size_t q = 0; q < dense.V; q++) { s->v[q] = p.safe[q % p.c.n_inputs]; }
	p.guessed = (int)random_below(random, 4) > 0;
	if (p.guessed) { random_guess(random, s); }
}

/* Column q of row k of the factor, whose diagonal is kept inverted; 0 is a row that was dropped. */
static wide factor_element(size_t k, size_t q) {
	const wide x = mpc.factor[k * mpc.n_free - k * (k + 1) / 2 + q];
	return k < q ? x : fabs(x) > 0 ? 1 / x : 0;
}

static int was_dropped(size_t k) {
	return !(fabs(factor_element(k, k)) > 0);
}

/* Its square is the Hessian over the free inputs. */
static void check_factor(const stage *s, size_t round) {
	size_t row[MOST_V], of[MOST_V], rows = 0, count = 0;
	for (size_t q = 0; q < dense.V; q++) {
		CHECK((s->set[q] == FREE) == (mpc.set[q] == FREE), "round %zu: input %zu: %d", round, q, mpc.set[q]);
		if (s->set[q] == FREE) {
			row[count] = rows;
			of[count++] = q;
		}
		CHECK(mpc.set[q] % 2 || was_dropped(rows) == (mpc.set[q] != FREE), "round %zu: row %zu", round, rows);
		rows += mpc.set[q] % 2 == 0;
	}
	TEST_ASSERT_TRUE(rows == mpc.n_free);
	for (size_t a = 0; a < count; a++) {
		for (size_t b = a; b < count; b++) {
			wide sum = 0;
			for (size_t k = 0; k <= row[a]; k++) {
				if (!was_dropped(k)) { sum += factor_element(k, row[a]) * factor_element(k, row[b]); }
			}
			const wide right = dense.hessian[of[a]][of[b]];
			const wide size = sqrt(dense.hessian[of[a]][of[a]] * dense.hessian[of[b]][of[b]]);
			CHECK(fabs(sum - right) <= 40 * REAL_EPSILON * size, "round %zu: (%zu, %zu) %g, not %g", round,
			      of[a], of[b], (double)sum, (double)right);
		}
	}
}

/* What inputs do, what would come without them, and the Hessian's diagonal. */
static void check_condensed(size_t round) {
	const size_t n = p.c.n_states, m = p.c.n_inputs, H = p.c.horizon;
	for (size_t k = 0; k < H; k++) {
		real G[MOST_n * MOST_M];
		CHECK_STATUS(KOOP_OK, KOOP(mpc_sensitivity)(&mpc, k, G));
		for (size_t i = 0; i < n * m; i++) {
			const wide off = fabs(G[i] - response[k][i % m][i / m]);
			CHECK(off <= 40 * REAL_EPSILON, "round %zu: sensitivity %zu is off by %g", round, k, (double)off);
		}
		for (size_t i = 0; i < n; i++) {
			const wide off = fabs(mpc.free_error[i * KOOP_MPC_PAD(H) + H - 1 - k] - error[k][i]);
			CHECK(off <= 40 * REAL_EPSILON, "round %zu: error %zu is off by %g", round, k, (double)off);
		}
	}
	for (size_t q = 0; q < dense.V; q++) {
		const wide off = fabs(mpc.inverse[q] * dense.hessian[q][q] - 1);
		CHECK(off <= 40 * REAL_EPSILON, "round %zu: diagonal %zu is off by %g", round, q, (double)off);
	}
}

/* Returns whether there was anything to see. */
static int check_problem(random_source *random, size_t round) {
	stage s;
	wide tolerance;
	real u[MOST_M];
	KOOP(mpc_result) result;
	random_problem(random, round);
	write_out();
	start(random, &s);
	const size_t steps = follow_slowly(&s, 1 + random_below(random, STEPS), &tolerance);
	if (steps == 0) { return 0; }
	mpc.config.tolerance = (real)tolerance;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, &result));
	CHECK(result.iterations == steps, "round %zu: %zu steps, not %zu", round, result.iterations, steps);
	TEST_ASSERT_TRUE(mpc.factored && mpc.fresh);
	for (size_t q = 0; q < dense.V; q++) {
		CHECK(fabs(mpc.plan[q] - s.v[q]) <= 2000 * REAL_EPSILON, "round %zu: u[%zu] %g, not %g", round, q,
		      (double)mpc.plan[q], (double)s.v[q]);
	}
	CHECK(fabs(result.residual - s.residual) <= 2000 * REAL_EPSILON, "round %zu: residual %g, not %g", round,
	      (double)result.residual, (double)s.residual);
	check_condensed(round);
	check_factor(&s, round);
	return 1;
}

static void test_each_step_and_its_factor_are_those_of_the_hessian_written_out(void) {
	random_source random = random_seed(71);
	const size_t rounds = 1500 / TEST_SHARE;
	size_t seen = 0;
	for (size_t round = 0; round < rounds; round++) { seen += (size_t)check_problem(&random, round); }
	printf("%zu of %zu problems\n", seen, rounds);
	TEST_ASSERT_TRUE(seen > rounds / 4);
}

/* The least cost that has a finite inverse, and half of it, which some processors take for 0. */
static void test_least_cost_of_an_input(void) {
	static const real theta[2 * 4] = {1}, psi[1] = {0}, reference[1] = {0}, Q[1] = {1};
	static const real low[1] = {-1}, high[1] = {1}, safe[1] = {0};
	for (int below = 0; below < 2; below++) {
		const real R[1] = {below ? REAL_MIN / 2 : REAL_MIN};
		const KOOP(mpc_config) config = {1, 1, 1, 1, Q, R, NULL, low, high, safe, 0, KOOP_MPC_NEWTON};
		real u[1];
		int status = KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage);
		if (status == KOOP_OK) { status = KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL); }
		CHECK((status == KOOP_OK) == !below, "status %d", status);
	}
}

/* A step leads to the optimum, the next takes away what round-off has left of it, and there is no third. */
static void test_two_steps_are_enough_where_no_limit_holds(void) {
	random_source random = random_seed(72);
	for (size_t round = 0; round < 150 / TEST_SHARE; round++) {
		real u[MOST_M];
		KOOP(mpc_result) result;
		random_problem(&random, round);
		for (size_t j = 0; j < p.c.n_inputs; j++) {
			p.low[j] = -100;
			p.high[j] = 100;
			p.safe[j] = 1;
		}
		p.c.tolerance = REAL_MIN;
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.c, storage, sizeof storage / sizeof *storage));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.before, u, &result));
		CHECK(result.iterations <= 2, "round %zu: %zu steps", round, result.iterations);
		CHECK(result.residual <= 2000 * REAL_EPSILON, "round %zu: %g", round, (double)result.residual);
	}
}

enum { INPUTS = 6 };

/* One step of a robot that only the input `held` pushes, to where it meets its limit; 6: none does. */
static int solve_singular(size_t held, size_t idle, const real *safe, real *u) {
	static const real psi[1] = {0}, reference[1] = {10}, Q[1] = {1};
	static const real low[INPUTS] = {-1, -1, -1, -1, -1, -1}, high[INPUTS] = {1, 1, 1, 1, 1, 1};
	real theta[(1 + INPUTS) * 4] = {0}, R[INPUTS * INPUTS] = {0};
	const KOOP(mpc_config) config = {1, 1, INPUTS, 1, Q, R, NULL, low, high, safe, 0, KOOP_MPC_NEWTON};
	for (size_t j = 0; j < INPUTS; j++) { R[j * (INPUTS + 1)] = j == idle ? REAL_EPSILON : 1; }
	if (held < INPUTS) { theta[(1 + held) * 4] = 1; }
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	return KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL);
}

/* One that does nothing and costs less than a rounding of what others do: the Hessian is singular in this
 * precision. Where all are free that shows in a leading block, else in one of the groups behind. */
static void test_input_that_neither_does_nor_costs_anything_makes_the_hessian_singular(void) {
	for (size_t k = 0; k < (INPUTS + 1) * INPUTS; k++) {
		const size_t held = k / INPUTS, idle = k % INPUTS;
		real u[INPUTS], safe[INPUTS] = {0};
		if (held == idle) { continue; }
		safe[idle] = (real)0.5;
		if (held < INPUTS) { safe[held] = 1; }
		CHECK_STATUS(KOOP_E_INDEFINITE, solve_singular(held, idle, safe, u));
		TEST_ASSERT_EQUAL_MEMORY(safe, u, sizeof u);
	}
}

/* Three inputs do the same, and the first is held. What the third costs is all that makes the Hessian over
 * the others definite: 1, 1, 1 and 1 + cost. */
static int solve_alike(real cost, real *u) {
	static const real theta[4 * 4] = {0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
	static const real psi[1] = {0}, reference[1] = {10}, Q[1] = {1};
	static const real low[3] = {-1, -1, -1}, high[3] = {1, 1, 1}, safe[3] = {1, 0, 0};
	const real R[9] = {REAL_EPSILON, 0, 0, 0, REAL_EPSILON / 8, 0, 0, 0, cost};
	const KOOP(mpc_config) config = {1, 1, 3, 1, Q, R, NULL, low, high, safe, 0, KOOP_MPC_NEWTON};
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, sizeof storage / sizeof *storage));
	return KOOP(mpc_solve)(&mpc, theta, psi, reference, NULL, u, NULL);
}

static void test_hessian_that_is_definite_by_a_rounding_is_refused(void) {
	real u[3];
	CHECK_STATUS(KOOP_E_INDEFINITE, solve_alike(REAL_EPSILON, u));
	CHECK_STATUS(KOOP_OK, solve_alike(4 * REAL_EPSILON, u));
	for (size_t j = 0; j < 3; j++) { TEST_ASSERT_TRUE(u[j] >= 1 && u[j] <= 1); }
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_least_cost_of_an_input);
	RUN_TEST(test_two_steps_are_enough_where_no_limit_holds);
	RUN_TEST(test_input_that_neither_does_nor_costs_anything_makes_the_hessian_singular);
	RUN_TEST(test_hessian_that_is_definite_by_a_rounding_is_refused);
	RUN_TEST(test_each_step_and_its_factor_are_those_of_the_hessian_written_out);
	return UNITY_END();
}
