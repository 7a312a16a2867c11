/* A differential-drive robot that learns its model on line and follows a path with
 * it: what closed_loop.c and footprint.c run, the same on every target and on the
 * host. The plant is in double, so that it is the same robot everywhere; what is
 * compared and measured is koopf_. */
#ifndef ROBOT_H
#define ROBOT_H

#include "tinykoop.h"

#define N_MAX 22 /* lifted states */
#define STATES 3  /* x = [px (m), py (m), theta (rad)] */
#define INPUTS 2  /* u = [v (m/s), omega (rad/s)] */
#define HORIZON 50
#define LEARN 500 /* steps under open-loop commands, then */
#define CONTROL 500

/* A learner and a controller, with the settings of the host's tools. */
typedef struct agent {
	koopf_config config;
	koopf_rls rls;
	koopf_mpc mpc;
	float rls_storage[KOOP_RLS_REALS_PLAIN(N_MAX, INPUTS) + KOOP_EXTENSION_REALS_PLAIN(N_MAX, INPUTS)];
	float mpc_storage[KOOP_MPC_REALS_NEWTON(N_MAX, STATES, INPUTS, HORIZON)];
} agent;

/* Status of the library. `tolerance` 0: the controller's own. */
int agent_start(agent *a, const koopf_dictionary *dictionary, const koopf_regulator *regulator,
                const koopf_form *form, int check, float tolerance);

/* Moves the true pose by one period under u. From step LEARN + CONTROL / 2 on the
 * wheels slip. */
void robot_step(double pose[STATES], const float u[INPUTS], size_t k);
void robot_measure(const double pose[STATES], float x[STATES]);
/* Open-loop commands at step k. */
void robot_command(size_t k, float u[INPUTS]);

/* The robot at step LEARN, half a metre off the path, and the path from there: where
 * sharper commands would take it without slip. Row k of `path` belongs to step
 * LEARN + k + 1. */
#define PATH (CONTROL + HORIZON)
void robot_path(double pose[STATES], float path[PATH * STATES]);

#endif
