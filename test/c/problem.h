/* Random problems of the controller, and what certifies a plan: the gradient by a costate recursion in wide
 * arithmetic, which shares nothing with condensing. */
#ifndef PROBLEM_H
#define PROBLEM_H

#include "support.h"

enum { MOST_N = 22, MOST_n = 3, MOST_m = 3, MOST_H = 50, MOST_V = MOST_H * MOST_m };

typedef struct {
	size_t N, n, m, H;
	real theta[(MOST_N + MOST_m) * KOOP_PAD(MOST_N)];
	real Q[MOST_n * MOST_n], R[MOST_m * MOST_m], S[MOST_m * MOST_m];
	real low[MOST_m], high[MOST_m], safe[MOST_m], before[MOST_m];
	real psi[MOST_N], reference[MOST_H * MOST_n];
	int rate;
} problem;

double decades(random_source *random, double from, double to);

/* Up to the size of the paper's and beyond what its models lead to. */
void random_problem(random_source *random, problem *p);

/* For mpc_init(): it points to the problem's weights and limits. */
KOOP(mpc_config) problem_settings(const problem *p, real tolerance, int method);

/* Element (i, j) of Theta. */
wide model(const problem *p, size_t i, size_t j);

/* Half gradient of the cost at the inputs u (H rows of m): states forwards, costates backwards. */
void costate_gradient(const problem *p, const real *u, wide *gradient);

/* Diagonal of the Hessian: what one unit of an input at step k costs. */
void hessian_diagonal(const problem *p, wide *diagonal);

/* An upper bound of the Hessian's condition number: trace over the smallest of R. */
wide condition_bound(const problem *p, const wide *diagonal);

#endif
