/* A stored model written by hand and read by hand, from the description of its format alone: every field,
 * every size, P of every form, and the byte order that format 1 does not tell. */
#include "reference.h"
#include "stored.h"

#define TRIANGLE(d) ((d) * ((d) + 1u) / 2u)
#define MOST_BYTES (MODEL_BYTES_P(MAX_N, MAX_M) + TRIANGLE(MAX_D) * sizeof(real))

static estimator e;
static unsigned char model[MOST_BYTES + 1], again[MOST_BYTES + 1];

/* An estimator that has learned something; half of what is lifted is the state. */
static void start(random_source *random, size_t N, size_t m, const KOOP(regulator) *regulator,
                  const KOOP(form) *form) {
	estimator_settings(&e, N, m, regulator, form);
	e.dictionary.n_states = (N + 1) / 2;
	e.config.checksum = random_below(random, 2) == 0;
	estimator_start(&e);
	estimator_teach(&e, random, 4);
}

/* How many say all of P: SIFt keeps the inverse beside a plain P. */
static size_t own_triangles(void) {
	return e.config.form == &KOOP(form_plain) && e.config.regulator == &KOOP(reg_sift) ? 2 : 1;
}

static size_t theta_at(size_t i, size_t j) {
	return STORED_HEADER + (i * e.rls.n_regressors + j) * sizeof(real);
}

/* Element (i, j) of a lower triangle, j <= i. */
static size_t triangle_at(size_t triangle, size_t i, size_t j) {
	const size_t elements = triangle * TRIANGLE(e.rls.n_regressors) + TRIANGLE(i) + j;
	return theta_at(e.rls.n_lifted, 0) + elements * sizeof(real);
}

static size_t bytes_of(size_t triangles) {
	return triangle_at(triangles, 0, 0);
}

static void write_header(unsigned char *at, uint32_t format, size_t triangles) {
	const char *name = e.dictionary.name, *form = e.config.form->name;
	uint32_t hash = stored_crc(0xFFFFFFFFu, name, strlen(name));
	if (triangles > 0) { hash = stored_crc(hash, form, strlen(form)); }
	memcpy(at, "KOOP", 4);
	stored_number(at + 4, format, 2);
	stored_number(at + 6, sizeof(real), 2);
	stored_number(at + 8, (uint32_t)e.dictionary.n_lifted, 2);
	stored_number(at + 10, (uint32_t)e.config.n_inputs, 2);
	stored_number(at + 12, (uint32_t)e.dictionary.n_states, 2);
	stored_number(at + 14, (uint32_t)triangles, 2);
	stored_number(at + 16, ~hash, 4);
}

static int same_bits(real a, real b) {
	return memcmp(&a, &b, sizeof a) == 0;
}

static int is_close(wide a, wide b, wide size) {
	return fabs(a - b) <= 64 * (wide)REAL_EPSILON * size;
}

/* Element (i, j) of the product of a stored lower triangle with itself: P where that is its root. */
static wide square_of_root(const unsigned char *bytes, size_t i, size_t j) {
	wide sum = 0;
	for (size_t k = i > j ? i : j; k < e.rls.n_regressors; k++) {
		const real one = stored_get(bytes + triangle_at(0, k, i), 0);
		sum += (wide)one * (wide)stored_get(bytes + triangle_at(0, k, j), 0);
	}
	return sum;
}

/* ---- What is saved, and what a model is loaded as --------------------------------------------- */

static void check_theta(const unsigned char *bytes, int big_endian, const learned *now) {
	const size_t d = e.rls.n_regressors;
	for (size_t i = 0; i < e.rls.n_lifted; i++) {
		for (size_t j = 0; j < d; j++) {
			const real stored = stored_get(bytes + theta_at(i, j), big_endian);
			CHECK(same_bits(stored, now->theta[i * d + j]), "%s: Theta (%zu, %zu)", estimator_name(&e), i, j);
		}
	}
}

static void check_covariance(const unsigned char *bytes, const learned *now) {
	const size_t d = e.rls.n_regressors;
	const int plain = e.config.form == &KOOP(form_plain);
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j < d; j++) {
			const real P = now->covariance[i * d + j];
			const wide size = sqrt((wide)now->covariance[i * d + i] * (wide)now->covariance[j * d + j]);
			const size_t at = i > j ? triangle_at(0, i, j) : triangle_at(0, j, i);
			const int same = plain ? same_bits(stored_get(bytes + at, 0), P)
			                       : is_close(square_of_root(bytes, i, j), (wide)P, size);
			CHECK(same, "%s, d %zu: P (%zu, %zu)", estimator_name(&e), d, i, j);
		}
	}
}

/* Header and checksum, and nothing behind the model. */
static void check_frame(size_t triangles) {
	const size_t size = bytes_of(triangles);
	memcpy(again, model, size);
	write_header(again, 2, triangles);
	stored_seal(again, size);
	CHECK(memcmp(model, again, size) == 0, "%s, d %zu", estimator_name(&e), e.rls.n_regressors);
	TEST_ASSERT_EQUAL_UINT8(0xA5, model[size]);
}

static void check_saved(void) {
	learned now;
	learned_take(&now, &e);
	memset(model, 0xA5, sizeof model);
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&e.rls, model, bytes_of(0)));
	check_frame(0);
	check_theta(model, 0, &now);
	memset(model, 0xA5, sizeof model);
	CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, sizeof model));
	check_frame(own_triangles());
	check_theta(model, 0, &now);
	check_covariance(model, &now);
}

static void test_what_is_saved_is_read_by_the_description_of_the_format(void) {
	random_source random = random_seed(31);
	for (size_t N = 1; N <= MAX_N; N += N < 9 ? 1 : 13) {
		for (size_t k = 0; k < REGULATORS * FORMS; k++) {
			if (all_regulators[k % REGULATORS]->extension) { continue; } /* test_extensions.c has these */
			start(&random, N, 1 + (k + N) % MAX_M, all_regulators[k % REGULATORS], all_forms[k / REGULATORS]);
			check_saved();
		}
	}
}

static void test_storage_that_is_too_small_is_not_written(void) {
	random_source random = random_seed(32);
	start(&random, 3, 2, &KOOP(reg_ef), &KOOP(form_sqrt));
	memset(model, 0xA5, sizeof model);
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save)(&e.rls, model, bytes_of(0) - 1));
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save_covariance)(&e.rls, model, bytes_of(1) - 1));
	for (size_t i = 0; i < sizeof model; i++) { TEST_ASSERT_EQUAL_UINT8(0xA5, model[i]); }
}

/* A Theta of numbers up to `size`, of which the largest is returned. */
static real write_theta(random_source *random, double size) {
	real largest = 0;
	for (size_t at = STORED_HEADER; at < bytes_of(0); at += sizeof(real)) {
		const real value = random_uniform(random, -size, size), magnitude = (real)fabs(value);
		stored_put(model + at, value, 0);
		largest = magnitude > largest ? magnitude : largest;
	}
	return largest;
}

/* P is to be positive definite: where it is stored itself, its diagonal outweighs the rest. */
static void write_covariance(random_source *random, wide *P, double size) {
	const size_t d = e.rls.n_regressors;
	const double most = e.config.form == &KOOP(form_plain) ? 0.5 / (double)d : 2;
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			const double low = i == j ? size : -most * size, high = i == j ? 2 * size : most * size;
			const real value = random_uniform(random, low, high);
			stored_put(model + triangle_at(0, i, j), value, 0);
			P[i * d + j] = P[j * d + i] = (wide)value;
		}
	}
	for (size_t i = 0; e.config.form == &KOOP(form_sqrt) && i < d * d; i++) {
		P[i] = square_of_root(model, i / d, i % d);
	}
}

/* R = P^-1; as the second triangle where there is one. */
static void write_inverse(const wide *P, wide *R) {
	const size_t d = e.rls.n_regressors;
	wide copy[MAX_D * MAX_D];
	memcpy(copy, P, d * d * sizeof *copy);
	for (size_t i = 0; i < d * d; i++) { R[i] = i / d == i % d ? 1 : 0; }
	solve_positive_definite(copy, d, R, d);
	for (size_t i = 0; own_triangles() == 2 && i < d; i++) {
		for (size_t j = 0; j <= i; j++) { stored_put(model + triangle_at(1, i, j), (real)R[i * d + j], 0); }
	}
}

static void finish(size_t triangles) {
	write_header(model, 2, triangles);
	stored_seal(model, bytes_of(triangles));
}

/* What is kept of P has no element, and as a root no row, beyond the bound, which is not far beyond them. */
static void check_covariance_bound(const learned *now) {
	const size_t d = e.rls.n_regressors;
	const int plain = e.config.form == &KOOP(form_plain);
	wide largest = 0;
	for (size_t i = 0; i < d; i++) {
		const wide diagonal = (wide)now->covariance[i * d + i];
		largest = fmax(largest, plain ? diagonal : sqrt(diagonal));
	}
	const wide bound = (wide)e.rls.covariance_bound;
	CHECK(bound >= largest * (1 - 8 * (wide)REAL_EPSILON), "%s: %g", estimator_name(&e), (double)bound);
	CHECK(own_triangles() == 2 || bound <= (wide)d * largest, "%s: %g", estimator_name(&e), (double)bound);
}

static void check_one_step(random_source *random, reference *paper) {
	const size_t d = paper->d, N = paper->N;
	real zeta[MAX_D], psi_next[MAX_N];
	learned now;
	random_fill(random, zeta, d, -1, 1);
	random_fill(random, psi_next, N, -1, 1);
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	(void)reference_update(paper, zeta, psi_next);
	learned_take(&now, &e);
	const double most = 200 * (double)REAL_EPSILON;
	const double P = relative_difference(now.covariance, paper->P, d * d);
	const double theta = relative_difference(now.theta, paper->theta, N * d);
	CHECK(theta <= most && P <= most, "%s, N %zu, d %zu: %g, %g", estimator_name(&e), N, d, theta, P);
}

/* A model that was written by hand goes on as the paper's recursion does from there. */
static void check_loaded(random_source *random, double size) {
	static reference paper;
	learned now;
	reference_start(&paper, &e);
	const real largest = write_theta(random, size);
	write_covariance(random, paper.P, size);
	write_inverse(paper.P, paper.R);
	finish(own_triangles());
	e.rls.positive_definite = 0; /* as KOOP_CHECK_REPORT may have left it: that was another P */
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, model, bytes_of(own_triangles())));
	learned_take(&now, &e);
	check_theta(model, 0, &now);
	check_covariance(model, &now);
	check_covariance_bound(&now);
	CHECK(same_bits(e.rls.theta_bound, largest), "%g", (double)e.rls.theta_bound);
	TEST_ASSERT_TRUE(e.rls.positive_definite == 1);
	if (e.config.checksum) { CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls)); }
	CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, again, sizeof again));
	CHECK(memcmp(model, again, bytes_of(own_triangles())) == 0, "%s", estimator_name(&e));
	for (size_t i = 0; i < paper.N * paper.d; i++) { paper.theta[i] = (wide)now.theta[i]; }
	for (int step = 0; step < 3; step++) { check_one_step(random, &paper); }
}

static void test_model_written_by_hand_goes_on_as_the_paper_does(void) {
	static const double sizes[] = {1.0 / 16, 1, 4};
	random_source random = random_seed(33);
	for (size_t N = 1; N <= MAX_N; N += N < 9 ? 1 : 13) {
		for (size_t k = 0; k < REGULATORS * FORMS; k++) {
			if (all_regulators[k % REGULATORS]->extension) { continue; } /* test_extensions.c has these */
			start(&random, N, 1 + (k + N) % MAX_M, all_regulators[k % REGULATORS], all_forms[k / REGULATORS]);
			check_loaded(&random, sizes[random_below(&random, 3)]);
		}
	}
}

static void test_model_without_covariance_leaves_that_alone(void) {
	random_source random = random_seed(34);
	learned before, after;
	start(&random, 3, 2, &KOOP(reg_ef), &KOOP(form_plain));
	learned_take(&before, &e);
	const real bound = e.rls.covariance_bound, scale = e.rls.covariance_scale;
	(void)write_theta(&random, 4);
	finish(0);
	e.rls.positive_definite = 0;
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, model, bytes_of(0)));
	learned_take(&after, &e);
	check_theta(model, 0, &after);
	TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
	TEST_ASSERT_TRUE(same_bits(bound, e.rls.covariance_bound) && same_bits(scale, e.rls.covariance_scale));
	TEST_ASSERT_TRUE(e.rls.positive_definite == 0);
}

/* ---- What is refused ------------------------------------------------------------------------ */

static void check_status_of_load(size_t size, int expected, const char *what) {
	learned before, after;
	learned_take(&before, &e);
	const int status = KOOP(model_load)(&e.rls, model, size);
	learned_take(&after, &e);
	CHECK(status == expected, "%s, %s: %d", estimator_name(&e), what, status);
	const int same = learned_same_theta(&before, &after, &e) && learned_same_covariance(&before, &after, &e);
	CHECK(status == KOOP_OK || same, "%s, %s", estimator_name(&e), what);
}

/* Each in turn becomes `value`; a diagonal element, or one beside the diagonal. */
static void check_each_element(int diagonal, double value, int expected) {
	const size_t size = bytes_of(own_triangles());
	for (size_t k = 0; k < own_triangles() * e.rls.n_regressors * e.rls.n_regressors; k++) {
		const size_t d = e.rls.n_regressors, t = k / (d * d), i = k / d % d, j = k % d;
		if (j > i || (i == j) != diagonal) { continue; }
		CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, size));
		memcpy(again, model, size);
		stored_put(model + triangle_at(t, i, j), (real)value, 0);
		stored_seal(model, size);
		check_status_of_load(size, expected, "an element");
		CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, again, size));
	}
}

static void test_diagonal_is_taken_down_to_the_smallest_normal_number(void) {
	random_source random = random_seed(35);
	for (size_t k = 0; k < REGULATORS * FORMS; k++) {
		if (all_regulators[k % REGULATORS]->extension) { continue; }
		start(&random, 3, 2, all_regulators[k % REGULATORS], all_forms[k / REGULATORS]);
		check_each_element(1, (double)REAL_MIN, KOOP_OK);
		check_each_element(1, (double)REAL_MIN * (1 - (double)REAL_EPSILON), KOOP_E_MODEL);
		check_each_element(1, -1, KOOP_E_MODEL);
		check_each_element(0, -0.125, KOOP_OK);
		check_each_element(0, 0, KOOP_OK);
		check_each_element(0, (double)NAN, KOOP_E_MODEL);
		check_each_element(0, -(double)INFINITY, KOOP_E_MODEL);
	}
}

static void test_every_changed_header_of_a_model_with_covariance_is_refused(void) {
	random_source random = random_seed(36);
	start(&random, 2, 1, &KOOP(reg_sift), &KOOP(form_plain));
	const size_t size = bytes_of(2);
	CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, size));
	for (size_t i = 0; i < STORED_CHECKSUM_AT; i++) {
		const unsigned char right = model[i];
		for (int value = 0; value < 256; value++) {
			model[i] = (unsigned char)value;
			stored_seal(model, size);
			if (value != right) { check_status_of_load(size, KOOP_E_MODEL, "header"); }
		}
		model[i] = right;
	}
	stored_seal(model, size);
	check_status_of_load(size, KOOP_OK, "as it was");
}

/* The header's number of triangles and the size disagree, or no such number is known. */
static void test_number_of_triangles_is_that_of_the_size(void) {
	random_source random = random_seed(37);
	for (size_t k = 0; k < REGULATORS * FORMS * 12; k++) {
		if (all_regulators[k / 12 % REGULATORS]->extension) { continue; }
		const size_t said = k % 4, there = k / 4 % 3;
		start(&random, 2, 2, all_regulators[k / 12 % REGULATORS], all_forms[k / 12 / REGULATORS]);
		CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, sizeof model));
		const size_t triangle = bytes_of(1) - bytes_of(0);
		if (there > own_triangles()) { memcpy(model + bytes_of(1), model + bytes_of(0), triangle); }
		write_header(model, 2, said);
		stored_seal(model, bytes_of(there));
		const int right = said == there && (said == 0 || said == own_triangles());
		check_status_of_load(bytes_of(there), right ? KOOP_OK : KOOP_E_MODEL, "triangles");
	}
}

/* ---- Format 1: which byte order? ------------------------------------------------------------- */

/* 2^-32 and 2^32 are the last of a usual size. Read the other way round, they and the numbers next to them
 * are none. */
static real number_of_kind(random_source *random, int usual) {
	static const double in[] = {1,  -1.5, 3.25, 4294967296.0, -4294967296.0, 1 / 4294967296.0,
	                            -1 / 4294967296.0};
	static const double out[] = {4294967296.0 * (1 + (double)REAL_EPSILON), 4294967296.0 * 4294967296.0,
	                             (1 - (double)REAL_EPSILON / 2) / 4294967296.0,
	                             -1 / 4294967296.0 / 4294967296.0};
	return (real)(usual ? in[random_below(random, 7)] : out[random_below(random, 4)]);
}

/* 0: zero, 1 and 2: usual in one byte order, 3: in both, 4: in none */
static void write_kind(random_source *random, unsigned char *at, size_t kind) {
	memset(at, 0, sizeof(real));
	if (kind == 1 || kind == 2) { stored_put(at, number_of_kind(random, 1), kind == 2); }
	if (kind == 4) { stored_put(at, number_of_kind(random, 0), random_below(random, 2) == 0); }
	for (size_t i = 0; kind == 3 && i < sizeof(real); i++) { at[i] = random_below(random, 2) ? 0x3F : 0x40; }
}

/* Three quarters of all numbers but zeros are of a usual size, and of those read otherwise less than half. */
static int order_of(const size_t *kinds) {
	const size_t usual[2] = {kinds[1] + kinds[3], kinds[2] + kinds[3]};
	const size_t numbers = kinds[1] + kinds[2] + kinds[3] + kinds[4];
	for (int big_endian = 0; big_endian < 2; big_endian++) {
		if (numbers - usual[big_endian] <= numbers / 4 && usual[!big_endian] < (numbers + 1) / 2) {
			return big_endian;
		}
	}
	return -1;
}

static int theta_is_finite(int big_endian) {
	int finite = 1;
	for (size_t at = STORED_HEADER; at < bytes_of(0); at += sizeof(real)) {
		finite = finite && isfinite(stored_get(model + at, big_endian));
	}
	return finite;
}

/* Numbers mostly of one kind, and some of the others. */
static void write_kinds(random_source *random, size_t *kinds) {
	const size_t most = random_below(random, 5), others = 1 + random_below(random, 4);
	for (size_t at = STORED_HEADER; at < bytes_of(0); at += sizeof(real)) {
		const size_t kind = random_below(random, 4) < others ? random_below(random, 5) : most;
		write_kind(random, model + at, kind);
		kinds[kind]++;
	}
	write_header(model, 1, 0);
	stored_seal(model, bytes_of(0));
}

static void check_format_1(random_source *random) {
	size_t kinds[5] = {0};
	learned now;
	write_kinds(random, kinds);
	const int order = order_of(kinds), right = order >= 0 && theta_is_finite(order);
	check_status_of_load(bytes_of(0), right ? KOOP_OK : KOOP_E_MODEL, "order");
	if (!right) { return; }
	learned_take(&now, &e);
	check_theta(model, order, &now);
	for (size_t i = 0; i < e.rls.n_lifted * e.rls.n_regressors; i++) {
		TEST_ASSERT_TRUE(fabs(now.theta[i]) <= e.rls.theta_bound);
	}
}

static void test_byte_order_of_format_1_is_that_of_numbers_of_a_usual_size(void) {
	random_source random = random_seed(38);
	for (int round = 0; round < 6000 / TEST_SHARE; round++) {
		if (round % 100 == 0) {
			const size_t N = 1 + random_below(&random, 4), m = 1 + random_below(&random, 3);
			start(&random, N, m, &KOOP(reg_ef), &KOOP(form_sqrt));
		}
		check_format_1(&random);
	}
}

/* So is what a sign says of zero. */
static void test_zeros_of_either_sign_say_nothing_of_the_byte_order(void) {
	random_source random = random_seed(39);
	start(&random, 3, 2, &KOOP(reg_ef), &KOOP(form_plain));
	for (size_t at = STORED_HEADER; at < bytes_of(0); at += sizeof(real)) {
		stored_put(model + at, -(real)0, 0);
	}
	stored_put(model + theta_at(1, 3), (real)0.75, 0);
	write_header(model, 1, 0);
	stored_seal(model, bytes_of(0));
	check_status_of_load(bytes_of(0), KOOP_OK, "zeros");
}

static void test_format_1_carries_no_covariance(void) {
	random_source random = random_seed(40);
	start(&random, 3, 2, &KOOP(reg_ef), &KOOP(form_plain));
	for (size_t said = 0; said < 3; said++) {
		CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, bytes_of(1)));
		write_header(model, 1, said);
		stored_seal(model, bytes_of(1));
		check_status_of_load(bytes_of(1), KOOP_E_MODEL, "with P");
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_what_is_saved_is_read_by_the_description_of_the_format);
	RUN_TEST(test_storage_that_is_too_small_is_not_written);
	RUN_TEST(test_model_written_by_hand_goes_on_as_the_paper_does);
	RUN_TEST(test_model_without_covariance_leaves_that_alone);
	RUN_TEST(test_diagonal_is_taken_down_to_the_smallest_normal_number);
	RUN_TEST(test_every_changed_header_of_a_model_with_covariance_is_refused);
	RUN_TEST(test_number_of_triangles_is_that_of_the_size);
	RUN_TEST(test_byte_order_of_format_1_is_that_of_numbers_of_a_usual_size);
	RUN_TEST(test_zeros_of_either_sign_say_nothing_of_the_byte_order);
	RUN_TEST(test_format_1_carries_no_covariance);
	return UNITY_END();
}
