/* The controller writes nothing behind the storage that it asks for. */
#include "support.h"

enum { MOST_N = 14, MOST_M = 4, MOST_H = 9, FENCE = 40 };
#define MARK ((real)0.123456789)

static real storage[KOOP_MPC_REALS_NEWTON(MOST_N, MOST_N, MOST_M, MOST_H) +
                    KOOP_MPC_REALS_RATE(MOST_M, MOST_H) + FENCE];
static KOOP(mpc) mpc;

static void check_fence(const real *fence, const KOOP(mpc_config) *c) {
	for (size_t i = 0; i < FENCE; i++) {
		CHECK(fence[i] == MARK, "method %d, N %zu, n %zu, m %zu, H %zu: %zu behind the end", c->method,
		      c->n_lifted, c->n_states, c->n_inputs, c->horizon, i);
	}
}

/* Half of the problems have a horizon that is short against N, the others the other way round. */
static void test_exact_storage_suffices(void) {
	random_source random = random_seed(52);
	static real Q[MOST_N * MOST_N], R[MOST_M * MOST_M], safe[MOST_M], low[MOST_M], high[MOST_M];
	for (size_t round = 0; round < 200; round++) {
		const size_t N = 1 + random_below(&random, round % 2 ? MOST_N : 3),
		             m = 1 + random_below(&random, MOST_M),
		             H = 1 + random_below(&random, round % 2 ? 3 : MOST_H), n = 1 + random_below(&random, N);
		real theta[(MOST_N + MOST_M) * KOOP_PAD(MOST_N)] = {0}, psi[MOST_N], reference[MOST_H * MOST_N],
		                               u[MOST_M];
		const int method = (int)(round / 2 % 2), rate = (int)(round / 4 % 2);
		const size_t reals = (method == KOOP_MPC_NEWTON ? KOOP_MPC_REALS_NEWTON(N, n, m, H)
		                                                : KOOP_MPC_REALS_GRADIENT(N, n, m, H)) +
		                     (rate ? KOOP_MPC_REALS_RATE(m, H) : 0);
		for (size_t i = 0; i < n * n; i++) { Q[i] = i % (n + 1) == 0; }
		for (size_t j = 0; j < m * m; j++) { R[j] = j % (m + 1) == 0; }
		for (size_t j = 0; j < m; j++) {
			low[j] = (real)-0.1;
			high[j] = (real)0.1;
		}
		for (size_t row = 0; row < N + m; row++) {
			random_fill(&random, theta + row * KOOP_PAD(N), N, -0.5, 0.5);
		}
		random_fill(&random, psi, N, -1, 1);
		random_fill(&random, reference, H * n, -1, 1);
		const KOOP(mpc_config) config = {N, n, m, H, Q, R, rate ? R : NULL, low, high, safe, 0, method};
		for (size_t i = 0; i < FENCE; i++) { storage[reals + i] = MARK; }
		CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, storage, reals));
		for (int k = 0; k < 3; k++) {
			CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&mpc, theta, psi, reference, safe, u, NULL));
			random_fill(&random, psi, N, -1, 1);
		}
		check_fence(storage + reals, &config);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_exact_storage_suffices);
	return UNITY_END();
}
