/* An observer of the flapping-wing vehicle: the simulated vehicle, held to a logged flight by a
 * constant gain. What it misses from row to row is white as long as the vehicle is the simulated one. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "angle.h"
#include "fwmav_controller.h"
#include "message.h"

static const double TICK = 0.002;    /* s, at most: the flight controller's */
static const double MOST_LIFT = 1.4; /* weights that the height hold asks for at most */
static const double CLIMBING = 2.0;  /* s: how long it asks for more or less than the weight */

enum { VELOCITIES = 0, TILT = 3, SPINS = 6, AIR = 9, LIFT = 15 };

/* What the observer takes the vehicle to be in. */
typedef struct observed {
	double state[TK_FWMAV_STATES], air[6];
	double lift; /* weights, above one */
	estimate estimate;
} observed;

typedef struct follower {
	const tk_flown *log;
	effect_chain effects;
	size_t ticks;            /* of a row */
	double dt;               /* s, of one */
	double felt;             /* m/s^2: norm of the accelerometer, as the attitude estimate divides by it */
	double (*asked)[SERVOS]; /* of every tick, after delays and lags */
	observed now;
} follower;

static int usable(const tk_flown *log, size_t k) {
	return !log->usable || log->usable[k];
}

/* ---- Commands --------------------------------------------------------------------- */

/* What the height hold, which the log does not show, asks of the motor: this lift (weights), where the
 * battery lets it. */
static double beat_held(const fwmav_signal *signal, double lift) {
	return fwmav_hover_beat() * fmin(sqrt(MOST_LIFT), sqrt(fmax(lift, 0)) / signal->voltage);
}

/* Attitude (roll, pitch, yaw) of row k. */
static void attitude(const tk_flown *log, size_t k, double *angles) {
	const double *x = log->x + 10 * k;
	angles[0] = x[7];
	angles[1] = x[6];
	angles[2] = x[8];
}

/* What the servos are asked within the transition k -> k + 1: u runs straight from row to row. */
static void ask(follower *f, loop *loops, size_t k, const double *target) {
	static const int about[SERVOS] = {[DIHEDRAL] = 1, [TWIST] = 2, [SHARE] = 0};
	const tk_flown *log = f->log;
	const int axis = log->yaw ? TWIST : DIHEDRAL;
	double here[3], there[3], turn[3];
	attitude(log, k, here);
	attitude(log, k + 1, there);
	for (int a = 0; a < 3; a++) { turn[a] = wrapped(there[a] - here[a]); }
	for (size_t j = 0; j < f->ticks; j++) {
		const double share = (double)j / (double)f->ticks;
		const size_t tick = k * f->ticks + j;
		fwmav_signal signal = fwmav_signal_at(&f->effects, (double)tick * f->dt, f->dt);
		for (int i = 0; i < SERVOS; i++) {
			const int a = about[i];
			signal.servo[i] = i == axis ? (1 - share) * log->u[k] + share * log->u[k + 1]
			                            : loop_step(&loops[i], target[a], here[a] + share * turn[a],
			                                        turn[a] / log->dt, f->dt);
		}
		fwmav_command(&f->effects, axis, &signal);
		memcpy(f->asked[tick], signal.servo, sizeof signal.servo);
	}
}

/* The loops of the other servos hold the vehicle level, in its heading. */
static void ask_all(follower *f) {
	const double target[3] = {0, 0, f->log->heading};
	loop loops[SERVOS];
	for (size_t k = 0; k + 1 < f->log->rows; k++) {
		if (usable(f->log, k)) {
			if (k == 0 || !usable(f->log, k - 1)) { loops_start(loops); }
			ask(f, loops, k, target);
		} else {
			memset(f->asked[k * f->ticks], 0, f->ticks * sizeof *f->asked);
		}
	}
}

/* ---- Prediction and correction ------------------------------------------------------- */

static void begin(follower *f, size_t k) {
	double angles[3];
	memset(&f->now, 0, sizeof f->now);
	fwmav_hover(f->now.state);
	attitude(f->log, k, angles);
	estimate_set(&f->now.estimate, angles[1], angles[0], angles[2]);
	memcpy(f->now.state + ATTITUDE, f->now.estimate.q, sizeof f->now.estimate.q);
	for (size_t i = 0; i < SERVOS; i++) { f->now.state[SERVO + 2 * i] = f->asked[k * f->ticks][i]; }
}

static fwmav_signal signal_in(const follower *f, size_t tick, const observed *o) {
	fwmav_signal signal = fwmav_signal_at(&f->effects, (double)tick * f->dt, f->dt);
	const double *push = f->log->push ? f->log->push + 6 * (tick / f->ticks) : NULL;
	signal.vibration = 0; /* the phase of the wing beat is unknown */
	signal.beat = beat_held(&signal, 1 + o->lift);
	memcpy(signal.servo, f->asked[tick], sizeof signal.servo);
	for (size_t i = 0; i < 6; i++) { signal.turbulence[i] = o->air[i] + (push ? push[i] : 0); }
	return signal;
}

/* What the IMU reads, gyro and accelerometer, and the derivative of the state. */
static void read_imu(const fwmav_signal *signal, const observed *o, double *imu, double *derivative) {
	fwmav_derivative(signal, o->state, derivative, imu + 3);
	for (size_t i = 0; i < 3; i++) { imu[i] = o->state[SPIN + i] + signal->gyro[i]; }
}

/* A tick on by the midpoint rule: without the shaking the vehicle is slow beside a tick, and Runge-Kutta
 * steps change what is missed by less than 0.004 of its standard deviation. derivative: at the tick's
 * beginning. */
static void step(const fwmav_signal *signal, const double *derivative, double *state) {
	double middle[TK_FWMAV_STATES], slope[TK_FWMAV_STATES], felt[3];
	const double dt = signal->common.dt;
	for (size_t i = 0; i < TK_FWMAV_STATES; i++) { middle[i] = state[i] + 0.5 * dt * derivative[i]; }
	fwmav_derivative(signal, middle, slope, felt);
	for (size_t i = 0; i < TK_FWMAV_STATES; i++) { state[i] += dt * slope[i]; }
	quaternion_normalise(state + ATTITUDE);
}

/* From row k to row k + 1; sensed: what is predicted there. */
static void advance(const follower *f, size_t k, observed *o, double *sensed) {
	const double kept = exp(-f->dt / FWMAV_GUSTS), held = exp(-f->dt / CLIMBING);
	double imu[6], up[3], derivative[TK_FWMAV_STATES];
	fwmav_signal signal = signal_in(f, k * f->ticks, o);
	read_imu(&signal, o, imu, derivative);
	for (size_t tick = k * f->ticks; tick < (k + 1) * f->ticks; tick++) {
		step(&signal, derivative, o->state);
		for (size_t i = 0; i < 6; i++) { o->air[i] *= kept; }
		o->lift *= held;
		signal = signal_in(f, tick + 1, o);
		read_imu(&signal, o, imu, derivative);
		for (size_t i = 0; i < 3; i++) { up[i] = imu[3 + i] / f->felt; }
		estimate_step(&o->estimate, imu, up, f->dt);
	}
	estimate_angles(&o->estimate);
	memcpy(sensed, imu, sizeof imu);
	sensed[6] = o->estimate.roll;
	sensed[7] = o->estimate.pitch;
	sensed[8] = o->estimate.yaw;
}

static void correct(follower *f, size_t k, const double *predicted) {
	const double *x = f->log->x + 10 * k;
	double missed[TK_FWMAV_SENSED], change[TK_FWMAV_CORRECTED] = {0}, angles[3], R[3][3], turn[4];
	attitude(f->log, k, angles);
	for (size_t i = 0; i < 6; i++) { missed[i] = x[i] - predicted[i]; }
	for (size_t i = 6; i < 9; i++) { missed[i] = wrapped(angles[i - 6] - predicted[i]); }
	for (size_t i = 0; i < TK_FWMAV_CORRECTED; i++) {
		for (size_t j = 0; j < TK_FWMAV_SENSED; j++) {
			change[i] += f->log->gain[i * TK_FWMAV_SENSED + j] * missed[j];
		}
	}
	double *state = f->now.state;
	quaternion_to_matrix(state + ATTITUDE, R);
	for (size_t i = 0; i < 3; i++) {
		for (size_t j = 0; j < 3; j++) { state[VELOCITY + i] += R[i][j] * change[VELOCITIES + j]; }
		state[SPIN + i] += change[SPINS + i];
	}
	quaternion_derivative(state + ATTITUDE, change + TILT, turn);
	for (size_t i = 0; i < 4; i++) { state[ATTITUDE + i] += turn[i]; }
	quaternion_normalise(state + ATTITUDE);
	for (size_t i = 0; i < 6; i++) { f->now.air[i] += change[AIR + i]; }
	f->now.lift += change[LIFT];
	estimate_set(&f->now.estimate, angles[1], angles[0], angles[2]);
}

/* ---- Running on by itself -------------------------------------------------------------- */

static void fill(double *values, size_t n) {
	for (size_t i = 0; i < n; i++) { values[i] = NAN; }
}

static void run_on(const follower *f, size_t start, size_t n_steps, const int64_t *steps, double *ahead) {
	observed o = f->now;
	double sensed[TK_FWMAV_SENSED];
	size_t next = 0;
	fill(ahead, n_steps * TK_FWMAV_SENSED);
	for (size_t k = start; next < n_steps && k + 1 < f->log->rows && usable(f->log, k); k++) {
		advance(f, k, &o, sensed);
		while (next < n_steps && steps[next] <= (int64_t)(k + 1 - start)) {
			memcpy(ahead + TK_FWMAV_SENSED * next++, sensed, sizeof sensed);
		}
	}
}

static int follow(follower *f, double *predicted, size_t n_starts, const int64_t *starts, size_t n_steps,
                  const int64_t *steps, double *ahead) {
	size_t next = 0;
	ask_all(f);
	for (size_t k = 0; k < f->log->rows; k++) {
		double *sensed = predicted + k * TK_FWMAV_SENSED;
		if (k > 0 && usable(f->log, k - 1)) {
			advance(f, k - 1, &f->now, sensed);
			correct(f, k, sensed);
		} else {
			fill(sensed, TK_FWMAV_SENSED);
			begin(f, k);
		}
		if (fwmav_check(f->now.state, (double)k * f->log->dt) != TK_OK) { return TK_ERROR; }
		while (ahead && next < n_starts && starts[next] <= (int64_t)k) {
			run_on(f, k, n_steps, steps, ahead + next * n_steps * TK_FWMAV_SENSED);
			next++;
		}
	}
	return TK_OK;
}

/* ---- Interface --------------------------------------------------------------------------- */

static int check(const tk_flown *log, size_t n_starts, const int64_t *starts, size_t n_steps,
                 const int64_t *steps) {
	if (!log || !log->x || !log->u || !log->gain) { return fail("log, x, u and gain must be given"); }
	if (!(log->dt > 0 && log->dt <= 0.1)) {
		return fail("dt is %g s, it must be positive and at most 0.1 s", log->dt);
	}
	if (log->rows < 2) { return fail("a flight of %zu rows is too short", log->rows); }
	for (size_t i = 0; i < n_starts; i++) {
		if (starts[i] < (i ? starts[i - 1] : 0) || starts[i] >= (int64_t)log->rows) {
			return fail("starts must rise, within the log's rows");
		}
	}
	for (size_t i = 0; i < n_steps; i++) {
		if (steps[i] <= (i ? steps[i - 1] : 0)) { return fail("steps must rise, from 1"); }
	}
	return TK_OK;
}

/* 1 / mean(1 / |a|) over the log. */
static double norm_felt(const tk_flown *log) {
	double sum = 0, count = 0;
	for (size_t k = 0; k < log->rows; k++) {
		const double *a = log->x + 10 * k + 3;
		const double norm = sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
		if (norm > 1e-3) {
			sum += 1 / norm;
			count++;
		}
	}
	return sum > 0 ? count / sum : 9.81;
}

int tk_fwmav_follow(const tk_active *effects, size_t n_effects, const tk_flown *log, double *predicted,
                    size_t n_starts, const int64_t *starts, size_t n_steps, const int64_t *steps,
                    double *ahead) {
	if (!predicted || (n_effects && !effects) || (ahead && (!starts || !steps))) {
		return fail("effects, predicted, starts and steps must be given");
	}
	if (check(log, ahead ? n_starts : 0, starts, ahead ? n_steps : 0, steps) != TK_OK) { return TK_ERROR; }
	follower f = {.log = log, .ticks = (size_t)ceil(log->dt / TICK - 1e-9), .felt = norm_felt(log)};
	f.dt = log->dt / (double)f.ticks;
	const double end = (double)log->rows * log->dt;
	if (effects_open(&f.effects, &fwmav_effects, effects, n_effects, f.dt, end) != TK_OK) { return TK_ERROR; }
	f.asked = calloc(log->rows * f.ticks, sizeof *f.asked);
	const int status =
	    f.asked ? follow(&f, predicted, n_starts, starts, n_steps, steps, ahead) : fail("out of memory");
	free(f.asked);
	effects_free(&f.effects);
	return status;
}
