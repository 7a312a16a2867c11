/* The gate: what it refuses, what it takes, and when it brings back what was known before. */
#include "support.h"

enum { N = 4, M = 2, D = N + M, PATIENCE = 5, WINDOW = 4 * D, HOLD = 1000 };
enum { SAMPLES_TO_CLOSE = 16 * WINDOW }; /* the model has to be learned again, too */

static const double NOISE = 1e-3;

static estimator e, twin;
static KOOP(gate) gate;
enum { REALS = KOOP_GATE_REALS_PLAIN(N, M) + KOOP_EXTENSION_REALS_PLAIN(N, M) };
static real storage[REALS];
static random_source random;

/* A robot: psi_next = zeta[i + 1] / 2 - zeta[i], the second half by `gain`, and noise. */
static void draw(double gain, double noise, real *zeta, real *psi_next) {
	random_fill(&random, zeta, D, -1, 1);
	for (int i = 0; i < N; i++) {
		const double healthy = (double)zeta[i + 1] / 2 - (double)zeta[i];
		psi_next[i] = (real)(gain * healthy) + random_uniform(&random, -noise, noise);
	}
}

static int gated(const real *zeta, const real *psi_next, KOOP(health) *health) {
	return KOOP(gate_update)(&gate, &e.rls, zeta, zeta + N, psi_next, health);
}

/* Samples of a robot; how many of them were not taken. */
static int drive(double gain, double noise, int samples) {
	int refused = 0;
	for (int k = 0; k < samples; k++) {
		real zeta[D], psi_next[N];
		draw(gain, noise, zeta, psi_next);
		refused += gated(zeta, psi_next, NULL) != KOOP_OK;
	}
	return refused;
}

/* rms of the one-step error on samples that are not learned */
static double error_on(double gain) {
	double sum = 0;
	for (int k = 0; k < 100; k++) {
		real zeta[D], psi_next[N], predicted[N];
		draw(gain, 0, zeta, psi_next);
		CHECK_STATUS(KOOP_OK, KOOP(rls_predict)(&e.rls, zeta, zeta + N, predicted));
		for (int i = 0; i < N; i++) { sum += pow((double)(psi_next[i] - predicted[i]), 2); }
	}
	return sqrt(sum / (100 * N));
}

/* After a reset of P the next innovations are large, and some are refused: not what these tests are about. */
static void never_reset(void) {
	if (e.config.regulator == &KOOP(reg_reset)) { memset(e.own, 0, sizeof e.own); }
}

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form, const KOOP(gate_config) *config) {
	random = random_seed(61);
	estimator_settings(&e, N, M, regulator, form);
	e.dead_zone.delta = (real)NOISE;
	e.config.p0 = 10000; /* what is known at first counts for little beside the noise */
	e.trace.tau0 = D;
	never_reset();
	estimator_start(&e);
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, config, &e.rls, storage, REALS));
}

/* With a model that has been learned, and saved. */
static void start_learned(const KOOP(regulator) *regulator, const KOOP(form) *form) {
	start(regulator, form, NULL);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 500));
	TEST_ASSERT_EQUAL_size_t(0, gate.restored);
	CHECK(error_on(1) < NOISE, "%s: %g", estimator_name(&e), error_on(1));
}

static void check_unchanged(const learned *before, const char *when) {
	learned now;
	learned_take(&now, &e);
	CHECK(learned_same_theta(before, &now, &e), "%s: Theta, %s", estimator_name(&e), when);
	CHECK(learned_same_covariance(before, &now, &e), "%s: P, %s", estimator_name(&e), when);
}

#define FOR_ALL_KINDS                                                                                        \
	for (int r = 0; r < REGULATORS; r++)                                                                     \
		for (int f = 0; f < FORMS; f++)

static void test_what_is_taken_is_learned_as_without_it(void) {
	FOR_ALL_KINDS {
		start(all_regulators[r], all_forms[f], NULL);
		estimator_settings(&twin, N, M, all_regulators[r], all_forms[f]);
		twin.config = e.config;
		twin.dead_zone = e.dead_zone;
		twin.trace = e.trace;
		twin.floor = e.floor;
		twin.config.dictionary = &twin.dictionary;
		memcpy(twin.own, e.own, sizeof twin.own);
		estimator_start(&twin);
		for (int k = 0; k < 500; k++) {
			real zeta[D], psi_next[N];
			KOOP(health) health, twins;
			draw(1, NOISE, zeta, psi_next);
			CHECK_STATUS(KOOP_OK, gated(zeta, psi_next, &health));
			CHECK_STATUS(KOOP_OK, estimator_update(&twin, zeta, psi_next, &twins));
			TEST_ASSERT_TRUE(memcmp(&health.innovation, &twins.innovation, sizeof(real)) == 0);
			TEST_ASSERT_TRUE(memcmp(&health.trace, &twins.trace, sizeof(real)) == 0);
			TEST_ASSERT_EQUAL_INT(twins.frozen, health.frozen);
		}
		learned alone;
		learned_take(&alone, &twin);
		check_unchanged(&alone, "as without a gate");
	}
}

static void test_outlier_leaves_no_trace(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		for (int position = 0; position < N; position++) {
			real zeta[D], psi_next[N];
			learned before;
			KOOP(health) health;
			draw(1, NOISE, zeta, psi_next);
			psi_next[position] += (real)(30 * NOISE);
			learned_take(&before, &e);
			const int status = gated(zeta, psi_next, &health);
			CHECK(status == KOOP_E_OUTLIER, "%s: %d, usual %g", estimator_name(&e), status,
			      sqrt((double)gate.variance[position]));
			check_unchanged(&before, "after an outlier");
			const double innovation = (double)health.innovation;
			CHECK(innovation > 20 * NOISE && innovation < 40 * NOISE, "%g", innovation);
			CHECK(health.finite && health.positive_definite && health.min_diagonal > 0, "health");
			const wide trace = trace_of(before.covariance, D);
			CHECK(fabs((wide)health.trace - trace) <= D * (wide)REAL_EPSILON * trace, "trace");
			TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 5));
		}
	}
}

static void test_spikes_are_refused_while_they_are_few(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	for (int k = 0; k < 2000; k++) {
		real zeta[D], psi_next[N];
		draw(1, NOISE, zeta, psi_next);
		const int spike = k % 5 < 2;
		if (spike) { psi_next[k % N] += 100; }
		CHECK_STATUS(spike ? KOOP_E_OUTLIER : KOOP_OK, gated(zeta, psi_next, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(0, gate.restored);
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Outliers are refused until there are too many. Then the learner follows. */
static void test_patience(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		learned before;
		learned_take(&before, &e);
		TEST_ASSERT_EQUAL_INT(PATIENCE, drive(-1, NOISE, PATIENCE));
		check_unchanged(&before, "before patience is over");
		TEST_ASSERT_EQUAL_INT(0, drive(-1, NOISE, WINDOW));
		learned now;
		learned_take(&now, &e);
		CHECK(!learned_same_theta(&before, &now, &e), "%s does not follow", estimator_name(&e));
	}
}

/* However long it refuses: that says nothing of P. */
static void test_long_patience(void) {
	const KOOP(gate_config) config = {0, 0, 1000, 0};
	start(&KOOP(reg_ef), &KOOP(form_sqrt), &config);
	drive(1, NOISE, 500);
	learned before;
	learned_take(&before, &e);
	TEST_ASSERT_EQUAL_INT(999, drive(-1, NOISE, 999));
	check_unchanged(&before, "while all is refused");
	TEST_ASSERT_EQUAL_size_t(0, gate.restored);
}

/* A robot that has changed is learned as fast as without the gate, and it is not gone back on. */
static void test_jump_is_learned(void) {
	static const KOOP(regulator) *const forgetting[] = {&KOOP(reg_ef), &KOOP(reg_dz_cs), &KOOP(reg_ct)};
	for (int r = 0; r < 3; r++) {
		for (int f = 0; f < FORMS; f++) {
			start_learned(forgetting[r], all_forms[f]);
			const int refused = drive(0.3, NOISE, 10 * WINDOW);
			CHECK(refused < 2 * PATIENCE, "%s: %d refused", estimator_name(&e), refused);
			CHECK(error_on(0.3) < NOISE, "%s: %g", estimator_name(&e), error_on(0.3));
			drive(0.3, NOISE, 2 * HOLD);
			TEST_ASSERT_EQUAL_size_t(0, gate.restored);
			CHECK(error_on(0.3) < NOISE, "%s: %g", estimator_name(&e), error_on(0.3));
		}
	}
}

/* What a fault has taught is gone two windows after it, whatever the regulator would have made of it. */
static void test_fault_leaves_no_trace(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		for (int fault = 0; fault < 3; fault++) {
			drive(-1, NOISE, 300);
			CHECK(error_on(1) > 100 * NOISE, "%s: no fault: the test is void", estimator_name(&e));
			drive(1, NOISE, PATIENCE + 2 * WINDOW);
			CHECK(error_on(1) < NOISE, "%s: %g", estimator_name(&e), error_on(1));
			drive(1, NOISE, 300);
		}
		TEST_ASSERT_EQUAL_size_t(3, gate.restored);
	}
}

/* Theta and P as they were saved, each time anew. */
static void test_what_comes_back(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		for (size_t fault = 0; fault < 3; fault++) {
			learned was, now;
			drive(-1, NOISE, 300);
			for (int k = 0; k < HOLD && gate.restored == fault; k++) { drive(1, NOISE, 1); }
			TEST_ASSERT_EQUAL_size_t(fault + 1, gate.restored);
			learned_take(&now, &e);
			twin.rls = gate.saved;
			learned_take(&was, &twin);
			CHECK(learned_same_theta(&was, &now, &e), "%s: Theta", estimator_name(&e));
			CHECK(learned_same_covariance(&was, &now, &e), "%s: P", estimator_name(&e));
			drive(1, NOISE, 300);
		}
	}
}

/* A fault too small for any sample to be an outlier. */
static void test_small_fault_leaves_no_trace(void) {
	start_learned(&KOOP(reg_none), &KOOP(form_sqrt)); /* which would not get over it by itself */
	TEST_ASSERT_EQUAL_INT(0, drive(0.998, NOISE, 300));
	const double spoilt = error_on(1);
	drive(1, NOISE, 2 * WINDOW);
	TEST_ASSERT_EQUAL_size_t(1, gate.restored);
	CHECK(error_on(1) < spoilt / 3, "%g, was %g", error_on(1), spoilt);
}

/* What a fault leaves behind goes even where it would pass for usual by itself. */
static void test_little_left_of_a_fault(void) {
	start_learned(&KOOP(reg_none), &KOOP(form_sqrt));
	drive(1, NOISE, 5000);
	const double before = error_on(1);
	drive(0.93, NOISE, 40);
	drive(1, NOISE, 3 * WINDOW);
	TEST_ASSERT_EQUAL_size_t(1, gate.restored);
	CHECK(error_on(1) < 1.5 * before, "%g, was %g", error_on(1), before);
}

/* Nor does what each of many faults leaves behind add up where nothing is forgotten. */
static void test_little_left_of_many_faults(void) {
	start_learned(&KOOP(reg_none), &KOOP(form_sqrt));
	drive(1, NOISE, 5000);
	for (int fault = 0; fault < 100; fault++) {
		drive(0.95, NOISE, 40);
		drive(1, NOISE, 10 * WINDOW);
	}
	CHECK(error_on(1) < NOISE / 2, "%g", error_on(1));
}

/* A change that lasts is believed: what was known before does not come back. */
static void test_hold(void) {
	for (int longer = 0; longer < 2; longer++) {
		start_learned(&KOOP(reg_none), &KOOP(form_sqrt));
		drive(-1, NOISE, longer ? HOLD + 3 * WINDOW : HOLD - 3 * WINDOW);
		drive(1, NOISE, 3 * WINDOW);
		CHECK((error_on(1) < NOISE) == !longer, "longer %d: %g", longer, error_on(1));
		TEST_ASSERT_EQUAL_size_t(longer ? 0 : 1, gate.restored);
	}
}

/* The model that the learner begins with is one to come back to, with its P; the learner stays as it is. */
static void test_loaded_model_is_saved(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		learned had, saved;
		learned_take(&had, &e);
		CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
		check_unchanged(&had, "with a gate");
		twin = e;
		twin.rls = gate.saved;
		learned_take(&saved, &twin);
		CHECK(learned_same_theta(&had, &saved, &e), "%s: Theta", estimator_name(&e));
		CHECK(learned_same_covariance(&had, &saved, &e), "%s: P", estimator_name(&e));
	}
}

/* Nothing is saved while a fault is at work. */
static void test_saved(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	real kept[REALS];
	memcpy(kept, storage, sizeof kept);
	const size_t size = D * e.rls.n_lifted_padded * sizeof(real);
	for (int k = 0; k < HOLD - 2 * WINDOW; k++) {
		drive(-1, NOISE, 1);
		CHECK(memcmp(kept, gate.saved.theta, size) == 0, "sample %d", k);
	}
	drive(1, NOISE, 4 * WINDOW);
	TEST_ASSERT_TRUE(memcmp(kept, gate.saved.theta, size) != 0);
}

/* What is usual follows, so that a noisier world does not lock the learner out. */
static void test_more_noise_for_good(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	const int at_first = drive(1, 100 * NOISE, 10 * WINDOW), refused = drive(1, 100 * NOISE, 5000);
	CHECK(at_first <= 3 * PATIENCE, "%d refused at first", at_first);
	CHECK(refused < 5, "%d of 5000 refused", refused);
	CHECK(fabs((double)gate.variance[0] / pow(100 * NOISE, 2) - 1.0 / 3) < 0.1, "usual %g",
	      (double)gate.variance[0]);
}

static void test_grows_from_nothing(void) {
	static const real zeta[D] = {0}, psi_next[N] = {0};
	start(&KOOP(reg_none), &KOOP(form_plain), NULL);
	for (int k = 0; k < 5000; k++) { CHECK_STATUS(KOOP_OK, gated(zeta, psi_next, NULL)); }
	for (int i = 0; i < N; i++) { TEST_ASSERT_TRUE(!(gate.variance[i] > 0)); }
	drive(1, NOISE, 3 * HOLD);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 1000));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

static void test_usual_follows(void) {
	start(&KOOP(reg_none), &KOOP(form_sqrt), NULL);
	drive(1, NOISE, 20000);
	const double before = (double)gate.variance[0];
	drive(1, 1.2 * NOISE, 10000); /* two memories: most of the way from 1 to 1.44 */
	const double grown = (double)gate.variance[0] / before;
	CHECK(grown > 1.3 && grown < 1.45, "%g", grown);
	TEST_ASSERT_EQUAL_size_t(0, gate.restored);
}

static void test_floor(void) {
	static const real rest[D] = {0}, stays[N] = {0};
	const KOOP(gate_config) config = {0, (real)NOISE, 0, 0};
	for (int with = 0; with < 2; with++) {
		start(&KOOP(reg_none), &KOOP(form_sqrt), with ? &config : NULL);
		drive(1, NOISE, 500);
		for (int k = 0; k < 10000; k++) { CHECK_STATUS(KOOP_OK, gated(rest, stays, NULL)); }
		const int refused = drive(1, NOISE, 10);
		CHECK(refused == (with ? 0 : PATIENCE), "%d refused, floor %d", refused, with);
	}
}

static void test_lost_sensor_is_no_reason(void) {
	static const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	start_learned(&KOOP(reg_ct), &KOOP(form_sqrt));
	const KOOP(gate) before = gate;
	learned had;
	learned_take(&had, &e);
	for (int k = 0; k < 10 * WINDOW; k++) {
		real sample[D + N];
		draw(1, NOISE, sample, sample + D);
		sample[k % (D + N)] = (real)bad[k % 3];
		CHECK_STATUS(KOOP_E_INPUT, gated(sample, sample + D, NULL));
	}
	TEST_ASSERT_TRUE(memcmp(&before, &gate, sizeof gate) == 0);
	check_unchanged(&had, "after a lost sensor");
}

/* Where nothing can be learned for a window, what was known before comes back, and P begins anew. */
static void test_overflow_that_keeps_coming_back(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	learned after;
	real zeta[D] = {0};
	const real psi_next[N] = {0};
	zeta[0] = REAL_MAX / 4;
	for (size_t windows = 1; windows < 4; windows++) {
		while (gate.restored < windows) { CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL)); }
		learned_take(&after, &e);
		TEST_ASSERT_TRUE(memcmp(e.rls.theta, gate.saved.theta, D * e.rls.n_lifted_padded * sizeof(real)) ==
		                 0);
		for (int i = 0; i < D * D; i++) {
			const double expected = i % (D + 1) == 0 ? 10000 : 0;
			CHECK(fabs((double)after.covariance[i] - expected) <= 20000 * (double)REAL_EPSILON, "P[%d] = %g",
			      i, (double)after.covariance[i]);
		}
	}
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
	for (int i = 0; i < N; i++) { CHECK((double)gate.variance[i] < NOISE * NOISE, "%g", (double)gate.variance[i]); }
}

/* Nothing is known yet, and nothing can be learned for long: it learns all the same once it can. */
static void test_overflow_from_the_start(void) {
	start(&KOOP(reg_ef), &KOOP(form_plain), NULL);
	real zeta[D] = {0};
	const real psi_next[N] = {0};
	zeta[0] = REAL_MAX / 4;
	for (int k = 0; k < 10 * WINDOW; k++) { CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL)); }
	TEST_ASSERT_EQUAL_size_t(10, gate.restored);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 500));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Vanilla forgetting at rest ends here: the plain form's P would be lost, every sample refused for good. */
static void test_windup_is_cured(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	real zeta[D], psi_next[N];
	draw(1, 0, zeta, psi_next);
	size_t indefinite = 0;
	for (int k = 0; k < (TEST_SHARE > 1 ? 8000 : 20000); k++) {
		const int status = gated(zeta, psi_next, NULL);
		CHECK(status == KOOP_OK || status == KOOP_E_INDEFINITE || status == KOOP_E_OVERFLOW, "%d", status);
		indefinite += status != KOOP_OK;
	}
	CHECK(indefinite > 0 && gate.restored > 0, "no windup: the test is void");
	drive(1, NOISE, 3 * HOLD); /* what is usual has shrunk to round-off meanwhile */
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 100));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Nor is a P that has wound up brought back again and again: each time it would lead astray anew. */
static void test_wound_up_covariance_comes_back_once(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	for (int round = 0; round < 20; round++) {
		real zeta[D], psi_next[N];
		draw(1, 0, zeta, psi_next);
		for (int k = 0; k < 400; k++) { gated(zeta, psi_next, NULL); }
		const size_t restored = gate.restored;
		drive(1, NOISE, 4 * WINDOW);
		CHECK(gate.restored <= restored + 2, "%d times", (int)(gate.restored - restored));
		CHECK(error_on(1) < 1.5 * NOISE, "round %d: %g", round, error_on(1));
	}
}

/* Nothing overflows, and what is usual stays a number, whatever comes. */
static void test_wild_samples(void) {
	FOR_ALL_KINDS {
		start(all_regulators[r], all_forms[f], NULL);
		for (int k = 0; k < 5000; k++) {
			real sample[D + N];
			const double size = pow(10, (double)random_uniform(&random, -40, TEST_DOUBLE ? 160 : 25));
			for (int i = 0; i < D + N; i++) {
				sample[i] = (real)(size * (double)random_uniform(&random, -1, 1));
			}
			const int status = gated(sample, sample + D, NULL);
			CHECK(status <= KOOP_OK && status != KOOP_E_NULL, "%d", status);
			CHECK(isfinite(gate.nis) && isfinite(gate.saved_nis), "strain");
		}
		for (int i = 0; i < N; i++) { CHECK(isfinite(gate.variance[i]) && isfinite(gate.recent_variance[i]), "usual"); }
		learned now;
		learned_take(&now, &e);
		for (int i = 0; i < N * D; i++) { CHECK(isfinite(now.theta[i]), "%s", estimator_name(&e)); }
	}
}

static void test_settings(void) {
	static const struct {
		double multiple, floor;
		size_t patience, hold;
		int expected;
	} settings[] = {
	    {0, 0, 0, 0, KOOP_OK},
	    {1, 0, 1, 1, KOOP_OK},
	    {8, 0.5, 3, 50, KOOP_OK},
	    {0.99, 0, 0, 0, KOOP_E_RANGE},
	    {-5, 0, 0, 0, KOOP_E_RANGE},
	    {(double)NAN, 0, 0, 0, KOOP_E_RANGE},
	    {(double)INFINITY, 0, 0, 0, KOOP_E_RANGE},
	    {(double)REAL_MAX, 0, 0, 0, KOOP_E_RANGE},
	    {0, -1, 0, 0, KOOP_E_RANGE},
	    {0, (double)NAN, 0, 0, KOOP_E_RANGE},
	    {0, (double)REAL_MAX, 0, 0, KOOP_E_RANGE},
	    {0, 0, (size_t)-1 / 2, (size_t)-1 / 2, KOOP_OK},
	    {0, 0, (size_t)-1 / 2 + 1, 0, KOOP_E_RANGE},
	    {0, 0, 0, (size_t)-1 / 2 + 1, KOOP_E_RANGE},
	};
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	for (size_t i = 0; i < sizeof settings / sizeof settings[0]; i++) {
		const KOOP(gate_config) config = {(real)settings[i].multiple, (real)settings[i].floor,
		                                  settings[i].patience, settings[i].hold};
		const int status = KOOP(gate_init)(&gate, &config, &e.rls, storage, REALS);
		CHECK(status == settings[i].expected, "setting %d: %d", (int)i, status);
	}
}

static void test_arguments(void) {
	const real zeta[D] = {1}, psi_next[N] = {1};
	KOOP(gate) unset;
	KOOP(rls) empty;
	memset(&unset, 0, sizeof unset);
	memset(&empty, 0, sizeof empty);
	start(&KOOP(reg_ef), &KOOP(form_sqrt), NULL);
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(NULL, NULL, &e.rls, storage, REALS));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, NULL, storage, REALS));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, &empty, storage, REALS));
	empty = e.rls;
	empty.theta = NULL;
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, &empty, storage, REALS));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, &empty, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, &e.rls, NULL, REALS));
	CHECK_STATUS(KOOP_E_STORAGE,
	             KOOP(gate_init)(&gate, NULL, &e.rls, storage, KOOP_GATE_REALS_SQRT(N, M) - 1));

	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(NULL, &e.rls, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&unset, &e.rls, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, NULL, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, &empty, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, &e.rls, NULL, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, &e.rls, zeta, NULL, psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_update)(&gate, &e.rls, zeta, zeta, NULL, NULL));
	estimator_default(&twin, N, M + 1, &KOOP(reg_ef), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	estimator_default(&twin, N - 1, M + 1, &KOOP(reg_ef), &KOOP(form_sqrt)); /* of as many regressors */
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	estimator_default(&twin, N, M, &KOOP(reg_sift), &KOOP(form_sqrt));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	estimator_default(&twin, N, M, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	estimator_default(&twin, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	twin.rls.config.check = e.rls.config.check + 1;
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	estimator_default(&twin, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	twin.rls.config.checksum = 1;
	CHECK_STATUS(KOOP_E_SIZE, KOOP(gate_update)(&gate, &twin.rls, zeta, zeta, psi_next, NULL));
	CHECK_STATUS(KOOP_OK, KOOP(gate_update)(&gate, &e.rls, zeta, zeta, psi_next, NULL));
	e.rls.config.p0 = -1;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
}

/* ---- after a fault that was longer than `hold` ------------------------------------------- */

/* Samples whose measurement is lost in noise of that size. */
static void fault(double size, int samples) {
	for (int k = 0; k < samples; k++) {
		real zeta[D], psi_next[N];
		draw(1, NOISE, zeta, psi_next);
		for (int i = 0; i < N; i++) { psi_next[i] += random_uniform(&random, -size, size); }
		(void)gated(zeta, psi_next, NULL);
	}
}

/* Whether a spike would be refused now; leaves all as it was. */
static int spike_is_refused(double size) {
	static estimator kept;
	static real kept_storage[REALS];
	const KOOP(gate) kept_gate = gate;
	const random_source kept_random = random;
	real zeta[D], psi_next[N];
	kept = e;
	memcpy(kept_storage, storage, sizeof storage);
	draw(1, NOISE, zeta, psi_next);
	psi_next[1] += (real)size;
	const int status = gated(zeta, psi_next, NULL);
	e = kept;
	gate = kept_gate;
	random = kept_random;
	memcpy(storage, kept_storage, sizeof storage);
	return status == KOOP_E_OUTLIER;
}

/* Good samples until a spike of 50 times the noise is refused, as it was before the fault, and again
 * some windows later. */
static int samples_until_closed(void) {
	int samples = 0;
	while (samples < 60000 && !spike_is_refused(50 * NOISE)) {
		drive(1, NOISE, 1);
		samples++;
	}
	drive(1, NOISE, 4 * WINDOW);
	TEST_ASSERT_TRUE(spike_is_refused(50 * NOISE));
	return samples;
}

static void test_memory_of_a_long_fault_is_bounded(void) {
	static const double sizes[] = {30 * NOISE, 1000 * NOISE, 1e6 * NOISE};
	int worst = 0;
	for (int f = 0; f < FORMS; f++) {
		for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
			for (int length = 1500; length <= 12000; length *= 2) {
				start_learned(&KOOP(reg_ef), all_forms[f]);
				TEST_ASSERT_TRUE(spike_is_refused(50 * NOISE));
				fault(sizes[s], length);
				const int samples = samples_until_closed();
				worst = samples > worst ? samples : worst;
				CHECK(samples <= SAMPLES_TO_CLOSE, "%s, %d samples of %g: open for %d", estimator_name(&e), length, sizes[s],
				      samples);
			}
		}
	}
	printf("open for at most %d samples after a fault, %d of a window\n", worst, WINDOW);
}

static void test_configuration_may_be_the_gate_s_own(void) {
	start(&KOOP(reg_ef), &KOOP(form_sqrt), &(KOOP(gate_config)){7, (real)0.25, 3, 50});
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, &gate.config, &e.rls, storage, REALS));
	TEST_ASSERT_EQUAL_size_t(3, gate.config.patience);
	TEST_ASSERT_EQUAL_size_t(50, gate.config.hold);
	TEST_ASSERT_TRUE(gate.config.multiple >= 7 && gate.config.floor >= (real)0.25);
}

/* ---- whether the model is to be trusted ----------------------------------------------------- */

static int trust(void) {
	return KOOP(gate_trust)(&gate);
}

static void spike(double size) {
	real zeta[D], psi_next[N];
	draw(1, NOISE, zeta, psi_next);
	psi_next[0] += (real)size;
	(void)gated(zeta, psi_next, NULL);
}

static void test_trust_begins_in_doubt_and_comes_with_what_is_usual(void) {
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, KOOP(gate_trust)(NULL));
	TEST_ASSERT_EQUAL_INT(KOOP_E_NULL, KOOP(gate_trust)(&(KOOP(gate)){.variance = NULL}));
	start(&KOOP(reg_ef), &KOOP(form_sqrt), NULL);
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust());
	drive(1, NOISE, 2 * WINDOW);
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust());
	drive(1, NOISE, 2 * WINDOW);
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, trust());
}

static void test_an_outlier_is_doubted_for_a_window(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, trust());
	spike(1);
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust());
	drive(1, NOISE, WINDOW - 1);
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust());
	drive(1, NOISE, 2 * WINDOW);
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, trust());
}

/* Refused within the window in which the sensor fails; trusted again by steps, within three windows after the
 * last alarm. */
static void test_a_fault_is_refused_and_trust_comes_back_by_steps(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	int samples[3] = {0, 0, 0}, alarm = 0;
	while (trust() != KOOP_REFUSE && alarm <= 2 * WINDOW) {
		spike(1);
		alarm++;
	}
	CHECK(alarm <= 2 * WINDOW, "no alarm after %d samples", alarm);
	while (trust() != KOOP_TRUSTED && samples[0] + samples[1] + samples[2] < 1000) {
		samples[trust()]++;
		drive(1, NOISE, 1);
	}
	CHECK(samples[KOOP_REFUSE] > 0 && samples[KOOP_DOUBTFUL] >= WINDOW, "%d refused, %d doubtful",
	      samples[KOOP_REFUSE], samples[KOOP_DOUBTFUL]);
	CHECK(samples[KOOP_REFUSE] + samples[KOOP_DOUBTFUL] < 6 * WINDOW, "%d refused, %d doubtful",
	      samples[KOOP_REFUSE], samples[KOOP_DOUBTFUL]);
}

static void test_samples_that_cannot_be_learned_are_refused_trust(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	real zeta[D], psi_next[N];
	draw(1, NOISE, zeta, psi_next);
	psi_next[0] = REAL_MAX;
	zeta[0] = -REAL_MAX;
	CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL));
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, trust());
}

static void test_indefinite_covariance_is_refused_trust(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	e.rls.positive_definite = 0;
	e.dead_zone.delta = 0;
	real zeta[D], psi_next[N];
	draw(1, NOISE, zeta, psi_next);
	spike(1); /* refused, so that P stays what it is */
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, trust());
}

static void test_noise_that_has_grown_is_doubted(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	drive(1, 2.6 * NOISE, 3 * WINDOW);
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust());
}

/* ---- bits that flip ---------------------------------------------------------------------------- */

static void start_with_checksum(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	e.config.checksum = 1;
	estimator_start(&e);
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 500));
}

static void flip(real *word, int bits) {
	for (int bit = 0; bit < bits; bit++) { ((unsigned char *)word)[bit % 2] ^= (unsigned char)(5 << bit); }
}

static void test_learner_beyond_mending_gets_what_was_saved(void) {
	start_with_checksum();
	flip(e.rls.theta, 2);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 1));
	TEST_ASSERT_EQUAL_size_t(1, gate.restored);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 100));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

static void test_nothing_sound_is_left_is_told(void) {
	start_with_checksum();
	flip(e.rls.theta, 2);
	flip(gate.saved.theta, 2);
	real zeta[D], psi_next[N];
	draw(1, NOISE, zeta, psi_next);
	CHECK_STATUS(KOOP_E_MEMORY, gated(zeta, psi_next, NULL));
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, trust());
}

static void test_saved_model_beyond_mending_is_saved_anew(void) {
	start_with_checksum();
	flip(gate.saved.theta, 2);
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(rls_check)(&gate.saved));
	drive(1, NOISE, WINDOW);
	CHECK_STATUS(KOOP_OK, KOOP(rls_check)(&gate.saved));
}

static void test_what_is_usual_is_mended_or_learned_anew(void) {
	for (int bits = 1; bits <= 2; bits++) {
		start_with_checksum();
		const real kept = gate.variance[2];
		((unsigned char *)&gate.variance[2])[sizeof(real) - 1] ^= 0x10;
		if (bits == 2) { ((unsigned char *)&gate.variance[1])[0] ^= 0x03; }
		drive(1, NOISE, 1);
		TEST_ASSERT_TRUE(bits == 2 ? gate.n_variance == 0 : fabs((double)(gate.variance[2] / kept - 1)) < 0.1);
		drive(1, NOISE, 200);
		TEST_ASSERT_TRUE(spike_is_refused(50 * NOISE));
	}
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_configuration_may_be_the_gate_s_own);
	RUN_TEST(test_trust_begins_in_doubt_and_comes_with_what_is_usual);
	RUN_TEST(test_an_outlier_is_doubted_for_a_window);
	RUN_TEST(test_a_fault_is_refused_and_trust_comes_back_by_steps);
	RUN_TEST(test_samples_that_cannot_be_learned_are_refused_trust);
	RUN_TEST(test_indefinite_covariance_is_refused_trust);
	RUN_TEST(test_noise_that_has_grown_is_doubted);
	RUN_TEST(test_learner_beyond_mending_gets_what_was_saved);
	RUN_TEST(test_nothing_sound_is_left_is_told);
	RUN_TEST(test_saved_model_beyond_mending_is_saved_anew);
	RUN_TEST(test_what_is_usual_is_mended_or_learned_anew);
	RUN_TEST(test_memory_of_a_long_fault_is_bounded);
	RUN_TEST(test_what_is_taken_is_learned_as_without_it);
	RUN_TEST(test_outlier_leaves_no_trace);
	RUN_TEST(test_spikes_are_refused_while_they_are_few);
	RUN_TEST(test_patience);
	RUN_TEST(test_long_patience);
	RUN_TEST(test_jump_is_learned);
	RUN_TEST(test_fault_leaves_no_trace);
	RUN_TEST(test_what_comes_back);
	RUN_TEST(test_small_fault_leaves_no_trace);
	RUN_TEST(test_little_left_of_a_fault);
	RUN_TEST(test_little_left_of_many_faults);
	RUN_TEST(test_hold);
	RUN_TEST(test_loaded_model_is_saved);
	RUN_TEST(test_saved);
	RUN_TEST(test_more_noise_for_good);
	RUN_TEST(test_grows_from_nothing);
	RUN_TEST(test_usual_follows);
	RUN_TEST(test_floor);
	RUN_TEST(test_lost_sensor_is_no_reason);
	RUN_TEST(test_overflow_that_keeps_coming_back);
	RUN_TEST(test_overflow_from_the_start);
	RUN_TEST(test_windup_is_cured);
	RUN_TEST(test_wound_up_covariance_comes_back_once);
	RUN_TEST(test_wild_samples);
	RUN_TEST(test_settings);
	RUN_TEST(test_arguments);
	return UNITY_END();
}
