/* The interface of an unmodelled effect.
 *
 * To add one: write effects/NAME.c and add its line to effects.c.
 * All parameters zero must leave every signal bit for bit as it was.
 * Actuator and plant know nothing of the pose: so the way covered in a step is
 * the same wherever it began, and windows.c needs it only once.
 */
#ifndef EFFECTS_H
#define EFFECTS_H

#include "tinykoop_sim.h"

/* What flows through one time step. An effect changes the part of its block. */
typedef struct tk_signal {
	double t, dt;      /* s; t is the log's, dt as it truly lasts */
	double passed;     /* share of the time between setting in and the end, 0 to 1 */
	double command[2]; /* actuator: v (m/s), omega (rad/s) as they reach the wheels */
	double body[3];    /* plant: longitudinal, lateral velocity (m/s), yaw rate (rad/s) */
	double drift[2];   /* plant: velocity (m/s) in the world's axes on top */
	double pose[3];    /* sensor: px, py (m), theta (rad), first true, then as measured */
} tk_signal;

typedef struct tk_parameter {
	const char *name, *unit;
	double low, high; /* refused outside; a fit may begin with closer ones */
	double usual;     /* of a robot that has this effect */
} tk_parameter;

typedef struct tk_effect {
	const char *name;
	int block; /* TK_ACTUATOR, TK_PLANT or TK_SENSOR */
	size_t n_parameters;
	tk_parameter parameters[TK_MAX_PARAMETERS];
	size_t n_memory; /* doubles of state, zero when the effect sets in */
	size_t (*history)(const double *parameters, double dt); /* further ones, or null */
	int needs_end;                                          /* uses `passed` */
	void (*apply)(const double *parameters, double *memory, tk_signal *signal);
	/* sensor: takes back what apply() did; null if it cannot be known */
	void (*undo)(const double *parameters, double *memory, tk_signal *signal);
} tk_effect;

/* Null if there is none of that name. */
const tk_effect *effect_by_name(const char *name);

#endif
