#include "plant.h"

static const double NOISE = 1e-3; /* of each state: half the width of a uniform distribution */

/* ---- Differential drive: x = [px, py (m), heading (rad)], u = [v (m/s), omega (rad/s)] -- */

static void move_ddr(const double *x, const double *u, double effect, double *next) {
	const double dt = 0.05, v = effect * u[0], omega = effect * u[1];
	next[0] = x[0] + dt * v * cos(x[2]);
	next[1] = x[1] + dt * v * sin(x[2]);
	next[2] = x[2] + dt * omega;
}

static const double ddr_low[] = {-3, -3, -3, 1.4, -1}, ddr_high[] = {3, 3, 3, 1.6, 1};
/* of three turns, so that the heading is not its atan2, and no step crosses where that jumps */
static void turn_ddr(random_source *random, double *x) {
	x[2] += 6.28318530717958648 * ((double)random_below(random, 3) - 1);
}
const plant plant_ddr = {"ddr", 3, 2, 0.98, ddr_low, ddr_high, move_ddr, turn_ddr};

/* ---- Flapping wing: states as in dictionary_fwmav.c, u = torques ------------------------ */

static void move_fwmav(const double *x, const double *u, double effect, double *next) {
	const double dt = 0.01, coupling = 0.003, g = 9.81;
	for (size_t i = 0; i < 3; i++) {
		const double gyroscopic = coupling * x[(i + 1) % 3] * x[(i + 2) % 3];
		next[i] = 0.95 * x[i] + 0.2 * effect * u[i] + gyroscopic;
	}
	next[3] = 0.5 * x[3] - 0.5 * g * sin(x[6]) + effect * u[1];
	next[4] = 0.5 * x[4] + 0.5 * g * sin(x[7]) + effect * u[0];
	next[5] = 0.5 * x[5] + 0.25 * g * (cos(x[6]) + cos(x[7]));
	next[6] = x[6] + dt * x[1];
	next[7] = x[7] + dt * x[0];
	next[8] = x[8] + dt * x[2];
	next[9] = 0.8 * x[9] + 0.2 * x[2];
}

static const double fwmav_low[] = {-2, -2, -2, -3, -3, 7, -0.7, -0.7, -3, -2, -1, -1, -1};
static const double fwmav_high[] = {2, 2, 2, 3, 3, 12, 0.7, 0.7, 3, 2, 1, 1, 1};
const plant plant_fwmav = {"fwmav", 10, 3, 0.995, fwmav_low, fwmav_high, move_fwmav, NULL};

/* ---- Both --------------------------------------------------------------------------------- */

void plant_move(const plant *robot, random_source *noise, double effect, sample *s) {
	robot->move(s->x, s->u, effect, s->next);
	for (size_t i = 0; noise && i < robot->n; i++) {
		s->next[i] += (double)random_uniform(noise, -NOISE, NOISE);
	}
}

void plant_draw(const plant *robot, random_source *random, double effect, sample *s) {
	for (size_t i = 0; i < robot->n; i++) {
		s->x[i] = (double)random_uniform(random, robot->low[i], robot->high[i]);
	}
	for (size_t i = 0; i < robot->m; i++) {
		const size_t k = robot->n + i;
		s->u[i] = (double)random_uniform(random, robot->low[k], robot->high[k]);
	}
	if (robot->adjust) { robot->adjust(random, s->x); }
	plant_move(robot, random, effect, s);
}
