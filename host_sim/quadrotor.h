/* The quadrotor, a step at a time (model and sources: docs/quadrotor.md). */
#ifndef QUADROTOR_H
#define QUADROTOR_H

#include "effects.h"
#include "quaternion.h"

#define QUADROTOR_GRAVITY 9.81 /* m/s^2 */
#define QUADROTOR_GUSTS 0.3    /* s, that turbulence lasts */

/* Parameters of a vehicle: name, unit, bounds, and the value of a Crazyflie 2.1. The only list of them. */
#define QUADROTOR_PARAMETERS(P)                                                                              \
	P(mass, "kg", 0.005, 50, 0.033)           /* with battery and decks */                                   \
	P(arm, "m", 0.01, 2, 0.046)               /* centre to rotor; the rotors stand in an X */                \
	P(inertia_x, "kg m^2", 1e-7, 10, 1.66e-5) /* about the centre of mass, principal axes */                 \
	P(inertia_y, "kg m^2", 1e-7, 10, 1.67e-5)                                                                \
	P(inertia_z, "kg m^2", 1e-7, 10, 2.93e-5)                                                                \
	P(thrust_full, "N", 0.01, 1000, 0.132) /* of one rotor asked for all it has, at `voltage` */             \
	P(torque_per_thrust, "m", 1e-4, 0.5, 0.00596)                                                            \
	P(motor_lag, "s", 0.002, 0.5, 0.06) /* time constant of the thrust */                                    \
	P(drag_xy, "1/s", 0, 5, 0.23)       /* force over mass and velocity through the air */                   \
	P(drag_z, "1/s", 0, 5, 0.26)                                                                             \
	P(voltage, "V", 1, 100, 3.5)         /* of the battery under load */                                     \
	P(voltage_slope, "1/V", -1, 1, -0.1) /* share of thrust that a volt more gives */                        \
	P(rate_gain, "1/s", 1, 500, 110)     /* of the controller's rate loops, roll and pitch */                \
	P(yaw_rate_gain, "1/s", 0.5, 200, 11)

#define QUADROTOR_FIELD(name, unit, low, high, value) double name;
typedef struct quadrotor {
	QUADROTOR_PARAMETERS(QUADROTOR_FIELD)
} quadrotor;

/* Where things stand in a state. The load's swing: horizontal part of the unit vector along its string, and
 * its rate. */
enum {
	QUAD_POSITION = 0,
	QUAD_VELOCITY = 3,
	QUAD_ATTITUDE = 6,
	QUAD_SPIN = 10,
	QUAD_ROTOR = 13, /* share of thrust_full, before voltage and effects */
	QUAD_SWING = 17,
	QUAD_SWINGING = 19,
};

enum { ROTORS = 4 }; /* front right, rear right, rear left, front left */

/* What flows through one step: requests, the battery, the air, what hangs on the vehicle, the sensors. */
typedef struct quadrotor_signal {
	tk_signal common;      /* first: effects are handed this one */
	double asked[ROTORS];  /* actuator: 0 to 1 */
	double vbat;           /* V, NaN where it is not known */
	double thrust[ROTORS]; /* plant: factors */
	double moment[3];      /* plant: N m, body axes */
	double wind[2];        /* plant: m/s, in the world's x and y */
	double drag;           /* plant: 1/s, on top */
	double payload[6];    /* plant: sums over what is fixed to the body of m, m x, m y, m x^2, m y^2, m x y */
	double load[4];       /* plant: on a string: mass (kg), length (m), x, y (m) */
	double turbulence[6]; /* plant: m/s^2 and rad/s^2 in body axes */
	double gyro[3];       /* sensor: on top, rad/s */
	double accelerometer[3]; /* sensor: on top, m/s^2, body axes */
	double vibration;        /* sensor: factor of the noise that vibration makes */
} quadrotor_signal;

static inline quadrotor_signal *in_quadrotor(tk_signal *signal) {
	return (quadrotor_signal *)signal;
}

/* From `parameters` in the order of QUADROTOR_PARAMETERS; null: a Crazyflie 2.1. Fails outside the bounds. */
int quadrotor_from(const double *parameters, quadrotor *vehicle);
/* Share of full thrust at which the rotors carry the vehicle at its voltage. */
double quadrotor_hover_request(const quadrotor *vehicle);
/* Hovering, level, 1 m above the origin. */
void quadrotor_hover(const quadrotor *vehicle, double *state);
/* x and y (m, body axes) of a rotor from the centre. */
void quadrotor_place(const quadrotor *vehicle, size_t rotor, double *place);
/* Sign of the moment about z that a rotor's drag gives. */
double quadrotor_turn(size_t rotor);

/* The effects with bounds and usual sizes for this vehicle; the table refers to `store`. */
typedef struct quadrotor_store {
	tk_effect effects[24];
	const tk_effect *list[24];
} quadrotor_store;
void quadrotor_effects_for(const quadrotor *vehicle, quadrotor_store *store, tk_effects *table);

/* The signal at time t as plant and sensor effects leave it. */
quadrotor_signal quadrotor_signal_at(const effect_chain *effects, double vbat, double t, double dt);
/* Takes the requests through the effects on the way to the rotors; a rotor can do no more than all and no
 * less than nothing. */
void quadrotor_command(const effect_chain *effects, quadrotor_signal *signal);

/* d state / dt; the velocity's part is the acceleration without gravity that an estimator tells. */
void quadrotor_derivative(const quadrotor *vehicle, const quadrotor_signal *signal, const double *state,
                          double *derivative);
/* One step of `dt` on, by Runge and Kutta. */
void quadrotor_step(const quadrotor *vehicle, const quadrotor_signal *signal, double dt, double *state);
/* As the sensors tell: position, velocity, acceleration (world), roll, pitch, yaw, angular velocity (body).
 */
void quadrotor_sense(const quadrotor *vehicle, const quadrotor_signal *signal, const double *state,
                     double *x);
/* Fails if the state at time t is not finite. */
int quadrotor_check(const double *state, double t);

#endif
