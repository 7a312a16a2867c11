/* Bits that flip in what was learned: one is repaired, more are told. And what a flipped bit does where no
 * checksum is kept. */
#include "support.h"

enum { N = 4, M = 2, D = N + M, ROWS = (D + 3) / 4 * 4 };

static estimator e, twin;

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form, int checksum) {
	random_source random = random_seed(91);
	estimator_settings(&e, N, M, regulator, form);
	e.config.checksum = checksum;
	estimator_start(&e);
	estimator_teach(&e, &random, 30);
}

static void flip(void *word, size_t bit) {
	((unsigned char *)word)[bit / 8] ^= (unsigned char)(1 << bit % 8);
}

/* Reals of what is learned: Theta and what is kept of P, which begin the storage. */
static size_t learned_reals(void) {
	return e.rls.kept;
}

static void test_every_single_bit_is_repaired(void) {
	for (size_t f = 0; f < FORMS; f++) {
		start(&KOOP(reg_sift), all_forms[f], 1);
		static real kept[KOOP_RLS_REALS_PLAIN(MAX_N, MAX_M)];
		memcpy(kept, e.storage, sizeof kept);
		for (size_t bit = 0; bit < 8 * sizeof(real) * learned_reals(); bit++) {
			flip(e.rls.theta, bit);
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			CHECK(memcmp(kept, e.storage, sizeof kept) == 0, "bit %zu", bit);
			TEST_ASSERT_EQUAL_size_t(bit + 1, e.rls.repaired);
		}
		CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
		TEST_ASSERT_EQUAL_size_t(8 * sizeof(real) * learned_reals(), e.rls.repaired);
	}
}

static void test_numbers_beside_the_storage_are_repaired(void) {
	start(&KOOP(reg_ef), &KOOP(form_plain), 1);
	real *const numbers[] = {&e.rls.covariance_scale, &e.rls.theta_bound, &e.rls.covariance_bound};
	for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
		const real kept[] = {*numbers[0], *numbers[1], *numbers[2]};
		for (size_t bit = 0; bit < 8 * sizeof(real); bit++) {
			flip(numbers[i], bit);
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			for (size_t k = 0; k < 3; k++) {
				CHECK(memcmp(numbers[k], &kept[k], sizeof *kept) == 0, "number %zu, bit %zu", i, bit);
			}
		}
	}
}

/* Pairs of bits of one word, of two words, the same bit of two words, up and down: told, but for those that
 * no sum of this kind can tell from one bit. */
static void test_two_bits_are_told_or_at_least_not_overlooked(void) {
	random_source random = random_seed(92);
	size_t told = 0, trials = 20000;
	start(&KOOP(reg_ef), &KOOP(form_sqrt), 1);
	for (size_t k = 0; k < trials; k++) {
		static real kept[KOOP_RLS_REALS_PLAIN(MAX_N, MAX_M)];
		const size_t bits = 8 * sizeof(real) * learned_reals();
		const size_t first = random_below(&random, bits), second = random_below(&random, bits);
		if (first == second) { continue; }
		const KOOP(rls) before = e.rls;
		memcpy(kept, e.storage, sizeof kept);
		flip(e.rls.theta, first);
		flip(e.rls.theta, second);
		const int status = KOOP(rls_check)(&e.rls);
		TEST_ASSERT_TRUE(status == KOOP_E_MEMORY ||
		                 (status == KOOP_OK && e.rls.repaired == before.repaired + 1));
		told += status == KOOP_E_MEMORY;
		e.rls = before;
		memcpy(e.storage, kept, sizeof kept);
	}
	/* the same bit of two words, in the same direction, can look like the next bit of a word between them: 1 in 64 */
	CHECK(told > trials * 63 / 64, "%zu of %zu told", told, trials);
}

static void test_update_refuses_a_memory_that_it_cannot_mend(void) {
	start(&KOOP(reg_ct), &KOOP(form_sqrt), 1);
	const real zeta[D] = {1, 1, 1, 1, 1, 1}, psi_next[N] = {0};
	KOOP(health) health;
	learned before, after;
	flip(e.rls.theta, 3);
	flip(e.rls.theta, 40);
	learned_take(&before, &e);
	CHECK_STATUS(KOOP_E_MEMORY, estimator_update(&e, zeta, psi_next, &health));
	TEST_ASSERT_TRUE(health.innovation >= 0 && health.innovation <= 0); /* the sample was not looked at */
	TEST_ASSERT_EQUAL_INT(0, health.frozen);
	learned_take(&after, &e);
	TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e) && learned_same_covariance(&before, &after, &e));
	/* a model and your own P begin anew */
	static const real theta[N * D] = {0};
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 10));
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
}

/* Every call that changes what is learned renews the sum. */
static void test_sum_is_renewed_by_every_change(void) {
	real theta[N * D];
	unsigned char bytes[MODEL_BYTES(N, M)];
	random_source random = random_seed(93);
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t r = 0; r < REGULATORS; r++) {
			start(all_regulators[r], all_forms[f], 1);
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			random_fill(&random, theta, N * D, -1, 1);
			CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&e.rls, theta));
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 2));
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			CHECK_STATUS(KOOP_OK, KOOP(model_save)(&e.rls, bytes, sizeof bytes));
			e.rls.theta[0] = 0;
			CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, bytes, sizeof bytes));
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			estimator_default(&twin, N, M, all_regulators[r], all_forms[f]);
			CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&e.rls, twin.rls.theta));
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			TEST_ASSERT_EQUAL_size_t(0, e.rls.repaired);
		}
	}
}

/* What it is of, in words of 32 bits: Theta and P, then three numbers. The first is their sum, the second
 * that of each times its distance from the end. */
static void test_the_sum_is_what_is_said(void) {
	for (size_t f = 0; f < FORMS; f++) {
		start(&KOOP(reg_sift), all_forms[f], 1);
		const real numbers[] = {e.rls.covariance_scale, e.rls.theta_bound, e.rls.covariance_bound};
		const size_t most = learned_reals() * sizeof(real) / 4, count = most + sizeof numbers / 4;
		uint64_t words = 0, places = 0;
		for (size_t i = 0; i < count; i++) {
			const unsigned char *theta = (const unsigned char *)e.rls.theta;
			uint32_t word;
			memcpy(&word, i < most ? theta + 4 * i : (const unsigned char *)numbers + 4 * (i - most), 4);
			words += word;
			places += (uint64_t)word * (count - i);
		}
		TEST_ASSERT_TRUE(words == e.rls.sum.words && places == e.rls.sum.weighted);
	}
}

/* The sum changes nothing of what is learned. */
static void test_learning_is_the_same_with_a_checksum(void) {
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t r = 0; r < REGULATORS; r++) {
			learned with, without;
			start(all_regulators[r], all_forms[f], 1);
			learned_take(&with, &e);
			start(all_regulators[r], all_forms[f], 0);
			learned_take(&without, &e);
			CHECK(learned_same_theta(&with, &without, &e), "%s", estimator_name(&e));
			CHECK(learned_same_covariance(&with, &without, &e), "%s", estimator_name(&e));
			CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_check)(&e.rls));
		}
	}
}

/* What a refused sample leaves behind as scratch is no part of what was learned. */
static void test_refused_samples_leave_the_sum_alone(void) {
	const real huge[D] = {1, 1, 1, 1, 1, REAL_MAX / 4}, psi_next[N] = {0};
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t r = 0; r < REGULATORS; r++) {
			start(all_regulators[r], all_forms[f], 1);
			TEST_ASSERT_TRUE(estimator_update(&e, huge, psi_next, NULL) < KOOP_OK);
			CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
			TEST_ASSERT_EQUAL_size_t(0, e.rls.repaired);
		}
	}
	/* P so small that the next sample costs it its definiteness */
	start(&KOOP(reg_none), &KOOP(form_plain), 1);
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 1));
	const real line[D] = {(real)1e6, 1}, zeros[N] = {0};
	int refused = 0;
	for (int k = 0; k < 50; k++) { refused += estimator_update(&e, line, zeros, NULL) == KOOP_E_INDEFINITE; }
	TEST_ASSERT_TRUE(refused > 0 || TEST_DOUBLE);
	CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
}

static void test_a_setting_that_is_none_is_refused(void) {
	estimator_settings(&e, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	e.config.checksum = 2;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_init)(&e.rls, &e.config, e.storage, sizeof e.storage / sizeof(real)));
	e.config.checksum = -1;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_init)(&e.rls, &e.config, e.storage, sizeof e.storage / sizeof(real)));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_check)(NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_check)(&(KOOP(rls)){.theta = NULL}));
}

/* ---- without a checksum ------------------------------------------------------------------- */

/* P as it acts: P zeta for unit vectors, from the gain of a prediction's update. Here by the form itself. */
static int covariance_is_symmetric(void) {
	real P[D * D];
	for (size_t j = 0; j < D; j++) {
		for (size_t i = 0; i < e.rls.n_regressors_padded; i++) { e.rls.zeta[i] = i == j ? 1 : 0; }
		(void)e.rls.config.form->gain(&e.rls);
		for (size_t i = 0; i < D; i++) { P[i * D + j] = e.rls.gain[i]; }
	}
	for (size_t i = 0; i < D; i++) {
		for (size_t j = 0; j < i; j++) {
			if (memcmp(&P[i * D + j], &P[j * D + i], sizeof *P) != 0) { return 0; }
		}
	}
	return 1;
}

/* A bit of P that flips makes it asymmetric at most for as many samples as P has rows. */
static void test_plain_form_does_not_stay_asymmetric(void) {
	random_source random = random_seed(94);
	for (size_t r = 0; r < REGULATORS; r++) {
		for (size_t at = 0; at < D * ROWS; at++) {
			start(all_regulators[r], &KOOP(form_plain), 0);
			e.dead_zone.delta = 0;
			flip(e.rls.covariance + at, 8 * sizeof(real) - 12);
			int samples = 0;
			for (int k = 0; k < 40 && samples < ROWS; k++) {
				real zeta[D], psi_next[N];
				random_fill(&random, zeta, D, -1, 1);
				random_fill(&random, psi_next, N, -3, 3);
				samples += estimator_update(&e, zeta, psi_next, NULL) == KOOP_OK;
			}
			if (samples < ROWS) { continue; } /* it was noticed: P is indefinite */
			CHECK(covariance_is_symmetric(), "%s, element %zu", estimator_name(&e), at);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_every_single_bit_is_repaired);
	RUN_TEST(test_numbers_beside_the_storage_are_repaired);
	RUN_TEST(test_two_bits_are_told_or_at_least_not_overlooked);
	RUN_TEST(test_update_refuses_a_memory_that_it_cannot_mend);
	RUN_TEST(test_sum_is_renewed_by_every_change);
	RUN_TEST(test_the_sum_is_what_is_said);
	RUN_TEST(test_learning_is_the_same_with_a_checksum);
	RUN_TEST(test_refused_samples_leave_the_sum_alone);
	RUN_TEST(test_a_setting_that_is_none_is_refused);
	RUN_TEST(test_plain_form_does_not_stay_asymmetric);
	return UNITY_END();
}
