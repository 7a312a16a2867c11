/* The gate beside a second writing of its rules: slow, in wide arithmetic, on estimators of its own that it
 * uses as anyone would. Both see the same samples, and must agree on all that they say and keep. */
#include "support.h"

#include <stddef.h>
#include <stdio.h>

enum { MOST_N = 6, MOST_M = 2, MOST_D = MOST_N + MOST_M };
enum { ROUNDS = 48 / (TEST_SHARE < 8 ? TEST_SHARE : 8), SAMPLES = 1500, MEMORY = 5000 };
static const double NOISE = 1e-3;

static estimator e;
static KOOP(gate) gate;
enum { REALS = KOOP_GATE_REALS_PLAIN(MOST_N, MOST_M) + KOOP_EXTENSION_REALS_PLAIN(MOST_N, MOST_M) };
static real storage[REALS];
static random_source random;

/* ---- the rules, written again ------------------------------------------------------------------- */

typedef struct {
	estimator learner;
	estimator kept;  /* the learner when it was saved: comes back by assignment */
	estimator judge; /* predicts with what was saved */
	size_t N, window, patience, hold;
	wide multiple, floor;
	wide variance[MOST_N], recent_variance[MOST_N], previous_variance[MOST_N]; /* mean squares */
	size_t first; /* samples accepted before any counts in the variance */
	size_t n_variance, refused, grace, suspect_for, restored;
	int restored_once, changed, trust;
	/* of this window */
	size_t judged, failed;
	wide nis, kept_nis, previous_nis;
	int worst;
	size_t repaired[2]; /* flipped bits of the learner, and of what is saved */
	int close;        /* a decision hung on less than rounding: from here on the two may differ */
} rules;

static rules twin;

/* a > b */
static int above(rules *t, wide a, wide b) {
	if (fabs(a - b) < (wide)0.001L * (fabs(a) + fabs(b))) { t->close = 1; }
	return a > b;
}

static void rules_save(rules *t) {
	t->kept = t->learner;
	CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&t->judge.rls, t->learner.rls.theta));
}

/* What is known of the samples: nothing. */
static void rules_begin(rules *t) {
	for (size_t i = 0; i < MOST_N; i++) {
		t->variance[i] = t->recent_variance[i] = t->previous_variance[i] = 0;
	}
	t->first = t->window;
	t->n_variance = t->refused = t->grace = t->suspect_for = t->restored = t->judged = t->failed = 0;
	t->nis = t->kept_nis = t->previous_nis = 0;
	t->restored_once = t->changed = 0;
	t->trust = t->worst = KOOP_DOUBTFUL;
}

static void rules_start(rules *t, const estimator *of, const KOOP(gate_config) *config) {
	t->N = of->rls.n_lifted;
	t->window = 4 * of->rls.n_regressors;
	t->multiple = config->multiple > 0 ? (wide)config->multiple : 5;
	t->floor = (wide)config->floor;
	t->patience = config->patience > 0 ? config->patience : 5;
	t->hold = config->hold > 0 ? config->hold : 1000;
	t->close = 0;
	t->repaired[0] = t->repaired[1] = 0;
	rules_begin(t);
	estimator *const all[] = {&t->learner, &t->judge};
	for (size_t i = 0; i < 2; i++) {
		estimator_settings(all[i], t->N, of->config.n_inputs, of->config.regulator, of->config.form);
		all[i]->config = of->config;
		all[i]->config.dictionary = &all[i]->dictionary;
		all[i]->dead_zone = of->dead_zone;
		all[i]->trace = of->trace;
		all[i]->floor = of->floor;
		estimator_start(all[i]);
	}
	rules_save(t);
}

static wide largest(wide a, wide b) {
	return a > b ? a : b;
}

/* The largest square of innovation i that is no outlier. */
static wide limit(const rules *t, size_t i) {
	return t->multiple * t->multiple *
	       largest(largest(t->variance[i], t->floor * t->floor), t->recent_variance[i]);
}

static int is_outlier(rules *t, const wide *square) {
	int found = 0;
	if (t->grace > 0 || t->n_variance < t->window) { return 0; }
	for (size_t i = 0; i < t->N; i++) { found = found || above(t, square[i], limit(t, i)); }
	return found;
}

/* The squares of what the model predicts wrongly; 0 where they do not fit. */
static int squares_of(estimator *model, const real *zeta, const real *psi_next, wide *square) {
	real predicted[MOST_N];
	const size_t N = model->dictionary.n_lifted;
	wide sum = 0;
	const int fits = KOOP(rls_predict)(&model->rls, zeta, zeta + N, predicted) == KOOP_OK;
	for (size_t i = 0; i < N; i++) {
		const wide error = fits ? (wide)(real)(psi_next[i] - predicted[i]) : (wide)REAL_MAX;
		square[i] = error * error;
		sum += square[i];
	}
	return fits && sum < (wide)REAL_MAX;
}

/* The mean of the squares in units of `usual`, no more than a sample may have that is no outlier. */
static wide strain_of(const rules *t, const wide *square, const wide *usual, int fits) {
	const wide most = t->multiple * t->multiple;
	wide sum = 0;
	for (size_t i = 0; i < t->N; i++) {
		sum += square[i] / (largest(usual[i], t->floor * t->floor) + (wide)REAL_MIN);
	}
	return fits && sum < most * (wide)t->N ? sum / (wide)t->N : most;
}

/* A sample that was learned. */
static void count_taken(rules *t, const wide *square) {
	for (size_t i = 0; i < t->N; i++) {
		const wide most = largest(limit(t, i), (wide)REAL_EPSILON * square[i]);
		const wide seen = square[i] > most ? most : square[i];
		t->recent_variance[i] =
		    t->recent_variance[i] * (wide)(t->window - 1) / (wide)t->window + seen / (wide)t->window;
	}
	if (t->grace > 0) {
		t->grace--;
		return;
	}
	if (t->first > 0) {
		t->first--;
		return;
	}
	if (t->refused > 0) { t->refused--; }
	if (t->suspect_for > 0) { return; }
	if (t->n_variance < MEMORY) { t->n_variance++; }
	for (size_t i = 0; i < t->N; i++) {
		t->variance[i] = t->variance[i] * (wide)(t->n_variance - 1) / (wide)t->n_variance +
		                 square[i] / (wide)t->n_variance;
	}
}

static void bring_back(rules *t, int lost) {
	if (t->restored_once) {
		CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&t->learner.rls, t->judge.rls.theta));
	} else {
		t->learner = t->kept;
	}
	if (lost) { CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&t->learner.rls, t->learner.config.p0)); }
	t->restored_once = 1;
	t->restored++;
}

/* Whether the mean strain of this window is one of a model that still fits. */
static int fits_yet(rules *t, wide strain) {
	return above(t, (wide)1.5L * (wide)t->judged, strain);
}

/* A change that is believed: what is usual is learned anew, from here on. */
static void believe_a_change(rules *t) {
	if (!t->changed) { memcpy(t->previous_variance, t->variance, sizeof t->previous_variance); }
	t->changed = 1;
	t->n_variance = t->window;
}

/* At the end of a window: whether the learner is to be saved, as no fault is at work. */
static int is_sound(rules *t) {
	const int young = t->n_variance <= t->window;
	if (young || fits_yet(t, t->kept_nis)) {
		t->suspect_for = 0;
		return 1;
	}
	t->suspect_for += t->window;
	if (t->suspect_for < t->hold) { return 0; }
	t->suspect_for = 0;
	believe_a_change(t);
	return 1;
}

/* Whether what is saved has done so much better that it comes back. */
static int is_worse_than_kept(rules *t) {
	const wide margin = t->restored_once ? (wide)1.2L : (wide)1.05L;
	if (t->suspect_for == 0 && fits_yet(t, t->nis)) { return 0; }
	return above(t, t->nis, margin * t->kept_nis);
}

static void settle(rules *t) {
	const int poor = above(t, t->nis, 5 * (wide)t->window);
	if (t->worst == KOOP_TRUSTED && poor) { t->worst = KOOP_DOUBTFUL; }
	if (t->worst < t->trust) {
		t->trust--;
	} else {
		t->trust = t->worst;
	}
	t->worst = KOOP_TRUSTED;
}

static void end_window(rules *t) {
	if (t->changed && fits_yet(t, t->previous_nis)) {
		memcpy(t->variance, t->previous_variance, sizeof t->variance);
		memcpy(t->recent_variance, t->previous_variance, sizeof t->recent_variance);
		t->changed = 0;
	}
	const int lost = t->failed == t->window, worse = is_worse_than_kept(t), sound = is_sound(t);
	if (lost || worse) {
		bring_back(t, lost);
	} else if (sound) {
		rules_save(t);
		t->restored_once = 0;
	}
	settle(t);
	t->judged = t->failed = 0;
	t->nis = t->kept_nis = t->previous_nis = 0;
}

/* What a sample says of the model by itself. */
static int verdict(rules *t, int status) {
	const int failed = status != KOOP_OK && status != KOOP_E_OUTLIER;
	if (failed || !t->learner.rls.positive_definite) { return KOOP_REFUSE; }
	if (above(t, t->nis, 12 * (wide)t->window)) { return KOOP_REFUSE; }
	if (status == KOOP_E_OUTLIER || t->grace > 0 || t->n_variance <= t->window) { return KOOP_DOUBTFUL; }
	return KOOP_TRUSTED;
}

/* One sample, by the rules. */
static int rules_update(rules *t, const real *zeta, const real *psi_next, KOOP(health) *health) {
	wide square[MOST_N], kept_square[MOST_N];
	const int fits = squares_of(&t->learner, zeta, psi_next, square);
	const int kept_fits = squares_of(&t->judge, zeta, psi_next, kept_square);
	int status = KOOP_E_OUTLIER;
	if (!fits || !is_outlier(t, square)) { status = estimator_update(&t->learner, zeta, psi_next, health); }
	if (status == KOOP_E_INPUT) { return status; }

	if (status == KOOP_OK) { count_taken(t, square); }
	if (status == KOOP_E_OUTLIER) {
		t->refused++;
		if (t->refused >= t->patience) { t->grace = t->window; }
	}
	t->nis += strain_of(t, square, t->variance, fits);
	t->kept_nis += strain_of(t, kept_square, t->variance, kept_fits);
	if (t->changed) { t->previous_nis += strain_of(t, square, t->previous_variance, fits); }
	if (status != KOOP_OK && status != KOOP_E_OUTLIER) { t->failed++; }
	const int now = verdict(t, status);
	if (now > t->worst) { t->worst = now; }
	if (t->worst > t->trust) { t->trust = t->worst; }
	t->judged++;
	if (t->judged == t->window) { end_window(t); }
	return status;
}

/* ---- both of them ------------------------------------------------------------------------------- */

static void check_means(const real *now, const wide *expected, const char *what) {
	/* three roundings a sample, of which those of so many samples last */
	const wide roundings = 3 * (wide)(twin.n_variance + twin.window);
	for (size_t i = 0; i < twin.N; i++) {
		CHECK(fabs((wide)now[i] - expected[i]) <=
		          roundings * (wide)REAL_EPSILON * expected[i] + (wide)REAL_MIN,
		      "%s: %s[%d] is %.9g instead of %.9g", estimator_name(&e), what, (int)i, (double)now[i],
		      (double)expected[i]);
	}
}

static void check_sum(real now, wide expected, const char *what) {
	const wide roundings = 3 * (wide)(twin.n_variance + twin.window) + 8 * MOST_N;
	CHECK(fabs((wide)now - expected) <= roundings * (wide)REAL_EPSILON * expected,
	      "%s: %s is %.9g instead of %.9g", estimator_name(&e), what, (double)now, (double)expected);
}

/* What is learned, and what it was when it was saved, to the bit. */
static void check_models(void) {
	const size_t bytes = e.rls.kept * sizeof(real);
	CHECK(memcmp(e.rls.theta, twin.learner.rls.theta, bytes) == 0, "%s: learner", estimator_name(&e));
	CHECK(memcmp(gate.saved.theta, twin.kept.storage, bytes) == 0, "%s: saved", estimator_name(&e));
	TEST_ASSERT_EQUAL_INT(twin.learner.rls.positive_definite, e.rls.positive_definite);
}

static void check_counts(void) {
	TEST_ASSERT_EQUAL_INT(twin.trust, KOOP(gate_trust)(&gate));
	TEST_ASSERT_EQUAL_size_t(twin.restored, gate.restored);
	TEST_ASSERT_EQUAL_size_t(twin.refused, gate.refused);
	TEST_ASSERT_EQUAL_size_t(twin.n_variance, gate.n_variance);
	TEST_ASSERT_EQUAL_size_t(twin.first, gate.warm_up);
	TEST_ASSERT_EQUAL_size_t(twin.grace, gate.grace);
	TEST_ASSERT_EQUAL_size_t(twin.suspect_for, gate.suspect_for);
	TEST_ASSERT_EQUAL_size_t(twin.judged, gate.judged);
	TEST_ASSERT_EQUAL_size_t(twin.failed, gate.failed);
	TEST_ASSERT_EQUAL_INT(twin.restored_once, gate.restored_once);
	TEST_ASSERT_EQUAL_INT(twin.changed, gate.changed);
	TEST_ASSERT_EQUAL_INT(twin.worst, gate.worst);
	TEST_ASSERT_EQUAL_size_t(twin.repaired[0], e.rls.repaired);
	TEST_ASSERT_EQUAL_size_t(twin.repaired[1], gate.saved.repaired);
}

/* The sum of words of 32 bits and that of each times its distance from the end, for a gate of a learner that
 * has a checksum. */
static void check_checksum(void) {
	const size_t from = offsetof(KOOP(gate), warm_up), state = offsetof(KOOP(gate), sum) - from;
	const size_t means = 3 * twin.N * sizeof(real);
	uint32_t words[(3 * MOST_N * sizeof(real) + sizeof(KOOP(gate))) / 4];
	koop_checksum expected = {0, 0};
	memcpy(words, gate.variance, means);
	memcpy(words + means / 4, (const unsigned char *)&gate + from, state);
	const size_t count = (means + state) / 4;
	for (size_t i = 0; i < count; i++) {
		expected.words += words[i];
		expected.weighted += (uint64_t)words[i] * (count - i);
	}
	TEST_ASSERT_EQUAL_MEMORY(&expected, &gate.sum, sizeof expected);
}

static void check_all(void) {
	if (e.config.checksum) { check_checksum(); }
	check_counts();
	check_models();
	check_means(gate.variance, twin.variance, "usual");
	check_means(gate.recent_variance, twin.recent_variance, "recent");
	check_means(gate.previous_variance, twin.previous_variance, "before");
	check_sum(gate.nis, twin.nis, "strain");
	check_sum(gate.saved_nis, twin.kept_nis, "saved_strain");
	check_sum(gate.previous_nis, twin.previous_nis, "past_strain");
}

/* A refused sample has no more to say than its innovation. */
static void check_health(int status, const KOOP(health) *now, const KOOP(health) *expected) {
	if (status == KOOP_E_OUTLIER) {
		TEST_ASSERT_EQUAL_INT(0, now->frozen);
		TEST_ASSERT_EQUAL_INT(1, now->finite);
		return;
	}
	TEST_ASSERT_TRUE(memcmp(&now->innovation, &expected->innovation, sizeof(real)) == 0);
	TEST_ASSERT_TRUE(memcmp(&now->trace, &expected->trace, sizeof(real)) == 0);
	TEST_ASSERT_EQUAL_INT(expected->frozen, now->frozen);
	TEST_ASSERT_EQUAL_INT(expected->finite, now->finite);
	TEST_ASSERT_EQUAL_INT(expected->positive_definite, now->positive_definite);
}

/* A sample to both; its status. */
static int both(const real *zeta, const real *psi_next) {
	KOOP(health) health, expected_health;
	const int expected = rules_update(&twin, zeta, psi_next, &expected_health);
	const int status = KOOP(gate_update)(&gate, &e.rls, zeta, zeta + twin.N, psi_next, &health);
	if (twin.close) { return status; }
	CHECK(status == expected, "%s: status %d instead of %d", estimator_name(&e), status, expected);
	check_health(status, &health, &expected_health);
	check_all();
	return status;
}

static void start(size_t N, size_t m, const KOOP(regulator) *regulator, const KOOP(form) *form,
                  const KOOP(gate_config) *config, int checksum) {
	estimator_settings(&e, N, m, regulator, form);
	e.dead_zone.delta = (real)NOISE;
	e.config.p0 = 10000;
	e.trace.tau0 = (real)(N + m);
	e.config.checksum = checksum;
	estimator_start(&e);
	for (size_t i = 0; i < REALS; i++) { storage[i] = (real)NAN; } /* what it holds does not matter */
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, config, &e.rls, storage, REALS));
	rules_start(&twin, &e, config);
	check_all();
}

/* ---- random robots and faults ------------------------------------------------------------------- */

/* What goes on, for some samples. */
enum { WELL, SPIKES, CHANGED, SMALL_FAULT, LONG_FAULT, LOST, TOO_LARGE, REST, LOUDER, GOINGS_ON };

static void robot(real *zeta, real *psi_next, double gain, double noise) {
	const size_t N = twin.N, d = twin.window / 4;
	random_fill(&random, zeta, d, -1, 1);
	for (size_t i = 0; i < N; i++) {
		psi_next[i] = (real)(gain * ((double)zeta[i + 1] / 2 - (double)zeta[i])) +
		              random_uniform(&random, -noise, noise);
	}
}

static void spoil(real *zeta, real *psi_next, int going_on) {
	static const double lost[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	const size_t N = twin.N, d = twin.window / 4, i = random_below(&random, N);
	if (going_on == SPIKES && random_below(&random, 4) == 0) {
		psi_next[i] += random_uniform(&random, -0.1, 0.1);
	}
	if (going_on == LONG_FAULT) { random_fill(&random, psi_next, N, -1, 1); }
	if (going_on == LOST) {
		(random_below(&random, 2) ? zeta : psi_next)[i] = (real)lost[random_below(&random, 3)];
	}
	if (going_on == TOO_LARGE) { zeta[random_below(&random, d)] = REAL_MAX / 4; }
	if (going_on == REST) {
		memset(zeta, 0, d * sizeof *zeta);
		memset(psi_next, 0, N * sizeof *psi_next);
	}
}

static void sample_of(int going_on, real *zeta, real *psi_next) {
	const double gain = going_on == CHANGED ? -1 : going_on == SMALL_FAULT ? 0.995 : 1;
	robot(zeta, psi_next, gain, going_on == LOUDER ? 4 * NOISE : NOISE);
	spoil(zeta, psi_next, going_on);
}

static void flip(void *at, size_t bits) {
	const size_t bit = random_below(&random, bits);
	((unsigned char *)at)[bit / 8] ^= (unsigned char)(1u << bit % 8);
}

/* No single bit accounts for this. */
static void flip_two(koop_checksum *sum) {
	sum->words ^= 32;
	sum->weighted ^= 8;
}

/* One flipped bit leaves no trace; of two, what they are in begins anew. */
static void flip_something(void) {
	const size_t from = offsetof(KOOP(gate), warm_up), which = random_below(&random, 7);
	KOOP(rls) *const model = which % 2 ? &gate.saved : &e.rls;
	if (which < 2) {
		flip(model->theta, model->kept * 8 * sizeof(real));
		twin.repaired[which]++;
	}
	if (which == 2) { flip(gate.variance, 3 * twin.N * 8 * sizeof(real)); }
	if (which == 3) { flip((unsigned char *)&gate + from, (sizeof gate - from) * 8); }
	if (which == 4 || which == 5) { flip_two(&model->sum); }
	if (which == 4) {
		twin.learner = twin.kept;
		twin.restored++;
	}
	if (which == 5) { rules_save(&twin); }
	if (which == 6) {
		flip_two(&gate.sum);
		rules_begin(&twin);
	}
}

/* One setting in three is the default. */
static KOOP(gate_config) some_settings(void) {
	KOOP(gate_config) config = {0, 0, 0, 50 + random_below(&random, 200)};
	if (random_below(&random, 3)) { config.multiple = random_uniform(&random, 1, 8); }
	if (random_below(&random, 3) == 0) { config.floor = random_uniform(&random, 0, 2 * NOISE); }
	if (random_below(&random, 3)) { config.patience = 1 + random_below(&random, 12); }
	if (random_below(&random, 3) == 0) { config.hold = 1 + random_below(&random, 30); }
	return config;
}

/* Samples that were compared. */
static int run_round(int round) {
	const KOOP(gate_config) config = some_settings();
	const size_t N = 1 + random_below(&random, MOST_N), m = 1 + random_below(&random, MOST_M);
	int going_on = WELL, left = 100, k = 0;
	start(N, m, all_regulators[round % REGULATORS], all_forms[round / REGULATORS % FORMS], &config,
	      round % 2);
	for (; k < SAMPLES && !twin.close; k++) {
		real zeta[MOST_D], psi_next[MOST_N];
		if (left-- == 0) {
			going_on = going_on == WELL ? (int)random_below(&random, GOINGS_ON) : WELL;
			left = 1 + (int)random_below(&random, going_on == TOO_LARGE ? 80 : 200);
		}
		sample_of(going_on, zeta, psi_next);
		if (round % 2 && random_below(&random, 50) == 0) { flip_something(); }
		(void)both(zeta, psi_next);
	}
	return k;
}

static void test_gate_follows_its_rules_whatever_comes(void) {
	long compared = 0;
	random = random_seed(401);
	for (int round = 0; round < ROUNDS; round++) { compared += run_round(round); }
	printf("%ld of %ld samples compared\n", compared, (long)ROUNDS * SAMPLES);
	CHECK(2 * compared >= (long)ROUNDS * SAMPLES, "only %ld samples compared", compared);
}

/* A memory that nothing sound is left in says nothing of the sample, and the models are not to be used. */
static void test_what_cannot_be_mended_changes_trust_alone(void) {
	real zeta[MOST_D], psi_next[MOST_N];
	static KOOP(gate) before;
	random = random_seed(402);
	start(3, 2, &KOOP(reg_ef), &KOOP(form_sqrt), &(KOOP(gate_config)){0}, 1);
	for (int k = 0; k < 100 && !twin.close; k++) {
		sample_of(WELL, zeta, psi_next);
		CHECK_STATUS(KOOP_OK, both(zeta, psi_next));
	}
	flip_two(&e.rls.sum);
	flip_two(&gate.saved.sum);
	before = gate;
	KOOP(health) health;
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(gate_update)(&gate, &e.rls, zeta, zeta + 3, psi_next, &health));
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, KOOP(gate_trust)(&gate));
	TEST_ASSERT_TRUE(health.innovation <= 0 && health.innovation >= 0 && !health.frozen);
	twin.trust = twin.worst = KOOP_REFUSE;
	check_all();
	check_means(before.recent_variance, twin.recent_variance, "recent");
}

/* Whether P is known not to be positive definite is saved and comes back with it. The learner, spoilt, gets
 * what is saved, and an outlier leaves that as it is. */
static void test_definiteness_is_saved_and_comes_back(void) {
	for (int saved = 0; saved < 2; saved++) {
		real zeta[MOST_D], psi_next[MOST_N];
		random = random_seed(403);
		start(3, 2, &KOOP(reg_ef), &KOOP(form_plain), &(KOOP(gate_config)){0}, 1);
		for (int k = 0; k < 100; k++) {
			sample_of(WELL, zeta, psi_next);
			CHECK_STATUS(KOOP_OK, KOOP(gate_update)(&gate, &e.rls, zeta, zeta + 3, psi_next, NULL));
		}
		gate.saved.positive_definite = saved;
		e.rls.positive_definite = !saved;
		flip_two(&e.rls.sum);
		psi_next[1] += 100;
		CHECK_STATUS(KOOP_E_OUTLIER, KOOP(gate_update)(&gate, &e.rls, zeta, zeta + 3, psi_next, NULL));
		TEST_ASSERT_EQUAL_INT(saved, e.rls.positive_definite);
		CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &e.rls, storage, REALS));
		TEST_ASSERT_EQUAL_INT(saved, gate.saved.positive_definite);
	}
}

/* ---- at the limits themselves --------------------------------------------------------------------- */

/* A learner that never learns, so that Theta is what the test sets, at first 0, and the innovation of
 * zeta = 0 is psi_next itself. With one state a window is of 8 samples. */
enum { ONE_WINDOW = 8 };

static void start_fixed(size_t N, const KOOP(gate_config) *config) {
	estimator_settings(&e, N, 1, &KOOP(reg_dz_ks), &KOOP(form_sqrt));
	e.dead_zone.delta = REAL_MAX / 2;
	estimator_start(&e);
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, config, &e.rls, storage, REALS));
}

/* Samples of these innovations; how many were outliers. */
static int innovations(size_t N, double first, double others, int samples) {
	static const real zeta[MOST_D] = {0};
	real psi_next[MOST_N];
	int outliers = 0;
	for (size_t i = 0; i < N; i++) { psi_next[i] = (real)(i == 0 ? first : others); }
	for (int k = 0; k < samples; k++) {
		const int status = KOOP(gate_update)(&gate, &e.rls, zeta, zeta, psi_next, NULL);
		CHECK(status == KOOP_OK || status == KOOP_E_OUTLIER, "status %d", status);
		outliers += status == KOOP_E_OUTLIER;
	}
	return outliers;
}

static void check_exactly(double expected, real now) {
	CHECK((double)now >= expected && (double)now <= expected, "%.9g instead of %.9g", (double)now, expected);
}

/* The first window is let pass, and what is usual is learned from the second. */
static void test_what_is_usual_is_known_after_two_windows(void) {
	start_fixed(1, NULL);
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1000, 0, ONE_WINDOW));
	check_exactly(0, gate.variance[0]);
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 2, 0, 1));
	check_exactly(4, gate.variance[0]);
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 4, 0, 1));
	check_exactly(10, gate.variance[0]);
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1e4, 0, ONE_WINDOW - 2));
	TEST_ASSERT_EQUAL_INT(1, innovations(1, 1e9, 0, 1));
}

/* With a usual square of 1, known for longer than it is remembered lately. */
static void start_usual(size_t N, const KOOP(gate_config) *config) {
	start_fixed(N, config);
	TEST_ASSERT_EQUAL_INT(0, innovations(N, 1, 1, 4 * (int)(N + 1) * 20));
	for (size_t i = 0; i < N; i++) {
		check_exactly(1, gate.variance[i]);
		gate.recent_variance[i] = 1; /* where it tends to */
	}
}

static void test_an_innovation_of_five_times_the_usual_one_is_the_last_that_is_none(void) {
	for (int negative = 0; negative < 2; negative++) {
		const double sign = negative ? -1 : 1;
		start_usual(1, NULL);
		TEST_ASSERT_EQUAL_INT(1, innovations(1, sign * 5 * (1 + 2 * (double)REAL_EPSILON), 1, 1));
		TEST_ASSERT_EQUAL_INT(0, innovations(1, sign * 5, 1, 1));
	}
	for (size_t i = 0; i < 3; i++) { /* any of them */
		static const real zeta[MOST_D] = {0};
		real psi_next[3] = {1, 1, 1};
		start_usual(3, &(KOOP(gate_config)){.multiple = 2});
		psi_next[i] = 2 * (1 + 2 * REAL_EPSILON);
		CHECK_STATUS(KOOP_E_OUTLIER, KOOP(gate_update)(&gate, &e.rls, zeta, zeta, psi_next, NULL));
		psi_next[i] = 2;
		CHECK_STATUS(KOOP_OK, KOOP(gate_update)(&gate, &e.rls, zeta, zeta, psi_next, NULL));
	}
}

static void test_a_floor_is_an_innovation_not_its_square(void) {
	start_usual(1, &(KOOP(gate_config)){.multiple = 2, .floor = 8});
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 16, 0, 1));
	TEST_ASSERT_EQUAL_INT(1, innovations(1, 16 * (1 + 2 * (double)REAL_EPSILON), 0, 1));
}

static void test_defaults_are_those_that_are_said(void) {
	start_fixed(1, NULL);
	check_exactly(5, gate.config.multiple);
	check_exactly(0, gate.config.floor);
	TEST_ASSERT_EQUAL_size_t(5, gate.config.patience);
	TEST_ASSERT_EQUAL_size_t(1000, gate.config.hold);
}

static void test_the_least_settings_are_not_taken_for_defaults(void) {
	start_usual(1, &(KOOP(gate_config)){.multiple = 1, .patience = 1, .hold = 1});
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, 1));
	TEST_ASSERT_EQUAL_INT(1, innovations(1, 1 + 2 * (double)REAL_EPSILON, 0, 1));
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1e4, 0, 1)); /* patience is over */
	TEST_ASSERT_EQUAL_size_t(1, gate.config.hold);
}

/* What begins anew leaves what lies behind it alone. */
static void test_a_gate_writes_nothing_behind_itself(void) {
	static struct {
		KOOP(gate) gate;
		unsigned char behind[sizeof(KOOP(gate))];
	} one;
	static const real zeta[MOST_D] = {0}, psi_next[MOST_N] = {0};
	estimator_settings(&e, 2, 1, &KOOP(reg_ef), &KOOP(form_sqrt));
	e.config.checksum = 1;
	estimator_start(&e);
	memset(one.behind, 0x5a, sizeof one.behind);
	for (int k = 0; k < 2; k++) {
		if (k == 0) { CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&one.gate, NULL, &e.rls, storage, REALS)); }
		flip_two(&one.gate.sum);
		CHECK_STATUS(KOOP_OK, KOOP(gate_update)(&one.gate, &e.rls, zeta, zeta, psi_next, NULL));
		for (size_t i = 0; i < sizeof one.behind; i++) { TEST_ASSERT_EQUAL_INT(0x5a, one.behind[i]); }
	}
}

static void test_samples_are_taken_for_a_window_when_patience_is_over(void) {
	start_usual(1, NULL);
	TEST_ASSERT_EQUAL_INT(5, innovations(1, 100, 0, 5 + ONE_WINDOW));
	TEST_ASSERT_EQUAL_INT(1, innovations(1, 1e4, 0, 1)); /* patience has not come back yet */
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1e4, 0, ONE_WINDOW));
}

/* Outliers less samples taken since. */
static void test_each_sample_taken_makes_up_for_an_outlier(void) {
	start_usual(1, NULL);
	TEST_ASSERT_EQUAL_INT(4, innovations(1, 1e4, 0, 4));
	TEST_ASSERT_EQUAL_size_t(4, gate.refused);
	for (size_t left = 4; left-- > 0;) {
		TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, 1));
		TEST_ASSERT_EQUAL_size_t(left, gate.refused);
	}
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, 1));
	TEST_ASSERT_EQUAL_size_t(0, gate.refused);
}

/* A plain mean of up to 5,000 samples; from then on a new one counts for a 5,000th. */
static void test_what_is_usual_is_remembered_for_five_thousand_samples(void) {
	start_fixed(1, &(KOOP(gate_config)){.floor = 100}); /* so that nothing is out of the ordinary */
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, ONE_WINDOW + MEMORY - 1));
	TEST_ASSERT_EQUAL_size_t(MEMORY - 1, gate.n_variance);
	for (int k = 0; k < 2; k++) {
		gate.variance[0] = 1;
		TEST_ASSERT_EQUAL_INT(0, innovations(1, 4, 0, 1));
		TEST_ASSERT_EQUAL_size_t(MEMORY, gate.n_variance);
		CHECK(fabs((wide)gate.variance[0] - (1 + (wide)15 / MEMORY)) <= 2 * (wide)REAL_EPSILON, "%.9g",
		      (double)gate.variance[0]);
	}
}

/* A sample counts for no more than the gate admits at most, so that one huge sample does not open it. */
static void test_recent_samples_count_for_what_is_admitted_at_most(void) {
	start_usual(1, &(KOOP(gate_config)){.patience = 1});
	TEST_ASSERT_EQUAL_INT(1, innovations(1, 1e4, 0, 1)); /* open from here on */
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1e4, 0, 1));
	check_exactly(1 + 24.0 / ONE_WINDOW, gate.recent_variance[0]);
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 2, 0, 1));
	check_exactly(4, gate.recent_variance[0]); /* a square of what it is leaves it alone */
}

/* Eight samples whose mean square is 1.5 times what is usual by the floor, or less by a rounding of one. */
static void a_window_of_one_and_a_half(int less) {
	static const double sizes[ONE_WINDOW] = {4, 2, 0, 2, 2, 0, 4, 2};
	for (int k = 0; k < ONE_WINDOW; k++) {
		const double size = k == 0 && less ? 4 * (1 - 8 * (double)REAL_EPSILON) : sizes[k];
		TEST_ASSERT_EQUAL_INT(0, innovations(1, size, 0, 1));
	}
}

static void test_a_mean_square_of_one_and_a_half_is_the_first_that_is_in_doubt(void) {
	for (int less = 0; less < 2; less++) {
		start_fixed(1, &(KOOP(gate_config)){.floor = 2});
		TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, 4 * ONE_WINDOW));
		a_window_of_one_and_a_half(less);
		TEST_ASSERT_EQUAL_size_t(less ? 0 : ONE_WINDOW, gate.suspect_for);
	}
}

/* A change is believed as soon as samples have been in doubt for as long as `hold`, and what was usual before
 * is kept: the mean of 24 squares of 1 and of the first window in doubt, as nobody doubted it at the time. */
static void test_a_change_is_believed_when_hold_is_over(void) {
	start_fixed(1, &(KOOP(gate_config)){.floor = 2, .hold = 3 * ONE_WINDOW});
	TEST_ASSERT_EQUAL_INT(0, innovations(1, 1, 0, 4 * ONE_WINDOW));
	for (size_t window = 1; window <= 3; window++) {
		TEST_ASSERT_EQUAL_INT(0, gate.changed);
		a_window_of_one_and_a_half(0);
		TEST_ASSERT_EQUAL_size_t(window < 3 ? window * ONE_WINDOW : 0, gate.suspect_for);
	}
	TEST_ASSERT_EQUAL_INT(1, gate.changed);
	check_exactly((24 + 48) / 32.0, gate.previous_variance[0]);
	TEST_ASSERT_EQUAL_size_t(ONE_WINDOW, gate.n_variance);
}

/* ---- trust, at the limits ---- */

/* A window in which the mean square is exactly this many times the usual one; trust at its end. The gate
 * is so wide that there is no outlier, and what is usual is set again before each sample. */
static int trust_after_window_of(double squares) {
	start_usual(1, &(KOOP(gate_config)){.multiple = 100, .hold = 100000});
	for (int k = 0; k < 3 * ONE_WINDOW || gate.judged > 0; k++) { (void)innovations(1, 1, 0, 1); }
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, KOOP(gate_trust)(&gate));
	gate.nis = (real)(squares * ONE_WINDOW);
	gate.judged = ONE_WINDOW - 1;
	(void)innovations(1, 0, 0, 1);
	return KOOP(gate_trust)(&gate);
}

static void test_a_mean_square_of_five_and_of_twelve_are_the_last_before_doubt_and_alarm(void) {
	const double beside = 1 + 2 * (double)REAL_EPSILON;
	TEST_ASSERT_EQUAL_INT(KOOP_TRUSTED, trust_after_window_of(5));
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust_after_window_of(5 * beside));
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, trust_after_window_of(12));
	TEST_ASSERT_EQUAL_INT(KOOP_REFUSE, trust_after_window_of(12 * beside));
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_gate_follows_its_rules_whatever_comes);
	RUN_TEST(test_definiteness_is_saved_and_comes_back);
	RUN_TEST(test_what_cannot_be_mended_changes_trust_alone);
	RUN_TEST(test_what_is_usual_is_known_after_two_windows);
	RUN_TEST(test_an_innovation_of_five_times_the_usual_one_is_the_last_that_is_none);
	RUN_TEST(test_a_floor_is_an_innovation_not_its_square);
	RUN_TEST(test_defaults_are_those_that_are_said);
	RUN_TEST(test_the_least_settings_are_not_taken_for_defaults);
	RUN_TEST(test_a_gate_writes_nothing_behind_itself);
	RUN_TEST(test_samples_are_taken_for_a_window_when_patience_is_over);
	RUN_TEST(test_each_sample_taken_makes_up_for_an_outlier);
	RUN_TEST(test_what_is_usual_is_remembered_for_five_thousand_samples);
	RUN_TEST(test_recent_samples_count_for_what_is_admitted_at_most);
	RUN_TEST(test_a_mean_square_of_one_and_a_half_is_the_first_that_is_in_doubt);
	RUN_TEST(test_a_change_is_believed_when_hold_is_over);
	RUN_TEST(test_a_mean_square_of_five_and_of_twelve_are_the_last_before_doubt_and_alarm);
	return UNITY_END();
}
