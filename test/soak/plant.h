/* The robots of the soak: simple, nearly linear when lifted, and excited in every direction. */
#ifndef PLANT_H
#define PLANT_H

#include "support.h"

enum { MOST_STATES = 10, MOST_INPUTS = 3 };

/* One step: x and u led to next. In double, so that a fault can be of any size. */
typedef struct {
	double x[MOST_STATES], u[MOST_INPUTS], next[MOST_STATES];
} sample;

typedef struct {
	const char *name;
	size_t n, m;
	double lambda;            /* what the paper forgets by on this robot */
	const double *low, *high; /* of the n states, then of the m inputs */
	void (*move)(const double *x, const double *u, double effect, double *next);
	void (*adjust)(random_source *random, double *x); /* of a state that was drawn; may be null */
} plant;

extern const plant plant_ddr, plant_fwmav;

/* A step from a state of its own, so that any d of them excite every direction. `effect`: how much of
 * the inputs arrives, 1 if the robot is healthy. */
void plant_draw(const plant *robot, random_source *random, double effect, sample *s);
/* next from x and u, with noise or without */
void plant_move(const plant *robot, random_source *noise, double effect, sample *s);

#endif
