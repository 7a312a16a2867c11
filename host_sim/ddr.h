/* The differential-drive robot, a step at a time. */
#ifndef DDR_H
#define DDR_H

#include "tinykoop_sim.h"

typedef struct ddr ddr;

/* Null after fail(). The effects must outlive the robot. */
ddr *ddr_new(const tk_active *effects, size_t n_effects, double dt, const double *x0);
void ddr_free(ddr *robot);
/* x (3): the pose as measured now */
void ddr_measure(const ddr *robot, double *x);
/* moves by dt under u (2) */
void ddr_step(ddr *robot, const double *u);

#endif
