#include "robot.h"

#include <stdlib.h>

#define PERIOD 0.05 /* s */
#define TURN 1.4f   /* the path turns more than the commands: with slip, about what the box allows */

int agent_start(agent *a, const koopf_dictionary *dictionary, const koopf_regulator *regulator,
                const koopf_form *form, int check, float tolerance) {
	static const float Q[STATES * STATES] = {20, 0, 0, 0, 20, 0, 0, 0, 3};
	static const float R[INPUTS * INPUTS] = {0.05f, 0, 0, 0.08f};
	static const float u_min[INPUTS] = {0, -1.2f}, u_max[INPUTS] = {3.5f, 1.2f}, u_safe[INPUTS] = {0, 0};
	const koopf_config config = { /* the regulator has its default settings */
	    .dictionary = dictionary,
	    .n_inputs = INPUTS,
	    .regulator = regulator,
	    .form = form,
	    .lambda = 0.98f,
	    .p0 = 100,
	    .check = check,
	};
	const koopf_mpc_config control = {
	    .n_lifted = dictionary->n_lifted,
	    .n_states = STATES,
	    .n_inputs = INPUTS,
	    .horizon = HORIZON,
	    .Q = Q,
	    .R = R,
	    .u_min = u_min,
	    .u_max = u_max,
	    .u_safe = u_safe,
	    .tolerance = tolerance,
	    .method = KOOP_MPC_NEWTON,
	};
	a->config = config;
	const int status =
	    koopf_rls_init(&a->rls, &config, a->rls_storage, sizeof a->rls_storage / sizeof *a->rls_storage);
	if (status != KOOP_OK) { return status; }
	return koopf_mpc_init(&a->mpc, &control, a->mpc_storage, sizeof a->mpc_storage / sizeof *a->mpc_storage);
}

/* With the library's own functions: libm's differ from one target to the next. */
static void sine_cosine(double angle, double *sine, double *cosine) {
	const double x[STATES] = {0, 0, angle};
	double psi[7];
	if (koopd_lift(&koopd_poly_ddr, x, psi) != KOOP_OK) { abort(); }
	*sine = psi[5];
	*cosine = psi[6];
}

static void move(double pose[STATES], double v, double omega) {
	double sine, cosine;
	sine_cosine(pose[2], &sine, &cosine);
	pose[0] += v * cosine * PERIOD;
	pose[1] += v * sine * PERIOD;
	pose[2] += omega * PERIOD;
}

void robot_step(double pose[STATES], const float u[INPUTS], size_t k) {
	const int slips = k >= LEARN + CONTROL / 2;
	move(pose, (slips ? 0.8 : 1.0) * (double)u[0], (slips ? 0.7 : 1.0) * (double)u[1]);
}

void robot_measure(const double pose[STATES], float x[STATES]) {
	for (size_t i = 0; i < STATES; i++) { x[i] = (float)pose[i]; }
}

void robot_command(size_t k, float u[INPUTS]) {
	double sine, cosine, unused;
	sine_cosine(0.1 * (double)k, &sine, &unused);
	sine_cosine(0.08 * (double)k, &unused, &cosine);
	u[0] = (float)(1.5 + 0.3 * sine);
	u[1] = (float)(0.6 * cosine);
}

void robot_path(double pose[STATES], float path[PATH * STATES]) {
	float u[INPUTS];
	double at[STATES] = {0, 0, 0};
	for (size_t k = 0; k < LEARN + PATH; k++) {
		robot_command(k, u);
		if (k == LEARN) {
			for (size_t i = 0; i < STATES; i++) { pose[i] = at[i]; }
			pose[1] += 0.5;
		}
		if (k >= LEARN) { u[1] *= TURN; }
		move(at, (double)u[0], (double)u[1]);
		if (k >= LEARN) { robot_measure(at, path + (k - LEARN) * STATES); }
	}
}
