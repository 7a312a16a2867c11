/* Your own dictionary, for a quadrotor: 12 states and 7 functions of them.
 *
 * A quadrotor's acceleration is nearly linear in thrust and torques once the direction of the thrust is known, so that
 * direction is among the functions; so are the products of rates in Euler's equations. Their inputs are thrust and torques. */
#include <math.h>
#include <stdio.h>

#include "tinykoop.h"

enum { POSITION, ANGLE = 3, VELOCITY = 6, RATE = 9, STATES = 12, LIFTED = 19, INPUTS = 4 };

typedef struct settings {
	float rate; /* rad/s: products are taken of rates in this unit, which keeps them near 1 */
} settings;

static void lift(const koopf_dictionary *self, const float *x, float *psi) {
	const settings *s = self->context;
	const float roll = x[ANGLE], pitch = x[ANGLE + 1], yaw = x[ANGLE + 2];
	const float p = x[RATE] / s->rate, q = x[RATE + 1] / s->rate, r = x[RATE + 2] / s->rate;
	for (int i = 0; i < STATES; i++) { psi[i] = x[i]; }
	psi[12] = cosf(yaw) * sinf(pitch) * cosf(roll) + sinf(yaw) * sinf(roll); /* direction of the thrust */
	psi[13] = sinf(yaw) * sinf(pitch) * cosf(roll) - cosf(yaw) * sinf(roll);
	psi[14] = cosf(pitch) * cosf(roll);
	psi[15] = q * r; /* Euler's equations */
	psi[16] = r * p;
	psi[17] = p * q;
	psi[18] = 1; /* gravity */
}

static const settings unit = {.rate = 3.0f};
static const koopf_dictionary quadrotor = {
	.name = "quadrotor", .n_states = STATES, .n_lifted = LIFTED, .lift = lift, .context = &unit,
};

/* One step of 10 ms of the true vehicle: 0.5 kg, inertia of a racing frame. It takes your vehicle's place. */
static void fly(float *x, const float *u) {
	static const float inertia[3] = {3e-3f, 3e-3f, 5e-3f}, dt = 0.01f, mass = 0.5f, drag = 0.2f;
	float psi[LIFTED];
	lift(&quadrotor, x, psi);
	for (int i = 0; i < 3; i++) {
		const float gravity = i == 2 ? 9.81f : 0;
		x[POSITION + i] += dt * x[VELOCITY + i];
		x[VELOCITY + i] += dt * (psi[12 + i] * u[0] / mass - gravity - drag * x[VELOCITY + i]);
		x[ANGLE + i] += dt * x[RATE + i];
	}
	const float p = x[RATE], q = x[RATE + 1], r = x[RATE + 2];
	x[RATE] += dt * (u[1] + (inertia[1] - inertia[2]) * q * r) / inertia[0];
	x[RATE + 1] += dt * (u[2] + (inertia[2] - inertia[0]) * r * p) / inertia[1];
	x[RATE + 2] += dt * (u[3] + (inertia[0] - inertia[1]) * p * q) / inertia[2];
}

/* A controller that keeps the vehicle level, with swings that excite all axes. */
static void hold(const float *x, int k, float *u) {
	const float t = 0.01f * (float)k;
	u[0] = 4.905f + 0.5f * sinf(2.1f * t) - 0.6f * x[VELOCITY + 2] - 0.5f * x[2];
	for (int i = 0; i < 3; i++) {
		const float wish = 0.2f * sinf((1.3f + 0.9f * (float)i) * t + (float)i);
		u[1 + i] = 0.06f * (wish - x[ANGLE + i]) - 0.018f * x[RATE + i];
	}
}

int main(void) {
	static float storage[KOOP_RLS_REALS_SQRT(LIFTED, INPUTS)];
	static koopf_rls learner;
	static const koopf_dead_zone zone = {.delta = 1e-4f};
	const koopf_config config = {
		.dictionary = &quadrotor, .n_inputs = INPUTS, .regulator = &koopf_reg_dz_cs, .form = &koopf_form_sqrt,
		.lambda = 0.995f, .p0 = 100.0f, .settings = &zone,
	};
	float x[STATES] = {0}, u[INPUTS], psi[LIFTED], psi_next[LIFTED], late = 0;
	koopf_health health = {0};
	int status = koopf_rls_init(&learner, &config, storage, sizeof storage / sizeof *storage);
	if (status == KOOP_OK) { status = koopf_lift(&quadrotor, x, psi); }
	for (int k = 0; k < 3000 && status == KOOP_OK; k++) { /* 30 s */
		hold(x, k, u);
		fly(x, u);
		status = koopf_lift(&quadrotor, x, psi_next);
		if (status == KOOP_OK) { status = koopf_rls_update(&learner, psi, u, psi_next, &health); }
		for (int i = 0; i < LIFTED; i++) { psi[i] = psi_next[i]; }
		if (k >= 2900) { late = fmaxf(late, health.innovation); }
	}
	printf("status %d, largest one-step error of the last second %g\n", status, (double)late);
	return status != KOOP_OK || !(late < 1e-2f);
}
