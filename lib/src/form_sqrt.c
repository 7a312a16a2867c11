/* P = S S' with an upper triangular S that has a positive diagonal: P is positive definite despite round-off,
 * and S needs half the exponent range of P.
 *
 * The storage holds S', a lower triangle: its row j is column j of S. The update is Carlson's ("Fast
 * triangular formulation of the square root filter", AIAA Journal 11(9), 1973). */

static COLD size_t sqrt_reals(const KOOP(rls) *rls) {
	return KOOP_TRIANGLE(rls->n_regressors);
}

static COLD void sqrt_reset(KOOP(rls) *rls, real p0) {
	const real root = MATH(sqrt)(p0);
	set_triangle(rls->covariance, root, rls->n_regressors);
	rls->covariance_bound = root;
}

/* f = S' zeta into the first work vector, where sqrt_apply() reads it */
static void sqrt_project(KOOP(rls) *rls) {
	triangle_times(rls->work, rls->covariance, rls->zeta, rls->n_regressors);
}

static real sqrt_gain(KOOP(rls) *rls) {
	sqrt_project(rls);
	triangle_transposed_times(rls->gain, rls->covariance, rls->work, rls->n_regressors);
	return dot(rls->work, rls->work, rls->n_regressors_padded);
}

/* y = S^-1 zeta by back substitution; returns y' y */
static GLUE real sqrt_information(KOOP(rls) *rls) {
	real *y = rls->work + rls->n_regressors_padded;
	copy(y, rls->zeta, rls->n_regressors_padded);
	for (size_t j = rls->n_regressors; j-- > 0;) {
		const real *column = rls->covariance + TRIANGLE_AT(j, 0);
		const real value = y[j] / column[4 * (j - j % 4) + j % 4];
		for (size_t i = 0; i <= j; i += 4) { add_four(y + i, -value, column + 4 * i); }
		y[j] = value;
	}
	return dot(y, y, rls->n_regressors_padded);
}

/* sqrt(a^2 + b^2) for a > 0, without intermediate overflow */
static real root_sum_squares(real a, real b) {
	const real large = max_of(a, MATH(fabs)(b)), small = a > MATH(fabs)(b) ? b : a;
	return large * MATH(sqrt)(1 + (small / large) * (small / large));
}

/* S S' + w w', by rotations of w into the columns of S; overwrites w */
static GLUE void sqrt_add(KOOP(rls) *rls, real *w) {
	for (size_t j = rls->n_regressors; j-- > 0;) {
		real *diagonal = rls->covariance + TRIANGLE_AT(j, j), *element = rls->covariance + TRIANGLE_AT(j, 0);
		const real radius = root_sum_squares(*diagonal, w[j]);
		const real c = *diagonal / radius, s = w[j] / radius;
		for (size_t i = 0; i < j; i++, element += i % 4 ? 1 : 13) {
			const real t = *element;
			*element = c * t + s * w[i];
			w[i] = c * w[i] - s * t;
		}
		*diagonal = radius;
	}
}

/* column = c column - e b,  b += f column, both from the old column; four elements */
static INLINE void carlson_four(real *column, real *b, real c, real e, real f) {
	const real old[4] = {column[0], column[1], column[2], column[3]};
	column[0] = c * old[0] - e * b[0];
	column[1] = c * old[1] - e * b[1];
	column[2] = c * old[2] - e * b[2];
	column[3] = c * old[3] - e * b[3];
	add_four(b, f, old);
}

/* S S' = (S S' - g g' / (noise + s)) root_scale^2, from f = S' zeta; b is scratch. Out of line: its many registers
 * would be saved below what else sqrt_apply() calls. */
static OUT_OF_LINE HOT void carlson(real *restrict S, const real *restrict f, real *restrict b, real noise,
                                    real root_scale, size_t d) {
	for (size_t j = 0; j < d; j += 2) {
		real *column = S + TRIANGLE_AT(j, 0);
		const real f0 = f[j], f1 = f[j + 1];
		const real n0 = noise + f0 * f0, n1 = n0 + f1 * f1;
		const real c0 = MATH(sqrt)(noise / n0), c1 = MATH(sqrt)(n0 / n1);
		const real e0 = f0 / (n0 * c0), e1 = f1 / (n1 * c1);
		noise = n1;
		if (j % 4 == 0) { b[j] = b[j + 1] = b[j + 2] = b[j + 3] = 0; }
		for (size_t i = 0; i <= j; i += 4, column += 16) {
			carlson_four(column, b + i, c0 * root_scale, e0 * root_scale, f0);
			carlson_four(column + 4, b + i, c1 * root_scale, e1 * root_scale, f1);
		}
	}
}

/* Checks that the trace can be scaled to step->trace. An update without scale reduces the trace by a factor
 * of noise / denominator at most. Neither the trace, nor the factor that restores it, nor the smallest
 * diagonal element may leave the range of `real`. Squares below REAL_MIN may be missing from the sum of
 * `size` squares; the condition on it keeps three quarters of the trace. */
static int sqrt_trace_limits(const KOOP(step) *step, real trace, size_t size, real denominator,
                             real smallest) {
	const real wanted = step->trace / trace;
	if (!(trace < REAL_MAX)) { return KOOP_E_OVERFLOW; }
	if (!(wanted * (denominator / step->noise) < REAL_MAX)) { return KOOP_E_OVERFLOW; }
	if (!(trace * (step->noise / denominator) >= 4 * (real)size * REAL_MIN)) { return KOOP_E_INDEFINITE; }
	return smallest * MATH(sqrt)(wanted) >= REAL_MIN ? KOOP_OK : KOOP_E_INDEFINITE;
}

/* The new bound of S's elements, or the status that refuses the update; S is not changed. No row of S grows
 * by more than `growth`. The square of a diagonal element shrinks by a factor of noise / denominator at most. Out of
 * line, as carlson(). */
static OUT_OF_LINE GLUE int sqrt_limits(const KOOP(rls) *rls, const KOOP(step) *step, real denominator, real growth,
                                        real *bound) {
	const size_t d = rls->n_regressors, size = KOOP_TRIANGLE(d);
	const real *S = rls->covariance, *diagonal = S;
	const real root_scale = MATH(sqrt)(step->scale);
	real smallest = REAL_MAX;
	*bound = root_scale * (rls->covariance_bound + growth);
	if (!(*bound < REAL_MAX / 2)) {
		*bound = root_scale * (max_abs(S, size) * MATH(sqrt)((real)d) + growth);
		if (!(*bound < REAL_MAX / 2)) { return KOOP_E_OVERFLOW; }
	}
	for (size_t j = 0; j < d; diagonal += diagonal_step(++j)) {
		smallest = *diagonal < smallest ? *diagonal : smallest;
	}
	smallest *= MATH(sqrt)(step->noise / denominator);
	if (!(smallest >= REAL_MIN)) { return KOOP_E_INDEFINITE; }
	if (step->trace > 0) { return sqrt_trace_limits(step, dot(S, S, size), size, denominator, smallest); }
	return KOOP_OK;
}

/* S S' + root^2 v v'. Out of line, as carlson(). */
static OUT_OF_LINE GLUE void sqrt_grow(KOOP(rls) *rls, real root, const real *v) {
	real *up = rls->work + 2 * rls->n_regressors_padded;
	scaled(up, root, v, rls->n_regressors_padded);
	sqrt_add(rls, up);
	sqrt_project(rls);
}

static GLUE int sqrt_apply(KOOP(rls) *rls, const KOOP(step) *step, real denominator) {
	const size_t d = rls->n_regressors, rows = rls->n_regressors_padded, size = KOOP_TRIANGLE(d);
	real *S = rls->covariance, *f = rls->work, *b = rls->work + rows;
	/* with a negative denominator P grows along the gain, and with f = 0 nothing is subtracted */
	const int grows = denominator < 0;
	const real *along = grows ? rls->gain : rls->zeta;
	const real root = MATH(sqrt)(grows ? -denominator : step->inflate);
	const real growth = root > 0 ? root * max_abs(along, d) : 0;
	real bound;
	const int status = sqrt_limits(rls, step, denominator, growth, &bound);
	if (status != KOOP_OK) { return status; }

	if (root > 0) { sqrt_grow(rls, root, along); }
	if (grows) { scaled(f, 0, f, rows); }
	carlson(S, f, b, step->noise, MATH(sqrt)(step->scale), d);
	if (step->trace > 0) {
		scaled(S, MATH(sqrt)(step->trace / dot(S, S, size)), S, size);
		bound = MATH(sqrt)(step->trace) * 2;
	}
	rls->covariance_bound = bound;
	rls->positive_definite = 1; /* corrects a flipped bit; it is 1 otherwise */
	return KOOP_OK;
}

static COLD real sqrt_element(const KOOP(rls) *rls, size_t i, size_t j) {
	real sum = 0;
	for (size_t k = i > j ? i : j; k < rls->n_regressors; k++) {
		sum += rls->covariance[TRIANGLE_AT(k, i)] * rls->covariance[TRIANGLE_AT(k, j)];
	}
	return sum;
}

static void sqrt_diagonal(const KOOP(rls) *rls, real *diagonal) {
	triangle_square_diagonal(diagonal, rls->covariance, rls->n_regressors);
}

static COLD size_t sqrt_triangles(const KOOP(rls) *rls) {
	(void)rls;
	return 1;
}

static COLD real sqrt_get(const KOOP(rls) *rls, size_t triangle, size_t i, size_t j) {
	(void)triangle;
	return rls->covariance[TRIANGLE_AT(i, j)];
}

static COLD void sqrt_set(KOOP(rls) *rls, size_t triangle, size_t i, size_t j, real value) {
	(void)triangle;
	rls->covariance[TRIANGLE_AT(i, j)] = value;
}

const KOOP(form) KOOP(form_sqrt) = {
    "sqrt",       sqrt_reals,    sqrt_reset,     sqrt_gain, sqrt_information, sqrt_apply,
    sqrt_element, sqrt_diagonal, sqrt_triangles, sqrt_get,  sqrt_set,         NULL,
};
