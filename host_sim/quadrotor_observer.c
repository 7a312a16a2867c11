/* An observer of the quadrotor: the simulated vehicle, held to a logged flight by a constant gain. What the
 * log lacks is estimated with the rest. What it misses from row to row is white as long as the vehicle is the
 * simulated one. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "angle.h"
#include "message.h"
#include "quadrotor.h"

static const double TICK = 0.01; /* s, at most */

/* What is corrected, in this order; position and velocity in axes that turn with the heading. */
enum { PLACES = 0, VELOCITIES = 3, TILT = 6, SPINS = 9, SHARES = 12, AIR = 16 };

/* What the observer takes the vehicle to be in. */
typedef struct observed {
	double state[TK_QUADROTOR_STATES], air[6];
} observed;

typedef struct follower {
	const tk_quadrotor_flown *log;
	quadrotor vehicle;
	effect_chain effects;
	size_t ticks;            /* of a row */
	double dt, kept;         /* s, of one; what is left of the turbulence after it */
	double (*asked)[ROTORS]; /* of every tick, after delays and lags */
	observed now;
} follower;

static int usable(const tk_quadrotor_flown *log, size_t k) {
	return !log->usable || log->usable[k];
}

static const double *row(const tk_quadrotor_flown *log, size_t k) {
	return log->x + TK_QUADROTOR_SENSED * k;
}

static double or_zero(double value) {
	return isnan(value) ? 0 : value;
}

/* ---- Prediction ------------------------------------------------------------------------- */

static void ask_all(follower *f) {
	for (size_t tick = 0; tick < f->log->rows * f->ticks; tick++) {
		quadrotor_signal signal = {.common = {.t = (double)tick * f->dt, .dt = f->dt}};
		memcpy(signal.asked, f->log->u + TK_QUADROTOR_COMMANDS * (tick / f->ticks), sizeof signal.asked);
		quadrotor_command(&f->effects, &signal);
		memcpy(f->asked[tick], signal.asked, sizeof signal.asked);
	}
}

static quadrotor_signal signal_in(const follower *f, size_t tick, const observed *o) {
	const size_t k = tick / f->ticks;
	const double vbat = f->log->u[TK_QUADROTOR_COMMANDS * k + ROTORS];
	const double *push = f->log->push ? f->log->push + 6 * k : NULL;
	quadrotor_signal signal = quadrotor_signal_at(&f->effects, vbat, (double)tick * f->dt, f->dt);
	memcpy(signal.asked, f->asked[tick], sizeof signal.asked);
	for (size_t i = 0; i < 6; i++) { signal.turbulence[i] = o->air[i] + (push ? push[i] : 0); }
	return signal;
}

/* From row k to row k + 1; sensed: what is predicted there. */
static void advance(const follower *f, size_t k, observed *o, double *sensed) {
	for (size_t tick = k * f->ticks; tick < (k + 1) * f->ticks; tick++) {
		const quadrotor_signal signal = signal_in(f, tick, o);
		quadrotor_step(&f->vehicle, &signal, f->dt, o->state);
		for (size_t i = 0; i < 6; i++) { o->air[i] *= f->kept; }
	}
	const quadrotor_signal there = signal_in(f, (k + 1) * f->ticks, o);
	quadrotor_sense(&f->vehicle, &there, o->state, sensed);
}

/* ---- Correction ---------------------------------------------------------------------------- */

/* Turns the horizontal part of a vector by an angle about the vertical. */
static void turn(double c, double s, double *v) {
	const double x = v[0];
	v[0] = c * x - s * v[1];
	v[1] = s * x + c * v[1];
}

static void missed_at(const double *x, const double *predicted, double c, double s, double *missed) {
	for (size_t i = 0; i < TK_QUADROTOR_SENSED; i++) { missed[i] = or_zero(x[i] - predicted[i]); }
	for (size_t i = 9; i < 12; i++) { missed[i] = wrapped(missed[i]); }
	for (size_t i = 0; i < 9; i += 3) { turn(c, -s, missed + i); }
}

static void tilt(const double *by, double *q) {
	double change[4];
	quaternion_derivative(q, by, change);
	for (size_t i = 0; i < 4; i++) { q[i] += change[i]; }
	quaternion_normalise(q);
}

static void correct(follower *f, size_t k, const double *predicted) {
	double missed[TK_QUADROTOR_SENSED], change[TK_QUADROTOR_CORRECTED] = {0}, *state = f->now.state;
	const double c = cos(predicted[11]), s = sin(predicted[11]);
	missed_at(row(f->log, k), predicted, c, s, missed);
	for (size_t i = 0; i < TK_QUADROTOR_CORRECTED; i++) {
		for (size_t j = 0; j < TK_QUADROTOR_SENSED; j++) {
			change[i] += f->log->gain[i * TK_QUADROTOR_SENSED + j] * missed[j];
		}
	}
	turn(c, s, change + PLACES);
	turn(c, s, change + VELOCITIES);
	for (size_t i = 0; i < 3; i++) {
		state[QUAD_POSITION + i] += change[PLACES + i];
		state[QUAD_VELOCITY + i] += change[VELOCITIES + i];
		state[QUAD_SPIN + i] += change[SPINS + i];
	}
	tilt(change + TILT, state + QUAD_ATTITUDE);
	for (size_t i = 0; i < ROTORS; i++) { state[QUAD_ROTOR + i] += change[SHARES + i]; }
	for (size_t i = 0; i < 6; i++) { f->now.air[i] += change[AIR + i]; }
}

/* As the row has it, and else level and at rest, in steady requests. */
static void begin(follower *f, size_t k) {
	const double *x = row(f->log, k);
	double *state = f->now.state;
	memset(&f->now, 0, sizeof f->now);
	for (size_t i = 0; i < 6; i++) { state[QUAD_POSITION + i] = or_zero(x[i]); }
	quaternion_from_angles(or_zero(x[9]), or_zero(x[10]), or_zero(x[11]), state + QUAD_ATTITUDE);
	for (size_t i = 0; i < 3; i++) { state[QUAD_SPIN + i] = or_zero(x[12 + i]); }
	memcpy(state + QUAD_ROTOR, f->asked[k * f->ticks], ROTORS * sizeof *state);
}

/* ---- Along the log ----------------------------------------------------------------------------- */

static void fill(double *values, size_t n) {
	for (size_t i = 0; i < n; i++) { values[i] = (double)NAN; }
}

static void run_on(const follower *f, size_t start, const tk_ahead *ahead, double *out) {
	observed o = f->now;
	double sensed[TK_QUADROTOR_SENSED];
	size_t next = 0;
	fill(out, ahead->n_steps * TK_QUADROTOR_SENSED);
	for (size_t k = start; next < ahead->n_steps && k + 1 < f->log->rows && usable(f->log, k); k++) {
		advance(f, k, &o, sensed);
		while (next < ahead->n_steps && ahead->steps[next] <= (int64_t)(k + 1 - start)) {
			memcpy(out + TK_QUADROTOR_SENSED * next++, sensed, sizeof sensed);
		}
	}
}

static int follow(follower *f, double *predicted, double *estimated, const tk_ahead *ahead) {
	size_t next = 0;
	ask_all(f);
	for (size_t k = 0; k < f->log->rows; k++) {
		double *sensed = predicted + k * TK_QUADROTOR_SENSED;
		if (k > 0 && usable(f->log, k - 1)) {
			advance(f, k - 1, &f->now, sensed);
			correct(f, k, sensed);
		} else {
			fill(sensed, TK_QUADROTOR_SENSED);
			begin(f, k);
		}
		if (quadrotor_check(f->now.state, (double)k * f->log->dt) != TK_OK) { return TK_ERROR; }
		if (estimated) { memcpy(estimated + k * TK_QUADROTOR_STATES, f->now.state, sizeof f->now.state); }
		while (ahead && next < ahead->n_starts && ahead->starts[next] <= (int64_t)k) {
			run_on(f, k, ahead, ahead->predicted + next++ * ahead->n_steps * TK_QUADROTOR_SENSED);
		}
	}
	return TK_OK;
}

/* ---- Interface ----------------------------------------------------------------------------------- */

static int check_ahead(const tk_ahead *a, size_t rows) {
	if (!a->starts || !a->steps || !a->predicted) {
		return fail("starts, steps and predicted must be given");
	}
	for (size_t i = 0; i < a->n_starts; i++) {
		if (a->starts[i] < (i ? a->starts[i - 1] : 0) || a->starts[i] >= (int64_t)rows) {
			return fail("starts must rise, within the log's rows");
		}
	}
	for (size_t i = 0; i < a->n_steps; i++) {
		if (a->steps[i] <= (i ? a->steps[i - 1] : 0)) { return fail("steps must rise, from 1"); }
	}
	return TK_OK;
}

static int check(const tk_quadrotor_flown *log) {
	if (!log || !log->x || !log->u || !log->gain) { return fail("log, x, u and gain must be given"); }
	if (!(log->dt > 0 && log->dt <= 0.1)) {
		return fail("dt is %g s, it must be positive and at most 0.1 s", log->dt);
	}
	return log->rows < 2 ? fail("a flight of %zu rows is too short", log->rows) : TK_OK;
}

int tk_quadrotor_follow(const tk_active *effects, size_t n_effects, const tk_quadrotor_flown *log,
                        double *predicted, double *states, const tk_ahead *ahead) {
	if (!predicted || (n_effects && !effects)) { return fail("effects and predicted must be given"); }
	if (check(log) != TK_OK || (ahead && check_ahead(ahead, log->rows) != TK_OK)) { return TK_ERROR; }
	follower f = {.log = log, .ticks = (size_t)ceil(log->dt / TICK - 1e-9)};
	quadrotor_store store;
	tk_effects table;
	if (quadrotor_from(log->vehicle, &f.vehicle) != TK_OK) { return TK_ERROR; }
	quadrotor_effects_for(&f.vehicle, &store, &table);
	f.dt = log->dt / (double)f.ticks;
	f.kept = exp(-f.dt / QUADROTOR_GUSTS);
	const double end = (double)log->rows * log->dt;
	if (effects_open(&f.effects, &table, effects, n_effects, f.dt, end) != TK_OK) { return TK_ERROR; }
	f.asked = calloc(log->rows * f.ticks, sizeof *f.asked);
	const int status = f.asked ? follow(&f, predicted, states, ahead) : fail("out of memory");
	free(f.asked);
	effects_free(&f.effects);
	return status;
}
