/* The differential-drive robot: nominal kinematics and the effects on top. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ddr.h"
#include "effects.h"
#include "message.h"

struct ddr {
	effect_chain effects;
	int integrator;
	double dt;
	size_t k;       /* steps made */
	double pose[3]; /* true */
	struct {
		int known;
		double u[2], reached[3]; /* the last command, and what reached the wheels for how long */
		ddr_motion motion;
	} last; /* commands are often held, and then the motion is the same */
};

static tk_signal signal_at(const ddr *robot, size_t k) {
	return (tk_signal){.t = (double)k * robot->dt, .dt = robot->dt};
}

int ddr_senses(const ddr *robot) {
	return effects_any(&robot->effects, TK_SENSOR);
}

void ddr_sense(const ddr *robot, size_t k, double *pose) {
	if (!effects_any(&robot->effects, TK_SENSOR)) { return; }
	tk_signal signal = signal_at(robot, k);
	for (size_t i = 0; i < 3; i++) { signal.pose[i] = pose[i]; }
	effects_apply(&robot->effects, TK_SENSOR, &signal);
	for (size_t i = 0; i < 3; i++) { pose[i] = signal.pose[i]; }
}

void ddr_unsense(const ddr *robot, size_t k, double *pose) {
	tk_signal signal = signal_at(robot, k);
	for (size_t i = 0; i < 3; i++) { signal.pose[i] = pose[i]; }
	effects_undo(&robot->effects, TK_SENSOR, &signal);
	for (size_t i = 0; i < 3; i++) { pose[i] = signal.pose[i]; }
}

static void actuate(ddr *robot, const effect_chain *effects, const double *u, tk_signal *signal) {
	*signal = signal_at(robot, robot->k++);
	for (size_t i = 0; i < 2; i++) { signal->command[i] = u[i]; }
	effects_apply(effects, TK_ACTUATOR, signal);
}

static ddr_motion moved(const ddr *robot, tk_signal *signal) {
	signal->body[0] = signal->command[0];
	signal->body[2] = signal->command[1];
	effects_apply(&robot->effects, TK_PLANT, signal);
	static const double share[] = {[TK_EULER] = 0, [TK_MIDPOINT] = 1, [TK_ARC] = 1, [TK_SEMI_IMPLICIT] = 2};
	const double half = 0.5 * signal->body[2] * signal->dt, ahead = share[robot->integrator] * half;
	const double c = ahead == 0 ? 1 : cos(ahead), s = ahead == 0 ? 0 : sin(ahead);
	/* an arc's chord lies half the turn ahead, and is shorter than the arc */
	const double chord = robot->integrator == TK_ARC && half != 0 ? s / half : 1;
	return (ddr_motion){
	    .dt = signal->dt,
	    .way = {signal->body[0] * chord, signal->body[1] * chord},
	    .ahead = ahead,
	    .facing = {c, s},
	    .turn = signal->body[2],
	    .drift = {signal->drift[0], signal->drift[1]},
	};
}

/* Whether `now` is bit for bit what was there last; then it is there. */
static int held(double *last, const double *now, size_t count) {
	if (memcmp(last, now, count * sizeof *now) == 0) { return 1; }
	memcpy(last, now, count * sizeof *now);
	return 0;
}

/* The motion of what reached the wheels, which is the last one if that was the same. */
static ddr_motion motion_of(ddr *robot, tk_signal *signal) {
	const double reached[3] = {signal->command[0], signal->command[1], signal->dt};
	const int known = robot->last.known && robot->effects.blocks[TK_PLANT].steady;
	if (!held(robot->last.reached, reached, 3) || !known) { robot->last.motion = moved(robot, signal); }
	robot->last.known = 1;
	return robot->last.motion;
}

ddr_motion ddr_next(ddr *robot, const double *u) {
	const effect_chain *effects = &robot->effects;
	const int steady = effects->blocks[TK_ACTUATOR].steady && effects->blocks[TK_PLANT].steady;
	if (held(robot->last.u, u, 2) && steady && robot->last.known) {
		robot->k++;
		return robot->last.motion;
	}
	tk_signal signal;
	actuate(robot, effects, u, &signal);
	return motion_of(robot, &signal);
}

void ddr_reach(ddr *robot, const double *u, double *reached) {
	effect_chain remembering = robot->effects;
	remembering.count = remembering.remembers;
	tk_signal signal;
	actuate(robot, &remembering, u, &signal);
	for (size_t i = 0; i < 2; i++) { reached[i] = signal.command[i]; }
}

ddr_motion ddr_go_on(ddr *robot, const double *reached) {
	effect_chain rest = robot->effects;
	rest.blocks[TK_ACTUATOR].first = rest.remembers;
	tk_signal signal;
	actuate(robot, &rest, reached, &signal);
	return motion_of(robot, &signal);
}

void ddr_skip(ddr *robot, size_t steps) {
	robot->k += steps;
}

void ddr_roll(ddr *robot, size_t steps, const double *u) {
	effect_chain remembering = robot->effects;
	remembering.count = remembering.remembers; /* what comes after these changes nothing that lasts */
	if (!remembering.count) {
		ddr_skip(robot, steps);
		return;
	}
	tk_signal unused;
	for (size_t k = 0; k < steps; k++) { actuate(robot, &remembering, u + 2 * k, &unused); }
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

void ddr_free(ddr *robot) {
	if (!robot) { return; }
	effects_free(&robot->effects);
	free(robot);
}

void ddr_restart(ddr *robot) {
	effects_restart(&robot->effects);
	robot->k = 0;
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
	ddr *robot = calloc(1, sizeof *robot);
	if (!robot) {
		fail("out of memory");
		return NULL;
	}
	*robot = (ddr){.integrator = integrator, .dt = dt};
	for (size_t i = 0; i < 3; i++) { robot->pose[i] = x0[i]; }
	if (effects_open(&robot->effects, &ddr_effects, effects, n_effects, dt, end) != TK_OK) {
		free(robot);
		return NULL;
	}
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
			    fail("the simulation diverged (NaN or Inf) at t = %g s: check effect parameters and commands",
			         (double)(k + 1) * dt);
		}
	}
	ddr_free(robot);
	return status;
}
