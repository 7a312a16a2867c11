/* One of each object of the library, and every call on them with what must hold after it. */
#ifndef WORLD_H
#define WORLD_H

#include "tinykoop_supervisor.h"

#include "fuzz.h"
#include "precision.h"

/* ---- Values out of bytes: bit patterns, ends of the range, and plausible ones -- */

real take_real(input *in);
void take_reals(input *in, real *x, size_t count);
/* a new array of `count` such values */
real *new_reals(input *in, size_t count);
/* mostly small, now and then any bit pattern */
size_t take_size(input *in);

/* ---- The objects ---------------------------------------------------------------- */

typedef struct {
	input in;
	int arbitrary; /* any settings, and null pointers; else sound ones */
	uint8_t nulls; /* which pointers of this call are null, by bit */

	KOOP(dictionary) dictionary;
	KOOP(rls) rls;
	KOOP(mpc) mpc;
	KOOP(supervisor) supervisor;
	KOOP(lowpass) lowpass;
	KOOP(gate) gate;
} world;

/* Makes the estimator, the controller, the supervisor, the gate and the filter of a sound world. */
void begin_sound(world *w);
/* One call, chosen and filled by the bytes. */
void call(world *w);

/* ---- What was learned, bit for bit ------------------------------------------------- */

typedef struct {
	KOOP(rls) rls;
	const real *theta, *covariance; /* copies */
} learned;

learned learned_take(const KOOP(rls) *rls);
/* stops unless the estimator is as it was */
void learned_expect(const learned *before, const KOOP(rls) *rls, const char *after);
/* finite, and P as its form and check promise */
void learned_check(const KOOP(rls) *rls);

#endif
