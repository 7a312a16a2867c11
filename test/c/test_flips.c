/* Bits that flip between two calls: what the checksums mend, and what they must not take for a flip. */
#include "tinykoop_guard.h" /* first: it leaves KOOP undefined */

#include "support.h"

#include <stddef.h>

enum { N = 4, M = 2, D = N + M, HORIZON = 5, BITS = 8 * sizeof(koop_checksum) };

static estimator e;
static random_source random;

static void draw(real *zeta, real *psi_next) {
	random_fill(&random, zeta, D, -1, 1);
	for (int i = 0; i < N; i++) { psi_next[i] = zeta[i + 1] / 2 - zeta[i]; }
}

static int learn_one(estimator *of) {
	real zeta[D], psi_next[N];
	draw(zeta, psi_next);
	return estimator_update(of, zeta, psi_next, NULL);
}

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form) {
	random = random_seed(71);
	estimator_settings(&e, N, M, regulator, form);
	e.config.checksum = 1;
	estimator_start(&e);
	for (int k = 0; k < 20; k++) { CHECK_STATUS(KOOP_OK, learn_one(&e)); }
}

static void flip(void *at, size_t bit) {
	((unsigned char *)at)[bit / 8] ^= (unsigned char)(1u << bit % 8);
}

/* Flips each bit of some bytes; each is to be found, mended and counted. */
static void check_mended(void *at, size_t bytes) {
	static estimator before;
	for (size_t bit = 0; bit < 8 * bytes; bit++) {
		before = e;
		flip(at, bit);
		CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
		TEST_ASSERT_EQUAL_size_t(before.rls.mended + 1, e.rls.mended);
		e.rls.mended = before.rls.mended;
		CHECK(memcmp(&before, &e, sizeof e) == 0, "%s, bit %lu", estimator_name(&e), (unsigned long)bit);
	}
}

static void test_any_bit_of_what_was_learned_is_mended(void) {
	const size_t from = offsetof(KOOP(rls), covariance_scale);
	const size_t numbers = offsetof(KOOP(rls), positive_definite) - from;
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			start(all_regulators[r], all_forms[f]);
			check_mended(e.rls.theta, (size_t)(e.rls.zeta - e.rls.theta) * sizeof(real));
			check_mended((unsigned char *)&e.rls + from, numbers / sizeof(real) * sizeof(real));
		}
	}
}

static void test_any_bit_of_the_checksum_itself_is_mended(void) {
	for (int f = 0; f < FORMS; f++) {
		start(&KOOP(reg_ef), all_forms[f]);
		check_mended(&e.rls.sum, sizeof e.rls.sum);
		CHECK_STATUS(KOOP_OK, learn_one(&e));
	}
}

/* Here of the sums, so that no flipped bit of a word accounts for both. */
static void test_two_flipped_bits_are_reported(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	flip(&e.rls.sum.words, 5);
	flip(&e.rls.sum.places, 3);
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(rls_check)(&e.rls));
	flip(&e.rls.sum.places, 3);
	flip(&e.rls.sum.words, 4);
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(rls_check)(&e.rls));
}

/* The check that factors P works in storage that the checksum covers. Without excitation the plain form's P
 * is used up, and sample after sample is refused. */
static void test_a_refusal_is_not_taken_for_a_flip(void) {
	static estimator twin;
	int refused = 0;
	start(&KOOP(reg_ef), &KOOP(form_plain));
	estimator_default(&twin, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	random = random_seed(71);
	for (int k = 0; k < 20; k++) { CHECK_STATUS(KOOP_OK, learn_one(&twin)); }
	for (int k = 0; k < 2000; k++) {
		const real zeta[D] = {1, (real)0.5, (real)-0.25}, psi_next[N] = {1, 1};
		const int status = estimator_update(&twin, zeta, psi_next, NULL);
		CHECK_STATUS(status, estimator_update(&e, zeta, psi_next, NULL));
		refused += status == KOOP_E_INDEFINITE;
	}
	CHECK(refused > 10, "%d refused", refused);
	TEST_ASSERT_EQUAL_size_t(0, e.rls.mended);
}

/* What is usual is still known: an outlier is refused. */
static void test_any_bit_of_the_gates_checksum_is_mended(void) {
	static KOOP(gate) gate;
	static real storage[KOOP_GATE_REALS_SQRT(N, M)];
	real zeta[D], psi_next[N];
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, sizeof storage / sizeof *storage));
	for (int k = 0; k < 100 * D; k++) {
		draw(zeta, psi_next);
		psi_next[0] += random_uniform(&random, -1e-3, 1e-3);
		(void)KOOP(gate_update)(&gate, &e.rls, zeta, zeta + N, psi_next, NULL);
	}
	psi_next[0] += 10;
	const KOOP(gate) before = gate;
	for (size_t bit = 0; bit < BITS; bit++) {
		gate = before;
		flip(&gate.sum, bit);
		CHECK_STATUS(KOOP_E_OUTLIER, KOOP(gate_update)(&gate, &e.rls, zeta, zeta + N, psi_next, NULL));
	}
}

static void test_any_bit_of_the_guards_checksum_is_mended(void) {
	static KOOP(mpc) mpc;
	static KOOP(guard) guard;
	static real mpc_storage[KOOP_MPC_REALS_GRADIENT(N, 1, M, HORIZON)];
	static real guard_storage[KOOP_GUARD_REALS(N, 1, M, HORIZON)];
	const real one[M * M] = {1, 0, 0, 1}, low[M] = {-1, -1}, high[M] = {1, 1}, safe[M] = {0};
	const KOOP(mpc_config) config = {.n_lifted = N,
	                                 .n_states = 1,
	                                 .n_inputs = M,
	                                 .horizon = HORIZON,
	                                 .Q = one,
	                                 .R = one,
	                                 .u_min = low,
	                                 .u_max = high,
	                                 .u_safe = safe,
	                                 .method = KOOP_MPC_GRADIENT};
	real theta[D * KOOP_PAD(N)] = {0}, u[M];
	const real psi[N] = {1, 0, 0, 0}, reference[HORIZON] = {0};
	theta[0] = (real)0.5;
	theta[N * KOOP_PAD(N)] = theta[(N + 1) * KOOP_PAD(N)] = 1;
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage));
	CHECK_STATUS(KOOP_OK, KOOP(guard_init)(&guard, NULL, &mpc, theta, guard_storage,
	                                       sizeof guard_storage / sizeof *guard_storage));
	for (size_t bit = 0; bit < BITS; bit++) {
		const koop_checksum before = guard.sum;
		flip(&guard.sum, bit);
		CHECK_STATUS(KOOP_OK, KOOP(guard_control)(&guard, &e.rls, &mpc, psi, reference, NULL, u, NULL));
		TEST_ASSERT_EQUAL_MEMORY(&before, &guard.sum, sizeof before);
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_any_bit_of_what_was_learned_is_mended);
	RUN_TEST(test_any_bit_of_the_checksum_itself_is_mended);
	RUN_TEST(test_two_flipped_bits_are_reported);
	RUN_TEST(test_a_refusal_is_not_taken_for_a_flip);
	RUN_TEST(test_any_bit_of_the_gates_checksum_is_mended);
	RUN_TEST(test_any_bit_of_the_guards_checksum_is_mended);
	return UNITY_END();
}
