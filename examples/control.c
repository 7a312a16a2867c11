/* Learns a differential-drive robot in one drive, then follows a path with the learned model: each second the robot turns
 * a little less than commanded, which the controller does not know. */
#include <math.h>
#include <stdio.h>

#include "tinykoop.h"

enum { LIFTED = 22, STATES = 3, INPUTS = 2, HORIZON = 20, LEARN = 600, FOLLOW = 400 };

static float storage[KOOP_RLS_REALS_SQRT(LIFTED, INPUTS)];
static float mpc_storage[KOOP_MPC_REALS_NEWTON(LIFTED, STATES, INPUTS, HORIZON)];
static koopf_rls learner;
static koopf_mpc mpc;

static int start(void) {
	static const float Q[9] = {20, 0, 0, 0, 20, 0, 0, 0, 3}, R[4] = {0.05f, 0, 0, 0.08f};
	static const float low[2] = {0, -1.2f}, high[2] = {2.0f, 1.2f}, stop[2] = {0, 0};
	static const koopf_dead_zone zone = {.delta = 0.003f};
	const koopf_config config = {
		.dictionary = &koopf_rbf_ddr, .n_inputs = INPUTS, .regulator = &koopf_reg_dz_cs, .form = &koopf_form_sqrt,
		.lambda = 0.98f, .p0 = 100.0f, .settings = &zone,
	};
	const koopf_mpc_config plan = {
		.n_lifted = LIFTED, .n_states = STATES, .n_inputs = INPUTS, .horizon = HORIZON,
		.Q = Q, .R = R, .u_min = low, .u_max = high, .u_safe = stop,
	};
	const int status = koopf_rls_init(&learner, &config, storage, sizeof storage / sizeof *storage);
	return status != KOOP_OK ? status : koopf_mpc_init(&mpc, &plan, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage);
}

/* 50 ms of the true robot, simulated. Read your own here. */
static void drive(float *x, const float *u, int k) {
	const float turns = 1.0f - 2e-4f * (float)k;
	x[0] += 0.05f * u[0] * cosf(x[2]);
	x[1] += 0.05f * u[0] * sinf(x[2]);
	x[2] += 0.05f * turns * u[1];
}

/* The path: along x with a swing of 0.3 m. */
static void path_at(float s, float *pose) {
	pose[0] = s;
	pose[1] = 0.3f * sinf(0.8f * s);
	pose[2] = atanf(0.24f * cosf(0.8f * s));
}

int main(void) {
	float x[STATES] = {0}, u[INPUTS], psi[LIFTED], psi_next[LIFTED], path[HORIZON * STATES], worst = 0;
	int status = start();
	if (status == KOOP_OK) { status = koopf_lift(&koopf_rbf_ddr, x, psi); }
	for (int k = 0; k < LEARN + FOLLOW && status == KOOP_OK; k++) {
		const float s = 0.05f * (float)(k - LEARN);
		if (k == LEARN) { x[0] = x[1] = x[2] = 0; }
		if (k < LEARN) {
			u[0] = 1.0f + 0.5f * sinf(0.11f * (float)k);
			u[1] = 0.9f * cosf(0.07f * (float)k);
		} else {
			for (int i = 0; i < HORIZON; i++) { path_at(s + 0.05f * (float)(i + 1), path + i * STATES); }
			status = koopf_lift(&koopf_rbf_ddr, x, psi);
			if (status == KOOP_OK) { status = koopf_mpc_solve(&mpc, learner.theta, psi, path, NULL, u, NULL); }
		}
		drive(x, u, k);
		if (k >= LEARN) { worst = fmaxf(worst, fabsf(x[1] - 0.3f * sinf(0.8f * x[0]))); }
		if (status == KOOP_OK) { status = koopf_lift(&koopf_rbf_ddr, x, psi_next); }
		if (status == KOOP_OK) { status = koopf_rls_update(&learner, psi, u, psi_next, NULL); }
		for (int i = 0; i < LIFTED; i++) { psi[i] = psi_next[i]; }
	}
	printf("status %d, at most %g m beside the path\n", status, (double)worst);
	return status != KOOP_OK || !(worst < 0.1f);
}
