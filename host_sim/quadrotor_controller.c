/* Position, velocity, attitude and rate loops, and the mixer. Gains are those of the Crazyflie's firmware
 * (platform_defaults_cf2.h) in radians and shares of full thrust; those that depend on the vehicle's size are
 * among its parameters. */
#include "quadrotor_controller.h"

#include <math.h>
#include <string.h>

#include "angle.h"

enum { EVERY = 5 }; /* ticks of a step of position and velocity loops: 100 Hz */

typedef struct pid {
	double p, i, d;
	double most_sum, most; /* of the integral of the error, and of the output */
} pid;

static const pid position_loop = {.p = 2, .most = 1.1};                        /* m/s */
static const pid height_loop = {.p = 2, .i = 0.5, .most_sum = 5, .most = 1.1}; /* m/s */
static const pid velocity_loop = {
    .p = 0.436, .i = 0.0175, .most_sum = 5, .most = 0.349}; /* rad: 25, 1, 20 degrees */
static const pid climb_loop = {
    .p = 0.62, .i = 0.373, .most_sum = 5, .most = 0.82};                       /* of the weight: 25, 15 */
static const pid tilt_loop = {.p = 6, .i = 3, .most_sum = 0.349, .most = 1e9}; /* rad/s */
static const pid yaw_loop = {.p = 6, .i = 1, .d = 0.35, .most_sum = 6.28, .most = 1e9};  /* rad/s */
static const pid tilt_rate = {.p = 1, .i = 2, .d = 0.01, .most_sum = 0.58, .most = 1e9}; /* of rate_gain */
static const pid yaw_rate = {.p = 1, .i = 0.139, .most_sum = 2.91, .most = 1e9}; /* of yaw_rate_gain */
static const double BASE = 0.9, LEAST = 0.5; /* of the weight: before the climb loop, and at least */
static const double CUTOFF = 30;             /* Hz, of the low-pass of derivatives */

static double limited(double value, double most) {
	return fmax(-most, fmin(most, value));
}

/* `off` is asked less measured; the derivative is that of `measured`, so that a step of what is asked is
 * none. */
static double pid_step(const pid *loop, pid_memory *m, double off, double measured, double dt) {
	const double kept = exp(-2 * 3.141592653589793 * CUTOFF * dt);
	m->sum = limited(m->sum + off * dt, loop->most_sum);
	m->slope = kept * m->slope + (1 - kept) * (measured - m->last) / dt;
	m->last = measured;
	return limited(loop->p * off + loop->i * m->sum - loop->d * m->slope, loop->most);
}

void quadrotor_control_start(const quadrotor *vehicle, int hovers, quadrotor_controller *c) {
	memset(c, 0, sizeof *c);
	c->collective = quadrotor_hover_request(vehicle);
	if (hovers) { c->velocity[2].sum = (1 - BASE) / climb_loop.i; }
}

/* Tilt and thrust that bring the vehicle to the aim. */
static void steer(const quadrotor *vehicle, quadrotor_controller *c, const quadrotor_aim *aim,
                  const double *x) {
	const double dt = EVERY * QUADROTOR_TICK, co = cos(x[11]), si = sin(x[11]);
	const double dx = aim->position[0] - x[0], dy = aim->position[1] - x[1];
	const double off[3] = {co * dx + si * dy, -si * dx + co * dy, aim->position[2] - x[2]};
	const double moving[3] = {co * x[3] + si * x[4], -si * x[3] + co * x[4], x[5]};
	double wanted[3], out[3];
	for (size_t i = 0; i < 3; i++) {
		wanted[i] = pid_step(i < 2 ? &position_loop : &height_loop, &c->position[i], off[i], 0, dt);
		out[i] =
		    pid_step(i < 2 ? &velocity_loop : &climb_loop, &c->velocity[i], wanted[i] - moving[i], 0, dt);
	}
	c->asked[0] = -out[1];
	c->asked[1] = out[0];
	c->asked[2] = aim->yaw;
	c->collective = quadrotor_hover_request(vehicle) * fmax(LEAST, BASE + out[2]);
}

/* Requests that give this collective and this angular acceleration (rad/s^2). Thrust gives way to turning. */
static void mix(const quadrotor *vehicle, double collective, const double *turning, double *asked) {
	const double inertia[3] = {vehicle->inertia_x, vehicle->inertia_y, vehicle->inertia_z};
	const double full = ROTORS * vehicle->thrust_full;
	double most = 1;
	for (size_t i = 0; i < ROTORS; i++) {
		double place[2];
		quadrotor_place(vehicle, i, place);
		asked[i] = collective + (inertia[0] * turning[0] / place[1] - inertia[1] * turning[1] / place[0] +
		                         quadrotor_turn(i) * inertia[2] * turning[2] / vehicle->torque_per_thrust) /
		                            full;
		most = fmax(most, asked[i]);
	}
	for (size_t i = 0; i < ROTORS; i++) { asked[i] = fmax(0, asked[i] - (most - 1)); }
}

void quadrotor_control(const quadrotor *vehicle, quadrotor_controller *c, const quadrotor_aim *aim,
                       const double *x, double *asked) {
	const double gains[3] = {vehicle->rate_gain, vehicle->rate_gain, vehicle->yaw_rate_gain};
	double turning[3];
	if (c->ticks++ % EVERY == 0) { steer(vehicle, c, aim, x); }
	for (size_t i = 0; i < 3; i++) {
		const double rate = pid_step(i < 2 ? &tilt_loop : &yaw_loop, &c->angle[i],
		                             wrapped(c->asked[i] - x[9 + i]), x[9 + i], QUADROTOR_TICK);
		turning[i] = gains[i] * pid_step(i < 2 ? &tilt_rate : &yaw_rate, &c->rate[i], rate - x[12 + i],
		                                 x[12 + i], QUADROTOR_TICK);
	}
	mix(vehicle, c->collective, turning, asked);
}
