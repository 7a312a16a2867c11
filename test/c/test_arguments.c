/* What each call refuses, and that sizes are exact. */
#include "support.h"

#include <limits.h>

enum { N = 3, M = 2, D = N + M };

static estimator e;
static const real zeta[D] = {1, 2, 3, 4, 5};
static real psi_next[N] = {1, 1, 1};

/* Status of rls_reals() with the settings of `e`; rls_init() must say the same. */
static int status_of_settings(void) {
	size_t reals = 0;
	const int status = KOOP(rls_reals)(&e.config, &reals);
	KOOP(rls) rls;
	const int init = KOOP(rls_init)(&rls, &e.config, e.storage, sizeof e.storage / sizeof e.storage[0]);
	CHECK(init == status, "rls_init() says %d, rls_reals() %d", init, status);
	return status;
}

static void fresh_settings(void) {
	estimator_settings(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
}

static void test_null_pointers_to_an_estimator(void) {
	size_t reals;
	KOOP(health) health;
	real buffer[D * D] = {0};
	unsigned char model[MODEL_BYTES(N, M)];
	KOOP(rls) empty;
	memset(&empty, 0, sizeof empty);

	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	const size_t enough = sizeof e.storage / sizeof e.storage[0];
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_reals)(NULL, &reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_reals)(&e.config, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_init)(NULL, &e.config, e.storage, enough));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_init)(&empty, NULL, e.storage, enough));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_init)(&empty, &e.config, NULL, enough));

	/* twice: without an estimator, and with one that was never initialised */
	for (KOOP(rls) *rls = NULL, *end = &empty;; rls = end) {
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_update)(rls, zeta, zeta, psi_next, &health));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_predict)(rls, zeta, zeta, psi_next));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_reset_covariance)(rls, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_get_theta)(rls, buffer));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_set_theta)(rls, buffer));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_copy_theta)(rls, buffer));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_get_covariance)(rls, buffer));
		CHECK_STATUS(KOOP_E_NULL, KOOP(model_save)(rls, model, sizeof model));
		CHECK_STATUS(KOOP_E_NULL, KOOP(model_load)(rls, model, sizeof model));
		if (rls == end) { break; }
	}

	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_update)(&e.rls, NULL, zeta, psi_next, &health));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_update)(&e.rls, zeta, NULL, psi_next, &health));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_update)(&e.rls, zeta, zeta, NULL, &health));
	CHECK_STATUS(KOOP_OK, KOOP(rls_update)(&e.rls, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_predict)(&e.rls, NULL, zeta, psi_next));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_predict)(&e.rls, zeta, NULL, psi_next));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_predict)(&e.rls, zeta, zeta, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_get_theta)(&e.rls, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_set_theta)(&e.rls, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_copy_theta)(&e.rls, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_get_covariance)(&e.rls, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(model_save)(&e.rls, NULL, sizeof model));
	CHECK_STATUS(KOOP_E_NULL, KOOP(model_load)(&e.rls, NULL, sizeof model));
}

static void test_null_pointers_in_the_settings(void) {
	fresh_settings();
	e.config.dictionary = NULL;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());
	fresh_settings();
	e.config.regulator = NULL;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());
	fresh_settings();
	e.config.form = NULL;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());
	fresh_settings();
	e.dictionary.lift = NULL;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());
	fresh_settings();
	e.dictionary.name = NULL;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());

	fresh_settings();
	KOOP(regulator) undecided = KOOP(reg_ef);
	undecided.decide = NULL;
	e.config.regulator = &undecided;
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, status_of_settings());
}

static void test_null_pointers_elsewhere(void) {
	real score = 1, delta;
	const real x[3] = {0, 0, 0};
	real psi[7];
	CHECK_STATUS(KOOP_E_NULL, KOOP(lift)(NULL, x, psi));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lift)(&KOOP(poly_ddr), NULL, psi));
	CHECK_STATUS(KOOP_E_NULL, KOOP(lift)(&KOOP(poly_ddr), x, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(threshold)(NULL, 1, 0, &delta));
	CHECK_STATUS(KOOP_E_NULL, KOOP(threshold)(&score, 1, 0, NULL));

	fresh_settings();
	e.dictionary.lift = NULL;
	CHECK_STATUS(KOOP_E_NULL, KOOP(lift)(&e.dictionary, zeta, psi));
	fresh_settings();
	e.dictionary.name = NULL;
	CHECK_STATUS(KOOP_E_NULL, KOOP(lift)(&e.dictionary, zeta, psi));
}

static void test_sizes(void) {
	static const struct {
		size_t n, N, m;
		int status;
	} cases[] = {
	    {0, 3, 1, KOOP_E_SIZE},
	    {4, 3, 1, KOOP_E_SIZE}, /* psi begins with x */
	    {0, 0, 1, KOOP_E_SIZE},
	    {1, KOOP_MAX_DIM + 1, 1, KOOP_E_SIZE},
	    {1, KOOP_MAX_DIM, 1, KOOP_E_SIZE}, /* d counts too */
	    {1, (size_t)-1, 1, KOOP_E_SIZE},
	    {3, 3, 0, KOOP_E_SIZE},
	    {3, 3, KOOP_MAX_DIM - 2, KOOP_E_SIZE},
	    {3, 3, (size_t)-1, KOOP_E_SIZE}, /* d would wrap around */
	    {3, 3, (size_t)-3, KOOP_E_SIZE},
	    {1, 1, 1, KOOP_OK},
	    {3, 3, KOOP_MAX_DIM - 3, KOOP_OK},
	    {254, 254, 1, KOOP_OK},
	};
	for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
		size_t reals;
		fresh_settings();
		e.dictionary.n_states = cases[i].n;
		e.dictionary.n_lifted = cases[i].N;
		e.config.n_inputs = cases[i].m;
		const int status = KOOP(rls_reals)(&e.config, &reals);
		CHECK(status == cases[i].status, "case %u: %d", (unsigned)i, status);
	}
	fresh_settings();
	e.dictionary.n_states = 0;
	CHECK_STATUS(KOOP_E_SIZE, KOOP(lift)(&e.dictionary, zeta, psi_next));
}

static void test_ranges_of_settings(void) {
	const real nan = (real)NAN, inf = (real)INFINITY;
	enum { LAMBDA, P0, DELTA, TAU0, EPS };
	const struct {
		int field;
		real value;
		int status;
	} cases[] = {
	    {LAMBDA, 0, KOOP_E_RANGE},
	    {LAMBDA, (real)-0.5, KOOP_E_RANGE},
	    {LAMBDA, 1 + REAL_EPSILON, KOOP_E_RANGE},
	    {LAMBDA, nan, KOOP_E_RANGE},
	    {LAMBDA, inf, KOOP_E_RANGE},
	    {LAMBDA, 1, KOOP_OK},
	    {LAMBDA, (real)0.01, KOOP_OK},
	    {P0, 0, KOOP_E_RANGE},
	    {P0, -1, KOOP_E_RANGE},
	    {P0, nan, KOOP_E_RANGE},
	    {P0, inf, KOOP_E_RANGE},
	    {P0, REAL_MAX, KOOP_E_RANGE},
	    {P0, REAL_MAX / 2, KOOP_E_RANGE},
	    {P0, REAL_MAX / 4, KOOP_OK}, /* the trace is not finite, and no regulator but ct needs it */
	    {P0, REAL_MIN / 2, KOOP_E_RANGE},
	    {P0, REAL_MIN, KOOP_OK},
	    {P0, (real)1e6, KOOP_OK},
	    {DELTA, -REAL_MIN, KOOP_E_RANGE},
	    {DELTA, -1, KOOP_E_RANGE},
	    {DELTA, nan, KOOP_E_RANGE},
	    {DELTA, inf, KOOP_E_RANGE},
	    {DELTA, 0, KOOP_OK},
	    {TAU0, -1, KOOP_E_RANGE},
	    {TAU0, nan, KOOP_E_RANGE},
	    {TAU0, inf, KOOP_E_RANGE},
	    {TAU0, REAL_MAX, KOOP_E_RANGE},
	    {TAU0, 0, KOOP_OK},
	    {EPS, -1, KOOP_E_RANGE},
	    {EPS, nan, KOOP_E_RANGE},
	    {EPS, inf, KOOP_E_RANGE},
	    {EPS, 0, KOOP_OK},
	};
	for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
		fresh_settings();
		static const KOOP(regulator) *const owners[] = {&KOOP(reg_ef), &KOOP(reg_ef), &KOOP(reg_dz_ks),
		                                                &KOOP(reg_ct), &KOOP(reg_sift)};
		real *const fields[] = {&e.config.lambda, &e.config.p0, &e.dead_zone.delta, &e.trace.tau0,
		                        &e.floor.eps_sift};
		estimator_settings(&e, N, M, owners[cases[i].field], &KOOP(form_plain));
		*fields[cases[i].field] = cases[i].value;
		const int status = status_of_settings();
		CHECK(status == cases[i].status, "field %d = %g: %d", cases[i].field, (double)cases[i].value, status);
	}
	for (int check = -1; check <= 3; check++) {
		fresh_settings();
		e.config.check = check;
		TEST_ASSERT_EQUAL_INT(check < 0 || check > 2 ? KOOP_E_RANGE : KOOP_OK, status_of_settings());
	}
}

/* An estimator in use that is to be made anew with settings that are refused goes on as it was. */
static void test_refused_settings_leave_the_estimator(void) {
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	static estimator before;
	before = e;
	KOOP(dictionary) larger = e.dictionary;
	larger.n_states = larger.n_lifted = 2 * N;
	for (int refused = 0; refused < 3; refused++) {
		KOOP(config) config = e.config;
		size_t reals = sizeof e.storage / sizeof(real);
		config.dictionary = &larger;
		if (refused == 2) {
			CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&config, &reals));
			reals--;
		}
		config.lambda = refused == 0 ? 0 : config.lambda;
		config.p0 = refused == 1 ? REAL_MAX / 2 : config.p0;
		CHECK_STATUS(refused == 2 ? KOOP_E_STORAGE : KOOP_E_RANGE,
		             KOOP(rls_init)(&e.rls, &config, e.storage, reals));
		TEST_ASSERT_EQUAL_MEMORY(&before, &e, sizeof e);
	}
}

static void test_reset_takes_what_settings_take(void) {
	static const double bad[] = {
	    0, -1, (double)NAN, (double)INFINITY, (double)REAL_MAX, (double)REAL_MAX / 2, (double)REAL_MIN / 2};
	learned before, after;
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	learned_take(&before, &e);
	for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_reset_covariance)(&e.rls, (real)bad[i]));
	}
	learned_take(&after, &e);
	TEST_ASSERT_TRUE(learned_same_covariance(&before, &after, &e));
}

static void test_storage_is_exact(void) {
	static const size_t sizes[][2] = {{1, 1}, {3, 2}, {4, 4 - 1}, {7, 2}, {8, 1}, {MAX_N, MAX_M}};
	static real supervised[KOOP_RLS_REALS_PLAIN(MAX_N, MAX_M) + 1];
	const real mark = (real)12345.678;
	random_source random = random_seed(1);

	for (size_t s = 0; s < sizeof sizes / sizeof sizes[0]; s++) {
		for (int r = 0; r < REGULATORS; r++) {
			if (all_regulators[r]->extension) { continue; } /* test_extensions.c has these */
			for (int f = 0; f < FORMS; f++) {
				for (int check = 0; check < 3; check++) {
					const size_t n_lifted = sizes[s][0], m = sizes[s][1];
					size_t reals = 0;
					estimator_settings(&e, n_lifted, m, all_regulators[r], all_forms[f]);
					e.config.check = check;
					CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reals));

					const size_t plain = KOOP_RLS_REALS_PLAIN(n_lifted, m);
					const size_t root = KOOP_RLS_REALS_SQRT(n_lifted, m);
					const size_t macro = e.config.form == &KOOP(form_sqrt) ? root : plain;
					CHECK(macro >= reals, "%s: %u < %u", estimator_name(&e), (unsigned)macro,
					      (unsigned)reals);
					if (e.config.form == &KOOP(form_sqrt)) { CHECK(reals == root, "sqrt wastes storage"); }
					if (e.config.regulator == &KOOP(reg_sift) &&check != KOOP_CHECK_DIAGONAL &&
					    e.config.form == &KOOP(form_plain)) {
						CHECK(reals == plain, "the macro is not what the largest case needs");
					}

					CHECK_STATUS(KOOP_E_STORAGE, KOOP(rls_init)(&e.rls, &e.config, supervised, reals - 1));
					CHECK_STATUS(KOOP_E_STORAGE, KOOP(rls_init)(&e.rls, &e.config, supervised, 0));
					supervised[reals] = mark;
					CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&e.rls, &e.config, supervised, reals));
					for (int k = 0; k < 5; k++) {
						real x[MAX_D], y[MAX_N];
						random_fill(&random, x, n_lifted + m, -1, 1);
						random_fill(&random, y, n_lifted, -1, 1);
						CHECK_STATUS(KOOP_OK, estimator_update(&e, x, y, NULL));
					}
					CHECK(memcmp(&supervised[reals], &mark, sizeof mark) == 0, "%s wrote past its storage",
					      estimator_name(&e));
				}
			}
		}
	}
}

static void test_plain_form_pays_only_for_what_it_uses(void) {
	size_t with_factor = 0, without = 0, sift = 0;
	estimator_settings(&e, 22, 2, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &with_factor));
	e.config.check = KOOP_CHECK_DIAGONAL;
	CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &without));
	e.config.regulator = &KOOP(reg_sift);
	CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &sift));
	TEST_ASSERT_TRUE(with_factor == without + KOOP_TRIANGLE(24));
	TEST_ASSERT_TRUE(sift == without + KOOP_SYMMETRIC(24));
}

/* What each regulator and check needs of storage: P, P^-1 for SIFt alone, and a factor where P is factored.
 */
static void test_plain_form_needs_what_is_said(void) {
	for (int r = 0; r < REGULATORS; r++) {
		if (all_regulators[r]->extension) { continue; } /* test_extensions.c has these */
		for (int check = 0; check < 3; check++) {
			size_t reals = 0;
			estimator_settings(&e, 5, 2, all_regulators[r], &KOOP(form_plain));
			e.config.check = check;
			CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reals));
			const size_t matrices = all_regulators[r] == &KOOP(reg_sift) ? 2 : 1;
			const size_t factor = check == KOOP_CHECK_DIAGONAL ? 0 : KOOP_TRIANGLE(7);
			const size_t expected = KOOP_RLS_REALS(5, 7, matrices * KOOP_SYMMETRIC(7) + factor);
			CHECK(reals == expected, "%s: %u instead of %u", estimator_name(&e), (unsigned)reals,
			      (unsigned)expected);
		}
	}
}

static void test_each_status_has_its_own_message(void) {
	for (int a = KOOP_E_ARITHMETIC; a <= KOOP_OK; a++) {
		const char *message = KOOP(status_message)(a);
		TEST_ASSERT_NOT_NULL(message);
		TEST_ASSERT_TRUE(strlen(message) > 1);
		TEST_ASSERT_TRUE(strcmp(message, KOOP(status_message)(1)) != 0);
		TEST_ASSERT_TRUE(strcmp(message, OTHER(status_message)(a)) == 0);
		for (int b = KOOP_E_ARITHMETIC; b < a; b++) {
			TEST_ASSERT_TRUE(strcmp(message, KOOP(status_message)(b)) != 0);
		}
	}
}

static void test_what_is_no_status_is_called_unknown(void) {
	static const int none[] = {1, 2, INT_MAX, KOOP_E_ARITHMETIC - 1, KOOP_E_ARITHMETIC - 2, -1000, INT_MIN};
	for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
		TEST_ASSERT_EQUAL_STRING("unknown status", KOOP(status_message)(none[i]));
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_null_pointers_to_an_estimator);
	RUN_TEST(test_null_pointers_in_the_settings);
	RUN_TEST(test_null_pointers_elsewhere);
	RUN_TEST(test_sizes);
	RUN_TEST(test_ranges_of_settings);
	RUN_TEST(test_refused_settings_leave_the_estimator);
	RUN_TEST(test_reset_takes_what_settings_take);
	RUN_TEST(test_storage_is_exact);
	RUN_TEST(test_plain_form_pays_only_for_what_it_uses);
	RUN_TEST(test_each_status_has_its_own_message);
	RUN_TEST(test_what_is_no_status_is_called_unknown);
	RUN_TEST(test_plain_form_needs_what_is_said);
	return UNITY_END();
}
