#include "faults.h"

/* Rich excitation: nothing befalls it. */
static void nothing(stretch *now, sample *s) {
	(void)now;
	(void)s;
}

/* At rest at the origin, as sensors see it that have steps. */
static void no_excitation(stretch *now, sample *s) {
	const sample rest = {{0}, {0}, {0}};
	*s = rest;
	plant_move(now->robot, NULL, 1, s);
}

static void constant_regressor(stretch *now, sample *s) {
	memcpy(s->x, now->first.x, sizeof s->x);
	memcpy(s->u, now->first.u, sizeof s->u);
	plant_move(now->robot, &now->random, 1, s);
}

/* Two states and all inputs run together. */
static void duplicated_columns(stretch *now, sample *s) {
	const size_t n = now->robot->n;
	s->x[(now->channel + 1) % n] = s->x[now->channel];
	for (size_t i = 1; i < now->robot->m; i++) { s->u[i] = s->u[0]; }
	plant_move(now->robot, &now->random, 1, s);
}

/* All, or only the state, or only what follows, is off by 1e12. */
static void scale_jump(stretch *now, sample *s) {
	const double scale = 1e12;
	for (size_t i = 0; i < now->robot->n; i++) {
		s->x[i] *= now->kind != 1 ? scale : 1;
		s->next[i] *= now->kind != 2 ? scale : 1;
	}
	for (size_t i = 0; i < now->robot->m; i++) { s->u[i] *= now->kind == 0 ? scale : 1; }
}

static void denormals(stretch *now, sample *s) {
	const double scale = (double)REAL_MIN / 1e3;
	for (size_t i = 0; i < now->robot->n; i++) {
		s->x[i] *= scale;
		s->next[i] *= scale;
	}
	for (size_t i = 0; i < now->robot->m; i++) { s->u[i] *= scale; }
}

/* One sensor, or all, stays at what it was when the fault began. */
static void stuck_sensor(stretch *now, sample *s) {
	const size_t from = now->kind == 0 ? 0 : now->channel, to = now->kind == 0 ? now->robot->n : from + 1;
	for (size_t i = from; i < to; i++) { s->x[i] = s->next[i] = now->first.x[i]; }
}

/* One sample in five has a sensor off by several times its range, within what its format can say. */
static void spiking_sensor(stretch *now, sample *s) {
	if (random_below(&now->random, 5) > 0) { return; }
	const size_t i = random_below(&now->random, now->robot->n);
	const double spike = (double)random_uniform(&now->random, 5, 50);
	*(now->kind == 0 ? &s->x[i] : &s->next[i]) += random_below(&now->random, 2) ? spike : -spike;
}

static void missing_sensor(stretch *now, sample *s) {
	s->x[now->channel] = s->next[now->channel] = (double)NAN;
}

/* Bursts of 1 to 20 samples in which any number may be NaN or infinite. */
static void nan_bursts(stretch *now, sample *s) {
	const double values[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
	if (now->k % 40 > random_below(&now->random, 20)) { return; }
	s->x[random_below(&now->random, now->robot->n)] = values[random_below(&now->random, 3)];
	s->u[random_below(&now->random, now->robot->m)] = values[random_below(&now->random, 3)];
	s->next[random_below(&now->random, now->robot->n)] = values[random_below(&now->random, 3)];
}

/* Rows are lost, doubled or swapped: what follows is not what the step led to. */
static void time_jumps(stretch *now, sample *s) {
	sample after = *s, before = *s;
	switch (random_below(&now->random, 4)) {
	case 0: /* rows lost */
		for (size_t rows = 1 + random_below(&now->random, 9); rows > 0; rows--) {
			memcpy(after.x, after.next, sizeof after.x);
			plant_move(now->robot, NULL, 1, &after);
		}
		memcpy(s->next, after.next, sizeof s->next);
		break;
	case 1: /* a row twice */ memcpy(s->next, s->x, sizeof s->next); break;
	case 2: /* two rows swapped */
		memcpy(s->x, before.next, sizeof s->x);
		memcpy(s->next, before.x, sizeof s->next);
		break;
	default: break;
	}
}

/* Only a part of the inputs arrives, or they arrive the wrong way round. */
static void parameter_jump(stretch *now, sample *s) {
	static const double effects[] = {0.3, 2, -1};
	plant_move(now->robot, &now->random, effects[now->kind], s);
}

const fault all_faults[FAULTS] = {
    {"rich excitation", nothing},
    {"no excitation", no_excitation},
    {"constant regressor", constant_regressor},
    {"duplicated columns", duplicated_columns},
    {"scale jumps by 1e12", scale_jump},
    {"denormals", denormals},
    {"stuck sensor", stuck_sensor},
    {"spiking sensor", spiking_sensor},
    {"missing sensor", missing_sensor},
    {"NaN bursts", nan_bursts},
    {"time stamps jump", time_jumps},
    {"parameter jump", parameter_jump},
};

stretch stretch_begin(const plant *robot, random_source random, const sample *first) {
	stretch now = {robot, random, 0, 0, 0, *first};
	now.kind = random_below(&now.random, 3);
	now.channel = random_below(&now.random, robot->n);
	return now;
}

void stretch_spoil(const fault *f, stretch *now, sample *s) {
	f->spoil(now, s);
	now->k++;
}
