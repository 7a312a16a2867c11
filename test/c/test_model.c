/* Stored models: what comes back, and what is refused. */
#include "stored.h"
#include "support.h"

enum { N = 3, M = 2, D = N + M, BYTES = MODEL_BYTES(N, M), FORMAT_AT = 4, CHECKSUM_AT = 20 };
enum { TRIANGLE = D * (D + 1) / 2 * sizeof(real), BYTES_P = BYTES + TRIANGLE };

static estimator from, to;
static unsigned char model[BYTES];

static void seal(unsigned char *bytes) {
	stored_seal(bytes, BYTES);
}

/* `from` has learned something and is saved, `to` holds another Theta */
static void prepare(void) {
	random_source random = random_seed(11);
	real theta[N * D];
	estimator_default(&from, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	estimator_default(&to, N, M, &KOOP(reg_sift), &KOOP(form_sqrt));
	for (int k = 0; k < 20; k++) {
		real zeta[D], psi_next[N];
		random_fill(&random, zeta, D, -1, 1);
		random_fill(&random, psi_next, N, -1, 1);
		CHECK_STATUS(KOOP_OK, estimator_update(&from, zeta, psi_next, NULL));
	}
	random_fill(&random, theta, N * D, -1, 1);
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&to.rls, theta));
	memset(model, 0xA5, sizeof model);
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, model, BYTES));
}

static void check_refused(const void *bytes, size_t size, const char *what) {
	learned before, after;
	learned_take(&before, &to);
	const int status = KOOP(model_load)(&to.rls, bytes, size);
	learned_take(&after, &to);
	CHECK(status == KOOP_E_MODEL, "%s: %d", what, status);
	CHECK(learned_same_theta(&before, &after, &to), "%s", what);
	CHECK(learned_same_covariance(&before, &after, &to), "%s", what);
}

static void test_round_trip(void) {
	learned sent, received, before;
	unsigned char again[BYTES];
	prepare();
	learned_take(&sent, &from);
	learned_take(&before, &to);
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&to.rls, model, BYTES));
	learned_take(&received, &to);
	TEST_ASSERT_TRUE(learned_same_theta(&sent, &received, &to));
	TEST_ASSERT_TRUE(learned_same_covariance(&before, &received, &to));
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&to.rls, again, BYTES));
	TEST_ASSERT_EQUAL_MEMORY(model, again, BYTES);
}

static void test_seal_is_the_library_s_checksum(void) {
	unsigned char copy[BYTES];
	prepare();
	memcpy(copy, model, BYTES);
	memset(copy + CHECKSUM_AT, 0, 4);
	seal(copy);
	TEST_ASSERT_EQUAL_MEMORY(model, copy, BYTES);
}

static void test_every_flipped_bit_is_refused(void) {
	prepare();
	for (size_t i = 0; i < BYTES; i++) {
		for (int bit = 0; bit < 9; bit++) {
			unsigned char copy[BYTES];
			memcpy(copy, model, BYTES);
			copy[i] ^= (unsigned char)(bit < 8 ? 1 << bit : 0xFF); /* at last the whole byte */
			check_refused(copy, BYTES, "flipped");
		}
	}
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&to.rls, model, BYTES));
}

/* With a right checksum: the header alone must give them away. */
static void test_every_changed_header_is_refused(void) {
	prepare();
	for (size_t i = 0; i < CHECKSUM_AT; i++) {
		for (int value = 0; value < 256; value++) {
			unsigned char copy[BYTES];
			memcpy(copy, model, BYTES);
			if (copy[i] == value || (i == FORMAT_AT && value == 1)) { continue; } /* 1: see below */
			copy[i] = (unsigned char)value;
			seal(copy);
			check_refused(copy, BYTES, "header");
		}
	}
}

static void test_wrong_size_is_refused(void) {
	unsigned char large[BYTES + 1] = {0};
	prepare();
	memcpy(large, model, BYTES);
	check_refused(large, BYTES + 1, "one byte more");
	for (size_t size = 0; size < BYTES; size++) { check_refused(large, size, "truncated"); }
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save)(&from.rls, large, BYTES - 1));
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save)(&from.rls, large, 0));
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, large, BYTES + 1));
	TEST_ASSERT_EQUAL_MEMORY(model, large, BYTES);
}

/* Same number of bytes, other meaning. */
static void test_model_of_another_kind_is_refused(void) {
	prepare();
	estimator_settings(&to, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	to.dictionary.name = "another";
	estimator_start(&to);
	check_refused(model, BYTES, "dictionary");

	estimator_settings(&to, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	to.dictionary.n_states = N - 1;
	estimator_start(&to);
	check_refused(model, BYTES, "states");

	estimator_default(&to, N + 1, M, &KOOP(reg_ef), &KOOP(form_plain));
	check_refused(model, BYTES, "lifted states");
	estimator_default(&to, N, M + 1, &KOOP(reg_ef), &KOOP(form_plain));
	check_refused(model, BYTES, "inputs");

	/* 2 x (2 + 7) and 3 x (3 + 3) elements are 18 both: only the header tells them apart */
	static unsigned char same_size[MODEL_BYTES(2, 7)];
	static real storage[KOOP_RLS_REALS_PLAIN(2, 7)];
	estimator_settings(&from, 2, 7, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK,
	             KOOP(rls_init)(&from.rls, &from.config, storage, sizeof storage / sizeof storage[0]));
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, same_size, sizeof same_size));
	estimator_default(&to, 3, 3, &KOOP(reg_ef), &KOOP(form_plain));
	TEST_ASSERT_TRUE(sizeof same_size == MODEL_BYTES(3, 3));
	check_refused(same_size, sizeof same_size, "N and m");
}

/* The other precision's 2 x (2 + 1) model, as it is and padded or cut to this one's size. */
static void test_model_of_the_other_precision_is_refused(void) {
	static const OTHER(dictionary) dictionary = {"identity", 2, 2, NULL, NULL};
	OTHER(dictionary) lifted = dictionary;
	estimator_default(&to, 2, 1, &KOOP(reg_ef), &KOOP(form_plain));
	OTHER(config) config;
	OTHER(rls) rls;
	memset(&config, 0, sizeof config);
	/* never called: only its presence is checked */
	lifted.lift = OTHER(poly_ddr).lift;
	config.dictionary = &lifted;
	config.n_inputs = 1;
	config.regulator = &OTHER(reg_ef);
	config.form = &OTHER(form_plain);
	config.lambda = 1;
	config.p0 = 1;
#if TEST_DOUBLE
	static float storage[KOOP_RLS_REALS_PLAIN(2, 1)];
#else
	static double storage[KOOP_RLS_REALS_PLAIN(2, 1)];
#endif
	unsigned char bytes[KOOPD_MODEL_BYTES(2, 1)] = {0};
	const size_t theirs = KOOPF_MODEL_BYTES(2, 1) + KOOPD_MODEL_BYTES(2, 1) - MODEL_BYTES(2, 1);
	CHECK_STATUS(KOOP_OK, OTHER(rls_init)(&rls, &config, storage, sizeof storage / sizeof storage[0]));
	CHECK_STATUS(KOOP_OK, OTHER(model_save)(&rls, bytes, theirs));
	check_refused(bytes, theirs, "as it is");
	check_refused(bytes, MODEL_BYTES(2, 1), "at this precision's size");
}

static void test_payload_that_is_not_finite_is_refused(void) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	prepare();
	for (size_t i = 0; i < N * D; i++) {
		for (int v = 0; v < 3; v++) {
			unsigned char copy[BYTES];
			const real value = (real)values[v];
			memcpy(copy, model, BYTES);
			stored_put(copy + CHECKSUM_AT + 4 + i * sizeof(real), value, 0);
			seal(copy);
			check_refused(copy, BYTES, "not finite");
		}
	}
}

/* ---- the same bytes everywhere --------------------------------------------------------- */

static void test_bytes_are_little_endian_on_every_machine(void) {
	static const unsigned char header[] = {'K', 'O', 'O', 'P', 2, 0, sizeof(real), 0, N, 0, M, 0, N, 0, 0, 0};
	real theta[N * D] = {1, (real)-2.5};
	prepare();
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&from.rls, theta));
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, model, BYTES));
	TEST_ASSERT_EQUAL_MEMORY(header, model, sizeof header);
	const unsigned char *one = model + CHECKSUM_AT + 4, *other = one + sizeof(real);
#if TEST_DOUBLE
	static const unsigned char of_one[] = {0, 0, 0, 0, 0, 0, 0xF0, 0x3F}, of_other[] = {0, 0, 0, 0, 0, 0, 0x04, 0xC0};
#else
	static const unsigned char of_one[] = {0, 0, 0x80, 0x3F}, of_other[] = {0, 0, 0x20, 0xC0};
#endif
	TEST_ASSERT_EQUAL_MEMORY(of_one, one, sizeof of_one);
	TEST_ASSERT_EQUAL_MEMORY(of_other, other, sizeof of_other);
}

/* A model as version 0.1.0 wrote it, on a machine of either byte order. */
static void make_format_1(unsigned char *bytes, int big_endian) {
	memcpy(bytes, model, BYTES);
	bytes[FORMAT_AT] = 1;
	for (size_t at = CHECKSUM_AT + 4; big_endian && at < BYTES; at += sizeof(real)) {
		for (size_t i = 0; i < sizeof(real); i++) { bytes[at + i] = model[at + sizeof(real) - 1 - i]; }
	}
	seal(bytes);
}

static void test_format_1_is_read_in_either_byte_order(void) {
	for (int big_endian = 0; big_endian < 2; big_endian++) {
		unsigned char old[BYTES];
		learned sent, received;
		prepare();
		learned_take(&sent, &from);
		make_format_1(old, big_endian);
		CHECK_STATUS(KOOP_OK, KOOP(model_load)(&to.rls, old, BYTES));
		learned_take(&received, &to);
		CHECK(learned_same_theta(&sent, &received, &to), "big-endian %d", big_endian);
	}
}

static void test_format_1_is_refused_where_its_byte_order_is_unclear(void) {
	static const double values[] = {0, 1e-20, 1e25};
	for (size_t v = 0; v < sizeof values / sizeof *values; v++) {
		real theta[N * D];
		unsigned char old[BYTES];
		for (size_t i = 0; i < N * D; i++) { theta[i] = (real)values[v]; }
		prepare();
		CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&from.rls, theta));
		CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, model, BYTES));
		make_format_1(old, 0);
		check_refused(old, BYTES, "unclear");
	}
	/* a number of a usual size in either order */
	unsigned char old[BYTES];
	prepare();
	for (size_t at = CHECKSUM_AT + 4; at < BYTES; at++) { model[at] = 0x3F; }
	make_format_1(old, 0);
	check_refused(old, BYTES, "the same in both");
}

static void test_format_1_that_is_not_finite_is_refused(void) {
	unsigned char old[BYTES];
	prepare();
	make_format_1(old, 0);
	memset(old + BYTES - sizeof(real), 0xFF, sizeof(real));
	seal(old);
	check_refused(old, BYTES, "NaN");
}

/* ---- with P ---------------------------------------------------------------------------- */

static unsigned char with_covariance[BYTES_P + TRIANGLE];

/* As if there had been no stop: bit for bit in the root form, to rounding in the plain one, whose scale is
 * worked into P. */
static void check_goes_on(const KOOP(regulator) *regulator, const KOOP(form) *form) {
	random_source random = random_seed(77);
	const size_t size = form == &KOOP(form_plain) && regulator->needs_information ? BYTES_P + TRIANGLE : BYTES_P;
	learned one, other;
	estimator_default(&from, N, M, regulator, form);
	estimator_default(&to, N, M, regulator, form);
	estimator_teach(&from, &random, 20);
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save_covariance)(&from.rls, with_covariance, size - 1));
	CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&from.rls, with_covariance, size));
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&to.rls, with_covariance, size));
	learned_take(&one, &from);
	learned_take(&other, &to);
	CHECK(learned_same_theta(&one, &other, &to), "%s", estimator_name(&to));
	CHECK(learned_same_covariance(&one, &other, &to), "%s", estimator_name(&to));
	random_source again = random;
	estimator_teach(&from, &random, 30);
	estimator_teach(&to, &again, 30);
	learned_take(&one, &from);
	learned_take(&other, &to);
	if (form == &KOOP(form_sqrt)) {
		CHECK(learned_same_theta(&one, &other, &to), "%s", estimator_name(&to));
		CHECK(learned_same_covariance(&one, &other, &to), "%s", estimator_name(&to));
	} else {
		const double most = 1e5 * (double)REAL_EPSILON;
		CHECK(relative_difference_real(other.theta, one.theta, N * D) < most, "%s", estimator_name(&to));
		CHECK(relative_difference_real(other.covariance, one.covariance, D * D) < most, "%s", estimator_name(&to));
	}
}

static void test_learning_goes_on_with_a_covariance_that_was_stored(void) {
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t r = 0; r < REGULATORS; r++) {
			if (!all_regulators[r]->extension) { check_goes_on(all_regulators[r], all_forms[f]); }
		}
	}
}

static void store_covariance(const KOOP(form) *form) {
	random_source random = random_seed(78);
	estimator_default(&from, N, M, &KOOP(reg_ef), form);
	estimator_default(&to, N, M, &KOOP(reg_ef), form);
	estimator_teach(&from, &random, 20);
	CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&from.rls, with_covariance, BYTES_P));
}

static void test_covariance_of_another_form_is_refused(void) {
	store_covariance(&KOOP(form_sqrt));
	estimator_default(&to, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	check_refused(with_covariance, BYTES_P, "of the root form");
	estimator_default(&to, N, M, &KOOP(reg_sift), &KOOP(form_plain));
	check_refused(with_covariance, BYTES_P, "without P^-1");
}

/* Your own form that does not say how: Theta alone goes in and out. */
static void test_form_that_stores_no_covariance(void) {
	KOOP(form) own = KOOP(form_sqrt);
	store_covariance(&KOOP(form_sqrt));
	CHECK_STATUS(KOOP_E_NULL, KOOP(model_save_covariance)(NULL, model, BYTES));
	CHECK_STATUS(KOOP_E_NULL, KOOP(model_save_covariance)(&from.rls, NULL, BYTES));
	CHECK_STATUS(KOOP_E_NULL, KOOP(model_save_covariance)(&(KOOP(rls)){.theta = NULL}, model, BYTES));
	own.triangles = NULL;
	from.rls.config.form = &own;
	CHECK_STATUS(KOOP_E_MODEL, KOOP(model_save_covariance)(&from.rls, with_covariance, BYTES_P));
	to.rls.config.form = &own;
	check_refused(with_covariance, BYTES_P, "P");
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&from.rls, model, BYTES));
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&to.rls, model, BYTES));
}

static void test_covariance_that_is_none_is_refused(void) {
	static const double bad[] = {0, -1, (double)NAN, (double)INFINITY};
	for (size_t f = 0; f < FORMS; f++) {
		for (size_t v = 0; v < sizeof bad / sizeof *bad; v++) {
			const real value = (real)bad[v];
			store_covariance(all_forms[f]);
			stored_put(with_covariance + BYTES + 2 * sizeof(real), value, 0); /* element (1, 1) */
			stored_seal(with_covariance, BYTES_P);
			check_refused(with_covariance, BYTES_P, "diagonal");
		}
	}
}

static void test_every_flipped_bit_of_a_covariance_is_refused(void) {
	store_covariance(&KOOP(form_sqrt));
	for (size_t i = BYTES; i < BYTES_P; i++) {
		for (int bit = 0; bit < 8; bit++) {
			with_covariance[i] ^= (unsigned char)(1 << bit);
			check_refused(with_covariance, BYTES_P, "flipped");
			with_covariance[i] ^= (unsigned char)(1 << bit);
		}
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_bytes_are_little_endian_on_every_machine);
	RUN_TEST(test_format_1_is_read_in_either_byte_order);
	RUN_TEST(test_format_1_is_refused_where_its_byte_order_is_unclear);
	RUN_TEST(test_format_1_that_is_not_finite_is_refused);
	RUN_TEST(test_learning_goes_on_with_a_covariance_that_was_stored);
	RUN_TEST(test_covariance_of_another_form_is_refused);
	RUN_TEST(test_form_that_stores_no_covariance);
	RUN_TEST(test_covariance_that_is_none_is_refused);
	RUN_TEST(test_every_flipped_bit_of_a_covariance_is_refused);
	RUN_TEST(test_round_trip);
	RUN_TEST(test_seal_is_the_library_s_checksum);
	RUN_TEST(test_every_flipped_bit_is_refused);
	RUN_TEST(test_every_changed_header_is_refused);
	RUN_TEST(test_wrong_size_is_refused);
	RUN_TEST(test_model_of_another_kind_is_refused);
	RUN_TEST(test_model_of_the_other_precision_is_refused);
	RUN_TEST(test_payload_that_is_not_finite_is_refused);
	return UNITY_END();
}
