/* A stranger's program, as C99 or as C++11: it learns a differential-drive robot that
 * it drives about, then plans on what it has learned. Prints what came of it. */
#include "tinykoop.h"

#include <math.h>
#include <stdio.h>

#define N 22
#define STATES 3
#define INPUTS 2
#define HORIZON 20

static float rls_storage[KOOP_RLS_REALS_SQRT(N, INPUTS)];
static float mpc_storage[KOOP_MPC_REALS_NEWTON(N, STATES, INPUTS, HORIZON)];
static koopf_config learning;
static koopf_mpc_config control;
static koopf_rls rls;
static koopf_mpc mpc;

static int start(void) {
	static const float Q[STATES * STATES] = {20, 0, 0, 0, 20, 0, 0, 0, 3};
	static const float R[INPUTS * INPUTS] = {0.05f, 0, 0, 0.08f};
	static const float low[INPUTS] = {0, -1.2f}, high[INPUTS] = {3.5f, 1.2f}, stop[INPUTS] = {0, 0};
	static const koopf_dead_zone zone = {0.01f};
	learning.dictionary = &koopf_rbf_ddr;
	learning.n_inputs = INPUTS;
	learning.regulator = &koopf_reg_dz_cs;
	learning.form = &koopf_form_sqrt;
	learning.lambda = 0.98f;
	learning.p0 = 100;
	learning.settings = &zone;
	control.n_lifted = N;
	control.n_states = STATES;
	control.n_inputs = INPUTS;
	control.horizon = HORIZON;
	control.Q = Q;
	control.R = R;
	control.u_min = low;
	control.u_max = high;
	control.u_safe = stop;
	const int status = koopf_rls_init(&rls, &learning, rls_storage, sizeof rls_storage / sizeof *rls_storage);
	return status != KOOP_OK
	           ? status
	           : koopf_mpc_init(&mpc, &control, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage);
}

/* The robot moves on by 50 ms, and is learned from. */
static int step(float x[STATES], float psi[N], const float u[INPUTS]) {
	float psi_next[N];
	x[0] += 0.05f * u[0] * cosf(x[2]);
	x[1] += 0.05f * u[0] * sinf(x[2]);
	x[2] += 0.05f * u[1];
	int status = koopf_lift(&koopf_rbf_ddr, x, psi_next);
	if (status == KOOP_OK) { status = koopf_rls_update(&rls, psi, u, psi_next, NULL); }
	for (int i = 0; i < N; i++) { psi[i] = psi_next[i]; }
	return status;
}

/* Where the robot is to be k steps after the beginning of its path: straight on, at 1.5 m/s. */
static void place(const float from[STATES], int k, float to[STATES]) {
	to[0] = from[0] + 0.05f * 1.5f * (float)k * cosf(from[2]);
	to[1] = from[1] + 0.05f * 1.5f * (float)k * sinf(from[2]);
	to[2] = from[2];
}

int main(void) {
	float x[STATES] = {0, 0, 0}, u[INPUTS], psi[N], path[HORIZON * STATES], begin[STATES], end[STATES];
	int status = start();
	if (status == KOOP_OK) { status = koopf_lift(&koopf_rbf_ddr, x, psi); }
	for (int k = 0; k < 400 && status == KOOP_OK; k++) {
		u[0] = 1.5f + 0.8f * sinf(0.1f * (float)k);
		u[1] = 0.9f * cosf(0.23f * (float)k);
		status = step(x, psi, u);
	}
	for (int i = 0; i < STATES; i++) { begin[i] = x[i]; }
	for (int k = 0; k < 40 && status == KOOP_OK; k++) {
		for (int i = 0; i < HORIZON; i++) { place(begin, k + 1 + i, path + STATES * i); }
		status = koopf_mpc_solve(&mpc, rls.theta, psi, path, NULL, u, NULL);
		if (status == KOOP_OK) { status = step(x, psi, u); }
	}
	if (status != KOOP_OK) {
		fprintf(stderr, "%s\n", koopf_status_message(status));
		return 1;
	}
	place(begin, 40, end);
	printf("speed %.9g off %.9g m\n", (double)u[0],
	       (double)sqrtf((x[0] - end[0]) * (x[0] - end[0]) + (x[1] - end[1]) * (x[1] - end[1])));
	return 0;
}
