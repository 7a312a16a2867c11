/* Regulators with settings, a memory, a decision that needs zeta' P zeta, and further changes of P: what they may
 * do, and that a refused sample leaves everything as it was. */
#include "reference.h"

enum { N = 3, M = 2, D = N + M, REALS = 2 * KOOP_RLS_REALS_PLAIN(N, M) + 2 * KOOP_PAD(D + 2) };

/* Their arrays are of the sizes above, so that all of this fits the memory of a microcontroller. */
static estimator e;
static unsigned char model[MODEL_BYTES_P(N, M) + (D + 2) * sizeof(real)];

/* ---- A regulator that uses all of it --------------------------------------------------- */

/* What `everything` is to do: not settings of reals, so it is not in the list of settings. */
static struct {
	int refuse_in; /* 0: nowhere, 1: decide, 2: adjust, 3: reshape, at its end */
	int unlearned; /* 1: neither Theta nor P is changed */
	real lambda, weight, noise;
	real information, covariance, factor, p0; /* of reshape; 0: not */
	real s; /* as adjust was given it */
} plan;

static size_t memory_reals(const KOOP(rls) *rls) {
	return rls->n_regressors + 2; /* a vector, a counter, a sum */
}

static void start_memory(KOOP(rls) *rls) {
	rls->memory[rls->n_regressors + 1] = rls->config.form->element(rls, 0, 0);
}

static int decide_first(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	rls->memory[rls->n_regressors] += 1;
	rls->memory[rls->n_regressors + 1] += innovation;
	step->update_theta = step->update_covariance = !plan.unlearned;
	return plan.refuse_in == 1 ? KOOP_E_RANGE : KOOP_OK;
}

static int adjust_then(KOOP(rls) *rls, real s, KOOP(step) *step) {
	plan.s = s;
	for (size_t i = 0; i < rls->n_regressors; i++) { rls->memory[i] += rls->gain[i]; }
	step->noise = plan.noise < 0 || plan.noise > 0 ? plan.noise : plan.lambda;
	step->scale = 1 / plan.lambda;
	step->weight = plan.weight;
	return plan.refuse_in == 2 ? KOOP_E_RANGE : KOOP_OK;
}

static int reshape_last(KOOP(rls) *rls) {
	real unit[MAX_D] = {0};
	unit[1] = 1;
	int status = KOOP_OK;
	if (plan.p0 > 0) { rls->config.form->reset(rls, plan.p0); }
	if (plan.factor > 0) { status = KOOP(rls_scale_covariance)(rls, plan.factor); }
	if (status == KOOP_OK && plan.information > 0) {
		status = KOOP(rls_add_information)(rls, unit, plan.information);
	}
	if (status == KOOP_OK && plan.covariance > 0) {
		status = KOOP(rls_add_covariance)(rls, rls->memory, plan.covariance);
	}
	return status == KOOP_OK && plan.refuse_in == 3 ? KOOP_E_RANGE : status;
}

static const KOOP(extension) all_of_it = {&KOOP(reg_engine), memory_reals, start_memory, adjust_then, reshape_last};
static const KOOP(extension) memory_only = {&KOOP(reg_engine), memory_reals, NULL, NULL, NULL};
static const KOOP(extension) reshape_only = {&KOOP(reg_engine), NULL, NULL, NULL, reshape_last};
static const KOOP(regulator) everything = {.name = "everything", .decide = decide_first, .extension = &all_of_it};
static const KOOP(regulator) remembers = {.name = "remembers", .decide = decide_first, .extension = &memory_only};

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form) {
	memset(&plan, 0, sizeof plan);
	plan.lambda = (real)0.9;
	plan.weight = 1;
	estimator_settings(&e, N, M, regulator, form);
	e.config.checksum = 1;
	estimator_start(&e);
}

static void sample(random_source *random, real *zeta, real *psi_next) {
	random_fill(random, zeta, D, -1, 1);
	random_fill(random, psi_next, N, -1, 1);
}

static void teach(random_source *random, int samples) {
	for (int k = 0; k < samples; k++) {
		real zeta[D], psi_next[N];
		sample(random, zeta, psi_next);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
	}
}

/* ---- Atomic ---------------------------------------------------------------------------------- */

/* All that is kept, and the numbers beside it. */
typedef struct {
	real kept[REALS];
	KOOP(rls) rls;
} snapshot;

static snapshot taken;

static void take_snapshot(void) {
	TEST_ASSERT_TRUE(e.rls.kept <= REALS);
	memcpy(taken.kept, e.rls.theta, e.rls.kept * sizeof(real));
	taken.rls = e.rls;
}

static void check_same(const char *where) {
	CHECK(memcmp(taken.kept, e.rls.theta, e.rls.kept * sizeof(real)) == 0, "%s, %s", estimator_name(&e), where);
	KOOP(rls) now = e.rls;
	now.gain_square = taken.rls.gain_square; /* scratch */
	CHECK(memcmp(&taken.rls, &now, sizeof now) == 0, "%s, %s", estimator_name(&e), where);
	CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
	TEST_ASSERT_EQUAL_size_t(0, e.rls.repaired);
}

static void test_refusal_leaves_memory_and_covariance(void) {
	for (int f = 0; f < FORMS; f++) {
		for (int where = 1; where <= 5; where++) {
			random_source random = random_seed(71);
			real zeta[D], psi_next[N];
			KOOP(health) health;
			start(&everything, all_forms[f]);
			plan.factor = (real)1.01, plan.information = (real)0.1, plan.covariance = (real)0.01;
			teach(&random, 20);
			take_snapshot();
			sample(&random, zeta, psi_next);
			plan.refuse_in = where <= 3 ? where : 0;
			if (where == 4) { plan.information = 1 / REAL_MAX; } /* P has been scaled by then */
			if (where == 5) { plan.weight = REAL_MAX; }          /* Theta does not fit */
			const int expected = where <= 4 ? KOOP_E_RANGE : KOOP_E_OVERFLOW;
			CHECK_STATUS(expected, estimator_update(&e, zeta, psi_next, &health));
			check_same(where == 1 ? "decide" : where == 2 ? "adjust" : "reshape");
			plan.refuse_in = 0, plan.information = (real)0.1, plan.weight = 1;
			CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, &health));
			TEST_ASSERT_EQUAL_INT(0, health.frozen);
		}
	}
}

/* Memory goes on where the model does not, and its checksum with it. */
static void test_memory_of_a_sample_that_is_not_learned(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(72);
		learned before, after;
		start(&remembers, all_forms[f]);
		learned_take(&before, &e);
		plan.unlearned = 1;
		teach(&random, 7);
		learned_take(&after, &e);
		TEST_ASSERT_TRUE(learned_same_theta(&before, &after, &e) && learned_same_covariance(&before, &after, &e));
		TEST_ASSERT_TRUE(e.rls.memory[D] > 6 && e.rls.memory[D] < 8);
		plan.unlearned = 0;
		teach(&random, 1);
		learned_take(&after, &e);
		TEST_ASSERT_FALSE(learned_same_theta(&before, &after, &e));
		take_snapshot();
		real zeta[D], psi_next[N];
		sample(&random, zeta, psi_next);
		plan.refuse_in = 1;
		CHECK_STATUS(KOOP_E_RANGE, estimator_update(&e, zeta, psi_next, NULL));
		check_same("memory alone");
	}
}

static void test_flipped_bit_of_memory_is_repaired(void) {
	random_source random = random_seed(73);
	start(&everything, &KOOP(form_sqrt));
	teach(&random, 5);
	real memory[D + 2];
	memcpy(memory, e.rls.memory, sizeof memory);
	((unsigned char *)(e.rls.memory + D))[2] ^= 16;
	CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&e.rls));
	TEST_ASSERT_EQUAL_size_t(1, e.rls.repaired);
	TEST_ASSERT_EQUAL_MEMORY(memory, e.rls.memory, sizeof memory);
}

/* The gate compares the saved model on the same sample, after P has been reshaped. */
static void test_reshape_leaves_the_regressor(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(82);
		real zeta[D], psi_next[N];
		start(&everything, all_forms[f]);
		plan.information = plan.factor = (real)1.01;
		sample(&random, zeta, psi_next);
		CHECK_STATUS(KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
		TEST_ASSERT_EQUAL_MEMORY(zeta, e.rls.zeta, sizeof zeta);
	}
}

/* ---- Storage, reset, copies, stored models ------------------------------------------------------- */

static void test_storage_grows_by_what_is_said(void) {
	for (int f = 0; f < FORMS; f++) {
		size_t bare, memory, all, reshape;
		const KOOP(regulator) reshapes = {.name = "reshapes", .decide = decide_first, .extension = &reshape_only};
		start(&KOOP(reg_none), all_forms[f]);
		const size_t P = e.config.form->reals(&e.rls);
		CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &bare));
		e.config.regulator = &remembers;
		CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &memory));
		e.config.regulator = &everything;
		CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &all));
		e.config.regulator = &reshapes;
		CHECK_STATUS(KOOP_OK, KOOP(rls_reals)(&e.config, &reshape));
		TEST_ASSERT_EQUAL_size_t(bare + 2 * KOOP_PAD(D + 2), memory);
		TEST_ASSERT_EQUAL_size_t(bare + P + 2 * KOOP_PAD(D) + 4, reshape);
		TEST_ASSERT_EQUAL_size_t(reshape + 2 * KOOP_PAD(D + 2), all);
		e.storage[all] = 42;
		e.config.regulator = &everything;
		CHECK_STATUS(KOOP_E_STORAGE, KOOP(rls_init)(&e.rls, &e.config, e.storage, all - 1));
		CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&e.rls, &e.config, e.storage, all));
		random_source random = random_seed(74);
		plan.factor = plan.information = (real)1.01;
		teach(&random, 5);
		TEST_ASSERT_TRUE(e.storage[all] > 41 && e.storage[all] < 43);
	}
}

static void test_reset_of_covariance_restarts_the_memory(void) {
	random_source random = random_seed(75);
	start(&everything, &KOOP(form_plain));
	teach(&random, 5);
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&e.rls, 7));
	for (size_t i = 0; i <= D; i++) { TEST_ASSERT_TRUE(e.rls.memory[i] >= 0 && e.rls.memory[i] <= 0); }
	CHECK(fabs((double)e.rls.memory[D + 1] - 7) < 1e-5, "%g", (double)e.rls.memory[D + 1]);
}

/* A stored model brings the memory back with P, and another regulator's is refused. */
static void test_stored_model_has_the_memory(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(76);
		start(&everything, all_forms[f]);
		teach(&random, 12);
		real memory[D + 2];
		memcpy(memory, e.rls.memory, sizeof memory);
		CHECK_STATUS(KOOP_E_STORAGE, KOOP(model_save_covariance)(&e.rls, model, sizeof model - 1));
		CHECK_STATUS(KOOP_OK, KOOP(model_save_covariance)(&e.rls, model, sizeof model));
		estimator_default(&e, N, M, &everything, all_forms[f]);
		CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, model, sizeof model));
		TEST_ASSERT_EQUAL_MEMORY(memory, e.rls.memory, sizeof memory);
		estimator_default(&e, N, M, &remembers, all_forms[f]);
		CHECK_STATUS(KOOP_E_MODEL, KOOP(model_load)(&e.rls, model, sizeof model));
		estimator_default(&e, N, M, &KOOP(reg_ef), all_forms[f]);
		CHECK_STATUS(KOOP_E_MODEL, KOOP(model_load)(&e.rls, model, sizeof model));
	}
}

/* Theta alone is what it always was, and leaves the memory. */
static void test_stored_theta_leaves_the_memory(void) {
	random_source random = random_seed(77);
	start(&everything, &KOOP(form_sqrt));
	teach(&random, 12);
	real memory[D + 2];
	memcpy(memory, e.rls.memory, sizeof memory);
	CHECK_STATUS(KOOP_OK, KOOP(model_save)(&e.rls, model, MODEL_BYTES(N, M)));
	CHECK_STATUS(KOOP_OK, KOOP(model_load)(&e.rls, model, MODEL_BYTES(N, M)));
	TEST_ASSERT_EQUAL_MEMORY(memory, e.rls.memory, sizeof memory);
}

/* Each gate has its copy of the memory; one of another size belongs to another estimator. */
static size_t more_reals(const KOOP(rls) *rls) {
	return (size_t)((const KOOP(dead_zone) *)rls->config.settings)->delta;
}

static void test_gate_saves_the_memory(void) {
	static real storage[REALS];
	static KOOP(gate) gate;
	random_source random = random_seed(78);
	start(&everything, &KOOP(form_plain));
	teach(&random, 12);
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
	TEST_ASSERT_EQUAL_MEMORY(e.rls.memory, gate.saved.memory, (D + 2) * sizeof(real));

	static const KOOP(setting) size = {"size", 1, 20};
	static const KOOP(dead_zone) four = {4}, eight = {8};
	static const KOOP(extension) grows = {&KOOP(reg_engine), more_reals, NULL, NULL, NULL};
	static const KOOP(regulator) grown = {
	    .name = "grown", .decide = decide_first, .settings = &size, .n_settings = 1, .defaults = &four, .extension = &grows};
	plan.unlearned = 1;
	estimator_settings(&e, 1, 1, &grown, &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&e.rls, &e.config, e.storage, REALS));
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
	e.config.settings = &eight;
	CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&e.rls, &e.config, e.storage, REALS));
	const real zeta[2] = {0}, psi_next[1] = {0};
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &e.rls, zeta, zeta + 1, psi_next, NULL));
}

/* ---- What they do to P, against wide arithmetic ---------------------------------------------------- */

static void invert(wide *matrix) {
	wide inverse[D * D] = {0};
	for (size_t i = 0; i < D; i++) { inverse[i * D + i] = 1; }
	solve_positive_definite(matrix, D, inverse, D);
	memcpy(matrix, inverse, sizeof inverse);
}

static void add(wide *P, wide a, const wide *x) {
	for (size_t i = 0; i < D * D; i++) { P[i] += a * x[i / D] * x[i % D]; }
}

/* One step with noise, scale and weight of its own, then scaling, information and covariance. */
static void expect(wide *theta, wide *P, const real *zeta, const real *psi_next, const real *memory) {
	wide g[D], s = 0, v[D], unit[D] = {0};
	for (size_t i = 0; i < D; i++) {
		g[i] = 0;
		for (size_t j = 0; j < D; j++) { g[i] += P[i * D + j] * (wide)zeta[j]; }
		s += (wide)zeta[i] * g[i];
		v[i] = (wide)memory[i];
	}
	const wide noise = plan.noise < 0 || plan.noise > 0 ? (wide)plan.noise : (wide)plan.lambda;
	for (size_t i = 0; i < N; i++) {
		wide error = (wide)psi_next[i];
		for (size_t j = 0; j < D; j++) { error -= theta[i * D + j] * (wide)zeta[j]; }
		for (size_t j = 0; j < D; j++) { theta[i * D + j] += (wide)plan.weight * error * g[j] / fabs(noise + s); }
	}
	add(P, -1 / (noise + s), g);
	for (size_t i = 0; i < D * D; i++) { P[i] *= 1 / (wide)plan.lambda; }
	for (size_t i = 0; i < D * D && plan.factor > 0; i++) { P[i] *= (wide)plan.factor; }
	if (plan.information > 0) {
		unit[1] = 1;
		invert(P);
		add(P, (wide)plan.information, unit);
		invert(P);
	}
	if (plan.covariance > 0) { add(P, (wide)plan.covariance, v); }
	CHECK(fabs(s / (wide)plan.s - 1) < 1000 * (double)REAL_EPSILON, "s is %g, not %g", (double)plan.s, (double)s);
}

static void test_steps_and_further_changes_are_what_is_said(void) {
	for (int kind = 0; kind < 16 * FORMS; kind++) {
		random_source random = random_seed(80 + (uint64_t)kind);
		wide theta[N * D] = {0}, P[D * D] = {0};
		start(&everything, all_forms[kind % FORMS]);
		for (size_t i = 0; i < D; i++) { P[i * D + i] = (wide)e.config.p0; }
		plan.factor = kind / 2 % 2 ? (real)1.1 : 0;
		plan.information = kind / 4 % 2 ? (real)0.2 : 0;
		plan.covariance = kind / 8 % 2 ? (real)0.001 : 0;
		for (int k = 0; k < 12; k++) {
			real zeta[D], psi_next[N];
			learned now;
			sample(&random, zeta, psi_next);
			plan.lambda = random_uniform(&random, 0.8, 1);
			plan.weight = random_uniform(&random, 0, 1);
			if (kind / 16) { plan.noise = k % 3 == 0 ? -1000000 : 0; } /* P grows along the gain */
			const int status = estimator_update(&e, zeta, psi_next, NULL);
			CHECK(status == KOOP_OK, "%s kind %d step %d: status %d", estimator_name(&e), kind, k, status);
			expect(theta, P, zeta, psi_next, e.rls.memory);
			learned_take(&now, &e);
			const double off = relative_difference(now.covariance, P, D * D), moved = relative_difference(now.theta, theta, N * D);
			CHECK(off < 3000 * (double)REAL_EPSILON, "%s kind %d step %d: P %g epsilon", estimator_name(&e), kind, k,
			      off / (double)REAL_EPSILON);
			CHECK(moved < 3000 * (double)REAL_EPSILON, "%s kind %d step %d: Theta %g epsilon", estimator_name(&e), kind, k,
			      moved / (double)REAL_EPSILON);
		}
	}
}

/* A negative noise may not leave a positive denominator: P would become indefinite. */
static void test_negative_noise_beyond_the_denominator_is_refused(void) {
	for (int f = 0; f < FORMS; f++) {
		for (int beyond = 0; beyond < 2; beyond++) {
			const real zeta[D] = {1}, psi_next[N] = {1};
			start(&everything, all_forms[f]);
			e.config.check = KOOP_CHECK_DIAGONAL;
			estimator_start(&e);
			plan.noise = beyond ? -5 : -20; /* s is 10 */
			CHECK_STATUS(beyond ? KOOP_E_INDEFINITE : KOOP_OK, estimator_update(&e, zeta, psi_next, NULL));
			learned now;
			learned_take(&now, &e);
			const double expected = beyond ? 10 : (10 + 100 / 10.0) / 0.9;
			CHECK(fabs((double)now.covariance[0] / expected - 1) < 1e-5, "%g", (double)now.covariance[0]);
		}
	}
}

static void test_covariance_resetting(void) {
	for (int f = 0; f < FORMS; f++) {
		random_source random = random_seed(79);
		learned now;
		start(&everything, all_forms[f]);
		teach(&random, 12);
		plan.p0 = 16;
		teach(&random, 1);
		learned_take(&now, &e);
		for (size_t i = 0; i < D * D; i++) { CHECK(fabs((double)now.covariance[i] - (i % (D + 1) ? 0 : 16)) < 1e-9, "%zu", i); }
	}
}

/* ---- Arguments ----------------------------------------------------------------------------------------- */

static void test_further_changes_check_what_they_get(void) {
	static const double bad[] = {0, -1, (double)NAN, (double)INFINITY};
	for (int f = 0; f < FORMS; f++) {
		real v[D] = {1, 1, 0, 1, 1}, lost[D] = {1, (real)NAN}, huge[D] = {REAL_MAX};
		KOOP(rls) none = {0};
		start(&everything, all_forms[f]);
		take_snapshot();
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_add_information)(NULL, v, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_add_information)(&none, v, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_add_information)(&e.rls, NULL, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_add_covariance)(NULL, v, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_scale_covariance)(NULL, 1));
		CHECK_STATUS(KOOP_E_NULL, KOOP(rls_scale_covariance)(&none, 1));
		for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
			CHECK_STATUS(i < 3 ? KOOP_E_RANGE : KOOP_E_OVERFLOW, KOOP(rls_add_covariance)(&e.rls, v, (real)bad[i]));
			CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_scale_covariance)(&e.rls, (real)bad[i]));
		}
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_add_information)(&e.rls, v, 1 / REAL_MAX));
		CHECK_STATUS(KOOP_E_INPUT, KOOP(rls_add_information)(&e.rls, lost, 1));
		CHECK_STATUS(KOOP_E_INPUT, KOOP(rls_add_covariance)(&e.rls, lost, 1));
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(rls_add_information)(&e.rls, huge, 1));
		CHECK_STATUS(KOOP_E_OVERFLOW, KOOP(rls_add_covariance)(&e.rls, huge, 1));
		check_same("arguments");
	}
}

/* Its inverse must be below a quarter of the largest number. */
static void test_the_least_information_is_taken(void) {
	for (int f = 0; f < FORMS; f++) {
		const real nothing[D] = {0}, largest = REAL_MAX / 4;
		start(&everything, all_forms[f]);
		CHECK_STATUS(KOOP_OK, KOOP(rls_add_information)(&e.rls, nothing, (1 + 4 * REAL_EPSILON) / largest));
		CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_add_information)(&e.rls, nothing, (1 - 4 * REAL_EPSILON) / largest));
	}
}

/* Settings: as many as are listed, each within its bounds; all regulators of the list. */
static void test_settings_of_all_regulators(void) {
	for (int r = 0; r < REGULATORS; r++) {
		const KOOP(regulator) *regulator = all_regulators[r];
		const real *defaults = (const real *)regulator->defaults;
		real settings[8] = {0};
		TEST_ASSERT_TRUE(regulator->n_settings <= 8);
		for (int f = 0; f < FORMS; f++) {
			for (size_t i = 0; i < regulator->n_settings; i++) {
				const KOOP(setting) *s = &regulator->settings[i];
				const real below = (real)((double)s->low - 1e-3 - 1e-3 * fabs((double)s->low));
				const real outside[] = {below, (real)NAN, (real)INFINITY, -(real)INFINITY};
				CHECK(strlen(s->name) > 0 && defaults[i] >= s->low && defaults[i] <= s->high, "%s", regulator->name);
				for (size_t k = 0; k < sizeof outside / sizeof *outside; k++) {
					memcpy(settings, defaults, regulator->n_settings * sizeof(real));
					settings[i] = outside[k];
					estimator_settings(&e, N, M, regulator, all_forms[f]);
					e.config.settings = settings;
					CHECK_STATUS(KOOP_E_RANGE, KOOP(rls_init)(&e.rls, &e.config, e.storage, REALS));
				}
			}
			estimator_settings(&e, N, M, regulator, all_forms[f]);
			e.config.settings = NULL;
			CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&e.rls, &e.config, e.storage, REALS));
			TEST_ASSERT_TRUE(e.rls.config.settings == regulator->defaults);
			random_source random = random_seed(81);
			teach(&random, 30);
		}
	}
	KOOP(regulator) lacking = KOOP(reg_dz_cs);
	lacking.defaults = NULL;
	estimator_settings(&e, N, M, &lacking, &KOOP(form_plain));
	e.config.settings = NULL;
	CHECK_STATUS(KOOP_E_NULL, KOOP(rls_init)(&e.rls, &e.config, e.storage, REALS));
}

/* Names are those of command lines: one each. */
static void test_names_are_distinct(void) {
	for (int a = 0; a < REGULATORS; a++) {
		TEST_ASSERT_TRUE(strlen(all_regulators[a]->name) > 0);
		for (int b = 0; b < a; b++) { TEST_ASSERT_TRUE(strcmp(all_regulators[a]->name, all_regulators[b]->name) != 0); }
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_refusal_leaves_memory_and_covariance);
	RUN_TEST(test_memory_of_a_sample_that_is_not_learned);
	RUN_TEST(test_flipped_bit_of_memory_is_repaired);
	RUN_TEST(test_reshape_leaves_the_regressor);
	RUN_TEST(test_storage_grows_by_what_is_said);
	RUN_TEST(test_reset_of_covariance_restarts_the_memory);
	RUN_TEST(test_stored_model_has_the_memory);
	RUN_TEST(test_stored_theta_leaves_the_memory);
	RUN_TEST(test_gate_saves_the_memory);
	RUN_TEST(test_steps_and_further_changes_are_what_is_said);
	RUN_TEST(test_negative_noise_beyond_the_denominator_is_refused);
	RUN_TEST(test_covariance_resetting);
	RUN_TEST(test_further_changes_check_what_they_get);
	RUN_TEST(test_the_least_information_is_taken);
	RUN_TEST(test_settings_of_all_regulators);
	RUN_TEST(test_names_are_distinct);
	return UNITY_END();
}
