#include "reference.h"

void reference_start(reference *r, const estimator *e) {
	memset(r, 0, sizeof *r);
	r->N = e->dictionary.n_lifted;
	r->d = r->N + e->config.n_inputs;
	r->regulator = e->config.regulator->name;
	static const char *const known[] = {"none", "ef", "dz_cs", "dz_ks", "ct", "sift", "reset",
	                                    "vrf", "er", "cr", "kulhavy", "bgf"};
	int found = 0;
	for (size_t i = 0; i < sizeof known / sizeof *known; i++) { found |= strcmp(r->regulator, known[i]) == 0; }
	CHECK(found, "test/c/reference.c has no recursion of '%s': write it there, and add it to `known`", r->regulator);
	r->lambda = strcmp(r->regulator, "none") == 0 ? 1 : (wide)e->config.lambda;
	r->delta = (wide)e->dead_zone.delta;
	r->tau0 = e->trace.tau0 > 0 ? (wide)e->trace.tau0 : (wide)e->config.p0 * (wide)r->d;
	r->eps_sift = (wide)e->floor.eps_sift;
	r->p0 = (wide)e->config.p0;
	for (size_t i = 0; i < MAX_SETTINGS; i++) { r->own[i] = (wide)e->own[i]; }
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

/* ---- Regulators of other papers ------------------------------------------------------
 *
 * The library changes P by rank-one terms. Here R = P^-1 is what is kept, and Theta += error (P zeta)' with the P
 * that has learned from the sample, as most of these papers have it. */

static void set_identity(wide *M, wide value, size_t d) {
	for (size_t i = 0; i < d * d; i++) { M[i] = i % (d + 1) == 0 ? value : 0; }
}

/* P = R^-1, symmetric bit for bit */
static void invert_information(reference *r) {
	static wide copied[MAX_D * MAX_D];
	memcpy(copied, r->R, r->d * r->d * sizeof(wide));
	set_identity(r->P, 1, r->d);
	solve_positive_definite(copied, r->d, r->P, r->d);
	for (size_t i = 0; i < r->d; i++) {
		for (size_t j = 0; j < i; j++) { r->P[i * r->d + j] = r->P[j * r->d + i]; }
	}
}

/* R = lambda R + zeta zeta', and Theta by its inverse */
static void learn_by_information(reference *r, wide lambda, const wide *zeta, const wide *error) {
	wide gain[MAX_D];
	for (size_t i = 0; i < r->d * r->d; i++) { r->R[i] *= lambda; }
	add_outer(r->R, 1, zeta, r->d);
	invert_information(r);
	times(r->P, zeta, r->d, gain);
	for (size_t i = 0; i < r->N * r->d; i++) { r->theta[i] += error[i / r->d] * gain[i % r->d]; }
}

static wide trace_of_wide(const wide *M, size_t d) {
	wide sum = 0;
	for (size_t i = 0; i < d; i++) { sum += M[i * d + i]; }
	return sum;
}

/* own: period, min_trace; memory: samples since the last reset */
static void update_reset(reference *r, const wide *zeta, const wide *error) {
	learn_by_information(r, 1, zeta, error);
	r->memory[0] += 1;
	const int late = r->own[0] > 0 && r->memory[0] > r->own[0] - (wide)0.5;
	if (!late && trace_of_wide(r->P, r->d) >= r->own[1] * r->p0 * (wide)r->d) { return; }
	set_identity(r->P, r->p0, r->d);
	set_identity(r->R, 1 / r->p0, r->d);
	r->memory[0] = 0;
}

/* own: fast, slow, eta; memory: samples, and the two means */
static void update_vrf(reference *r, const wide *zeta, const wide *error) {
	wide square = 0;
	for (size_t i = 0; i < r->N; i++) { square += error[i] * error[i]; }
	r->memory[0] += 1;
	for (size_t i = 0; i < 2; i++) {
		const wide weight = 1 / fmin(r->memory[0], r->own[i]);
		r->memory[1 + i] = (1 - weight) * r->memory[1 + i] + weight * square;
	}
	const wide ratio = r->memory[2] > 0 ? sqrt(r->memory[1] / r->memory[2]) : 1;
	learn_by_information(r, fmax(r->lambda, 1 / (1 + r->own[2] * fmax(0, ratio - 1))), zeta, error);
}

/* own: p_inf; memory: the direction that is next. R is that before the sample, so it forgets for the next one. */
static void update_resetting(reference *r, int cyclic, const wide *zeta, const wide *error) {
	const wide p_inf = r->own[0] > 0 ? r->own[0] : r->p0;
	learn_by_information(r, 1, zeta, error);
	for (size_t i = 0; i < r->d * r->d; i++) { r->R[i] *= r->lambda; }
	for (size_t i = 0; i < r->d; i++) {
		const int next = !cyclic || fabs(r->memory[0] - (wide)i) < (wide)0.5;
		const wide share = cyclic ? 1 - pow(r->lambda, (wide)r->d) : 1 - r->lambda;
		r->R[i * r->d + i] += next ? share / p_inf : 0;
	}
	r->memory[0] = fmod(r->memory[0] + 1, (wide)r->d);
	invert_information(r);
}

/* own: min_square */
static void update_kulhavy(reference *r, const wide *zeta, const wide *error) {
	wide gain[MAX_D], square = 0;
	const wide s = times(r->P, zeta, r->d, gain);
	for (size_t i = 0; i < r->N * r->d; i++) { r->theta[i] += error[i / r->d] * gain[i % r->d] / (1 + s); }
	for (size_t i = 0; i < r->d; i++) { square += zeta[i] * zeta[i]; }
	if (square < r->own[0] || !(s > 0)) { return; }
	add_outer(r->R, r->lambda - (1 - r->lambda) / s, zeta, r->d);
	invert_information(r);
}

/* own: k0 */
static void update_bgf(reference *r, const wide *zeta, const wide *error) {
	const wide k0 = r->own[0] > 0 ? r->own[0] : r->p0 * (wide)r->d;
	const wide rate = (1 - r->lambda) * (1 - trace_of_wide(r->P, r->d) / k0);
	learn_by_information(r, 1 - fmax(rate, 0), zeta, error);
}

/* Returns 1 if the regulator is one of these. */
static int update_of_other_papers(reference *r, const wide *zeta, const wide *error) {
	if (strcmp(r->regulator, "reset") == 0) {
		update_reset(r, zeta, error);
	} else if (strcmp(r->regulator, "vrf") == 0) {
		update_vrf(r, zeta, error);
	} else if (strcmp(r->regulator, "er") == 0 || strcmp(r->regulator, "cr") == 0) {
		update_resetting(r, r->regulator[0] == 'c', zeta, error);
	} else if (strcmp(r->regulator, "kulhavy") == 0) {
		update_kulhavy(r, zeta, error);
	} else if (strcmp(r->regulator, "bgf") == 0) {
		update_bgf(r, zeta, error);
	} else {
		return 0;
	}
	return 1;
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
	if (update_of_other_papers(r, zeta, error)) { return 0; }

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
