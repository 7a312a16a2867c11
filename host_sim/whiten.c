/* A Kalman filter along a log that whitens many columns at once.
 *
 * What is filtered is the deviation of the robot from a reference path: its transition matrices are given row by row, its
 * inputs are the columns. Gains depend on the noise alone, so all columns share them, and innovations over their standard
 * deviations are white with unit variance if the noise is as described (Kailath, "An innovations approach to least-squares
 * estimation", IEEE Transactions on Automatic Control 13, 1968).
 *
 * The state is the deviation (n), random motion (r, each AR(1) with unit variance), and coloured sensor noise (c, AR(1)).
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
	size_t q;
	double *P;     /* N x N */
	double *F;     /* N x N */
	double *work;  /* N x N */
	double *z;     /* N x q: the columns' states, then n x q to compute in */
} filter;

static void start(filter *f) {
	const size_t N = f->N;
	memset(f->P, 0, N * N * sizeof *f->P);
	memset(f->z, 0, N * f->q * sizeof *f->z);
	for (size_t i = 0; i < f->n; i++) { f->P[i * N + i] = f->noise->start[i] * f->noise->start[i]; }
	for (size_t i = 0; i < f->r; i++) { f->P[(f->n + i) * N + f->n + i] = 1; }
	for (size_t i = 0; i < f->coloured; i++) {
		const double sd = f->noise->coloured[i];
		f->P[(f->n + f->r + i) * N + f->n + f->r + i] = sd * sd;
	}
}

/* The variance of the innovation of channel i, whose coloured noise is a state, and its gain K; P less what it tells. */
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
		for (size_t b = 0; b <= a; b++) {
			f->P[b * N + a] = f->P[a * N + b] -= K[a] * Ph[b];
		}
	}
	return S;
}

/* Innovations of channel i for all columns into `out`, and what the gain makes of them. */
static void innovate(filter *f, size_t i, const double *E, double S, const double *K, double *out) {
	const size_t q = f->q;
	const double *C = f->noise->C + i * f->n, *own = f->z + (f->n + f->r + i) * q;
	const double unit = 1 / sqrt(S);
	for (size_t k = 0; k < q; k++) { out[k] = f->coloured ? E[k] - own[k] : E[k]; }
	for (size_t b = 0; b < f->n; b++) {
		if (C[b] == 0) { continue; }
		const double *z = f->z + b * q;
		for (size_t k = 0; k < q; k++) { out[k] -= C[b] * z[k]; }
	}
	for (size_t a = 0; a < f->N; a++) {
		double *z = f->z + a * q;
		const double gain = K[a];
		if (gain == 0) { continue; }
		for (size_t k = 0; k < q; k++) { z[k] += gain * out[k]; }
	}
	for (size_t k = 0; k < q; k++) { out[k] *= unit; }
}

static void transition(filter *f, const double *A, const double *G) {
	const size_t N = f->N, n = f->n, r = f->r;
	memset(f->F, 0, N * N * sizeof *f->F);
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < n; j++) { f->F[i * N + j] = A[i * n + j]; }
		for (size_t j = 0; j < r; j++) { f->F[i * N + n + j] = G[i * r + j] * f->noise->process[j]; }
	}
	for (size_t j = 0; j < r; j++) { f->F[(n + j) * N + n + j] = f->noise->process_rho[j]; }
	for (size_t j = 0; j < f->coloured; j++) { f->F[(n + r + j) * N + n + r + j] = f->noise->coloured_rho[j]; }
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

static void predict_columns(filter *f, const double *D) {
	const size_t N = f->N, n = f->n, q = f->q;
	double *after = f->z + N * q;
	memcpy(after, D, n * q * sizeof *after);
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < N; j++) {
			const double a = f->F[i * N + j];
			if (a == 0) { continue; }
			const double *z = f->z + j * q;
			double *to = after + i * q;
			for (size_t k = 0; k < q; k++) { to[k] += a * z[k]; }
		}
	}
	memcpy(f->z, after, n * q * sizeof *after);
	for (size_t i = n; i < N; i++) {
		for (size_t k = 0; k < q; k++) { f->z[i * q + k] *= f->F[i * N + i]; }
	}
}

static double innovate_row(filter *f, const double *variance, const double *E, double *out) {
	double log_det = 0, K[MOST];
	for (size_t i = 0; i < f->c; i++, E += f->q, out += f->q) {
		if (!isfinite(variance[i])) {
			memset(out, 0, f->q * sizeof *out);
			continue;
		}
		const double S = update(f, i, variance[i], K);
		innovate(f, i, E, S, K, out);
		log_det += log(S);
	}
	return log_det;
}

WIDE static double run(filter *f, size_t rows, const tk_path *path, const double *D, const double *E, double *out) {
	const size_t n = f->n, r = f->r, c = f->c, q = f->q;
	double log_det = 0;
	for (size_t k = 0; k < rows; k++) {
		if (path->begins[k]) { start(f); }
		log_det += innovate_row(f, path->variance + k * c, E + k * c * q, out + k * c * q);
		if (k + 1 == rows || path->begins[k + 1]) { continue; }
		transition(f, path->A + k * n * n, path->G + k * n * r);
		predict_covariance(f);
		predict_columns(f, D + k * n * q);
	}
	return log_det;
}

int tk_whiten(const tk_noise *noise, size_t rows, size_t columns, const tk_path *path, const double *D, const double *E,
              double *out, double *log_det) {
	const size_t n = noise->n, r = noise->r, c = noise->c, coloured = noise->coloured ? c : 0, N = n + r + coloured;
	if (N > MOST) { return fail("a filter of %zu states: at most %d", N, MOST); }
	filter f = {noise, n, r, c, coloured, N, columns, NULL, NULL, NULL, NULL};
	double *memory = calloc(3 * N * N + (N + n) * columns, sizeof *memory);
	if (!memory) { return fail("out of memory"); }
	f.P = memory;
	f.F = memory + N * N;
	f.work = memory + 2 * N * N;
	f.z = memory + 3 * N * N;
	*log_det = run(&f, rows, path, D, E, out);
	free(memory);
	return TK_OK;
}
