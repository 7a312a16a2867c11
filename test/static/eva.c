/* What Frama-C's Eva proves free of undefined behaviour: every public call in float32, at the small sizes
 * given by macros, on storage of exactly the size asked for. Settings and data are any float there is, NaN
 * and infinity too; what a call refuses comes as its status and the calls go on. */
#include "tinykoop.h"
#include "tinykoop_supervisor.h"

#include <math.h>

#define STATES 1
#ifndef CHECK
#define CHECK any_int
#endif

extern volatile float any_float;
extern volatile int any_int;

/* libm's contracts in Frama-C forbid NaN, which lib/ lets through on purpose. */
float fabsf(float x) {
	return x < 0 ? -x : x;
}
float sqrtf(float x) {
	return x < 0 ? any_float : x;
}
float sinf(float x) {
	return x - x + any_float;
}
float cosf(float x) {
	return x - x + any_float;
}
float expf(float x) {
	return x - x + any_float;
}
float atan2f(float y, float x) {
	return y - x + any_float;
}

static void fill(float *x, size_t count) {
	for (size_t i = 0; i < count; i++) { x[i] = any_float; }
}

static void lift_anything(const koopf_dictionary *self, const float *x, float *psi) {
	fill(psi, self->n_lifted);
	psi[0] = x[0];
}

static const koopf_dictionary dictionary = {"own", STATES, LIFTED, lift_anything, NULL};
static float theta[KOOP_EVEN(LIFTED + INPUTS) * KOOP_PAD(LIFTED)];
static float x[STATES], psi[LIFTED], u[INPUTS], u_before[INPUTS], psi_next[LIFTED];

static void new_sample(void) {
	fill(x, STATES);
	fill(psi, LIFTED);
	fill(u, INPUTS);
	fill(u_before, INPUTS);
	fill(psi_next, LIFTED);
}

#ifndef CONTROLLER
static koopf_rls rls;

static int start_learner(void) {
	static float storage[KOOP_RLS_REALS_PLAIN(LIFTED, INPUTS) + KOOP_EXTENSION_REALS_PLAIN(LIFTED, INPUTS)];
	static float settings[3]; /* of any regulator */
	settings[0] = any_float;
	settings[1] = any_float;
	settings[2] = any_float;
	const koopf_config c = {&dictionary, INPUTS, &REGULATOR, settings, &FORM, any_float, any_float, CHECK, 0};
	size_t reals = 0;
	if (koopf_rls_reals(&c, &reals) != KOOP_OK) { return 0; }
	if (reals > sizeof storage / sizeof *storage) { return 0; /*@ assert too_few: \false; */ }
	return koopf_rls_init(&rls, &c, storage, reals) == KOOP_OK;
}
#endif

#ifdef MESSAGES
static void run(void) {
	for (int status = KOOP_E_MODEL - 4; status <= 2; status++) { koopf_status_message(status); }
}
#elif defined(GATE)
static void run(void) {
	static float storage[KOOP_GATE_REALS_PLAIN(LIFTED, INPUTS)];
	const koopf_gate_config c = {any_float, any_float, (size_t)any_int, (size_t)any_int};
	koopf_gate gate;
	koopf_health health;
	size_t reals = 0;
	if (!start_learner()) { return; }
	koopf_rls_reals(&rls.config, &reals);
	reals += 2 * LIFTED;
	if (koopf_gate_init(&gate, any_int ? &c : NULL, &rls, storage, reals) != KOOP_OK) { return; }
	for (int k = 0; k < 2; k++) {
		new_sample();
		gate.n_variance = gate.judged = (size_t)any_int; /* as after more samples than can be gone through here */
		koopf_gate_update(&gate, &rls, psi, u, psi_next, any_int ? &health : NULL);
	}
}
#elif defined(LEARNER)
static void run(void) {
	static float flat[LIFTED * (LIFTED + INPUTS)], P[(LIFTED + INPUTS) * (LIFTED + INPUTS)],
	    channels[2 * LIFTED], scores[3], delta;
	static unsigned char model[KOOPF_MODEL_BYTES(LIFTED, INPUTS)];
	koopf_lowpass filter;
	koopf_health health;
	if (!start_learner()) { return; }
	for (int k = 0; k < 2; k++) {
		new_sample();
		koopf_lift(&dictionary, x, psi);
		koopf_rls_update(&rls, psi, u, psi_next, any_int ? &health : NULL);
		koopf_rls_predict(&rls, psi, u, psi_next);
	}
	koopf_rls_get_theta(&rls, flat);
	fill(flat, LIFTED * (LIFTED + INPUTS));
	koopf_rls_set_theta(&rls, flat);
	koopf_rls_copy_theta(&rls, theta);
	koopf_rls_get_covariance(&rls, P);
	koopf_rls_reset_covariance(&rls, any_float);
	koopf_model_save(&rls, model, sizeof model);
	for (size_t i = 0; i < sizeof model; i++) { model[i] = (unsigned char)any_int; }
	koopf_model_load(&rls, model, sizeof model);

	fill(scores, 3);
	koopf_threshold(scores, 3, any_float, &delta);
	if (koopf_lowpass_init(&filter, LIFTED, any_float, any_float, channels, 2 * LIFTED) == KOOP_OK) {
		fill(psi, LIFTED);
		koopf_lowpass_step(&filter, psi, psi);
		koopf_lowpass_step(&filter, psi, psi_next);
		koopf_lowpass_reset(&filter);
	}
}
#else
static float reference[HORIZON * STATES], plan[HORIZON * INPUTS], G[STATES * INPUTS];
static koopf_mpc mpc;
static koopf_mpc_result result;

static int start_controller(void) {
	static float Q[STATES * STATES], R[INPUTS * INPUTS], u_min[INPUTS], u_max[INPUTS], u_safe[INPUTS];
	static float storage[KOOP_MPC_REALS_NEWTON(LIFTED, STATES, INPUTS, HORIZON) +
	                     KOOP_MPC_REALS_RATE(INPUTS, HORIZON)];
	fill(Q, STATES * STATES);
	fill(R, INPUTS * INPUTS);
	fill(u_min, INPUTS);
	fill(u_max, INPUTS);
	fill(u_safe, INPUTS);
	const size_t reals =
	    (METHOD == KOOP_MPC_NEWTON ? KOOP_MPC_REALS_NEWTON(LIFTED, STATES, INPUTS, HORIZON)
	                               : KOOP_MPC_REALS_GRADIENT(LIFTED, STATES, INPUTS, HORIZON)) +
	    (RATE ? KOOP_MPC_REALS_RATE(INPUTS, HORIZON) : 0);
	const koopf_mpc_config c = {LIFTED,          STATES, INPUTS, HORIZON, Q,         R,
	                            RATE ? R : NULL, u_min,  u_max,  u_safe,  any_float, METHOD};
	return koopf_mpc_init(&mpc, &c, storage, reals) == KOOP_OK;
}

#ifdef CONTROLLER
static void run(void) {
	if (!start_controller()) { return; }
	for (int k = 0; k < 2; k++) {
		new_sample();
		fill(theta, sizeof theta / sizeof *theta);
		fill(reference, HORIZON * STATES);
		koopf_mpc_solve(&mpc, theta, psi, reference, u_before, u, any_int ? &result : NULL);
	}
	koopf_mpc_plan(&mpc, plan);
	koopf_mpc_sensitivity(&mpc, any_int ? 0 : HORIZON, G);
}
#else
static void run(void) {
	static float storage[KOOP_SUPERVISOR_REALS(LIFTED, STATES, INPUTS, HORIZON)];
	const koopf_supervisor_config c = {any_float, any_float, any_float, any_float,
	                                   any_float, any_float, 2,         3};
	koopf_supervisor supervisor;
	koopf_health health;
	if (!start_learner() || !start_controller()) { return; }
	fill(theta, sizeof theta / sizeof *theta);
	if (koopf_supervisor_init(&supervisor, any_int ? &c : NULL, &mpc, theta, storage,
	                          KOOP_SUPERVISOR_REALS(LIFTED, STATES, INPUTS, HORIZON)) != KOOP_OK) {
		return;
	}
	for (int k = 0; k < 2; k++) {
		new_sample();
		koopf_supervisor_update(&supervisor, &rls, psi, u, psi_next, any_int ? &health : NULL);
		fill(reference, HORIZON * STATES);
		koopf_supervisor_control(&supervisor, &rls, &mpc, psi, reference, u_before, u, &result);
	}
}
#endif
#endif

int main(void) {
	run();
	return 0;
}
