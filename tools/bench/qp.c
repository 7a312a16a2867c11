/* Times the controller on recorded steps, and says what it saw in JSON, one object a line.
 *
 *     qp_X facts
 *     qp_X plans FILE SETTING..                      the plan of every step, cold and warm
 *     qp_X run FILE FIRST COUNT REPEATS SETTING..    us per solve of steps FIRST, .., condensing included
 *
 * A SETTING is a precision, a method and a tolerance: f64,newton,1e-6. FILE holds doubles: lifted
 * states, horizon, number of steps, the diagonals of Q and R, u_min, u_max; then for each step
 * Theta row by row, psi and the reference, first of the step before it and then its own.
 */
#define _POSIX_C_SOURCE 199309L
#include "tinykoop.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MAX_SETTINGS = 16, HEADER = 12 };

typedef struct recording {
	double *all; /* the file */
	size_t n_lifted, horizon, n_steps, step_size;
	const double *q, *r, *u_min, *u_max, *steps;
} recording;

typedef struct setting {
	const char *text;
	int is_double, method;
	double tolerance;
} setting;

static double now_us(void) {
	struct timespec t;
	clock_gettime(CLOCK_MONOTONIC, &t);
	return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

#define REAL float
#define KOOP(name) koopf_##name
#define QP(name) name##_f32
#include "qp_real.h"
#undef REAL
#undef KOOP
#undef QP

#define REAL double
#define KOOP(name) koopd_##name
#define QP(name) name##_f64
#include "qp_real.h"

static int pass(const recording *r, const setting *s, size_t first, size_t count, int plans) {
	return s->is_double ? pass_f64(r, s, first, count, plans) : pass_f32(r, s, first, count, plans);
}

static int read_recording(const char *path, recording *r) {
	FILE *file = fopen(path, "rb");
	if (!file) { return 0; }
	double header[HEADER];
	int fine = fread(header, sizeof *header, HEADER, file) == HEADER;
	for (size_t i = 0; i < 3; i++) { fine = fine && header[i] >= 1 && header[i] <= 1e4; }
	if (fine) {
		r->n_lifted = (size_t)header[0];
		r->horizon = (size_t)header[1];
		r->n_steps = (size_t)header[2];
		r->step_size = r->n_lifted * (r->n_lifted + 3) + 3 * r->horizon;
		const size_t rest = 2 * r->n_steps * r->step_size;
		r->all = malloc((HEADER + rest) * sizeof *r->all);
		fine = r->all && fread(r->all + HEADER, sizeof *r->all, rest, file) == rest;
	}
	fclose(file);
	if (!fine) {
		free(r->all);
		return 0;
	}
	memcpy(r->all, header, sizeof header);
	r->q = r->all + 3;
	r->r = r->q + 3;
	r->u_min = r->r + 2;
	r->u_max = r->u_min + 2;
	r->steps = r->all + HEADER;
	return 1;
}

static int read_setting(const char *text, setting *s) {
	char precision[8], method[16];
	s->text = text;
	if (sscanf(text, "%7[^,],%15[^,],%lf", precision, method, &s->tolerance) != 3) { return 0; }
	s->is_double = strcmp(precision, "f64") == 0;
	s->method = strcmp(method, "gradient") == 0 ? KOOP_MPC_GRADIENT : KOOP_MPC_NEWTON;
	return (s->is_double || strcmp(precision, "f32") == 0) &&
	       (s->method == KOOP_MPC_GRADIENT || strcmp(method, "newton") == 0);
}

static size_t number(const char *text) {
	return (size_t)strtoul(text, NULL, 10);
}

int main(int argc, char **argv) {
	recording r = {0};
	setting settings[MAX_SETTINGS];
	if (argc == 2 && strcmp(argv[1], "facts") == 0) {
		printf("{\"compiler\": \"%s\", \"flags\": \"%s\"}\n", BENCH_COMPILER, BENCH_FLAGS);
		return 0;
	}
	const int plans = argc > 1 && strcmp(argv[1], "plans") == 0;
	const int first_setting = plans ? 3 : 6, n_settings = argc - first_setting;
	if (n_settings < 1 || n_settings > MAX_SETTINGS || (!plans && strcmp(argv[1], "run") != 0)) {
		fprintf(stderr, "usage: %s facts | plans FILE SETTING.. | run FILE FIRST COUNT REPEATS SETTING..\n",
		        argv[0]);
		return 2;
	}
	for (int i = 0; i < n_settings; i++) {
		if (!read_setting(argv[first_setting + i], &settings[i])) {
			fprintf(stderr, "%s: no setting: want f32 or f64, newton or gradient, tolerance\n",
			        argv[first_setting + i]);
			return 2;
		}
	}
	if (!read_recording(argv[2], &r)) {
		fprintf(stderr, "%s: cannot be read as recorded steps\n", argv[2]);
		return 2;
	}
	const size_t first = plans ? 0 : number(argv[3]), count = plans ? r.n_steps : number(argv[4]);
	const size_t repeats = plans ? 1 : number(argv[5]);
	int fine = first < r.n_steps && count <= r.n_steps - first;
	for (size_t k = 0; k < repeats; k++) {
		for (int i = 0; fine && i < n_settings; i++) { fine = pass(&r, &settings[i], first, count, plans); }
	}
	if (!fine) { fprintf(stderr, "a step has no plan, or is not in the file\n"); }
	free(r.all);
	return fine ? 0 : 1;
}
