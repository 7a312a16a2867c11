/* A Kalman filter along a log that whitens many columns at once.
 *
 * What is filtered is the deviation of the robot from a reference path: its transition matrices are given row
 * by row, its inputs are the columns. Gains depend on the noise alone, so all columns share them, and
 * innovations over their standard deviations are white with unit variance if the noise is as described
 * (Kailath, "An innovations approach to least-squares estimation", IEEE Transactions on Automatic Control 13,
 * 1968).
 *
 * The state is the deviation (n), random motion (r, each AR(1) with unit variance), and coloured sensor noise
 * (c, AR(1)).
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "message.h"
#include "tinykoop_sim.h"
#include "wide.h"

enum { MOST = 48 }; /* states */

typedef struct filter {
	const tk_noise *noise;
	size_t n, r, c, coloured, N; /* coloured: states of coloured sensor noise, none where all is white */
	double *P;                   /* N x N */
	double *F;                   /* N x N */
	double *work;                /* N x N */
} filter;

static filter filter_of(const tk_noise *noise) {
	const size_t coloured = noise->coloured ? noise->c : 0, N = noise->n + noise->r + coloured;
	return (filter){
	    .noise = noise, .n = noise->n, .r = noise->r, .c = noise->c, .coloured = coloured, .N = N};
}

/* ---- What the noise alone makes ----------------------------------------------- */

static void start(filter *f) {
	const size_t N = f->N;
	memset(f->P, 0, N * N * sizeof *f->P);
	for (size_t i = 0; i < f->n; i++) { f->P[i * N + i] = f->noise->start[i] * f->noise->start[i]; }
	for (size_t i = 0; i < f->r; i++) { f->P[(f->n + i) * N + f->n + i] = 1; }
	for (size_t i = 0; i < f->coloured; i++) {
		const double sd = f->noise->coloured[i];
		f->P[(f->n + f->r + i) * N + f->n + f->r + i] = sd * sd;
	}
}

/* The variance of the innovation of channel i, whose coloured noise is a state, and its gain K; P less what
 * it tells. */
static double update(filter *f, size_t i, double variance, double *K) {
	const size_t N = f->N;
	const double *C = f->noise->C + i * f->n;
	const size_t own = f->n + f->r + i;
	double Ph[MOST] = {0}, S = variance;
	for (size_t a = 0; a < N; a++) {
		double sum = f->coloured ? f->P[a * N + own] : 0;
		for (size_t b = 0; b < f->n; b++) { sum += f->P[a * N + b] * C[b]; }
		Ph[a] = sum;
	}
	for (size_t b = 0; b < f->n; b++) { S += C[b] * Ph[b]; }
	S += f->coloured ? Ph[own] : 0;
	for (size_t a = 0; a < N; a++) { K[a] = Ph[a] / S; }
	for (size_t a = 0; a < N; a++) {
		for (size_t b = 0; b <= a; b++) { f->P[b * N + a] = f->P[a * N + b] -= K[a] * Ph[b]; }
	}
	return S;
}

static void transition(filter *f, const double *A, const double *G) {
	const size_t N = f->N, n = f->n, r = f->r;
	memset(f->F, 0, N * N * sizeof *f->F);
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < n; j++) { f->F[i * N + j] = A[i * n + j]; }
		for (size_t j = 0; j < r; j++) { f->F[i * N + n + j] = G[i * r + j] * f->noise->process[j]; }
	}
	for (size_t j = 0; j < r; j++) { f->F[(n + j) * N + n + j] = f->noise->process_rho[j]; }
	for (size_t j = 0; j < f->coloured; j++) {
		f->F[(n + r + j) * N + n + r + j] = f->noise->coloured_rho[j];
	}
}

/* F P F' without what is zero in F, which is most of it. */
static void predict_covariance(filter *f) {
	const size_t N = f->N, n = f->n, r = f->r;
	memset(f->work, 0, N * N * sizeof *f->work);
	for (size_t i = 0; i < N; i++) {
		for (size_t k = 0; k < N; k++) {
			const double a = f->F[i * N + k];
			if (a == 0) { continue; }
			for (size_t j = 0; j < N; j++) { f->work[i * N + j] += a * f->P[k * N + j]; }
		}
	}
	memset(f->P, 0, N * N * sizeof *f->P);
	for (size_t j = 0; j < N; j++) {
		for (size_t k = 0; k < N; k++) {
			const double a = f->F[j * N + k];
			if (a == 0) { continue; }
			for (size_t i = 0; i < N; i++) { f->P[j * N + i] += a * f->work[i * N + k]; }
		}
	}
	for (size_t j = 0; j < r; j++) {
		const double rho = f->noise->process_rho[j];
		f->P[(n + j) * N + n + j] += 1 - rho * rho;
	}
	for (size_t j = 0; j < f->coloured; j++) {
		const double rho = f->noise->coloured_rho[j], sd = f->noise->coloured[j];
		f->P[(n + r + j) * N + n + r + j] += (1 - rho * rho) * sd * sd;
	}
}

WIDE static double gains_of(filter *f, size_t rows, const tk_path *path, double *gains, double *units) {
	const size_t n = f->n, r = f->r;
	double log_det = 0;
	for (size_t k = 0; k < rows; k++) {
		if (path->begins[k]) { start(f); }
		for (size_t i = 0; i < f->c; i++, gains += f->N, units++) {
			const double variance = path->variance[k * f->c + i];
			if (!isfinite(variance)) { continue; }
			const double S = update(f, i, variance, gains);
			*units = 1 / sqrt(S);
			log_det += log(S);
		}
		if (k + 1 == rows || path->begins[k + 1]) { continue; }
		transition(f, path->A + k * n * n, path->G + k * n * r);
		predict_covariance(f);
	}
	return log_det;
}

int tk_gains(const tk_noise *noise, size_t rows, const tk_path *path, double *gains, double *units,
             double *log_det) {
	filter f = filter_of(noise);
	if (f.N > MOST) { return fail("a filter of %zu states: at most %d", f.N, MOST); }
	double *memory = calloc(3 * f.N * f.N, sizeof *memory);
	if (!memory) { return fail("out of memory"); }
	f.P = memory;
	f.F = memory + f.N * f.N;
	f.work = memory + 2 * f.N * f.N;
	memset(gains, 0, rows * f.c * f.N * sizeof *gains);
	memset(units, 0, rows * f.c * sizeof *units);
	*log_det = gains_of(&f, rows, path, gains, units);
	free(memory);
	return TK_OK;
}

/* ---- What columns make of that --------------------------------------------------- */

/* z (N x q): the columns' states, then n x q to compute in. */

/* Innovations of channel i for all columns into `out`, and what the gain makes of them. */
static void innovate(const filter *f, size_t q, double *z, size_t i, const double *E, double unit,
                     const double *K, double *out) {
	const double *C = f->noise->C + i * f->n, *own = z + (f->n + f->r + i) * q;
	for (size_t k = 0; k < q; k++) { out[k] = f->coloured ? E[k] - own[k] : E[k]; }
	for (size_t b = 0; b < f->n; b++) {
		if (C[b] == 0) { continue; }
		for (size_t k = 0; k < q; k++) { out[k] -= C[b] * z[b * q + k]; }
	}
	for (size_t a = 0; a < f->N; a++) {
		const double gain = K[a];
		if (gain == 0) { continue; }
		for (size_t k = 0; k < q; k++) { z[a * q + k] += gain * out[k]; }
	}
	for (size_t k = 0; k < q; k++) { out[k] *= unit; }
}

static void innovate_row(const filter *f, size_t q, double *z, const double *E, const double *units,
                         const double *gains, double *out) {
	for (size_t i = 0; i < f->c; i++) {
		if (units[i] == 0) {
			memset(out + i * q, 0, q * sizeof *out);
		} else {
			innovate(f, q, z, i, E + i * q, units[i], gains + i * f->N, out + i * q);
		}
	}
}

/* to (q) += a * from (q) */
static void add(size_t q, double a, const double *from, double *to) {
	if (a == 0) { return; }
	for (size_t k = 0; k < q; k++) { to[k] += a * from[k]; }
}

static void predict(const filter *f, size_t q, double *z, const double *A, const double *G, const double *D) {
	const size_t n = f->n, r = f->r;
	const tk_noise *noise = f->noise;
	double *after = z + f->N * q;
	memcpy(after, D, n * q * sizeof *after);
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < n; j++) { add(q, A[i * n + j], z + j * q, after + i * q); }
		for (size_t j = 0; j < r; j++) {
			add(q, G[i * r + j] * noise->process[j], z + (n + j) * q, after + i * q);
		}
	}
	memcpy(z, after, n * q * sizeof *after);
	for (size_t i = n; i < f->N; i++) {
		const double rho = i < n + r ? noise->process_rho[i - n] : noise->coloured_rho[i - n - r];
		for (size_t k = 0; k < q; k++) { z[i * q + k] *= rho; }
	}
}

WIDE static void run(const filter *f, size_t rows, size_t q, const tk_path *path, const double *gains,
                     const double *units, const double *D, const double *E, double *z, double *out) {
	const size_t n = f->n, r = f->r, c = f->c;
	for (size_t k = 0; k < rows; k++) {
		if (path->begins[k]) { memset(z, 0, f->N * q * sizeof *z); }
		innovate_row(f, q, z, E + k * c * q, units + k * c, gains + k * c * f->N, out + k * c * q);
		if (k + 1 == rows || path->begins[k + 1]) { continue; }
		predict(f, q, z, path->A + k * n * n, path->G + k * n * r, D + k * n * q);
	}
}

int tk_whiten(const tk_noise *noise, size_t rows, size_t columns, const tk_path *path, const double *gains,
              const double *units, const double *D, const double *E, double *out) {
	const filter f = filter_of(noise);
	double *z = calloc((f.N + f.n) * columns, sizeof *z);
	if (!z) { return fail("out of memory"); }
	run(&f, rows, columns, path, gains, units, D, E, z, out);
	free(z);
	return TK_OK;
}
