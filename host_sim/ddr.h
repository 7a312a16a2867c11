/* The differential-drive robot, a step at a time. */
#ifndef DDR_H
#define DDR_H

#include "tinykoop_sim.h"

typedef struct ddr ddr;

/* Null after fail(). The effects must outlive the robot. `end` (s): when the
 * drive is over. */
ddr *ddr_open(const tk_active *effects, size_t n_effects, int integrator, double dt, double end,
              const double *x0);
void ddr_free(ddr *robot);
/* Back to the begin of the drive, all but the pose. */
void ddr_restart(ddr *robot);
/* x (3): the pose as measured now */
void ddr_measure(const ddr *robot, double *x);
/* moves by dt under u (2) */
void ddr_step(ddr *robot, const double *u);

/* ---- A step and a measurement in parts, for who has poses of its own ---- */

/* What a step does to any pose: a straight way in the direction that lies `ahead`
 * of the heading at the beginning, and a turn. */
typedef struct ddr_motion {
	double dt;        /* s */
	double way[2];    /* m/s, along and to the left of that direction */
	double ahead;     /* rad */
	double facing[2]; /* cosine and sine of that */
	double turn;      /* rad/s */
	double drift[2];  /* m/s, in the world's axes */
} ddr_motion;

/* The motion of the next step under u (2); time and actuators go on, the robot's pose stays. */
ddr_motion ddr_next(ddr *robot, const double *u);
/* What remembers is behind some command, and commands are often the same: a step in two halves. */
/* The command (2) that the next step has under u (2) behind the last effect that has a state; time goes on. */
void ddr_reach(ddr *robot, const double *u, double *reached);
/* As ddr_next() from there on. */
ddr_motion ddr_go_on(ddr *robot, const double *reached);
/* As many steps of time alone. */
void ddr_skip(ddr *robot, size_t steps);
/* As many steps under u (steps, 2), for what time and actuators become of them. */
void ddr_roll(ddr *robot, size_t steps, const double *u);
void ddr_move(const ddr_motion *motion, double *pose);
/* Whether a sensor's effect acts; a true pose into the measured one at step k, and back. */
int ddr_senses(const ddr *robot);
void ddr_sense(const ddr *robot, size_t k, double *pose);
void ddr_unsense(const ddr *robot, size_t k, double *pose);

#endif
