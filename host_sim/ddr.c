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

struct ddr {
	running *runs;
	double *memory;
	size_t count;
	int senses;    /* whether any effect has a say in the measured pose, */
	int remembers; /* or a state of its own */
	int integrator;
	double dt, end;
	size_t k;       /* steps made */
	double pose[3]; /* true */
};

static tk_signal signal_at(const ddr *robot, size_t k) {
	return (tk_signal){.t = (double)k * robot->dt, .dt = robot->dt};
}

/* Whether `r` has a say in this block now; if so, tells it how far its time has passed. */
static int acts(const ddr *robot, const running *r, int block, tk_signal *signal) {
	const double now = signal->t + 1e-6 * robot->dt; /* t is k dt: rounded */
	if (r->effect->block != block || now < r->active->t0 || now >= r->active->t1) { return 0; }
	const double end = fmin(r->active->t1, robot->end);
	signal->passed = r->effect->needs_end ? (signal->t - r->active->t0) / (end - r->active->t0) : 0;
	return 1;
}

/* Lets every effect of `block` that acts at this time change the signal. */
static void pass(const ddr *robot, int block, tk_signal *signal) {
	for (size_t i = 0; i < robot->count; i++) {
		const running *r = &robot->runs[i];
		if (acts(robot, r, block, signal)) { r->effect->apply(r->active->parameters, r->memory, signal); }
	}
}

void ddr_sense(const ddr *robot, size_t k, double *pose) {
	if (!robot->senses) { return; }
	tk_signal signal = signal_at(robot, k);
	for (size_t i = 0; i < 3; i++) { signal.pose[i] = pose[i]; }
	pass(robot, TK_SENSOR, &signal);
	for (size_t i = 0; i < 3; i++) { pose[i] = signal.pose[i]; }
}

void ddr_unsense(const ddr *robot, size_t k, double *pose) {
	tk_signal signal = signal_at(robot, k);
	for (size_t i = 0; i < 3; i++) { signal.pose[i] = pose[i]; }
	for (size_t i = robot->count; i-- > 0;) {
		const running *r = &robot->runs[i];
		if (r->effect->undo && acts(robot, r, TK_SENSOR, &signal)) {
			r->effect->undo(r->active->parameters, r->memory, &signal);
		}
	}
	for (size_t i = 0; i < 3; i++) { pose[i] = signal.pose[i]; }
}

ddr_motion ddr_next(ddr *robot, const double *u) {
	tk_signal signal = signal_at(robot, robot->k++);
	for (size_t i = 0; i < 2; i++) { signal.command[i] = u[i]; }
	pass(robot, TK_ACTUATOR, &signal);
	signal.body[0] = signal.command[0];
	signal.body[2] = signal.command[1];
	pass(robot, TK_PLANT, &signal);

	static const double ahead[] = {
	    [TK_EULER] = 0, [TK_MIDPOINT] = 1, [TK_ARC] = 1, [TK_SEMI_IMPLICIT] = 2};
	/* an arc's chord lies half the turn ahead, and is shorter than the arc */
	const double half = 0.5 * signal.body[2] * signal.dt;
	const double chord = robot->integrator == TK_ARC && half != 0 ? sin(half) / half : 1;
	return (ddr_motion){
	    .dt = signal.dt,
	    .way = {signal.body[0] * chord, signal.body[1] * chord},
	    .ahead = ahead[robot->integrator] * half,
	    .turn = signal.body[2],
	    .drift = {signal.drift[0], signal.drift[1]},
	};
}

void ddr_roll(ddr *robot, size_t steps, const double *u) {
	if (!robot->remembers) {
		robot->k += steps;
		return;
	}
	for (size_t k = 0; k < steps; k++) { ddr_next(robot, u + 2 * k); }
}

void ddr_move(const ddr_motion *m, double *pose) {
	const double c = cos(pose[2] + m->ahead), s = sin(pose[2] + m->ahead);
	pose[0] += (m->way[0] * c - m->way[1] * s + m->drift[0]) * m->dt;
	pose[1] += (m->way[0] * s + m->way[1] * c + m->drift[1]) * m->dt;
	pose[2] += m->turn * m->dt;
}

void ddr_measure(const ddr *robot, double *x) {
	for (size_t i = 0; i < 3; i++) { x[i] = robot->pose[i]; }
	ddr_sense(robot, robot->k, x);
}

void ddr_step(ddr *robot, const double *u) {
	const ddr_motion motion = ddr_next(robot, u);
	ddr_move(&motion, robot->pose);
}

/* ---- Setting up ------------------------------------------------------------- */

enum { MOST_MEMORY = 1 << 20 }; /* doubles of one effect */

static int check_parameters(const tk_effect *effect, const tk_active *active) {
	if (active->n_parameters != effect->n_parameters) {
		return fail("%s: %zu parameters are given, it takes %zu", effect->name, active->n_parameters,
		            effect->n_parameters);
	}
	for (size_t i = 0; i < effect->n_parameters; i++) {
		const tk_parameter *p = &effect->parameters[i];
		const double value = active->parameters[i];
		if (!(value >= p->low && value <= p->high)) {
			return fail("%s: %s is %g, it must be between %g and %g", effect->name, p->name, value, p->low,
			            p->high);
		}
	}
	return TK_OK;
}

static size_t memory_of(const tk_effect *effect, const tk_active *active, double dt) {
	return effect->n_memory + (effect->history ? effect->history(active->parameters, dt) : 0);
}

static int check(const tk_active *active, double dt) {
	const tk_effect *effect = effect_by_name(active->effect);
	if (!effect) { return fail("there is no effect named '%s'", active->effect ? active->effect : ""); }
	if (!isfinite(active->t0) || isnan(active->t1)) {
		return fail("%s: it acts from %g s to %g s, which is no time", effect->name, active->t0, active->t1);
	}
	if (check_parameters(effect, active) != TK_OK) { return TK_ERROR; }
	if (memory_of(effect, active, dt) > MOST_MEMORY) {
		return fail("%s reaches back over too many steps of %g s", effect->name, dt);
	}
	return TK_OK;
}

/* In the order of the table of effects, whatever the caller's: reordering a
 * list of effects must not change a trajectory. */
static void collect(ddr *robot, const tk_active *actives) {
	size_t n = 0;
	double *memory = robot->memory;
	for (size_t e = 0; e < tk_effect_count(); e++) {
		const tk_effect *effect = effect_by_name(tk_effect_name(e));
		for (size_t i = 0; i < robot->count; i++) {
			if (effect_by_name(actives[i].effect) != effect) { continue; }
			robot->runs[n++] = (running){effect, &actives[i], memory};
			const size_t size = memory_of(effect, &actives[i], robot->dt);
			robot->senses |= effect->block == TK_SENSOR;
			robot->remembers |= size > 0;
			memory += size;
		}
	}
}

void ddr_free(ddr *robot) {
	if (!robot) { return; }
	free(robot->runs);
	free(robot->memory);
	free(robot);
}

ddr *ddr_open(const tk_active *effects, size_t n_effects, int integrator, double dt, double end,
              const double *x0) {
	if (!(dt > 0 && isfinite(dt))) {
		fail("dt is %g s, it must be positive", dt);
		return NULL;
	}
	if (integrator < TK_EULER || integrator > TK_SEMI_IMPLICIT) {
		fail("there is no integrator %d", integrator);
		return NULL;
	}
	size_t memory_size = 1;
	for (size_t i = 0; i < n_effects; i++) {
		if (check(&effects[i], dt) != TK_OK) { return NULL; }
		memory_size += memory_of(effect_by_name(effects[i].effect), &effects[i], dt);
	}
	ddr *robot = calloc(1, sizeof *robot);
	if (robot) {
		*robot = (ddr){.count = n_effects, .integrator = integrator, .dt = dt, .end = end};
		for (size_t i = 0; i < 3; i++) { robot->pose[i] = x0[i]; }
		robot->runs = calloc(n_effects + 1, sizeof *robot->runs);
		robot->memory = calloc(memory_size, sizeof *robot->memory);
	}
	if (!robot || !robot->runs || !robot->memory) {
		ddr_free(robot);
		fail("out of memory");
		return NULL;
	}
	collect(robot, effects);
	return robot;
}

int tk_ddr_simulate(const tk_active *effects, size_t n_effects, int integrator, double dt, size_t steps,
                    const double *x0, const double *u, double *x) {
	if (!x0 || !u || !x || (n_effects && !effects)) { return fail("x0, u, x and effects must be given"); }
	ddr *robot = ddr_open(effects, n_effects, integrator, dt, (double)steps * dt, x0);
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
