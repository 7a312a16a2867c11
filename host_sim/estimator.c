/* lib/ in either precision behind one interface. */
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "ddr.h"
#include "message.h"
#include "tinykoop.h"
#include "tinykoop_supervisor.h"

/* Whether M (d x d), of which the lower triangle is read and overwritten, has a
 * Cholesky factor in double. Column by column: no product waits for the one before. */
static int cholesky_succeeds(double *M, size_t d) {
	for (size_t k = 0; k < d; k++) {
		if (!(M[k * d + k] > 0)) { return 0; }
		const double root = sqrt(M[k * d + k]);
		for (size_t i = k + 1; i < d; i++) {
			double *row = M + i * d;
			row[k] /= root;
			for (size_t j = k + 1; j <= i; j++) { row[j] -= row[k] * M[j * d + k]; }
		}
	}
	return 1;
}

/* Euclidean norm. Squares may leave the range of a double where the norm does not: then by hypot, which takes
 * ten times as long. */
static double norm_of(const double *values, size_t count) {
	double squares = 0, norm = 0;
	for (size_t i = 0; i < count; i++) { squares += values[i] * values[i]; }
	if (squares > 1e-280 && squares < 1e280) { return sqrt(squares); }
	for (size_t i = 0; i < count; i++) { norm = hypot(norm, values[i]); }
	return norm;
}

static double microseconds(void) {
	struct timespec now;
	clock_gettime(CLOCK_MONOTONIC, &now);
	return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

struct tk_dictionary {
	struct f32_own *f32_own;
	struct f64_own *f64_own;
};

#define REAL float
#define KOOP(name) koopf_##name
#define SIM(name) f32_##name
#include "dictionary_real.h"
#include "estimator_real.h"
#include "control_real.h"
#undef REAL
#undef KOOP
#undef SIM

#define REAL double
#define KOOP(name) koopd_##name
#define SIM(name) f64_##name
#include "dictionary_real.h"
#include "estimator_real.h"
#include "control_real.h"
#undef REAL
#undef KOOP
#undef SIM

const char *tk_regulator_name(size_t regulator) {
	const koopd_regulator *r = f64_regulator_at(regulator);
	return r ? r->name : NULL;
}

size_t tk_regulator_settings(size_t regulator) {
	const koopd_regulator *r = f64_regulator_at(regulator);
	return r ? r->n_settings : 0;
}

int tk_regulator_setting(size_t regulator, size_t setting, const char **name, double *low, double *high,
                         double *usual) {
	if (setting >= tk_regulator_settings(regulator)) {
		return fail("regulator %zu has no setting %zu", regulator, setting);
	}
	const koopd_regulator *r = f64_regulator_at(regulator);
	*name = r->settings[setting].name;
	*low = r->settings[setting].low;
	*high = r->settings[setting].high;
	*usual = ((const double *)r->defaults)[setting];
	return TK_OK;
}

/* ---- Dictionaries of your own -------------------------------------------------- */

void tk_dictionary_free(tk_dictionary *d) {
	if (!d) { return; }
	f32_own_free(d->f32_own);
	f64_own_free(d->f64_own);
	free(d);
}

/* Gives *dictionary a new one that was made with this status, or frees it. */
static int give_dictionary(tk_dictionary *d, int status, tk_dictionary **dictionary) {
	if (status == TK_OK) {
		*dictionary = d;
	} else {
		tk_dictionary_free(d);
	}
	return status;
}

static tk_dictionary *empty_dictionary(void) {
	tk_dictionary *d = calloc(1, sizeof *d);
	if (!d) { return NULL; }
	d->f32_own = calloc(1, sizeof *d->f32_own);
	d->f64_own = calloc(1, sizeof *d->f64_own);
	if (d->f32_own && d->f64_own) { return d; }
	tk_dictionary_free(d);
	return NULL;
}

int tk_dictionary_new(const char *name, size_t n_states, size_t n_parts, const tk_part *parts,
                      tk_dictionary **dictionary) {
	tk_dictionary *d = empty_dictionary();
	if (!d) { return fail("out of memory"); }
	int status = f32_own_of_parts(d->f32_own, name, n_states, n_parts, parts);
	if (status == TK_OK) { status = f64_own_of_parts(d->f64_own, name, n_states, n_parts, parts); }
	return give_dictionary(d, status, dictionary);
}

int tk_dictionary_outside(const char *name, size_t n_states, size_t n_lifted, tk_dictionary **dictionary) {
	tk_dictionary *d = empty_dictionary();
	if (!d) { return fail("out of memory"); }
	int status = f32_own_outside(d->f32_own, name, n_states, n_lifted);
	if (status == TK_OK) { status = f64_own_outside(d->f64_own, name, n_states, n_lifted); }
	return give_dictionary(d, status, dictionary);
}

int tk_dictionary_given(const void *f32, const void *f64, tk_dictionary **dictionary) {
	tk_dictionary *d = empty_dictionary();
	if (!d) { return fail("out of memory"); }
	int status = f32_own_given(d->f32_own, f32);
	if (status == TK_OK) { status = f64_own_given(d->f64_own, f64); }
	return give_dictionary(d, status, dictionary);
}

/* ---- Estimators ------------------------------------------------------------------ */

struct tk_estimator {
	f32_estimator *f32; /* one of the two is null */
	f64_estimator *f64;
};

int tk_estimator_new(const tk_settings *settings, tk_estimator **estimator) {
	if (!settings || !estimator || !(settings->own || settings->dictionary) || !settings->regulator || !settings->form) {
		return fail("dictionary, regulator and form must be given");
	}
	if (settings->precision != 32 && settings->precision != 64) {
		return fail("precision is %d, it must be 32 or 64", settings->precision);
	}
	if (settings->n_inputs < 1) { return fail("n_inputs is %d, it must be at least 1", settings->n_inputs); }
	tk_estimator *e = calloc(1, sizeof *e);
	if (!e) { return fail("out of memory"); }
	const int status = settings->precision == 32 ? f32_new(settings, &e->f32) : f64_new(settings, &e->f64);
	if (status != TK_OK) {
		free(e);
		return status;
	}
	*estimator = e;
	return TK_OK;
}

void tk_estimator_free(tk_estimator *e) {
	if (e && e->f32) { f32_free(e->f32); }
	if (e && e->f64) { f64_free(e->f64); }
	free(e);
}

int tk_estimator_sizes(const tk_estimator *e, size_t *n, size_t *N, size_t *m) {
	*n = e->f32 ? e->f32->rls.config.dictionary->n_states : e->f64->rls.config.dictionary->n_states;
	*N = e->f32 ? e->f32->rls.n_lifted : e->f64->rls.n_lifted;
	*m = e->f32 ? e->f32->rls.config.n_inputs : e->f64->rls.config.n_inputs;
	return TK_OK;
}

int tk_estimator_get_theta(const tk_estimator *e, double *theta) {
	return e->f32 ? f32_get_theta(e->f32, theta) : f64_get_theta(e->f64, theta);
}

int tk_estimator_set_theta(tk_estimator *e, const double *theta) {
	return e->f32 ? f32_set_theta(e->f32, theta) : f64_set_theta(e->f64, theta);
}

int tk_estimator_get_covariance(const tk_estimator *e, double *P) {
	if (e->f32) {
		f32_get_covariance(e->f32, P);
	} else {
		f64_get_covariance(e->f64, P);
	}
	return TK_OK;
}

int tk_estimator_reset_covariance(tk_estimator *e, double p0) {
	return e->f32 ? f32_reset_covariance(e->f32, p0) : f64_reset_covariance(e->f64, p0);
}

int tk_estimator_model(const tk_estimator *e, int covariance, void *bytes, size_t *size) {
	return e->f32 ? f32_model(e->f32, covariance, bytes, size) : f64_model(e->f64, covariance, bytes, size);
}

int tk_estimator_load(tk_estimator *e, const void *bytes, size_t size) {
	return e->f32 ? f32_load(e->f32, bytes, size) : f64_load(e->f64, bytes, size);
}

int tk_update(tk_estimator *e, int lifted, const double *now, const double *u, const double *next,
              tk_health *health) {
	return e->f32 ? f32_update(e->f32, lifted, now, u, next, health)
	              : f64_update(e->f64, lifted, now, u, next, health);
}

int tk_predict(tk_estimator *e, int lifted, size_t rows, const double *now, const double *u, double *psi_next) {
	return e->f32 ? f32_predict(e->f32, lifted, rows, now, u, psi_next)
	              : f64_predict(e->f64, lifted, rows, now, u, psi_next);
}

int tk_rollout(tk_estimator *e, int lifted, size_t steps, const double *start, const double *u, double *psi) {
	return e->f32 ? f32_rollout(e->f32, lifted, steps, start, u, psi)
	              : f64_rollout(e->f64, lifted, steps, start, u, psi);
}

int tk_lift(const tk_estimator *e, size_t rows, const double *x, double *psi) {
	return e->f32 ? f32_lift(e->f32, rows, x, psi) : f64_lift(e->f64, rows, x, psi);
}

int tk_replay(tk_estimator *e, size_t steps, const double *x, const double *psi, const double *u,
              const int32_t *usable, int learn, const tk_trace *trace) {
	return e->f32 ? f32_replay(e->f32, steps, x, psi, u, usable, learn, trace)
	              : f64_replay(e->f64, steps, x, psi, u, usable, learn, trace);
}

int tk_estimator_soak(tk_estimator *e, size_t steps, const double *zeta, const double *target, size_t repeats,
                      tk_soak *result) {
	return e->f32 ? f32_soak(e->f32, steps, zeta, target, repeats, result)
	              : f64_soak(e->f64, steps, zeta, target, repeats, result);
}

int tk_control(tk_estimator *e, const tk_mpc_settings *mpc, const tk_active *effects, size_t n_effects,
               double dt, size_t steps, const double *x0, const double *reference, int learn,
               const tk_supervisor_settings *supervisor, const tk_control_trace *trace) {
	ddr *robot = ddr_open(effects, n_effects, TK_EULER, dt, (double)steps * dt, x0);
	if (!robot) { return TK_ERROR; }
	const int status = e->f32 ? f32_control(e->f32, mpc, robot, steps, reference, learn, supervisor, trace)
	                          : f64_control(e->f64, mpc, robot, steps, reference, learn, supervisor, trace);
	ddr_free(robot);
	return status;
}

struct tk_controller {
	f32_controller f32; /* one of the two has storage */
	f64_controller f64;
};

int tk_controller_new(const tk_mpc_settings *settings, int precision, size_t N, tk_controller **controller) {
	if (precision != 32 && precision != 64) {
		return fail("precision is %d, it must be 32 or 64", precision);
	}
	tk_controller *c = calloc(1, sizeof *c);
	if (!c) { return fail("out of memory"); }
	const int status = precision == 32 ? f32_controller_open(&c->f32, settings, N)
	                                   : f64_controller_open(&c->f64, settings, N);
	if (status != TK_OK) {
		free(c);
		return status;
	}
	*controller = c;
	return TK_OK;
}

void tk_controller_free(tk_controller *c) {
	if (!c) { return; }
	f32_controller_close(&c->f32);
	f64_controller_close(&c->f64);
	free(c);
}

int tk_controller_reset(tk_controller *c) {
	return c->f32.storage ? koopf_mpc_reset(&c->f32.mpc) : koopd_mpc_reset(&c->f64.mpc);
}

int tk_controller_limits(tk_controller *c, const double *u_min, const double *u_max) {
	if (c->f32.storage) {
		f32_controller_limits(&c->f32, u_min, u_max);
	} else {
		f64_controller_limits(&c->f64, u_min, u_max);
	}
	return TK_OK;
}

int tk_controller_solve(tk_controller *c, const double *theta, const double *psi, const double *reference,
                        const double *u_before, double *u, double *plan, tk_solution *solution) {
	return c->f32.storage ? f32_controller_solve(&c->f32, NULL, NULL, theta, psi, reference, u_before, u, plan, solution)
	                      : f64_controller_solve(&c->f64, NULL, NULL, theta, psi, reference, u_before, u, plan, solution);
}

struct tk_guard {
	f32_supervised f32; /* one of the two has storage */
	f64_supervised f64;
};

int tk_guard_new(const tk_supervisor_settings *settings, tk_estimator *e, tk_controller *c, tk_guard **guard) {
	if ((c->f32.storage != NULL) != (e->f32 != NULL)) { return fail("guard: the learner has another precision"); }
	tk_guard *g = calloc(1, sizeof *g);
	if (!g) { return fail("out of memory"); }
	const int status =
	    e->f32 ? f32_supervisor_open(&g->f32, &c->f32, settings, e->f32->gated ? &e->f32->gate : NULL)
	           : f64_supervisor_open(&g->f64, &c->f64, settings, e->f64->gated ? &e->f64->gate : NULL);
	if (status != TK_OK) {
		free(g);
		return status;
	}
	*guard = g;
	return TK_OK;
}

void tk_guard_free(tk_guard *g) {
	if (!g) { return; }
	free(g->f32.storage);
	free(g->f64.storage);
	free(g);
}

int tk_guard_model(const tk_guard *g, int *model, size_t *resets) {
	*model = g->f32.storage ? g->f32.supervisor.model : g->f64.supervisor.model;
	*resets = g->f32.storage ? g->f32.supervisor.resets : g->f64.supervisor.resets;
	return TK_OK;
}

int tk_guard_update(tk_guard *g, tk_estimator *e, int lifted, const double *now, const double *u, const double *next,
                    tk_health *health) {
	return e->f32 ? f32_supervised_update(&g->f32, e->f32, lifted, now, u, next, health)
	              : f64_supervised_update(&g->f64, e->f64, lifted, now, u, next, health);
}

int tk_guard_solve(tk_guard *g, tk_estimator *e, tk_controller *c, const double *psi, const double *reference,
                   const double *u_before, double *u, double *plan, tk_solution *solution) {
	return e->f32 ? f32_controller_solve(&c->f32, &g->f32, e->f32, NULL, psi, reference, u_before, u, plan, solution)
	              : f64_controller_solve(&c->f64, &g->f64, e->f64, NULL, psi, reference, u_before, u, plan, solution);
}

int tk_lowpass(int precision, double cutoff, double rate, size_t rows, size_t n, const double *x,
               const int32_t *usable, double *y) {
	return precision == 32 ? f32_lowpass(cutoff, rate, rows, n, x, usable, y)
	                       : f64_lowpass(cutoff, rate, rows, n, x, usable, y);
}

int tk_threshold(double *scores, size_t count, double eta, double *delta) {
	const int status = koopd_threshold(scores, count, eta, delta);
	return status == KOOP_OK ? TK_OK : fail("threshold: %s", koopd_status_message(status));
}

const char *tk_status_message(int status) {
	return koopd_status_message(status);
}
