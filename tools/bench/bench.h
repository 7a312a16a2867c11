/* What a contender of the benchmark looks like to bench.c. */
#ifndef TINYKOOP_BENCH_H
#define TINYKOOP_BENCH_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The task: one full update (innovation, gain, Theta, P) with exponential
 * forgetting, at the sizes of the paper's RBF dictionary. */
enum {
	BENCH_LIFTED = 22,
	BENCH_INPUTS = 2,
	BENCH_REGRESSORS = BENCH_LIFTED + BENCH_INPUTS,
	BENCH_SAMPLES = 64 /* the data repeat after as many */
};
#define BENCH_LAMBDA 0.98
#define BENCH_P0 100.0

/* One lifted step: psi and u led to psi_next. */
typedef struct bench_sample_f32 {
	float psi[BENCH_LIFTED], u[BENCH_INPUTS], psi_next[BENCH_LIFTED];
} bench_sample_f32;

typedef struct bench_sample_f64 {
	double psi[BENCH_LIFTED], u[BENCH_INPUTS], psi_next[BENCH_LIFTED];
} bench_sample_f64;

/* The same numbers for everyone, filled in once by bench.c. */
extern bench_sample_f32 bench_data_f32[BENCH_SAMPLES];
extern bench_sample_f64 bench_data_f64[BENCH_SAMPLES];

typedef struct bench_case {
	const char *task;
	const char *precision; /* "f32" or "f64" */
	const char *who;
	/* Theta = 0, P = p0 I; null where nothing is learned */
	void (*reset)(void);
	/* `count` calls on samples 0, 1, ..; over again after BENCH_SAMPLES */
	void (*run)(size_t count);
	/* Theta, BENCH_LIFTED rows of BENCH_REGRESSORS; null where nothing is learned */
	void (*theta)(double *theta);
} bench_case;

extern const bench_case bench_ours_f32[], bench_ours_f64[], bench_eigen[];
extern const size_t bench_ours_count_f32, bench_ours_count_f64, bench_eigen_count;
extern const char bench_eigen_version[];

#ifdef __cplusplus
}
#endif

#endif
