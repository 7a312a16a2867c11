#include "reference.h"

void reference_start(reference *r, const estimator *e) {
	memset(r, 0, sizeof *r);
	r->N = e->dictionary.n_lifted;
	r->d = r->N + e->config.n_inputs;
	r->regulator = e->config.regulator->name;
	static const char *const known[] = {"none", "ef", "dz_cs", "dz_ks", "ct", "sift"};
	int found = 0;
	for (size_t i = 0; i < sizeof known / sizeof *known; i++) { found |= strcmp(r->regulator, known[i]) == 0; }
	CHECK(found, "test/c/reference.c has no recursion of '%s': write it there, and add it to `known`", r->regulator);
	r->lambda = strcmp(r->regulator, "none") == 0 ? 1 : (wide)e->config.lambda;
	r->delta = (wide)e->dead_zone.delta;
	r->tau0 = e->trace.tau0 > 0 ? (wide)e->trace.tau0 : (wide)e->config.p0 * (wide)r->d;
	r->eps_sift = (wide)e->floor.eps_sift;
	for (size_t i = 0; i < r->d; i++) {
		r->P[i * r->d + i] = (wide)e->config.p0;
		r->R[i * r->d + i] = 1 / (wide)e->config.p0;
	}
}

/* y = M x; returns x' y */
static wide times(const wide *M, const wide *x, size_t d, wide *y) {
	wide sum = 0;
	for (size_t i = 0; i < d; i++) {
		y[i] = 0;
		for (size_t j = 0; j < d; j++) { y[i] += M[i * d + j] * x[j]; }
		sum += x[i] * y[i];
	}
	return sum;
}

/* M += a x x', one triangle, which the other copies: M stays symmetric bit for bit. What is not symmetric
 * grows with every step of the constant trace, within 100 steps from the last digit of long double to those
 * of double. Products alone do not ensure it: in the pairs of doubles that long double is on PowerPC, a b
 * is not b a, since one of the two cross terms goes into a fused multiplication. */
static void add_outer(wide *M, wide a, const wide *x, size_t d) {
	for (size_t i = 0; i < d; i++) {
		for (size_t j = 0; j <= i; j++) {
			M[i * d + j] += a * (x[i] * x[j]);
			M[j * d + i] = M[i * d + j];
		}
	}
}

int reference_update(reference *r, const real *zeta_real, const real *psi_next) {
	const size_t N = r->N, d = r->d;
	wide zeta[MAX_D], error[MAX_N], Pz[MAX_D], Rz[MAX_D];
	wide square = 0, innovation = 0, noise = r->lambda;

	for (size_t i = 0; i < d; i++) {
		zeta[i] = (wide)zeta_real[i];
		square += zeta[i] * zeta[i];
	}
	for (size_t i = 0; i < N; i++) {
		error[i] = (wide)psi_next[i];
		for (size_t j = 0; j < d; j++) { error[i] -= r->theta[i * d + j] * zeta[j]; }
		innovation += error[i] * error[i];
	}
	innovation = sqrt(innovation);

	const int dead_zone = strncmp(r->regulator, "dz_", 3) == 0;
	const int gated = dead_zone && innovation <= r->delta;
	if (gated && strcmp(r->regulator, "dz_ks") == 0) { return 1; }

	const int sift = strcmp(r->regulator, "sift") == 0;
	if (sift) {
		if (square < r->eps_sift) { return 1; }
		const wide rho = times(r->R, zeta, d, Rz);
		add_outer(r->P, (1 - r->lambda) / (r->lambda * rho), zeta, d);
		add_outer(r->R, -(1 - r->lambda) / rho, Rz, d);
		add_outer(r->R, 1, zeta, d);
		noise = 1;
	}

	const wide denominator = noise + times(r->P, zeta, d, Pz);
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < d; j++) { r->theta[i * d + j] += error[i] * Pz[j] / denominator; }
	}
	if (gated) { return 1; }

	add_outer(r->P, -1 / denominator, Pz, d);
	wide scale = 1 / noise;
	if (strcmp(r->regulator, "ct") == 0) {
		wide trace = 0;
		for (size_t i = 0; i < d; i++) { trace += r->P[i * d + i]; }
		scale = r->tau0 / trace;
	}
	for (size_t i = 0; i < d * d; i++) { r->P[i] *= scale; }
	return 0;
}
