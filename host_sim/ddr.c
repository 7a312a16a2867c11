/* The differential-drive robot: nominal kinematics and the effects on top. */
#include <math.h>
#include <stdlib.h>

#include "effects.h"
#include "message.h"

typedef struct running {
	const tk_effect *effect;
	const tk_active *active;
	double *memory;
} running;

/* Lets every effect of `block` that acts at this time change the signal. */
static void pass(const running *runs, size_t count, int block, tk_signal *signal) {
	const double now = signal->t + 1e-6 * signal->dt; /* t is k dt: rounded */
	for (size_t i = 0; i < count; i++) {
		const running *r = &runs[i];
		if (r->effect->block == block && r->active->t0 <= now && now < r->active->t1) {
			r->effect->apply(r->active->parameters, r->memory, signal);
		}
	}
}

/* One Euler step, paper eq. (nominal kinematics), from `pose` into itself. */
static void step(const running *runs, size_t count, const double *u, double *pose, tk_signal *signal) {
	for (size_t i = 0; i < 2; i++) { signal->command[i] = u[i]; }
	for (size_t i = 0; i < 3; i++) { signal->pose[i] = pose[i]; }
	pass(runs, count, TK_ACTUATOR, signal);
	signal->body[0] = signal->command[0];
	signal->body[1] = 0;
	signal->body[2] = signal->command[1];
	pass(runs, count, TK_PLANT, signal);

	const double c = cos(pose[2]), s = sin(pose[2]);
	pose[0] += (signal->body[0] * c - signal->body[1] * s) * signal->dt;
	pose[1] += (signal->body[0] * s + signal->body[1] * c) * signal->dt;
	pose[2] += signal->body[2] * signal->dt;
}

static void measure(const running *runs, size_t count, const double *pose, tk_signal *signal, double *x) {
	for (size_t i = 0; i < 3; i++) { signal->pose[i] = pose[i]; }
	pass(runs, count, TK_SENSOR, signal);
	for (size_t i = 0; i < 3; i++) { x[i] = signal->pose[i]; }
}

static int simulate(const running *runs, size_t count, double dt, size_t steps, const double *x0,
                    const double *u, double *x) {
	double pose[3] = {x0[0], x0[1], x0[2]};
	tk_signal signal = {0};
	signal.dt = dt;
	measure(runs, count, pose, &signal, x);
	for (size_t k = 0; k < steps; k++) {
		signal.t = (double)k * dt;
		step(runs, count, u + 2 * k, pose, &signal);
		signal.t = (double)(k + 1) * dt;
		measure(runs, count, pose, &signal, x + 3 * (k + 1));
		const double *measured = x + 3 * (k + 1);
		if (!isfinite(pose[0] + pose[1] + pose[2] + measured[0] + measured[1] + measured[2])) {
			return fail(
			    "simulation left the finite numbers at t = %g s: check effect parameters and commands",
			    signal.t);
		}
	}
	return TK_OK;
}

/* In the order of the table of effects, whatever the caller's: reordering a
 * list of effects must not change a trajectory. */
static int collect(const tk_active *actives, size_t count, running *runs, double *memory) {
	size_t n = 0;
	for (size_t e = 0; e < tk_effect_count(); e++) {
		const tk_effect *effect = effect_by_name(tk_effect_name(e));
		for (size_t i = 0; i < count; i++) {
			if (effect_by_name(actives[i].effect) != effect) { continue; }
			runs[n++] = (running){effect, &actives[i], memory};
			memory += effect->n_memory;
		}
	}
	return n == count ? TK_OK : TK_ERROR;
}

int tk_ddr_simulate(const tk_active *effects, size_t n_effects, double dt, size_t steps, const double *x0,
                    const double *u, double *x) {
	if (!x0 || !u || !x || (n_effects && !effects)) { return fail("x0, u, x and effects must be given"); }
	if (!(dt > 0)) { return fail("dt is %g s, it must be positive", dt); }
	size_t memory_size = 1;
	for (size_t i = 0; i < n_effects; i++) {
		const tk_effect *effect = effect_by_name(effects[i].effect);
		if (!effect) {
			return fail("there is no effect named '%s'", effects[i].effect ? effects[i].effect : "");
		}
		memory_size += effect->n_memory;
	}

	running *runs = calloc(n_effects + 1, sizeof *runs);
	double *memory = calloc(memory_size, sizeof *memory);
	int status = fail("out of memory");
	if (runs && memory && collect(effects, n_effects, runs, memory) == TK_OK) {
		status = simulate(runs, n_effects, dt, steps, x0, u, x);
	}
	free(runs);
	free(memory);
	return status;
}
