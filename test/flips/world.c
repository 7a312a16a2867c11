#include "world.h"

#include <stdio.h>
#include <stdlib.h>

const char *const use_names[USES] = {"alone", "checksum", "gate", "gate_checksum", "newton", "gradient"};

void fatal(const char *what) {
	fprintf(stderr, "flips: %s\n", what);
	exit(2);
}

static void must(int status) {
	if (status != KOOP_OK) { fatal(KOOP(status_message)(status)); }
}

/* ---- The robot under control: two carts, each with a place and a speed --------------------- */

static const double NOISE = 1e-3, DITHER = 0.2; /* half the widths of uniform distributions */
static const double DT = 0.1, DRAG = 0.9, PUSH = 0.2;

static void move_carts(const double *x, const double *u, double *next) {
	for (size_t i = 0; i < 2; i++) {
		next[2 * i] = x[2 * i] + DT * x[2 * i + 1];
		next[2 * i + 1] = DRAG * x[2 * i + 1] + PUSH * u[i];
	}
}

static void carts_reference(size_t time, real *x) {
	const double rates[] = {0.07, 0.11};
	for (size_t i = 0; i < 2; i++) {
		x[2 * i] = (real)sin(rates[i] * (double)time);
		x[2 * i + 1] = (real)(rates[i] / DT * cos(rates[i] * (double)time));
	}
}

static void lift_itself(const KOOP(dictionary) *self, const real *x, real *psi) {
	for (size_t i = 0; i < self->n_states; i++) { psi[i] = x[i]; }
}

static const real Q[TRACKED * TRACKED] = {10, 0, 0, 0, 0, 1, 0, 0, 0, 0, 10, 0, 0, 0, 0, 1};
static const real R[] = {(real)0.1, 0, 0, (real)0.1}, S[] = {(real)0.1, 0, 0, (real)0.1};
static const real low[] = {-1, -1}, high[] = {1, 1}, safe[] = {0, 0};

/* A model that a log might have given: off by a tenth. */
static void carts_offline(const world *w, real *theta) {
	const size_t d = TRACKED + INPUTS;
	for (size_t j = 0; j < d; j++) {
		double x[TRACKED] = {0}, u[INPUTS] = {0}, next[TRACKED];
		*(j < TRACKED ? &x[j] : &u[j - TRACKED]) = 1;
		move_carts(x, u, next);
		for (size_t i = 0; i < TRACKED; i++) {
			theta[j * w->rls.n_lifted_padded + i] = (real)(next[i] * (i == j ? 1 : 0.9));
		}
	}
}

/* ---- Samples ---------------------------------------------------------------------------- */

typedef struct {
	real psi[LIFTED], u[INPUTS], next[LIFTED];
} lifted;

static void lift(const world *w, const double *x, real *psi) {
	real state[MOST_STATES];
	for (size_t i = 0; i < w->dictionary.n_states; i++) { state[i] = (real)x[i]; }
	must(KOOP(lift)(&w->dictionary, state, psi));
}

static double noise(random_source *random, double size) {
	return (double)random_uniform(random, -size, size);
}

/* From anywhere, with any input. */
static void draw(const world *w, random_source *random, lifted *seen) {
	sample s;
	if (w->closed) {
		for (size_t i = 0; i < TRACKED; i++) { s.x[i] = noise(random, 1); }
		for (size_t i = 0; i < INPUTS; i++) { s.u[i] = noise(random, 1); }
		move_carts(s.x, s.u, s.next);
		for (size_t i = 0; i < TRACKED; i++) { s.next[i] += noise(random, NOISE); }
	} else {
		plant_draw(&plant_ddr, random, 1, &s);
	}
	lift(w, s.x, seen->psi);
	lift(w, s.next, seen->next);
	for (size_t i = 0; i < INPUTS; i++) { seen->u[i] = (real)s.u[i]; }
}

double world_error(world *w) {
	random_source random = random_seed(1000 + (uint64_t)w->closed);
	double sum = 0;
	for (size_t k = 0; k < HELD_OUT; k++) {
		lifted seen;
		real predicted[LIFTED];
		draw(w, &random, &seen);
		if (KOOP(rls_predict)(&w->rls, seen.psi, seen.u, predicted)) { return (double)INFINITY; }
		for (size_t i = 0; i < w->rls.n_lifted; i++) {
			const double error = (double)seen.next[i] - (double)predicted[i];
			sum += error * error;
		}
	}
	return sum / HELD_OUT;
}

/* ---- One step ----------------------------------------------------------------------------- */

static int is_gated(const world *w) {
	return w->use != ALONE && w->use != CHECKSUM;
}

static void learn(world *w, const lifted *s, report *r) {
	KOOP(health) health = {0, 0, 0, 0, 1, 1, 0, 0};
	r->learned = w->closed ? KOOP(supervisor_update)(&w->supervisor, &w->rls, s->psi, s->u, s->next, &health)
	             : is_gated(w) ? KOOP(gate_update)(&w->gate, &w->rls, s->psi, s->u, s->next, &health)
	                           : KOOP(rls_update)(&w->rls, s->psi, s->u, s->next, &health);
	r->unhealthy = !health.finite || !health.positive_definite || health.winding_up;
	r->innovation = (double)health.innovation;
	r->repaired = w->rls.repaired;
	if (is_gated(w)) { r->trust = KOOP(gate_trust)(&w->gate); }
}

/* Weighed error of the robot's place, and the robot one step on. */
static void control(world *w, lifted *s, report *r) {
	real reference[HORIZON * TRACKED], before[INPUTS];
	double next[TRACKED];
	for (size_t k = 0; k < HORIZON; k++) { carts_reference(w->time + 1 + k, reference + k * TRACKED); }
	for (size_t i = 0; i < INPUTS; i++) { before[i] = (real)w->u[i]; }
	lift(w, w->x, s->psi);
	r->controlled =
	    KOOP(supervisor_control)(&w->supervisor, &w->rls, &w->mpc, s->psi, reference, before, s->u, NULL);
	r->model = w->supervisor.model;
	r->resets = w->supervisor.resets;
	for (size_t i = 0; i < INPUTS; i++) {
		/* written so that NaN fails */
		r->unsafe |= !(s->u[i] >= low[i] && s->u[i] <= high[i]);
		w->u[i] = fmax(-1, fmin(1, (double)s->u[i] + noise(&w->random, DITHER)));
		s->u[i] = (real)w->u[i];
	}
	move_carts(w->x, w->u, next);
	for (size_t i = 0; i < TRACKED; i++) {
		w->x[i] = next[i] + noise(&w->random, NOISE);
		const double error = w->x[i] - (double)reference[i];
		r->cost += (double)Q[i * (TRACKED + 1)] * error * error;
	}
	lift(w, w->x, s->next);
}

report world_step(world *w) {
	report r = {0};
	lifted s;
	if (w->closed) {
		control(w, &s, &r);
	} else {
		draw(w, &w->random, &s);
	}
	learn(w, &s, &r);
	w->time++;
	return r;
}

/* ---- Start -------------------------------------------------------------------------------- */

#define REALS(array) (array), sizeof(array) / sizeof *(array)

static void start_control(world *w) {
	const KOOP(mpc_config) config = {
	    .n_lifted = TRACKED,
	    .n_states = TRACKED,
	    .n_inputs = INPUTS,
	    .horizon = HORIZON,
	    .Q = Q,
	    .R = R,
	    .S = S,
	    .u_min = low,
	    .u_max = high,
	    .u_safe = safe,
	    .method = w->use == NEWTON ? KOOP_MPC_NEWTON : KOOP_MPC_GRADIENT,
	};
	const KOOP(supervisor_config) supervisor = {.gate = &w->gate};
	real offline[(TRACKED + INPUTS) * KOOP_PAD(TRACKED)] = {0};
	carts_offline(w, offline);
	must(KOOP(rls_copy_theta)(&w->rls, offline));
	must(KOOP(mpc_init)(&w->mpc, &config, REALS(w->mpc_storage)));
	must(KOOP(supervisor_init)(&w->supervisor, &supervisor, &w->mpc, offline, REALS(w->supervisor_storage)));
}

void world_start(world *w, protection use, const KOOP(config) *config, uint64_t seed) {
	KOOP(config) own = *config;
	memset(w, 0, sizeof *w);
	w->use = use;
	w->closed = use >= NEWTON;
	w->random = random_seed(seed);
	w->dictionary = KOOP(poly_ddr);
	if (w->closed) { w->dictionary = (KOOP(dictionary)){"itself", TRACKED, TRACKED, lift_itself, NULL}; }
	own.dictionary = &w->dictionary;
	own.n_inputs = INPUTS;
	own.checksum = use != ALONE && use != GATE;
	must(KOOP(rls_init)(&w->rls, &own, REALS(w->storage)));
	if (w->closed) { start_control(w); }
	must(KOOP(gate_init)(&w->gate, NULL, &w->rls, REALS(w->gate_storage)));
}
