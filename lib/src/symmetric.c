/* Symmetric d x d matrices. With vector registers they are stored in full, as KOOP_PAD(d) rows of
 * KOOP_PAD(d). Without, they are stored as a triangle whose tiles on the diagonal are complete, which halves
 * the work. Elements beyond d are zero. Both layouts apply the same operations in the same order to each
 * element, and the same to (i, j) as to (j, i). */

#if VECTORS

/* Index of element (i, j), j <= i. */
static size_t symmetric_at(size_t i, size_t j, size_t rows) {
	return i * rows + j;
}

/* Distance in storage from diagonal element i - 1 to diagonal element i. */
static size_t symmetric_step(size_t i, size_t rows) {
	(void)i;
	return rows + 1;
}

/* Number of elements of row i that are stored on both sides of the diagonal. */
static size_t symmetric_twice(size_t i) {
	return i;
}

/* y = M x */
static KERNEL void symmetric_times(real *restrict y, const real *restrict M, const real *restrict x,
                                   size_t rows) {
	weighted_rows(y, M, x, rows, rows);
}

/* M += sign v v' */
static KERNEL void symmetric_add(real *restrict M, real sign, const real *restrict v, size_t rows) {
	add_outer(M, sign, v, v, rows, rows);
}

static COLD void set_pair(real *M, size_t i, size_t j, size_t rows, real value) {
	M[i * rows + j] = M[j * rows + i] = value;
}

#else

static size_t symmetric_at(size_t i, size_t j, size_t rows) {
	(void)rows;
	return TRIANGLE_AT(i, j);
}

static size_t symmetric_step(size_t i, size_t rows) {
	(void)rows;
	return diagonal_step(i);
}

static size_t symmetric_twice(size_t i) {
	return i % 4;
}

/* y[0..3] += tile x[0..3] */
static INLINE void add_tile(real *y, const real *tile, const real *x) {
	y[0] += tile[0] * x[0];
	y[1] += tile[4] * x[0];
	y[2] += tile[8] * x[0];
	y[3] += tile[12] * x[0];
	y[0] += tile[1] * x[1];
	y[1] += tile[5] * x[1];
	y[2] += tile[9] * x[1];
	y[3] += tile[13] * x[1];
	y[0] += tile[2] * x[2];
	y[1] += tile[6] * x[2];
	y[2] += tile[10] * x[2];
	y[3] += tile[14] * x[2];
	y[0] += tile[3] * x[3];
	y[1] += tile[7] * x[3];
	y[2] += tile[11] * x[3];
	y[3] += tile[15] * x[3];
}

static KERNEL void symmetric_times(real *restrict y, const real *restrict M, const real *restrict x,
                                   size_t rows) {
	for (size_t i = 0; i < rows; i += 4) {
		real sum[4] = {0, 0, 0, 0};
		for (size_t j = 0; j <= i; j += 4, M += 16) {
			add_tile(sum, M, x + j);
			if (j < i) {
				real other[4] = {y[j], y[j + 1], y[j + 2], y[j + 3]};
				add_transposed_tile(other, M, x + i);
				copy_four(y + j, other);
			}
		}
		copy_four(y + i, sum);
	}
}

static KERNEL void symmetric_add(real *restrict M, real sign, const real *restrict v, size_t rows) {
	for (size_t i = 0; i < rows; i += 4) {
		const real a0 = sign * v[i], a1 = sign * v[i + 1], a2 = sign * v[i + 2], a3 = sign * v[i + 3];
		for (size_t j = 0; j <= i; j += 4, M += 16) {
			add_four(M, a0, v + j);
			add_four(M + 4, a1, v + j);
			add_four(M + 8, a2, v + j);
			add_four(M + 12, a3, v + j);
		}
	}
}

/* Tiles on the diagonal store both halves. */
static COLD void set_pair(real *M, size_t i, size_t j, size_t rows, real value) {
	(void)rows;
	M[TRIANGLE_AT(i, j)] = value;
	if (i / 4 == j / 4) { M[TRIANGLE_AT(j, i)] = value; }
}

#endif

/* Copies row i to column i, so that an asymmetry from a flipped bit does not persist. */
static void symmetric_mirror(real *M, size_t i, size_t rows) {
	real *row = M + symmetric_at(i, i, rows), *column = row;
	for (size_t count = symmetric_twice(i); count > 0; count--) {
		*(column -= symmetric_at(1, 0, rows)) = *--row;
	}
}

/* value I */
static COLD void set_symmetric(real *M, real value, size_t d) {
	const size_t rows = KOOP_PAD(d);
	for (size_t i = 0; i < KOOP_SYMMETRIC(d); i++) { M[i] = 0; }
	for (size_t i = 0; i < d; i++) { M[symmetric_at(i, i, rows)] = value; }
}
