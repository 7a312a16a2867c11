/* Vector kernels. A `rows` length is a multiple of four, with zeros in the
 * padding, and the loops are written out by four: in-order cores then overlap
 * the operations, and compilers turn each group into vector instructions
 * already at -O2. */

/* Where a compiler would merge functions, and with them their stack, or make a copy
 * for a constant argument that it then spoils. */
#if defined(__clang__)
#define OUT_OF_LINE __attribute__((noinline))
#elif defined(__GNUC__)
#define OUT_OF_LINE __attribute__((noinline, noclone))
#else
#define OUT_OF_LINE
#endif

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

/* y += a x */
static void add_scaled(real *restrict y, real a, const real *restrict x, size_t n) {
	size_t i = 0;
	for (; i + 4 <= n; i += 4) {
		y[i] += a * x[i];
		y[i + 1] += a * x[i + 1];
		y[i + 2] += a * x[i + 2];
		y[i + 3] += a * x[i + 3];
	}
	for (; i < n; i++) { y[i] += a * x[i]; }
}

/* y = x */
static void copy(real *restrict y, const real *restrict x, size_t n) {
	size_t i = 0;
	for (; i + 4 <= n; i += 4) {
		y[i] = x[i];
		y[i + 1] = x[i + 1];
		y[i + 2] = x[i + 2];
		y[i + 3] = x[i + 3];
	}
	for (; i < n; i++) { y[i] = x[i]; }
}

/* y = x - y */
static void subtract_from(real *restrict y, const real *restrict x, size_t n) {
	size_t i = 0;
	for (; i + 4 <= n; i += 4) {
		y[i] = x[i] - y[i];
		y[i + 1] = x[i + 1] - y[i + 1];
		y[i + 2] = x[i + 2] - y[i + 2];
		y[i + 3] = x[i + 3] - y[i + 3];
	}
	for (; i < n; i++) { y[i] = x[i] - y[i]; }
}

/* y = a x, rows; y may be x */
static void scaled(real *y, real a, const real *x, size_t rows) {
	for (size_t i = 0; i < rows; i += 4) {
		const real x0 = x[i], x1 = x[i + 1], x2 = x[i + 2], x3 = x[i + 3];
		y[i] = a * x0;
		y[i + 1] = a * x1;
		y[i + 2] = a * x2;
		y[i + 3] = a * x3;
	}
}

/* Matrices of `count` rows, each of length `rows`, are worked in blocks of
 * columns that stay in registers down all rows. Each lane is written out, and
 * the loop down the rows counts elements: compilers then make vectors of the
 * lanes and leave the loop alone. */
#define LANES_4(DO) DO(0) DO(1) DO(2) DO(3)
#define LANES_8(DO) LANES_4(DO) DO(4) DO(5) DO(6) DO(7)
#define LANES_12(DO) LANES_8(DO) DO(8) DO(9) DO(10) DO(11)
#define LANES_16(DO) LANES_8(DO) DO(8) DO(9) DO(10) DO(11) DO(12) DO(13) DO(14) DO(15)
#define LANES_24(DO) LANES_16(DO) DO(16) DO(17) DO(18) DO(19) DO(20) DO(21) DO(22) DO(23)

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
static void weighted_rows(real *restrict y, const real *restrict M, const real *restrict x, size_t count,
                          size_t rows) {
	const size_t size = count * rows;
	size_t i = 0;
	SUM_COLUMNS(24)
	SUM_COLUMNS(8)
	SUM_COLUMNS(4)
}

#define OUTER_BEGIN(lane) const real y##lane = y[i + lane];
#define OUTER_ADD(lane) row[lane] += a * y##lane;
#define OUTER_SUBTRACT(lane) row[lane] -= a * y##lane;
#define OUTER_COLUMNS(width, CHANGE) OUTER_COLUMNS_(width, CHANGE)
#define OUTER_COLUMNS_(width, CHANGE)                                                                        \
	for (; i + width <= rows; i += width) {                                                                  \
		LANES_##width(OUTER_BEGIN) const real *weight = x;                                                   \
		for (size_t k = i; k < size; k += rows) {                                                            \
			const real a = *weight++;                                                                        \
			real *row = M + k;                                                                               \
			LANES_##width(CHANGE)                                                                            \
		}                                                                                                    \
	}

/* M += x y' */
static void add_outer(real *restrict M, const real *restrict x, const real *restrict y, size_t count,
                      size_t rows) {
	const size_t size = count * rows;
	size_t i = 0;
	OUTER_COLUMNS(OUTER_WIDTH, OUTER_ADD)
	OUTER_COLUMNS(8, OUTER_ADD)
	OUTER_COLUMNS(4, OUTER_ADD)
}

/* M -= x y' */
static void subtract_outer(real *restrict M, const real *restrict x, const real *restrict y, size_t count,
                           size_t rows) {
	const size_t size = count * rows;
	size_t i = 0;
	OUTER_COLUMNS(OUTER_WIDTH, OUTER_SUBTRACT)
	OUTER_COLUMNS(8, OUTER_SUBTRACT)
	OUTER_COLUMNS(4, OUTER_SUBTRACT)
}
