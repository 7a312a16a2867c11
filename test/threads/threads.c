/* Separate objects in separate threads: each thread learns, plans and supervisors on its own, and must end
 * with the bits of the same run alone. Built with ThreadSanitizer, which sees what two threads would share.
 */
#include "tinykoop_supervisor.h"

#include "../c/precision.h"

#include <pthread.h>
#include <stdio.h>
#include <string.h>

enum { THREADS = 8, STEPS = 200, STATES = 3, INPUTS = 2, HORIZON = 10, MOST = 22 };

typedef struct {
	uint64_t seed, digest;
	int refused; /* calls that did not return KOOP_OK */
	KOOP(rls) rls;
	KOOP(mpc) mpc;
	KOOP(supervisor) supervisor;
	KOOP(lowpass) filter;
	real learner[KOOP_RLS_REALS_PLAIN(MOST, INPUTS)];
	real controller[KOOP_MPC_REALS_NEWTON(MOST, STATES, INPUTS, HORIZON)];
	real supervised[KOOP_SUPERVISOR_REALS(MOST, STATES, INPUTS, HORIZON)];
	real filtered[KOOP_LOWPASS_REALS(STATES)];
	real offline[(MOST + INPUTS) * KOOP_PAD(MOST)];
	unsigned char model[MODEL_BYTES(MOST, INPUTS)];
} agent;

static void note(agent *a, int status) {
	a->refused += status != KOOP_OK;
}

static void digest(agent *a, const void *bytes, size_t count) {
	const unsigned char *byte = (const unsigned char *)bytes;
	for (size_t i = 0; i < count; i++) { a->digest = (a->digest ^ byte[i]) * 0x100000001B3u; }
}

static real noise(agent *a) {
	a->seed = a->seed * 6364136223846793005u + 1442695040888963407u;
	return (real)(int32_t)(a->seed >> 32) / (real)2147483648.0;
}

/* Each thread has its own regulator, form and dictionary. */
static void start(agent *a, size_t which) {
#define ENTER(name) &KOOP(reg_##name),
	static const KOOP(regulator) *const regulators[] = {KOOP_REGULATORS(ENTER)};
	static const real weight[STATES * STATES] = {10, 0, 0, 0, 10, 0, 0, 0, 1},
	                                  effort[INPUTS * INPUTS] = {1, 0, 0, 1};
	static const real low[INPUTS] = {-1, -2}, high[INPUTS] = {1, 2}, safe[INPUTS] = {0, 0};
	memset(a, 0, sizeof *a);
	a->seed = which + 1;
	a->digest = 0xCBF29CE484222325u;
	const KOOP(config) config = {
	    .dictionary = which % 2 ? &KOOP(rbf_ddr) : &KOOP(poly_ddr),
	    .n_inputs = INPUTS,
	    .regulator = regulators[which % (sizeof regulators / sizeof *regulators)],
	    .form = which / 2 % 2 ? &KOOP(form_sqrt) : &KOOP(form_plain),
	    .lambda = (real)0.99,
	    .p0 = 10,
	};
	const size_t N = config.dictionary->n_lifted;
	const KOOP(mpc_config) control = {N,    STATES, INPUTS, HORIZON, weight, effort,
	                                  NULL, low,    high,   safe,    0,      KOOP_MPC_NEWTON};
	note(a, KOOP(rls_init)(&a->rls, &config, a->learner, sizeof a->learner / sizeof *a->learner));
	note(a, KOOP(mpc_init)(&a->mpc, &control, a->controller, sizeof a->controller / sizeof *a->controller));
	note(a, KOOP(lowpass_init)(&a->filter, STATES, 10, 100, a->filtered, KOOP_LOWPASS_REALS(STATES)));
	for (size_t i = 0; i < N; i++) { a->offline[i * KOOP_PAD(N) + i] = 1; }
	for (size_t j = 0; j < INPUTS; j++) {
		for (size_t i = 0; i < STATES; i++) {
			a->offline[(N + j) * KOOP_PAD(N) + i] = (real)0.1 + (real)0.01 * (real)(i + j);
		}
	}
	note(a, KOOP(supervisor_init)(&a->supervisor, NULL, &a->mpc, a->offline, a->supervised,
	                              sizeof a->supervised / sizeof *a->supervised));
	note(a, KOOP(rls_copy_theta)(&a->rls, a->offline));
}

static void step(agent *a, real x[STATES]) {
	real psi[MOST], psi_next[MOST], u[INPUTS], reference[HORIZON * STATES] = {0};
	const KOOP(dictionary) *dictionary = a->rls.config.dictionary;
	note(a, KOOP(lift)(dictionary, x, psi));
	note(a, KOOP(supervisor_control)(&a->supervisor, &a->rls, &a->mpc, psi, reference, NULL, u, NULL));
	x[0] += (real)0.1 * u[0] * (1 - x[2] * x[2] / 2) + (real)0.01 * noise(a);
	x[1] += (real)0.1 * u[0] * x[2] + (real)0.01 * noise(a);
	x[2] = (real)0.9 * x[2] + (real)0.1 * u[1] + (real)0.01 * noise(a);
	note(a, KOOP(lowpass_step)(&a->filter, x, x));
	note(a, KOOP(lift)(dictionary, x, psi_next));
	note(a, KOOP(supervisor_update)(&a->supervisor, &a->rls, psi, u, psi_next, NULL));
	digest(a, u, sizeof u);
}

static void *fly(void *argument) {
	agent *a = (agent *)argument;
	real x[STATES] = {1, (real)-0.5, (real)0.2};
	const size_t size = KOOP_MODEL_HEADER_BYTES + sizeof(real) * a->rls.n_lifted * a->rls.n_regressors;
	for (int k = 0; k < STEPS; k++) { step(a, x); }
	note(a, KOOP(model_save)(&a->rls, a->model, sizeof a->model));
	note(a, KOOP(model_load)(&a->rls, a->model, size));
	digest(a, a->model, size);
	return NULL;
}

static agent alone[THREADS], together[THREADS];

int main(void) {
	pthread_t threads[THREADS];
	int wrong = 0;
	for (size_t t = 0; t < THREADS; t++) {
		start(&alone[t], t);
		start(&together[t], t);
		fly(&alone[t]);
	}
	for (size_t t = 0; t < THREADS; t++) {
		if (pthread_create(&threads[t], NULL, fly, &together[t]) != 0) { return 2; }
	}
	for (size_t t = 0; t < THREADS; t++) { pthread_join(threads[t], NULL); }
	for (size_t t = 0; t < THREADS; t++) {
		const int same = alone[t].digest == together[t].digest && alone[t].refused == 0;
		if (!same) {
			printf("thread %zu: %d calls refused, digest %016llx instead of %016llx\n", t,
			       together[t].refused, (unsigned long long)together[t].digest,
			       (unsigned long long)alone[t].digest);
		}
		wrong += !same;
	}
	return wrong != 0;
}
