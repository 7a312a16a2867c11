/* The flapping-wing vehicle, a step at a time (model: docs/flapping-wing.md). */
#ifndef FWMAV_H
#define FWMAV_H

#include "effects.h"
#include "quaternion.h"

#define FWMAV_TURN 6.283185307179586 /* rad */
#define FWMAV_GUSTS 0.1              /* s, that turbulence lasts */

/* Where things stand in a state. Angle and rate of a servo follow each other. */
enum {
	POSITION = 0,
	VELOCITY = 3,
	ATTITUDE = 6,
	SPIN = 10,
	BEAT = 13,
	PHASE = 14,
	SERVO = 15,
};

/* The servos: dihedral (pitches), wing twist (yaws), share of thrust moved to the left wing (rolls). */
enum { DIHEDRAL, TWIST, SHARE, SERVOS };

/* What flows through one step: commands, the air, the shaking of the body, the gyro. */
typedef struct fwmav_signal {
	tk_signal common;     /* first: effects are handed this one; command[0] is u (rad) */
	double beat;          /* asked of the motor with a full battery, Hz */
	double servo[SERVOS]; /* asked: rad, rad, 1 */
	double trim[2];       /* actuator: on top of dihedral and twist, rad */
	double voltage;       /* plant: share of a full battery's */
	double thrust[2];     /* plant: factor of the left and the right wing's */
	double damping;       /* plant: factor */
	double vibration;     /* plant: factor */
	double wind[2];       /* plant: m/s, in the world's x and y */
	double turbulence[7]; /* plant: m/s^2 and rad/s^2 in body axes, Hz of wing beat */
	double gyro[3];       /* sensor: on top, rad/s */
} fwmav_signal;

static inline fwmav_signal *in_flight(tk_signal *signal) {
	return (fwmav_signal *)signal;
}

/* Hovering, level, at the origin. */
void fwmav_hover(double *state);
/* Adds the swaying that belongs to the beat's phase, by this factor, to a hovering vehicle. */
void fwmav_sway(double vibration, double *state);
/* Wing-beat frequency at which the wings carry the vehicle, Hz. */
double fwmav_hover_beat(void);

/* The signal at time t as plant and sensor effects leave it. */
fwmav_signal fwmav_signal_at(const effect_chain *effects, double t, double dt);
/* Takes beat and servo commands through the effects on the way to the wings; u is that of servo `axis`. */
void fwmav_command(const effect_chain *effects, int axis, fwmav_signal *signal);

/* d state / dt, and what an accelerometer in the centre of mass feels (m/s^2, body axes). */
void fwmav_derivative(const fwmav_signal *signal, const double *state, double *derivative, double *felt);
/* The step of `signal` on, in as many parts as the shaking asks for. */
void fwmav_step(const fwmav_signal *signal, double *state);
/* Fails if the state at time t is not finite. */
int fwmav_check(const double *state, double t);

#endif
