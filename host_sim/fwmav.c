/* The flapping-wing vehicle by itself: a rigid body, two wings whose forces are averaged over the
 * beat, the shaking of the beat on top, motor, servos and battery.
 *
 * Sources in docs/flapping-wing.md; "scaled" is from published figures of a 103-g
 * vehicle of this kind (mass with the mass, inertia with mass times span squared,
 * drag with the mass), "chosen" has no published figure behind it. */
#include "fwmav.h"

#include <math.h>
#include <string.h>

#include "message.h"

static const double PI = 3.141592653589793;
static const double FINE = 0.0005;                         /* s, of a step at most: the shaking asks for it */
static const double MASS = 0.026;                          /* kg, as the paper's vehicle */
static const double GRAVITY = 9.81;                        /* m/s^2 */
static const double INERTIA[3] = {6.4e-5, 3.9e-5, 4.1e-5}; /* kg m^2, scaled */
static const double HOVER_BEAT = 17;                       /* Hz, DelFly Nimble */
static const double ARM = 0.080;                           /* m, root to a wing's centre of pressure */
static const double HEIGHT = 0.027;                        /* m, of these above the centre of mass */
static const double DRAG[3] = {4.3e-3, 2.7e-3, 1.0e-3};    /* of one wing, N/(m/s) per Hz, scaled */
static const double MOTOR_LAG = 0.08;                      /* s, identified on the 103-g vehicle */
static const double SERVO_BAND = 40, SERVO_DAMPING = 0.63; /* rad/s, identified there on the dihedral */
/* share of the voltage, per s; chosen: it then carries the vehicle for five minutes, as DelFly Nimble's does
 */
static const double DISCHARGE = 0.0005;

/* How the beat shakes the body: its first harmonics at HOVER_BEAT (they go with its square), as
 * [harmonic][axis] (cosine, sine). Sizes as logs of the 103-g vehicle show them, phases chosen. */
enum { HARMONICS = 3 };
static const double SHAKE[HARMONICS][3][2] = {
    /* m/s^2, along x, y, z */
    {{-0.5, 1.9}, {-2.6, 8.6}, {2.9, 0.9}},
    {{0.9, 0.9}, {3.7, 3.7}, {4.0, -4.0}},
    {{1.1, -0.8}, {-1.8, 1.8}, {2.4, 2.4}},
};
static const double SWAY[HARMONICS][3][2] = {
    /* rad/s, about x, y, z */
    {{1.2, 0.4}, {0.1, -0.3}, {2.6, 1.0}},
    {{-0.4, 1.2}, {0.3, 0.1}, {-1.5, 1.4}},
    {{0.5, 0.4}, {-0.1, 0.1}, {1.0, -2.6}},
};

double fwmav_hover_beat(void) {
	return HOVER_BEAT;
}

void fwmav_hover(double *state) {
	memset(state, 0, TK_FWMAV_STATES * sizeof *state);
	state[ATTITUDE] = 1;
	state[BEAT] = HOVER_BEAT;
}

void fwmav_sway(double vibration, double *state) {
	for (size_t h = 0; h < HARMONICS; h++) {
		const double order = (double)(h + 1), c = cos(order * state[PHASE]), s = sin(order * state[PHASE]);
		const double band = 2 * PI * HOVER_BEAT * order; /* rad/s */
		for (size_t i = 0; i < 3; i++) {
			state[SPIN + i] += vibration * (SWAY[h][i][0] * c + SWAY[h][i][1] * s);
			state[VELOCITY + i] += vibration * (SHAKE[h][i][0] * s - SHAKE[h][i][1] * c) / band;
		}
	}
}

/* ---- Forces ------------------------------------------------------------------- */

typedef struct servo_angles {
	double sin_dihedral, cos_dihedral, sin_twist, cos_twist;
} servo_angles;

/* Adds force and moment of one wing, in body axes. Thrust goes with the beat squared and leans
 * with the twist; drag goes with the beat and with how the centre of pressure moves through the
 * air, so that it damps turning too (flapping counter-torque). */
static void add_wing(const fwmav_signal *signal, const double *state, const servo_angles *servo,
                     const double *air, int right, double *force, double *moment) {
	const double side = right ? -1 : 1, beat = state[BEAT] + signal->turbulence[6];
	const double share = state[SERVO + 2 * SHARE];
	const double at[3] = {-ARM * servo->sin_dihedral, side * ARM * servo->cos_dihedral, HEIGHT};
	const double thrust = 0.5 * MASS * GRAVITY * (beat / HOVER_BEAT) * (beat / HOVER_BEAT) *
	                      (1 + side * share) * signal->thrust[right];
	double moving[3] = {air[0], air[1], air[2]};
	add_cross(state + SPIN, at, moving);
	double wing[3] = {-side * thrust * servo->sin_twist, 0, thrust * servo->cos_twist};
	for (size_t i = 0; i < 3; i++) {
		wing[i] -= signal->damping * beat * DRAG[i] * moving[i];
		force[i] += wing[i];
	}
	add_cross(at, wing, moment);
}

/* Adds the shaking of the beat: forces, and the moments that make the body sway. */
static void add_shaking(const fwmav_signal *signal, const double *state, double *force, double *moment) {
	const double share = state[BEAT] / HOVER_BEAT, scale = signal->vibration * share * share;
	if (scale == 0) { return; }
	for (size_t h = 0; h < HARMONICS; h++) {
		const double order = (double)(h + 1), c = cos(order * state[PHASE]), s = sin(order * state[PHASE]);
		const double band = 2 * PI * HOVER_BEAT * order; /* rad/s */
		for (size_t i = 0; i < 3; i++) {
			force[i] += scale * MASS * (SHAKE[h][i][0] * c + SHAKE[h][i][1] * s);
			moment[i] += scale * INERTIA[i] * band * (SWAY[h][i][1] * c - SWAY[h][i][0] * s);
		}
	}
}

/* ---- Motion -------------------------------------------------------------------- */

static void actuator_derivative(const fwmav_signal *signal, const double *state, double *derivative) {
	derivative[BEAT] = (signal->beat * signal->voltage - state[BEAT]) / MOTOR_LAG;
	derivative[PHASE] = 2 * PI * (state[BEAT] + signal->turbulence[6]);
	for (size_t i = 0; i < SERVOS; i++) {
		const double *servo = state + SERVO + 2 * i;
		derivative[SERVO + 2 * i] = servo[1];
		derivative[SERVO + 2 * i + 1] =
		    SERVO_BAND * (SERVO_BAND * (signal->servo[i] - servo[0]) - 2 * SERVO_DAMPING * servo[1]);
	}
}

void fwmav_derivative(const fwmav_signal *signal, const double *state, double *derivative, double *felt) {
	const double *velocity = state + VELOCITY, *spin = state + SPIN;
	double R[3][3], air[3], force[3] = {0}, moment[3] = {0};
	quaternion_to_matrix(state + ATTITUDE, R);
	for (size_t i = 0; i < 3; i++) {
		air[i] = R[0][i] * (velocity[0] - signal->wind[0]) + R[1][i] * (velocity[1] - signal->wind[1]) +
		         R[2][i] * velocity[2];
	}
	const double dihedral = state[SERVO + 2 * DIHEDRAL], twist = state[SERVO + 2 * TWIST];
	const servo_angles servo = {sin(dihedral), cos(dihedral), sin(twist), cos(twist)};
	add_wing(signal, state, &servo, air, 0, force, moment);
	add_wing(signal, state, &servo, air, 1, force, moment);
	add_shaking(signal, state, force, moment);

	const double momentum[3] = {INERTIA[0] * spin[0], INERTIA[1] * spin[1], INERTIA[2] * spin[2]};
	add_cross(momentum, spin, moment); /* Euler's equations */
	for (size_t i = 0; i < 3; i++) {
		felt[i] = force[i] / MASS + signal->turbulence[i];
		derivative[SPIN + i] = moment[i] / INERTIA[i] + signal->turbulence[3 + i];
	}
	for (size_t i = 0; i < 3; i++) {
		derivative[POSITION + i] = velocity[i];
		derivative[VELOCITY + i] = R[i][0] * felt[0] + R[i][1] * felt[1] + R[i][2] * felt[2];
	}
	derivative[VELOCITY + 2] -= GRAVITY;
	quaternion_derivative(state + ATTITUDE, spin, derivative + ATTITUDE);
	actuator_derivative(signal, state, derivative);
}

static void runge_kutta(const fwmav_signal *signal, double dt, double *state) {
	static const double node[4] = {0, 0.5, 0.5, 1}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
	double slope[TK_FWMAV_STATES] = {0}, sum[TK_FWMAV_STATES] = {0}, at[TK_FWMAV_STATES], felt[3];
	for (size_t stage = 0; stage < 4; stage++) {
		for (size_t i = 0; i < TK_FWMAV_STATES; i++) { at[i] = state[i] + node[stage] * dt * slope[i]; }
		fwmav_derivative(signal, at, slope, felt);
		for (size_t i = 0; i < TK_FWMAV_STATES; i++) { sum[i] += weight[stage] * slope[i]; }
	}
	for (size_t i = 0; i < TK_FWMAV_STATES; i++) { state[i] += dt * sum[i]; }
	quaternion_normalise(state + ATTITUDE);
}

void fwmav_step(const fwmav_signal *signal, double *state) {
	const size_t parts = (size_t)ceil(signal->common.dt / FINE - 1e-9);
	for (size_t i = 0; i < parts; i++) { runge_kutta(signal, signal->common.dt / (double)parts, state); }
	state[PHASE] = fmod(state[PHASE], 2 * PI);
}

int fwmav_check(const double *state, double t) {
	double sum = 0;
	for (size_t i = 0; i < TK_FWMAV_STATES; i++) { sum += state[i]; }
	if (isfinite(sum)) { return TK_OK; }
	return fail(
	    "the simulated flight diverged (NaN or Inf) at t = %g s: check effect parameters and commands", t);
}

/* ---- Effects -------------------------------------------------------------------- */

fwmav_signal fwmav_signal_at(const effect_chain *effects, double t, double dt) {
	fwmav_signal signal = {
	    .common = {.t = t, .dt = dt},
	    .voltage = 1 - DISCHARGE * t,
	    .thrust = {1, 1},
	    .damping = 1,
	    .vibration = 1,
	};
	effects_apply(effects, TK_PLANT, &signal.common);
	effects_apply(effects, TK_SENSOR, &signal.common);
	return signal;
}

void fwmav_command(const effect_chain *effects, int axis, fwmav_signal *signal) {
	signal->common.command[0] = signal->servo[axis];
	effects_apply(effects, TK_ACTUATOR, &signal->common);
	signal->servo[axis] = signal->common.command[0];
	signal->servo[DIHEDRAL] += signal->trim[0];
	signal->servo[TWIST] += signal->trim[1];
}

int tk_fwmav_roll(const tk_active *effects, size_t n_effects, int yaw, double dt, size_t steps,
                  const double *state, const double *commands, double *states) {
	if (!state || !commands || !states || (n_effects && !effects)) {
		return fail("state, commands, states and effects must be given");
	}
	if (!(dt > 0 && dt <= 1)) { return fail("dt is %g s, it must be positive and at most 1 s", dt); }
	effect_chain chain;
	if (effects_open(&chain, &fwmav_effects, effects, n_effects, dt, (double)steps * dt) != TK_OK) {
		return TK_ERROR;
	}
	memcpy(states, state, TK_FWMAV_STATES * sizeof *state);
	int status = TK_OK;
	for (size_t k = 0; k < steps && status == TK_OK; k++) {
		const double *command = commands + 4 * k;
		double *now = states + (k + 1) * TK_FWMAV_STATES;
		fwmav_signal signal = fwmav_signal_at(&chain, (double)k * dt, dt);
		signal.beat = command[0];
		for (size_t i = 0; i < SERVOS; i++) { signal.servo[i] = command[1 + i]; }
		fwmav_command(&chain, yaw ? TWIST : DIHEDRAL, &signal);
		memcpy(now, now - TK_FWMAV_STATES, TK_FWMAV_STATES * sizeof *now);
		fwmav_step(&signal, now);
		status = fwmav_check(now, (double)(k + 1) * dt);
	}
	effects_free(&chain);
	return status;
}
