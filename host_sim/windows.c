/* Many short predictions over one log: the actuators are rolled over all of it,
 * only the pose starts again, at the measured one, in every window.
 *
 * The way covered in a step does not depend on the pose, so one path over the
 * log holds every window: what lies between two of its rows, turned to the
 * window's own start. A window costs two rotations whatever its length, and
 * agrees with a simulation of its own to rounding. */
#include <math.h>
#include <stdlib.h>

#include "angle.h"
#include "ddr.h"
#include "effects.h"
#include "message.h"

typedef struct place {
	double pose[3];  /* without the drift, from (0, 0, 0) */
	double drift[2]; /* m, in the world's axes: not turned */
	size_t last;     /* the row up to which all transitions may be used */
} place;

static int check_actives(const tk_active *effects, size_t n_effects) {
	for (size_t i = 0; i < n_effects; i++) {
		const tk_effect *effect = effect_by_name(&ddr_effects, effects[i].effect);
		if (effect && effect->block == TK_SENSOR && !effect->undo) {
			return fail("%s cannot be undone at the start of a window: it serves simulation only",
			            effect->name);
		}
	}
	return TK_OK;
}

static int usable(const tk_recording *log, size_t k) {
	return !log->usable || log->usable[k];
}

static int all_finite(const double *values, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (!isfinite(values[i])) { return 0; }
	}
	return 1;
}

/* Whether nothing is NaN or infinite anywhere: the usual case, in one pass without branches. */
static int wholly_finite(const double *values, size_t count) {
	double odd[4] = {0, 0, 0, 0}; /* NaN once a value is not finite */
	size_t i = 0;
	for (; i + 4 <= count; i += 4) {
		odd[0] += values[i] - values[i];
		odd[1] += values[i + 1] - values[i + 1];
		odd[2] += values[i + 2] - values[i + 2];
		odd[3] += values[i + 3] - values[i + 3];
	}
	return odd[0] + odd[1] + odd[2] + odd[3] == 0 && all_finite(values + i, count - i);
}

static int check_recording(const tk_recording *log) {
	if (!log->x || !log->u || log->rows < 2) { return fail("the log is empty: it needs two rows at least"); }
	if (wholly_finite(log->u, 2 * (log->rows - 1)) && wholly_finite(log->x, 3 * log->rows)) { return TK_OK; }
	for (size_t k = 0; k + 1 < log->rows; k++) {
		const double *x = log->x + 3 * k, *u = log->u + 2 * k;
		if (!all_finite(u, 2)) { return fail("the command in row %zu is not finite", k); }
		if (usable(log, k) && !all_finite(x, 6)) {
			return fail("the pose in row %zu or %zu is not finite", k, k + 1);
		}
	}
	return TK_OK;
}

static int check_windows(const tk_recording *log, size_t n_starts, const int64_t *starts, size_t n_steps,
                         const int64_t *steps) {
	const int64_t final = (int64_t)log->rows - 1;
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

/* The path from row `first` to row `final`. The actuators are rolled from the log's
 * first row, through gaps too. */
static int travel(ddr *robot, const tk_recording *log, size_t first, size_t final, place *path) {
	ddr_roll(robot, first, log->u);
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
		return fail("prediction left the finite numbers: check effect parameters and commands");
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

int tk_windows(const tk_active *effects, size_t n_effects, int integrator, const tk_recording *log,
               size_t n_starts, const int64_t *starts, size_t n_steps, const int64_t *steps,
               double *predicted, double *residual) {
	const double nowhere[3] = {0, 0, 0};
	if (!log || (n_effects && !effects)) { return fail("log and effects must be given"); }
	if (check_recording(log) != TK_OK || check_windows(log, n_starts, starts, n_steps, steps) != TK_OK ||
	    check_actives(effects, n_effects) != TK_OK) {
		return TK_ERROR;
	}
	ddr *robot =
	    ddr_open(effects, n_effects, integrator, log->dt, (double)(log->rows - 1) * log->dt, nowhere);
	if (!robot) { return TK_ERROR; }
	size_t first = log->rows - 1, final = 0;
	for (size_t i = 0; i < n_starts; i++) {
		const size_t start = (size_t)starts[i], end = start + (size_t)longest_of(n_steps, steps);
		first = start < first ? start : first;
		final = end > final ? end : final;
	}
	final = n_starts && final < log->rows ? final : log->rows - 1;
	place *path = malloc(log->rows * sizeof *path);
	const int status = path ? travel(robot, log, first, final, path) : fail("out of memory");
	for (size_t i = 0; status == TK_OK && i < n_starts; i++) {
		const size_t out = 3 * n_steps * i;
		run(robot, log, path, (size_t)starts[i], n_steps, steps, predicted ? predicted + out : NULL,
		    residual ? residual + out : NULL);
	}
	free(path);
	ddr_free(robot);
	return status;
}
