/* What runs on the quadrotor's flight controller: cascaded PID loops, as in the Crazyflie's firmware. */
#ifndef QUADROTOR_CONTROLLER_H
#define QUADROTOR_CONTROLLER_H

#include "quadrotor.h"

#define QUADROTOR_TICK 0.002 /* s, of the attitude and rate loops */

typedef struct quadrotor_aim {
	double position[3], yaw; /* m, world; rad */
} quadrotor_aim;

/* Integral and, filtered, the derivative of what a loop controls. */
typedef struct pid_memory {
	double sum, last, slope;
} pid_memory;

typedef struct quadrotor_controller {
	size_t ticks; /* since it was reset */
	pid_memory position[3], velocity[3], angle[3], rate[3];
	double asked[3];   /* roll, pitch, yaw, rad */
	double collective; /* share of full thrust */
} quadrotor_controller;

/* With all integrals zero, but for the lift of a vehicle that hovers. */
void quadrotor_control_start(const quadrotor *vehicle, int hovers, quadrotor_controller *c);
/* Requests of the rotors for x as measured (position, velocity, -, roll, pitch, yaw, angular velocity); to be
 * called every QUADROTOR_TICK. */
void quadrotor_control(const quadrotor *vehicle, quadrotor_controller *c, const quadrotor_aim *aim,
                       const double *x, double *asked);

#endif
