/* CSV logs: contract of columns, checks, masks and segments. */
#define _POSIX_C_SOURCE 200809L /* locales of a thread */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "message.h"
#include "system.h"

enum { MAX_COLUMNS = 64, MIN_ROWS = 3 };

/* No number of a robot is beyond `limit`, either way: what is, has another unit or is damaged. */
typedef struct quantity {
	const char *name, *unit;
	double limit;
} quantity;

#define TIME(name) {name, "s", 1e11}             /* since 1970 in ms is beyond it */
#define POSITION(name) {name, "m", 1e8}          /* twice around the Earth; coordinates of maps are below */
#define ANGLE(name) {name, "rad", 1e7}           /* days of turning, without jumps at pi */
#define RATE(name) {name, "rad/s", 1e4}          /* a turbine */
#define ACCELERATION(name) {name, "m/s^2", 1e5}  /* a shot */
#define COMMAND(name, unit) {name, unit, 1e7}    /* your own platform may count it in something else */
#define SPEED(name) {name, "m/s", 1e5}           /* beyond what leaves the Earth */
#define VOLTAGE(name) {name, "V", 1e5}           /* in mV it is within: the vehicle's voltage tells */

enum { MAX_VALUES = 24 };

typedef struct platform {
	const char *name;
	size_t n_states, n_inputs;
	size_t state, input;  /* where they begin in `columns`; t is the first */
	size_t optional;      /* columns from here on may be absent: NaN */
	quantity columns[MAX_VALUES];
} platform;

static const platform platforms[] = {
    {"ddr",
     3,
     2,
     1,
     4,
     6,
     {TIME("t"), POSITION("px"), POSITION("py"), ANGLE("theta"), COMMAND("v", "m/s"),
      COMMAND("omega", "rad/s")}},
    {"fwmav",
     10,
     1,
     1,
     11,
     12,
     {TIME("t"), RATE("gx"), RATE("gy"), RATE("gz"), ACCELERATION("ax"), ACCELERATION("ay"), ACCELERATION("az"),
      ANGLE("pitch"), ANGLE("roll"), ANGLE("yaw"), RATE("yaw_rate"), COMMAND("u", "rad")}},
    {"quadrotor",
     TK_QUADROTOR_SENSED,
     TK_QUADROTOR_COMMANDS,
     6,
     1,
     5,
     {TIME("t"), COMMAND("m1", "of full"), COMMAND("m2", "of full"), COMMAND("m3", "of full"),
      COMMAND("m4", "of full"), VOLTAGE("vbat"), POSITION("px"), POSITION("py"), POSITION("pz"), SPEED("vx"), SPEED("vy"),
      SPEED("vz"), ACCELERATION("ax"), ACCELERATION("ay"), ACCELERATION("az"), ANGLE("roll"), ANGLE("pitch"),
      ANGLE("yaw"), RATE("gx"), RATE("gy"), RATE("gz")}},
};

static const platform *platform_by_name(const char *name) {
	for (size_t i = 0; i < sizeof platforms / sizeof *platforms; i++) {
		if (name && strcmp(platforms[i].name, name) == 0) { return &platforms[i]; }
	}
	fail("there is no platform named '%s': use ddr, fwmav or quadrotor", name ? name : "");
	return NULL;
}

struct tk_log {
	const platform *platform;
	size_t rows, capacity;
	double dt;
	double *values; /* rows of the platform's columns */
	double *seg;
	int *pose_ok;
};

static size_t width(const tk_log *log) {
	return 1 + log->platform->n_states + log->platform->n_inputs;
}

void tk_log_free(tk_log *log) {
	if (!log) { return; }
	free(log->values);
	free(log->seg);
	free(log->pose_ok);
	free(log);
}

/* ---- Reading --------------------------------------------------------------- */

/* Where in the file the reader is, for its messages. */
typedef struct reader {
	const char *path;
	char *next; /* rest of the text, zero-terminated */
	size_t line;
	size_t n_columns;
	char *names[MAX_COLUMNS];
	int field_of[MAX_VALUES]; /* for each value, its column; -1 where an optional one is absent */
	int seg, pose_ok; /* columns, -1 where there is none */
} reader;

/* Cuts the next line off the text; null at the end. */
static char *next_line(reader *r) {
	char *line = r->next;
	if (!*line) { return NULL; }
	char *end = strchr(line, '\n');
	r->next = end ? end + 1 : line + strlen(line);
	if (end) { *end = 0; }
	const size_t length = strlen(line);
	if (length && line[length - 1] == '\r') { line[length - 1] = 0; }
	r->line++;
	return line;
}

static char *trim(char *field) {
	while (*field == ' ' || *field == '\t') { field++; }
	size_t length = strlen(field);
	while (length && (field[length - 1] == ' ' || field[length - 1] == '\t')) { field[--length] = 0; }
	return field;
}

/* Splits `line` at its commas; returns the number of fields, at most `most` of
 * which are kept. */
static size_t split(char *line, char **fields, size_t most) {
	size_t count = 0;
	while (line) {
		char *comma = strchr(line, ',');
		if (comma) { *comma = 0; }
		if (count < most) { fields[count] = trim(line); }
		count++;
		line = comma ? comma + 1 : NULL;
	}
	return count;
}

static int is_state(const platform *p, size_t i) {
	return i >= p->state && i < p->state + p->n_states;
}

static int find_column(const reader *r, const char *name) {
	for (size_t i = 0; i < r->n_columns; i++) {
		if (strcmp(r->names[i], name) == 0) { return (int)i; }
	}
	return -1;
}

static int read_header(reader *r, const tk_log *log) {
	char *line = next_line(r);
	if (!line) { return fail("%s: the file is empty; the first line must name the columns", r->path); }
	if (strncmp(line, "\xEF\xBB\xBF", 3) == 0) { line += 3; } /* byte order mark */
	r->n_columns = split(line, r->names, MAX_COLUMNS);
	if (r->n_columns > MAX_COLUMNS) {
		return fail("%s:1: %zu columns, at most %d can be read", r->path, r->n_columns, MAX_COLUMNS);
	}
	size_t states = 0;
	for (size_t i = 0; i < width(log); i++) {
		const char *name = log->platform->columns[i].name;
		r->field_of[i] = find_column(r, name);
		if (r->field_of[i] < 0 && i < log->platform->optional) {
			return fail("%s:1: column '%s' is missing; a %s log needs all of its columns (see README, Logs)",
			            r->path, name, log->platform->name);
		}
		states += r->field_of[i] >= 0 && is_state(log->platform, i);
	}
	if (!states) {
		return fail("%s:1: no column of the state, such as '%s'; add what was measured", r->path,
		            log->platform->columns[log->platform->state].name);
	}
	for (size_t i = 0; i < r->n_columns; i++) {
		if (find_column(r, r->names[i]) != (int)i && r->names[i][0]) {
			return fail("%s:1: duplicate column '%s' (again at column %zu); remove one", r->path,
			            r->names[i], i + 1);
		}
	}
	r->seg = find_column(r, "seg");
	r->pose_ok = find_column(r, "pose_ok");
	return TK_OK;
}

/* A finite decimal number and nothing else. */
static int parse(const char *text, double *value) {
	char *end;
	if (!*text || text[strspn(text, "+-.0123456789eE")]) { return 0; }
	*value = strtod(text, &end);
	return !*end && isfinite(*value);
}

static int read_number(const reader *r, char *const *fields, int column, double *value) {
	if (parse(fields[column], value)) { return TK_OK; }
	return fail("%s:%zu: column '%s' (%d): '%.40s' is not a finite number", r->path, r->line,
	            r->names[column], column + 1, fields[column]);
}

static int is_possible(double value, const quantity *c) {
	return fabs(value) <= c->limit; /* not for NaN */
}

/* Value i of a row: a number that a robot can have. */
static int read_value(const reader *r, const tk_log *log, char *const *fields, size_t i, double *value) {
	const quantity *c = &log->platform->columns[i];
	const int at = r->field_of[i];
	*value = NAN;
	if (at < 0) { return TK_OK; }
	if (read_number(r, fields, at, value) != TK_OK) { return TK_ERROR; }
	if (is_possible(*value, c)) { return TK_OK; }
	return fail("%s:%zu: column '%s' (%d): %.40s is beyond %g %s; write it in SI units%s", r->path, r->line,
	            c->name, at + 1, fields[at], c->limit, c->unit,
	            is_state(log->platform, i) ? ", or mask the row by pose_ok 0" : "");
}

/* The same of a masked row, in which a state is never looked at: what cannot be one is NaN. */
static int read_masked(const reader *r, const tk_log *log, char *const *fields, size_t i, double *value) {
	if (!is_state(log->platform, i) || r->field_of[i] < 0) { return read_value(r, log, fields, i, value); }
	const int possible = parse(fields[r->field_of[i]], value) && is_possible(*value, &log->platform->columns[i]);
	if (!possible) { *value = NAN; }
	return TK_OK;
}

static int grow(tk_log *log) {
	if (log->rows < log->capacity) { return TK_OK; }
	const size_t capacity = log->capacity ? 2 * log->capacity : 1024;
	double *values = realloc(log->values, capacity * width(log) * sizeof *values);
	if (values) { log->values = values; }
	double *seg = realloc(log->seg, capacity * sizeof *seg);
	if (seg) { log->seg = seg; }
	int *pose_ok = realloc(log->pose_ok, capacity * sizeof *pose_ok);
	if (pose_ok) { log->pose_ok = pose_ok; }
	if (!values || !seg || !pose_ok) { return fail("out of memory after %zu rows", log->rows); }
	log->capacity = capacity;
	return TK_OK;
}

static int read_row(reader *r, char *line, tk_log *log) {
	char *fields[MAX_COLUMNS];
	const size_t count = split(line, fields, MAX_COLUMNS);
	if (count != r->n_columns) {
		return fail("%s:%zu: %zu fields, but the header names %zu columns", r->path, r->line, count,
		            r->n_columns);
	}
	if (grow(log) != TK_OK) { return TK_ERROR; }

	double seg = 0, pose_ok = 1;
	if (r->seg >= 0 && read_number(r, fields, r->seg, &seg) != TK_OK) { return TK_ERROR; }
	if (r->pose_ok >= 0 && read_number(r, fields, r->pose_ok, &pose_ok) != TK_OK) { return TK_ERROR; }
	double *row = log->values + log->rows * width(log);
	for (size_t i = 0; i < width(log); i++) {
		const int status = pose_ok == 0 ? read_masked(r, log, fields, i, &row[i])
		                                : read_value(r, log, fields, i, &row[i]);
		if (status != TK_OK) { return TK_ERROR; }
	}
	if (log->rows && !(row[0] > row[0 - (ptrdiff_t)width(log)])) {
		return fail("%s:%zu: column 't' (%d): time goes from %g s to %g s; it must increase", r->path,
		            r->line, r->field_of[0] + 1, row[0 - (ptrdiff_t)width(log)], row[0]);
	}
	log->seg[log->rows] = seg;
	log->pose_ok[log->rows] = pose_ok != 0;
	log->rows++;
	return TK_OK;
}

static int compare(const void *a, const void *b) {
	const double x = *(const double *)a, y = *(const double *)b;
	return (x > y) - (x < y);
}

/* dt is the median time step; samples that are not spaced by it within a
 * segment are gaps, which tk_log_get() marks as not usable. */
static int find_dt(const reader *r, tk_log *log) {
	if (log->rows < MIN_ROWS) {
		return fail("%s: %zu rows of data, at least %d are needed", r->path, log->rows, MIN_ROWS);
	}
	const size_t count = log->rows - 1;
	double *steps = malloc(count * sizeof *steps);
	if (!steps) { return fail("out of memory"); }
	for (size_t k = 0; k < count; k++) {
		steps[k] = log->values[(k + 1) * width(log)] - log->values[k * width(log)];
	}
	qsort(steps, count, sizeof *steps, compare);
	log->dt = steps[count / 2];
	free(steps);
	return isfinite(log->dt) ? TK_OK : fail("%s: column 't': the steps are too large to be numbers", r->path);
}

static char *read_file(const char *path) {
	FILE *file = fopen(path, "rb");
	if (!file) {
		fail("%s: cannot be opened; check the path", path);
		return NULL;
	}
	size_t size = 0, capacity = 1 << 16;
	char *text = malloc(capacity + 1);
	while (text) {
		size += fread(text + size, 1, capacity - size, file);
		if (size < capacity) { break; }
		char *larger = realloc(text, 2 * capacity + 1);
		if (!larger) { free(text); }
		text = larger;
		capacity *= 2;
	}
	const int failed = ferror(file);
	fclose(file);
	if (!text) {
		fail("%s: does not fit into memory", path);
		return NULL;
	}
	if (failed) {
		free(text);
		fail("%s: cannot be read; is it a file?", path);
		return NULL;
	}
	text[size] = 0;
	if (strlen(text) != size) {
		free(text);
		fail("%s: contains a zero byte, so it is not a text file", path);
		return NULL;
	}
	return text;
}

static int read_log(reader *r, tk_log *log) {
	char *line;
	if (read_header(r, log) != TK_OK) { return TK_ERROR; }
	while ((line = next_line(r))) {
		if (!*line) {
			if (*r->next) { return fail("%s:%zu: the line is empty", r->path, r->line); }
			break;
		}
		if (read_row(r, line, log) != TK_OK) { return TK_ERROR; }
	}
	return find_dt(r, log);
}

static int read_path(const char *path, const platform *p, tk_log **out) {
	char *text = read_file(path);
	if (!text) { return TK_ERROR; }
	tk_log *log = calloc(1, sizeof *log);
	int status = fail("out of memory");
	if (log) {
		reader r = {.path = path, .next = text};
		log->platform = p;
		status = read_log(&r, log);
	}
	free(text);
	if (status == TK_OK) {
		*out = log;
	} else {
		tk_log_free(log);
	}
	return status;
}

int tk_log_read(const char *path, const char *platform_name, tk_log **out) {
	if (!path || !out) { return fail("path and log must be given"); }
	const platform *p = platform_by_name(platform_name);
	if (!p) { return TK_ERROR; }
	const saved_locale before = set_locale_aside();
	if (!before) { return fail("out of memory"); }
	const int status = read_path(path, p, out);
	put_locale_back(before);
	return status;
}

size_t tk_log_rows(const tk_log *log) {
	return log->rows;
}

double tk_log_dt(const tk_log *log) {
	return log->dt;
}

int tk_log_get(const tk_log *log, double *t, double *x, double *u, int32_t *usable) {
	const size_t n = log->platform->n_states, m = log->platform->n_inputs;
	for (size_t k = 0; k < log->rows; k++) {
		const double *row = log->values + k * width(log);
		if (t) { t[k] = row[0]; }
		if (x) { memcpy(x + k * n, row + log->platform->state, n * sizeof *x); }
		if (u) { memcpy(u + k * m, row + log->platform->input, m * sizeof *u); }
		if (usable && k + 1 < log->rows) {
			const double step = row[width(log)] - row[0];
			usable[k] = log->seg[k] == log->seg[k + 1] && log->pose_ok[k] && log->pose_ok[k + 1] &&
			            fabs(step - log->dt) < 0.5 * log->dt;
		}
	}
	return TK_OK;
}

/* ---- Writing ----------------------------------------------------------------- */

/* Value i > 0 of row k. */
static double written(const platform *p, size_t k, size_t i, const double *x, const double *u) {
	if (is_state(p, i)) { return x[k * p->n_states + i - p->state]; }
	return u[k * p->n_inputs + i - p->input];
}

/* Whether the column is left out: an optional one without any number. */
static int is_absent(const platform *p, size_t rows, size_t i, const double *x, const double *u) {
	int absent = i >= p->optional;
	for (size_t k = 0; k < rows && absent; k++) { absent = isnan(written(p, k, i, x, u)); }
	return absent;
}

static int write_rows(FILE *file, const platform *p, size_t rows, double dt, const double *x,
                      const double *u) {
	const saved_locale before = set_locale_aside();
	if (!before) { return 0; }
	const size_t columns = 1 + p->n_states + p->n_inputs;
	int absent[MAX_VALUES];
	for (size_t i = 0; i < columns; i++) {
		absent[i] = is_absent(p, rows, i, x, u);
		if (!absent[i]) { fprintf(file, "%s%s", i ? "," : "", p->columns[i].name); }
	}
	for (size_t k = 0; k < rows; k++) {
		fprintf(file, "\n%.10g", (double)k * dt);
		for (size_t i = 1; i < columns; i++) {
			if (!absent[i]) { fprintf(file, ",%.17g", written(p, k, i, x, u)); }
		}
	}
	fprintf(file, "\n");
	put_locale_back(before);
	return fflush(file) == 0 && !ferror(file) && to_disk(file) == 0;
}

/* Refuses what reading would refuse. */
static int check_column(const char *path, const platform *p, size_t rows, size_t i, const double *x,
                        const double *u) {
	const quantity *c = &p->columns[i];
	if (is_absent(p, rows, i, x, u)) { return TK_OK; }
	for (size_t k = 0; k < rows; k++) {
		const double value = written(p, k, i, x, u);
		if (!is_possible(value, c)) {
			return fail("%s: row %zu: column '%s': %g is not a number within %g %s; a log holds no other", path, k,
			            c->name, value, c->limit, c->unit);
		}
	}
	return TK_OK;
}

/* Into a file beside, this process's own, renamed when whole: a half-written log is never taken for one. */
int tk_log_write(const char *path, const char *platform_name, size_t rows, double dt, const double *x,
                 const double *u) {
	const platform *p = platform_by_name(platform_name);
	if (!p) { return TK_ERROR; }
	if (!path || !x || !u) { return fail("path, x and u must be given"); }
	for (size_t i = 1; i < 1 + p->n_states + p->n_inputs; i++) {
		if (check_column(path, p, rows, i, x, u) != TK_OK) { return TK_ERROR; }
	}
	char *beside = malloc(strlen(path) + 32);
	if (!beside) { return fail("out of memory"); }
	sprintf(beside, "%s.%ld.part", path, process_id());
	FILE *file = fopen(beside, "w");
	int ok = file != NULL;
	if (ok) {
		ok = write_rows(file, p, rows, dt, x, u);
		ok = fclose(file) == 0 && ok;
		ok = ok && rename_over(beside, path) == 0;
		if (!ok) { remove(beside); }
	}
	free(beside);
	return ok ? TK_OK : fail("%s: cannot be written; check folder, rights and free space", path);
}
