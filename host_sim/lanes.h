/* Numbers side by side that a compiler computes at once, and the sizes of the filters that do so (whiten.c, deviances.c). */
#ifndef TINYKOOP_LANES_H
#define TINYKOOP_LANES_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "tinykoop_sim.h"

#ifdef __GNUC__
typedef double lanes __attribute__((vector_size(32)));
#define INLINED inline __attribute__((always_inline))
#else
typedef double lanes;
#define INLINED inline
#endif
#if defined(__GNUC__) && !defined(__clang__)
#define UNROLLED _Pragma("GCC unroll 16") /* the next loop, whose inner loops then have bounds that the compiler knows */
#else
#define UNROLLED
#endif
enum { LANES = sizeof(lanes) / sizeof(double), MOST = 48 }; /* MOST: states of a filter */

#define EACH for (size_t l = 0; l < LANES; l++)
#define OF(v, l) (((double *)&(v))[l])

/* The first place for lanes in memory that has room for one more than are needed. */
static inline lanes *aligned(double *memory) {
	return (lanes *)(memory + (LANES - (uintptr_t)memory / sizeof *memory % LANES) % LANES);
}

/* `count` numbers, which the compiler should know. */
static INLINED void load(lanes *v, const double *from, size_t count) {
	const lanes zero = {0};
	*v = zero;
	if (count == LANES) {
		memcpy(v, from, sizeof *v);
	} else {
		for (size_t l = 0; l < count; l++) { OF(*v, l) = from[l]; }
	}
}

static INLINED void store(double *to, size_t count, const lanes *v) {
	if (count == LANES) {
		memcpy(to, v, sizeof *v);
	} else {
		for (size_t l = 0; l < count; l++) { to[l] = OF(*v, l); }
	}
}

/* States of the deviation, axes of random motion, channels, states of coloured noise, and states in all. A compiler that knows the
 * numbers unrolls all loops. */
typedef struct sizes {
	size_t n, r, c, coloured, N;
	int plain; /* each channel is one of the states: C is the identity */
} sizes;

static const sizes white_drive = {3, 3, 3, 0, 6, 1}, coloured_drive = {3, 3, 3, 3, 9, 1};
enum { WHITE_DRIVE, COLOURED_DRIVE, ANY };

static inline int is_identity(size_t n, size_t c, const double *C) {
	for (size_t i = 0; i < c * n; i++) {
		if (C[i] != (i / n == i % n)) { return 0; }
	}
	return c == n;
}

static inline sizes sizes_of(size_t n, size_t r, size_t c, int coloured, const double *C) {
	return (sizes){n, r, c, coloured ? c : 0, n + r + (coloured ? c : 0), is_identity(n, c, C)};
}

static inline int kind_of(sizes s) {
	const int drive = s.n == 3 && s.r == 3 && s.plain;
	return !drive ? ANY : s.coloured ? COLOURED_DRIVE : WHITE_DRIVE;
}

/* Correlation from row to row of a state beyond the deviation. */
static INLINED double rho_of(const tk_noise *noise, sizes s, size_t i) {
	return i < s.n + s.r ? noise->process_rho[i - s.n] : noise->coloured_rho[i - s.n - s.r];
}

#endif
