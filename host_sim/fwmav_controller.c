/* Attitude estimate and attitude loops of the flapping-wing vehicle. */
#include "fwmav_controller.h"

#include <math.h>
#include <string.h>

#include "angle.h"

/* ---- Attitude estimate ---------------------------------------------------------- */

void estimate_set(estimate *e, double pitch, double roll, double yaw) {
	quaternion_from_angles(roll, pitch, yaw, e->q);
	e->pitch = pitch;
	e->roll = roll;
	e->yaw = yaw;
}

void estimate_step(estimate *e, const double *gyro, const double *felt, double dt) {
	static const double KP = 0.4, KI = 0.001; /* 1/s, 1/s^2 */
	double R[3][3], turn[3], slope[4];
	quaternion_to_matrix(e->q, R);
	/* from the vertical as estimated to the one that is felt */
	const double *up = R[2];
	const double off[3] = {felt[1] * up[2] - felt[2] * up[1], felt[2] * up[0] - felt[0] * up[2],
	                       felt[0] * up[1] - felt[1] * up[0]};
	for (size_t i = 0; i < 3; i++) {
		e->bias[i] += KI * off[i] * dt;
		e->rate[i] = gyro[i] + e->bias[i];
		turn[i] = e->rate[i] + KP * off[i];
	}
	quaternion_derivative(e->q, turn, slope);
	for (size_t i = 0; i < 4; i++) { e->q[i] += dt * slope[i]; }
	quaternion_normalise(e->q);
}

void estimate_angles(estimate *e) {
	double angles[3];
	quaternion_to_angles(e->q, angles);
	e->roll = angles[0];
	e->pitch = angles[1];
	e->yaw = angles[2];
	const double c = cos(e->pitch);
	e->yaw_rate = (sin(e->roll) * e->rate[1] + cos(e->roll) * e->rate[2]) / fmax(c, 0.01);
}

/* ---- Loops ---------------------------------------------------------------------- */

/* Sizes of p and d as the Flapper's in the Crazyflie firmware, in radians; i chosen. */
static const loop at_rest[SERVOS] = {
    [DIHEDRAL] = {.p = 0.25, .i = 0.1, .d = 0.04, .cutoff = 20, .most = 0.31},
    [TWIST] = {.p = 0.30, .i = 0.1, .d = 0.01, .cutoff = 5, .most = 0.5},
    [SHARE] = {.p = 0.40, .i = 0.5, .d = 0.05, .cutoff = 20, .most = 0.3},
};

void loops_start(loop *loops) {
	memcpy(loops, at_rest, sizeof at_rest);
}

static double limited(double value, double most) {
	return fmax(-most, fmin(most, value));
}

double loop_step(loop *l, double asked, double angle, double rate, double dt) {
	const double off = wrapped(asked - angle);
	l->rate += (1 - exp(-FWMAV_TURN * l->cutoff * dt)) * (rate - l->rate);
	l->sum = limited(l->sum + l->i * off * dt, 0.5 * l->most);
	return limited(l->p * off + l->sum - l->d * l->rate, l->most);
}
