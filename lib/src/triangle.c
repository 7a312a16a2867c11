/* Triangular d x d matrices in tiles of 4 x 4. The tiles are stored row by row up to the diagonal, and each
 * tile is stored row by row: a tile is processed while its sums or weights stay in registers. Elements above
 * the diagonal and beyond d are zero. Vectors are padded to a multiple of four. */

#include "triangle.h"

/* value I */
static COLD void set_triangle(real *L, real value, size_t d) {
	for (size_t i = 0; i < KOOP_TRIANGLE(d); i++) { L[i] = 0; }
	for (size_t i = 0; i < d; i++) { L[TRIANGLE_AT(i, i)] = value; }
}

/* Distance in storage from diagonal element i - 1 to diagonal element i. */
static size_t diagonal_step(size_t i) {
	return i % 4 ? 5 : 4 * i + 1;
}

/* y[0..3] += tile' x[0..3] */
static INLINE void add_transposed_tile(real *y, const real *tile, const real *x) {
	add_four(y, x[0], tile);
	add_four(y, x[1], tile + 4);
	add_four(y, x[2], tile + 8);
	add_four(y, x[3], tile + 12);
}

/* y = L x */
static KERNEL void triangle_times(real *restrict y, const real *restrict L, const real *restrict x,
                                  size_t d) {
	for (size_t i = 0; i < d; i += 4) {
		real sum0[4] = {0, 0, 0, 0}, sum1[4] = {0, 0, 0, 0}, sum2[4] = {0, 0, 0, 0}, sum3[4] = {0, 0, 0, 0};
		for (size_t j = 0; j <= i; j += 4, L += 16) {
			add_products(sum0, L, x + j);
			add_products(sum1, L + 4, x + j);
			add_products(sum2, L + 8, x + j);
			add_products(sum3, L + 12, x + j);
		}
		y[i] = sum_of_four(sum0);
		y[i + 1] = sum_of_four(sum1);
		y[i + 2] = sum_of_four(sum2);
		y[i + 3] = sum_of_four(sum3);
	}
}

/* y = L' x */
static KERNEL void triangle_transposed_times(real *restrict y, const real *restrict L, const real *restrict x,
                                             size_t d) {
	for (size_t i = 0; i < d; i += 4) {
		y[i] = y[i + 1] = y[i + 2] = y[i + 3] = 0;
		for (size_t j = 0; j <= i; j += 4, L += 16) {
			real sum[4] = {y[j], y[j + 1], y[j + 2], y[j + 3]};
			add_transposed_tile(sum, L, x + i);
			copy_four(y + j, sum);
		}
	}
}

/* y = diagonal of L' L */
static KERNEL void triangle_square_diagonal(real *restrict y, const real *restrict L, size_t d) {
	for (size_t i = 0; i < d; i += 4) {
		y[i] = y[i + 1] = y[i + 2] = y[i + 3] = 0;
		for (size_t j = 0; j <= i; j += 4) {
			for (size_t k = 0; k < 4; k++, L += 4) { add_products(y + j, L, L); }
		}
	}
}

/* ---- Cholesky factor of a positive definite matrix, in place ------------------------
 *
 * The tiles are stored column by column here. The diagonal of the factor holds the inverse pivots. */

/* tile -= A' B over `count` columns. If `diagonal` is not null, the result is then solved with that tile. */
static KERNEL void factor_tile(real *restrict tile, const real *restrict A, const real *restrict B,
                               size_t count, const real *restrict diagonal) {
	real x0[4], x1[4], x2[4], x3[4];
	copy_four(x0, tile);
	copy_four(x1, tile + 4);
	copy_four(x2, tile + 8);
	copy_four(x3, tile + 12);
	for (; count > 0; count--, A += 4, B += 4) {
		subtract_four(x0, A[0], B);
		subtract_four(x1, A[1], B);
		subtract_four(x2, A[2], B);
		subtract_four(x3, A[3], B);
	}
	if (diagonal) {
		scale_four(x0, diagonal[0], x0);
		subtract_four(x1, diagonal[1], x0);
		subtract_four(x2, diagonal[2], x0);
		subtract_four(x3, diagonal[3], x0);
		scale_four(x1, diagonal[5], x1);
		subtract_four(x2, diagonal[6], x1);
		subtract_four(x3, diagonal[7], x1);
		scale_four(x2, diagonal[10], x2);
		subtract_four(x3, diagonal[11], x2);
		scale_four(x3, diagonal[15], x3);
	}
	copy_four(tile, x0);
	copy_four(tile + 4, x1);
	copy_four(tile + 8, x2);
	copy_four(tile + 12, x3);
}

/* Factors the first n columns of a tile on the diagonal. Returns 1 if its pivots are positive. */
static int factor_diagonal(real *tile, size_t n) {
	for (size_t k = 0; k < 4; k++) {
		real *column = tile + 4 * k;
		if (k < n && !(column[k] > 0)) { return 0; }
		const real inverse = k < n ? 1 / MATH(sqrt)(column[k]) : 0;
		scale_four(column, inverse, column);
		column[k] = inverse;
		for (size_t l = k + 1; l < 4; l++) { subtract_four(tile + 4 * l, column[l], column); }
	}
	return 1;
}

/* Returns 1 if the matrix is positive definite. Overwrites it with its factor. */
static int factor_triangle(real *L, size_t d) {
	for (size_t i = 0; i < d; i += 4) {
		real *row = L + TRIANGLE_AT(i, 0);
		for (size_t j = 0; j < i; j += 4) {
			const real *above = L + TRIANGLE_AT(j, 0);
			factor_tile(row + 4 * j, above, row, j, above + 4 * j);
		}
		factor_tile(row + 4 * i, row, row, i, NULL);
		if (!factor_diagonal(row + 4 * i, d - i)) { return 0; }
	}
	return 1;
}
