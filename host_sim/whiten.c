/* A Kalman filter along a log that whitens many columns at once.
 *
 * What is filtered is the deviation of the robot from a reference path: its transition matrices are given row
 * by row, its inputs are the columns. Gains depend on the noise alone, so all columns share them, and
 * innovations over their standard deviations are white with unit variance if the noise is as described
 * (Kailath, "An innovations approach to least-squares estimation", IEEE Transactions on Automatic Control 13,
 * 1968).
 *
 * The state is the deviation (n), random motion (r, each AR(1) with unit variance), and coloured sensor noise
 * (c, AR(1)). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lanes.h"
#include "message.h"
#include "tinykoop_sim.h"
#include "wide.h"

enum { BLOCKS = 2 }; /* lanes of columns that go along the path together, so that one need not wait for the other */
enum { TILE = 64 };  /* rows that all columns go along before the next ones, so that what one has loaded is there for the others */

/* ---- What the noise alone makes ----------------------------------------------- */

typedef struct filter {
	const tk_noise *noise;
	double *P, *F, *work; /* N x N */
} filter;

static INLINED void start(filter *f, sizes s) {
	memset(f->P, 0, s.N * s.N * sizeof *f->P);
	for (size_t i = 0; i < s.n; i++) { f->P[i * s.N + i] = f->noise->start[i] * f->noise->start[i]; }
	for (size_t i = s.n; i < s.N; i++) {
		const double sd = i < s.n + s.r ? 1 : f->noise->coloured[i - s.n - s.r];
		f->P[i * s.N + i] = sd * sd;
	}
}

/* The variance of the innovation of channel i, whose coloured noise is a state, and its gain K; P less what
 * it tells. */
static INLINED double update(filter *f, sizes s, size_t i, double variance, double *K) {
	const size_t own = s.n + s.r + i, from = s.plain ? i : 0, to = s.plain ? i + 1 : s.n;
	const double *C = f->noise->C + i * s.n;
	double Ph[MOST] = {0}, S = variance;
	for (size_t a = 0; a < s.N; a++) {
		double sum = s.coloured ? f->P[a * s.N + own] : 0;
		for (size_t b = from; b < to; b++) { sum += f->P[a * s.N + b] * C[b]; }
		Ph[a] = sum;
	}
	for (size_t b = from; b < to; b++) { S += C[b] * Ph[b]; }
	S += s.coloured ? Ph[own] : 0;
	for (size_t a = 0; a < s.N; a++) { K[a] = Ph[a] / S; }
	for (size_t a = 0; a < s.N; a++) {
		for (size_t b = 0; b <= a; b++) { f->P[b * s.N + a] = f->P[a * s.N + b] -= K[a] * Ph[b]; }
	}
	return S;
}

static INLINED void transition(filter *f, sizes s, const double *A, const double *G) {
	memset(f->F, 0, s.N * s.N * sizeof *f->F);
	for (size_t i = 0; i < s.n; i++) {
		for (size_t j = 0; j < s.n; j++) { f->F[i * s.N + j] = A[i * s.n + j]; }
		for (size_t j = 0; j < s.r; j++) { f->F[i * s.N + s.n + j] = G[i * s.r + j] * f->noise->process[j]; }
	}
	for (size_t i = s.n; i < s.N; i++) { f->F[i * s.N + i] = rho_of(f->noise, s, i); }
}

/* out += F P, or with the work of that out += F (F P)', without what is zero in F, which is most of it. */
static INLINED void times(const double *F, const double *P, sizes s, size_t along, size_t across, double *out) {
	memset(out, 0, s.N * s.N * sizeof *out);
	for (size_t i = 0; i < s.N; i++) {
		for (size_t k = i < s.n ? 0 : i; k < (i < s.n ? s.n + s.r : i + 1); k++) {
			const double a = F[i * s.N + k];
			if (a == 0) { continue; }
			for (size_t j = 0; j < s.N; j++) { out[i * s.N + j] += a * P[k * along + j * across]; }
		}
	}
}

static INLINED void predict_covariance(filter *f, sizes s) {
	times(f->F, f->P, s, s.N, 1, f->work);
	times(f->F, f->work, s, 1, s.N, f->P);
	for (size_t j = s.n; j < s.N; j++) {
		const double rho = rho_of(f->noise, s, j), sd = j < s.n + s.r ? 1 : f->noise->coloured[j - s.n - s.r];
		f->P[j * s.N + j] += (1 - rho * rho) * sd * sd;
	}
}

static INLINED double gains_along(filter *f, sizes s, size_t rows, const tk_path *path, double *gains, double *units) {
	double log_det = 0;
	for (size_t k = 0; k < rows; k++) {
		if (path->begins[k]) { start(f, s); }
		for (size_t i = 0; i < s.c; i++, gains += s.N, units++) {
			const double variance = path->variance[k * s.c + i];
			if (!isfinite(variance)) { continue; }
			const double S = update(f, s, i, variance, gains);
			*units = 1 / sqrt(S);
			log_det += log(S);
		}
		if (k + 1 == rows || path->begins[k + 1]) { continue; }
		transition(f, s, path->A + k * s.n * s.n, path->G + k * s.n * s.r);
		predict_covariance(f, s);
	}
	return log_det;
}

WIDE static double gains_of(filter *f, sizes s, size_t rows, const tk_path *path, double *gains, double *units) {
	switch (kind_of(s)) {
		case WHITE_DRIVE: return gains_along(f, white_drive, rows, path, gains, units);
		case COLOURED_DRIVE: return gains_along(f, coloured_drive, rows, path, gains, units);
		default: return gains_along(f, s, rows, path, gains, units);
	}
}

int tk_gains(const tk_noise *noise, size_t rows, const tk_path *path, double *gains, double *units,
             double *log_det) {
	const sizes s = sizes_of(noise->n, noise->r, noise->c, noise->coloured != NULL, noise->C);
	if (s.N > MOST) { return fail("a filter of %zu states: at most %d", s.N, MOST); }
	double *memory = calloc(3 * s.N * s.N, sizeof *memory);
	if (!memory) { return fail("out of memory"); }
	filter f = {noise, memory, memory + s.N * s.N, memory + 2 * s.N * s.N};
	memset(gains, 0, rows * s.c * s.N * sizeof *gains);
	memset(units, 0, rows * s.c * sizeof *units);
	*log_det = gains_of(&f, s, rows, path, gains, units);
	free(memory);
	return TK_OK;
}

/* ---- What columns make of that --------------------------------------------------- */

/* Some columns of all: `count` of them, in `blocks` of lanes. shared: what channels show is one column for all. */
typedef struct part {
	size_t q, first, count, blocks;
	int shared;
} part;

/* Where the columns of a row of numbers begin. */
static INLINED size_t at(part p, size_t row, size_t block) {
	return row * p.q + p.first + block * LANES;
}

static INLINED size_t within(part p, size_t block) {
	return p.count - block * LANES < LANES ? p.count - block * LANES : LANES;
}

/* Innovations of channel i into `out`, and what the gain makes of them. */
static INLINED void innovate(sizes s, part p, lanes *z, size_t i, const double *C, size_t row, const double *E,
                             double unit, const double *K, double *out) {
	const lanes zero = {0};
	for (size_t w = 0; w < p.blocks; w++) {
		lanes e = zero;
		if (p.shared) {
			e += E[row];
		} else {
			load(&e, E + at(p, row, w), within(p, w));
		}
		if (s.coloured) { e -= z[(s.n + s.r + i) * p.blocks + w]; }
		for (size_t b = s.plain ? i : 0; b < (s.plain ? i + 1 : s.n); b++) {
			if (s.plain || C[b] != 0) { e -= (s.plain ? 1 : C[b]) * z[b * p.blocks + w]; }
		}
		for (size_t a = 0; a < s.N; a++) {
			if (K[a] != 0) { z[a * p.blocks + w] += K[a] * e; }
		}
		e *= unit;
		store(out + at(p, row, w), within(p, w), &e);
	}
}

static INLINED void skip(part p, size_t row, double *out) {
	const lanes zero = {0};
	for (size_t w = 0; w < p.blocks; w++) { store(out + at(p, row, w), within(p, w), &zero); }
}

static INLINED void predict(sizes s, part p, const tk_noise *noise, lanes *z, const double *A, const double *G,
                            size_t row, const double *D) {
	lanes after[MOST * BLOCKS];
	for (size_t w = 0; w < p.blocks; w++) {
		for (size_t i = 0; i < s.n; i++) {
			lanes sum;
			load(&sum, D + at(p, row + i, w), within(p, w));
			for (size_t j = 0; j < s.n; j++) {
				if (A[i * s.n + j] != 0) { sum += A[i * s.n + j] * z[j * p.blocks + w]; }
			}
			for (size_t j = 0; j < s.r; j++) {
				const double g = G[i * s.r + j] * noise->process[j];
				if (g != 0) { sum += g * z[(s.n + j) * p.blocks + w]; }
			}
			after[i * p.blocks + w] = sum;
		}
	}
	for (size_t i = 0; i < s.n * p.blocks; i++) { z[i] = after[i]; }
	for (size_t i = s.n; i < s.N; i++) {
		for (size_t w = 0; w < p.blocks; w++) { z[i * p.blocks + w] *= rho_of(noise, s, i); }
	}
}

typedef struct request {
	const tk_noise *noise;
	size_t rows, columns;
	int shared;
	const tk_path *path;
	const double *gains, *units, *D, *E;
	double *out;
	lanes *states; /* of all columns, between one tile and the next: N for each lanes of them */
} request;

/* Some columns along the rows from `begin` to before `end`. */
static INLINED void along(const request *q, sizes s, part p, size_t begin, size_t end) {
	lanes z[MOST * BLOCKS], *kept = q->states + p.first / LANES * s.N;
	memcpy(z, kept, s.N * p.blocks * sizeof *z);
	for (size_t k = begin; k < end; k++) {
		if (q->path->begins[k]) { memset(z, 0, s.N * p.blocks * sizeof *z); }
		for (size_t i = 0; i < s.c; i++) {
			const size_t row = k * s.c + i;
			if (q->units[row] == 0) {
				skip(p, row, q->out);
			} else {
				innovate(s, p, z, i, q->noise->C + i * s.n, row, q->E, q->units[row], q->gains + row * s.N, q->out);
			}
		}
		if (k + 1 == q->rows || q->path->begins[k + 1]) { continue; }
		predict(s, p, q->noise, z, q->path->A + k * s.n * s.n, q->path->G + k * s.n * s.r, k * s.n, q->D);
	}
	memcpy(kept, z, s.N * p.blocks * sizeof *z);
}

/* All columns along a tile, in parts whose numbers of columns the compiler knows. */
static INLINED void along_tile(const request *q, sizes s, size_t begin, size_t end) {
	const size_t n = q->columns;
	size_t first = 0;
	for (; n - first >= BLOCKS * LANES; first += BLOCKS * LANES) {
		along(q, s, (part){n, first, BLOCKS * LANES, BLOCKS, q->shared}, begin, end);
	}
	for (; n - first >= LANES; first += LANES) { along(q, s, (part){n, first, LANES, 1, q->shared}, begin, end); }
	switch (n - first) {
		case 1: along(q, s, (part){n, first, 1, 1, q->shared}, begin, end); break;
		case 2: along(q, s, (part){n, first, 2, 1, q->shared}, begin, end); break;
		case 3: along(q, s, (part){n, first, 3, 1, q->shared}, begin, end); break;
		default: break;
	}
}

static INLINED void all_along(const request *q, sizes s) {
	for (size_t k = 0; k < q->rows; k += TILE) { along_tile(q, s, k, k + TILE < q->rows ? k + TILE : q->rows); }
}

WIDE static void run(const request *q, sizes s) {
	switch (kind_of(s)) {
		case WHITE_DRIVE: all_along(q, white_drive); break;
		case COLOURED_DRIVE: all_along(q, coloured_drive); break;
		default: all_along(q, s); break;
	}
}

int tk_whiten(const tk_noise *noise, size_t rows, size_t columns, int shared, const tk_path *path, const double *gains,
              const double *units, const double *D, const double *E, double *out) {
	const sizes s = sizes_of(noise->n, noise->r, noise->c, noise->coloured != NULL, noise->C);
	if (s.N > MOST) { return fail("a filter of %zu states: at most %d", s.N, MOST); }
	double *memory = calloc(((columns / LANES + 1) * s.N + 1) * LANES, sizeof *memory);
	if (!memory) { return fail("out of memory"); }
	const request q = {noise, rows, columns, shared, path, gains, units, D, E, out, aligned(memory)};
	run(&q, s);
	free(memory);
	return TK_OK;
}
