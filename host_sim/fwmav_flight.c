/* A flight: the vehicle in turbulent air, its IMU, attitude estimate and controller, and the
 * manoeuvre that is flown. What the flight controller sees goes into the log. */
#include <math.h>
#include <string.h>

#include "fwmav_controller.h"
#include "message.h"
#include "random.h"

/* The controller's rate, s, and every how many of its steps the log takes a sample: as it is, not
 * averaged, so that what shakes faster than 50 Hz folds down. */
static const double DT = 0.002;
enum { EVERY = 5 };

enum { HOVER, PITCH, YAW, MANOEUVRES };
static const char *const names[MANOEUVRES] = {"hover", "pitch", "yaw"};

/* ---- Chance ------------------------------------------------------------------ */

/* Of the air and the irregular beat: standard deviations and how long they last. Chosen so that a
 * hovering vehicle sways by one or two degrees. */
static const double TURBULENCE[7] = {0.3, 0.3, 0.3, 4, 4, 4, 0.25}; /* m/s^2, rad/s^2, Hz */
/* Of gears and frame, which rattle faster than the log can tell: what they add to gyro and
 * accelerometer. It turns the body nowhere, so it is a difference. Sizes as in logs of the 103-g vehicle. */
static const double RATTLE[6] = {1.0, 0.4, 3.5, 3.2, 8.0, 7.0}; /* rad/s, m/s^2 */
/* Of the IMU: white noise of a BMI088 over 250 Hz, and what is left of its bias after calibration. */
static const double GYRO_NOISE = 0.004, ACCELEROMETER_NOISE = 0.03; /* rad/s, m/s^2 */
static const double GYRO_BIAS = 0.005, ACCELEROMETER_BIAS = 0.1;    /* chosen */

/* First-order Gauss-Markov processes. */
static void blow(double *turbulence, uint64_t *random, double noise) {
	const double kept = exp(-DT / FWMAV_GUSTS), fresh = sqrt(1 - kept * kept);
	for (size_t i = 0; i < 7; i++) {
		turbulence[i] = kept * turbulence[i] + fresh * noise * TURBULENCE[i] * random_normal(random);
	}
}

/* ---- Manoeuvre -------------------------------------------------------------------- */

typedef struct aim {
	double pitch, yaw, height, climb; /* rad, rad, m, m/s */
} aim;

typedef struct schedule {
	int manoeuvre, tipped;
	uint64_t random;
	double next;    /* s, when it changes */
	aim asked, now; /* now follows at a limited rate */
} schedule;

static double between(uint64_t *random, double low, double high) {
	return low + (high - low) * random_uniform(random);
}

static double either(uint64_t *random) {
	return random_uniform(random) < 0.5 ? -1 : 1;
}

/* The next part of the manoeuvre. */
static void change(schedule *s, double t) {
	if (s->manoeuvre == PITCH) {
		s->tipped = !s->tipped;
		s->asked.pitch = s->tipped ? either(&s->random) * between(&s->random, 0.08, 0.28) : 0;
		s->asked.climb = 0.25;
	} else if (s->manoeuvre == YAW) {
		s->asked.yaw = either(&s->random) * between(&s->random, 0.1, 0.5);
	}
	s->next = t + between(&s->random, 0.8, 2.0);
}

static double towards(double now, double asked, double step) {
	return now + fmax(-step, fmin(step, asked - now));
}

static const aim *proceed(schedule *s, double t) {
	if (t >= s->next) { change(s, t); }
	s->now.pitch = towards(s->now.pitch, s->asked.pitch, 1.5 * DT); /* rad/s */
	s->now.yaw = towards(s->now.yaw, s->asked.yaw, 1.5 * DT);
	s->now.climb = towards(s->now.climb, s->asked.climb, 0.5 * DT); /* m/s^2 */
	s->now.height += s->now.climb * DT;
	return &s->now;
}

/* ---- Height ---------------------------------------------------------------------------- */

/* Height hold: asks for a share more or less than the weight. It knows height and climb as they
 * are; the log has neither. */
static double throttle(const aim *target, const double *state) {
	const double share =
	    1 + 0.4 * (target->height - state[POSITION + 2]) + 0.3 * (target->climb - state[VELOCITY + 2]);
	return fwmav_hover_beat() * sqrt(fmax(0.6, fmin(1.4, share)));
}

/* ---- Flight ---------------------------------------------------------------------------- */

typedef struct flight {
	effect_chain effects;
	double noise;
	uint64_t random;
	double state[TK_FWMAV_STATES], turbulence[7];
	double bias[6], rattle[6]; /* of the IMU */
	double imu[6];             /* gyro (rad/s), accelerometer (m/s^2) as measured */
	estimate estimate;
	schedule schedule;
	loop loops[SERVOS];
} flight;

static void sense(flight *f, const fwmav_signal *signal) {
	double derivative[TK_FWMAV_STATES], felt[3];
	fwmav_derivative(signal, f->state, derivative, felt);
	for (size_t i = 0; i < 6; i++) {
		const double rattle = f->noise * sqrt(0.5) * RATTLE[i] * random_normal(&f->random);
		f->imu[i] = (i < 3 ? f->state[SPIN + i] + signal->gyro[i] : felt[i - 3]) + f->bias[i] +
		            signal->vibration * (rattle - f->rattle[i]) +
		            f->noise * (i < 3 ? GYRO_NOISE : ACCELEROMETER_NOISE) * random_normal(&f->random);
		f->rattle[i] = rattle;
	}
	const double *a = f->imu + 3, norm = fmax(sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]), 1e-9);
	const double felt_up[3] = {a[0] / norm, a[1] / norm, a[2] / norm};
	estimate_step(&f->estimate, f->imu, felt_up, DT);
	estimate_angles(&f->estimate);
}

static void steer(flight *f, fwmav_signal *signal) {
	const estimate *e = &f->estimate;
	const aim *target = proceed(&f->schedule, signal->common.t);
	signal->servo[DIHEDRAL] = loop_step(&f->loops[DIHEDRAL], target->pitch, e->pitch, e->rate[1], DT);
	signal->servo[TWIST] = loop_step(&f->loops[TWIST], target->yaw, e->yaw, e->rate[2], DT);
	signal->servo[SHARE] = loop_step(&f->loops[SHARE], 0, e->roll, e->rate[0], DT);
	signal->beat = throttle(target, f->state);
}

static void write_row(const flight *f, double *x) {
	const estimate *e = &f->estimate;
	memcpy(x, f->imu, sizeof f->imu);
	x[6] = e->pitch;
	x[7] = e->roll;
	x[8] = e->yaw;
	x[9] = e->yaw_rate;
}

static void take_off(flight *f, const tk_flight *settings, int manoeuvre) {
	f->noise = settings->noise;
	f->random = random_mix(settings->seed);
	f->schedule = (schedule){.manoeuvre = manoeuvre, .random = random_mix(~settings->seed)};
	f->schedule.next = between(&f->schedule.random, 1, 2);
	loops_start(f->loops);
	f->estimate.q[0] = 1;
	fwmav_hover(f->state);
	f->state[PHASE] = f->noise > 0 ? FWMAV_TURN * random_uniform(&f->random) : 0;
	fwmav_sway(fwmav_signal_at(&f->effects, 0, DT).vibration, f->state);
	for (size_t i = 0; i < 6; i++) {
		f->bias[i] = f->noise * (i < 3 ? GYRO_BIAS : ACCELEROMETER_BIAS) * random_normal(&f->random);
	}
	for (size_t i = 0; i < 7; i++) {
		f->turbulence[i] = f->noise * TURBULENCE[i] * random_normal(&f->random);
	}
}

static int fly(flight *f, int axis, size_t rows, double *x, double *u, double *states) {
	int status = TK_OK;
	for (size_t tick = 0; tick < rows * EVERY && status == TK_OK; tick++) {
		fwmav_signal signal = fwmav_signal_at(&f->effects, (double)tick * DT, DT);
		memcpy(signal.turbulence, f->turbulence, sizeof f->turbulence);
		sense(f, &signal);
		steer(f, &signal);
		if (tick % EVERY == 0) {
			const size_t k = tick / EVERY;
			if (states) { memcpy(states + k * TK_FWMAV_STATES, f->state, sizeof f->state); }
			if (x) { write_row(f, x + 10 * k); }
			if (u) { u[k] = signal.servo[axis]; }
		}
		fwmav_command(&f->effects, axis, &signal);
		fwmav_step(&signal, f->state);
		blow(f->turbulence, &f->random, f->noise);
		status = fwmav_check(f->state, (double)(tick + 1) * DT);
	}
	return status;
}

static int manoeuvre_by_name(const char *name) {
	for (int i = 0; i < MANOEUVRES; i++) {
		if (name && strcmp(name, names[i]) == 0) { return i; }
	}
	return fail("there is no manoeuvre named '%s': use hover, pitch or yaw", name ? name : "");
}

int tk_fwmav_fly(const tk_active *effects, size_t n_effects, const tk_flight *settings, size_t rows,
                 double *x, double *u, double *states) {
	if (!settings || (n_effects && !effects)) { return fail("flight and effects must be given"); }
	if (!(settings->noise >= 0 && settings->noise <= 10)) {
		return fail("noise is %g, it must be between 0 and 10", settings->noise);
	}
	const int manoeuvre = manoeuvre_by_name(settings->manoeuvre);
	if (manoeuvre == TK_ERROR) { return TK_ERROR; }
	const double end = (double)(rows * EVERY) * DT;
	flight f = {0};
	if (effects_open(&f.effects, &fwmav_effects, effects, n_effects, DT, end) != TK_OK) { return TK_ERROR; }
	take_off(&f, settings, manoeuvre);
	const int status = fly(&f, manoeuvre == YAW ? TWIST : DIHEDRAL, rows, x, u, states);
	effects_free(&f.effects);
	return status;
}
