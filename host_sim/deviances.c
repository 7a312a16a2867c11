/* The deviance of one residual under several noises at once, as an optimiser asks for it along with its slopes.
 *
 * The filter is that of whiten.c; every number of it is a row of LANES, one for each noise, so that a compiler makes vector
 * instructions of the inner loops. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "message.h"
#include "tinykoop_sim.h"
#include "wide.h"

enum { LANES = 8, MOST = 48 };

typedef struct lanes {
	double of[LANES];
} lanes;

typedef struct filter {
	const tk_noises *noises;
	size_t n, r, c, coloured, N;
	lanes *P, *work, *z, *after;
	lanes process[MOST], rho[MOST]; /* of states beyond the deviation */
	lanes squares, log_det, product;
} filter;

#define EACH for (size_t l = 0; l < LANES; l++)

static lanes spread(double value) {
	lanes v;
	EACH { v.of[l] = value; }
	return v;
}

static void start(filter *f) {
	const tk_noises *s = f->noises;
	memset(f->P, 0, f->N * f->N * sizeof *f->P);
	memset(f->z, 0, f->N * sizeof *f->z);
	for (size_t i = 0; i < f->n; i++) { f->P[i * f->N + i] = spread(s->start[i] * s->start[i]); }
	for (size_t i = 0; i < f->r; i++) { f->P[(f->n + i) * f->N + f->n + i] = spread(1); }
	for (size_t i = 0; i < f->coloured; i++) {
		lanes *p = &f->P[(f->n + f->r + i) * f->N + f->n + f->r + i];
		EACH { p->of[l] = s->coloured[l * f->c + i] * s->coloured[l * f->c + i]; }
	}
}

/* Logarithms are slow: one of a product, before that leaves the numbers. */
static void settle_product(filter *f, int last) {
	int far = last;
	EACH { far |= !(f->product.of[l] > 1e-100 && f->product.of[l] < 1e100); }
	if (!far) { return; }
	EACH {
		f->log_det.of[l] += log(f->product.of[l]);
		f->product.of[l] = 1;
	}
}

static void update(filter *f, size_t i, double present, double seen) {
	const tk_noises *s = f->noises;
	const size_t N = f->N, own = f->n + f->r + i;
	const double *C = s->C + i * f->n;
	lanes Ph[MOST], S, e = spread(seen), unit;
	for (size_t a = 0; a < N; a++) {
		Ph[a] = f->coloured ? f->P[a * N + own] : spread(0);
		for (size_t b = 0; b < f->n; b++) {
			const double weight = C[b];
			if (weight == 0) { continue; }
			const lanes *p = &f->P[a * N + b];
			EACH { Ph[a].of[l] += p->of[l] * weight; }
		}
	}
	EACH { S.of[l] = s->white[l * f->c + i] * present + (f->coloured ? Ph[own].of[l] : 0); }
	for (size_t b = 0; b < f->n; b++) {
		EACH {
			S.of[l] += C[b] * Ph[b].of[l];
			e.of[l] -= C[b] * f->z[b].of[l];
		}
	}
	EACH {
		e.of[l] -= f->coloured ? f->z[own].of[l] : 0;
		unit.of[l] = 1 / S.of[l];
		f->squares.of[l] += e.of[l] * e.of[l] * unit.of[l];
		f->product.of[l] *= S.of[l];
	}
	for (size_t a = 0; a < N; a++) {
		lanes K, *z = &f->z[a];
		EACH {
			K.of[l] = Ph[a].of[l] * unit.of[l];
			z->of[l] += K.of[l] * e.of[l];
		}
		for (size_t b = 0; b <= a; b++) {
			lanes *p = &f->P[a * N + b], *q = &f->P[b * N + a];
			EACH { p->of[l] -= K.of[l] * Ph[b].of[l]; }
			*q = *p;
		}
	}
}

/* to += weight x from, over a row of N */
static void add(lanes *to, const lanes *from, const lanes *weight, size_t count, size_t to_step, size_t from_step) {
	for (size_t j = 0; j < count; j++) {
		lanes *a = to + j * to_step;
		const lanes *b = from + j * from_step;
		EACH { a->of[l] += weight->of[l] * b->of[l]; }
	}
}

/* Element (i, k) of the transition; whether it is other than zero. */
static int element(const filter *f, const double *A, const double *G, size_t i, size_t k, lanes *out) {
	if (i >= f->n) {
		*out = f->rho[i];
		return i == k;
	}
	if (k < f->n) {
		*out = spread(A[i * f->n + k]);
		return A[i * f->n + k] != 0;
	}
	if (k >= f->n + f->r || G[i * f->r + k - f->n] == 0) { return 0; }
	EACH { out->of[l] = G[i * f->r + k - f->n] * f->process[k].of[l]; }
	return 1;
}

static void predict(filter *f, const double *A, const double *G, const double *D) {
	const tk_noises *s = f->noises;
	const size_t N = f->N, n = f->n;
	lanes F;
	memset(f->work, 0, N * N * sizeof *f->work);
	for (size_t i = 0; i < N; i++) { f->after[i] = spread(i < n ? D[i] : 0); }
	for (size_t i = 0; i < N; i++) {
		for (size_t k = 0; k < N; k++) {
			if (!element(f, A, G, i, k, &F)) { continue; }
			add(f->work + i * N, f->P + k * N, &F, N, 1, 1);
			add(f->after + i, f->z + k, &F, 1, 1, 1);
		}
	}
	memcpy(f->z, f->after, N * sizeof *f->z);
	memset(f->P, 0, N * N * sizeof *f->P);
	for (size_t j = 0; j < N; j++) {
		for (size_t k = 0; k < N; k++) {
			if (element(f, A, G, j, k, &F)) { add(f->P + j * N, f->work + k, &F, N, 1, N); }
		}
	}
	for (size_t j = n; j < N; j++) {
		lanes *p = &f->P[j * N + j];
		const int coloured_state = j >= n + f->r;
		EACH {
			const double sd = coloured_state ? s->coloured[l * f->c + j - n - f->r] : 1;
			p->of[l] += (1 - f->rho[j].of[l] * f->rho[j].of[l]) * sd * sd;
		}
	}
}

WIDE static void run(filter *f, size_t rows, const tk_path *path, const double *D, const double *E) {
	f->squares = f->log_det = spread(0);
	f->product = spread(1);
	for (size_t k = 0; k < rows; k++) {
		if (path->begins[k]) { start(f); }
		for (size_t i = 0; i < f->c; i++) {
			const double present = path->variance[k * f->c + i];
			if (isfinite(present)) { update(f, i, present, E[k * f->c + i]); }
		}
		settle_product(f, k + 1 == rows);
		if (k + 1 == rows || path->begins[k + 1]) { continue; }
		predict(f, path->A + k * f->n * f->n, path->G + k * f->n * f->r, D + k * f->n);
	}
}

int tk_deviances(const tk_noises *noises, size_t rows, const tk_path *path, const double *D, const double *E, double *out) {
	const size_t n = noises->n, r = noises->r, c = noises->c, coloured = noises->coloured ? c : 0, N = n + r + coloured;
	if (N > MOST) { return fail("a filter of %zu states: at most %d", N, MOST); }
	filter f = {.noises = noises, .n = n, .r = r, .c = c, .coloured = coloured, .N = N};
	lanes *memory = calloc(2 * N * N + 2 * N, sizeof *memory);
	if (!memory) { return fail("out of memory"); }
	f.P = memory;
	f.work = memory + N * N;
	f.z = memory + 2 * N * N;
	f.after = f.z + N;
	for (size_t j = n; j < N; j++) {
		EACH {
			f.process[j].of[l] = j < n + r ? noises->process[l * r + j - n] : 0;
			f.rho[j].of[l] = j < n + r ? noises->process_rho[l * r + j - n] : noises->coloured_rho[l * c + j - n - r];
		}
	}
	run(&f, rows, path, D, E);
	EACH { out[l] = f.squares.of[l] + f.log_det.of[l]; }
	free(memory);
	return TK_OK;
}
