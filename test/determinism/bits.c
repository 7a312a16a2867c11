/* All that the library computes, in one script of fixed inputs, so that builds of it can be compared. For
 * each part of the script prints a line of
 *
 *     part <precision> <name> <digest of the bits of all outputs> <the last outputs, in hexadecimal>
 *
 * Of NaN only that it is one goes into the digest: its sign and payload are the processor's choice. Needs
 * nothing of libm, so that nothing but the library can differ. */
#include "tinykoop_supervisor.h"
#include "precision.h"

#include <stdio.h>
#include <string.h>

#if TEST_DOUBLE
#define PART "part float64 "
#else
#define PART "part float32 "
#endif

#define COUNT(array) (sizeof(array) / sizeof *(array))

/* ---- What is written down ------------------------------------------------------ */

#define LAST 8

static uint64_t digest; /* FNV-1a */
static real last[LAST];
static size_t noted;
static uint32_t seed;

static void digest_bytes(const void *bytes, size_t count) {
	for (size_t i = 0; i < count; i++) {
		digest = (digest ^ ((const unsigned char *)bytes)[i]) * 0x100000001B3u;
	}
}

static void note(const real *values, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (values[i] == values[i]) {
			digest_bytes(values + i, sizeof *values);
		} else {
			digest_bytes("NaN", 3);
		}
		last[noted++ % LAST] = values[i];
	}
}

static void note_number(long number) {
	const real value = (real)number;
	digest_bytes(&value, sizeof value);
}

/* The caller has printed the part's name. */
static void part_begin(void) {
	digest = 0xCBF29CE484222325u;
	noted = 0;
	seed = 1;
}

static void part_end(void) {
	printf(" %08lx%08lx", (unsigned long)(digest >> 32), (unsigned long)(digest & 0xFFFFFFFFu));
	for (size_t i = 0; i < LAST && i < noted; i++) { printf(" %a", (double)last[i]); }
	printf("\n");
}

/* ---- Inputs ---------------------------------------------------------------------- */

/* in [low, high), a multiple of (high - low) / 2^16: exact in either precision for what is asked below */
static real uniform(real low, real high) {
	seed = seed * 1664525u + 1013904223u;
	return low + (high - low) * (real)(seed >> 16) / 65536;
}

static void uniform_fill(real *x, size_t count, real low, real high) {
	for (size_t i = 0; i < count; i++) { x[i] = uniform(low, high); }
}

/* ---- Lift -------------------------------------------------------------------------- */

static void lifts(const KOOP(dictionary) *dictionary, const char *vehicle) {
	static const real scales[] = {1, (real)1e-5, 10, 1000, 500000, (real)1e20};
	printf(PART "lift-%s-%s", dictionary->name, vehicle);
	part_begin();
	for (size_t k = 0; k < 300; k++) {
		real x[10], psi[30];
		uniform_fill(x, COUNT(x), -4, 4);
		x[k % dictionary->n_states] *= scales[k % COUNT(scales)];
		const int status = KOOP(lift)(dictionary, x, psi);
		note_number(status);
		if (status == KOOP_OK) { note(psi, dictionary->n_lifted); }
	}
	part_end();
}

/* ---- Updates ------------------------------------------------------------------------- */

#define N 9
#define M 2
#define D (N + M)

static void lift_identity(const KOOP(dictionary) *self, const real *x, real *psi) {
	for (size_t i = 0; i < self->n_lifted; i++) { psi[i] = x[i]; }
}

static const KOOP(dictionary) identity = {"identity", N, N, lift_identity, NULL};
#define ENTER(name) &KOOP(reg_##name),
static const KOOP(regulator) *const regulators[] = {KOOP_REGULATORS(ENTER)};
#undef ENTER
static const KOOP(form) *const forms[] = {&KOOP(form_plain), &KOOP(form_sqrt)};

static KOOP(rls) rls;
static real rls_storage[KOOP_RLS_REALS_PLAIN(22, M)];

static void note_health(const KOOP(health) *health) {
	note(&health->innovation, 1);
	note(&health->trace, 1);
	note(&health->min_diagonal, 1);
	note_number(health->frozen + 2 * health->positive_definite + 4 * health->finite);
}

static void note_learned(void) {
	static real theta[N * D], covariance[D * D];
	note_number(KOOP(rls_get_covariance)(&rls, covariance));
	note(covariance, COUNT(covariance));
	note_number(KOOP(rls_get_theta)(&rls, theta));
	note(theta, COUNT(theta));
}

static KOOP(gate) gate;
static real gate_storage[KOOP_GATE_REALS_PLAIN(N, M)];
static int gated; /* whether samples go through it */

static int learn(const real *psi, const real *u, const real *next, KOOP(health) *health) {
	return gated ? KOOP(gate_update)(&gate, &rls, psi, u, next, health)
	             : KOOP(rls_update)(&rls, psi, u, next, health);
}

/* A stable linear robot with noise; from the middle on little excites it, which winds P up. Now and then a
 * sample is not a number, infinite or huge. */
static void drive(size_t steps) {
	static const real faults[] = {(real)NAN, REAL_MAX, (real)INFINITY};
	real psi[N], next[N], u[M];
	uniform_fill(psi, N, -1, 1);
	for (size_t k = 0; k < steps; k++) {
		const real size = k < steps / 2 ? 1 : (real)0.015625;
		KOOP(health) health;
		uniform_fill(u, M, -size, size);
		for (size_t i = 0; i < N; i++) {
			const real noise = uniform(-size, size) / 32;
			next[i] = (real)0.75 * psi[i] - psi[(i + 1) % N] / 8 + u[i % M] / 2 + noise;
		}
		const real right = next[k % N];
		if (k % 17 == 16) { next[k % N] = faults[k / 17 % COUNT(faults)]; }
		note_number(learn(psi, u, next, &health));
		note_health(&health);
		next[k % N] = right;
		memcpy(psi, next, sizeof psi);
	}
}

static void start(const KOOP(regulator) *regulator, const KOOP(form) *form, int check) {
	static const KOOP(dead_zone) zone = {(real)0.03125};
	const int has_zone = regulator == &KOOP(reg_dz_cs) || regulator == &KOOP(reg_dz_ks);
	const KOOP(config) config = {.dictionary = &identity,
	                             .n_inputs = M,
	                             .regulator = regulator,
	                             .settings = has_zone ? &zone : NULL,
	                             .form = form,
	                             .lambda = (real)0.5,
	                             .p0 = 100,
	                             .check = check};
	note_number(KOOP(rls_init)(&rls, &config, rls_storage, COUNT(rls_storage)));
}

static void updates(void) {
	static const char *const checks[] = {"refuse", "report", "diagonal"};
	for (size_t i = 0; i < COUNT(regulators) * COUNT(forms) * COUNT(checks); i++) {
		const KOOP(regulator) *regulator = regulators[i / COUNT(checks) / COUNT(forms)];
		const KOOP(form) *form = forms[i / COUNT(checks) % COUNT(forms)];
		printf(PART "update-%s-%s-%s", regulator->name, form->name, checks[i % COUNT(checks)]);
		part_begin();
		start(regulator, form, (int)(i % COUNT(checks)));
		drive(120);
		note_learned();
		part_end();
	}
}

static void gated_updates(void) {
	for (size_t f = 0; f < COUNT(forms); f++) {
		printf(PART "gate-%s", forms[f]->name);
		part_begin();
		start(&KOOP(reg_none), forms[f], KOOP_CHECK_REFUSE);
		note_number(KOOP(gate_init)(&gate, NULL, &rls, gate_storage, COUNT(gate_storage)));
		gated = 1;
		drive(400);
		gated = 0;
		note_learned();
		note_number((int)gate.restored);
		note(gate.variance, N);
		part_end();
	}
}

/* ---- What is small ------------------------------------------------------------------------ */

static void small_parts(void) {
	static unsigned char model[MODEL_BYTES(N, M)];
	real scores[100], x[3], y[3], state[KOOP_LOWPASS_REALS(3)], delta, psi[N], u[M];
	KOOP(lowpass) filter;

	printf(PART "threshold");
	part_begin();
	for (int k = 0; k <= 20; k++) {
		uniform_fill(scores, COUNT(scores), 0, 1);
		note_number(KOOP(threshold)(scores, COUNT(scores), (real)k / 20, &delta));
		note(scores, COUNT(scores));
		note(&delta, 1);
	}
	part_end();

	printf(PART "lowpass");
	part_begin();
	for (int k = 1; k <= 9; k++) {
		note_number(KOOP(lowpass_init)(&filter, COUNT(x), (real)k * 5, 100, state, COUNT(state)));
		for (int i = 0; i < 40; i++) {
			uniform_fill(x, COUNT(x), -1, 1);
			note_number(KOOP(lowpass_step)(&filter, x, y));
			note(y, COUNT(y));
		}
	}
	part_end();

	printf(PART "model");
	part_begin();
	start(&KOOP(reg_ef), &KOOP(form_sqrt), KOOP_CHECK_REFUSE);
	drive(40);
	note_number(KOOP(model_save)(&rls, model, sizeof model));
	digest_bytes(model, sizeof model);
	start(&KOOP(reg_sift), &KOOP(form_plain), KOOP_CHECK_REFUSE);
	note_number(KOOP(model_load)(&rls, model, sizeof model));
	uniform_fill(psi, N, -1, 1);
	uniform_fill(u, M, -1, 1);
	for (int k = 0; k < 20; k++) {
		note_number(KOOP(rls_predict)(&rls, psi, u, psi));
		note(psi, N);
	}
	drive(40); /* from the loaded model on */
	note_number(KOOP(rls_reset_covariance)(&rls, 1));
	drive(40);
	note_learned();
	part_end();
}

/* ---- Closed loops ---------------------------------------------------------------------------- */

#define HORIZON 16
#define STATES 3

typedef struct {
	const char *name;
	const KOOP(dictionary) *dictionary;
	int method, rate, cold;
} loop;

static KOOP(mpc) mpc;
static real mpc_storage[KOOP_MPC_REALS_NEWTON(22, STATES, M, HORIZON) + KOOP_MPC_REALS_RATE(M, HORIZON)];
static KOOP(supervisor) supervisor;
static real supervisor_storage[KOOP_SUPERVISOR_REALS(22, STATES, M, HORIZON)];
static real offline[(22 + M) * KOOP_PAD(22)];

/* The differential-drive robot, with the library's own sine. */
static void move(real *x, const real *u) {
	real psi[7];
	note_number(KOOP(lift)(&KOOP(poly_ddr), x, psi));
	x[0] += u[0] * psi[6] / 16;
	x[1] += u[0] * psi[5] / 16;
	x[2] += u[1] / 16;
}

static void loop_start(const loop *l) {
	static const real Q[STATES * STATES] = {20, 1, 0, 1, 20, 0, 0, 0, 3};
	static const real R[M * M] = {(real)0.0625, 0, 0, (real)0.125}, S[M * M] = {(real)0.25, 0, 0, (real)0.5};
	static const real u_min[M] = {0, (real)-1.25}, u_max[M] = {3, (real)1.25}, u_safe[M] = {0, 0};
	const KOOP(config) config = {.dictionary = l->dictionary,
	                             .n_inputs = M,
	                             .regulator = &KOOP(reg_ef),
	                             .form = &KOOP(form_sqrt),
	                             .lambda = (real)0.98,
	                             .p0 = 100};
	const KOOP(mpc_config) control = {.n_lifted = l->dictionary->n_lifted,
	                                  .n_states = STATES,
	                                  .n_inputs = M,
	                                  .horizon = HORIZON,
	                                  .Q = Q,
	                                  .R = R,
	                                  .S = l->rate ? S : NULL,
	                                  .u_min = u_min,
	                                  .u_max = u_max,
	                                  .u_safe = u_safe,
	                                  .method = l->method};
	note_number(KOOP(rls_init)(&rls, &config, rls_storage, COUNT(rls_storage)));
	note_number(KOOP(mpc_init)(&mpc, &control, mpc_storage, COUNT(mpc_storage)));
}

/* Applies u to the robot and learns from what it does. */
static void loop_step(const loop *l, int supervised, const real *u, real *x, real *psi) {
	real next[22];
	KOOP(health) health;
	move(x, u);
	note_number(KOOP(lift)(l->dictionary, x, next));
	note_number(supervised ? KOOP(supervisor_update)(&supervisor, &rls, psi, u, next, &health)
	                       : KOOP(rls_update)(&rls, psi, u, next, &health));
	note_health(&health);
	memcpy(psi, next, l->dictionary->n_lifted * sizeof *psi);
	note(x, STATES);
}

static void loop_learn(const loop *l, real *x, real *psi) {
	note_number(KOOP(lift)(l->dictionary, x, psi));
	for (int k = 0; k < 60; k++) {
		const real u[M] = {uniform(0, 2), uniform(-1, 1)};
		loop_step(l, 0, u, x, psi);
	}
}

/* Half a metre beside the robot, straight on. */
static void loop_path(const real *x, real *path) {
	for (size_t i = 0; i < HORIZON; i++) {
		path[i * STATES] = x[0] + (real)(i + 1) / 8;
		path[i * STATES + 1] = x[1] + (real)0.5;
		path[i * STATES + 2] = 0;
	}
}

static void note_solved(const KOOP(mpc_result) *result, const real *u) {
	real plan[HORIZON * M], G[STATES * M];
	note(&result->residual, 1);
	note_number((long)result->iterations);
	note_number(KOOP(mpc_plan)(&mpc, plan));
	note(plan, COUNT(plan));
	note_number(KOOP(mpc_sensitivity)(&mpc, HORIZON / 2, G));
	note(G, COUNT(G));
	note(u, M);
}

static void run(const loop *l) {
	real x[STATES] = {0, 0, 0}, psi[22], path[HORIZON * STATES], u[M] = {0, 0};
	KOOP(mpc_result) result;
	printf(PART "loop-%s-%s", l->dictionary->name, l->name);
	part_begin();
	loop_start(l);
	loop_learn(l, x, psi);
	for (int k = 0; k < 15; k++) {
		loop_path(x, path);
		if (l->cold) { note_number(KOOP(mpc_reset)(&mpc)); }
		note_number(KOOP(mpc_solve)(&mpc, rls.theta, psi, path, u, u, &result));
		note_solved(&result, u);
		loop_step(l, 0, u, x, psi);
	}
	part_end();
}

/* The learner is led astray by samples of another robot, and comes back. */
static void run_supervised(const loop *l) {
	real x[STATES] = {0, 0, 0}, psi[22], path[HORIZON * STATES], u[M] = {0, 0};
	KOOP(mpc_result) result;
	printf(PART "supervisor-%s", l->dictionary->name);
	part_begin();
	loop_start(l);
	loop_learn(l, x, psi);
	const size_t size = rls.n_regressors * rls.n_lifted_padded;
	memcpy(offline, rls.theta, size * sizeof *offline);
	note_number(KOOP(supervisor_init)(&supervisor, NULL, &mpc, offline, supervisor_storage,
	                                  COUNT(supervisor_storage)));
	for (int k = 0; k < 60; k++) {
		loop_path(x, path);
		note_number(KOOP(supervisor_control)(&supervisor, &rls, &mpc, psi, path, u, u, &result));
		note_number(supervisor.model);
		note(u, M);
		note(&result.residual, 1);
		const real wrong[M] = {k >= 20 && k < 25 ? -4 * u[0] : u[0], u[1]};
		loop_step(l, 1, wrong, x, psi);
	}
	part_end();
}

int main(void) {
	static const loop loops[] = {
	    {"newton", &KOOP(poly_ddr), KOOP_MPC_NEWTON, 0, 0},
	    {"newton-rate", &KOOP(poly_ddr), KOOP_MPC_NEWTON, 1, 0},
	    {"gradient", &KOOP(poly_ddr), KOOP_MPC_GRADIENT, 0, 0},
	    {"gradient-rate", &KOOP(poly_ddr), KOOP_MPC_GRADIENT, 1, 0},
	    {"newton", &KOOP(rbf_ddr), KOOP_MPC_NEWTON, 0, 0},
	    {"newton-cold", &KOOP(rbf_ddr), KOOP_MPC_NEWTON, 0, 1},
	    {"newton-rate-cold", &KOOP(rbf_ddr), KOOP_MPC_NEWTON, 1, 1},
	    {"gradient-cold", &KOOP(rbf_ddr), KOOP_MPC_GRADIENT, 0, 1},
	};
	lifts(&KOOP(poly_ddr), "ddr");
	lifts(&KOOP(rbf_ddr), "ddr");
	lifts(&KOOP(poly_fwmav), "fwmav");
	lifts(&KOOP(rbf_fwmav), "fwmav");
	updates();
	gated_updates();
	small_parts();
	for (size_t i = 0; i < COUNT(loops); i++) { run(loops + i); }
	run_supervised(loops);
	return 0;
}
