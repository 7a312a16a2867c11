/* The paper's quadratic program, condensed with the present Theta = [A B] at every step. Paper, section
 * "Koopman-MPC with Online Learning".
 *
 * Time runs backwards: the inputs v and the predicted states are stored with the last step of the horizon
 * first. The Markov parameters G[k] = C A^k B of a state are stored in one row. Every sum of the condensed
 * problem then runs over a window that moves along a row:
 *
 *     x[b]  = free[b] + sum over c of G[c] v[b + c]
 *     T' w[a] = sum over b <= a of G[a - b]' w[b]
 *     H[a, b] = H[a - 1, b - 1] + G[a]' Q G[b]
 */

/* Windows are processed eight elements at a time, and their arrays are padded to multiples of eight. */
#define WINDOW KOOP_MPC_WINDOW

/* Compiles a function without knowledge of its callers. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define UNKNOWN_CALLERS __attribute__((noipa))
#else
#define UNKNOWN_CALLERS
#endif

static size_t padded(size_t k) {
	return KOOP_MPC_PAD(k);
}

#define WINDOW_ADD(lane) s##lane += a * x[lane];
#define WINDOW_BEGIN(lane) real s##lane = y[lane];
#define WINDOW_END(lane) y[lane] = s##lane;
/* four steps at once: 11 elements of x are loaded instead of 32 */
#define WINDOW_FOUR(lane, next1, next2, next3)                                                               \
	s##lane += a0 * x##lane;                                                                                 \
	s##lane += a1 * x##next1;                                                                                \
	s##lane += a2 * x##next2;                                                                                \
	s##lane += a3 * x##next3;

/* y[0..7] += sum over k of g[k] x[k..k+7]. `dx` is 1. A compiler that knew this would reuse the elements of
 * the previous window, and would not vectorise. */
OUT_OF_LINE static UNKNOWN_CALLERS void add_windows(real *restrict y, const real *g, const real *x, size_t dx,
                                                    size_t n) {
	LANES_8(WINDOW_BEGIN)
#if !VECTORS
	for (; n >= 4; n -= 4, g += 4, x += 4) {
		const real a0 = g[0], a1 = g[1], a2 = g[2], a3 = g[3];
		const real x0 = x[0], x1 = x[1], x2 = x[2], x3 = x[3], x4 = x[4], x5 = x[5];
		const real x6 = x[6], x7 = x[7], x8 = x[8], x9 = x[9], x10 = x[10];
		WINDOW_FOUR(0, 1, 2, 3)
		WINDOW_FOUR(1, 2, 3, 4)
		WINDOW_FOUR(2, 3, 4, 5)
		WINDOW_FOUR(3, 4, 5, 6)
		WINDOW_FOUR(4, 5, 6, 7)
		WINDOW_FOUR(5, 6, 7, 8)
		WINDOW_FOUR(6, 7, 8, 9)
		WINDOW_FOUR(7, 8, 9, 10)
	}
#endif
	for (; n > 0; n--) {
		const real a = *g;
		LANES_8(WINDOW_ADD)
		g += dx;
		x += dx;
	}
	LANES_8(WINDOW_END)
}

/* y[b] += sum over c of g[c] x[b + c], over n steps. y is padded, and x ends with eight zeros. */
static void correlate(real *y, const real *g, const real *x, size_t n) {
	for (size_t b = 0; b < n; b += WINDOW) { add_windows(y + b, g, x + b, 1, n - b); }
}

/* Impulse response of state i to input j: element (i, j) of C A^k B, k = 0..H-1. */
static real *markov_row(const KOOP(mpc) *mpc, size_t i, size_t j) {
	return mpc->markov + (i * mpc->config.n_inputs + j) * mpc->config.horizon;
}

/* sum + rest = sum + rest + a x, where `rest` collects the rounding errors: Dekker's product and Knuth's sum.
 */
static UNCONTRACTED void add_product(real *sum, real *rest, real a, real x) {
#if SPLIT > 0
	const real split_a = SPLIT * a, split_x = SPLIT * x, product = a * x;
	const real a1 = split_a - (split_a - a), a2 = a - a1;
	const real x1 = split_x - (split_x - x), x2 = x - x1;
	const real total = *sum + product, part = total - *sum;
	*rest += (a2 * x2 - (((product - a1 * x1) - a2 * x1) - a1 * x2)) +
	         ((*sum - (total - part)) + (product - part));
	*sum = total;
#else
	*sum += a * x;
	(void)rest;
#endif
}

/* change = A psi - psi. A robot's position is large compared with its motion in one step, and the plan
 * depends on the motion. In float32 the sum is therefore compensated. */
static UNCONTRACTED void first_change(const real *theta, const real *psi, size_t N, real *change,
                                      real *rest) {
	for (size_t i = 0; i < N; i++) {
		change[i] = -psi[i];
		rest[i] = 0;
	}
	for (size_t k = 0; k < N; k++) {
		for (size_t i = 0; i < N; i++) {
			add_product(change + i, rest + i, theta[k * KOOP_PAD(N) + i], psi[k]);
		}
	}
	for (size_t i = 0; i < N; i++) { change[i] += rest[i]; }
}

#if VECTORS

/* next = A now for each of `count` vectors */
static void step_all(real *next, const real *A, const real *now, size_t N, size_t count) {
	const size_t rows = KOOP_PAD(N);
	for (size_t j = 0; j < count; j++) { weighted_rows(next + j * rows, A, now + j * rows, N, rows); }
}

#else

#define STEP_BEGIN(lane) real p##lane = 0, q##lane = 0, r##lane = 0;
#define STEP_ADD(lane)                                                                                       \
	{                                                                                                        \
		const real element = row[lane];                                                                      \
		p##lane += element * a;                                                                              \
		q##lane += element * b;                                                                              \
		r##lane += element * c;                                                                              \
	}
#define STEP_END(lane) y[i + lane] = p##lane, y[second + i + lane] = q##lane, y[third + i + lane] = r##lane;

/* y = A x for the three vectors at 0, `second` and `third` of x and y: each element of A is loaded once for
 * all three. */
OUT_OF_LINE static void step_three(real *restrict y, const real *A, const real *x, size_t N, size_t second,
                                   size_t third) {
	const size_t rows = KOOP_PAD(N);
	for (size_t i = 0; i < rows; i += 4) {
		const real *row = A + i, *x0 = x, *x1 = x + second, *x2 = x + third;
		LANES_4(STEP_BEGIN)
		for (const real *end = row + N * rows; row < end; row += rows) {
			const real a = *x0++, b = *x1++, c = *x2++;
			LANES_4(STEP_ADD)
		}
		LANES_4(STEP_END)
	}
}

static void step_all(real *next, const real *A, const real *now, size_t N, size_t count) {
	const size_t rows = KOOP_PAD(N);
	for (size_t j = 0; j < count; j += 3) {
		const size_t second = j + 1 < count ? rows : 0, third = j + 2 < count ? 2 * rows : second;
		step_three(next + j * rows, A, now + j * rows, N, second, third);
	}
}

#endif

/* Computes the Markov parameters, and the free response minus the reference: A is applied to m + 1 vectors
 * per step. The free response is computed as its change from psi. */
static void predict(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs, H = c->horizon, rows = KOOP_PAD(N);
	real *change = mpc->work, *now = change + rows, *next = now + (m + 1) * rows;
	first_change(theta, psi, N, change, next);
	copy(now, theta + N * rows, m * rows);
	copy(now + m * rows, change, N);
	for (size_t k = 0; k < H; k++) {
		if (k > 0) {
			step_all(next, theta, now, N, m + 1);
			add_scaled(next + m * rows, 1, change, N);
			real *swap = now;
			now = next;
			next = swap;
		}
		for (size_t i = 0; i < n; i++) {
			const real *element = now + i;
			for (size_t j = 0; j < m; j++, element += rows) { markov_row(mpc, i, j)[k] = *element; }
			mpc->free_error[i * padded(H) + H - 1 - k] = (psi[i] - reference[k * n + i]) + *element;
		}
	}
}

/* state += prediction under v */
static void add_prediction(KOOP(mpc) *mpc, const real *v) {
	const size_t m = mpc->config.n_inputs, H = mpc->config.horizon;
	for (size_t j = 0; j < m; j++) {
		real *input = mpc->work; /* input j over time, and zeros */
		for (size_t a = 0; a < H; a++) { input[a] = v[a * m + j]; }
		for (size_t a = H; a < H + WINDOW; a++) { input[a] = 0; }
		for (size_t i = 0; i < mpc->config.n_states; i++) {
			correlate(mpc->state + i * padded(H), markov_row(mpc, i, j), input, H);
		}
	}
}

/* out += T' Q state; overwrites the state. With time forwards this is a sum like the prediction. */
static void add_adjoint(KOOP(mpc) *mpc, real *out) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon, rows = H + WINDOW;
	for (size_t i = 0; i < n; i++) {
		real *weighted = mpc->work + i * rows; /* Q state, first step first, and zeros */
		for (size_t a = 0; a < rows; a++) { weighted[a] = 0; }
		for (size_t k = 0; k < n; k++) {
			const real Q = c->Q[i * n + k], *last = mpc->state + k * padded(H) + H;
			if (is_zero(Q)) { continue; }
			for (size_t a = 0; a < H; a++) { weighted[a] += Q * *--last; }
		}
	}
	for (size_t j = 0; j < m; j++) {
		real *sum = mpc->state;
		for (size_t a = 0; a < padded(H); a++) { sum[a] = 0; }
		for (size_t i = 0; i < n; i++) { correlate(sum, markov_row(mpc, i, j), mpc->work + i * rows, H); }
		for (size_t a = 0; a < H; a++) { out[a * m + j] += sum[H - 1 - a]; }
	}
}

/* out = the part of H v that does not depend on the states: R, and S between consecutive inputs */
static void multiply_weights(const KOOP(mpc) *mpc, const real *v, real *out) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	for (size_t q = 0; q < V; q += m) {
		for (size_t j = 0; j < m; j++) {
			real sum = 0;
			for (size_t k = 0; k < m; k++) { sum += c->R[j * m + k] * v[q + k]; }
			for (size_t k = 0, e = q; c->S && k < m; k++, e++) {
				const real after = e >= m ? v[e] - v[e - m] : 0, before = e + m < V ? v[e] - v[e + m] : v[e];
				sum += c->S[j * m + k] * (after + before);
			}
			out[q + j] = sum;
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

/* The largest change of an input, inside the limits, by a gradient step scaled by the Hessian's diagonal. */
static real kkt_residual(const KOOP(mpc) *mpc, const real *v, const real *gradient) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs;
	real residual = 0;
	for (size_t q = 0, j = 0; q < c->horizon * m; q++, j = next_input(j, m)) {
		const real step = clip(v[q] - gradient[q] * mpc->inverse[q], mpc->u_min[j], mpc->u_max[j]);
		residual = max_of(residual, MATH(fabs)(v[q] - step));
	}
	return residual;
}

/* Computes the gradient of half the cost at v; returns the KKT residual. The tracking errors are computed
 * first: if the plan tracks well they are small, and so is their round-off. */
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

/* out[a] = G' Q G for input j at step a */
static void response_weights(KOOP(mpc) *mpc, size_t j, real *out) {
	const size_t n = mpc->config.n_states, H = mpc->config.horizon;
	real *weighted = mpc->trial_gradient;
	for (size_t a = 0; a < H; a++) { out[a] = 0; }
	for (size_t i = 0; i < n; i++) {
		const real *Q = mpc->config.Q + i * n, *G = markov_row(mpc, i, j);
		for (size_t a = 0; a < H; a++) { weighted[a] = 0; }
		for (size_t k = 0; k < n; k++) {
			if (!is_zero(Q[k])) { add_scaled(weighted, Q[k], markov_row(mpc, k, j), H); }
		}
		for (size_t a = 0; a < H; a++) { out[a] += weighted[a] * G[a]; }
	}
}

/* Condenses the problem: Markov parameters, free response, diagonal of the Hessian. */
OUT_OF_LINE static int condense(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                                const real *u_before) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon;
	predict(mpc, theta, psi, reference);
	if (!all_finite(mpc->markov, n * m * H)) { return KOOP_E_OVERFLOW; }
	if (!all_finite(mpc->free_error, n * padded(H))) { return KOOP_E_OVERFLOW; }
	for (size_t j = 0; j < m; j++) {
		const real rate = c->S ? c->S[j * m + j] : 0;
		real sum = c->R[j * m + j];
		if (c->S) { mpc->u_before[j] = u_before[j]; }
		response_weights(mpc, j, mpc->trial);
		for (size_t a = 0; a < H; a++) {
			sum += mpc->trial[a];
			const real diagonal = sum + (real)(a > 0 ? 2 : 1) * rate;
			if (!is_finite(diagonal)) { return KOOP_E_OVERFLOW; }
			if (!(diagonal >= REAL_MIN)) { return KOOP_E_INDEFINITE; } /* its inverse would not be finite */
			mpc->inverse[a * m + j] = 1 / diagonal;
		}
	}
	return KOOP_OK;
}
