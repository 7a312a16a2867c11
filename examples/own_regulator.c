/* Your own regulator, with settings and a memory: exponential forgetting only while the innovation is larger than
 * it usually is, after the variable-rate forgetting of Bruce, Goel and Bernstein ("Convergence and consistency of
 * recursive least squares with variable-rate forgetting", Automatica 119, 2020). P does not grow while the model holds. */
#include <math.h>
#include <stdio.h>

#include "tinykoop.h"

enum { LIFTED = 7, INPUTS = 2 };

/* All settings are floats, in the order of the list below. */
typedef struct {
	float fast, slow; /* samples in the two means of the squared innovation */
	float eta;        /* how strongly their ratio makes it forget */
} variable_rate;

static const koopf_setting settings[] = {{"fast", 1, 1e4f}, {"slow", 1, 1e6f}, {"eta", 0, 100}};
static const variable_rate usual = {10, 100, 0.1f};

enum { FAST, SLOW, MEMORY }; /* the two means are remembered from sample to sample */

static size_t memory(const koopf_rls *rls) {
	(void)rls;
	return MEMORY;
}

/* What the ranges of the list cannot tell. */
static int check(koopf_rls *rls) {
	const variable_rate *own = rls->config.settings;
	return own->fast < own->slow ? KOOP_OK : KOOP_E_RANGE;
}

/* lambda = 1 / (1 + eta (sqrt(fast / slow) - 1)), at least config.lambda. A refused sample gives the means back. */
static int decide(koopf_rls *rls, float innovation, koopf_step *step) {
	const variable_rate *own = rls->config.settings;
	float *mean = rls->memory;
	const float square = innovation * innovation;
	mean[FAST] += (square - mean[FAST]) / own->fast;
	mean[SLOW] += (square - mean[SLOW]) / own->slow;
	const float excess = mean[SLOW] > 0 ? sqrtf(mean[FAST] / mean[SLOW]) - 1 : 0;
	const float lambda = excess > 0 ? fmaxf(1 / (1 + own->eta * excess), rls->config.lambda) : 1;
	step->noise = lambda;
	step->scale = 1 / lambda;
	return KOOP_OK;
}

static const koopf_extension remembers = {.engine = &koopf_reg_engine, .memory = memory};
static const koopf_regulator variable = {
	.name = "variable", .decide = decide, .settings = settings, .n_settings = 3, .defaults = &usual, .check = check,
	.extension = &remembers,
};

int main(void) {
	static float storage[KOOP_RLS_REALS_SQRT(LIFTED, INPUTS) + 2 * KOOP_PAD(MEMORY)];
	const variable_rate own = {.fast = 5, .slow = 50, .eta = 0.2f};
	const koopf_config config = {
		.dictionary = &koopf_poly_ddr, .n_inputs = INPUTS, .regulator = &variable, .settings = &own, .form = &koopf_form_sqrt,
		.lambda = 0.9f, .p0 = 100.0f,
	};
	koopf_rls learner;
	float psi[LIFTED], psi_next[LIFTED], x[3] = {0}, theta[LIFTED * (LIFTED + INPUTS)];
	int status = koopf_rls_init(&learner, &config, storage, sizeof storage / sizeof *storage);
	if (status == KOOP_OK) { status = koopf_lift(&koopf_poly_ddr, x, psi); }
	for (int k = 0; k < 600 && status == KOOP_OK; k++) {
		const float turns = k < 300 ? 1.0f : 0.5f; /* a wheel fails half-way */
		const float u[INPUTS] = {0.5f + 0.3f * sinf(0.1f * (float)k), 0.6f * cosf(0.08f * (float)k)};
		x[0] += 0.05f * u[0] * cosf(x[2]);
		x[1] += 0.05f * u[0] * sinf(x[2]);
		x[2] += 0.05f * turns * u[1];
		status = koopf_lift(&koopf_poly_ddr, x, psi_next);
		if (status == KOOP_OK) { status = koopf_rls_update(&learner, psi, u, psi_next, NULL); }
		for (int i = 0; i < LIFTED; i++) { psi[i] = psi_next[i]; }
	}
	if (status == KOOP_OK) { status = koopf_rls_get_theta(&learner, theta); }
	const float turn = theta[2 * (LIFTED + INPUTS) + LIFTED + 1]; /* the heading's row, the second input's column */
	printf("status %d, learned turn per step %.4f s, true 0.0250 s\n", status, (double)turn);
	return status != KOOP_OK || !(fabsf(turn - 0.025f) < 1e-3f);
}
