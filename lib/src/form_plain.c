/* P = scale * M with M in d rows of KOOP_PAD(d): forgetting then changes one
 * number, not all of M. Every update adds v v' to M, element (i, j) by the same
 * operations as (j, i), so P is symmetric bit for bit. The textbook's
 * P - K (P zeta)' is not, and ends in NaN from round-off alone.
 *
 * Squares: M, then P^-1 for a regulator that needs it, then the factor of the
 * check. */

static size_t plain_square(const KOOP(rls) *rls) {
	return rls->n_regressors * rls->n_regressors_padded;
}

static size_t plain_squares(const KOOP(rls) *rls) {
	return 1u + (rls->config.regulator->needs_information ? 1u : 0u) +
	       (rls->config.check != KOOP_CHECK_DIAGONAL ? 1u : 0u);
}

static real *plain_inverse(const KOOP(rls) *rls) {
	return rls->covariance + plain_square(rls);
}

static real *plain_factor(const KOOP(rls) *rls) {
	return rls->covariance + (plain_squares(rls) - 1u) * plain_square(rls);
}

static void set_diagonal(const KOOP(rls) *rls, real *M, real value) {
	for (size_t i = 0; i < plain_square(rls); i++) { M[i] = 0; }
	for (size_t i = 0; i < rls->n_regressors; i++) { M[i * rls->n_regressors_padded + i] = value; }
}

static void plain_reset(KOOP(rls) *rls, real p0) {
	set_diagonal(rls, rls->covariance, p0);
	rls->covariance_scale = 1;
	rls->covariance_bound = p0;
	if (rls->config.regulator->needs_information) { set_diagonal(rls, plain_inverse(rls), 1 / p0); }
}

static real plain_gain(KOOP(rls) *rls) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	weighted_rows(rls->gain, rls->covariance, rls->zeta, d, rows);
	scaled(rls->gain, rls->covariance_scale, rls->gain, rows);
	return dot(rls->gain, rls->zeta, rows);
}

/* Leaves P^-1 zeta in the first work vector, for plain_apply(). */
static real plain_information(KOOP(rls) *rls) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	weighted_rows(rls->work, plain_inverse(rls), rls->zeta, d, rows);
	return dot(rls->work, rls->zeta, rows);
}

/* What is to become of M: M + up up' + sign v v'. */
typedef struct KOOP(change) {
	const real *v;
	const real *up; /* may be null */
	real sign;
} KOOP(change);

static real changed(const KOOP(change) *c, const real *M, size_t i, size_t j, size_t rows) {
	const real up = c->up ? M[i * rows + j] + c->up[i] * c->up[j] : M[i * rows + j];
	return up + c->sign * c->v[i] * c->v[j];
}

static void change_rows(const KOOP(change) *c, real *M, size_t count, size_t rows) {
	if (c->up) { add_outer(M, c->up, c->up, count, rows); }
	if (c->sign < 0) {
		subtract_outer(M, c->v, c->v, count, rows);
	} else {
		add_outer(M, c->v, c->v, count, rows);
	}
}

/* row = row i of what M would become, from the column `first` on */
static void changed_row(const KOOP(change) *c, real *restrict row, const real *restrict M, size_t i,
                        size_t first, size_t rows) {
	copy(row + first, M + i * rows + first, rows - first);
	if (c->up) { add_scaled(row + first, c->up[i], c->up + first, rows - first); }
	add_scaled(row + first, c->sign * c->v[i], c->v + first, rows - first);
}

/* Cholesky factor of what P would become, upper and row by row, with the
 * diagonal lowered by d epsilon of itself: what is definite by less is not told
 * from round-off, neither that of P nor that of the factorisation. Rows start
 * at a multiple of four; what stands left of their diagonal is not read. */
static int stays_positive_definite(const KOOP(rls) *rls, const KOOP(change) *c) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	const real lowered = (real)d * REAL_EPSILON;
	real *factor = plain_factor(rls);
	for (size_t i = 0; i < d; i++) {
		const size_t first = i / 4 * 4;
		real *row = factor + i * rows;
		changed_row(c, row, rls->covariance, i, first, rows);
		row[i] -= lowered * row[i];
		for (size_t k = 0; k < i; k++) {
			const real *above = factor + k * rows;
			add_scaled(row + first, -above[i], above + first, rows - first);
		}
		if (!(row[i] > 0)) { return 0; }
		scaled(row + first, 1 / MATH(sqrt)(row[i]), row + first, rows - first);
	}
	return 1;
}

/* Smallest diagonal element of what M would become. */
static real least_diagonal(const KOOP(rls) *rls, const KOOP(change) *c) {
	const size_t next = rls->n_regressors_padded + 1;
	const real *diagonal = rls->covariance, *v = c->v, *up = c->up;
	const real sign = c->sign;
	real least = REAL_MAX;
	for (size_t i = 0; i < rls->n_regressors; i++, diagonal += next) {
		const real before = up ? *diagonal + up[i] * up[i] : *diagonal;
		const real value = before + sign * v[i] * v[i];
		least = value < least ? value : least;
	}
	return least;
}

/* Beyond this factor the scale is worked into M. */
#define PLAIN_SCALE_MAX 1024

static int plain_apply(KOOP(rls) *rls, const KOOP(step) *step, real denominator) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	real *M = rls->covariance;
	real *inverse_zeta = rls->work, *v = rls->work + rows, *up = rls->work + 2 * rows;
	KOOP(change) change = {v, NULL, denominator > 0 ? (real)-1 : (real)1};

	const real old_scale = rls->covariance_scale;
	scaled(v, MATH(sqrt)(MATH(fabs)(denominator) / old_scale), rls->gain, rows);
	if (step->inflate > 0) {
		scaled(up, MATH(sqrt)(step->inflate / old_scale), rls->zeta, rows);
		change.up = up;
	}

	real scale = old_scale * step->scale;
	if (step->trace > 0) {
		real trace = 0;
		for (size_t i = 0; i < d; i++) { trace += changed(&change, M, i, i, rows); }
		if (!is_finite(trace)) { return KOOP_E_OVERFLOW; }
		if (!(trace > 0)) { return KOOP_E_INDEFINITE; }
		scale = step->trace / trace;
	}

	/* |M[i,j]| is bounded without a look at all of M, as long as the bound is far from overflow */
	const real growth =
	    rls->gain_square * (MATH(fabs)(denominator) / old_scale) + (change.up ? dot(up, up, rows) : 0);
	real bound = rls->covariance_bound + growth;
	if (!(bound * scale < REAL_MAX / 2)) { bound = max_abs(M, plain_square(rls)) + growth; }
	if (!(bound * scale < REAL_MAX / 2)) { return KOOP_E_OVERFLOW; }

	/* the diagonal first: it is cheap and tells most of what can go wrong */
	const real least = least_diagonal(rls, &change);
	int positive_definite = least > 0 && least * scale > 0; /* the product may underflow */
	if (positive_definite && rls->config.check != KOOP_CHECK_DIAGONAL) {
		positive_definite = stays_positive_definite(rls, &change);
	}
	if (!positive_definite && rls->config.check != KOOP_CHECK_REPORT) { return KOOP_E_INDEFINITE; }

	if (rls->config.regulator->needs_information) {
		/* paper, SIFt: R = R - (1 - lambda) / rho (R zeta)(R zeta)' + zeta zeta' */
		scaled(inverse_zeta, MATH(sqrt)(step->inflate * rls->config.lambda), inverse_zeta, rows);
		const KOOP(change) dual = {inverse_zeta, rls->zeta, -1};
		change_rows(&dual, plain_inverse(rls), d, rows);
	}
	change_rows(&change, M, d, rows);
	rls->covariance_scale = scale;
	rls->covariance_bound = bound;
	rls->positive_definite = positive_definite;
	if (!(scale > (real)1 / PLAIN_SCALE_MAX && scale < PLAIN_SCALE_MAX)) {
		scaled(M, scale, M, d * rows);
		rls->covariance_scale = 1;
		rls->covariance_bound = bound * scale;
	}
	return KOOP_OK;
}

static real plain_element(const KOOP(rls) *rls, size_t i, size_t j) {
	return rls->covariance[i * rls->n_regressors_padded + j] * rls->covariance_scale;
}

const KOOP(form) KOOP(form_plain) = {
    "plain", plain_squares, plain_reset, plain_gain, plain_information, plain_apply, plain_element,
};
