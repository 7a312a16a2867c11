/* The gate: what it refuses, what it takes, and when it gives a model up. */
#include "support.h"

enum { N = 4, M = 2, D = N + M, PATIENCE = 4 * D, TRIAL = 2 * PATIENCE };

static const double NOISE = 1e-3;

static estimator e, twin;
static KOOP(gate) gate;
static real storage[KOOP_GATE_REALS(N, M)];
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

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form, const KOOP(gate_config) *config) {
	random = random_seed(61);
	estimator_settings(&e, N, M, regulator, form);
	e.config.delta = (real)NOISE;
	e.config.p0 = 10000; /* what is known at first counts for little beside the noise */
	e.config.tau0 = D;
	estimator_start(&e);
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, config, &e.rls, storage, KOOP_GATE_REALS(N, M)));
}

/* With a model that has been learned, and kept as good. */
static void start_learned(const KOOP(regulator) *regulator, const KOOP(form) *form) {
	start(regulator, form, NULL);
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 500));
	TEST_ASSERT_EQUAL_size_t(0, gate.restarts);
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
		twin.config.dictionary = &twin.dictionary;
		estimator_start(&twin);
		for (int k = 0; k < 500; k++) {
			real zeta[D], psi_next[N];
			KOOP(health) health, twins;
			draw(1, NOISE, zeta, psi_next);
			CHECK_STATUS(KOOP_OK, gated(zeta, psi_next, &health));
			CHECK_STATUS(KOOP_OK, estimator_update(&twin, zeta, psi_next, &twins));
			TEST_ASSERT_TRUE(memcmp(&health.innovation, &twins.innovation, sizeof(real)) == 0);
			TEST_ASSERT_TRUE(memcmp(&health.trace, &twins.trace, sizeof(real)) == 0);
			TEST_ASSERT_EQUAL_INT(twins.gated, health.gated);
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
			      sqrt((double)gate.usual[position]));
			check_unchanged(&before, "after an outlier");
			const double innovation = (double)health.innovation;
			CHECK(innovation > 20 * NOISE && innovation < 40 * NOISE, "%g", innovation);
			CHECK(health.finite && health.positive_definite && health.min_diagonal > 0, "health");
			const wide trace = trace_of(before.covariance, D);
			CHECK(fabsl((wide)health.trace - trace) <= D * (wide)REAL_EPSILON * trace, "trace");
			CHECK_STATUS(KOOP_E_OUTLIER, gated(zeta, psi_next, NULL));
		}
	}
}

static void test_spikes_do_not_start_it_again(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	for (int k = 0; k < 20 * PATIENCE; k++) {
		real zeta[D], psi_next[N];
		draw(1, NOISE, zeta, psi_next);
		const int spike = k % 5 < 2;
		if (spike) { psi_next[k % N] += 100; }
		CHECK_STATUS(spike ? KOOP_E_OUTLIER : KOOP_OK, gated(zeta, psi_next, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(0, gate.restarts);
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Theta and P are given up on the last refusal, not before, and what begins is p0 I and the last good Theta.
 */
static void test_patience(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		learned before, after;
		learned_take(&before, &e);
		TEST_ASSERT_EQUAL_INT(PATIENCE - 1, drive(-1, NOISE, PATIENCE - 1));
		check_unchanged(&before, "before patience is over");
		TEST_ASSERT_EQUAL_INT(1, drive(-1, NOISE, 1));
		TEST_ASSERT_EQUAL_size_t(1, gate.restarts);
		learned_take(&after, &e);
		TEST_ASSERT_TRUE(memcmp(e.rls.theta, gate.last_good, D * e.rls.n_lifted_padded * sizeof(real)) == 0);
		for (int i = 0; i < D * D; i++) {
			const double expected = i % (D + 1) == 0 ? 10000 : 0;
			CHECK(fabs((double)after.covariance[i] - expected) <= 20000 * (double)REAL_EPSILON, "P[%d] = %g",
			      i, (double)after.covariance[i]);
		}
	}
}

/* A robot that has changed is learned again, in a trial and with all of it taken. */
static void test_jump_is_learned(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		drive(0.3, NOISE, PATIENCE);
		TEST_ASSERT_EQUAL_INT(0, drive(0.3, NOISE, TRIAL + 300));
		TEST_ASSERT_EQUAL_size_t(1, gate.restarts);
		CHECK(error_on(0.3) < NOISE, "%s: %g", estimator_name(&e), error_on(0.3));
	}
}

/* A trial that the fault had a part in is not believed. */
static void test_spoilt_trial_is_given_up(void) {
	FOR_ALL_KINDS {
		start_learned(all_regulators[r], all_forms[f]);
		drive(-1, NOISE, PATIENCE + PATIENCE / 2); /* refused, then half a patience of the trial */
		TEST_ASSERT_EQUAL_size_t(1, gate.restarts);
		TEST_ASSERT_TRUE(gate.trial > 0);
		drive(1, NOISE, 2 * TRIAL + 200);
		CHECK(error_on(1) < NOISE, "%s: %g after %d restarts", estimator_name(&e), error_on(1),
		      (int)gate.restarts);
	}
}

/* No sample is an outlier, but together they are. */
static void test_strain_starts_it_again(void) {
	start_learned(&KOOP(reg_none), &KOOP(form_sqrt)); /* which would not get over it by itself */
	int samples = 0;
	while (gate.restarts == 0 && samples < 20 * PATIENCE) {
		TEST_ASSERT_EQUAL_INT(0, drive(1, 2.5 * NOISE, 1));
		samples++;
	}
	CHECK(gate.restarts == 1 && samples < 2 * PATIENCE, "%d restarts after %d", (int)gate.restarts, samples);
}

/* What is usual follows, so that a noisier world does not lock the learner out. */
static void test_more_noise_for_good(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	drive(1, 100 * NOISE, 20 * (PATIENCE + TRIAL));
	const size_t restarts = gate.restarts;
	const int refused = drive(1, 100 * NOISE, 1000);
	CHECK(refused < 20, "%d of 1000 refused", refused);
	TEST_ASSERT_EQUAL_size_t(restarts, gate.restarts);
}

static void test_grows_from_nothing(void) {
	static const real zeta[D] = {0}, psi_next[N] = {0};
	start(&KOOP(reg_none), &KOOP(form_plain), NULL);
	for (int k = 0; k < 5000; k++) { CHECK_STATUS(KOOP_OK, gated(zeta, psi_next, NULL)); }
	for (int i = 0; i < N; i++) { TEST_ASSERT_TRUE(!(gate.usual[i] > 0)); }
	drive(1, NOISE, 30 * (PATIENCE + TRIAL));
	const size_t restarts = gate.restarts;
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 1000));
	TEST_ASSERT_EQUAL_size_t(restarts, gate.restarts);
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Of what is out of the ordinary for long, and of nothing else. */
static void test_only_what_is_seen_becomes_usual(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	for (int k = 0; k < 10 * (PATIENCE + TRIAL); k++) {
		real zeta[D], psi_next[N];
		draw(1, NOISE, zeta, psi_next);
		psi_next[0] = random_uniform(&random, -1, 1);
		gated(zeta, psi_next, NULL);
	}
	CHECK(gate.usual[0] > (real)1e-2, "%g", (double)gate.usual[0]);
	for (int i = 1; i < N; i++) {
		CHECK((double)gate.usual[i] < 2 * NOISE * NOISE, "%g", (double)gate.usual[i]);
	}
}

static void test_usual_follows(void) {
	start(&KOOP(reg_none), &KOOP(form_sqrt), NULL);
	drive(1, NOISE, 20000);
	const double before = (double)gate.usual[0];
	drive(1, 1.5 * NOISE, 10000); /* two memories: most of the way from 1 to 2.25 */
	const double grown = (double)gate.usual[0] / before;
	CHECK(grown > 1.9 && grown < 2.3, "%g", grown);
	TEST_ASSERT_EQUAL_size_t(0, gate.restarts);
}

/* A model is kept as good only after a patience without a refusal. */
static void test_last_good(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_sqrt));
	real kept[KOOP_GATE_REALS(N, M)];
	memcpy(kept, storage, sizeof kept);
	const size_t size = D * e.rls.n_lifted_padded * sizeof(real);
	for (int k = 0; k < 10 * PATIENCE; k++) {
		real zeta[D], psi_next[N];
		draw(1, NOISE, zeta, psi_next);
		if (k % (PATIENCE - 1) == 0) { psi_next[1] += 1; }
		gated(zeta, psi_next, NULL);
		CHECK(memcmp(kept, gate.last_good, size) == 0, "sample %d", k);
	}
	drive(1, NOISE, PATIENCE);
	TEST_ASSERT_TRUE(memcmp(kept, gate.last_good, size) != 0);
}

/* Only a trial in vain says that what is usual has changed: two jumps far apart do not. */
static void test_jumps_far_apart(void) {
	start_learned(&KOOP(reg_none), &KOOP(form_sqrt));
	const double before = (double)gate.usual[0];
	drive(0.3, NOISE, PATIENCE + TRIAL + 2 * PATIENCE);
	TEST_ASSERT_EQUAL_size_t(1, gate.restarts);
	drive(1, NOISE, PATIENCE);
	TEST_ASSERT_EQUAL_size_t(2, gate.restarts);
	CHECK((double)gate.usual[0] < 2 * before, "%g, was %g", (double)gate.usual[0], before);
}

static void test_floor(void) {
	static const real rest[D] = {0}, stays[N] = {0};
	const KOOP(gate_config) config = {0, (real)NOISE, 0};
	for (int with = 0; with < 2; with++) {
		start(&KOOP(reg_none), &KOOP(form_sqrt), with ? &config : NULL);
		drive(1, NOISE, 500);
		for (int k = 0; k < 10000; k++) { CHECK_STATUS(KOOP_OK, gated(rest, stays, NULL)); }
		const int refused = drive(1, NOISE, 10);
		CHECK(with ? refused == 0 : refused > 5, "%d refused, floor %d", refused, with);
	}
}

static void test_lost_sensor_is_no_reason(void) {
	static const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	start_learned(&KOOP(reg_ct), &KOOP(form_sqrt));
	const KOOP(gate) before = gate;
	learned had;
	learned_take(&had, &e);
	for (int k = 0; k < 10 * PATIENCE; k++) {
		real sample[D + N];
		draw(1, NOISE, sample, sample + D);
		sample[k % (D + N)] = (real)bad[k % 3];
		CHECK_STATUS(KOOP_E_INPUT, gated(sample, sample + D, NULL));
	}
	TEST_ASSERT_TRUE(memcmp(&before, &gate, sizeof gate) == 0);
	check_unchanged(&had, "after a lost sensor");
}

/* Refusals that are not the gate's own end in a restart as well. */
static void test_overflow_that_keeps_coming_back(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	real zeta[D] = {0};
	const real psi_next[N] = {0};
	zeta[0] = REAL_MAX / 4;
	for (int k = 1; k <= PATIENCE; k++) {
		TEST_ASSERT_EQUAL_size_t(0, gate.restarts);
		CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(1, gate.restarts);
	for (int k = 0; k < TRIAL; k++) { /* a trial of which nothing can be taken comes to its end too */
		CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(0, gate.trial);
	CHECK(error_on(1) < NOISE, "%g", error_on(1));

	/* the second restart is one in vain; innovations whose squares are beyond range do not become usual */
	real usual[N];
	memcpy(usual, gate.usual, sizeof usual);
	for (int k = 0; k < PATIENCE; k++) { CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL)); }
	TEST_ASSERT_EQUAL_size_t(2, gate.restarts);
	for (int i = 0; i < N; i++) {
		CHECK(gate.usual[i] <= 4 * usual[i], "usual[%d] = %g", i, (double)gate.usual[i]);
	}
}

/* Nothing is known yet, and nothing can be learned for long: it learns all the same once it can. */
static void test_overflow_from_the_start(void) {
	start(&KOOP(reg_ef), &KOOP(form_plain), NULL);
	real zeta[D] = {0};
	const real psi_next[N] = {0};
	zeta[0] = REAL_MAX / 4;
	for (int k = 0; k < 2 * (TRIAL + PATIENCE); k++) {
		CHECK_STATUS(KOOP_E_OVERFLOW, gated(zeta, psi_next, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(2, gate.restarts);
	drive(1, NOISE, 30 * (PATIENCE + TRIAL));
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 100));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Vanilla forgetting at rest ends here: the plain form's P would be lost, every sample refused for good. */
static void test_windup_is_cured(void) {
	start_learned(&KOOP(reg_ef), &KOOP(form_plain));
	real zeta[D], psi_next[N];
	draw(1, 0, zeta, psi_next);
	size_t indefinite = 0;
	for (int k = 0; k < 20000; k++) {
		const int status = gated(zeta, psi_next, NULL);
		CHECK(status == KOOP_OK || status == KOOP_E_INDEFINITE || status == KOOP_E_OVERFLOW, "%d", status);
		indefinite += status != KOOP_OK;
	}
	CHECK(indefinite > 0 && gate.restarts > 0, "no windup: the test is void");
	drive(1, NOISE, 30 * (PATIENCE + TRIAL)); /* what is usual has shrunk to round-off meanwhile */
	TEST_ASSERT_EQUAL_INT(0, drive(1, NOISE, 100));
	CHECK(error_on(1) < NOISE, "%g", error_on(1));
}

/* Nothing overflows, and what is usual stays a number, whatever comes. */
static void test_wild_samples(void) {
	FOR_ALL_KINDS {
		start(all_regulators[r], all_forms[f], NULL);
		for (int k = 0; k < 200 * PATIENCE; k++) {
			real sample[D + N];
			const double size = pow(10, (double)random_uniform(&random, -40, TEST_DOUBLE ? 160 : 25));
			for (int i = 0; i < D + N; i++) {
				sample[i] = (real)(size * (double)random_uniform(&random, -1, 1));
			}
			const int status = gated(sample, sample + D, NULL);
			CHECK(status <= KOOP_OK && status != KOOP_E_NULL, "%d", status);
			CHECK(isfinite(gate.strain), "strain %g", (double)gate.strain);
		}
		for (int i = 0; i < N; i++) { CHECK(isfinite(gate.usual[i]), "usual %g", (double)gate.usual[i]); }
		learned now;
		learned_take(&now, &e);
		for (int i = 0; i < N * D; i++) { CHECK(isfinite(now.theta[i]), "%s", estimator_name(&e)); }
	}
}

static void test_settings(void) {
	static const struct {
		double multiple, floor;
		size_t patience;
		int expected;
	} settings[] = {
	    {0, 0, 0, KOOP_OK},
	    {1, 0, 0, KOOP_OK},
	    {8, 0.5, 3, KOOP_OK},
	    {0.99, 0, 0, KOOP_E_RANGE},
	    {-5, 0, 0, KOOP_E_RANGE},
	    {(double)NAN, 0, 0, KOOP_E_RANGE},
	    {(double)INFINITY, 0, 0, KOOP_E_RANGE},
	    {(double)REAL_MAX, 0, 0, KOOP_E_RANGE},
	    {0, -1, 0, KOOP_E_RANGE},
	    {0, (double)NAN, 0, KOOP_E_RANGE},
	    {0, (double)REAL_MAX, 0, KOOP_E_RANGE},
	    {0, 0, (size_t)-1 / 2, KOOP_OK},
	    {0, 0, (size_t)-1 / 2 + 1, KOOP_E_RANGE},
	};
	estimator_default(&e, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	for (size_t i = 0; i < sizeof settings / sizeof settings[0]; i++) {
		const KOOP(gate_config) config = {(real)settings[i].multiple, (real)settings[i].floor,
		                                  settings[i].patience};
		const int status = KOOP(gate_init)(&gate, &config, &e.rls, storage, KOOP_GATE_REALS(N, M));
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
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(NULL, NULL, &e.rls, storage, KOOP_GATE_REALS(N, M)));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, NULL, storage, KOOP_GATE_REALS(N, M)));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, &empty, storage, KOOP_GATE_REALS(N, M)));
	CHECK_STATUS(KOOP_E_NULL, KOOP(gate_init)(&gate, NULL, &e.rls, NULL, KOOP_GATE_REALS(N, M)));
	CHECK_STATUS(KOOP_E_STORAGE, KOOP(gate_init)(&gate, NULL, &e.rls, storage, KOOP_GATE_REALS(N, M) - 1));

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
	CHECK_STATUS(KOOP_OK, KOOP(gate_update)(&gate, &e.rls, zeta, zeta, psi_next, NULL));
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_what_is_taken_is_learned_as_without_it);
	RUN_TEST(test_outlier_leaves_no_trace);
	RUN_TEST(test_spikes_do_not_start_it_again);
	RUN_TEST(test_patience);
	RUN_TEST(test_jump_is_learned);
	RUN_TEST(test_spoilt_trial_is_given_up);
	RUN_TEST(test_strain_starts_it_again);
	RUN_TEST(test_more_noise_for_good);
	RUN_TEST(test_grows_from_nothing);
	RUN_TEST(test_only_what_is_seen_becomes_usual);
	RUN_TEST(test_usual_follows);
	RUN_TEST(test_last_good);
	RUN_TEST(test_jumps_far_apart);
	RUN_TEST(test_floor);
	RUN_TEST(test_lost_sensor_is_no_reason);
	RUN_TEST(test_overflow_that_keeps_coming_back);
	RUN_TEST(test_overflow_from_the_start);
	RUN_TEST(test_windup_is_cured);
	RUN_TEST(test_wild_samples);
	RUN_TEST(test_settings);
	RUN_TEST(test_arguments);
	return UNITY_END();
}
