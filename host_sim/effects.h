/* The interface of an unmodelled effect.
 *
 * To add one: write effects/NAME.c (of the DDR), fwmav_effects/NAME.c or quadrotor_effects/NAME.c
 * and add its line to effects.c.
 * All parameters zero must leave every signal bit for bit as it was.
 * Actuator and plant of the DDR know nothing of the pose: so the way covered in a
 * step is the same wherever it began, and windows.c needs it only once.
 */
#ifndef EFFECTS_H
#define EFFECTS_H

#include "tinykoop_sim.h"

/* What flows through one time step. An effect changes the part of its block.
 * The FWMAV has one command, and the quadrotor four; they have signals of their own around this (fwmav.h,
 * quadrotor.h). */
typedef struct tk_signal {
	double t, dt;      /* s; t is the log's, dt as it truly lasts */
	double passed;     /* share of the time between setting in and the end, 0 to 1 */
	double command[2]; /* actuator: v (m/s), omega (rad/s) as they reach the wheels; u (rad), 0 the wings */
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
	const char *name, *formula; /* of what it changes, in the names of its parameters */
	const char *family;         /* effects that look alike in a log; null: its own name */
	const char *reported_as;    /* the effect of which it is another form; null: its own name */
	int block;                  /* TK_ACTUATOR, TK_PLANT or TK_SENSOR */
	size_t n_parameters;
	tk_parameter parameters[TK_MAX_PARAMETERS];
	size_t n_memory; /* doubles of state, zero when the effect sets in */
	size_t (*history)(const double *parameters, double dt); /* further ones, or null */
	int needs_end;                                          /* uses `passed` */
	void (*apply)(const double *parameters, double *memory, tk_signal *signal);
	/* sensor: takes back what apply() did; null if it cannot be known */
	void (*undo)(const double *parameters, double *memory, tk_signal *signal);
} tk_effect;

/* The effects of one platform, in the order of action. */
typedef struct tk_effects {
	const char *platform;
	const tk_effect *const *effects;
	size_t count;
} tk_effects;

extern const tk_effects ddr_effects, fwmav_effects, quadrotor_effects;

/* Null if there is none of that name. */
const tk_effect *effect_by_name(const tk_effects *table, const char *name);

/* ---- Those that act on one robot -------------------------------------------- */

typedef struct effect_chain {
	struct running *runs;
	double *memory;
	size_t count, memory_size;
	double dt, end; /* s */
	size_t remembers; /* those up to the last one that has a state of its own */
	struct {
		size_t first, end; /* of the effects of a block, and others that may stand between them */
		int steady;        /* what they make of a signal does not depend on time, nor on what was before */
	} blocks[TK_BLOCKS];
} effect_chain;

/* The effects must outlive the chain; `end` (s): when the log is over. */
int effects_open(effect_chain *chain, const tk_effects *table, const tk_active *effects, size_t n_effects,
                 double dt, double end);
void effects_free(effect_chain *chain);
/* As they were when they were opened. */
void effects_restart(effect_chain *chain);
/* Whether any effect is of this block. */
int effects_any(const effect_chain *chain, int block);
/* Lets every effect of `block` that acts at this time change the signal. */
void effects_apply(const effect_chain *chain, int block, tk_signal *signal);
/* Takes back what those of `block` did that can be undone, the last one first. */
void effects_undo(const effect_chain *chain, int block, tk_signal *signal);

/* ---- Effects that several platforms have ---------------------------------------- */

void delay_commands(const double *parameters, double *memory, tk_signal *signal);
size_t delay_history(const double *parameters, double dt);
/* One command, late by `delay`; `memory` of axis_delay_history(). */
void delay_command(double delay, double *memory, double dt, double *command);
size_t axis_delay_history(double delay, double dt);
enum { LAG_MEMORY = 8 };
void lag_commands(const double *parameters, double *memory, tk_signal *signal);

/* ---- What several forms share -------------------------------------------------- */

/* One command behind a first-order lag of time constant tau; `memory` of AXIS_LAG_MEMORY. */
enum { AXIS_LAG_MEMORY = 4 };
void lag_command(double tau, double *memory, double dt, double *command);
/* Beyond `dead` it loses `dead`, within it nothing is left. */
double shrunk(double value, double dead);
/* The speeds of the two wheels at the rim, a track apart, each changed by act(rim speed, limit). Without a
 * track both wheels have the speed of the robot. */
void change_wheels(double (*act)(double rim, double limit), double limit, double track, tk_signal *signal);
/* Speed and yaw rate lose the shares v_loss and w_loss of themselves, and the robot slides by the share
 * `lateral` of the commanded speed, towards the inside of the bend. */
void slip_by(double v_loss, double w_loss, double lateral, tk_signal *signal);

#endif
