/* A flight: the vehicle in turbulent air, its state estimate, controller and battery, and what it is to fly.
 */
#include <math.h>
#include <string.h>

#include "angle.h"
#include "message.h"
#include "quadrotor_controller.h"
#include "random.h"

static const double DT = QUADROTOR_TICK;
enum { EVERY = 5 }; /* ticks of a row of the log */

enum { HOVER, LEGS, MIXED, MANOEUVRES };
static const char *const names[MANOEUVRES] = {"hover", "legs", "mixed"};
static const double HEIGHT = 0.5; /* m, of hover and legs */

/* ---- Chance ------------------------------------------------------------------------ */

/* Standard deviations, chosen so that roll, requests and place vary as much as on the labelled flights of
 * Crazyflies. */
static const double TURBULENCE[6] = {0.05, 0.05, 0.05, 2.5, 2.5, 0.6}; /* m/s^2, rad/s^2 */
/* White noise of the estimate: m, m/s, m/s^2, rad, rad/s. The accelerometer's and the gyro's is vibration. */
static const double NOISE[5] = {0.0004, 0.0015, 0.07, 0.0004, 0.02};
static const double LEVEL = 0.004; /* rad: of flights, how far the estimate's roll and pitch are off */
static const double TRIM = 0.006;  /* of flights, by which each rotor's thrust differs */
static const double ACCELEROMETER_BIAS = 0.03, GYRO_BIAS = 0.003; /* m/s^2, rad/s, of flights */

/* Battery, in shares of the vehicle's voltage: at take-off without load (mean and standard deviation of
 * flights), what full thrust takes off, and what flying takes off for good (1/s at full thrust). As on the
 * labelled flights. */
static const double OPEN = 1.09, OPEN_SPREAD = 0.03, SAG = 0.13, DISCHARGE = 0.0012, VOLT_NOISE = 0.0012;

static void blow(double *turbulence, uint64_t *random, double noise) {
	const double kept = exp(-DT / QUADROTOR_GUSTS), fresh = sqrt(1 - kept * kept);
	for (size_t i = 0; i < 6; i++) {
		turbulence[i] = kept * turbulence[i] + fresh * noise * TURBULENCE[i] * random_normal(random);
	}
}

/* ---- Manoeuvre ---------------------------------------------------------------------- */

typedef struct plan {
	int manoeuvre;
	uint64_t random;
	double next; /* s, when a mixed flight goes on */
	double yaw;  /* rad, asked for in the end */
	quadrotor_aim aim;
	int flies;
} plan;

static double between(uint64_t *random, double low, double high) {
	return low + (high - low) * random_uniform(random);
}

static double either(uint64_t *random) {
	return random_uniform(random) < 0.5 ? -1 : 1;
}

/* Share of the way, without a jerk at its ends. */
static double smooth(double share) {
	const double s = fmax(0, fmin(1, share));
	return s * s * s * (10 + s * (-15 + 6 * s));
}

/* There and back: take off, fly 2 m in 6.7 s, land, wait. The times (s) are those of the labelled flights. */
static const double GROUND = 3, RISE = 2, GO = 2.0 / 0.3, HOLD = 0.3, SINK = 1.2, WAIT = 3, WAY = 2;

static void legs(plan *p, double t) {
	const double leg = RISE + GO + HOLD + SINK + WAIT, since = fmax(t - GROUND, 0);
	const double n = fmin(floor(since / leg), 1), s = since - n * leg; /* after two legs it stays */
	const double gone = smooth((s - RISE) / GO), sunk = smooth((s - RISE - GO - HOLD) / SINK);
	p->aim.position[0] = WAY * (n > 0 ? 1 - gone : gone);
	p->aim.position[2] = HEIGHT * (smooth(s / RISE) - 1.1 * sunk);
	p->flies = t >= GROUND && s < leg - WAIT;
}

/* The next step of place, heading or height. */
static void step_on(plan *p, double t) {
	const double kind = random_uniform(&p->random);
	if (kind < 0.5) {
		double *place = &p->aim.position[random_uniform(&p->random) < 0.5 ? 0 : 1];
		*place = fabs(*place) > 0.6 ? 0 : *place + either(&p->random) * between(&p->random, 0.3, 0.8);
	} else if (kind < 0.75) {
		p->yaw += either(&p->random) * between(&p->random, 0.3, 1.2);
	} else {
		p->aim.position[2] = between(&p->random, 0.4, 1.6);
	}
	p->next = t + between(&p->random, 1.0, 2.2);
}

static void mixed(plan *p, double t) {
	if (t >= p->next) { step_on(p, t); }
	p->aim.yaw += fmax(-2.0 * DT, fmin(2.0 * DT, p->yaw - p->aim.yaw)); /* rad/s */
}

static void proceed(plan *p, double t) {
	p->flies = 1;
	if (p->manoeuvre == LEGS) { legs(p, t); }
	if (p->manoeuvre == MIXED) { mixed(p, t); }
}

/* ---- Flight --------------------------------------------------------------------------- */

typedef struct flight {
	quadrotor vehicle;
	effect_chain effects;
	double noise;
	uint64_t random;
	double state[TK_QUADROTOR_STATES], turbulence[6];
	double trim[ROTORS], level[2], bias[6]; /* of this flight */
	double open, vbat;                      /* V, without and under load */
	double x[TK_QUADROTOR_SENSED];          /* as estimated */
	double asked[ROTORS];
	int flies;
	plan plan;
	quadrotor_controller controller;
} flight;

static int on_ground(const flight *f) {
	return f->plan.manoeuvre == LEGS && f->state[QUAD_POSITION + 2] <= 0 && f->state[QUAD_VELOCITY + 2] <= 0;
}

static void estimate(flight *f, const quadrotor_signal *signal) {
	quadrotor_sense(&f->vehicle, signal, f->state, f->x);
	if (on_ground(f)) { memset(f->x + 6, 0, 3 * sizeof *f->x); }
	for (size_t i = 0; i < TK_QUADROTOR_SENSED; i++) {
		const int shaken = i / 3 == 2 || i / 3 == 4;
		f->x[i] += f->noise * (shaken ? signal->vibration : 1) * NOISE[i / 3] * random_normal(&f->random);
	}
	for (size_t i = 0; i < 3; i++) {
		f->x[6 + i] += f->bias[i];
		f->x[12 + i] += f->bias[3 + i];
	}
	for (size_t i = 0; i < 2; i++) { f->x[9 + i] += f->level[i]; }
	for (size_t i = 9; i < 12; i++) { f->x[i] = wrapped(f->x[i]); }
}

static void request(flight *f, double t) {
	proceed(&f->plan, t);
	if (f->plan.flies && !f->flies) { quadrotor_control_start(&f->vehicle, 0, &f->controller); }
	f->flies = f->plan.flies;
	memset(f->asked, 0, sizeof f->asked);
	if (f->flies) { quadrotor_control(&f->vehicle, &f->controller, &f->plan.aim, f->x, f->asked); }
}

static void discharge(flight *f) {
	double mean = 0;
	for (size_t i = 0; i < ROTORS; i++) { mean += f->asked[i] / ROTORS; }
	f->open -= DISCHARGE * mean * f->vehicle.voltage * DT;
	f->vbat = f->open - SAG * mean * f->vehicle.voltage;
}

/* The ground carries what does not rise, level and at rest. */
static void touch_down(flight *f) {
	double *s = f->state, angles[3];
	if (!on_ground(f)) { return; }
	quaternion_to_angles(s + QUAD_ATTITUDE, angles);
	quaternion_from_angles(0, 0, angles[2], s + QUAD_ATTITUDE);
	s[QUAD_POSITION + 2] = 0;
	memset(s + QUAD_VELOCITY, 0, 3 * sizeof *s);
	memset(s + QUAD_SPIN, 0, 3 * sizeof *s);
	memset(s + QUAD_SWING, 0, 4 * sizeof *s);
}

static void take_off(flight *f, const tk_flight *settings, int manoeuvre) {
	f->noise = settings->noise;
	f->random = random_mix(settings->seed);
	f->plan = (plan){.manoeuvre = manoeuvre, .random = random_mix(~settings->seed)};
	f->plan.next = between(&f->plan.random, 1, 2);
	quadrotor_hover(&f->vehicle, f->state);
	quadrotor_control_start(&f->vehicle, 1, &f->controller);
	f->flies = manoeuvre != LEGS;
	f->state[QUAD_POSITION + 2] = f->plan.aim.position[2] = f->flies ? HEIGHT : 0;
	if (!f->flies) { memset(f->state + QUAD_ROTOR, 0, ROTORS * sizeof *f->state); }
	for (size_t i = 0; i < ROTORS; i++) { f->trim[i] = 1 + f->noise * TRIM * random_normal(&f->random); }
	for (size_t i = 0; i < 2; i++) { f->level[i] = f->noise * LEVEL * random_normal(&f->random); }
	for (size_t i = 0; i < 6; i++) {
		f->bias[i] = f->noise * (i < 3 ? ACCELEROMETER_BIAS : GYRO_BIAS) * random_normal(&f->random);
		f->turbulence[i] = f->noise * TURBULENCE[i] * random_normal(&f->random);
	}
	f->open = f->vehicle.voltage * (OPEN + f->noise * OPEN_SPREAD * random_normal(&f->random));
	f->vbat = f->open - (f->flies ? SAG * f->vehicle.voltage * quadrotor_hover_request(&f->vehicle) : 0);
}

static void write_row(flight *f, size_t k, double *x, double *u, double *states) {
	const double noise = f->noise * VOLT_NOISE * f->vehicle.voltage * random_normal(&f->random);
	if (states) { memcpy(states + k * TK_QUADROTOR_STATES, f->state, sizeof f->state); }
	if (x) { memcpy(x + k * TK_QUADROTOR_SENSED, f->x, sizeof f->x); }
	if (u) {
		memcpy(u + k * TK_QUADROTOR_COMMANDS, f->asked, sizeof f->asked);
		u[k * TK_QUADROTOR_COMMANDS + ROTORS] = f->vbat + noise;
	}
}

static quadrotor_signal signal_now(const flight *f, size_t tick) {
	quadrotor_signal signal = quadrotor_signal_at(&f->effects, f->vbat, (double)tick * DT, DT);
	for (size_t i = 0; i < ROTORS; i++) { signal.thrust[i] *= f->trim[i]; }
	if (!on_ground(f)) { memcpy(signal.turbulence, f->turbulence, sizeof f->turbulence); }
	return signal;
}

static int fly(flight *f, size_t rows, double *x, double *u, double *states) {
	int status = TK_OK;
	for (size_t tick = 0; tick < rows * EVERY && status == TK_OK; tick++) {
		quadrotor_signal signal = signal_now(f, tick);
		estimate(f, &signal);
		request(f, (double)tick * DT);
		if (tick % EVERY == 0) { write_row(f, tick / EVERY, x, u, states); }
		memcpy(signal.asked, f->asked, sizeof f->asked);
		quadrotor_command(&f->effects, &signal);
		quadrotor_step(&f->vehicle, &signal, DT, f->state);
		touch_down(f);
		discharge(f);
		blow(f->turbulence, &f->random, f->noise);
		status = quadrotor_check(f->state, (double)(tick + 1) * DT);
	}
	return status;
}

static int manoeuvre_by_name(const char *name) {
	for (int i = 0; i < MANOEUVRES; i++) {
		if (name && strcmp(name, names[i]) == 0) { return i; }
	}
	return fail("there is no manoeuvre named '%s': use hover, legs or mixed", name ? name : "");
}

int tk_quadrotor_fly(const tk_active *effects, size_t n_effects, const double *vehicle,
                     const tk_flight *settings, size_t rows, double *x, double *u, double *states) {
	if (!settings || (n_effects && !effects)) { return fail("flight and effects must be given"); }
	if (!(settings->noise >= 0 && settings->noise <= 10)) {
		return fail("noise is %g, it must be between 0 and 10", settings->noise);
	}
	const int manoeuvre = manoeuvre_by_name(settings->manoeuvre);
	flight f = {0};
	quadrotor_store store;
	tk_effects table;
	if (manoeuvre == TK_ERROR || quadrotor_from(vehicle, &f.vehicle) != TK_OK) { return TK_ERROR; }
	quadrotor_effects_for(&f.vehicle, &store, &table);
	const double end = (double)(rows * EVERY) * DT;
	if (effects_open(&f.effects, &table, effects, n_effects, DT, end) != TK_OK) { return TK_ERROR; }
	take_off(&f, settings, manoeuvre);
	const int status = fly(&f, rows, x, u, states);
	effects_free(&f.effects);
	return status;
}
