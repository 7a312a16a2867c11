/* One kind of estimator through every fault again and again, bare and behind the gate, each beside a
 * twin that gets the same samples without the fault. A JSON line for each fault and way of use.
 *
 *     soak_koopf DICTIONARY REGULATOR FORM UPDATES SEED
 *
 * UPDATES of each estimator: episodes follow until there are as many. An episode is a stretch of fault,
 * then healthy samples. */
#include "faults.h"

#include <stdio.h>
#include <stdlib.h>

enum {
	MOST_LIFTED = 30,
	MOST_REGRESSORS = MOST_LIFTED + MOST_INPUTS,
	LEARNING = 1000,  /* healthy samples before the first fault */
	LEAST_FAULT = 10, /* samples */
	MOST_FAULT = 400,
	WINDOW = 200,       /* samples that an error is the mean of */
	MOST_HEALTHY = 2500 /* samples after a fault */
};

static const double AS_GOOD = 1.1; /* times the twin's error */
static const double RANGE = 100;   /* of every sensor: beyond it a reading is none */

/* ---- One estimator ------------------------------------------------------------------------ */

enum { OK, INPUT, OVERFLOW, INDEFINITE, OUTLIER, OUT_OF_RANGE, STATUSES };
static const char *const status_names[STATUSES] = {"ok",         "input",   "overflow",
                                                   "indefinite", "outlier", "range"};

typedef struct {
	KOOP(rls) rls;
	KOOP(gate) gate;
	int gated;
	unsigned long count[STATUSES], unsound; /* samples by status; non-finite outputs with status OK */
	unsigned long lost, recoveries, episodes;
	size_t worst_recovery;
	double worst_ratio; /* of errors at the end of an episode */
	real storage[KOOP_RLS_REALS_PLAIN(MOST_LIFTED, MOST_INPUTS) + KOOP_EXTENSION_REALS_PLAIN(MOST_LIFTED, MOST_INPUTS)];
	real gate_storage[KOOP_GATE_REALS_PLAIN(MOST_LIFTED, MOST_INPUTS) + KOOP_EXTENSION_REALS_PLAIN(MOST_LIFTED, MOST_INPUTS)];
} learner;

static void fatal(const char *what) {
	fprintf(stderr, "soak: %s\n", what);
	exit(2);
}

static void learner_start(learner *l, const KOOP(config) *config, int gated) {
	memset(l, 0, sizeof *l);
	l->gated = gated;
	if (KOOP(rls_init)(&l->rls, config, l->storage, sizeof l->storage / sizeof *l->storage) ||
	    KOOP(gate_init)(&l->gate, NULL, &l->rls, l->gate_storage,
	                    sizeof l->gate_storage / sizeof *l->gate_storage)) {
		fatal("an estimator did not start");
	}
}

static int known_status(int status) {
	switch (status) {
	case KOOP_OK: return OK;
	case KOOP_E_INPUT: return INPUT;
	case KOOP_E_OVERFLOW: return OVERFLOW;
	case KOOP_E_INDEFINITE: return INDEFINITE;
	case KOOP_E_OUTLIER: return OUTLIER;
	default: fatal(KOOP(status_message)(status));
	}
	return OK;
}

static int finite(const real *x, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (!isfinite(x[i])) { return 0; }
	}
	return 1;
}

/* A sample as the estimator gets it. */
typedef struct {
	real psi[MOST_LIFTED], u[MOST_INPUTS], next[MOST_LIFTED];
} lifted;

static void to_real(real *y, const double *x, size_t count) {
	for (size_t i = 0; i < count; i++) { y[i] = (real)x[i]; }
}

static int lift_sample(const plant *robot, const KOOP(dictionary) *dictionary, const sample *s, lifted *out) {
	real x[MOST_STATES], next[MOST_STATES];
	to_real(x, s->x, robot->n);
	to_real(next, s->next, robot->n);
	to_real(out->u, s->u, robot->m);
	const int status = KOOP(lift)(dictionary, x, out->psi);
	return status ? status : KOOP(lift)(dictionary, next, out->next);
}

/* What is not spoilt, drawn and lifted. */
static sample draw_healthy(const plant *robot, const KOOP(dictionary) *dictionary, random_source *random,
                           lifted *seen) {
	sample s;
	plant_draw(robot, random, 1, &s);
	if (lift_sample(robot, dictionary, &s, seen)) { fatal("a healthy sample was refused"); }
	return s;
}

static int in_range(const double *x, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (isfinite(x[i]) && fabs(x[i]) > RANGE) { return 0; }
	}
	return 1;
}

/* Learns from it; returns the error of the prediction before. */
static double learn(learner *l, const lifted *s) {
	const size_t N = l->rls.n_lifted;
	real predicted[MOST_LIFTED];
	KOOP(health) health;
	double square = 0;
	const int told = KOOP(rls_predict)(&l->rls, s->psi, s->u, predicted);
	for (size_t i = 0; i < N; i++) {
		const double error = told ? (double)INFINITY : (double)s->next[i] - (double)predicted[i];
		square += error * error;
	}
	const int status = l->gated ? KOOP(gate_update)(&l->gate, &l->rls, s->psi, s->u, s->next, &health)
	                            : KOOP(rls_update)(&l->rls, s->psi, s->u, s->next, &health);
	l->count[known_status(status)]++;
	l->unsound += !told && !finite(predicted, N);
	l->unsound += !status && !(isfinite(health.innovation) && health.finite && health.min_diagonal > 0);
	return sqrt(square);
}

/* A sample that a fault has had its hands on. */
static void learn_spoilt(learner *l, const plant *robot, const sample *s) {
	lifted seen;
	if (l->gated && !(in_range(s->x, robot->n) && in_range(s->u, robot->m) && in_range(s->next, robot->n))) {
		l->count[OUT_OF_RANGE]++;
		return;
	}
	const int status = lift_sample(robot, l->rls.config.dictionary, s, &seen);
	if (status) {
		l->count[known_status(status)]++;
		return;
	}
	l->unsound += !finite(seen.psi, l->rls.n_lifted) || !finite(seen.next, l->rls.n_lifted);
	learn(l, &seen);
}

/* 1 unless P = L L' with a positive diagonal, in long double */
static int is_indefinite(const real *P, size_t d) {
	static wide L[MOST_REGRESSORS][MOST_REGRESSORS];
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			wide sum = (wide)P[i * d + j];
			for (size_t k = 0; k < j; k++) { sum -= L[i][k] * L[j][k]; }
			if (i == j && !(sum > 0)) { return 1; }
			L[i][j] = i == j ? sqrtl(sum) : sum / L[j][j];
		}
	}
	return 0;
}

/* Whether Theta or P is no longer one. The root form's P is definite by construction, but rounded to this
 * precision it need not be, nor fit. */
static int is_lost(const learner *l) {
	static real theta[MOST_LIFTED * MOST_REGRESSORS], P[MOST_REGRESSORS * MOST_REGRESSORS];
	const size_t d = l->rls.n_regressors;
	if (KOOP(rls_get_theta)(&l->rls, theta) || !finite(theta, l->rls.n_lifted * d)) { return 1; }
	const int status = KOOP(rls_get_covariance)(&l->rls, P);
	if (l->rls.config.form == &KOOP(form_sqrt)) {
		if (status == KOOP_E_OVERFLOW) { return !finite(l->rls.covariance, KOOP_TRIANGLE(d)); }
		for (size_t i = 0; i < d; i++) {
			if (!(P[i * d + i] > 0)) { return 1; }
		}
		return status != KOOP_OK;
	}
	return status != KOOP_OK || !finite(P, d * d) || is_indefinite(P, d);
}

/* ---- Episodes ------------------------------------------------------------------------------ */

typedef struct {
	const plant *robot;
	const KOOP(dictionary) *dictionary;
	size_t fault, healthy;  /* lengths */
	sample raw[MOST_FAULT]; /* of the fault's stretch, before it */
	lifted seen[MOST_FAULT + MOST_HEALTHY];
	double twin[2][MOST_HEALTHY]; /* errors of the twins, bare and gated */
} episode;

static void episode_draw(episode *e, random_source *random) {
	e->fault = LEAST_FAULT + random_below(random, MOST_FAULT - LEAST_FAULT + 1);
	for (size_t k = 0; k < e->fault + e->healthy; k++) {
		const sample s = draw_healthy(e->robot, e->dictionary, random, &e->seen[k]);
		if (k < e->fault) { e->raw[k] = s; }
	}
}

static double mean(const double *x, size_t count) {
	double sum = 0;
	for (size_t i = 0; i < count; i++) { sum += x[i]; }
	return sum / (double)count;
}

/* Healthy samples after which a window is as good as the twin's: at most so far off, or no further than the
 * dead zone, which has nothing to learn there. `count` if none is. */
static size_t time_to_recover(const double *error, const double *twin, size_t count, double dead_zone) {
	for (size_t k = 0; k + WINDOW <= count; k++) {
		if (mean(error + k, WINDOW) <= fmax(AS_GOOD * mean(twin + k, WINDOW), dead_zone)) { return k; }
	}
	return count;
}

static void run_twin(learner *l, episode *e) {
	for (size_t k = 0; k < e->fault; k++) { learn(l, &e->seen[k]); }
	for (size_t k = 0; k < e->healthy; k++) { e->twin[l->gated][k] = learn(l, &e->seen[e->fault + k]); }
}

static real delta_of(const KOOP(rls) *rls) {
	return ((const KOOP(dead_zone) *)rls->config.settings)->delta;
}

static double dead_zone(const learner *l) {
	const KOOP(regulator) *regulator = l->rls.config.regulator;
	const int has_one = regulator == &KOOP(reg_dz_cs) || regulator == &KOOP(reg_dz_ks);
	return has_one ? (double)delta_of(&l->rls) : 0;
}

static void run_faulty(learner *l, const episode *e, const fault *f, random_source random, size_t limit) {
	static double error[MOST_HEALTHY];
	stretch now = stretch_begin(e->robot, random, &e->raw[0]);
	for (size_t k = 0; k < e->fault; k++) {
		sample s = e->raw[k];
		stretch_spoil(f, &now, &s);
		learn_spoilt(l, e->robot, &s);
	}
	l->lost += (unsigned long)is_lost(l);
	for (size_t k = 0; k < e->healthy; k++) { error[k] = learn(l, &e->seen[e->fault + k]); }
	l->lost += (unsigned long)is_lost(l);

	const double *twin = e->twin[l->gated], *end = error + e->healthy - WINDOW;
	const size_t recovery = time_to_recover(error, twin, e->healthy, dead_zone(l));
	l->episodes++;
	l->recoveries += recovery <= limit;
	l->worst_recovery = recovery > l->worst_recovery ? recovery : l->worst_recovery;
	l->worst_ratio = fmax(l->worst_ratio, mean(end, WINDOW) / mean(twin + (end - error), WINDOW));
}

/* ---- Set-up -------------------------------------------------------------------------------- */

/* Threshold of the dead zones: three quarters of the innovations of a model that has
 * been learned are smaller (paper, remark "Dead-Zone Threshold Selection"). */
static real calibrated(const KOOP(config) *config, const plant *robot, random_source random) {
	static learner l;
	static real scores[LEARNING];
	KOOP(config) plain = *config;
	plain.regulator = &KOOP(reg_none);
	plain.settings = NULL;
	real delta;
	learner_start(&l, &plain, 0);
	for (size_t k = 0; k < 2 * LEARNING; k++) {
		lifted seen;
		draw_healthy(robot, config->dictionary, &random, &seen);
		const double error = learn(&l, &seen);
		if (k >= LEARNING) { scores[k - LEARNING] = (real)error; }
	}
	if (KOOP(threshold)(scores, LEARNING, (real)0.75, &delta)) { fatal("no threshold"); }
	return delta;
}

/* Samples after which what was there before the fault has been outvoted five times. What does not forget does
 * not wait for that: the gate brings back what it knew. */
static size_t time_to_forget(const learner *l) {
	const KOOP(regulator) *regulator = l->rls.config.regulator;
	const int keeps = regulator == &KOOP(reg_none) || regulator == &KOOP(reg_sift);
	return keeps ? 0 : 5 * (size_t)ceil(1 / (1 - (double)l->rls.config.lambda));
}

/* The stated number of steps. The gate judges a model of d regressors by windows of 4 d samples: the one in
 * which the fault ends, one that tells what it has left behind, one more where P has wound up, and one for
 * the estimate to settle. */
static size_t stated_limit(const learner *l) {
	return 4 * 4 * l->rls.n_regressors + time_to_forget(l);
}

static void print_line(const learner *l, const char *condition, const char *precision, size_t limit) {
	const KOOP(config) *c = &l->rls.config;
	unsigned long updates = 0;
	for (int s = 0; s < STATUSES; s++) { updates += l->count[s]; }
	printf("{\"condition\": \"%s\", \"dictionary\": \"%s_%s\", \"regulator\": \"%s\", \"form\": \"%s\", "
	       "\"precision\": \"%s\", \"gate\": %d, \"updates\": %lu, \"refused\": {",
	       condition, c->dictionary->name, c->dictionary->n_states == 3 ? "ddr" : "fwmav", c->regulator->name,
	       c->form->name, precision, l->gated, updates);
	for (int s = INPUT; s < STATUSES; s++) {
		printf("%s\"%s\": %lu", s == INPUT ? "" : ", ", status_names[s], l->count[s]);
	}
	printf("}, \"restored\": %lu, \"non_finite_without_status\": %lu, \"lost\": %lu, \"episodes\": %lu, "
	       "\"recovered\": %lu, \"steps_to_recover\": %lu, \"limit\": %lu, \"error_ratio\": ",
	       (unsigned long)l->gate.restored, l->unsound, l->lost, l->episodes, l->recoveries,
	       (unsigned long)l->worst_recovery, (unsigned long)limit);
	printf(isfinite(l->worst_ratio) ? "%.6g}\n" : "null}\n", l->worst_ratio);
}

typedef struct {
	learner twin[2], faulty[2][FAULTS]; /* bare and gated */
	episode e;
} campaign;

static void run(campaign *c, const KOOP(config) *config, const plant *robot, unsigned long updates,
                uint64_t seed) {
	random_source random = random_seed(seed);
	c->e.robot = robot;
	c->e.dictionary = config->dictionary;
	for (int gated = 0; gated < 2; gated++) {
		learner_start(&c->twin[gated], config, gated);
		for (size_t f = 0; f < FAULTS; f++) { learner_start(&c->faulty[gated][f], config, gated); }
	}
	const size_t limit = stated_limit(&c->twin[0]);
	c->e.healthy = limit + WINDOW;
	if (c->e.healthy > MOST_HEALTHY) { fatal("MOST_HEALTHY is too small"); }

	for (size_t k = 0; k < LEARNING; k++) {
		lifted seen;
		draw_healthy(robot, config->dictionary, &random, &seen);
		for (int gated = 0; gated < 2; gated++) {
			learn(&c->twin[gated], &seen);
			for (size_t f = 0; f < FAULTS; f++) { learn(&c->faulty[gated][f], &seen); }
		}
	}
	unsigned long done = LEARNING;
	do {
		episode_draw(&c->e, &random);
		done += c->e.fault + c->e.healthy;
		const random_source own = random_seed(random_bits(&random));
		for (int gated = 0; gated < 2; gated++) {
			run_twin(&c->twin[gated], &c->e);
			for (size_t f = 0; f < FAULTS; f++) {
				run_faulty(&c->faulty[gated][f], &c->e, &all_faults[f], own, limit);
			}
		}
	} while (done < updates);

	for (int gated = 0; gated < 2; gated++) {
		for (size_t f = 0; f < FAULTS; f++) {
			print_line(&c->faulty[gated][f], all_faults[f].name, TEST_DOUBLE ? "f64" : "f32", limit);
		}
	}
}

static const KOOP(dictionary) *dictionary_called(const char *name) {
	if (strcmp(name, "poly_ddr") == 0) { return &KOOP(poly_ddr); }
	if (strcmp(name, "rbf_ddr") == 0) { return &KOOP(rbf_ddr); }
	if (strcmp(name, "poly_fwmav") == 0) { return &KOOP(poly_fwmav); }
	return strcmp(name, "rbf_fwmav") == 0 ? &KOOP(rbf_fwmav) : NULL;
}

int main(int count, char **arguments) {
	static campaign c;
	KOOP(config) config = {.p0 = 100, .check = KOOP_CHECK_REFUSE};
	if (count != 6) { fatal("DICTIONARY REGULATOR FORM UPDATES SEED"); }
	config.dictionary = dictionary_called(arguments[1]);
	for (int r = 0; r < REGULATORS; r++) {
		if (strcmp(all_regulators[r]->name, arguments[2]) == 0) { config.regulator = all_regulators[r]; }
	}
	for (int f = 0; f < FORMS; f++) {
		if (strcmp(all_forms[f]->name, arguments[3]) == 0) { config.form = all_forms[f]; }
	}
	if (!config.dictionary || !config.regulator || !config.form) {
		fatal("no such dictionary, regulator or form");
	}
	const plant *robot = config.dictionary->n_states == plant_ddr.n ? &plant_ddr : &plant_fwmav;
	const uint64_t seed = strtoull(arguments[5], NULL, 10);
	config.n_inputs = robot->m;
	config.lambda = (real)robot->lambda;
	const KOOP(dead_zone) zone = {calibrated(&config, robot, random_seed(seed + 1))};
	const KOOP(setting) *first = config.regulator->settings;
	if (first && strcmp(first->name, "delta") == 0) { config.settings = &zone; }
	run(&c, &config, robot, strtoul(arguments[4], NULL, 10), seed);
	return 0;
}
