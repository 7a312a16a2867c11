#include "problem.h"

double decades(random_source *random, double from, double to) {
	return pow(10, (double)random_uniform(random, from, to));
}

void random_problem(random_source *random, problem *p) {
	memset(p, 0, sizeof *p);
	p->N = random_below(random, 20) ? 1 + random_below(random, MOST_N) : 1;
	p->n = 1 + random_below(random, p->N < MOST_n ? p->N : MOST_n);
	p->m = 1 + random_below(random, MOST_m);
	p->H = random_below(random, 20) ? 1 + random_below(random, MOST_H) : 1;
	p->rate = random_below(random, 3) == 0;

	const size_t rows = KOOP_PAD(p->N);
	const double size = (double)random_uniform(random, 0.3, 1.15) * sqrt(3 / (double)p->N);
	const double gain = random_below(random, 50) ? decades(random, -2, 0.5) : 0;
	for (size_t j = 0; j < p->N; j++) { random_fill(random, p->theta + j * rows, p->N, -size, size); }
	for (size_t j = 0; j < p->m; j++) {
		random_fill(random, p->theta + (p->N + j) * rows, p->N, -gain, gain);
	}
	/* robots' models are near the identity */
	for (size_t j = 0; random_below(random, 3) == 0 && j < p->N; j++) { p->theta[j * rows + j] += (real)0.7; }

	const double q = decades(random, -2, 2), r = decades(random, -6, 1);
	real L[MOST_n * MOST_n];
	random_fill(random, L, p->n * p->n, -1, 1);
	for (size_t i = 0; i < p->n; i++) {
		for (size_t j = 0; j < p->n; j++) {
			for (size_t k = 0; k < p->n; k++) {
				p->Q[i * p->n + j] += (real)q * L[i * p->n + k] * L[j * p->n + k];
			}
		}
	}
	const double box = decades(random, -2, 1), scale = decades(random, -1, 1.5);
	for (size_t j = 0; j < p->m; j++) {
		p->R[j * p->m + j] = (real)(r * (double)random_uniform(random, 0.5, 2));
		p->S[j * p->m + j] = (real)(r * (double)random_uniform(random, 0, 20));
		p->low[j] = random_uniform(random, -box, 0);
		p->high[j] = random_uniform(random, 0, box);
	}
	random_fill(random, p->psi, p->N, -scale, scale);
	random_fill(random, p->reference, p->H * p->n, -scale, scale);
	random_fill(random, p->before, p->m, -box, box);
}

KOOP(mpc_config) problem_settings(const problem *p, real tolerance, int method) {
	return (KOOP(mpc_config)){
	    .n_lifted = p->N,
	    .n_states = p->n,
	    .n_inputs = p->m,
	    .horizon = p->H,
	    .Q = p->Q,
	    .R = p->R,
	    .S = p->rate ? p->S : NULL,
	    .u_min = p->low,
	    .u_max = p->high,
	    .u_safe = p->safe,
	    .tolerance = tolerance,
	    .method = method,
	};
}

wide model(const problem *p, size_t i, size_t j) {
	return p->theta[j * KOOP_PAD(p->N) + i];
}

/* What the inputs u of step k and their neighbours cost by R and S: half the derivative by input j. */
static wide weights_gradient(const problem *p, const real *u, size_t k, size_t j) {
	wide sum = 0;
	for (size_t e = 0; e < p->m; e++) {
		sum += p->R[j * p->m + e] * (wide)u[e];
		if (!p->rate) { continue; }
		sum += p->S[j * p->m + e] * ((wide)u[e] - (k > 0 ? (u - p->m)[e] : p->before[e]));
		if (k + 1 < p->H) { sum -= p->S[j * p->m + e] * ((wide)(u + p->m)[e] - u[e]); }
	}
	return sum;
}

void costate_gradient(const problem *p, const real *u, wide *gradient) {
	static wide x[MOST_H + 1][MOST_N];
	wide costate[MOST_N] = {0}, before[MOST_N];
	for (size_t i = 0; i < p->N; i++) { x[0][i] = p->psi[i]; }
	for (size_t k = 0; k < p->H; k++) {
		for (size_t i = 0; i < p->N; i++) {
			wide next = 0;
			for (size_t j = 0; j < p->N; j++) { next += model(p, i, j) * x[k][j]; }
			for (size_t j = 0; j < p->m; j++) { next += model(p, i, p->N + j) * u[k * p->m + j]; }
			x[k + 1][i] = next;
		}
	}
	for (size_t k = p->H; k-- > 0;) {
		for (size_t i = 0; i < p->n; i++) {
			for (size_t j = 0; j < p->n; j++) {
				costate[i] += p->Q[i * p->n + j] * (x[k + 1][j] - p->reference[k * p->n + j]);
			}
		}
		for (size_t j = 0; j < p->m; j++) {
			const size_t q = k * p->m + j;
			gradient[q] = weights_gradient(p, u + k * p->m, k, j);
			for (size_t i = 0; i < p->N; i++) { gradient[q] += model(p, i, p->N + j) * costate[i]; }
		}
		for (size_t i = 0; i < p->N; i++) {
			before[i] = 0;
			for (size_t j = 0; j < p->N; j++) { before[i] += model(p, j, i) * costate[j]; }
		}
		memcpy(costate, before, sizeof costate);
	}
}

void hessian_diagonal(const problem *p, wide *diagonal) {
	for (size_t j = 0; j < p->m; j++) {
		wide x[MOST_N], next[MOST_N], sum = p->R[j * p->m + j];
		for (size_t i = 0; i < p->N; i++) { x[i] = model(p, i, p->N + j); }
		for (size_t k = p->H; k-- > 0;) {
			for (size_t i = 0; i < p->n; i++) {
				for (size_t e = 0; e < p->n; e++) { sum += p->Q[i * p->n + e] * x[i] * x[e]; }
			}
			const wide s = p->rate ? p->S[j * p->m + j] : 0;
			diagonal[k * p->m + j] = sum + (k + 1 < p->H ? 2 * s : s);
			for (size_t i = 0; i < p->N; i++) {
				next[i] = 0;
				for (size_t e = 0; e < p->N; e++) { next[i] += model(p, i, e) * x[e]; }
			}
			memcpy(x, next, sizeof x);
		}
	}
}

wide condition_bound(const problem *p, const wide *diagonal) {
	wide trace = 0, least = p->R[0];
	for (size_t q = 0; q < p->H * p->m; q++) { trace += diagonal[q]; }
	for (size_t j = 1; j < p->m; j++) { least = p->R[j * p->m + j] < least ? p->R[j * p->m + j] : least; }
	return trace / least;
}
