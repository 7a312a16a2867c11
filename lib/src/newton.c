/* Newton steps over the free inputs, with an upper Cholesky factor of their Hessian, packed by rows.
 *
 * The Hessian is close to block Toeplitz: H[a, b] - H[a-1, b-1] is the sum of x[a]' x[b] over the rows x of a
 * generator. These rows are those of chol(Q)' G and, in the first blocks, of chol(R)' and chol(S)'. An
 * orthogonal transformation of the rows eliminates block column a in all but m of them. Those m are the rows
 * of the factor for block a, and the Schur complement has the same generator with the m rows shifted by one
 * block (generalised Schur algorithm, Kailath and Sayed 1995). A leading block in which every input is free
 * therefore costs O(V) instead of O(V^2). With reversed time the leading blocks are the end of the horizon,
 * where bounds are rarely active. The rest of the Schur complement is formed from its generator by the same
 * recursion along diagonals, and is factored as a dense matrix.
 *
 * An input that reaches a bound is removed from the factor by rotations of the rows below its own. */

static unsigned in_factor(int set) {
	return ~(unsigned)set & 1;
}

static size_t generator_rows(const KOOP(mpc_config) *c) {
	return c->n_states + (c->S ? 2 : 1) * c->n_inputs;
}

static real *generator_row(const KOOP(mpc) *mpc, size_t i) {
	return mpc->generator + i * padded(mpc->config.horizon * mpc->config.n_inputs);
}

OUT_OF_LINE static void generate(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, V = c->horizon * m;
	const real *root_r = mpc->roots, *root_s = root_r + m * m, *root_q = root_s + m * m;
	for (size_t i = 0; i < generator_rows(c) * padded(V) + WINDOW; i++) { mpc->generator[i] = 0; }
	for (size_t e = 0; e < m; e++) {
		for (size_t j = 0; j < m; j++) {
			generator_row(mpc, e)[j] = root_r[j * m + e];
			if (!c->S) { continue; }
			generator_row(mpc, m + n + e)[j] = root_s[j * m + e];
			if (V > m) { generator_row(mpc, m + n + e)[m + j] = -root_s[j * m + e]; }
		}
	}
	for (size_t i = 0; i < n * n; i++) {
		const real root = root_q[i];
		if (is_zero(root)) { continue; }
		for (size_t j = 0; j < m; j++) {
			const real *from = markov_row(mpc, i / n, j);
			real *to = generator_row(mpc, m + i % n) + j;
			for (size_t a = 0; a < c->horizon; a++) { to[a * m] += root * from[a]; }
		}
	}
}

#define MIX_BEGIN(lane) real s##lane = 0;
#define MIX_ADD(lane) s##lane += a * from[lane];
#define MIX_SCALE(lane) s##lane *= scale;
#define MIX_STORE(lane) from[lane] += a * s##lane;

/* Applies I + scale normal normal' to n rows, in a number of columns that is rounded up to a multiple of
 * eight. */
OUT_OF_LINE static void mix_rows(real *first, const real *normal, real scale, size_t n, ptrdiff_t stride,
                                 size_t columns) {
	for (const real *end = first + columns; first < end; first += WINDOW) {
		real *from = first;
		const real *const last = normal + n;
		LANES_8(MIX_BEGIN)
		for (const real *x = normal; x < last; from += stride) {
			const real a = *x++;
			LANES_8(MIX_ADD)
		}
		LANES_8(MIX_SCALE)
		from = first;
		for (const real *x = normal; x < last; from += stride) {
			const real a = *x++;
			LANES_8(MIX_STORE)
		}
	}
}

/* Householder reflection of the generator's rows from j on, over the columns from q on: column q becomes zero
 * in all of them but row j. */
static void reflect(KOOP(mpc) *mpc, size_t j, size_t q) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs, count = generator_rows(&mpc->config);
	real *top = generator_row(mpc, j), *normal = mpc->work;
	real below = 0;
	for (size_t i = j + 1; i < count; i++) {
		normal[i] = generator_row(mpc, i)[q];
		below += normal[i] * normal[i];
	}
	const real x = top[q], negligible = REAL_EPSILON * x;
	if (!(below > negligible * negligible)) { return; }
	const real norm = MATH(sqrt)(x * x + below);
	normal[j] = x > 0 ? -below / (x + norm) : x - norm;
	const real scale = -2 / (normal[j] * normal[j] + below);
	mix_rows(top + q, normal + j, scale, count - j, (ptrdiff_t)padded(V), V - q);
}

/* Row k of the packed triangle begins at its diagonal, which is stored inverted. The returned pointer is
 * indexed by column. */
static INLINE real *factor_row(const KOOP(mpc) *mpc, size_t k) {
	return mpc->factor + (k * mpc->n_free - k * (k + 1) / 2);
}

/* Row r of the factor = the elements of full[0..] that belong to free inputs from q on. */
static void pack_row(KOOP(mpc) *mpc, size_t r, const real *full, size_t q) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real *row = factor_row(mpc, r) + r;
	if (mpc->n_free == V) {
		copy(row, full, V - q);
		return;
	}
	for (const signed char *set = mpc->set + q, *end = mpc->set + V; set < end;) {
		const real element = *full++;
		if (*set++ == FREE) { *row++ = element; }
	}
}

/* Factors the leading blocks whose inputs are all free. *lead: their number of inputs. */
OUT_OF_LINE static int factor_leading(KOOP(mpc) *mpc, size_t *lead) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	*lead = 0;
	while (*lead < V && mpc->set[*lead] == FREE) { ++*lead; }
	*lead -= *lead % m;
	for (size_t q = 0; q < *lead; q += m) {
		for (size_t j = 0; j < m; j++) {
			reflect(mpc, j, q + j);
			pack_row(mpc, q + j, generator_row(mpc, j) + q + j, q + j);
			real *diagonal = factor_row(mpc, q + j) + q + j;
			if (is_zero(*diagonal)) { return KOOP_E_INDEFINITE; }
			*diagonal = 1 / *diagonal;
		}
		for (size_t j = 0; j < m; j++) {
			real *row = generator_row(mpc, j);
			for (size_t k = V; k-- > q + m;) { row[k] = row[k - m]; }
		}
	}
	return KOOP_OK;
}

/* The other rows are factored four at a time: the contribution of the rows above to a 4 x 4 block is summed
 * in registers. */
#define GROUP KOOP_MPC_GROUP
#define SQUARE_ROW(DO, i) DO(i, 0) DO(i, 1) DO(i, 2) DO(i, 3)
#define SQUARE(DO) SQUARE_ROW(DO, 0) SQUARE_ROW(DO, 1) SQUARE_ROW(DO, 2) SQUARE_ROW(DO, 3)
#define SQUARE_BEGIN(i, lane) real s##i##lane = 0;
#define SQUARE_ADD(i, lane) s##i##lane += a##i * there[lane];
#define SQUARE_END(i, lane) sum[i * GROUP + lane] = s##i##lane;

#define GROUP_OF_ROWS(type)                                                                                  \
	type *row0 = factor_row(mpc, r), *row1 = row0 + (mpc->n_free - r - 1);                                   \
	type *row2 = row1 + (mpc->n_free - r - 2), *row3 = row2 + (mpc->n_free - r - 3);

/* sum = the contribution of rows from..r-1 to rows r..r+3 in columns e..e+3 */
OUT_OF_LINE static void square_above(const KOOP(mpc) *mpc, size_t from, size_t r, size_t e,
                                     real *restrict sum) {
	const size_t size = mpc->n_free;
	SQUARE(SQUARE_BEGIN)
	const real *above = factor_row(mpc, from) + r, *there = above + (e - r);
	for (size_t step = size - 1 - from; step > size - 1 - r; step--) {
		const real a0 = above[0], a1 = above[1], a2 = above[2], a3 = above[3];
		SQUARE(SQUARE_ADD)
		above += step;
		there += step;
	}
	SQUARE(SQUARE_END)
}

/* Four columns of a group of rows: x = U'^-1 (x - sum), where U is the group's triangle on the diagonal and
 * `sum` is the contribution of the rows above. */
OUT_OF_LINE static void finish_square(const KOOP(mpc) *mpc, size_t r, size_t e, const real *sum) {
	GROUP_OF_ROWS(real)
	const real u00 = row0[r], u01 = row0[r + 1], u02 = row0[r + 2], u03 = row0[r + 3];
	const real u11 = row1[r + 1], u12 = row1[r + 2], u13 = row1[r + 3];
	const real u22 = row2[r + 2], u23 = row2[r + 3], u33 = row3[r + 3];
	for (const real *end = sum + GROUP; sum < end; sum++, e++) {
		const real x0 = (row0[e] - sum[0]) * u00;
		const real x1 = (row1[e] - sum[GROUP] - u01 * x0) * u11;
		const real x2 = (row2[e] - sum[2 * GROUP] - u02 * x0 - u12 * x1) * u22;
		row3[e] = (row3[e] - sum[3 * GROUP] - u03 * x0 - u13 * x1 - u23 * x2) * u33;
		row0[e] = x0;
		row1[e] = x1;
		row2[e] = x2;
	}
}

/* Rows r..r+count-1 hold the Schur complement of the rows before `from`, and become rows of the factor. Only
 * the first group has fewer than four rows, so that the others end with a complete 4 x 4 block. */
OUT_OF_LINE static int factor_group(const KOOP(mpc) *mpc, size_t from, size_t r, size_t count) {
	real *sum = mpc->square, *before = sum + GROUP * GROUP;
	const size_t size = mpc->n_free, end = r == from ? size : r + GROUP;
	for (size_t i = 0; i < count; i++) { before[i] = factor_row(mpc, r + i)[r + i]; }
	square_above(mpc, from, r, r, sum);
	for (size_t i = 0; i < count; i++) {
		real *row = factor_row(mpc, r + i) + r;
		for (size_t k = i; k < count; k++) { row[k] -= sum[i * GROUP + k]; }
		for (size_t k = 0; k < i; k++) {
			const real *above = factor_row(mpc, r + k) + r;
			add_scaled(row + i, -above[i], above + i, end - r - i);
		}
		if (!(row[i] > REAL_EPSILON * before[i])) { return KOOP_E_INDEFINITE; }
		row[i] = 1 / MATH(sqrt)(row[i]);
		for (size_t k = i + 1; k < end - r; k++) { row[k] *= row[i]; }
	}
	for (size_t e = end; e < size; e += GROUP) {
		square_above(mpc, from, r, e, sum);
		finish_square(mpc, r, e, sum);
	}
	return KOOP_OK;
}

#define PAIR_BEGIN(lane) real s##lane = y[lane], t##lane = z[lane];
#define PAIR_ADD_Y(lane) s##lane += a * there[lane];
#define PAIR_ADD_Z(lane) t##lane += b * there[lane];
#define PAIR_END_Y(lane) y[lane] = s##lane;
#define PAIR_END_Z(lane) z[lane] = t##lane;

/* The recursion along diagonals. On entry y and z are two rows of the Schur complement in the previous block;
 * on return they are rows `self` and `other` of this block, whose first column is q. */
OUT_OF_LINE static void add_generated(const KOOP(mpc) *mpc, real *y, real *z, size_t self, size_t other,
                                      size_t q) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs, stride = padded(V);
	const real *from = mpc->generator, *end = from + generator_rows(&mpc->config) * stride;
	while (is_zero(from[self]) && is_zero(from[other]) && from + stride < end) { from += stride; }
	for (; q < V; q += WINDOW, y += WINDOW, z += WINDOW) {
		LANES_8(PAIR_BEGIN)
		for (const real *row = from; row < end; row += stride) {
			const real a = row[self], b = row[other], *there = row + q;
			LANES_8(PAIR_ADD_Y)
			LANES_8(PAIR_ADD_Z)
		}
		LANES_8(PAIR_END_Y)
		LANES_8(PAIR_END_Z)
	}
}

/* Counts the free inputs for a new factor, which has no dropped rows. */
static void count_free(KOOP(mpc) *mpc) {
	mpc->n_free = 0;
	for (size_t q = 0; q < mpc->config.horizon * mpc->config.n_inputs; q++) {
		if (in_factor(mpc->set[q])) { mpc->set[q] /= DROPPED; }
		mpc->n_free += mpc->set[q] == FREE;
	}
}

OUT_OF_LINE static int factor_free(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m, length = padded(V);
	size_t lead, count = 0;
	count_free(mpc);
	generate(mpc);
	int status = factor_leading(mpc, &lead);
	real *rows = mpc->work; /* one block of the Schur complement, from its first column */
	for (size_t q = 0; q < m * length; q++) { rows[q] = 0; }
	for (size_t q = lead, r = lead; r < mpc->n_free && status == KOOP_OK; q += m) {
		for (size_t j = 0; j < m; j += 2) {
			const size_t k = j + 1 < m ? j + 1 : j;
			add_generated(mpc, rows + j * length, rows + k * length, q + j, q + k, q);
		}
		for (size_t j = 0; j < m && status == KOOP_OK; j++) {
			if (mpc->set[q + j] != FREE) { continue; }
			pack_row(mpc, r + count, rows + j * length + j, q + j);
			count++;
			if ((mpc->n_free - r - count) % GROUP == 0) {
				status = factor_group(mpc, lead, r, count);
				r += count;
				count = 0;
			}
		}
	}
	mpc->factored = mpc->fresh = status == KOOP_OK;
	return status;
}

/* Removes row and column p from the matrix that the factor represents. */
OUT_OF_LINE static void drop_row(const KOOP(mpc) *mpc, size_t p) {
	real *out = factor_row(mpc, p);
	for (size_t r = p + 1; r < mpc->n_free; r++) {
		real *row = factor_row(mpc, r);
		const real tangent = out[r] * row[r], cosine = 1 / MATH(sqrt)(1 + tangent * tangent);
		const real sine = tangent * cosine;
		row[r] *= cosine;
		real *x = row + r + 1, *y = out + r + 1;
		for (const real *end = row + mpc->n_free; x < end; x++, y++) {
			const real before = *x;
			*x = cosine * before + sine * *y;
			*y = cosine * *y - sine * before;
		}
	}
	out[p] = 0; /* makes the step of this input 0 */
}

#define ROWS_TAKE(lane)                                                                                      \
	step[e + lane] -=                                                                                        \
	    (x0 * row0[e + lane] + x1 * row1[e + lane]) + (x2 * row2[e + lane] + x3 * row3[e + lane]);

/* step[r + 4..] -= (rows r..r+3)' step[r..r + 3] */
OUT_OF_LINE static void take_rows(const KOOP(mpc) *mpc, size_t r, real *restrict step) {
	GROUP_OF_ROWS(const real)
	const real x0 = step[r], x1 = step[r + 1], x2 = step[r + 2], x3 = step[r + 3];
	for (size_t e = r + GROUP; e < mpc->n_free; e += 4) { LANES_4(ROWS_TAKE) }
}

/* step[r..r + 3] -= (rows r..r+3) step[r + 4..] */
OUT_OF_LINE static void take_columns(const KOOP(mpc) *mpc, size_t r, real *step) {
	GROUP_OF_ROWS(const real)
	real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
	for (size_t e = r + GROUP; e < mpc->n_free; e++) {
		const real x = step[e];
		s0 += row0[e] * x;
		s1 += row1[e] * x;
		s2 += row2[e] * x;
		s3 += row3[e] * x;
	}
	step[r] -= s0;
	step[r + 1] -= s1;
	step[r + 2] -= s2;
	step[r + 3] -= s3;
}

/* step = U'^-1 step */
static void substitute_forwards(const KOOP(mpc) *mpc, real *step) {
	const size_t size = mpc->n_free;
	for (size_t r = 0, next; r < size; r = next) {
		next = r + (size - r - 1) % GROUP + 1;
		const int whole = next - r == GROUP;
		const size_t end = whole ? next : size;
		for (size_t i = r; i < next; i++) {
			const real *row = factor_row(mpc, i), x = step[i] * row[i];
			step[i] = x;
			for (size_t k = i + 1; k < end; k++) { step[k] -= x * row[k]; }
		}
		if (whole) { take_rows(mpc, r, step); }
	}
}

/* step = -gradient over the inputs of the factor, in the order of the factor */
static void gather_descent(const KOOP(mpc) *mpc, const real *gradient, real *step) {
	for (size_t q = 0; q < mpc->config.horizon * mpc->config.n_inputs; q++) {
		if (in_factor(mpc->set[q])) { *step++ = -gradient[q]; }
	}
}

/* Moves v, over the free inputs, to where the gradient vanishes. Back substitution runs forwards in time:
 * with `in_box`, an input that reaches its bound stays there, and the later inputs are computed for it.
 * Returns 1 if no input reached a bound. */
static int newton_step(KOOP(mpc) *mpc, real *v, const real *gradient, int in_box) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m, size = mpc->n_free;
	real *step = mpc->work; /* the rows of the Hessian are no longer needed */
	int inside = 1;
	gather_descent(mpc, gradient, step);
	substitute_forwards(mpc, step);
	for (size_t q = V, r = size, j = 0, end = 0; q-- > 0;) {
		j = j > 0 ? j - 1 : m - 1;
		if (!in_factor(mpc->set[q])) { continue; }
		r--;
		if ((size - r - 1) % GROUP == 0) { /* the last row of a group */
			const int whole = r + 1 >= GROUP;
			if (whole) { take_columns(mpc, r + 1 - GROUP, step); }
			end = whole ? r + 1 : size;
		}
		const real *row = factor_row(mpc, r);
		for (size_t k = r + 1; k < end; k++) { step[r] -= row[k] * step[k]; }
		step[r] *= row[r];
		const real from = v[q], to = from + step[r];
		v[q] = in_box ? clip(to, mpc->u_min[j], mpc->u_max[j]) : to;
		if (bits_differ(v[q], to)) {
			step[r] = v[q] - from;
			inside = 0;
		}
	}
	return inside;
}
