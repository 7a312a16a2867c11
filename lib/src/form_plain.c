/* P = scale * M with a symmetric M: forgetting then changes one number instead of all of M. Every update adds
 * a multiple of v v' to M, so P is symmetric bit for bit. The textbook's P - K (P zeta)' is not symmetric,
 * and diverges to NaN from round-off alone.
 *
 * The storage holds M, P^-1 if the regulator needs it, and scratch for the check. */

static size_t plain_size(const KOOP(rls) *rls) {
	return KOOP_SYMMETRIC(rls->n_regressors);
}

/* Number of reals of scratch for the check. */
static COLD size_t plain_scratch(const KOOP(rls) *rls) {
	return rls->config.check != KOOP_CHECK_DIAGONAL ? KOOP_TRIANGLE(rls->n_regressors) : 0u;
}

static COLD size_t plain_reals(const KOOP(rls) *rls) {
	return (rls->config.regulator->needs_information ? 2u : 1u) * plain_size(rls) + plain_scratch(rls);
}

static real *plain_inverse(const KOOP(rls) *rls) {
	return rls->covariance + plain_size(rls);
}

static real *plain_factor(const KOOP(rls) *rls) {
	return rls->covariance + (rls->config.regulator->needs_information ? 2u : 1u) * plain_size(rls);
}

static COLD void plain_reset(KOOP(rls) *rls, real p0) {
	set_symmetric(rls->covariance, p0, rls->n_regressors);
	rls->covariance_scale = 1;
	rls->covariance_bound = p0;
	rls->mirrored = 0;
	if (rls->config.regulator->needs_information) {
		set_symmetric(plain_inverse(rls), 1 / p0, rls->n_regressors);
	}
}

static real plain_gain(KOOP(rls) *rls) {
	const size_t rows = rls->n_regressors_padded;
	symmetric_times(rls->gain, rls->covariance, rls->zeta, rows);
	return scaled_dot(rls->gain, rls->covariance_scale, rls->zeta, rows);
}

/* Leaves P^-1 zeta in the first work vector, for plain_apply(). */
static GLUE real plain_information(KOOP(rls) *rls) {
	const size_t rows = rls->n_regressors_padded;
	symmetric_times(rls->work, plain_inverse(rls), rls->zeta, rows);
	return dot(rls->work, rls->zeta, rows);
}

/* A change of M: M + up up' + sign v v'. */
typedef struct KOOP(change) {
	const real *v;
	const real *up; /* may be null */
	real sign;
} KOOP(change);

static void change_all(const KOOP(change) *c, real *M, size_t rows) {
	if (c->up) { symmetric_add(M, 1, c->up, rows); }
	symmetric_add(M, c->sign, c->v, rows);
}

/* Smallest diagonal element, and trace, of the changed M. */
static KERNEL real smallest_diagonal(const KOOP(rls) *rls, const KOOP(change) *c, real *trace) {
	const real *element = rls->covariance, *v = c->v, *up = c->up;
	const real sign = c->sign;
	real smallest = REAL_MAX, sum = 0;
	for (size_t i = 0; i < rls->n_regressors; element += symmetric_step(++i, rls->n_regressors_padded)) {
		const real before = up ? *element + up[i] * up[i] : *element;
		const real value = before + sign * v[i] * v[i];
		smallest = value < smallest ? value : smallest;
		sum += value;
	}
	*trace = sum;
	return smallest;
}

/* Writes one tile of the changed M, column by column. */
static KERNEL void changed_tile(const KOOP(change) *c, real *restrict tile, const real *restrict M, size_t i,
                                size_t j, size_t rows) {
	const real *row = M + symmetric_at(i, j, rows);
	for (size_t r = 0; r < 4; r++, row += symmetric_at(1, 0, rows), i++, tile++) {
		real sum[4];
		copy_four(sum, row);
		if (c->up) { add_four(sum, c->up[i], c->up + j); }
		add_four(sum, c->sign * c->v[i], c->v + j);
		tile[0] = sum[0];
		tile[4] = sum[1];
		tile[8] = sum[2];
		tile[12] = sum[3];
	}
}

/* Writes the changed M, with its diagonal reduced by the relative amount d epsilon, to the tiles that are factored.
 * Out of line, as carlson() is. */
static OUT_OF_LINE HOT void write_lowered(real *tile, const KOOP(rls) *rls, const KOOP(change) *c) {
	const size_t rows = rls->n_regressors_padded;
	const real lowered = (real)rls->n_regressors * REAL_EPSILON;
	for (size_t i = 0; i < rows; i += 4) {
		for (size_t j = 0; j <= i; j += 4, tile += 16) { changed_tile(c, tile, rls->covariance, i, j, rows); }
		real *last = tile - 16; /* the tile on the diagonal */
		for (size_t k = 0; k < 4; k++) { last[5 * k] -= lowered * last[5 * k]; }
	}
}

/* Returns 1 if the changed P is positive definite even when lowered. A smaller margin cannot be distinguished from the
 * round-off of P and of the factorisation. */
static int stays_definite(const KOOP(rls) *rls, const KOOP(change) *c) {
	write_lowered(plain_factor(rls), rls, c);
	return factor_triangle(plain_factor(rls), rls->n_regressors);
}

/* The new scale of P and the new bound of M's elements, or the status that refuses them. */
static GLUE int plain_limits(const KOOP(rls) *rls, const KOOP(step) *step, real trace, real growth,
                             real *scale, real *bound) {
	*scale = rls->covariance_scale * step->scale;
	if (step->trace > 0) {
		if (!is_finite(trace)) { return KOOP_E_OVERFLOW; }
		if (!(trace > 0)) { return KOOP_E_INDEFINITE; }
		*scale = step->trace / trace;
		if (!(*scale >= REAL_MIN)) { return KOOP_E_INDEFINITE; } /* some vector units flush less to 0 */
	}
	/* M is searched for its largest element only if the bound comes near overflow */
	*bound = rls->covariance_bound + growth;
	if (!(*bound * *scale < REAL_MAX / 2)) { *bound = max_abs(rls->covariance, plain_size(rls)) + growth; }
	return *bound * *scale < REAL_MAX / 2 ? KOOP_OK : KOOP_E_OVERFLOW;
}

/* Beyond this factor the scale is multiplied into M. */
#define PLAIN_SCALE_MAX 1024

static OUT_OF_LINE GLUE void plain_set_scale(KOOP(rls) *rls, real scale, real bound) {
	const int near_one = scale > (real)1 / PLAIN_SCALE_MAX && scale < PLAIN_SCALE_MAX;
	if (!near_one) { scaled(rls->covariance, scale, rls->covariance, plain_size(rls)); }
	rls->covariance_scale = near_one ? scale : 1;
	rls->covariance_bound = near_one ? bound : bound * scale;
}

/* Changes P^-1, from P^-1 zeta in the first work vector. Paper, SIFt:
 * R = R - (1 - lambda) / rho (R zeta)(R zeta)' + zeta zeta' */
static GLUE void plain_change_inverse(KOOP(rls) *rls, const KOOP(step) *step) {
	const size_t rows = rls->n_regressors_padded;
	const KOOP(change) dual = {rls->work, rls->zeta, -1};
	scaled(rls->work, MATH(sqrt)(step->deflate), rls->work, rows);
	change_all(&dual, plain_inverse(rls), rows);
}

/* Makes one row symmetric per update, and so all of P within d updates. */
static OUT_OF_LINE void plain_mirror(KOOP(rls) *rls) {
	const size_t rows = rls->n_regressors_padded, next = rls->mirrored + 1;
	rls->mirrored = next < rls->n_regressors ? next : 0;
	symmetric_mirror(rls->covariance, rls->mirrored, rows);
	if (rls->config.regulator->needs_information) {
		symmetric_mirror(plain_inverse(rls), rls->mirrored, rows);
	}
}

static GLUE int plain_apply(KOOP(rls) *rls, const KOOP(step) *step, real denominator) {
	const size_t rows = rls->n_regressors_padded;
	const real old_scale = rls->covariance_scale, size = MATH(fabs)(denominator) / old_scale;
	real *v = rls->work + rows, *up = rls->work + 2 * rows;
	KOOP(change) change = {v, NULL, denominator > 0 ? (real)-1 : (real)1};
	/* squares of the gain may have underflowed where size is large */
	real trace, scale, bound, growth = (rls->gain_square + KOOP_MAX_DIM * REAL_MIN) * size;

	scaled(v, MATH(sqrt)(size), rls->gain, rows);
	if (step->inflate > 0) {
		scaled(up, MATH(sqrt)(step->inflate / old_scale), rls->zeta, rows);
		change.up = up;
		growth += dot(up, up, rows);
	}

	/* the diagonal first: it is cheap and reveals most failures */
	const real smallest = smallest_diagonal(rls, &change, &trace);
	const int status = plain_limits(rls, step, trace, growth, &scale, &bound);
	if (status != KOOP_OK) { return status; }
	const int positive_definite = smallest >= REAL_MIN && smallest * scale >= REAL_MIN &&
	                              (rls->config.check == KOOP_CHECK_DIAGONAL || stays_definite(rls, &change));
	if (!positive_definite && rls->config.check != KOOP_CHECK_REPORT) { return KOOP_E_INDEFINITE; }

	if (rls->config.regulator->needs_information) { plain_change_inverse(rls, step); }
	change_all(&change, rls->covariance, rows);
	plain_mirror(rls);
	plain_set_scale(rls, scale, bound);
	rls->positive_definite = positive_definite;
	return KOOP_OK;
}

static COLD real plain_element(const KOOP(rls) *rls, size_t i, size_t j) {
	const size_t at = symmetric_at(i < j ? j : i, i < j ? i : j, rls->n_regressors_padded);
	return rls->covariance[at] * rls->covariance_scale;
}

static void plain_diagonal(const KOOP(rls) *rls, real *diagonal) {
	const size_t rows = rls->n_regressors_padded;
	const real scale = rls->covariance_scale;
	for (size_t i = 0; i < rows; i += 4) {
		const real *tile = rls->covariance + symmetric_at(i, i, rows);
		const size_t next = symmetric_at(1, 1, rows);
		diagonal[i] = tile[0] * scale;
		diagonal[i + 1] = tile[next] * scale;
		diagonal[i + 2] = tile[2 * next] * scale;
		diagonal[i + 3] = tile[3 * next] * scale;
	}
}

static COLD size_t plain_triangles(const KOOP(rls) *rls) {
	return rls->config.regulator->needs_information ? 2 : 1;
}

static COLD real plain_get(const KOOP(rls) *rls, size_t triangle, size_t i, size_t j) {
	const size_t at = symmetric_at(i, j, rls->n_regressors_padded);
	return triangle == 0 ? rls->covariance[at] * rls->covariance_scale : plain_inverse(rls)[at];
}

static COLD void plain_set(KOOP(rls) *rls, size_t triangle, size_t i, size_t j, real value) {
	set_pair(triangle == 0 ? rls->covariance : plain_inverse(rls), i, j, rls->n_regressors_padded, value);
}

const KOOP(form) KOOP(form_plain) = {
    "plain",       plain_reals,    plain_reset,     plain_gain, plain_information, plain_apply,
    plain_element, plain_diagonal, plain_triangles, plain_get,  plain_set,         plain_scratch,
};
