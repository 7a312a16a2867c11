/* One step from each of many rows of one log: as windows of one step, for a search that asks for little else.
 *
 * Directions of the poses are the caller's, so a step costs two rotations and no trigonometry but that of its
 * own turn. A sensor's effect acts on the poses themselves: then a step costs what a window does. */
#include <math.h>

#include "angle.h"
#include "ddr.h"
#include "effects.h"
#include "message.h"
#include "stretches.h"

typedef struct request {
	const tk_recording *log;
	const double *facing;
	const int64_t *rows, *places;
	const double *reached; /* commands behind what remembers, or null */
	double *beside;        /* null: these are asked for */
	double *reaches;
} request;

static int check_rows_given(const tk_recording *log, size_t n_rows, const int64_t *rows) {
	if (!log->x || !log->u || log->rows < 2) { return fail("the log is empty: it needs two rows at least"); }
	for (size_t i = 0; i < n_rows; i++) {
		if (rows[i] < (i ? rows[i - 1] + 1 : 0) || rows[i] >= (int64_t)log->rows - 1) {
			return fail("a step cannot start in row %lld: rows must ascend, up to %zu", (long long)rows[i],
			            log->rows - 2);
		}
	}
	return TK_OK;
}

/* Where a step ends beside the next row, in the world's axes and in heading, from the row's own pose. */
static void moved(const ddr_motion *m, const double *x, const double *facing, double *end) {
	const double c = m->facing[0], s = m->facing[1];
	const double along = m->way[0] * c - m->way[1] * s, across = m->way[0] * s + m->way[1] * c;
	end[0] = (along * facing[0] - across * facing[1] + m->drift[0]) * m->dt - (x[3] - x[0]);
	end[1] = (along * facing[1] + across * facing[0] + m->drift[1]) * m->dt - (x[4] - x[1]);
	end[2] = m->turn * m->dt - (x[5] - x[2]);
}

/* The same through the sensor, whose effects are undone at the start. */
static void sensed(const ddr *robot, const ddr_motion *m, size_t k, const double *x, double *end) {
	double pose[3] = {x[0], x[1], x[2]};
	ddr_unsense(robot, k, pose);
	ddr_move(m, pose);
	ddr_sense(robot, k + 1, pose);
	for (size_t i = 0; i < 3; i++) { end[i] = pose[i] - x[3 + i]; }
}

static void step_from(const request *q, const ddr *robot, const ddr_motion *m, size_t k, int senses,
                      double *out) {
	const double *x = q->log->x + 3 * k, *facing = q->facing + 2 * k, *then = facing + 2;
	double end[3];
	if (senses) {
		sensed(robot, m, k, x, end);
	} else {
		moved(m, x, facing, end);
	}
	out[0] = then[0] * end[0] + then[1] * end[1];
	out[1] = then[0] * end[1] - then[1] * end[0];
	out[2] = wrapped(end[2]);
}

static int step_along(const request *q, ddr *robot, const stretch *s) {
	const tk_recording *log = q->log;
	const int senses = ddr_senses(robot);
	size_t row = s->from;
	int finite = 1;
	for (size_t i = s->begin; i < s->end; i++) {
		const size_t k = (size_t)q->rows[i];
		double *out = q->beside + 3 * q->places[i];
		ddr_motion motion;
		if (q->reached) {
			ddr_skip(robot, k - row);
			motion = ddr_go_on(robot, q->reached + 2 * i);
		} else {
			ddr_roll(robot, k - row, log->u + 2 * row);
			motion = ddr_next(robot, log->u + 2 * k);
		}
		step_from(q, robot, &motion, k, senses, out);
		finite &= all_finite(out, 3);
		row = k + 1;
	}
	return finite ? TK_OK : fail("the prediction diverged (NaN or Inf): check effect parameters and commands");
}

static int reach_along(const request *q, ddr *robot, const stretch *s) {
	size_t row = s->from;
	for (size_t i = s->begin; i < s->end; i++) {
		const size_t k = (size_t)q->rows[i];
		ddr_roll(robot, k - row, q->log->u + 2 * row);
		ddr_reach(robot, q->log->u + 2 * k, q->reaches + 2 * i);
		row = k + 1;
	}
	return TK_OK;
}

static int run_stretch(const request *q, ddr *robot, const stretch *s) {
	ddr_restart(robot);
	ddr_skip(robot, s->from);
	return q->beside ? step_along(q, robot, s) : reach_along(q, robot, s);
}

static int run(const tk_active *effects, size_t n_effects, int integrator, const request *q, size_t n_rows) {
	const tk_recording *log = q->log;
	if (check_rows_given(log, n_rows, q->rows) != TK_OK || check_actives(effects, n_effects) != TK_OK) {
		return TK_ERROR;
	}
	const double nowhere[3] = {0, 0, 0}, final = (double)(log->rows - 1) * log->dt;
	ddr *robot = ddr_open(effects, n_effects, integrator, log->dt, final, nowhere);
	if (!robot) { return TK_ERROR; }
	int status = TK_OK;
	for (size_t begin = 0; status == TK_OK && begin < n_rows;) {
		stretch s = log->warm_up ? next_stretch(log, begin, n_rows, q->rows, 1)
		                         : (stretch){.end = n_rows, .final = log->rows - 1};
		status = check_rows(log, s.from, s.final);
		if (status == TK_OK) { status = run_stretch(q, robot, &s); }
		begin = s.end;
	}
	ddr_free(robot);
	return status;
}

int tk_steps(const tk_active *effects, size_t n_effects, int integrator, const tk_recording *log,
             const double *facing, size_t n_rows, const int64_t *rows, const int64_t *places, const double *reached,
             double *beside) {
	if (!log || !facing || !beside || (n_rows && (!rows || !places)) || (n_effects && !effects)) {
		return fail("log, facing, rows, places, beside and effects must be given");
	}
	const request q = {.log = log, .facing = facing, .rows = rows, .places = places, .reached = reached, .beside = beside};
	return run(effects, n_effects, integrator, &q, n_rows);
}

int tk_reaches(const tk_active *effects, size_t n_effects, const tk_recording *log, size_t n_rows, const int64_t *rows,
               double *reached) {
	if (!log || !reached || (n_rows && !rows) || (n_effects && !effects)) {
		return fail("log, rows, reached and effects must be given");
	}
	const request q = {.log = log, .rows = rows, .reaches = reached};
	return run(effects, n_effects, TK_EULER, &q, n_rows);
}
