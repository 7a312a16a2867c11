/* Koopman-MPC: the paper's quadratic program, condensed on Theta = [A B] anew at
 * every step, in its box. Paper, section "Koopman-MPC with Online Learning".
 *
 * Variables are the inputs over the horizon in reversed time: the last input
 * stands first. With the Markov parameters G[k] = C A^k B one after the other,
 * every sum of the condensed problem is then over contiguous elements:
 *
 *     x[t] = free[t] + sum over q of G[q] v[(H-1-t) m + q]
 *     H[a m + c, (a + s) m + e] = sum over k <= a of (G[k]' Q G[k+s])[c, e]
 *
 * so a row of the Hessian is the one m above it plus a few multiples of G. */

static real clip(real x, real low, real high) {
	return x < low ? low : x > high ? high : x;
}

/* y = M x for a small square M by rows */
static void multiply_small(real *y, const real *M, const real *x, size_t n) {
	for (size_t i = 0; i < n; i++) { y[i] = dot(M + i * n, x, n); }
}

/* ---- The condensed problem -------------------------------------------------- */

/* Markov parameters and free response, one pass of A over m + 1 vectors. */
static void predict_free(KOOP(mpc) *mpc, const real *theta, const real *psi) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs, H = c->horizon, rows = KOOP_PAD(N);
	real *now = mpc->work, *next = now + (m + 1) * rows;
	for (size_t i = 0; i < 2 * (m + 1) * rows; i++) { now[i] = 0; }
	for (size_t j = 0; j < m; j++) { copy(now + j * rows, theta + (N + j) * rows, N); }
	weighted_rows(now + m * rows, theta, psi, N, rows);
	for (size_t k = 0; k < H; k++) {
		for (size_t i = 0; i < n; i++) {
			for (size_t j = 0; j < m; j++) { mpc->markov[i * H * m + k * m + j] = now[j * rows + i]; }
			mpc->state[i * H + k] = now[m * rows + i];
		}
		for (size_t j = 0; j <= m; j++) { weighted_rows(next + j * rows, theta, now + j * rows, N, rows); }
		real *swap = now;
		now = next;
		next = swap;
	}
}

/* out += transposed prediction of Q w, for w (n rows of H) */
static void predict_adjoint(const KOOP(mpc) *mpc, const real *w, real *out) {
	const size_t n = mpc->config.n_states, m = mpc->config.n_inputs, H = mpc->config.horizon;
	for (size_t i = 0; i < n; i++) {
		for (size_t t = 0; t < H; t++) {
			add_scaled(out + (H - 1 - t) * m, w[i * H + t], mpc->markov_q + i * H * m, (t + 1) * m);
		}
	}
}

/* out = (condensed Hessian) v */
static void multiply_hessian(KOOP(mpc) *mpc, const real *v, real *out) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon;
	for (size_t i = 0; i < n; i++) {
		for (size_t t = 0; t < H; t++) {
			mpc->state[i * H + t] = dot(mpc->markov + i * H * m, v + (H - 1 - t) * m, (t + 1) * m);
		}
	}
	for (size_t a = 0; a < H; a++) {
		multiply_small(out + a * m, c->R, v + a * m, m);
		for (size_t j = 0; c->S && j < m; j++) {
			const real own = dot(c->S + j * m, v + a * m, m);
			out[a * m + j] += a > 0 ? 2 * own : own;
			if (a > 0) { out[a * m + j] -= dot(c->S + j * m, v + (a - 1) * m, m); }
			if (a + 1 < H) { out[a * m + j] -= dot(c->S + j * m, v + (a + 1) * m, m); }
		}
	}
	predict_adjoint(mpc, mpc->state, out);
}

/* Condenses: Markov parameters, linear term and diagonal of the Hessian. */
static int condense(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                    const real *u_before) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon, V = H * m;
	predict_free(mpc, theta, psi);
	if (!all_finite(mpc->markov, n * V) || !all_finite(mpc->state, n * H)) { return KOOP_E_OVERFLOW; }

	for (size_t i = 0; i < n; i++) {
		real *row = mpc->markov_q + i * V;
		for (size_t q = 0; q < V; q++) { row[q] = 0; }
		for (size_t j = 0; j < n; j++) { add_scaled(row, c->Q[i * n + j], mpc->markov + j * V, V); }
		for (size_t t = 0; t < H; t++) { mpc->state[i * H + t] -= reference[t * n + i]; }
	}
	for (size_t q = 0; q < V; q++) { mpc->linear[q] = 0; }
	predict_adjoint(mpc, mpc->state, mpc->linear);
	for (size_t j = 0; c->S && j < m; j++) { mpc->linear[(H - 1) * m + j] -= dot(c->S + j * m, u_before, m); }

	for (size_t j = 0; j < m; j++) {
		real sum = c->R[j * m + j];
		for (size_t a = 0; a < H; a++) {
			for (size_t i = 0; i < n; i++) {
				sum += mpc->markov[i * V + a * m + j] * mpc->markov_q[i * V + a * m + j];
			}
			const real rate = c->S ? c->S[j * m + j] : 0;
			mpc->diagonal[a * m + j] = sum + (a > 0 ? 2 * rate : rate);
		}
	}
	if (!all_finite(mpc->linear, V) || !all_finite(mpc->diagonal, V)) { return KOOP_E_OVERFLOW; }
	for (size_t q = 0; q < V; q++) {
		if (!(mpc->diagonal[q] > 0)) { return KOOP_E_INDEFINITE; }
	}
	return KOOP_OK;
}

/* gradient at v, and the KKT residual: the largest step that a gradient step
 * scaled by the diagonal would make inside the box, in units of the inputs */
static real evaluate(KOOP(mpc) *mpc, const real *v, real *gradient) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	real residual = 0;
	multiply_hessian(mpc, v, gradient);
	for (size_t q = 0; q < V; q++) {
		gradient[q] += mpc->linear[q];
		const real step = clip(v[q] - gradient[q] / mpc->diagonal[q], c->u_min[q % m], c->u_max[q % m]);
		residual = max_of(residual, MATH(fabs)(v[q] - step));
	}
	return residual;
}

/* ---- Newton steps on the free inputs ---------------------------------------- */

/* Row k of a packed upper factor begins at its own diagonal; from this offset on
 * it can be indexed by column. */
static size_t packed_offset(size_t k, size_t size) {
	return k * size - k * (k + 1) / 2;
}

/* Before the first call of hessian_row(). */
static void hessian_begin(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs;
	for (size_t q = 0; q < m * m * mpc->config.horizon; q++) { mpc->work[q] = 0; }
}

/* Row (a, j) of the Hessian from its own block on, so that element 0 is that of
 * input (a, 0). To be called in order, from (0, 0). */
static real *hessian_row(KOOP(mpc) *mpc, size_t a, size_t j) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, V = c->horizon * m, left = V - a * m;
	real *sum = mpc->work + j * V, *row = mpc->work + m * V;
	for (size_t i = 0; i < n; i++) {
		add_scaled(sum, mpc->markov_q[i * V + a * m + j], mpc->markov + i * V + a * m, left);
	}
	copy(row, sum, left);
	for (size_t e = 0; e < m; e++) {
		row[e] += c->R[j * m + e];
		if (c->S) { row[e] += c->S[j * m + e] * (a > 0 ? 2 : 1); }
		if (c->S && left > m) { row[m + e] -= c->S[j * m + e]; }
	}
	return row;
}

/* Cholesky factor of the Hessian over the free variables, upper, packed by rows,
 * from rows of the Hessian that are made as they are needed. */
static int factor_free(KOOP(mpc) *mpc, size_t n_free) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	size_t r = 0;
	hessian_begin(mpc);
	for (size_t self = 0; r < n_free; self++) {
		const real *hessian = hessian_row(mpc, self / m, self % m);
		if (mpc->set[self] != 0) { continue; }

		real *row = mpc->factor + packed_offset(r, n_free);
		const size_t block = self / m * m;
		for (size_t q = self, e = r; q < V; q++) {
			row[e] = hessian[q - block]; /* one too far at the end, where the next row comes */
			e += mpc->set[q] == 0;
		}
		const real diagonal = row[r];
		for (size_t k = 0; k < r; k++) {
			const real *above = mpc->factor + packed_offset(k, n_free);
			add_scaled(row + r, -above[r], above + r, n_free - r);
		}
		if (!(row[r] > REAL_EPSILON * diagonal)) { return KOOP_E_INDEFINITE; }
		const real inverse = 1 / MATH(sqrt)(row[r]);
		for (size_t e = r; e < n_free; e++) { row[e] *= inverse; }
		r++;
	}
	return KOOP_OK;
}

/* x = (U' U)^-1 x */
static void solve_factor(const real *factor, real *x, size_t size) {
	for (size_t r = 0; r < size; r++) {
		const real *row = factor + packed_offset(r, size);
		x[r] /= row[r];
		add_scaled(x + r + 1, -x[r], row + r + 1, size - r - 1);
	}
	for (size_t r = size; r-- > 0;) {
		const real *row = factor + packed_offset(r, size);
		x[r] = (x[r] - dot(row + r + 1, x + r + 1, size - r - 1)) / row[r];
	}
}

/* Writes down which inputs are free, and returns whether that is another choice
 * than the last. An input is not free where a gradient step scaled by the
 * diagonal would press it against a bound; `at_bounds`: only where it also is
 * at that bound, so that a Newton step on the free inputs is a way downhill. */
static int choose_free(KOOP(mpc) *mpc, const real *v, const real *gradient, int at_bounds) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	int changed = 0;
	mpc->n_free = 0;
	for (size_t q = 0; q < V; q++) {
		const real step = v[q] - gradient[q] / mpc->diagonal[q];
		const real low = c->u_min[q % m], high = c->u_max[q % m];
		real set = step > high ? 1 : step < low ? -1 : 0;
		if (at_bounds && v[q] > low && v[q] < high) { set = 0; }
		changed |= set != mpc->set[q];
		mpc->set[q] = set;
		mpc->n_free += set == 0;
	}
	return changed;
}

/* The inputs that are not free to their bounds; returns whether any moved. */
static int press_to_bounds(const KOOP(mpc) *mpc, real *v) {
	const KOOP(mpc_config) *c = &mpc->config;
	int moved = 0;
	for (size_t q = 0; q < c->horizon * c->n_inputs; q++) {
		const size_t j = q % c->n_inputs;
		const real to = mpc->set[q] == 0 ? v[q] : mpc->set[q] > 0 ? c->u_max[j] : c->u_min[j];
		moved |= to != v[q];
		v[q] = to;
	}
	return moved;
}

/* v over the free inputs to where the gradient vanishes, box or not */
static void newton_step(KOOP(mpc) *mpc, real *v, const real *gradient) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real *step = mpc->work; /* the rows of the Hessian are done with */
	for (size_t q = 0, r = 0; q < V; q++) {
		if (mpc->set[q] == 0) { step[r++] = -gradient[q]; }
	}
	solve_factor(mpc->factor, step, mpc->n_free);
	for (size_t q = 0, r = 0; q < V; q++) {
		if (mpc->set[q] == 0) { v[q] += step[r++]; }
	}
}

/* v into the box; returns whether it was outside. */
static int clip_all(const KOOP(mpc_config) *c, real *v) {
	int moved = 0;
	for (size_t q = 0; q < c->horizon * c->n_inputs; q++) {
		const real to = clip(v[q], c->u_min[q % c->n_inputs], c->u_max[q % c->n_inputs]);
		moved |= to != v[q];
		v[q] = to;
	}
	return moved;
}

/* One sweep of exact minimisation over each input in turn; never goes uphill.
 * The gradient comes in right at v and is right at no place afterwards. */
static void coordinate_sweep(KOOP(mpc) *mpc, real *v, real *gradient) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	hessian_begin(mpc);
	for (size_t self = 0; self < V; self++) {
		const size_t block = self / m * m;
		const real *row = hessian_row(mpc, self / m, self % m);
		const real wanted = v[self] - gradient[self] / mpc->diagonal[self];
		const real change = clip(wanted, c->u_min[self % m], c->u_max[self % m]) - v[self];
		v[self] += change;
		/* what is left behind is not looked at again in this sweep */
		add_scaled(gradient + block, change, row, V - block);
	}
}

/* Twice the change of the cost between two points whose gradients are known: it
 * is a quadratic. */
static real rise(const real *from, const real *gradient_from, const real *to, const real *gradient_to,
                 size_t V) {
	real sum = 0;
	for (size_t q = 0; q < V; q++) { sum += (to[q] - from[q]) * (gradient_from[q] + gradient_to[q]); }
	return sum;
}

/* Primal-dual active set: free inputs to their unconstrained optimum, the others
 * to their bounds, then choose again. Mostly a handful of steps; may cycle. */
#define MPC_ACTIVE_SET_STEPS 10

static int active_set(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real *v = mpc->plan, *gradient = mpc->gradient, *trial = mpc->trial;
	for (size_t q = 0; q < V; q++) { mpc->set[q] = 2; } /* no choice yet */
	for (size_t k = 0; k < MPC_ACTIVE_SET_STEPS && result->residual > mpc->config.tolerance; k++) {
		const int changed = choose_free(mpc, v, gradient, 0);
		copy(trial, v, V);
		const int moved = press_to_bounds(mpc, trial);
		if (changed) {
			const int status = factor_free(mpc, mpc->n_free);
			if (status != KOOP_OK) { return status; }
		}
		if (moved) { evaluate(mpc, trial, mpc->other); }
		newton_step(mpc, trial, moved ? mpc->other : gradient);
		const real residual = evaluate(mpc, trial, mpc->other);
		result->iterations++;
		/* on the same choice a step only refines the last: until round-off is reached */
		if (!changed && !(residual < result->residual)) { break; }
		copy(v, trial, V);
		copy(gradient, mpc->other, V);
		result->residual = residual;
	}
	if (clip_all(&mpc->config, v)) { result->residual = evaluate(mpc, v, gradient); }
	return KOOP_OK;
}

/* Bertsekas' two-metric projection: Newton steps on the free inputs, shortened
 * until they go downhill, with sweeps before each, which go downhill whatever
 * happens. Slower; does not cycle. */
#define MPC_SWEEPS 4
#define MPC_HALVINGS 12

static int projected_newton(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t V = c->horizon * c->n_inputs;
	real *v = mpc->plan, *gradient = mpc->gradient, *trial = mpc->trial;
	for (; result->iterations < KOOP_MPC_MAX_NEWTON && result->residual > c->tolerance;
	     result->iterations++) {
		for (size_t s = 0; s < MPC_SWEEPS; s++) {
			coordinate_sweep(mpc, v, gradient);
			result->residual = evaluate(mpc, v, gradient);
		}
		choose_free(mpc, v, gradient, 1);
		const int status = factor_free(mpc, mpc->n_free);
		if (status != KOOP_OK) { return status; }
		copy(trial, v, V);
		newton_step(mpc, trial, gradient);
		/* where the whole step would lead, in or out of the box; the halves of it follow */
		for (size_t q = 0; q < V; q++) { mpc->step[q] = trial[q] - v[q]; }
		real length = 1;
		for (size_t h = 0; h < MPC_HALVINGS; h++, length /= 2) {
			for (size_t q = 0; q < V; q++) { trial[q] = v[q] + length * mpc->step[q]; }
			clip_all(c, trial);
			const real residual = evaluate(mpc, trial, mpc->other);
			if (rise(v, gradient, trial, mpc->other, V) < 0) {
				copy(v, trial, V);
				copy(gradient, mpc->other, V);
				result->residual = residual;
				break;
			}
		}
	}
	return KOOP_OK;
}

static int solve_newton(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	result->residual = evaluate(mpc, mpc->plan, mpc->gradient);
	const int status = active_set(mpc, result);
	return status == KOOP_OK ? projected_newton(mpc, result) : status;
}

/* ---- Accelerated projected gradient, without a matrix ------------------------ */

/* FISTA with restart and backtracking on the step. The Hessian is applied once
 * an iteration: it is linear, so its product with the extrapolated point is
 * extrapolated too. */
static int solve_gradient(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	real *v = mpc->plan, *gradient = mpc->gradient;
	real *y = mpc->trial, *gradient_y = mpc->other;
	real *next = mpc->step, *next_gradient = mpc->work;
	real momentum = 1, lipschitz = 0;

	result->residual = evaluate(mpc, v, gradient);
	for (size_t q = 0; q < V; q++) { lipschitz = max_of(lipschitz, mpc->diagonal[q]); }
	copy(y, v, V);
	copy(gradient_y, gradient, V);
	for (; result->iterations < KOOP_MPC_MAX_GRADIENT && result->residual > c->tolerance;
	     result->iterations++) {
		for (size_t q = 0; q < V; q++) {
			next[q] = clip(y[q] - gradient_y[q] / lipschitz, c->u_min[q % m], c->u_max[q % m]);
		}
		const real residual = evaluate(mpc, next, next_gradient);

		real curvature = 0, square = 0, uphill = 0;
		for (size_t q = 0; q < V; q++) {
			const real step = next[q] - y[q];
			curvature += step * (next_gradient[q] - gradient_y[q]);
			square += step * step;
			uphill += (y[q] - next[q]) * (next[q] - v[q]);
		}
		if (curvature > lipschitz * square) {
			lipschitz = max_of((real)1.5 * lipschitz, curvature / square);
			continue;
		}
		const real old = uphill > 0 ? 1 : momentum;
		momentum = (1 + MATH(sqrt)(1 + 4 * old * old)) / 2;
		const real beta = (old - 1) / momentum;
		for (size_t q = 0; q < V; q++) {
			y[q] = next[q] + beta * (next[q] - v[q]);
			gradient_y[q] = next_gradient[q] + beta * (next_gradient[q] - gradient[q]);
			v[q] = next[q];
			gradient[q] = next_gradient[q];
		}
		result->residual = residual;
	}
	return KOOP_OK;
}

/* ---- Public ------------------------------------------------------------------- */

static int mpc_config_check(const KOOP(mpc_config) *c) {
	if (!c || !c->Q || !c->R || !c->u_min || !c->u_max || !c->u_safe) { return KOOP_E_NULL; }
	const size_t n = c->n_states, m = c->n_inputs;
	if (n < 1 || n > c->n_lifted || m < 1 || c->n_lifted > KOOP_MAX_DIM || m > KOOP_MAX_DIM - c->n_lifted) {
		return KOOP_E_SIZE;
	}
	if (c->horizon < 1 || c->horizon > KOOP_MPC_MAX_HORIZON) { return KOOP_E_SIZE; }
	if (!all_finite(c->Q, n * n) || !all_finite(c->R, m * m) || (c->S && !all_finite(c->S, m * m))) {
		return KOOP_E_INPUT;
	}
	for (size_t j = 0; j < m; j++) {
		if (!(c->R[j * m + j] > 0)) { return KOOP_E_RANGE; }
		if (!(is_finite(c->u_min[j]) && is_finite(c->u_max[j]))) { return KOOP_E_INPUT; }
		if (!(c->u_min[j] <= c->u_safe[j] && c->u_safe[j] <= c->u_max[j])) { return KOOP_E_RANGE; }
	}
	if (!(c->tolerance >= 0 && is_finite(c->tolerance))) { return KOOP_E_RANGE; }
	if (c->method != KOOP_MPC_NEWTON && c->method != KOOP_MPC_GRADIENT) { return KOOP_E_RANGE; }
	return KOOP_OK;
}

static size_t mpc_reals_needed(const KOOP(mpc_config) *c) {
	return c->method == KOOP_MPC_NEWTON
	           ? KOOP_MPC_REALS_NEWTON(c->n_lifted, c->n_states, c->n_inputs, c->horizon)
	           : KOOP_MPC_REALS_GRADIENT(c->n_lifted, c->n_states, c->n_inputs, c->horizon);
}

int KOOP(mpc_reset)(KOOP(mpc) *mpc) {
	if (!mpc || !mpc->plan) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs;
	for (size_t q = 0; q < mpc->config.horizon * m; q++) { mpc->plan[q] = mpc->config.u_safe[q % m]; }
	return KOOP_OK;
}

int KOOP(mpc_init)(KOOP(mpc) *mpc, const KOOP(mpc_config) *config, real *storage, size_t reals) {
	const int status = mpc_config_check(config);
	if (status != KOOP_OK) { return status; }
	if (!mpc || !storage) { return KOOP_E_NULL; }
	if (reals < mpc_reals_needed(config)) { return KOOP_E_STORAGE; }

	const size_t n = config->n_states, m = config->n_inputs, H = config->horizon, V = H * m;
	for (size_t i = 0; i < mpc_reals_needed(config); i++) { storage[i] = 0; }
	mpc->config = *config;
	if (!(config->tolerance > 0)) { mpc->config.tolerance = MATH(sqrt)(REAL_EPSILON) / 16; }
	mpc->markov = storage;
	mpc->markov_q = mpc->markov + n * V;
	mpc->state = mpc->markov_q + n * V;
	mpc->linear = mpc->state + n * H;
	mpc->diagonal = mpc->linear + V;
	mpc->plan = mpc->diagonal + V;
	mpc->gradient = mpc->plan + V;
	mpc->trial = mpc->gradient + V;
	mpc->other = mpc->trial + V;
	mpc->step = mpc->other + V;
	mpc->work = mpc->step + V;
	mpc->set = mpc->work + KOOP_MPC_WORK(config->n_lifted, m, H);
	mpc->factor = config->method == KOOP_MPC_NEWTON ? mpc->set + V : NULL;
	return KOOP(mpc_reset)(mpc);
}

/* The plan of the last step, one step on; its last input stands for two. */
static void shift_plan(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	for (size_t q = V; q-- > m;) { mpc->plan[q] = mpc->plan[q - m]; }
}

static int solve(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                 const real *u_before, KOOP(mpc_result) *result) {
	const KOOP(mpc_config) *c = &mpc->config;
	int status = condense(mpc, theta, psi, reference, u_before);
	if (status != KOOP_OK) { return status; }
	shift_plan(mpc);
	status = c->method == KOOP_MPC_NEWTON ? solve_newton(mpc, result) : solve_gradient(mpc, result);
	if (status != KOOP_OK) { return status; }
	return is_finite(result->residual) && all_finite(mpc->plan, c->horizon * c->n_inputs) ? KOOP_OK
	                                                                                      : KOOP_E_OVERFLOW;
}

int KOOP(mpc_solve)(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                    const real *u_before, real *u, KOOP(mpc_result) *result) {
	KOOP(mpc_result) seen = {0, 0};
	if (!mpc || !mpc->plan || !theta || !psi || !reference || !u) { return KOOP_E_NULL; }
	if (mpc->config.S && !u_before) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs, H = mpc->config.horizon;

	int status = KOOP_E_INPUT;
	if (all_finite(psi, mpc->config.n_lifted) && all_finite(reference, H * mpc->config.n_states) &&
	    (!mpc->config.S || all_finite(u_before, m))) {
		status = solve(mpc, theta, psi, reference, u_before, &seen);
	}
	if (status != KOOP_OK) { KOOP(mpc_reset)(mpc); }
	for (size_t j = 0; j < m; j++) {
		u[j] = status == KOOP_OK ? mpc->plan[(H - 1) * m + j] : mpc->config.u_safe[j];
	}
	if (result) { *result = seen; }
	return status;
}

int KOOP(mpc_plan)(const KOOP(mpc) *mpc, real *plan) {
	if (!mpc || !mpc->plan || !plan) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs, H = mpc->config.horizon;
	for (size_t k = 0; k < H; k++) { copy(plan + k * m, mpc->plan + (H - 1 - k) * m, m); }
	return KOOP_OK;
}
