/* Vector kernels. A length called `rows` is a multiple of four, with zeros in the padding. The loops are
 * unrolled by four: in-order cores then overlap the operations, and compilers vectorise each group even at
 * -O2. */

#define VECTORS KOOP_VECTORS

/* On processors without vectors, flash is small. GLUE, the code between the kernels, is then optimised for
 * size and KERNEL for speed. */
#if VECTORS
#define GLUE
#define KERNEL
#else
#define GLUE COLD
#define KERNEL OUT_OF_LINE HOT
#endif

static int all_finite(const real *x, size_t n) {
	for (; n > 0; n--, x++) {
		if (!is_finite(*x)) { return 0; }
	}
	return 1;
}

static int is_zero(real a) {
	return (bits_of(a) & ~SIGN_BIT) == 0;
}

/* Returns 1 if the bits of a and b differ. */
static int bits_differ(real a, real b) {
	return bits_of(a) != bits_of(b);
}

/* Both checks of a setting return 0 for NaN. */
static int is_nonnegative(real a) {
	return a >= 0 && is_finite(a);
}

static int is_within(real a, real low, real below) {
	return a >= low && a < below;
}

static real max_of(real a, real b) {
	return a > b ? a : b;
}

/* max |x[i]| */
static COLD real max_abs(const real *x, size_t n) {
	real largest = 0;
	for (size_t i = 0; i < n; i++) { largest = max_of(largest, MATH(fabs)(x[i])); }
	return largest;
}

/* The functions named .._four work on four consecutive elements. y += a x */
static INLINE void add_four(real *y, real a, const real *x) {
	y[0] += a * x[0];
	y[1] += a * x[1];
	y[2] += a * x[2];
	y[3] += a * x[3];
}

/* y -= a x */
static INLINE void subtract_four(real *y, real a, const real *x) {
	y[0] -= a * x[0];
	y[1] -= a * x[1];
	y[2] -= a * x[2];
	y[3] -= a * x[3];
}

/* sum[i] += x[i] y[i] */
static INLINE void add_products(real *sum, const real *x, const real *y) {
	sum[0] += x[0] * y[0];
	sum[1] += x[1] * y[1];
	sum[2] += x[2] * y[2];
	sum[3] += x[3] * y[3];
}

/* y = x */
static INLINE void copy_four(real *y, const real *x) {
	y[0] = x[0];
	y[1] = x[1];
	y[2] = x[2];
	y[3] = x[3];
}

/* y = a x; y may be x */
static INLINE void scale_four(real *y, real a, const real *x) {
	const real x0 = x[0], x1 = x[1], x2 = x[2], x3 = x[3];
	y[0] = a * x0;
	y[1] = a * x1;
	y[2] = a * x2;
	y[3] = a * x3;
}

static INLINE real sum_of_four(const real *x) {
	return (x[0] + x[1]) + (x[2] + x[3]);
}

/* x' y */
static KERNEL real dot(const real *restrict x, const real *restrict y, size_t n) {
	real sum[4] = {0, 0, 0, 0};
	for (; n >= 4; n -= 4, x += 4, y += 4) { add_products(sum, x, y); }
	for (; n > 0; n--) { sum[0] += *x++ * *y++; }
	return sum_of_four(sum);
}

/* y += a x */
static KERNEL void add_scaled(real *restrict y, real a, const real *restrict x, size_t n) {
	for (; n >= 4; n -= 4, x += 4, y += 4) { add_four(y, a, x); }
	for (; n > 0; n--) { *y++ += a * *x++; }
}

/* y = x */
static KERNEL void copy(real *restrict y, const real *restrict x, size_t n) {
	for (; n >= 4; n -= 4, x += 4, y += 4) { copy_four(y, x); }
	for (; n > 0; n--) { *y++ = *x++; }
}

/* y = x - y; returns y' y */
static KERNEL real subtract_from(real *restrict y, const real *restrict x, size_t n) {
	real sum[4] = {0, 0, 0, 0};
	for (; n >= 4; n -= 4, x += 4, y += 4) {
		y[0] = x[0] - y[0];
		y[1] = x[1] - y[1];
		y[2] = x[2] - y[2];
		y[3] = x[3] - y[3];
		add_products(sum, y, y);
	}
	for (; n > 0; n--, y++) {
		*y = *x++ - *y;
		sum[0] += *y * *y;
	}
	return sum_of_four(sum);
}

/* y = a x, rows; y may be x */
static KERNEL void scaled(real *y, real a, const real *x, size_t rows) {
	for (size_t i = 0; i < rows; i += 4) { scale_four(y + i, a, x + i); }
}

/* y = a y, rows; returns y' x. x may be y */
static KERNEL real scaled_dot(real *y, real a, const real *x, size_t rows) {
	real sum[4] = {0, 0, 0, 0};
	for (size_t i = 0; i < rows; i += 4) {
		scale_four(y + i, a, y + i);
		add_products(sum, y + i, x + i);
	}
	return sum_of_four(sum);
}

#define LANES_4(DO) DO(0) DO(1) DO(2) DO(3)
#define LANES_8(DO) LANES_4(DO) DO(4) DO(5) DO(6) DO(7)
#define LANES_12(DO) LANES_8(DO) DO(8) DO(9) DO(10) DO(11)
#define LANES_16(DO) LANES_8(DO) DO(8) DO(9) DO(10) DO(11) DO(12) DO(13) DO(14) DO(15)
#define LANES_24(DO) LANES_16(DO) DO(16) DO(17) DO(18) DO(19) DO(20) DO(21) DO(22) DO(23)

#if VECTORS

/* A matrix of `count` rows, each of length `rows`, is processed in blocks of columns that stay in registers
 * over all rows. Each lane is written out, and the loop over the rows counts elements: compilers then
 * vectorise the lanes and not the loop. */

#define SUM_BEGIN(lane) real s##lane = 0;
#define SUM_ADD(lane) s##lane += a * row[lane];
#define SUM_END(lane) y[i + lane] = s##lane;
#define SUM_COLUMNS(width)                                                                                   \
	for (; i + width <= rows; i += width) {                                                                  \
		LANES_##width(SUM_BEGIN) const real *weight = x;                                                     \
		for (size_t k = i; k < size; k += rows) {                                                            \
			const real a = *weight++;                                                                        \
			const real *row = M + k;                                                                         \
			LANES_##width(SUM_ADD)                                                                           \
		}                                                                                                    \
		LANES_##width(SUM_END)                                                                               \
	}

/* y = M' x */
static KERNEL void weighted_rows(real *restrict y, const real *restrict M, const real *restrict x,
                                 size_t count, size_t rows) {
	const size_t size = count * rows;
	size_t i = 0;
	SUM_COLUMNS(24)
	SUM_COLUMNS(8)
	SUM_COLUMNS(4)
}

#define OUTER_BEGIN(lane) const real y##lane = scale * y[i + lane];
#define OUTER_ADD(lane) row[lane] += a * y##lane;
#define OUTER_COLUMNS(width) OUTER_COLUMNS_(width)
#define OUTER_COLUMNS_(width)                                                                                \
	for (; i + width <= rows; i += width) {                                                                  \
		LANES_##width(OUTER_BEGIN) const real *weight = x;                                                   \
		for (size_t k = i; k < size; k += rows) {                                                            \
			const real a = *weight++;                                                                        \
			real *row = M + k;                                                                               \
			LANES_##width(OUTER_ADD)                                                                         \
		}                                                                                                    \
	}

/* M += scale x y' */
static KERNEL void add_outer(real *restrict M, real scale, const real *restrict x, const real *restrict y,
                             size_t count, size_t rows) {
	const size_t size = count * rows;
	size_t i = 0;
	OUTER_COLUMNS(OUTER_WIDTH)
	OUTER_COLUMNS(8)
	OUTER_COLUMNS(4)
}

#else

/* The same with 8 or 4 columns in registers and two rows per iteration. `count` is even, or a row of zeros
 * follows. */

/* y = M' x */
static KERNEL void weighted_rows(real *restrict y, const real *restrict M, const real *restrict x,
                                 size_t count, size_t rows) {
	size_t i = 0;
	for (; i + 8 <= rows; i += 8) {
		real sum0[4] = {0, 0, 0, 0}, sum1[4] = {0, 0, 0, 0};
		const real *row = M + i, *next = row + rows;
		for (size_t k = 0; k < count; k += 2, row += 2 * rows, next += 2 * rows) {
			add_four(sum0, x[k], row);
			add_four(sum1, x[k], row + 4);
			add_four(sum0, x[k + 1], next);
			add_four(sum1, x[k + 1], next + 4);
		}
		copy_four(y + i, sum0);
		copy_four(y + i + 4, sum1);
	}
	for (; i < rows; i += 4) {
		real sum0[4] = {0, 0, 0, 0};
		const real *row = M + i, *next = row + rows;
		for (size_t k = 0; k < count; k += 2, row += 2 * rows, next += 2 * rows) {
			add_four(sum0, x[k], row);
			add_four(sum0, x[k + 1], next);
		}
		copy_four(y + i, sum0);
	}
}

/* M += scale x y' */
static KERNEL void add_outer(real *restrict M, real scale, const real *restrict x, const real *restrict y,
                             size_t count, size_t rows) {
	size_t i = 0;
	for (; i + 8 <= rows; i += 8) {
		real *row = M + i, *next = row + rows;
		for (size_t k = 0; k < count; k += 2, row += 2 * rows, next += 2 * rows) {
			const real a = scale * x[k], b = scale * x[k + 1];
			add_four(row, a, y + i);
			add_four(row + 4, a, y + i + 4);
			add_four(next, b, y + i);
			add_four(next + 4, b, y + i + 4);
		}
	}
	for (; i < rows; i += 4) {
		real *row = M + i, *next = row + rows;
		for (size_t k = 0; k < count; k += 2, row += 2 * rows, next += 2 * rows) {
			const real a = scale * x[k], b = scale * x[k + 1];
			add_four(row, a, y + i);
			add_four(next, b, y + i);
		}
	}
}

#endif
