/* Bits that flip between two calls: what the checksums mend, and what they must not take for a flip. */
#include "tinykoop_supervisor.h" /* first: it leaves KOOP undefined */

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

/* Flips each bit of some bytes; each is to be found, repaired and counted. */
static void check_repaired(void *at, size_t bytes) {
	static estimator before;
	for (size_t bit = 0; bit < 8 * bytes; bit++) {
		before = e;
		flip(at, bit);
		CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
		TEST_ASSERT_EQUAL_size_t(before.rls.repaired + 1, e.rls.repaired);
		e.rls.repaired = before.rls.repaired;
		CHECK(memcmp(&before, &e, sizeof e) == 0, "%s, bit %lu", estimator_name(&e), (unsigned long)bit);
	}
}

static void test_any_bit_of_what_was_learned_is_repaired(void) {
	const size_t from = offsetof(KOOP(rls), covariance_scale);
	const size_t numbers = offsetof(KOOP(rls), positive_definite) - from;
	for (int r = 0; r < REGULATORS; r++) {
		for (int f = 0; f < FORMS; f++) {
			start(all_regulators[r], all_forms[f]);
			check_repaired(e.rls.theta, e.rls.kept * sizeof(real));
			check_repaired((unsigned char *)&e.rls + from, numbers / sizeof(real) * sizeof(real));
		}
	}
}

static void test_any_bit_of_the_checksum_itself_is_repaired(void) {
	for (int f = 0; f < FORMS; f++) {
		start(&KOOP(reg_ef), all_forms[f]);
		check_repaired(&e.rls.sum, sizeof e.rls.sum);
		CHECK_STATUS(KOOP_OK, learn_one(&e));
	}
}

/* Here of the sums, so that no flipped bit of a word accounts for both. */
static void test_two_flipped_bits_are_reported(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	flip(&e.rls.sum.words, 5);
	flip(&e.rls.sum.weighted, 3);
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(rls_check)(&e.rls));
	flip(&e.rls.sum.weighted, 3);
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
	TEST_ASSERT_EQUAL_size_t(0, e.rls.repaired);
}

/* ---- Gate ---------------------------------------------------------------------------------- */

typedef struct {
	KOOP(gate) gate;
	real storage[KOOP_GATE_REALS_SQRT(N, M) + KOOP_EXTENSION_REALS_SQRT(N, M)];
} gated;
static gated g;

static int gate_one(double off) {
	real zeta[D], psi_next[N];
	draw(zeta, psi_next);
	for (int i = 0; i < N; i++) { psi_next[i] += random_uniform(&random, -1e-3, 1e-3) + (real)off; }
	return KOOP(gate_update)(&g.gate, &e.rls, zeta, zeta + N, psi_next, NULL);
}

static void start_gate(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	memset(&g, 0, sizeof g);
	const size_t reals = sizeof g.storage / sizeof *g.storage;
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&g.gate, NULL, &e.rls, g.storage, reals));
	for (int k = 0; k < 100 * D; k++) { (void)gate_one(0); }
}

/* Each flipped bit leaves no trace at the next sample, which is an outlier, and would not be one to a gate
 * that does not know what is usual. */
static void check_gate_mends(void *at, size_t bytes) {
	static gated before, expected;
	static estimator learner;
	const random_source now = random;
	before = g;
	learner = e;
	CHECK_STATUS(KOOP_E_OUTLIER, gate_one(10));
	expected = g;
	for (size_t bit = 0; bit < 8 * bytes; bit++) {
		g = before;
		e = learner;
		random = now;
		flip(at, bit);
		CHECK_STATUS(KOOP_E_OUTLIER, gate_one(10));
		CHECK(memcmp(&expected, &g, sizeof g) == 0, "bit %lu", (unsigned long)bit);
	}
	g = before;
	e = learner;
}

static void test_any_bit_of_what_the_gate_knows_is_repaired(void) {
	const size_t from = offsetof(KOOP(gate), warm_up);
	start_gate();
	check_gate_mends(g.gate.variance, 3 * N * sizeof(real));
	check_gate_mends((unsigned char *)&g.gate + from, sizeof g.gate - from); /* and of the sums */
}

/* Two flipped bits of it, that no single one accounts for: what is usual is learned again. */
static void test_a_gate_that_cannot_be_mended_begins_anew(void) {
	start_gate();
	flip(&g.gate.sum.words, 5);
	flip(&g.gate.sum.weighted, 3);
	CHECK_STATUS(KOOP_OK, gate_one(10));
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, KOOP(gate_trust)(&g.gate));
	for (int k = 0; k < 100 * D; k++) { (void)gate_one(0); }
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, KOOP(gate_trust)(&g.gate));
	CHECK_STATUS(KOOP_E_OUTLIER, gate_one(10));
}

/* More bits of the learner than can be repaired: it gets what is saved. Where that is spoilt too, a status.
 */
static void test_the_gate_replaces_a_learner_that_cannot_be_repaired(void) {
	start_gate();
	flip(&e.rls.sum.words, 5);
	flip(&e.rls.sum.weighted, 3);
	CHECK_STATUS(KOOP_OK, gate_one(0));
	TEST_ASSERT_EQUAL_size_t(1, g.gate.restored);
	for (int k = 0; k < 2; k++) {
		flip(k ? &e.rls.sum.words : &g.gate.saved.sum.words, 5);
		flip(k ? &e.rls.sum.weighted : &g.gate.saved.sum.weighted, 3);
	}
	CHECK_STATUS(KOOP_E_MEMORY, gate_one(0));
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, KOOP(gate_trust)(&g.gate));
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 1));
	CHECK_STATUS(KOOP_OK, gate_one(0));
}

static void test_a_root_form_that_says_it_is_indefinite_is_definite_again(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	flip(&e.rls.positive_definite, 0);
	CHECK_STATUS(KOOP_OK, learn_one(&e));
	TEST_ASSERT_EQUAL_INT(1, e.rls.positive_definite);
}

/* ---- Supervisor --------------------------------------------------------------------------------- */

static KOOP(mpc) mpc;
static KOOP(supervisor) supervisor;
static real mpc_storage[KOOP_MPC_REALS_GRADIENT(N, 1, M, HORIZON)];
enum { SUPERVISOR_REALS = KOOP_SUPERVISOR_REALS(N, 1, M, HORIZON) };
static real supervisor_storage[SUPERVISOR_REALS];

static void start_supervisor(void) {
	static const real one[M * M] = {1, 0, 0, 1}, low[M] = {-1, -1}, high[M] = {1, 1}, safe[M] = {0};
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
	real theta[D * KOOP_PAD(N)] = {0};
	theta[0] = (real)0.5;
	theta[N * KOOP_PAD(N)] = theta[(N + 1) * KOOP_PAD(N)] = 1;
	start(&KOOP(reg_ef), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&e.rls, theta));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage));
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_init)(&supervisor, NULL, &mpc, theta, supervisor_storage, SUPERVISOR_REALS));
}

static int supervisor_one(void) {
	const real psi[N] = {1, 0, 0, 0}, reference[HORIZON] = {0};
	real u[M];
	return KOOP(supervisor_control)(&supervisor, &e.rls, &mpc, psi, reference, NULL, u, NULL);
}

static void test_any_bit_of_the_supervisors_models_and_checksum_is_repaired(void) {
	static real expected[SUPERVISOR_REALS];
	start_supervisor();
	CHECK_STATUS(KOOP_OK, supervisor_one());
	const KOOP(supervisor) before =
	    supervisor; /* too short in use for its model to become the last good one */
	memcpy(expected, supervisor_storage, sizeof expected);
	const size_t bits = 8 * (size_t)(supervisor.now - supervisor.offline) * sizeof(real);
	for (size_t bit = 0; bit < bits + BITS; bit++) {
		supervisor = before;
		flip(bit < bits ? (void *)supervisor.offline : (void *)&supervisor.sum,
		     bit < bits ? bit : bit - bits);
		CHECK_STATUS(KOOP_OK, supervisor_one());
		TEST_ASSERT_EQUAL_MEMORY(expected, supervisor_storage, bits / 8);
		TEST_ASSERT_EQUAL_MEMORY(&before.sum, &supervisor.sum, sizeof before.sum);
	}
	flip(&supervisor.sum.words, 5);
	flip(&supervisor.sum.weighted, 3);
	CHECK_STATUS(KOOP_E_MEMORY, supervisor_one());
}

/* The longest wait is 16 times the patience, which is 15. */
static void test_the_supervisor_comes_back_to_the_online_model_whatever_flips_in_its_waiting(void) {
	start_supervisor();
	size_t *const counters[] = {&supervisor.wait, &supervisor.delay};
	for (size_t c = 0; c < 2; c++) {
		for (size_t bit = 0; bit < 8 * sizeof(size_t); bit++) {
			flip(counters[c], bit);
			for (int k = 0; k < 16 * 15 + 1; k++) { CHECK_STATUS(KOOP_OK, supervisor_one()); }
			CHECK(supervisor.model == KOOP_SUPERVISOR_ONLINE, "counter %d, bit %d", (int)c, (int)bit);
		}
	}
}

static void test_the_supervisor_forgets_an_error_that_is_not_finite(void) {
	start_supervisor();
	for (int model = KOOP_SUPERVISOR_ONLINE; model <= KOOP_SUPERVISOR_OFFLINE; model++) {
		for (int k = 0; k < 2; k++) {
			supervisor.error[model] = (real)(k ? NAN : INFINITY);
			real zeta[D], psi_next[N];
			draw(zeta, psi_next);
			CHECK_STATUS(KOOP_OK,
			             KOOP(supervisor_update)(&supervisor, &e.rls, zeta, zeta + N, psi_next, NULL));
			for (int m = 0; m <= KOOP_SUPERVISOR_OFFLINE; m++) {
				TEST_ASSERT_TRUE(isfinite(supervisor.error[m]));
			}
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_any_bit_of_what_was_learned_is_repaired);
	RUN_TEST(test_any_bit_of_the_checksum_itself_is_repaired);
	RUN_TEST(test_two_flipped_bits_are_reported);
	RUN_TEST(test_a_refusal_is_not_taken_for_a_flip);
	RUN_TEST(test_any_bit_of_what_the_gate_knows_is_repaired);
	RUN_TEST(test_a_gate_that_cannot_be_mended_begins_anew);
	RUN_TEST(test_the_gate_replaces_a_learner_that_cannot_be_repaired);
	RUN_TEST(test_a_root_form_that_says_it_is_indefinite_is_definite_again);
	RUN_TEST(test_any_bit_of_the_supervisors_models_and_checksum_is_repaired);
	RUN_TEST(test_the_supervisor_comes_back_to_the_online_model_whatever_flips_in_its_waiting);
	RUN_TEST(test_the_supervisor_forgets_an_error_that_is_not_finite);
	return UNITY_END();
}
