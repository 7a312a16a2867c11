/* Newton steps on the free inputs: an upper Cholesky factor of the Hessian over
 * them, packed by rows.
 *
 * The Hessian is close to block Toeplitz: H[a, b] - H[a-1, b-1] = sum over the rows
 * x of a generator of x[a]' x[b], which are those of chol(Q)' G, and chol(R)' and
 * chol(S)' in the first blocks. After an orthogonal mix of these rows that
 * leaves block column a in m of them alone, those m are the factor's rows of
 * block a, and the Schur complement has the same generator with the m rows
 * moved on by one block (generalised Schur algorithm, Kailath and Sayed 1995).
 * So the leading blocks in which every input is free cost O(V) each, not O(V^2);
 * reversed time makes them the end of the horizon, where bounds seldom act.
 * The rest of the Schur complement comes from its generator by the same
 * recursion along diagonals, and is factored as any matrix is. */

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
	for (size_t i = 0; i < n; i++) {
		for (size_t k = 0; k < n; k++) {
			const real root = root_q[k * n + i];
			if (root != 0) { add_scaled(generator_row(mpc, m + i), root, markov_row(mpc, k), V); }
		}
	}
}

#define MIX_BEGIN(lane) real s##lane = 0;
#define MIX_ADD(lane) s##lane += a * from[lane];
#define MIX_SCALE(lane) s##lane *= scale;
#define MIX_STORE(lane) first[lane] += a * s##lane;

/* Eight columns of n rows += scale normal normal' times them */
OUT_OF_LINE static void mix_rows(real *first, const real *normal, real scale, size_t n, ptrdiff_t stride) {
	LANES_8(MIX_BEGIN)
	const real *from = first;
	for (size_t i = 0; i < n; i++) {
		const real a = normal[i];
		LANES_8(MIX_ADD)
		from += stride;
	}
	LANES_8(MIX_SCALE)
	for (size_t i = 0; i < n; i++) {
		const real a = normal[i];
		LANES_8(MIX_STORE)
		first += stride;
	}
}

/* Mixes the generator's rows from j on so that of column q only row j holds
 * something: a Householder reflection, over all columns from q on. */
static void reflect(KOOP(mpc) *mpc, size_t j, size_t q) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs, count = generator_rows(&mpc->config);
	const ptrdiff_t stride = (ptrdiff_t)padded(V);
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
	for (size_t c = q; c < V; c += WINDOW) { mix_rows(top + c, normal + j, scale, count - j, stride); }
}

/* Row k begins at its own diagonal, which is kept inverted; from this offset on it can be indexed by column.
 */
static size_t packed_offset(size_t k, size_t size) {
	return k * size - k * (k + 1) / 2;
}

/* Row r of the factor = those of full[0..] that belong to free inputs from q on. */
static void pack_row(KOOP(mpc) *mpc, size_t r, const real *full, size_t q) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real *row = mpc->factor + packed_offset(r, mpc->n_free);
	if (mpc->n_free == V) {
		copy(row + r, full, V - q);
		return;
	}
	for (size_t e = r; q < V; q++) {
		row[e] = *full++; /* one too far at the end, where the next row comes */
		e += mpc->set[q] == 0;
	}
}

/* Eliminates the leading blocks whose inputs are all free; *lead: how many inputs. */
OUT_OF_LINE static int factor_leading(KOOP(mpc) *mpc, size_t *lead) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	*lead = 0;
	while (*lead < V && mpc->set[*lead] == 0) { ++*lead; }
	*lead -= *lead % m;
	for (size_t q = 0; q < *lead; q += m) {
		for (size_t j = 0; j < m; j++) {
			reflect(mpc, j, q + j);
			pack_row(mpc, q + j, generator_row(mpc, j) + q + j, q + j);
			real *diagonal = mpc->factor + packed_offset(q + j, mpc->n_free) + q + j;
			if (*diagonal == 0) { return KOOP_E_INDEFINITE; }
			*diagonal = 1 / *diagonal;
		}
		for (size_t j = 0; j < m; j++) {
			real *row = generator_row(mpc, j);
			for (size_t k = V; k-- > q + m;) { row[k] = row[k - m]; }
			for (size_t k = q; k < q + m; k++) { row[k] = 0; }
		}
	}
	return KOOP_OK;
}

/* The other rows are factored four at a time: what the rows above take away from
 * a square of 4 x 4 is summed in registers. */
#define GROUP KOOP_MPC_GROUP
#define SQUARE_ROW(DO, i) DO(i, 0) DO(i, 1) DO(i, 2) DO(i, 3)
#define SQUARE(DO) SQUARE_ROW(DO, 0) SQUARE_ROW(DO, 1) SQUARE_ROW(DO, 2) SQUARE_ROW(DO, 3)
#define SQUARE_BEGIN(i, lane) real s##i##lane = 0;
#define SQUARE_ADD(i, lane) s##i##lane += a##i * there[lane];
#define SQUARE_END(i, lane) sum[i * GROUP + lane] = s##i##lane;

/* sum = what rows from..r-1 take from rows r..r+3 in columns e..e+3 */
OUT_OF_LINE static void square_above(const real *factor, size_t size, size_t from, size_t r, size_t e,
                                     real *restrict sum) {
	SQUARE(SQUARE_BEGIN)
	const real *above = factor + packed_offset(from, size) + r;
	for (size_t step = size - 1 - from; step > size - 1 - r; step--) {
		const real a0 = above[0], a1 = above[1], a2 = above[2], a3 = above[3];
		const real *there = above + (e - r);
		SQUARE(SQUARE_ADD)
		above += step;
	}
	SQUARE(SQUARE_END)
}

/* Rows r..r+count-1 hold the Schur complement of the rows before `from`; they become those of the factor. */
OUT_OF_LINE static int factor_group(const KOOP(mpc) *mpc, size_t from, size_t r, size_t count) {
	real *factor = mpc->factor, *sum = mpc->square, *before = sum + GROUP * GROUP;
	const size_t size = mpc->n_free;
	for (size_t i = 0; i < count; i++) { before[i] = factor[packed_offset(r + i, size) + r + i]; }
	for (size_t e = r; e < size; e += GROUP) {
		const size_t end = e + GROUP < size ? e + GROUP : size;
		square_above(factor, size, from, r, e,
		             sum); /* some lanes are not used, on the diagonal and at the end */
		for (size_t i = 0; i < count; i++) {
			real *row = factor + packed_offset(r + i, size);
			for (size_t k = e > r + i ? e : r + i; k < end; k++) { row[k] -= sum[i * GROUP + k - e]; }
		}
	}
	for (size_t i = 0; i < count; i++) {
		real *row = factor + packed_offset(r + i, size);
		for (size_t k = r; k < r + i; k++) {
			const real *above = factor + packed_offset(k, size);
			add_scaled(row + r + i, -above[r + i], above + r + i, size - r - i);
		}
		if (!(row[r + i] > REAL_EPSILON * before[i])) { return KOOP_E_INDEFINITE; }
		const real inverse = 1 / MATH(sqrt)(row[r + i]);
		row[r + i] = inverse;
		for (size_t k = r + i + 1; k < size; k++) { row[k] *= inverse; }
	}
	return KOOP_OK;
}

/* The row of the Schur complement that belongs to this input, from its block on; to be
 * called for one input after the other. */
OUT_OF_LINE static const real *schur_row(KOOP(mpc) *mpc, size_t self) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m, count = generator_rows(&mpc->config);
	const size_t block = self / m * m;
	real *sum = mpc->work + self % m * padded(V), *column = mpc->work + m * padded(V);
	for (size_t i = 0; i < count; i++) { column[i] = generator_row(mpc, i)[self]; }
	for (size_t q = 0; q < V - block; q += WINDOW) {
		add_windows(sum + q, column, 1, count, mpc->generator + block + q, (ptrdiff_t)padded(V));
	}
	return sum + self % m;
}

OUT_OF_LINE static int factor_free(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	size_t lead, count = 0;
	generate(mpc);
	int status = factor_leading(mpc, &lead);
	for (size_t q = 0; q < m * padded(V); q++) { mpc->work[q] = 0; }
	for (size_t self = lead, r = lead; r < mpc->n_free && status == KOOP_OK; self++) {
		const real *row = schur_row(mpc, self);
		if (mpc->set[self] != 0) { continue; }
		pack_row(mpc, r + count, row, self);
		count++;
		if (count == GROUP || r + count == mpc->n_free) {
			status = factor_group(mpc, lead, r, count);
			r += count;
			count = 0;
		}
	}
	mpc->factored = mpc->fresh = status == KOOP_OK;
	return status;
}

/* v over the free inputs to where the gradient vanishes. Back substitution runs
 * forwards in time: with `in_box`, an input that meets its bound stays there and
 * the later ones make the best of it. */
static void newton_step(KOOP(mpc) *mpc, real *v, const real *gradient, int in_box) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m, size = mpc->n_free;
	real *step = mpc->work; /* the rows of the Hessian are done with */
	for (size_t q = 0, r = 0; q < V; q++) {
		if (mpc->set[q] == 0) { step[r++] = -gradient[q]; }
	}
	for (size_t r = 0; r < size; r++) {
		const real *row = mpc->factor + packed_offset(r, size);
		step[r] *= row[r];
		add_scaled(step + r + 1, -step[r], row + r + 1, size - r - 1);
	}
	for (size_t q = V, r = size, j = 0; q-- > 0;) {
		j = j > 0 ? j - 1 : m - 1;
		if (mpc->set[q] != 0) { continue; }
		r--;
		const real *row = mpc->factor + packed_offset(r, size);
		step[r] = (step[r] - dot(row + r + 1, step + r + 1, size - r - 1)) * row[r];
		const real to = v[q] + step[r], inside = clip(to, c->u_min[j], c->u_max[j]);
		if (in_box && inside != to) {
			step[r] = inside - v[q];
			v[q] = inside;
		} else {
			v[q] = to;
		}
	}
}
