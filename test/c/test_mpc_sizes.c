/* The controller with few and many lifted states, tracked states, inputs and steps: it plans what is best,
 * and writes nothing behind the storage that it asks for. */
#include "support.h"

enum { MOST_N = 14, MOST_M = 4, MOST_H = 9, FENCE = 40 };
#define MARK ((real)0.123456789)

static real storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_N, MOST_M, MOST_H) +
                    KOOP_MPC_REALS_RATE(MOST_M, MOST_H) + FENCE];
static KOOP(mpc) mpc;

/* One random problem, and how much storage it takes. */
static struct {
	real theta[(MOST_N + MOST_M) * KOOP_PAD(MOST_N)], psi[MOST_N], reference[MOST_H * MOST_N];
	real Q[MOST_N * MOST_N], R[MOST_M * MOST_M], safe[MOST_M], low[MOST_M], high[MOST_M];
	KOOP(mpc_config) c;
	size_t reals;
} p;

static void set_settings(int method, int rate) {
	KOOP(mpc_config) *c = &p.c;
	c->Q = p.Q;
	c->R = p.R;
	c->S = rate ? p.R : NULL;
	c->u_min = p.low;
	c->u_max = p.high;
	c->u_safe = p.safe;
	c->method = method;
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs, H = c->horizon;
	p.reals =
	    method == KOOP_MPC_NEWTON ? KOOP_MPC_REALS_NEWTON(N, n, m, H) : KOOP_MPC_REALS_GRADIENT(N, n, m, H);
	if (rate) { p.reals += KOOP_MPC_REALS_RATE(m, H); }
}

/* In half of them the horizon is short against N, in the others it is the other way round. */
static void random_problem(random_source *random, size_t round) {
	memset(&p, 0, sizeof p);
	p.c.n_lifted = 1 + random_below(random, round % 2 ? MOST_N : 3);
	p.c.n_states = 1 + random_below(random, p.c.n_lifted);
	p.c.n_inputs = 1 + random_below(random, MOST_M);
	p.c.horizon = 1 + random_below(random, round % 2 ? 3 : MOST_H);
	set_settings((int)(round / 2 % 2), (int)(round / 4 % 2));
	const size_t N = p.c.n_lifted, n = p.c.n_states, m = p.c.n_inputs;
	for (size_t i = 0; i < n; i++) { p.Q[i * (n + 1)] = random_uniform(random, 0.5, 2); }
	for (size_t j = 0; j < m; j++) {
		p.R[j * (m + 1)] = random_uniform(random, 0.5, 2);
		p.high[j] = random_uniform(random, 0.1, round % 3 ? 2 : 0.2);
		p.low[j] = -p.high[j];
	}
	for (size_t row = 0; row < N + m; row++) {
		random_fill(random, p.theta + row * KOOP_PAD(N), N, -0.5, 0.5);
	}
	random_fill(random, p.psi, N, -1, 1);
	random_fill(random, p.reference, p.c.horizon * n, -1, 1);
}

/* z = A z + B u */
static void advance(wide *z, const wide *u) {
	const size_t N = p.c.n_lifted, rows = KOOP_PAD(N);
	wide next[MOST_N];
	for (size_t i = 0; i < N; i++) {
		next[i] = 0;
		for (size_t j = 0; j < N; j++) { next[i] += (wide)p.theta[j * rows + i] * z[j]; }
		for (size_t j = 0; j < p.c.n_inputs; j++) { next[i] += (wide)p.theta[(N + j) * rows + i] * u[j]; }
	}
	memcpy(z, next, sizeof next);
}

/* What the header says is minimised; Q and R are diagonal, S is R. */
static wide cost(const wide *u) {
	const size_t n = p.c.n_states, m = p.c.n_inputs;
	wide z[MOST_N] = {0}, sum = 0;
	for (size_t i = 0; i < p.c.n_lifted; i++) { z[i] = p.psi[i]; }
	for (size_t k = 0; k < p.c.horizon; k++) {
		advance(z, u + k * m);
		for (size_t i = 0; i < n; i++) {
			const wide error = z[i] - p.reference[k * n + i];
			sum += p.Q[i * (n + 1)] * error * error;
		}
		for (size_t j = 0; j < m; j++) {
			const wide now = u[k * m + j], before = k > 0 ? u[(k - 1) * m + j] : 0;
			sum += p.R[j * (m + 1)] * (now * now + (p.c.S ? (now - before) * (now - before) : 0));
		}
	}
	return sum;
}

/* No input a thousandth more or less, in the box, is better. */
static void check_best(size_t round) {
	real plan[MOST_H * MOST_M];
	wide u[MOST_H * MOST_M] = {0};
	const size_t V = p.c.horizon * p.c.n_inputs;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&mpc, plan));
	for (size_t q = 0; q < V; q++) { u[q] = plan[q]; }
	const wide best = cost(u);
	for (size_t q = 0; q < 2 * V; q++) {
		const wide other = u[q / 2] + (wide)(q % 2 ? 1e-3 : -1e-3);
		if (other < p.low[q / 2 % p.c.n_inputs] || other > p.high[q / 2 % p.c.n_inputs]) { continue; }
		const wide kept = u[q / 2];
		u[q / 2] = other;
		CHECK(cost(u) >= best, "round %zu: u[%zu] = %g is better than %g", round, q / 2, (double)other,
		      (double)kept);
		u[q / 2] = kept;
	}
}

static void test_plans_what_is_best_in_exact_storage(void) {
	random_source random = random_seed(52);
	for (size_t round = 0; round < 300; round++) {
		real u[MOST_M];
		random_problem(&random, round);
		for (size_t i = 0; i < FENCE; i++) { storage[p.reals + i] = MARK; }
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.c, storage, p.reals));
		for (int k = 0; k < 3; k++) {
			CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, p.theta, p.psi, p.reference, p.safe, u, NULL));
			check_best(round);
			random_fill(&random, p.psi, p.c.n_lifted, -1, 1);
		}
		for (size_t i = 0; i < FENCE; i++) {
			CHECK(storage[p.reals + i] == MARK, "round %zu: %zu behind the end", round, i);
		}
	}
}

/* ---- Where everything is --------------------------------------------------------- */

/* One array of the controller: it begins where the one before has ended, or later. */
static const real *check_array(const real *array, const real *free_from, size_t length, size_t round) {
	CHECK(array >= free_from, "round %zu: begins %ld before", round, (long)(free_from - array));
	return array + length;
}

/* All of them, as long as the header says they are; returns where the last ends. */
static const real *check_arrays(size_t round) {
	const size_t N = p.c.n_lifted, n = p.c.n_states, m = p.c.n_inputs, H = p.c.horizon, V = H * m;
	const size_t states = n * KOOP_MPC_PAD(H), inputs = KOOP_MPC_PAD(V);
	const real *const of_inputs[] = {mpc.inverse, mpc.plan,           mpc.gradient,
	                                 mpc.trial,   mpc.trial_gradient, mpc.step};
	const real *const of_one[] = {mpc.u_before, mpc.u_min, mpc.u_max, mpc.u_safe};
	const real *end = check_array(mpc.markov, storage, n * V, round);
	end = check_array(mpc.free_error, end, states, round);
	end = check_array(mpc.state, end, states, round);
	for (size_t i = 0; i < 6; i++) { end = check_array(of_inputs[i], end, inputs, round); }
	TEST_ASSERT_TRUE((const signed char *)end <= mpc.set && mpc.set + V <= (const signed char *)mpc.u_before);
	for (size_t i = 0; i < 4; i++) { end = check_array(of_one[i], end, m, round); }
	end = check_array(mpc.roots, end, 2 * m * m + n * n, round);
	end = check_array(mpc.work, end, KOOP_MPC_WORK(N, n, m, H), round);
	if (p.c.method == KOOP_MPC_GRADIENT) { return end; }
	end = check_array(mpc.square, end, 4 * 4 + 4, round);
	end = check_array(mpc.generator, end, (n + (p.c.S ? 2 : 1) * m) * inputs + KOOP_MPC_WINDOW, round);
	return check_array(mpc.factor, end, V * (V + 1) / 2 + 4, round); /* the last four are read in vain */
}

static void test_arrays_are_apart_and_inside_the_storage(void) {
	random_source random = random_seed(53);
	for (size_t round = 0; round < 300; round++) {
		random_problem(&random, round);
		CHECK_STATUS(KOOP_E_STORAGE, KOOP(mpc_init)(&mpc, &p.c, storage, p.reals - 1));
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &p.c, storage, p.reals));
		TEST_ASSERT_TRUE(check_arrays(round) <= storage + p.reals);
		TEST_ASSERT_TRUE(mpc.direction == mpc.trial && mpc.hessian_direction == mpc.trial_gradient);
		const int newton = p.c.method == KOOP_MPC_NEWTON;
		TEST_ASSERT_TRUE(newton || (!mpc.square && !mpc.generator && !mpc.factor));
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_plans_what_is_best_in_exact_storage);
	RUN_TEST(test_arrays_are_apart_and_inside_the_storage);
	return UNITY_END();
}
