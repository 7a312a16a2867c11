/* The deviance of one residual under several noises at once, as an optimiser asks for it along with its slopes.
 *
 * The filter is that of whiten.c; every number of it is a row of lanes, one for each of some noises, of which a compiler makes
 * vector instructions. Where it knows no vectors there is one lane. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lanes.h"
#include "message.h"
#include "tinykoop_sim.h"
#include "wide.h"

/* An element of the transition that is not zero in every row: by the deviation, or driven by random motion. */
typedef struct element {
	size_t column, at;
	int driven;
} element;

/* Elements row by row; those of row i begin at first[i]. */
typedef struct transition {
	element *elements;
	size_t count, first[MOST + 1];
} transition;

typedef struct filter {
	lanes *P, *work, *z, *after, *F; /* F: of the elements of the transition */
	lanes *process, *rho, *grows;    /* of states beyond the deviation, by the number of the state */
	lanes *white, *begin;            /* of channels; of all states */
	lanes squares, log_det, product;
} filter;

static INLINED void start(filter *f, sizes s) {
	memset(f->P, 0, s.N * s.N * sizeof *f->P);
	memset(f->z, 0, s.N * sizeof *f->z);
	for (size_t i = 0; i < s.N; i++) { f->P[i * s.N + i] = f->begin[i]; }
}

static INLINED int leaves_range(const filter *f) {
	int far = 0;
	EACH { far |= !(OF(f->product, l) > 1e-100 && OF(f->product, l) < 1e100); }
	return far;
}

/* Logarithms are slow: one of a product, before that of any noise leaves the numbers. */
static INLINED void settle(filter *f, size_t filters, int last) {
	int far = last;
	for (size_t h = 0; h < filters; h++) { far |= leaves_range(&f[h]); }
	for (size_t h = 0; far && h < filters; h++) {
		EACH {
			OF(f[h].log_det, l) += log(OF(f[h].product, l));
			OF(f[h].product, l) = 1;
		}
	}
}

/* ---- What a channel tells ------------------------------------------------------ */

/* Of P only the lower half is kept up to date within a row; whole: the upper one still is. */
static INLINED size_t place(sizes s, size_t a, size_t b, int whole) {
	return a < b && !whole ? b * s.N + a : a * s.N + b;
}

static INLINED void update(filter *f, sizes s, const double *C, size_t i, double present, double seen, int whole) {
	const size_t own = s.n + s.r + i, from = s.plain ? i : 0, to = s.plain ? i + 1 : s.n;
	const lanes zero = {0};
	lanes Ph[MOST], S = f->white[i] * present, e = zero + seen;
	UNROLLED
	for (size_t a = 0; a < s.N; a++) {
		Ph[a] = s.coloured ? f->P[place(s, a, own, whole)] : zero;
		for (size_t b = from; b < to; b++) {
			if (s.plain || C[b] != 0) { Ph[a] += f->P[place(s, a, b, whole)] * (s.plain ? 1 : C[b]); }
		}
	}
	S += s.coloured ? Ph[own] : zero;
	for (size_t b = from; b < to; b++) {
		S += C[b] * Ph[b];
		e -= C[b] * f->z[b];
	}
	e -= s.coloured ? f->z[own] : zero;
	const lanes unit = 1 / S;
	f->squares += e * e * unit;
	f->product *= S;
	UNROLLED
	for (size_t a = 0; a < s.N; a++) {
		const lanes K = Ph[a] * unit;
		f->z[a] += K * e;
		for (size_t b = 0; b <= a; b++) { f->P[a * s.N + b] -= K * Ph[b]; }
	}
}

static INLINED void mirror(filter *f, sizes s) {
	UNROLLED
	for (size_t a = 0; a < s.N; a++) {
		for (size_t b = 0; b < a; b++) { f->P[b * s.N + a] = f->P[a * s.N + b]; }
	}
}

/* ---- From row to row ----------------------------------------------------------- */

static INLINED void weigh(filter *f, const transition *t, const double *A, const double *G) {
	const lanes zero = {0};
	for (size_t m = 0; m < t->count; m++) {
		const element *e = &t->elements[m];
		f->F[m] = e->driven ? G[e->at] * f->process[e->column] : zero + A[e->at];
	}
}

/* work = F P and after = F z + D */
static INLINED void from_left(filter *f, sizes s, const transition *t, const double *D) {
	const lanes zero = {0};
	UNROLLED
	for (size_t i = 0; i < s.n; i++) {
		lanes sums[MOST], sum = zero + D[i];
		for (size_t j = 0; j < s.N; j++) { sums[j] = zero; }
		for (size_t m = t->first[i]; m < t->first[i + 1]; m++) {
			const lanes F = f->F[m], *P = f->P + t->elements[m].column * s.N;
			for (size_t j = 0; j < s.N; j++) { sums[j] += F * P[j]; }
			sum += F * f->z[t->elements[m].column];
		}
		for (size_t j = 0; j < s.N; j++) { f->work[i * s.N + j] = sums[j]; }
		f->after[i] = sum;
	}
	UNROLLED
	for (size_t i = s.n; i < s.N; i++) {
		for (size_t j = 0; j < s.N; j++) { f->work[i * s.N + j] = f->rho[i] * f->P[i * s.N + j]; }
		f->after[i] = f->rho[i] * f->z[i];
	}
}

/* P = work F' and the noise; z = after */
static INLINED void from_right(filter *f, sizes s, const transition *t) {
	const lanes zero = {0};
	UNROLLED
	for (size_t j = 0; j < s.n; j++) {
		lanes sums[MOST];
		for (size_t i = 0; i < s.N; i++) { sums[i] = zero; }
		for (size_t m = t->first[j]; m < t->first[j + 1]; m++) {
			const lanes F = f->F[m], *work = f->work + t->elements[m].column;
			for (size_t i = 0; i < s.N; i++) { sums[i] += F * work[i * s.N]; }
		}
		for (size_t i = 0; i < s.N; i++) { f->P[j * s.N + i] = sums[i]; }
	}
	UNROLLED
	for (size_t j = s.n; j < s.N; j++) {
		for (size_t i = 0; i < s.N; i++) { f->P[j * s.N + i] = f->rho[j] * f->work[i * s.N + j]; }
		f->P[j * s.N + j] += f->grows[j];
	}
	for (size_t i = 0; i < s.N; i++) { f->z[i] = f->after[i]; }
}

/* ---- Along the path ------------------------------------------------------------ */

static INLINED void see(filter *f, sizes s, const double *C, const double *variance, const double *E) {
	int whole = 1;
	for (size_t i = 0; i < s.c; i++) {
		if (!isfinite(variance[i])) { continue; }
		update(f, s, C + i * s.n, i, variance[i], E[i], whole);
		whole = 0;
	}
	if (!whole) { mirror(f, s); }
}

static INLINED void predict(filter *f, sizes s, const transition *t, const double *A, const double *G, const double *D) {
	weigh(f, t, A, G);
	from_left(f, s, t, D);
	from_right(f, s, t);
}

/* All filters in turn at each row: what one loads is there for the others, and none waits for another. */
static INLINED void sweep(filter *f, size_t filters, sizes s, const transition *t, const double *C, size_t rows,
                          const tk_path *path, const double *D, const double *E) {
	for (size_t k = 0; k < rows; k++) {
		const int last = k + 1 == rows;
		for (size_t h = 0; h < filters; h++) {
			if (path->begins[k]) { start(&f[h], s); }
			see(&f[h], s, C, path->variance + k * s.c, E + k * s.c);
		}
		settle(f, filters, last);
		for (size_t h = 0; h < filters && !last && !path->begins[k + 1]; h++) {
			predict(&f[h], s, t, path->A + k * s.n * s.n, path->G + k * s.n * s.r, D + k * s.n);
		}
	}
}

WIDE static void run(filter *f, size_t filters, sizes s, const transition *t, const double *C, size_t rows, const tk_path *path,
                     const double *D, const double *E) {
	switch (kind_of(s)) {
		case WHITE_DRIVE: sweep(f, filters, white_drive, t, C, rows, path, D, E); break;
		case COLOURED_DRIVE: sweep(f, filters, coloured_drive, t, C, rows, path, D, E); break;
		default: sweep(f, filters, s, t, C, rows, path, D, E); break;
	}
}

/* ---- Setting up ---------------------------------------------------------------- */

/* Whether `matrices` (rows x size) are other than zero in a place somewhere. */
static int anywhere(size_t rows, size_t size, const double *matrices, size_t place) {
	for (size_t k = 0; k < rows; k++) {
		if (matrices[k * size + place] != 0) { return 1; }
	}
	return 0;
}

static void find_elements(transition *t, sizes s, size_t rows, const tk_path *path) {
	for (size_t i = 0; i < s.n; i++) {
		for (size_t k = 0; k < s.n + s.r; k++) {
			const int driven = k >= s.n;
			const size_t at = driven ? i * s.r + k - s.n : i * s.n + k;
			if (anywhere(rows, s.n * (driven ? s.r : s.n), driven ? path->G : path->A, at)) {
				t->elements[t->count++] = (element){k, at, driven};
			}
		}
		t->first[i + 1] = t->count;
	}
}

/* Lane l of a filter is of noise number `at`. */
static void take(filter *f, sizes s, const tk_noises *noises, size_t at, size_t l) {
	for (size_t i = 0; i < s.c; i++) { OF(f->white[i], l) = noises->white[at * s.c + i]; }
	for (size_t i = 0; i < s.n; i++) { OF(f->begin[i], l) = noises->start[i] * noises->start[i]; }
	for (size_t j = s.n; j < s.N; j++) {
		const size_t motion = at * s.r + j - s.n, channel = at * s.c + j - s.n - s.r;
		const int moves = j < s.n + s.r;
		const double rho = moves ? noises->process_rho[motion] : noises->coloured_rho[channel];
		const double sd = moves ? 1 : noises->coloured[channel];
		OF(f->process[j], l) = moves ? noises->process[motion] : 0;
		OF(f->rho[j], l) = rho;
		OF(f->grows[j], l) = (1 - rho * rho) * sd * sd;
		OF(f->begin[j], l) = sd * sd;
	}
}

/* A filter of the noises from number `first` on; the last one stands for those that are lacking. */
static lanes *filter_of(filter *f, sizes s, const tk_noises *noises, size_t first, lanes *memory) {
	lanes **parts[] = {&f->P, &f->work, &f->F, &f->z, &f->after, &f->process, &f->rho, &f->grows, &f->begin, &f->white};
	const size_t needs[] = {s.N * s.N, s.N * s.N, s.n * (s.n + s.r), s.N, s.N, s.N, s.N, s.N, s.N, s.c};
	for (size_t i = 0; i < sizeof needs / sizeof *needs; i++) {
		*parts[i] = memory;
		memory += needs[i];
	}
	const lanes zero = {0};
	f->squares = f->log_det = zero;
	f->product = zero + 1;
	EACH { take(f, s, noises, first + l < noises->count ? first + l : noises->count - 1, l); }
	return memory;
}

int tk_deviances(const tk_noises *noises, size_t rows, const tk_path *path, const double *D, const double *E, double *out) {
	const sizes s = sizes_of(noises->n, noises->r, noises->c, noises->coloured != NULL, noises->C);
	if (s.N > MOST) { return fail("a filter of %zu states: at most %d", s.N, MOST); }
	const size_t filters = (noises->count + LANES - 1) / LANES, of_each = sizeof(filter) / sizeof(lanes) + 1;
	const size_t each = of_each + 2 * s.N * s.N + s.n * (s.n + s.r) + 6 * s.N + s.c;
	double *memory = calloc((filters * each + 1) * LANES, sizeof *memory);
	transition t = {.elements = calloc(s.n * (s.n + s.r) + 1, sizeof *t.elements)};
	if (memory && t.elements) {
		filter *f = (filter *)aligned(memory);
		lanes *next = aligned(memory) + filters * of_each;
		for (size_t h = 0; h < filters; h++) { next = filter_of(&f[h], s, noises, h * LANES, next); }
		find_elements(&t, s, rows, path);
		run(f, filters, s, &t, noises->C, rows, path, D, E);
		for (size_t i = 0; i < noises->count; i++) {
			out[i] = OF(f[i / LANES].squares, i % LANES) + OF(f[i / LANES].log_det, i % LANES);
		}
	}
	const int status = memory && t.elements ? TK_OK : fail("out of memory");
	free(t.elements);
	free(memory);
	return status;
}
