/* The paper's quadratic program, condensed on Theta = [A B] anew at every step.
 * Paper, section "Koopman-MPC with Online Learning".
 *
 * Time runs backwards: of the inputs v and of the predicted states the last of
 * the horizon stands first. With the Markov parameters G[k] = C A^k B side by
 * side in one row for each state, every sum of the condensed problem then runs
 * over a window that moves along a row:
 *
 *     x[b]  = free[b] + sum over c of G[c] v[b + c]
 *     T' w[a] = sum over b <= a of G[a - b]' w[b]
 *     H[a, b] = H[a - 1, b - 1] + G[a]' Q G[b]
 */

/* Windows are worked by eight: arrays are padded to that, and the rows of Markov
 * parameters have eight zeros in front, for windows that begin before them. */
#define WINDOW KOOP_MPC_WINDOW

static size_t padded(size_t k) {
	return KOOP_MPC_PAD(k);
}

/* y[0..7] += sum over k of x[k dx] w[k dw ..  k dw + 7]; w moves by dw, forwards or backwards */
OUT_OF_LINE static void add_windows(real *restrict y, const real *x, size_t dx, size_t n, const real *w,
                                    ptrdiff_t dw) {
	real s0 = y[0], s1 = y[1], s2 = y[2], s3 = y[3], s4 = y[4], s5 = y[5], s6 = y[6], s7 = y[7];
	for (; n > 0; n--) {
		const real a = *x;
		s0 += a * w[0];
		s1 += a * w[1];
		s2 += a * w[2];
		s3 += a * w[3];
		s4 += a * w[4];
		s5 += a * w[5];
		s6 += a * w[6];
		s7 += a * w[7];
		x += dx;
		w += dw;
	}
	y[0] = s0;
	y[1] = s1;
	y[2] = s2;
	y[3] = s3;
	y[4] = s4;
	y[5] = s5;
	y[6] = s6;
	y[7] = s7;
}

static real clip(real x, real low, real high) {
	return x < low ? low : x > high ? high : x;
}

/* Which input follows input j: a remainder would be a division for every element. */
static size_t next_input(size_t j, size_t m) {
	return j + 1 < m ? j + 1 : 0;
}

/* v into the box */
static void clip_all(const KOOP(mpc_config) *c, real *v) {
	for (size_t q = 0, j = 0; q < c->horizon * c->n_inputs; q++, j = next_input(j, c->n_inputs)) {
		v[q] = clip(v[q], c->u_min[j], c->u_max[j]);
	}
}

static real *markov_row(const KOOP(mpc) *mpc, size_t i) {
	return mpc->markov + i * (WINDOW + padded(mpc->config.horizon * mpc->config.n_inputs)) + WINDOW;
}

/* sum + rest = sum + rest + a x, with `rest` for what rounding takes away: Dekker's
 * product and Knuth's sum. */
static void add_product(real *sum, real *rest, real a, real x) {
	if (SPLIT == 0) {
		*sum += a * x;
		return;
	}
	const real split_a = SPLIT * a, split_x = SPLIT * x, product = a * x;
	const real a1 = split_a - (split_a - a), a2 = a - a1;
	const real x1 = split_x - (split_x - x), x2 = x - x1;
	const real total = *sum + product, part = total - *sum;
	*rest += (a2 * x2 - (((product - a1 * x1) - a2 * x1) - a1 * x2)) +
	         ((*sum - (total - part)) + (product - part));
	*sum = total;
}

/* change = A psi - psi. A robot's position is large against the way it goes in one
 * step, and a plan sees only the latter: in float32 the sum is kept in two parts. */
static void first_change(const real *theta, const real *psi, size_t N, size_t rows, real *change,
                         real *rest) {
	for (size_t i = 0; i < N; i++) {
		change[i] = -psi[i];
		rest[i] = 0;
	}
	for (size_t k = 0; k < N; k++) {
		for (size_t i = 0; i < N; i++) { add_product(change + i, rest + i, theta[k * rows + i], psi[k]); }
	}
	for (size_t i = 0; i < N; i++) { change[i] += rest[i]; }
}

/* Markov parameters and free response less the reference, one pass of A over
 * m + 1 vectors. The free response is followed as its change from psi. */
static void predict(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs, H = c->horizon, rows = KOOP_PAD(N);
	real *change = mpc->work, *now = change + rows, *next = now + (m + 1) * rows;
	for (size_t i = 0; i < (2 * m + 3) * rows; i++) { change[i] = 0; }
	first_change(theta, psi, N, rows, change, next);
	for (size_t j = 0; j < m; j++) { copy(now + j * rows, theta + (N + j) * rows, N); }
	copy(now + m * rows, change, N);
	for (size_t k = 0; k < H; k++) {
		for (size_t i = 0; i < n; i++) {
			for (size_t j = 0; j < m; j++) { markov_row(mpc, i)[k * m + j] = now[j * rows + i]; }
			mpc->free_error[i * padded(H) + H - 1 - k] = (psi[i] - reference[k * n + i]) + now[m * rows + i];
		}
		for (size_t j = 0; j <= m; j++) { weighted_rows(next + j * rows, theta, now + j * rows, N, rows); }
		add_scaled(next + m * rows, 1, change, N);
		real *swap = now;
		now = next;
		next = swap;
	}
}

/* state += prediction under v */
static void add_prediction(KOOP(mpc) *mpc, const real *v) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, H = c->horizon, rows = padded(H) + WINDOW;
	for (size_t j = 0; j < m; j++) {
		real *row = mpc->work + j * rows; /* input j over time, and zeros */
		for (size_t a = 0; a < H; a++) { row[a] = v[a * m + j]; }
		for (size_t a = H; a < rows; a++) { row[a] = 0; }
	}
	for (size_t i = 0; i < c->n_states; i++) {
		for (size_t b = 0; b < H; b += WINDOW) {
			for (size_t j = 0; j < m; j++) {
				add_windows(mpc->state + i * padded(H) + b, markov_row(mpc, i) + j, m, H - b,
				            mpc->work + j * rows + b, 1);
			}
		}
	}
}

/* out += T' Q state */
static void add_adjoint(KOOP(mpc) *mpc, real *out) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon, V = H * m;
	real *weighted = mpc->work; /* Q state */
	for (size_t i = 0; i < n * padded(H); i++) { weighted[i] = 0; }
	for (size_t i = 0; i < n; i++) {
		for (size_t k = 0; k < n; k++) {
			const real Q = c->Q[i * n + k];
			if (Q != 0) { add_scaled(weighted + i * padded(H), Q, mpc->state + k * padded(H), H); }
		}
	}
	for (size_t q = 0; q < V; q += WINDOW) {
		const size_t reach = (q + WINDOW - 1) / m + 1;
		for (size_t i = 0; i < n; i++) {
			add_windows(out + q, weighted + i * padded(H), 1, reach < H ? reach : H, markov_row(mpc, i) + q,
			            -(ptrdiff_t)m);
		}
	}
}

/* out = H v without the part of the states: R, and S between neighbours */
static void multiply_weights(const KOOP(mpc) *mpc, const real *v, real *out) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, H = c->horizon;
	for (size_t a = 0; a < H; a++) {
		for (size_t j = 0; j < m; j++) {
			real sum = dot(c->R + j * m, v + a * m, m);
			if (c->S) {
				const real *S = c->S + j * m;
				sum += (a > 0 ? 2 : 1) * dot(S, v + a * m, m);
				if (a > 0) { sum -= dot(S, v + (a - 1) * m, m); }
				if (a + 1 < H) { sum -= dot(S, v + (a + 1) * m, m); }
			}
			out[a * m + j] = sum;
		}
	}
}

/* out = (condensed Hessian) v */
static void multiply_hessian(KOOP(mpc) *mpc, const real *v, real *out) {
	const size_t states = mpc->config.n_states * padded(mpc->config.horizon);
	for (size_t i = 0; i < states; i++) { mpc->state[i] = 0; }
	multiply_weights(mpc, v, out);
	add_prediction(mpc, v);
	add_adjoint(mpc, out);
}

/* The largest step that a gradient step scaled by the diagonal would make inside
 * the box, in units of the inputs. */
static real kkt_residual(const KOOP(mpc) *mpc, const real *v, const real *gradient) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs;
	real residual = 0;
	for (size_t q = 0, j = 0; q < c->horizon * m; q++, j = next_input(j, m)) {
		const real step = clip(v[q] - gradient[q] * mpc->inverse[q], c->u_min[j], c->u_max[j]);
		residual = max_of(residual, MATH(fabs)(v[q] - step));
	}
	return residual;
}

/* Gradient of half the cost at v, and the KKT residual. The states' errors are
 * formed first: where the plan tracks well they are small, and so is their round-off. */
static real evaluate(KOOP(mpc) *mpc, const real *v, real *gradient) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, H = c->horizon, V = H * m;
	copy(mpc->state, mpc->free_error, c->n_states * padded(H));
	add_prediction(mpc, v);
	multiply_weights(mpc, v, gradient);
	for (size_t j = 0; c->S && j < m; j++) { gradient[V - m + j] -= dot(c->S + j * m, mpc->u_before, m); }
	add_adjoint(mpc, gradient);
	return kkt_residual(mpc, v, gradient);
}

/* weighted = column (a, j) of Q G */
static void weigh_column(const KOOP(mpc) *mpc, size_t q, real *weighted) {
	const size_t n = mpc->config.n_states;
	for (size_t i = 0; i < n; i++) {
		weighted[i] = 0;
		for (size_t k = 0; k < n; k++) { weighted[i] += mpc->config.Q[i * n + k] * markov_row(mpc, k)[q]; }
	}
}

/* Condenses: Markov parameters, free response, diagonal of the Hessian. */
OUT_OF_LINE static int condense(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                                const real *u_before) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon;
	real *weighted = mpc->work;
	predict(mpc, theta, psi, reference);
	for (size_t i = 0; i < n; i++) {
		if (!all_finite(markov_row(mpc, i), H * m)) { return KOOP_E_OVERFLOW; }
	}
	if (!all_finite(mpc->free_error, n * padded(H))) { return KOOP_E_OVERFLOW; }
	for (size_t j = 0; c->S && j < m; j++) { mpc->u_before[j] = u_before[j]; }

	for (size_t j = 0; j < m; j++) {
		const real rate = c->S ? c->S[j * m + j] : 0;
		real sum = c->R[j * m + j];
		for (size_t a = 0; a < H; a++) {
			weigh_column(mpc, a * m + j, weighted);
			for (size_t i = 0; i < n; i++) { sum += markov_row(mpc, i)[a * m + j] * weighted[i]; }
			const real diagonal = sum + (a > 0 ? 2 : 1) * rate;
			if (!is_finite(diagonal)) { return KOOP_E_OVERFLOW; }
			if (!(diagonal > 0)) { return KOOP_E_INDEFINITE; }
			mpc->inverse[a * m + j] = 1 / diagonal;
		}
	}
	return KOOP_OK;
}
