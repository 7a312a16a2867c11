/* The weights and their roots, which are taken anew at each solve with Newton's method, and what round-off
 * leaves of a plan. */
#include "problem.h"

enum { SIZE = 4, STEPS = 2 };

static KOOP(mpc) mpc;
static real
    storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_m, MOST_H) + KOOP_MPC_REALS_RATE(MOST_m, MOST_H)];
static const size_t reals = sizeof storage / sizeof *storage;

/* States and inputs are as many, one state for each input; their weights may all be of any rank. */
static struct {
	real theta[2 * SIZE * KOOP_PAD(SIZE)], psi[SIZE], reference[STEPS * SIZE], before[SIZE];
	real Q[SIZE * SIZE], R[SIZE * SIZE], S[SIZE * SIZE], low[SIZE], high[SIZE], safe[SIZE];
	KOOP(mpc_config) config;
} w;

static void unit_matrix(real *M, size_t n, real size) {
	for (size_t i = 0; i < n * n; i++) { M[i] = i % (n + 1) ? 0 : size; }
}

static void begin(size_t n) {
	memset(&w, 0, sizeof w);
	for (size_t i = 0; i < n; i++) {
		w.theta[i * KOOP_PAD(n) + i] = w.theta[(n + i) * KOOP_PAD(n) + i] = 1;
		w.low[i] = -1;
		w.high[i] = w.psi[i] = 1;
	}
	unit_matrix(w.Q, n, 1);
	unit_matrix(w.R, n, 1);
	w.config = (KOOP(mpc_config)){n,   n,     n,      STEPS,  w.Q, w.R,
	                              w.S, w.low, w.high, w.safe, 0,   KOOP_MPC_NEWTON};
}

static KOOP(mpc_result) result;

static int solve(void) {
	real u[SIZE];
	return KOOP(mpc_solve)(&mpc, w.theta, w.psi, w.reference, w.before, u, &result);
}

/* M = G G' for a random G of n x rank, so that rounding makes it hardly indefinite. */
static void random_of_rank(random_source *random, real *M, size_t n, size_t rank) {
	real G[SIZE * SIZE];
	random_fill(random, G, n * rank, -1, 1);
	for (size_t i = 0; i < n * n; i++) {
		wide sum = 0;
		for (size_t k = 0; k < rank; k++) { sum += (wide)G[i / n * rank + k] * G[i % n * rank + k]; }
		M[i] = (real)sum;
	}
}

/* L L' = M, as far as a semidefinite M has a root. */
static void check_root(const real *L, const real *M, size_t n, size_t rank, const char *name) {
	wide largest = 0;
	for (size_t i = 0; i < n; i++) { largest = fmax(largest, M[i * n + i]); }
	for (size_t i = 0; i < n * n; i++) {
		wide left = M[i];
		for (size_t k = 0; k < n; k++) { left -= (wide)L[i / n * n + k] * L[i % n * n + k]; }
		CHECK(fabs(left) <= 64 * REAL_EPSILON * largest, "%s, %zu x %zu of rank %zu: element %zu by %g", name,
		      n, n, rank, i, (double)left);
	}
}

static void check_roots(size_t n, size_t rank) {
	check_root(mpc.roots, w.R, n, n, "R");
	check_root(mpc.roots + n * n, w.S, n, n - rank, "S");
	check_root(mpc.roots + 2 * n * n, w.Q, n, rank, "Q");
}

static void test_roots_are_those_of_the_weights_as_they_are_now(void) {
	random_source random = random_seed(91);
	for (size_t round = 0; round < 200; round++) {
		const size_t n = 1 + round % SIZE;
		begin(n);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
		for (int k = 0; k < 4; k++) {
			const size_t rank = random_below(&random, n + 1);
			random_of_rank(&random, w.Q, n, rank);
			random_of_rank(&random, w.S, n, n - rank);
			random_of_rank(&random, w.R, n, n);
			for (size_t i = 0; i < n; i++) { w.R[i * (n + 1)] += 1; }
			random_fill(&random, w.psi, n, -9, 9);
			CHECK_STATUS(KOOP_OK, solve());
			if (result.iterations > 0) { check_roots(n, rank); }
			CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
			check_roots(n, rank);
		}
	}
}

/* What is left of a diagonal element is a pivot from 8 roundings of the largest on, wherever that stands. */
static void test_what_is_below_round_off_has_no_root(void) {
	for (size_t large = 0; large < 3; large++) {
		begin(3);
		const size_t small = (large + 1) % 3, smaller = (large + 2) % 3;
		w.Q[4 * large] = 2;
		w.Q[4 * small] = 17 * REAL_EPSILON;
		w.Q[4 * smaller] = 15 * REAL_EPSILON;
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
		const real *root = mpc.roots + 18;
		for (size_t i = 0; i < 9; i++) {
			const size_t row = i / 3, column = row == large ? 0 : row == small ? 1 : 2;
			const real expected = column < 2 && i % 3 == column ? w.Q[4 * row] : 0;
			CHECK(fabs((double)(root[i] * root[i] - expected)) <= 1e-6 * (double)expected, "%zu: %g", i,
			      (double)root[i]);
		}
	}
}

/* Weights are semidefinite up to half of a number's digits of their largest diagonal element: in each element
 * by a thousandth less, and by one more. */
static void check_allowance(real *M, size_t i, int status_beyond) {
	const real kept = M[i], allowed = 2 * (real)sqrt((double)REAL_EPSILON);
	M[i] = kept - allowed * (real)0.999;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
	M[i] = kept - allowed * (real)1.001;
	CHECK_STATUS(status_beyond, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
	M[i] = kept + allowed * (real)1.001;
	CHECK_STATUS(i % 4 ? status_beyond : KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
	M[i] = kept;
}

static void test_weights_may_be_indefinite_or_asymmetric_by_round_off_alone(void) {
	begin(3);
	for (size_t i = 0; i < 3; i++) { w.Q[4 * i] = i == 1 ? 2 : 0; }
	memcpy(w.S, w.Q, 9 * sizeof *w.S);
	for (size_t i = 0; i < 9; i++) {
		if (i == 4) { continue; } /* the largest itself */
		check_allowance(w.Q, i, KOOP_E_RANGE);
		check_allowance(w.S, i, KOOP_E_RANGE);
	}
}

/* Where there is nothing to weigh, the root of what was weighed before must not stay. */
static void test_weights_may_become_nothing(void) {
	for (size_t n = 1; n <= SIZE; n++) {
		begin(n);
		unit_matrix(w.S, n, 2);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
		memset(w.S, 0, sizeof w.S);
		CHECK_STATUS(KOOP_OK, solve());
		memset(w.Q, 0, sizeof w.Q);
		w.psi[0] = 2;
		CHECK_STATUS(KOOP_OK, solve());
		unit_matrix(w.Q, n, 1);
		memset(w.R, 0, sizeof w.R); /* the states count enough */
		w.psi[0] = 3;
		CHECK_STATUS(KOOP_OK, solve());
		TEST_ASSERT_TRUE(result.iterations > 0);
		check_root(mpc.roots, w.R, n, 0, "R");
		check_root(mpc.roots + n * n, w.S, n, 0, "S");
		check_root(mpc.roots + 2 * n * n, w.Q, n, n, "Q");
	}
}

/* The gradient method needs no roots: what becomes of the weights is then not looked at, and those of the
 * start stay. */
static void test_weights_of_any_kind_after_the_start_with_the_gradient(void) {
	begin(2);
	w.config.method = KOOP_MPC_GRADIENT;
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &w.config, storage, reals));
	w.Q[1] = w.Q[2] = (real)1.5;
	CHECK_STATUS(KOOP_OK, solve());
	check_root(mpc.roots, w.R, 2, 2, "R");
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_roots_are_those_of_the_weights_as_they_are_now);
	RUN_TEST(test_what_is_below_round_off_has_no_root);
	RUN_TEST(test_weights_may_be_indefinite_or_asymmetric_by_round_off_alone);
	RUN_TEST(test_weights_may_become_nothing);
	RUN_TEST(test_weights_of_any_kind_after_the_start_with_the_gradient);
	return UNITY_END();
}
