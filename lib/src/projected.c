/* Matrix-free projected gradient method, accelerated by conjugate directions until a bound becomes active:
 * modified proportioning with reduced gradient projections (Dostal and Schoeberl 2005), scaled by the
 * Hessian's diagonal. The cost decreases at every step. */

/* Element q of the gradient, which belongs to input j; 0 if the gradient pushes the input against its bound.
 * *at_bound: 1 if the input is at a bound. */
static real reduced_gradient(const KOOP(mpc) *mpc, size_t q, size_t j, int *at_bound) {
	const real v = mpc->plan[q], g = mpc->gradient[q];
	const int low = v <= mpc->u_min[j], high = v >= mpc->u_max[j];
	*at_bound = low || high;
	return (low && g > 0) || (high && g < 0) ? 0 : g;
}

/* direction = steepest descent, either over the inputs between their bounds or over those that should leave a
 * bound, whichever decreases the cost more. Returns 1 in the second case. */
static int restart_direction(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	real decrease[2] = {0, 0};
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = reduced_gradient(mpc, q, j, &at_bound),
		           step = MATH(fabs)(g) * mpc->inverse[q] / mpc->max_eigenvalue;
		const real room = g > 0 ? mpc->plan[q] - mpc->u_min[j] : mpc->u_max[j] - mpc->plan[q];
		decrease[at_bound] += MATH(fabs)(g) * (step < room ? step : room);
	}
	const int leave = decrease[1] > decrease[0];
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = reduced_gradient(mpc, q, j, &at_bound);
		mpc->direction[q] = at_bound == leave ? -g * mpc->inverse[q] : 0;
	}
	return leave;
}

/* direction = the next conjugate direction, after a step that no bound has shortened. Returns 0 if leaving a
 * bound decreases the cost more. */
static int conjugate_direction(KOOP(mpc) *mpc, real curvature) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	real decrease[2] = {0, 0}, turn = 0;
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = reduced_gradient(mpc, q, j, &at_bound), scaled_g = g * mpc->inverse[q];
		decrease[at_bound] += g * scaled_g;
		turn += at_bound ? 0 : scaled_g * mpc->hessian_direction[q];
	}
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = reduced_gradient(mpc, q, j, &at_bound);
		mpc->direction[q] = at_bound ? 0 : turn / curvature * mpc->direction[q] - g * mpc->inverse[q];
	}
	return decrease[0] >= decrease[1];
}

/* The longest step along the direction that stays inside the limits. */
static real max_length(const KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs;
	real length = REAL_MAX;
	for (size_t q = 0, j = 0; q < c->horizon * m; q++, j = next_input(j, m)) {
		const real way = mpc->direction[q], speed = MATH(fabs)(way);
		const real room = way < 0 ? mpc->plan[q] - mpc->u_min[j] : mpc->u_max[j] - mpc->plan[q];
		if (room < speed * length) { length = room / speed * (1 + 4 * REAL_EPSILON); }
	}
	return length;
}

/* A projected gradient step over the inputs between their bounds: several bounds can become active at once.
 */
static void project_gradient(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = reduced_gradient(mpc, q, j, &at_bound);
		mpc->plan[q] -= at_bound ? 0 : g * mpc->inverse[q] / mpc->max_eigenvalue;
	}
	clip_all(mpc, mpc->plan);
}

/* Computes hessian_direction = H direction; returns direction' H direction. Updates the largest eigenvalue of
 * the scaled Hessian. */
static real curvature_along(KOOP(mpc) *mpc) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real square = 0;
	multiply_hessian(mpc, mpc->direction, mpc->hessian_direction);
	for (size_t q = 0; q < V; q++) { square += mpc->direction[q] * mpc->direction[q] / mpc->inverse[q]; }
	const real curvature = dot(mpc->direction, mpc->hessian_direction, V);
	mpc->max_eigenvalue = max_of(curvature / square, mpc->max_eigenvalue);
	return curvature;
}

/* One step along the direction. *continues: 1 if no bound has shortened it and no bound was left. */
static void step_along(KOOP(mpc) *mpc, int leaving, real *curvature, int *continues) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	const real along = curvature_along(mpc), room = max_length(mpc);
	/* with negative curvature, from round-off or from the weights, the minimum is at the bound */
	const real wanted = along < 0 ? (real)INFINITY : -dot(mpc->direction, mpc->gradient, V) / along;
	const real length = wanted < room ? wanted : room;
	add_scaled(mpc->plan, length, mpc->direction, V);
	add_scaled(mpc->gradient, length, mpc->hessian_direction, V);
	clip_all(mpc, mpc->plan);
	if (wanted > room && !leaving) { project_gradient(mpc); }
	*continues = wanted <= room && !leaving;
	*curvature = along;
}

/* Updates the KKT residual of the plan. Conjugate steps update the gradient; it is evaluated again if that is
 * `due` or if the updated one meets the tolerance. Returns 1 if it was evaluated again. */
static int update_residual(KOOP(mpc) *mpc, KOOP(mpc_result) *result, int continues, int due) {
	if (continues) {
		result->residual = kkt_residual(mpc, mpc->plan, mpc->gradient);
		if (result->residual > mpc->config.tolerance && !due) { return 0; }
	}
	result->residual = evaluate(mpc, mpc->plan, mpc->gradient);
	return continues;
}

/* Returns 1 if the residual can be round-off alone and has not halved since the last evaluation. */
static int stalls(const KOOP(mpc) *mpc, real residual, real *last) {
	const int stalled = residual < mpc->noise && !(residual < *last / 2);
	*last = residual;
	return stalled;
}

#define MPC_REFRESH 100 /* steps between two evaluations of the gradient */

OUT_OF_LINE static void descend_projected(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	real last = REAL_MAX, curvature;
	int continues = 0;
	for (size_t k = 1; k <= KOOP_MPC_MAX_GRADIENT && result->residual > mpc->config.tolerance;
	     k++, result->iterations++) {
		estimate_noise(mpc);
		const int leaving = !continues && restart_direction(mpc);
		step_along(mpc, leaving, &curvature, &continues);
		const int settled = update_residual(mpc, result, continues, k % MPC_REFRESH == 0);
		if (settled && stalls(mpc, result->residual, &last)) { break; }
		continues = continues && !settled && conjugate_direction(mpc, curvature);
	}
}
