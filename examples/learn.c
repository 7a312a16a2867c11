/* Learns how a robot moves while it moves. The README shows this program. */
#include <math.h>
#include <stdio.h>

#include "tinykoop.h"

static float storage[KOOP_RLS_REALS_SQRT(22, 2)]; /* 4.2 kB for 22 lifted states and 2 inputs */

int main(void) {
	static const koopf_dead_zone zone = {.delta = 0.01f}; /* smaller innovations leave the covariance unchanged */
	const koopf_config config = {
		.dictionary = &koopf_rbf_ddr, /* 22 functions of the state; examples/own_dictionary.c has its own */
		.n_inputs = 2,
		.regulator = &koopf_reg_dz_cs, .settings = &zone, /* keeps the covariance of the least squares bounded */
		.form = &koopf_form_sqrt, /* the covariance as its square root: safe in float32 */
		.lambda = 0.98f, /* forgetting factor */
		.p0 = 100.0f,    /* initial covariance */
	};
	koopf_rls learner;
	koopf_health health = {0};
	float psi[22], psi_next[22], x[3] = {0}; /* x, y (m), heading (rad) */
	if (koopf_rls_init(&learner, &config, storage, sizeof storage / sizeof *storage) != KOOP_OK) { return 1; }
	if (koopf_lift(&koopf_rbf_ddr, x, psi) != KOOP_OK) { return 1; }
	for (int k = 0; k < 400; k++) {
		const float u[2] = {1.5f + 0.3f * sinf(0.1f * (float)k), 0.6f * cosf(0.08f * (float)k)}; /* m/s, rad/s */
		x[0] += 0.05f * u[0] * cosf(x[2]); /* simulated; read your sensors here, 20 times per second */
		x[1] += 0.05f * u[0] * sinf(x[2]);
		x[2] += 0.05f * u[1];
		if (koopf_lift(&koopf_rbf_ddr, x, psi_next) != KOOP_OK) { continue; }
		if (koopf_rls_update(&learner, psi, u, psi_next, &health) != KOOP_OK) { continue; } /* refused: the model is unchanged */
		for (int i = 0; i < 22; i++) { psi[i] = psi_next[i]; }
	}
	printf("one-step prediction error: %g\n", (double)health.innovation);
	return 0;
}
