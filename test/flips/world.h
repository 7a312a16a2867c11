/* A learner with what protects it, on a robot of its own; in one piece, so that a copy of the bytes brings
 * all of it back. */
#ifndef WORLD_H
#define WORLD_H

#include "tinykoop_supervisor.h" /* first: it leaves KOOP undefined */

#include "plant.h"

enum {
	LIFTED = 7, /* of poly_ddr; the robot under control has fewer */
	INPUTS = 2,
	TRACKED = 4, /* states of the robot under control */
	HORIZON = 8,
	HELD_OUT = 100, /* samples that a model is judged by */
};

/* How the learner is used. */
typedef enum { ALONE, CHECKSUM, GATE, GATE_CHECKSUM, NEWTON, GRADIENT, USES } protection;
extern const char *const use_names[USES];

typedef struct {
	protection use;
	int closed; /* 1: supervisor and controller, in a closed loop */
	random_source random;
	size_t time;
	double x[MOST_STATES], u[INPUTS]; /* of the robot under control */
	KOOP(dictionary) dictionary;
	KOOP(rls) rls;
	KOOP(gate) gate;
	KOOP(supervisor) supervisor;
	KOOP(mpc) mpc;
	real storage[KOOP_RLS_REALS_PLAIN(LIFTED, INPUTS) + KOOP_EXTENSION_REALS_PLAIN(LIFTED, INPUTS)];
	real gate_storage[KOOP_GATE_REALS_PLAIN(LIFTED, INPUTS) + KOOP_EXTENSION_REALS_PLAIN(LIFTED, INPUTS)];
	real supervisor_storage[KOOP_SUPERVISOR_REALS(TRACKED, TRACKED, INPUTS, HORIZON)];
	real mpc_storage[KOOP_MPC_REALS_NEWTON(TRACKED, TRACKED, INPUTS, HORIZON) +
	                 KOOP_MPC_REALS_RATE(INPUTS, HORIZON)];
} world;

/* What one sample showed. */
typedef struct {
	int learned, controlled; /* statuses */
	int trust, model;        /* gate_trust() and supervisor.model; 0 without */
	int unhealthy;           /* not finite, not positive definite, or winding up */
	size_t repaired, resets;
	double innovation, cost;
	int unsafe; /* the input is not finite, or outside its limits */
} report;

/* Refuses with a line on standard error where `config` is none; the dictionary is the world's own. */
void world_start(world *w, protection use, const KOOP(config) *config, uint64_t seed);
report world_step(world *w);
/* Mean square of the error by which the learner predicts samples that it has not seen; infinite if one
 * prediction is none. */
double world_error(world *w);

void fatal(const char *what);

#endif
