/* The paper's recursions written out literally in wide arithmetic: slow, and
 * independent of how the library arranges them. */
#ifndef REFERENCE_H
#define REFERENCE_H

#include "support.h"

typedef struct {
	size_t N, d;
	const char *regulator;
	wide lambda, p0, delta, tau0, eps_sift;
	wide own[MAX_SETTINGS];    /* settings of a regulator that is not the paper's */
	wide memory[MAX_SETTINGS]; /* what it remembers */
	wide theta[MAX_N * MAX_D]; /* N rows of d */
	wide P[MAX_D * MAX_D];
	wide R[MAX_D * MAX_D]; /* P^-1 */
} reference;

/* Theta = 0, P = p0 I, settings as in `e` */
void reference_start(reference *r, const estimator *e);
/* returns 1 where the regulator leaves P alone */
int reference_update(reference *r, const real *zeta, const real *psi_next);

#endif
