/* Many short predictions over one log: the actuators are rolled along it,
 * only the pose starts again, at the measured one, in every window.
 *
 * The way covered in a step does not depend on the pose, so one path over the
 * log holds every window: what lies between two of its rows, turned to the
 * window's own start. A window costs two rotations whatever its length, and
 * agrees with a simulation of its own to rounding.
 *
 * Of a long log the windows hold little. With a warm-up a path is made for each
 * stretch of windows that lie closer to each other, and the actuators are rolled
 * from that many rows before it. */
#include <math.h>
#include <stdlib.h>

#include "angle.h"
#include "ddr.h"
#include "effects.h"
#include "message.h"
#include "stretches.h"

typedef struct place {
	double pose[3];  /* without the drift, from (0, 0, 0) */
	double drift[2]; /* m, in the world's axes: not turned */
	size_t last;     /* the row up to which all transitions may be used */
} place;

static int check_windows(const tk_recording *log, size_t n_starts, const int64_t *starts, size_t n_steps,
                         const int64_t *steps) {
	const int64_t final = (int64_t)log->rows - 1;
	if (!log->x || !log->u || log->rows < 2) { return fail("the log is empty: it needs two rows at least"); }
	if ((n_starts && !starts) || !n_steps || !steps) { return fail("starts and steps must be given"); }
	for (size_t j = 0; j < n_steps; j++) {
		if (steps[j] < 1 || steps[j] > final) {
			return fail("a window of %lld steps does not fit into a log of %zu rows", (long long)steps[j],
			            log->rows);
		}
	}
	for (size_t i = 0; i < n_starts; i++) {
		if (starts[i] < 0 || starts[i] > final) {
			return fail("a window cannot start in row %lld: the last row is %lld", (long long)starts[i],
			            (long long) final);
		}
	}
	return TK_OK;
}

static int64_t longest_of(size_t n_steps, const int64_t *steps) {
	int64_t longest = 0;
	for (size_t j = 0; j < n_steps; j++) { longest = steps[j] > longest ? steps[j] : longest; }
	return longest;
}

/* The path from row `first` to row `final`. The actuators are rolled through gaps too. */
static int travel(ddr *robot, const tk_recording *log, const stretch *s, place *path) {
	const size_t first = s->first, final = s->final;
	ddr_skip(robot, s->from);
	ddr_roll(robot, first - s->from, log->u + 2 * s->from);
	double pose[3] = {0, 0, 0}, drift[2] = {0, 0};
	for (size_t k = first;; k++) {
		path[k] = (place){{pose[0], pose[1], pose[2]}, {drift[0], drift[1]}, k};
		if (k == final) { break; }
		ddr_motion motion = ddr_next(robot, log->u + 2 * k);
		for (size_t i = 0; i < 2; i++) {
			drift[i] += motion.drift[i] * motion.dt;
			motion.drift[i] = 0;
		}
		ddr_move(&motion, pose);
	}
	for (size_t k = final; k-- > first;) { path[k].last = usable(log, k) ? path[k + 1].last : k; }
	if (!all_finite(path[final].pose, 3) || !all_finite(path[final].drift, 2)) {
		return fail("the prediction diverged (NaN or Inf): check effect parameters and commands");
	}
	return TK_OK;
}

typedef struct rotation {
	double c, s;
} rotation;

static rotation by_angle(double angle) {
	return (rotation){cos(angle), sin(angle)};
}

/* v = (along, across) turned */
static void turn(rotation r, double along, double across, double *v) {
	v[0] = r.c * along - r.s * across;
	v[1] = r.s * along + r.c * across;
}

/* The measured pose at row `end` of the window that starts at `true_start` in row `start`;
 * `to_start` turns the path there. */
static void predict(const ddr *robot, const place *path, size_t start, size_t end, const double *true_start,
                    rotation to_start, double *pose) {
	const place *a = &path[start], *b = &path[end];
	turn(to_start, b->pose[0] - a->pose[0], b->pose[1] - a->pose[1], pose);
	pose[2] = b->pose[2] - a->pose[2];
	for (size_t i = 0; i < 2; i++) { pose[i] += b->drift[i] - a->drift[i]; }
	for (size_t i = 0; i < 3; i++) { pose[i] += true_start[i]; }
	ddr_sense(robot, end, pose);
}

static void run(const ddr *robot, const tk_recording *log, const place *path, size_t start, size_t n_steps,
                const int64_t *steps, double *predicted, double *residual) {
	const double *measured = log->x + 3 * start;
	double at[3] = {measured[0], measured[1], measured[2]};
	ddr_unsense(robot, start, at);
	const rotation to_start = by_angle(at[2] - path[start].pose[2]), to_axes = by_angle(-measured[2]);
	for (size_t j = 0; j < n_steps; j++) {
		const size_t end = start + (size_t)steps[j];
		double pose[3] = {NAN, NAN, NAN}, off[3] = {NAN, NAN, NAN};
		if (end <= path[start].last) {
			predict(robot, path, start, end, at, to_start, pose);
			const double *then = log->x + 3 * end;
			turn(to_axes, then[0] - pose[0], then[1] - pose[1], off);
			off[2] = wrapped(then[2] - pose[2]);
		}
		for (size_t i = 0; i < 3; i++) {
			if (predicted) { predicted[3 * j + i] = pose[i]; }
			if (residual) { residual[3 * j + i] = off[i]; }
		}
	}
}

/* All windows, and the actuators from the log's first row. */
static stretch whole(const tk_recording *log, size_t n_starts, const int64_t *starts, size_t longest) {
	stretch s = {.end = n_starts, .first = log->rows - 1};
	for (size_t i = 0; i < n_starts; i++) {
		const size_t start = (size_t)starts[i], end = start + longest;
		s.first = start < s.first ? start : s.first;
		s.final = end > s.final ? end : s.final;
	}
	if (!n_starts || s.final >= log->rows) { s.final = log->rows - 1; }
	return s;
}

typedef struct request {
	const tk_active *effects;
	size_t n_effects;
	int integrator;
	const tk_recording *log;
	const int64_t *starts, *steps;
	size_t n_steps;
	double *predicted, *residual;
} request;

static int run_stretch(const request *q, const stretch *s, place *path) {
	const double nowhere[3] = {0, 0, 0}, end = (double)(q->log->rows - 1) * q->log->dt;
	ddr *robot = ddr_open(q->effects, q->n_effects, q->integrator, q->log->dt, end, nowhere);
	if (!robot) { return TK_ERROR; }
	const int status = travel(robot, q->log, s, path);
	for (size_t i = s->begin; status == TK_OK && i < s->end; i++) {
		const size_t out = 3 * q->n_steps * i;
		run(robot, q->log, path, (size_t)q->starts[i], q->n_steps, q->steps,
		    q->predicted ? q->predicted + out : NULL, q->residual ? q->residual + out : NULL);
	}
	ddr_free(robot);
	return status;
}

int tk_windows(const tk_active *effects, size_t n_effects, int integrator, const tk_recording *log,
               size_t n_starts, const int64_t *starts, size_t n_steps, const int64_t *steps,
               double *predicted, double *residual) {
	if (!log || (n_effects && !effects)) { return fail("log and effects must be given"); }
	if (check_windows(log, n_starts, starts, n_steps, steps) != TK_OK ||
	    check_actives(effects, n_effects) != TK_OK) {
		return TK_ERROR;
	}
	const request q = {effects, n_effects, integrator, log, starts, steps, n_steps, predicted, residual};
	const size_t longest = (size_t)longest_of(n_steps, steps);
	const int is_long = log->warm_up && n_starts;
	place *path = malloc(log->rows * sizeof *path);
	int status = path ? TK_OK : fail("out of memory");
	for (size_t begin = 0, done = 0; status == TK_OK && !done;) {
		const stretch s = is_long ? next_stretch(log, begin, n_starts, starts, longest)
		                          : whole(log, n_starts, starts, longest);
		status = check_rows(log, is_long ? s.from : 0, is_long ? s.final : log->rows - 1);
		if (status == TK_OK) { status = run_stretch(&q, &s, path); }
		begin = s.end;
		done = s.end >= n_starts;
	}
	free(path);
	return status;
}
