/* Koopman-MPC: the condensed quadratic program with bounds, by the projected Newton method of Bertsekas. The
 * free inputs, at which no bound is active, move to where their gradient vanishes, clipped to the bounds, if
 * that decreases the cost. Otherwise they take a shorter step that does. So no active set occurs twice. */

/* The bound that is active at an input with this gradient, if any. */
static signed char active_limit(real v, real slope, real low, real high) {
	const int upper = v >= high && slope <= 0, lower = !upper && v <= low && slope >= 0;
	return (signed char)(HELD * (upper - lower));
}

/* Stores a new active set. Inputs that are no longer free are dropped from the factor, if it is valid. */
static void set_free(KOOP(mpc) *mpc, const signed char *wanted) {
	for (size_t q = 0, r = 0; q < mpc->config.horizon * mpc->config.n_inputs; q++) {
		if (!in_factor(mpc->set[q])) {
			mpc->set[q] = wanted[q];
			continue;
		}
		if (mpc->factored && mpc->set[q] == FREE && wanted[q] != FREE) { drop_row(mpc, r); }
		mpc->set[q] = (signed char)(DROPPED * wanted[q]);
		r++;
	}
}

/* Chooses the free inputs: all but those that descent pushes against their bound. Returns 1 if the set has
 * changed. If a few inputs have left the set and none has joined it, they are dropped from the factor;
 * otherwise the factor becomes invalid. */
#define MPC_MAX_DROPPED 8

static int choose_free(KOOP(mpc) *mpc, const real *slope) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	signed char *wanted = (signed char *)mpc->work;
	int dropped = 0, back = 0;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		wanted[q] = active_limit(mpc->plan[q], slope[q], mpc->u_min[j], mpc->u_max[j]);
		const int was_free = mpc->set[q] == FREE, is_free = wanted[q] == FREE;
		dropped += was_free > is_free;
		back += is_free > was_free;
	}
	if (dropped + back == 0) { return 0; }
	if (back > 0 || dropped > MPC_MAX_DROPPED) { mpc->factored = 0; }
	set_free(mpc, wanted);
	return 1;
}

/* Largest element of the gradient over the free inputs, scaled by the diagonal. */
static real free_residual(const KOOP(mpc) *mpc, const real *gradient) {
	real largest = 0;
	for (size_t q = 0; q < mpc->config.horizon * mpc->config.n_inputs; q++) {
		if (mpc->set[q] == FREE) { largest = max_of(largest, MATH(fabs)(gradient[q] * mpc->inverse[q])); }
	}
	return largest;
}

/* Twice the change of the cost from the plan to the trial. It is exact, since the cost is quadratic. */
static real cost_change(const KOOP(mpc) *mpc) {
	real sum = 0;
	for (size_t q = 0; q < mpc->config.horizon * mpc->config.n_inputs; q++) {
		sum += (mpc->trial[q] - mpc->plan[q]) * (mpc->gradient[q] + mpc->trial_gradient[q]);
	}
	return sum;
}

/* trial = plan with the free inputs moved to where their gradient vanishes, clipped to the bounds if
 * `in_box`. Returns 1 if nothing was clipped. */
static int try_newton(KOOP(mpc) *mpc, int in_box) {
	copy(mpc->trial, mpc->plan, mpc->config.horizon * mpc->config.n_inputs);
	return newton_step(mpc, mpc->trial, mpc->gradient, in_box);
}

static int have_factor(KOOP(mpc) *mpc) {
	return mpc->factored ? KOOP_OK : factor_free(mpc);
}

/* Computes -step = the Newton step over those inputs that it does not push against their bound. The others
 * are fixed, and the step is computed again until it fixes no more. It is a feasible descent direction. */
static int find_descent_direction(KOOP(mpc) *mpc) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	for (size_t k = 0; k <= V; k++) { /* never: returns earlier, as each pass fixes an input more */
		const int status = have_factor(mpc);
		if (status != KOOP_OK) { return status; }
		(void)try_newton(mpc, 0);
		for (size_t q = 0; q < V; q++) { mpc->step[q] = mpc->plan[q] - mpc->trial[q]; }
		if (!all_finite(mpc->step, V)) { break; } /* the active set would cycle */
		if (!choose_free(mpc, mpc->step)) { return KOOP_OK; }
	}
	return KOOP_E_OVERFLOW;
}

/* The fraction of the step at which the first input reaches its bound, at most 1. */
static real length_to_bound(const KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	real length = 1;
	for (size_t q = 0, j = 0; q < c->horizon * c->n_inputs; q++, j = next_input(j, c->n_inputs)) {
		const real speed = MATH(fabs)(mpc->step[q]);
		const real room = mpc->step[q] > 0 ? mpc->plan[q] - mpc->u_min[j] : mpc->u_max[j] - mpc->plan[q];
		if (room < speed * length) { length = room / speed; }
	}
	return length * (1 + 4 * REAL_EPSILON); /* reaches the bound despite rounding */
}

/* Backtracking line search: trial = plan - step, clipped to the bounds, then a quarter of the step, and so
 * on, until the cost decreases; at the end only up to the first bound. Returns the residual. */
#define MPC_MIN_LENGTH ((real)0.05)

OUT_OF_LINE static real line_search(KOOP(mpc) *mpc) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	const real smallest = length_to_bound(mpc);
	real length = 1;
	for (;;) {
		for (size_t q = 0; q < V; q++) { mpc->trial[q] = mpc->plan[q] - length * mpc->step[q]; }
		clip_all(mpc, mpc->trial);
		const real residual = evaluate(mpc, mpc->trial, mpc->trial_gradient);
		if (length <= smallest || cost_change(mpc) < 0) { return residual; }
		length = length > MPC_MIN_LENGTH ? max_of(length / 4, smallest) : smallest;
	}
}

/* Keeps a factor of an earlier solve as long as two more steps with it are predicted to suffice: the model
 * changes little between solves. */
static void review_factor(KOOP(mpc) *mpc, int downhill) {
	if (mpc->fresh) { return; }
	const real before = free_residual(mpc, mpc->gradient), after = free_residual(mpc, mpc->trial_gradient);
	const real rho = after / before;
	if (!(downhill && after * rho * rho <= mpc->config.tolerance)) { mpc->factored = 0; }
}

/* plan = trial, or if that does not decrease the cost, the result of the line search. `again`: the free
 * inputs are those of the previous step, so that the residual is round-off. *continues: 1 if another step can
 * help. */
static int take_step(KOOP(mpc) *mpc, KOOP(mpc_result) *result, real residual, int downhill, int again,
                     int *continues) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	*continues = !again || residual < result->residual / 2;
	if (!*continues && !(residual < result->residual)) { return KOOP_OK; }
	if (!downhill) {
		const int status = find_descent_direction(mpc);
		if (status != KOOP_OK) { return status; }
		residual = line_search(mpc);
		*continues = cost_change(mpc) < 0;
		if (!*continues) { return KOOP_OK; }
	}
	copy(mpc->plan, mpc->trial, V);
	copy(mpc->gradient, mpc->trial_gradient, V);
	result->residual = residual;
	return KOOP_OK;
}

/* Returns 1 if the trial is better than the plan: a lower cost, or a smaller residual if only round-off
 * remains. */
static int is_improvement(const KOOP(mpc) *mpc, real before, real residual, int again) {
	return cost_change(mpc) < 0 || (residual < before && (again || residual < mpc->noise));
}

/* A last correction of round-off. A small one is applied without an evaluation. A large one may come from a
 * numerically singular Hessian, and is applied only if it reduces the residual. */
static void correct(KOOP(mpc) *mpc, real residual) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real farthest = 0;
	for (size_t q = 0; q < V; q++) { farthest = max_of(farthest, MATH(fabs)(mpc->trial[q] - mpc->plan[q])); }
	if (farthest < mpc->noise || evaluate(mpc, mpc->trial, mpc->trial_gradient) < residual) {
		copy(mpc->plan, mpc->trial, V);
	}
}

/* A Newton step. *whole: 1 if no bound has shortened it; on entry, the value of the previous step. */
static int step_newton(KOOP(mpc) *mpc, KOOP(mpc_result) *result, int *whole, int *continues) {
	estimate_noise(mpc);
	const int guessed = mpc->planned; /* the active set is that of the last plan */
	mpc->planned = 0;
	const int again = !guessed && !choose_free(mpc, mpc->gradient) && *whole;
	const int status = have_factor(mpc);
	if (status != KOOP_OK) { return status; }
	*whole = try_newton(mpc, 1) && mpc->fresh;
	if (again && result->residual < mpc->noise) {
		correct(mpc, result->residual);
		*continues = 0;
		return KOOP_OK;
	}
	const real residual = evaluate(mpc, mpc->trial, mpc->trial_gradient);
	const int downhill = is_improvement(mpc, result->residual, residual, again);
	*whole &= downhill;
	review_factor(mpc, downhill);
	if (!downhill && (guessed || !mpc->fresh)) { return KOOP_OK; }
	return take_step(mpc, result, residual, downhill, again, continues);
}

/* Newton steps as long as they help. */
OUT_OF_LINE static int descend_newton(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	int whole = 0, continues = 1;
	for (size_t k = 0; k < KOOP_MPC_MAX_NEWTON && continues && result->residual > mpc->config.tolerance;
	     k++) {
		result->iterations++;
		const int status = step_newton(mpc, result, &whole, &continues);
		if (status != KOOP_OK) { return status; }
	}
	return KOOP_OK;
}

/* ---- Public ------------------------------------------------------------------- */

static COLD int mpc_sizes_check(const KOOP(mpc_config) *c) {
	const size_t N = c->n_lifted, n = c->n_states, m = c->n_inputs;
	if (N > KOOP_MAX_DIM || n < 1 || n > N || m < 1 || m > KOOP_MAX_DIM - N) { return KOOP_E_SIZE; }
	if (c->horizon < 1 || c->horizon > KOOP_MPC_MAX_HORIZON) { return KOOP_E_SIZE; }
	return c->horizon * m <= KOOP_MPC_MAX_INPUTS ? KOOP_OK : KOOP_E_SIZE;
}

static COLD int weights_are_finite(const KOOP(mpc_config) *c) {
	const size_t n = c->n_states, m = c->n_inputs;
	return all_finite(c->Q, n * n) && all_finite(c->R, m * m) && (!c->S || all_finite(c->S, m * m));
}

static COLD int mpc_settings_check(const KOOP(mpc_config) *c) {
	const size_t m = c->n_inputs;
	const int status = limits_check(c->u_min, c->u_max, c->u_safe, m);
	if (status != KOOP_OK) { return status; }
	for (size_t j = 0; j < m; j++) {
		if (!(c->R[j * m + j] > 0)) { return KOOP_E_RANGE; }
		if (!(c->u_min[j] <= c->u_safe[j] && c->u_safe[j] <= c->u_max[j])) { return KOOP_E_RANGE; }
	}
	const int known = c->method == KOOP_MPC_NEWTON || c->method == KOOP_MPC_GRADIENT;
	return known && is_nonnegative(c->tolerance) ? KOOP_OK : KOOP_E_RANGE;
}

static COLD int mpc_config_check(const KOOP(mpc_config) *c) {
	if (!c || !c->Q || !c->R || !c->u_min || !c->u_max || !c->u_safe) { return KOOP_E_NULL; }
	const int status = mpc_sizes_check(c);
	if (status != KOOP_OK) { return status; }
	return weights_are_finite(c) ? mpc_settings_check(c) : KOOP_E_INPUT;
}

static COLD size_t mpc_reals_needed(const KOOP(mpc_config) *c) {
	const size_t rate = c->S ? KOOP_MPC_REALS_RATE(c->n_inputs, c->horizon) : 0;
	return rate + (c->method == KOOP_MPC_NEWTON
	                   ? KOOP_MPC_REALS_NEWTON(c->n_lifted, c->n_states, c->n_inputs, c->horizon)
	                   : KOOP_MPC_REALS_GRADIENT(c->n_lifted, c->n_states, c->n_inputs, c->horizon));
}

COLD int KOOP(mpc_reset)(KOOP(mpc) *mpc) {
	if (!mpc || !mpc->plan) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	for (size_t q = 0; q < V; q++) {
		mpc->plan[q] = mpc->u_safe[q % m];
		mpc->set[q] = FREE;
	}
	mpc->max_eigenvalue = 1;
	mpc->n_free = 0;
	mpc->factored = 0;
	mpc->planned = 0;
	return KOOP_OK;
}

/* Sets the pointers into the storage. */
static COLD void mpc_lay_out(KOOP(mpc) *mpc, real *storage) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs, H = c->horizon, V = H * m;
	const size_t states = n * padded(H), inputs = padded(V);
	mpc->markov = storage;
	mpc->free_error = mpc->markov + n * V;
	mpc->state = mpc->free_error + states;
	mpc->inverse = mpc->state + states;
	mpc->plan = mpc->inverse + inputs;
	mpc->gradient = mpc->plan + inputs;
	mpc->trial = mpc->gradient + inputs;
	mpc->trial_gradient = mpc->trial + inputs;
	mpc->step = mpc->trial_gradient + inputs;
	mpc->set = (signed char *)(mpc->step + inputs);
	mpc->u_before = mpc->step + inputs + inputs / 4;
	mpc->u_min = mpc->u_before + m;
	mpc->u_max = mpc->u_min + m;
	mpc->u_safe = mpc->u_max + m;
	mpc->roots = mpc->u_safe + m;
	mpc->work = mpc->roots + 2 * m * m + n * n;
	mpc->direction = mpc->trial;
	mpc->hessian_direction = mpc->trial_gradient;
	mpc->square = mpc->generator = mpc->factor = NULL;
	if (c->method == KOOP_MPC_NEWTON) {
		mpc->square = mpc->work + KOOP_MPC_WORK(c->n_lifted, n, m, H);
		mpc->generator = mpc->square + GROUP * (GROUP + 1);
		mpc->factor = mpc->generator + generator_rows(c) * inputs + WINDOW;
	}
}

COLD int KOOP(mpc_init)(KOOP(mpc) *mpc, const KOOP(mpc_config) *config, real *storage, size_t reals) {
	const int status = mpc_config_check(config);
	if (status != KOOP_OK) { return status; }
	if (!mpc || !storage) { return KOOP_E_NULL; }
	const size_t needed = mpc_reals_needed(config);
	if (reals < needed) { return KOOP_E_STORAGE; }

	for (size_t i = 0; i < needed; i++) { storage[i] = 0; }
	mpc->config = *config;
	if (!(config->tolerance > 0)) { mpc->config.tolerance = MPC_TOLERANCE; }
	mpc_lay_out(mpc, storage);
	(void)take_limits(mpc);
	if (!take_roots(mpc)) {
		mpc->plan = NULL; /* every later call returns KOOP_E_NULL */
		return KOOP_E_RANGE;
	}
	return KOOP(mpc_reset)(mpc);
}

/* Shifts input j of the last plan, and its active set, by one step and clips it to the present limits. The
 * last step is repeated. Returns the number of its elements in the factor. */
static size_t shift_input(KOOP(mpc) *mpc, size_t j) {
	const size_t m = mpc->config.n_inputs;
	const real low = mpc->u_min[j], high = mpc->u_max[j];
	real *plan = mpc->plan;
	signed char *held = mpc->set;
	int changed = 0;
	size_t rows = 0;
	for (size_t q = mpc->config.horizon * m + j; q >= m;) {
		q -= m;
		const size_t from = q < m ? q : q - m;
		real u = clip(plan[from], low, high);
		signed char set = held[from];
		if (set != FREE) { set = follow_limit(known_set(set), low, high, &u); }
		changed |= held[q] ^ set;
		rows += in_factor(set);
		held[q] = set;
		plan[q] = u;
	}
	if (changed) { mpc->factored = 0; }
	return rows;
}

static void shift_plan(KOOP(mpc) *mpc) {
	size_t rows = 0;
	for (size_t j = 0; j < mpc->config.n_inputs; j++) { rows += shift_input(mpc, j); }
	if (rows != mpc->n_free) { mpc->factored = 0; } /* a bit of the storage has flipped */
}

static int arguments_are_finite(const KOOP(mpc_config) *c, const real *psi, const real *reference,
                                const real *u_before) {
	return all_finite(psi, c->n_lifted) && all_finite(reference, c->horizon * c->n_states) &&
	       (!c->S || all_finite(u_before, c->n_inputs));
}

/* Newton's method needs the Cholesky factors of the present weights. */
static int descend(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	if (mpc->config.method == KOOP_MPC_NEWTON) {
		return take_roots(mpc) ? descend_newton(mpc, result) : KOOP_E_INDEFINITE;
	}
	descend_projected(mpc, result);
	return KOOP_OK;
}

static int solve(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                 const real *u_before, KOOP(mpc_result) *result) {
	const KOOP(mpc_config) *c = &mpc->config;
	if (!arguments_are_finite(c, psi, reference, u_before)) { return KOOP_E_INPUT; }
	int status = condense(mpc, theta, psi, reference, u_before);
	if (status != KOOP_OK) { return status; }
	mpc->fresh = 0;
	shift_plan(mpc);
	result->residual = evaluate(mpc, mpc->plan, mpc->gradient);
	if (result->residual > c->tolerance) { status = descend(mpc, result); }
	if (status != KOOP_OK) { return status; }
	/* the plan and, behind it, the gradient: each of the three can be the only one that is not finite */
	const int finite =
	    is_finite(result->residual) && all_finite(mpc->plan, 2 * padded(c->horizon * c->n_inputs));
	return finite ? KOOP_OK : KOOP_E_OVERFLOW;
}

static int is_ready(const KOOP(mpc) *mpc, const real *u_before) {
	return mpc && mpc->plan && (!mpc->config.S || u_before);
}

int KOOP(mpc_solve)(KOOP(mpc) *mpc, const real *theta, const real *psi, const real *reference,
                    const real *u_before, real *u, KOOP(mpc_result) *result) {
	KOOP(mpc_result) seen = {0, 0};
	if (!is_ready(mpc, u_before) || !theta || !psi || !reference || !u) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs;
	int status = take_limits(mpc);
	copy(u, mpc->u_safe, m);
	if (status == KOOP_OK) {
		status = solve(mpc, theta, psi, reference, u_before, &seen);
		if (status != KOOP_OK) { (void)KOOP(mpc_reset)(mpc); }
		mpc->planned = status == KOOP_OK;
		copy(u, mpc->plan + (mpc->config.horizon - 1) * m, m); /* u_safe after a reset */
	}
	if (result) { *result = seen; }
	return status;
}

COLD int KOOP(mpc_plan)(const KOOP(mpc) *mpc, real *plan) {
	if (!mpc || !mpc->plan || !plan) { return KOOP_E_NULL; }
	const size_t m = mpc->config.n_inputs, H = mpc->config.horizon;
	for (size_t k = 0; k < H; k++) { copy(plan + k * m, mpc->plan + (H - 1 - k) * m, m); }
	return KOOP_OK;
}

COLD int KOOP(mpc_sensitivity)(const KOOP(mpc) *mpc, size_t step, real *G) {
	if (!mpc || !mpc->plan || !G) { return KOOP_E_NULL; }
	const size_t n = mpc->config.n_states, m = mpc->config.n_inputs;
	if (step >= mpc->config.horizon) { return KOOP_E_SIZE; }
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < m; j++) { G[i * m + j] = markov_row(mpc, i, j)[step]; }
	}
	return KOOP_OK;
}
