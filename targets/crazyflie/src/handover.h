/* What the controller task and the application task hand to each other, and the model
 * that both work on. */
#ifndef HANDOVER_H
#define HANDOVER_H

#include <stdint.h>

#include "FreeRTOS.h"
#include "queue.h"

#include "tinykoop.h"

/* The model: how the vehicle, under its stock controller, follows its position setpoint.
 *
 *     x    = [px py (m, from home)  vx vy (m/s)  tx ty (tilt: body z axis in the world)]
 *     psi  = [x  vx |v|  vy |v|  1]      drag, and what wind and trim add
 *     u    = pull: the position setpoint given to the stock controller less the position (m)
 *
 * Nothing in it depends on mass, motors or the stock gains: those are learned. */
enum {
	N_STATES = 6,
	N_TRACKED = 2, /* px, py */
	N_LIFTED = 9,
	N_INPUTS = 2,
	N_REGRESSORS = N_LIFTED + N_INPUTS,

	HOLD = 5,     /* ticks of 10 ms in a step of the model: 50 ms */
	HORIZON = 20, /* steps: 1 s, about twice what the stock controller takes to respond */
	SENT = 3      /* number of copied inputs: a plan is valid for 150 ms */
};

/* The stock controller saturates at 1 m/s: with its gain of 2 /s that is at 0.5 m. */
#define MOST_PULL 0.5f

/* From the controller task, at every step of the model. */
typedef struct {
	uint32_t tick;
	float theta[N_REGRESSORS * KOOP_PAD(N_LIFTED)]; /* laid out as rls.theta is */
	float psi[N_LIFTED];
	float pull[N_INPUTS];             /* the last one */
	float target[N_TRACKED];          /* setpoint's position (m, from home) */
	float target_velocity[N_TRACKED]; /* and velocity (m/s) */
} problem;

/* From the application task. */
typedef struct {
	uint32_t tick;              /* of the problem */
	int8_t status;              /* of the solve */
	uint8_t plausible;          /* 1: by the model a pull moves the vehicle that way */
	uint16_t microseconds;      /* that it took */
	float residual;             /* of the solve (m) */
	float pull[SENT][N_INPUTS]; /* for the next steps of the model */
} plan;

/* Queues of one: the newest counts. They copy, so neither task sees a half-written one. */
extern xQueueHandle problems, plans;

#endif
