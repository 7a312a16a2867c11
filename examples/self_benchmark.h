/* Measures on your chip how many cycles lift, update and solve take, with the cycle counter (DWT) of a Cortex-M3 or
 * larger. Include it in one file. self_benchmark.c is the whole program; targets/crazyflie/src/benchmark.c is the
 * same as a task of a firmware. */
#ifndef SELF_BENCHMARK_H
#define SELF_BENCHMARK_H

#include "tinykoop.h"

#include <stdint.h>
#include <string.h>

#ifndef SELF_BENCHMARK_HORIZON
#define SELF_BENCHMARK_HORIZON 20 /* steps; the storage of the controller grows with its square */
#endif
#define SELF_BENCHMARK_RUNS 101
#define SELF_BENCHMARK_NO_COUNTER 1 /* the chip, or the emulator, counts no cycles */

/* A line of the results: function, N, m, horizon, min, median, max (cycles). */
#define SELF_BENCHMARK_LINE "cycles %s %u %u %u %u %u %u\n"

enum { BENCH_STATES = 3, BENCH_INPUTS = 2, BENCH_LIFTED = 22, BENCH_LEARN = 300 };

typedef struct bench_result {
	const char *function;
	unsigned n_lifted;
	unsigned min, median, max; /* cycles */
} bench_result;

/* ---- The cycle counter ----------------------------------------------------------------------------- */

/* For another processor: a function without arguments, uint32_t, that counts up and wraps around. */
#ifdef SELF_BENCHMARK_COUNTER

static uint32_t bench_now(void) {
	return SELF_BENCHMARK_COUNTER();
}

static int bench_open(void) {
	return 1;
}

#elif defined(__ARM_ARCH) && __ARM_ARCH >= 7 && defined(__ARM_ARCH_PROFILE) && __ARM_ARCH_PROFILE == 'M'

#define BENCH_REGISTER(address) (*(volatile uint32_t *)(address))
#define BENCH_DEMCR BENCH_REGISTER(0xE000EDFCu)
#define BENCH_DWT_CTRL BENCH_REGISTER(0xE0001000u)
#define BENCH_DWT_CYCCNT BENCH_REGISTER(0xE0001004u)
#define BENCH_DWT_LAR BENCH_REGISTER(0xE0001FB0u)

static uint32_t bench_now(void) {
	return BENCH_DWT_CYCCNT;
}

/* 1: the counter runs. */
static int bench_open(void) {
	BENCH_DEMCR |= UINT32_C(1) << 24; /* TRCENA */
	BENCH_DWT_LAR = 0xC5ACCE55u;      /* some Cortex-M7 lock the unit */
	BENCH_DWT_CTRL |= 1;              /* CYCCNTENA */
	const uint32_t before = bench_now();
	for (int i = 0; i < 100; i++) {
		if (bench_now() != before) { return 1; }
	}
	return 0;
}

#else

static uint32_t bench_now(void) {
	return 0;
}

static int bench_open(void) {
	return 0;
}

#endif

/* ---- A robot that drives, learns and follows a path --------------------------------------------------- */

static struct {
	const koopf_dictionary *dictionary;
	koopf_rls rls;
	koopf_gate gate;
	koopf_mpc mpc;
	float rls_storage[KOOP_RLS_REALS_SQRT(BENCH_LIFTED, BENCH_INPUTS)];
	float gate_storage[KOOP_GATE_REALS_SQRT(BENCH_LIFTED, BENCH_INPUTS)];
	float mpc_storage[KOOP_MPC_REALS_NEWTON(BENCH_LIFTED, BENCH_STATES, BENCH_INPUTS, SELF_BENCHMARK_HORIZON)];
	float psi[BENCH_LIFTED], psi_next[BENCH_LIFTED];
	float pose[BENCH_STATES], target[BENCH_STATES]; /* of the robot, and of the point that it follows */
	float reference[SELF_BENCHMARK_HORIZON * BENCH_STATES];
	float u[BENCH_INPUTS];
	uint32_t cycles[SELF_BENCHMARK_RUNS];
	uint32_t overhead; /* of reading the counter twice */
} bench;

/* psi[5] and psi[6] of this dictionary are sine and cosine of the heading: no libm is needed. */
static void bench_move(float pose[BENCH_STATES], const float u[BENCH_INPUTS]) {
	const float x[BENCH_STATES] = {0, 0, pose[2]};
	float psi[7];
	if (koopf_lift(&koopf_poly_ddr, x, psi) != KOOP_OK) { return; }
	pose[0] += 0.05f * u[0] * psi[6];
	pose[1] += 0.05f * u[0] * psi[5];
	pose[2] += 0.05f * u[1];
}

/* Commands at step k: round and round, and varied so that every direction is excited. */
static void bench_command(uint32_t k, float u[BENCH_INPUTS]) {
	u[0] = 1.2f + 0.1f * (float)(k % 7);
	u[1] = 0.4f + 0.2f * (float)(k % 5);
}

static int bench_start(const koopf_dictionary *dictionary) {
	static const float Q[BENCH_STATES * BENCH_STATES] = {20, 0, 0, 0, 20, 0, 0, 0, 3};
	static const float R[BENCH_INPUTS * BENCH_INPUTS] = {0.05f, 0, 0, 0.08f};
	static const float least[BENCH_INPUTS] = {0, -1.2f}, most[BENCH_INPUTS] = {3.5f, 1.2f};
	static const float none[BENCH_INPUTS] = {0, 0};
	static const koopf_dead_zone zone = {.delta = 1e-6f}; /* so small that every sample changes the covariance */
	const koopf_config config = {.dictionary = dictionary,
	                             .n_inputs = BENCH_INPUTS,
	                             .regulator = &koopf_reg_dz_cs,
	                             .settings = &zone,
	                             .form = &koopf_form_sqrt,
	                             .lambda = 0.98f,
	                             .p0 = 100};
	const koopf_mpc_config control = {.n_lifted = dictionary->n_lifted,
	                                  .n_states = BENCH_STATES,
	                                  .n_inputs = BENCH_INPUTS,
	                                  .horizon = SELF_BENCHMARK_HORIZON,
	                                  .Q = Q,
	                                  .R = R,
	                                  .u_min = least,
	                                  .u_max = most,
	                                  .u_safe = none,
	                                  .method = KOOP_MPC_NEWTON};
	memset(&bench.pose, 0, sizeof bench.pose);
	bench.dictionary = dictionary;
	int status = koopf_rls_init(&bench.rls, &config, bench.rls_storage,
	                            sizeof bench.rls_storage / sizeof *bench.rls_storage);
	if (status == KOOP_OK) {
		status = koopf_mpc_init(&bench.mpc, &control, bench.mpc_storage,
		                        sizeof bench.mpc_storage / sizeof *bench.mpc_storage);
	}
	return status == KOOP_OK ? koopf_lift(dictionary, bench.pose, bench.psi) : status;
}

static int bench_lift(void) {
	return koopf_lift(bench.dictionary, bench.pose, bench.psi_next);
}

static int bench_update(void) {
	koopf_health health;
	return koopf_rls_update(&bench.rls, bench.psi, bench.u, bench.psi_next, &health);
}

static int bench_gate(void) {
	koopf_health health;
	const int status =
	    koopf_gate_update(&bench.gate, &bench.rls, bench.psi, bench.u, bench.psi_next, &health);
	return status == KOOP_E_OUTLIER ? KOOP_OK : status;
}

static int bench_solve(void) {
	return koopf_mpc_solve(&bench.mpc, bench.rls.theta, bench.psi, bench.reference, NULL, bench.u, NULL);
}

/* The way of the target from here. */
static void bench_preview(uint32_t k) {
	float at[BENCH_STATES], u[BENCH_INPUTS];
	memcpy(at, bench.target, sizeof at);
	for (uint32_t i = 0; i < SELF_BENCHMARK_HORIZON; i++) {
		bench_command(k + i, u);
		bench_move(at, u);
		memcpy(bench.reference + i * BENCH_STATES, at, sizeof at);
		if (i == 0) { memcpy(bench.target, at, sizeof at); }
	}
}

/* ---- Measuring ---------------------------------------------------------------------------------------- */

enum { BENCH_NOTHING, BENCH_LIFT, BENCH_UPDATE, BENCH_GATE, BENCH_WARM, BENCH_COLD, BENCH_KINDS };

static int bench_timed(int timed, uint32_t k, int (*call)(void)) {
	const uint32_t begin = bench_now();
	const int status = call();
	const uint32_t took = bench_now() - begin;
	if (timed) { bench.cycles[k % SELF_BENCHMARK_RUNS] = took > bench.overhead ? took - bench.overhead : 0; }
	return status;
}

/* One step: the input of this step, the robot's motion, and a sample that is learned. */
static int bench_step(int kind, uint32_t k) {
	int status = KOOP_OK;
	bench_command(k, bench.u);
	if (kind == BENCH_WARM || kind == BENCH_COLD) {
		bench_preview(k);
		if (kind == BENCH_COLD) { status = koopf_mpc_reset(&bench.mpc); }
		if (status == KOOP_OK) { status = bench_timed(1, k, bench_solve); }
	}
	bench_move(bench.pose, bench.u);
	if (status == KOOP_OK) { status = bench_timed(kind == BENCH_LIFT, k, bench_lift); }
	if (status == KOOP_OK) {
		const int timed = kind == BENCH_UPDATE || kind == BENCH_GATE;
		status = bench_timed(timed, k, kind == BENCH_GATE ? bench_gate : bench_update);
	}
	memcpy(bench.psi, bench.psi_next, sizeof bench.psi);
	return status;
}

static int bench_steps(int kind, uint32_t count) {
	int status = KOOP_OK;
	for (uint32_t k = 0; k < count && status == KOOP_OK; k++) { status = bench_step(kind, k); }
	return status;
}

static void bench_sort(void) {
	for (int i = 1; i < SELF_BENCHMARK_RUNS; i++) {
		const uint32_t value = bench.cycles[i];
		int j = i;
		for (; j > 0 && bench.cycles[j - 1] > value; j--) { bench.cycles[j] = bench.cycles[j - 1]; }
		bench.cycles[j] = value;
	}
}

static int bench_nothing(void) {
	return KOOP_OK;
}

static int bench_dictionary(const koopf_dictionary *dictionary, void (*print)(const bench_result *)) {
	static const char *const names[] = {"", "lift", "update", "gate", "warm", "cold"};
	int status = bench_start(dictionary);
	if (status == KOOP_OK) { status = bench_steps(BENCH_NOTHING, BENCH_LEARN); }
	if (status == KOOP_OK) {
		status = koopf_gate_init(&bench.gate, NULL, &bench.rls, bench.gate_storage,
		                         sizeof bench.gate_storage / sizeof *bench.gate_storage);
	}
	memcpy(bench.target, bench.pose, sizeof bench.target);
	bench.target[1] += 0.5f; /* m: the first plans are held by the limits */
	for (int kind = BENCH_LIFT; kind < BENCH_KINDS && status == KOOP_OK; kind++) {
		status = bench_steps(kind, SELF_BENCHMARK_RUNS);
		bench_sort();
		const bench_result result = {names[kind], (unsigned)dictionary->n_lifted, (unsigned)bench.cycles[0],
		                             (unsigned)bench.cycles[SELF_BENCHMARK_RUNS / 2],
		                             (unsigned)bench.cycles[SELF_BENCHMARK_RUNS - 1]};
		if (status == KOOP_OK) { print(&result); }
	}
	return status;
}

/* Calls `print` for each function at N = 7 and N = 22. KOOP_OK, the status of a call that failed, or
 * SELF_BENCHMARK_NO_COUNTER. */
static int self_benchmark(void (*print)(const bench_result *)) {
	if (!bench_open()) { return SELF_BENCHMARK_NO_COUNTER; }
	bench.overhead = 0;
	(void)bench_timed(1, 0, bench_nothing);
	bench.overhead = bench.cycles[0];
	const int status = bench_dictionary(&koopf_poly_ddr, print);
	return status == KOOP_OK ? bench_dictionary(&koopf_rbf_ddr, print) : status;
}

#endif
