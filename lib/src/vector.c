/* Vector kernels. A `rows` length is a multiple of four, with zeros in the
 * padding, and the loops are written out by four: in-order cores then overlap
 * the operations, and compilers turn each group into vector instructions
 * already at -O2. */

static int is_finite(real a) {
	return a - a == 0;
}

static int all_finite(const real *x, size_t n) {
	for (size_t i = 0; i < n; i++) {
		if (!is_finite(x[i])) { return 0; }
	}
	return 1;
}

static real max_of(real a, real b) {
	return a > b ? a : b;
}

/* max |x[i]| */
static real max_abs(const real *x, size_t n) {
	real largest = 0;
	for (size_t i = 0; i < n; i++) { largest = max_of(largest, MATH(fabs)(x[i])); }
	return largest;
}

/* x' y */
static real dot(const real *restrict x, const real *restrict y, size_t n) {
	real sum[4] = {0, 0, 0, 0};
	size_t i = 0;
	for (; i + 4 <= n; i += 4) {
		sum[0] += x[i] * y[i];
		sum[1] += x[i + 1] * y[i + 1];
		sum[2] += x[i + 2] * y[i + 2];
		sum[3] += x[i + 3] * y[i + 3];
	}
	for (; i < n; i++) { sum[0] += x[i] * y[i]; }
	return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* y += a x, rows */
static void add_scaled(real *restrict y, real a, const real *restrict x, size_t rows) {
	for (size_t i = 0; i < rows; i += 4) {
		y[i] += a * x[i];
		y[i + 1] += a * x[i + 1];
		y[i + 2] += a * x[i + 2];
		y[i + 3] += a * x[i + 3];
	}
}

/* y = M' x for `count` rows M, each of length `rows` */
static void weighted_rows(real *restrict y, const real *restrict M, const real *restrict x, size_t count,
                          size_t rows) {
	size_t i = 0;
	for (; i + 8 <= rows; i += 8) {
		real s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
		const real *row = M + i;
		for (size_t j = 0; j < count; j++, row += rows) {
			const real a = x[j];
			s0 += a * row[0];
			s1 += a * row[1];
			s2 += a * row[2];
			s3 += a * row[3];
			s4 += a * row[4];
			s5 += a * row[5];
			s6 += a * row[6];
			s7 += a * row[7];
		}
		y[i] = s0;
		y[i + 1] = s1;
		y[i + 2] = s2;
		y[i + 3] = s3;
		y[i + 4] = s4;
		y[i + 5] = s5;
		y[i + 6] = s6;
		y[i + 7] = s7;
	}
	if (i < rows) {
		real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
		const real *row = M + i;
		for (size_t j = 0; j < count; j++, row += rows) {
			const real a = x[j];
			s0 += a * row[0];
			s1 += a * row[1];
			s2 += a * row[2];
			s3 += a * row[3];
		}
		y[i] = s0;
		y[i + 1] = s1;
		y[i + 2] = s2;
		y[i + 3] = s3;
	}
}
