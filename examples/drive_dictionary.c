/* Your own dictionary for a differential drive, x = [px (m), py (m), theta (rad)], in both precisions: firmware compiles it
 * in float, and the command tinykoop once more in double. No main: it is linked into the firmware. */
#include "tinykoop.h"

#ifndef KOOP /* the command defines both */
#define KOOP(name) koopf_##name
#define KOOP_REAL float
#endif

static void lift(const KOOP(dictionary) *self, const KOOP_REAL *x, KOOP_REAL *psi) {
	static const unsigned char heading[] = {2};
	static const KOOP(angles) turn = {.states = heading, .n = 1};
	for (size_t i = 0; i < self->n_states; i++) { psi[i] = x[i]; }
	psi[3] = x[0] * x[1];
	KOOP(part_angles).write(&turn, x, psi + 4); /* sine and cosine of the library, with the same bits everywhere */
}

extern const KOOP(dictionary) KOOP(drive);
const KOOP(dictionary) KOOP(drive) = {.name = "drive", .n_states = 3, .n_lifted = 6, .lift = lift};
