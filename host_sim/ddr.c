/* The differential-drive robot: nominal kinematics and the effects on top. */
#include <math.h>
#include <stdlib.h>

#include "ddr.h"
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

/* In the order of the table of effects, whatever the caller's: reordering a
 * list of effects must not change a trajectory. */
static void collect(const tk_active *actives, size_t count, running *runs, double *memory) {
	size_t n = 0;
	for (size_t e = 0; e < tk_effect_count(); e++) {
		const tk_effect *effect = effect_by_name(tk_effect_name(e));
		for (size_t i = 0; i < count; i++) {
			if (effect_by_name(actives[i].effect) != effect) { continue; }
			runs[n++] = (running){effect, &actives[i], memory};
			memory += effect->n_memory;
		}
	}
}

struct ddr {
	running *runs;
	double *memory;
	size_t count;
	double dt;
	size_t k;       /* steps made */
	double pose[3]; /* true */
};

void ddr_free(ddr *robot) {
	if (!robot) { return; }
	free(robot->runs);
	free(robot->memory);
	free(robot);
}

ddr *ddr_new(const tk_active *effects, size_t n_effects, double dt, const double *x0) {
	if (!(dt > 0)) {
		fail("dt is %g s, it must be positive", dt);
		return NULL;
	}
	size_t memory_size = 1;
	for (size_t i = 0; i < n_effects; i++) {
		const tk_effect *effect = effect_by_name(effects[i].effect);
		if (!effect) {
			fail("there is no effect named '%s'", effects[i].effect ? effects[i].effect : "");
			return NULL;
		}
		memory_size += effect->n_memory;
	}
	ddr *robot = calloc(1, sizeof *robot);
	if (robot) {
		*robot = (ddr){.count = n_effects, .dt = dt, .pose = {x0[0], x0[1], x0[2]}};
		robot->runs = calloc(n_effects + 1, sizeof *robot->runs);
		robot->memory = calloc(memory_size, sizeof *robot->memory);
	}
	if (!robot || !robot->runs || !robot->memory) {
		ddr_free(robot);
		fail("out of memory");
		return NULL;
	}
	collect(effects, n_effects, robot->runs, robot->memory);
	return robot;
}

void ddr_measure(const ddr *robot, double *x) {
	tk_signal signal = {.t = (double)robot->k * robot->dt, .dt = robot->dt};
	for (size_t i = 0; i < 3; i++) { signal.pose[i] = robot->pose[i]; }
	pass(robot->runs, robot->count, TK_SENSOR, &signal);
	for (size_t i = 0; i < 3; i++) { x[i] = signal.pose[i]; }
}

void ddr_step(ddr *robot, const double *u) {
	tk_signal signal = {.t = (double)robot->k * robot->dt, .dt = robot->dt};
	step(robot->runs, robot->count, u, robot->pose, &signal);
	robot->k++;
}

int tk_ddr_simulate(const tk_active *effects, size_t n_effects, double dt, size_t steps, const double *x0,
                    const double *u, double *x) {
	if (!x0 || !u || !x || (n_effects && !effects)) { return fail("x0, u, x and effects must be given"); }
	ddr *robot = ddr_new(effects, n_effects, dt, x0);
	if (!robot) { return TK_ERROR; }
	int status = TK_OK;
	ddr_measure(robot, x);
	for (size_t k = 0; k < steps && status == TK_OK; k++) {
		const double *measured = x + 3 * (k + 1);
		ddr_step(robot, u + 2 * k);
		ddr_measure(robot, x + 3 * (k + 1));
		if (!isfinite(robot->pose[0] + robot->pose[1] + robot->pose[2] + measured[0] + measured[1] +
		              measured[2])) {
			status =
			    fail("simulation left the finite numbers at t = %g s: check effect parameters and commands",
			         (double)(k + 1) * dt);
		}
	}
	ddr_free(robot);
	return status;
}
