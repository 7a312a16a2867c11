/* What runs on the flapping-wing vehicle's flight controller: attitude estimate and attitude loops. */
#ifndef FWMAV_CONTROLLER_H
#define FWMAV_CONTROLLER_H

#include "fwmav.h"

/* Mahony's filter (explicit complementary filter with bias), with the Crazyflie's gains. */
typedef struct estimate {
	double q[4], bias[3];     /* the bias is what is to be added to the gyro */
	double pitch, roll, yaw;  /* rad */
	double rate[3], yaw_rate; /* rad/s, body axes and about the vertical */
} estimate;

/* Sets the attitude from its angles (rad). */
void estimate_set(estimate *e, double pitch, double roll, double yaw);
/* One step of dt (s) from gyro (rad/s) and the direction in which the accelerometer feels the
 * vertical: its reading over that reading's norm. The angles stay as they were. */
void estimate_step(estimate *e, const double *gyro, const double *felt, double dt);
/* Brings pitch, roll, yaw and yaw rate up to date. */
void estimate_angles(estimate *e);

/* PID of one axis on the attitude, the rate through a first-order low-pass. */
typedef struct loop {
	double p, i, d; /* per rad, per rad s, per rad/s */
	double cutoff;  /* Hz */
	double most;    /* of the command */
	double rate, sum;
} loop;

/* The vehicle's, at rest, in the order of the servos. */
void loops_start(loop *loops);
/* The command after dt (s), rad or share. */
double loop_step(loop *l, double asked, double angle, double rate, double dt);

#endif
