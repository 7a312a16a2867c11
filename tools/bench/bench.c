/* Times TinyKoop against Eigen, and says what it saw in JSON, one object a line.
 *
 *     bench_X data               the samples and what is learned from them
 *     bench_X run REPEATS CALLS  ns per call, a line per repeat and contender
 *
 * Contenders take turns within a repeat, so that a disturbance meets them all.
 */
#define _POSIX_C_SOURCE 199309L
#include "bench.h"

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { N = BENCH_LIFTED, D = BENCH_REGRESSORS, MAX_CASES = 32, VERIFY_UPDATES = 200 };

bench_sample_f32 bench_data_f32[BENCH_SAMPLES];
bench_sample_f64 bench_data_f64[BENCH_SAMPLES];

static const bench_case *cases[MAX_CASES];
static size_t n_cases;

/* uniform in [-1, 1), the same on every machine */
static double random_number(void) {
	static uint64_t state = 20250101;
	state = state * 6364136223846793005u + 1442695040888963407u;
	return (double)(state >> 11) / 4503599627370496.0 - 1;
}

/* Smooth regressors that excite every direction: sums of 16 harmonics, each
 * with its own phase. psi_next follows a random Theta, with noise. */
static void make_data(void) {
	enum { HARMONICS = 16 };
	static double theta[N][D], phase[D][HARMONICS];
	const double pi = 3.14159265358979323846;
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < D; j++) { theta[i][j] = 0.2 * random_number(); }
	}
	for (size_t j = 0; j < D; j++) {
		for (size_t h = 0; h < HARMONICS; h++) { phase[j][h] = pi * random_number(); }
	}
	for (size_t k = 0; k < BENCH_SAMPLES; k++) {
		bench_sample_f64 *s = &bench_data_f64[k];
		double zeta[D];
		for (size_t j = 0; j < D; j++) {
			zeta[j] = 0;
			for (size_t h = 0; h < HARMONICS; h++) {
				const double angle = 2 * pi * (double)((h + 1) * k) / (double)BENCH_SAMPLES;
				zeta[j] += 0.35 * cos(angle + phase[j][h]);
			}
			/* what float32 can hold, so that both precisions see the same numbers */
			zeta[j] = (double)(float)zeta[j];
		}
		memcpy(s->psi, zeta, sizeof s->psi);
		memcpy(s->u, zeta + N, sizeof s->u);
		for (size_t i = 0; i < N; i++) {
			double next = 1e-3 * random_number();
			for (size_t j = 0; j < D; j++) { next += theta[i][j] * zeta[j]; }
			s->psi_next[i] = (double)(float)next;
		}
		bench_sample_f32 *f = &bench_data_f32[k];
		for (size_t i = 0; i < N; i++) { f->psi[i] = (float)s->psi[i]; }
		for (size_t i = 0; i < BENCH_INPUTS; i++) { f->u[i] = (float)s->u[i]; }
		for (size_t i = 0; i < N; i++) { f->psi_next[i] = (float)s->psi_next[i]; }
	}
}

static void add_cases(const bench_case *from, size_t count) {
	for (size_t i = 0; i < count && n_cases < MAX_CASES; i++) { cases[n_cases++] = &from[i]; }
}

static void learn(const bench_case *c, double *theta) {
	c->reset();
	c->run(VERIFY_UPDATES);
	c->theta(theta);
}

/* Everyone that learns must learn the same, or the times compare different
 * work. After few updates: the forms that do not keep P symmetric drift away. */
static int verify(void) {
	static double first[N * D], other[N * D];
	learn(&bench_ours_f64[0], first);
	for (size_t i = 0; i < n_cases; i++) {
		if (!cases[i]->theta) { continue; }
		double difference = 0;
		learn(cases[i], other);
		for (size_t j = 0; j < N * D; j++) { difference = fmax(difference, fabs(other[j] - first[j])); }
		const double allowed = strcmp(cases[i]->precision, "f32") == 0 ? 1e-4 : 1e-11;
		printf("{\"kind\": \"theta\", \"task\": \"%s\", \"precision\": \"%s\", \"who\": \"%s\", "
		       "\"difference\": %.3g, \"allowed\": %.3g}\n",
		       cases[i]->task, cases[i]->precision, cases[i]->who, difference, allowed);
		if (!(difference <= allowed)) {
			fprintf(stderr, "%s %s: Theta differs by %.3g\n", cases[i]->who, cases[i]->precision, difference);
			return 0;
		}
	}
	return 1;
}

static double now_ns(void) {
	struct timespec t;
	clock_gettime(CLOCK_MONOTONIC, &t);
	return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

static void run(size_t repeats, size_t calls) {
	for (size_t r = 0; r < repeats; r++) {
		for (size_t i = 0; i < n_cases; i++) {
			const bench_case *c = cases[i];
			if (c->reset) { c->reset(); }
			c->run(BENCH_SAMPLES); /* warms caches and branch prediction */
			const double start = now_ns();
			c->run(calls);
			printf("{\"kind\": \"time\", \"repeat\": %zu, \"task\": \"%s\", \"precision\": \"%s\", "
			       "\"who\": \"%s\", \"ns\": %.2f}\n",
			       r, c->task, c->precision, c->who, (now_ns() - start) / (double)calls);
		}
	}
}

static void print_row(const double *x, size_t count) {
	for (size_t i = 0; i < count; i++) { printf("%s%.17g", i ? ", " : "[", x[i]); }
	printf("]");
}

static void print_data(void) {
	static double theta[N * D];
	for (size_t k = 0; k < BENCH_SAMPLES; k++) {
		const bench_sample_f64 *s = &bench_data_f64[k];
		printf("{\"kind\": \"sample\", \"psi\": ");
		print_row(s->psi, N);
		printf(", \"u\": ");
		print_row(s->u, BENCH_INPUTS);
		printf(", \"psi_next\": ");
		print_row(s->psi_next, N);
		printf("}\n");
	}
	learn(&bench_ours_f64[0], theta);
	printf("{\"kind\": \"learned\", \"updates\": %d, \"lambda\": %.17g, \"p0\": %.17g, \"eigen\": \"%s\", "
	       "\"compiler\": \"%s\", \"flags\": \"%s\", \"theta\": ",
	       VERIFY_UPDATES, BENCH_LAMBDA, BENCH_P0, bench_eigen_version, BENCH_COMPILER, BENCH_FLAGS);
	print_row(theta, N * D);
	printf("}\n");
}

int main(int argc, char **argv) {
	make_data();
	add_cases(bench_ours_f32, bench_ours_count_f32);
	add_cases(bench_ours_f64, bench_ours_count_f64);
	add_cases(bench_eigen, bench_eigen_count);

	if (argc == 2 && strcmp(argv[1], "data") == 0) {
		print_data();
		return 0;
	}
	if (argc == 4 && strcmp(argv[1], "run") == 0) {
		const long repeats = strtol(argv[2], NULL, 10), calls = strtol(argv[3], NULL, 10);
		if (repeats >= 1 && calls >= 1) {
			if (!verify()) { return 1; }
			run((size_t)repeats, (size_t)calls);
			return 0;
		}
	}
	fprintf(stderr, "usage: %s data | run REPEATS CALLS\n", argv[0]);
	return 2;
}
