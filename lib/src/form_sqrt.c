/* P = S S' with S upper triangular and a positive diagonal: P is positive
 * definite whatever the round-off, and S needs half the exponent range of P.
 *
 * Row j of the storage is column j of S, elements 0 to j, zero beyond. The
 * update is Carlson's ("Fast triangular formulation of the square root
 * filter", AIAA Journal 11(9), 1973). */

static size_t sqrt_squares(const KOOP(rls) *rls) {
	(void)rls;
	return 1;
}

static real *sqrt_column(const KOOP(rls) *rls, size_t j) {
	return rls->covariance + j * rls->n_regressors_padded;
}

static void sqrt_reset(KOOP(rls) *rls, real p0) {
	const real root = MATH(sqrt)(p0);
	set_diagonal(rls, rls->covariance, root);
	rls->covariance_bound = root;
}

/* f = S' zeta into the first work vector, where sqrt_apply() takes it up */
static void sqrt_project(KOOP(rls) *rls) {
	for (size_t j = 0; j < rls->n_regressors; j++) {
		rls->work[j] = dot(sqrt_column(rls, j), rls->zeta, KOOP_PAD(j + 1));
	}
}

static real sqrt_gain(KOOP(rls) *rls) {
	const size_t d = rls->n_regressors;
	real *f = rls->work;
	sqrt_project(rls);
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { rls->gain[i] = 0; }
	for (size_t j = 0; j < d; j++) { add_scaled(rls->gain, f[j], sqrt_column(rls, j), KOOP_PAD(j + 1)); }
	return dot(f, f, d);
}

/* y = S^-1 zeta by back substitution, y' y */
static real sqrt_information(KOOP(rls) *rls) {
	real *y = rls->work + rls->n_regressors_padded;
	for (size_t i = 0; i < rls->n_regressors_padded; i++) { y[i] = rls->zeta[i]; }
	for (size_t j = rls->n_regressors; j-- > 0;) {
		const real *column = sqrt_column(rls, j);
		const real value = y[j] / column[j];
		add_scaled(y, -value, column, KOOP_PAD(j + 1));
		y[j] = value;
	}
	return dot(y, y, rls->n_regressors);
}

/* sqrt(a^2 + b^2) for a > 0 without overflow on the way */
static real root_sum_squares(real a, real b) {
	const real large = max_of(a, MATH(fabs)(b)), small = a > MATH(fabs)(b) ? b : a;
	return large * MATH(sqrt)(1 + (small / large) * (small / large));
}

/* S S' + w w', by rotations of w into the columns of S; w is used up */
static void sqrt_add(KOOP(rls) *rls, real *w) {
	for (size_t j = rls->n_regressors; j-- > 0;) {
		real *column = sqrt_column(rls, j);
		const real radius = root_sum_squares(column[j], w[j]);
		const real c = column[j] / radius, s = w[j] / radius;
		for (size_t i = 0; i < j; i++) {
			const real t = column[i];
			column[i] = c * t + s * w[i];
			w[i] = c * w[i] - s * t;
		}
		column[j] = radius;
	}
}

/* column = c column - e b,  b += f column, over the old column */
static void carlson_column(real *restrict column, real *restrict b, real c, real e, real f, size_t rows) {
	for (size_t i = 0; i < rows; i += 4) {
		const real s0 = column[i], s1 = column[i + 1], s2 = column[i + 2], s3 = column[i + 3];
		const real b0 = b[i], b1 = b[i + 1], b2 = b[i + 2], b3 = b[i + 3];
		column[i] = c * s0 - e * b0;
		column[i + 1] = c * s1 - e * b1;
		column[i + 2] = c * s2 - e * b2;
		column[i + 3] = c * s3 - e * b3;
		b[i] = b0 + f * s0;
		b[i + 1] = b1 + f * s1;
		b[i + 2] = b2 + f * s2;
		b[i + 3] = b3 + f * s3;
	}
}

static int sqrt_apply(KOOP(rls) *rls, const KOOP(step) *step, real denominator) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded;
	real *f = rls->work, *b = rls->work + rows, *up = rls->work + 2 * rows;
	const real root_scale = MATH(sqrt)(step->scale);
	const real root_inflate = MATH(sqrt)(step->inflate);

	/* no row of S grows by more than |up|, and no diagonal element shrinks by
	 * more than noise / denominator: known before S is touched */
	const real growth = root_inflate * max_abs(rls->zeta, d);
	real bound = root_scale * (rls->covariance_bound + growth);
	real least = REAL_MAX;
	for (size_t j = 0; j < d; j++) {
		if (sqrt_column(rls, j)[j] < least) { least = sqrt_column(rls, j)[j]; }
	}
	if (!(bound < REAL_MAX / 2)) {
		bound = root_scale * (max_abs(rls->covariance, d * rows) * MATH(sqrt)((real)d) + growth);
	}
	if (!(bound < REAL_MAX / 2)) { return KOOP_E_OVERFLOW; }
	if (!(least * MATH(sqrt)(step->noise / denominator) > 0)) { return KOOP_E_INDEFINITE; }
	if (step->trace > 0) {
		/* an update without scale lowers the trace, by no more than noise / denominator:
		 * neither it nor the factor below may leave the range */
		const real trace = dot(rls->covariance, rls->covariance, d * rows);
		if (!(trace < REAL_MAX)) { return KOOP_E_OVERFLOW; }
		if (!(step->trace / trace * (denominator / step->noise) < REAL_MAX)) { return KOOP_E_OVERFLOW; }
	}

	if (step->inflate > 0) {
		for (size_t i = 0; i < rows; i++) { up[i] = root_inflate * rls->zeta[i]; }
		sqrt_add(rls, up);
		sqrt_project(rls);
	}

	for (size_t i = 0; i < rows; i++) { b[i] = 0; }
	real before = step->noise;
	for (size_t j = 0; j < d; j++) {
		const real after = before + f[j] * f[j];
		const real c = MATH(sqrt)(before / after);
		const real e = f[j] / (after * c);
		carlson_column(sqrt_column(rls, j), b, c * root_scale, e * root_scale, f[j], KOOP_PAD(j + 1));
		before = after;
	}

	if (step->trace > 0) {
		const real trace = dot(rls->covariance, rls->covariance, d * rows);
		const real factor = MATH(sqrt)(step->trace / trace);
		for (size_t i = 0; i < d * rows; i++) { rls->covariance[i] *= factor; }
		bound = MATH(sqrt)(step->trace) * 2;
	}
	rls->covariance_bound = bound;
	return KOOP_OK;
}

static real sqrt_element(const KOOP(rls) *rls, size_t i, size_t j) {
	real sum = 0;
	for (size_t k = i > j ? i : j; k < rls->n_regressors; k++) {
		sum += sqrt_column(rls, k)[i] * sqrt_column(rls, k)[j];
	}
	return sum;
}

const KOOP(form) KOOP(form_sqrt) = {
    "sqrt", sqrt_squares, sqrt_reset, sqrt_gain, sqrt_information, sqrt_apply, sqrt_element,
};
