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
 * The papers state R = P^-1. P is not computed by inverting R: where no type is wider than double, the inverse would
 * have larger errors than the library. It follows from the matrix inversion lemma, and a test multiplies the two. */

static void set_identity(wide *M, wide value, size_t d) {
	for (size_t i = 0; i < d * d; i++) { M[i] = i % (d + 1) == 0 ? value : 0; }
}

/* R = lambda R + weight x x' */
static void add_information(reference *r, wide lambda, wide weight, const wide *x) {
	wide Px[MAX_D];
	const wide s = times(r->P, x, r->d, Px);
	add_outer(r->P, -weight / (lambda + weight * s), Px, r->d);
	for (size_t i = 0; i < r->d * r->d; i++) {
		r->P[i] /= lambda;
		r->R[i] *= lambda;
	}
	add_outer(r->R, weight, x, r->d);
}

/* R = lambda R + weight I, so P = (lambda I + weight P)^-1 P, where the two factors commute */
static void add_identity(reference *r, wide lambda, wide weight) {
	static wide factor[MAX_D * MAX_D];
	const size_t d = r->d;
	for (size_t i = 0; i < d * d; i++) {
		factor[i] = weight * r->P[i] + (i % (d + 1) == 0 ? lambda : 0);
		r->R[i] = lambda * r->R[i] + (i % (d + 1) == 0 ? weight : 0);
	}
	solve_positive_definite(factor, d, r->P, d);
	for (size_t i = 0; i < d * d; i++) { r->P[i] = r->P[i / d < i % d ? i % d * d + i / d : i]; }
}

/* Theta += error (P zeta)' with the P of R = lambda R + zeta zeta' */
static void learn_theta(reference *r, wide lambda, const wide *zeta, const wide *error) {
	wide gain[MAX_D];
	const wide s = times(r->P, zeta, r->d, gain);
	for (size_t i = 0; i < r->N * r->d; i++) { r->theta[i] += error[i / r->d] * gain[i % r->d] / (lambda + s); }
}

static void learn(reference *r, wide lambda, const wide *zeta, const wide *error) {
	learn_theta(r, lambda, zeta, error);
	add_information(r, lambda, 1, zeta);
}

static wide trace_of_wide(const wide *M, size_t d) {
	wide sum = 0;
	for (size_t i = 0; i < d; i++) { sum += M[i * d + i]; }
	return sum;
}

/* own: period, min_trace; memory: samples since the last reset */
static void update_reset(reference *r, const wide *zeta, const wide *error) {
	learn(r, 1, zeta, error);
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
	learn(r, fmax(r->lambda, 1 / (1 + r->own[2] * fmax(0, ratio - 1))), zeta, error);
}

/* own: p_inf. R is that before the sample, so it forgets for the next one. */
static void update_er(reference *r, const wide *zeta, const wide *error) {
	const wide p_inf = r->own[0] > 0 ? r->own[0] : r->p0;
	learn(r, 1, zeta, error);
	add_identity(r, r->lambda, (1 - r->lambda) / p_inf);
}

/* own: p_inf; memory: the direction that is next. As er, one direction in turn. */
static void update_cr(reference *r, const wide *zeta, const wide *error) {
	const wide p_inf = r->own[0] > 0 ? r->own[0] : r->p0;
	wide next[MAX_D];
	for (size_t i = 0; i < r->d; i++) { next[i] = fabs(r->memory[0] - (wide)i) < (wide)0.5 ? 1 : 0; }
	learn(r, 1, zeta, error);
	add_information(r, r->lambda, (1 - pow(r->lambda, (wide)r->d)) / p_inf, next);
	r->memory[0] = fmod(r->memory[0] + 1, (wide)r->d);
}

/* own: min_square */
static void update_kulhavy(reference *r, const wide *zeta, const wide *error) {
	wide Pz[MAX_D], square = 0;
	const wide s = times(r->P, zeta, r->d, Pz);
	learn_theta(r, 1, zeta, error);
	for (size_t i = 0; i < r->d; i++) { square += zeta[i] * zeta[i]; }
	if (square < r->own[0] || !(s > 0)) { return; }
	add_information(r, 1, r->lambda - (1 - r->lambda) / s, zeta);
}

/* own: k0 */
static void update_bgf(reference *r, const wide *zeta, const wide *error) {
	const wide k0 = r->own[0] > 0 ? r->own[0] : r->p0 * (wide)r->d;
	const wide rate = (1 - r->lambda) * (1 - trace_of_wide(r->P, r->d) / k0);
	learn(r, 1 - fmax(rate, 0), zeta, error);
}

/* Returns 1 if the regulator is one of these. */
static int update_of_other_papers(reference *r, const wide *zeta, const wide *error) {
	if (strcmp(r->regulator, "reset") == 0) {
		update_reset(r, zeta, error);
	} else if (strcmp(r->regulator, "vrf") == 0) {
		update_vrf(r, zeta, error);
	} else if (strcmp(r->regulator, "er") == 0) {
		update_er(r, zeta, error);
	} else if (strcmp(r->regulator, "cr") == 0) {
		update_cr(r, zeta, error);
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
	add_outer(r->R, 1 / noise, zeta, d);
	for (size_t i = 0; i < d * d; i++) {
		r->P[i] *= scale;
		r->R[i] /= scale;
	}
	return 0;
}
