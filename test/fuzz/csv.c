/* The CSV reader of logs: any bytes are read or refused in words, and what is read comes back bit for bit. */
#define _GNU_SOURCE

#include "fuzz.h"
#include "tinykoop_sim.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static const struct {
	const char *name, *header;
	size_t n, m;
	size_t may_lack; /* 0 or 1: columns of the state and the last input */
} platforms[] = {
    {"ddr", "t,px,py,theta,v,omega", 3, 2, 0},
    {"fwmav", "t,gx,gy,gz,ax,ay,az,pitch,roll,yaw,yaw_rate,u", 10, 1, 0},
    {"quadrotor", "t,px,py,pz,vx,vy,vz,ax,ay,az,roll,pitch,yaw,gx,gy,gz,m1,m2,m3,m4,vbat", 15, 5, 1},
};

/* A file in memory, and its path. */
typedef struct {
	int descriptor;
	char path[40];
} memory_file;

static void write_file(memory_file *file, const void *bytes, size_t size) {
	if (!file->descriptor) {
		file->descriptor = memfd_create("log", 0);
		EXPECT(file->descriptor > 0, "memfd_create");
		snprintf(file->path, sizeof file->path, "/proc/self/fd/%d", file->descriptor);
	}
	const int empty = ftruncate(file->descriptor, 0);
	EXPECT(empty == 0, "ftruncate");
	const ssize_t written = pwrite(file->descriptor, bytes, size, 0);
	EXPECT(written == (ssize_t)size, "%zd of %zu", written, size);
}

/* What was read, in pieces of exactly the size that is asked for. */
typedef struct {
	size_t rows;
	double dt, *t, *x, *u;
	int32_t *usable;
} contents;

static contents take_contents(tk_log *log, size_t p) {
	contents c = {.rows = tk_log_rows(log), .dt = tk_log_dt(log)};
	c.t = allocate(c.rows * sizeof *c.t);
	c.x = allocate(c.rows * platforms[p].n * sizeof *c.x);
	c.u = allocate(c.rows * platforms[p].m * sizeof *c.u);
	c.usable = allocate((c.rows - 1) * sizeof *c.usable);
	EXPECT(tk_log_get(log, c.t, c.x, c.u, c.usable) == TK_OK, "%s", tk_message());
	tk_log_free(log);
	return c;
}

static int all_finite(const double *x, size_t count) {
	for (size_t i = 0; i < count; i++) {
		if (!isfinite(x[i])) { return 0; }
	}
	return 1;
}

/* Whether the log lacks column i of rows of n. */
static int is_absent(const double *x, size_t rows, size_t n, size_t i) {
	for (size_t k = 0; k < rows; k++) {
		if (!isnan(x[k * n + i])) { return 0; }
	}
	return 1;
}

/* Finite in row k, but for columns that the log may lack, and does throughout. */
static void check_row(const double *x, size_t rows, size_t n, size_t k, size_t needed) {
	for (size_t i = 0; i < n; i++) {
		EXPECT(isfinite(x[k * n + i]) || (i >= needed && is_absent(x, rows, n, i)), "row %zu", k);
	}
}

static void check_contents(const contents *c, size_t p) {
	const size_t n = platforms[p].n;
	EXPECT(c->rows >= 3, "%zu", c->rows);
	EXPECT(c->dt > 0 && isfinite(c->dt), "%g", c->dt);
	EXPECT(all_finite(c->t, c->rows), "time");
	const size_t m = platforms[p].m, lacks = platforms[p].may_lack;
	for (size_t k = 0; k < c->rows; k++) { check_row(c->u, c->rows, m, k, m - lacks); }
	for (size_t k = 0; k + 1 < c->rows; k++) {
		EXPECT(c->t[k] < c->t[k + 1], "row %zu", k);
		if (!c->usable[k]) { continue; }
		EXPECT(c->usable[k] == 1, "row %zu", k);
		check_row(c->x, c->rows, n, k, lacks ? 0 : n);
		check_row(c->x, c->rows, n, k + 1, lacks ? 0 : n);
		EXPECT(fabs(c->t[k + 1] - c->t[k] - c->dt) < 0.5 * c->dt, "row %zu", k);
	}
}

/* A message of one line that says which file and, unless it is of the file as a whole, which line of it. */
static void check_refusal(const char *path, size_t lines) {
	static const char *const of_the_file[] = {"the file is empty", "rows of data", "zero byte", "too large"};
	const char *message = tk_message();
	const size_t length = strlen(path);
	EXPECT(strlen(message) < 600 && strncmp(message, path, length) == 0, "%s", message);
	for (const char *c = message; *c; c++) { EXPECT((unsigned char)*c >= ' ', "%s", message); }
	for (size_t i = 0; i < sizeof of_the_file / sizeof *of_the_file; i++) {
		if (strstr(message, of_the_file[i])) { return; }
	}
	char *end;
	const long line = message[length] == ':' ? strtol(message + length + 1, &end, 10) : 0;
	EXPECT(line >= 1 && (size_t)line <= lines && *end == ':', "%s", message);
}

/* Written with all digits and read again: the same bits. */
static void check_round_trip(const contents *c, size_t p) {
	static memory_file file;
	const size_t n = platforms[p].n, m = platforms[p].m, most = c->rows * (1 + n + m) * 26 + 100;
	char *text = allocate(most);
	size_t length = (size_t)snprintf(text, most, "%s\n", platforms[p].header);
	if (!all_finite(c->x, c->rows * n) || !all_finite(c->u, c->rows * m)) { return; } /* masked, or columns absent */
	for (size_t k = 0; k < c->rows; k++) {
		length += (size_t)snprintf(text + length, most - length, "%.17g", c->t[k]);
		for (size_t i = 0; i < n + m; i++) {
			const double value = i < n ? c->x[k * n + i] : c->u[k * m + i - n];
			length += (size_t)snprintf(text + length, most - length, ",%.17g", value);
		}
		text[length++] = '\n';
	}
	write_file(&file, text, length);
	tk_log *log = NULL;
	EXPECT(tk_log_read(file.path, platforms[p].name, &log) == TK_OK, "%s", tk_message());
	const contents again = take_contents(log, p);
	EXPECT(again.rows == c->rows, "%zu rows, then %zu", c->rows, again.rows);
	EXPECT(memcmp(again.t, c->t, c->rows * sizeof *c->t) == 0, "time");
	EXPECT(memcmp(again.x, c->x, c->rows * n * sizeof *c->x) == 0, "states");
	EXPECT(memcmp(again.u, c->u, c->rows * m * sizeof *c->u) == 0, "inputs");
	EXPECT(memcmp(&again.dt, &c->dt, sizeof c->dt) == 0, "dt");
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
	static memory_file file;
	size_t lines = 1;
	for (size_t i = 0; i < size; i++) { lines += data[i] == '\n'; }
	write_file(&file, data, size);
	for (size_t p = 0; p < sizeof platforms / sizeof *platforms; p++) {
		tk_log *log = NULL;
		tk_log_read(NULL, NULL, NULL); /* its message is the last one now */
		if (tk_log_read(file.path, platforms[p].name, &log) == TK_OK) {
			const contents c = take_contents(log, p);
			check_contents(&c, p);
			check_round_trip(&c, p);
		} else {
			EXPECT(!log, "a log of a refused file");
			check_refusal(file.path, lines);
		}
		free_all();
	}
	return 0;
}
