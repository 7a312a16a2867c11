/* P itself, d rows of KOOP_PAD(d). Every update adds v v' and scales, element
 * (i, j) by the same operations as (j, i), so P is symmetric bit for bit. The
 * textbook's P - K (zeta' P) is not, and ends in NaN from round-off alone.
 *
 * Squares: P, then P^-1 for a regulator that needs it, then the factor of the
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
	rls->covariance_bound = p0;
	if (rls->config.regulator->needs_information) { set_diagonal(rls, plain_inverse(rls), 1 / p0); }
}

static real plain_gain(KOOP(rls) *rls) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	weighted_rows(rls->gain, rls->covariance, rls->zeta, d, rows);
	return dot(rls->gain, rls->zeta, rows);
}

/* Leaves P^-1 zeta in the first work vector, for plain_apply(). */
static real plain_information(KOOP(rls) *rls) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	weighted_rows(rls->work, plain_inverse(rls), rls->zeta, d, rows);
	return dot(rls->work, rls->zeta, rows);
}

/* What is to become of M: (M + sign v v' + up up') scale. */
typedef struct KOOP(change) {
	const real *v;
	const real *up; /* may be null */
	real sign;
	real scale;
} KOOP(change);

static real changed(const KOOP(change) *c, const real *M, size_t i, size_t j, size_t rows) {
	const real up = c->up ? M[i * rows + j] + c->up[i] * c->up[j] : M[i * rows + j];
	return (up + c->sign * c->v[i] * c->v[j]) * c->scale;
}

static void change_rows(const KOOP(change) *c, real *restrict M, size_t count, size_t rows) {
	const real scale = c->scale;
	const real *restrict v = c->v;
	for (size_t j = 0; j < count; j++, M += rows) {
		const real a = c->sign * v[j];
		if (c->up) { add_scaled(M, c->up[j], c->up, rows); }
		for (size_t i = 0; i < rows; i += 4) {
			M[i] = (M[i] + a * v[i]) * scale;
			M[i + 1] = (M[i + 1] + a * v[i + 1]) * scale;
			M[i + 2] = (M[i + 2] + a * v[i + 2]) * scale;
			M[i + 3] = (M[i + 3] + a * v[i + 3]) * scale;
		}
	}
}

/* Cholesky factor of what P would become, with the diagonal lowered by d epsilon
 * of itself: what is definite by less is not told from round-off, neither that
 * of P nor that of the factorisation. */
static int stays_positive_definite(const KOOP(rls) *rls, const KOOP(change) *c) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	const real kept = 1 - (real)d * REAL_EPSILON;
	real *factor = plain_factor(rls);
	for (size_t i = 0; i < d; i++) {
		real *row = factor + i * rows;
		for (size_t j = 0; j < i; j++) {
			const real *other = factor + j * rows;
			row[j] = (changed(c, rls->covariance, i, j, rows) - dot(row, other, j)) / other[j];
		}
		const real diagonal = changed(c, rls->covariance, i, i, rows);
		const real pivot = kept * diagonal - dot(row, row, i);
		if (!(pivot > 0)) { return 0; }
		row[i] = MATH(sqrt)(pivot);
	}
	return 1;
}

static int plain_apply(KOOP(rls) *rls, const KOOP(step) *step, real denominator) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	real *P = rls->covariance;
	real *inverse_zeta = rls->work, *v = rls->work + rows, *up = rls->work + 2 * rows;
	KOOP(change) change = {v, NULL, denominator > 0 ? (real)-1 : (real)1, step->scale};

	const real root = MATH(sqrt)(MATH(fabs)(denominator));
	for (size_t i = 0; i < rows; i++) { v[i] = rls->gain[i] * root; }
	if (step->inflate > 0) {
		const real root_inflate = MATH(sqrt)(step->inflate);
		for (size_t i = 0; i < rows; i++) { up[i] = rls->zeta[i] * root_inflate; }
		change.up = up;
	}

	/* the diagonal first: it is cheap and tells most of what can go wrong */
	real trace = 0, least = REAL_MAX, largest_v = 0, largest_up = 0;
	for (size_t i = 0; i < d; i++) {
		const real diagonal = changed(&change, P, i, i, rows);
		trace += diagonal;
		if (diagonal < least) { least = diagonal; }
		largest_v = max_of(largest_v, MATH(fabs)(v[i]));
		largest_up = max_of(largest_up, change.up ? MATH(fabs)(up[i]) : 0);
	}
	if (step->trace > 0) {
		if (!(trace > 0)) { return KOOP_E_INDEFINITE; }
		change.scale = step->trace / trace;
	}

	/* |P[i,j]| is bounded without a look at all of P, as long as the bound is far from overflow */
	const real growth = largest_v * largest_v + largest_up * largest_up;
	real bound = (rls->covariance_bound + growth) * change.scale;
	if (!(bound < REAL_MAX / 2)) { bound = (max_abs(P, plain_square(rls)) + growth) * change.scale; }
	if (!is_finite(trace) || !(bound < REAL_MAX / 2)) { return KOOP_E_OVERFLOW; }

	int positive_definite = least > 0;
	if (positive_definite && rls->config.check != KOOP_CHECK_DIAGONAL) {
		positive_definite = stays_positive_definite(rls, &change);
	}
	if (!positive_definite && rls->config.check != KOOP_CHECK_REPORT) { return KOOP_E_INDEFINITE; }

	if (rls->config.regulator->needs_information) {
		/* paper, SIFt: R = R - (1 - lambda) / rho (R zeta)(R zeta)' + zeta zeta' */
		const real part = MATH(sqrt)(step->inflate * rls->config.lambda);
		for (size_t i = 0; i < rows; i++) { inverse_zeta[i] *= part; }
		const KOOP(change) dual = {inverse_zeta, rls->zeta, -1, 1};
		change_rows(&dual, plain_inverse(rls), d, rows);
	}
	change_rows(&change, P, d, rows);
	rls->covariance_bound = bound;
	rls->positive_definite = positive_definite;
	return KOOP_OK;
}

static real plain_element(const KOOP(rls) *rls, size_t i, size_t j) {
	return rls->covariance[i * rls->n_regressors_padded + j];
}

const KOOP(form) KOOP(form_plain) = {
    "plain", plain_squares, plain_reset, plain_gain, plain_information, plain_apply, plain_element,
};
