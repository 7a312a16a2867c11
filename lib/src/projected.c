/* Projected gradient without a matrix, accelerated by conjugate directions as long
 * as no bound comes in the way: modified proportioning with reduced gradient
 * projections (Dostal and Schoeberl 2005), scaled by the Hessian's diagonal. Goes
 * downhill at every step, whatever the bounds. */

/* The gradient by element q, of input j, or 0 where a bound holds the input; *at_bound: whether it
 * is at one. */
static real way_down(const KOOP(mpc) *mpc, size_t q, size_t j, int *at_bound) {
	const real v = mpc->plan[q], g = mpc->gradient[q];
	const int low = v <= mpc->u_min[j], high = v >= mpc->u_max[j];
	*at_bound = low || high;
	return (low && g > 0) || (high && g < 0) ? 0 : g;
}

/* way = steepest descent, either of the inputs inside the box or of those that are
 * to leave a bound, whichever promises more; returns 1 for the latter. */
static int begin_way(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs, V = c->horizon * m;
	real promise[2] = {0, 0};
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = way_down(mpc, q, j, &at_bound),
		           step = MATH(fabs)(g) * mpc->inverse[q] / mpc->max_eigenvalue;
		const real room = g > 0 ? mpc->plan[q] - mpc->u_min[j] : mpc->u_max[j] - mpc->plan[q];
		promise[at_bound] += MATH(fabs)(g) * (step < room ? step : room);
	}
	const int leave = promise[1] > promise[0];
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = way_down(mpc, q, j, &at_bound);
		mpc->direction[q] = at_bound == leave ? -g * mpc->inverse[q] : 0;
	}
	return leave;
}

/* way = the next conjugate direction, after a step along it that no bound has cut
 * short; returns 0 where leaving a bound promises more. */
static int continue_way(KOOP(mpc) *mpc, real curvature) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	real promise[2] = {0, 0}, turn = 0;
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = way_down(mpc, q, j, &at_bound), scaled_g = g * mpc->inverse[q];
		promise[at_bound] += g * scaled_g;
		turn += at_bound ? 0 : scaled_g * mpc->hessian_direction[q];
	}
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = way_down(mpc, q, j, &at_bound);
		mpc->direction[q] = at_bound ? 0 : turn / curvature * mpc->direction[q] - g * mpc->inverse[q];
	}
	return promise[0] >= promise[1];
}

/* The longest step along the way inside the box. */
static real room_along(const KOOP(mpc) *mpc) {
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

/* A gradient step of the inputs inside the box, projected: several bounds can be met at once. */
static void project_gradient(KOOP(mpc) *mpc) {
	const size_t m = mpc->config.n_inputs, V = mpc->config.horizon * m;
	int at_bound;
	for (size_t q = 0, j = 0; q < V; q++, j = next_input(j, m)) {
		const real g = way_down(mpc, q, j, &at_bound);
		mpc->plan[q] -= at_bound ? 0 : g * mpc->inverse[q] / mpc->max_eigenvalue;
	}
	clip_all(mpc, mpc->plan);
}

/* bent = H way; returns way' H way, and keeps track of the largest eigenvalue of the
 * scaled Hessian. */
static real bend(KOOP(mpc) *mpc) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	real square = 0;
	multiply_hessian(mpc, mpc->direction, mpc->hessian_direction);
	for (size_t q = 0; q < V; q++) { square += mpc->direction[q] * mpc->direction[q] / mpc->inverse[q]; }
	const real curvature = dot(mpc->direction, mpc->hessian_direction, V);
	mpc->max_eigenvalue = max_of(curvature / square, mpc->max_eigenvalue);
	return curvature;
}

/* One step along the way. *goes_on: no bound has cut it short, nor was one left. */
static void go_along(KOOP(mpc) *mpc, int leaving, real *curvature, int *goes_on) {
	const size_t V = mpc->config.horizon * mpc->config.n_inputs;
	const real bends = bend(mpc), room = room_along(mpc);
	/* where it bends down, by round-off or by the weights, the best is at the bound */
	const real wanted = bends < 0 ? (real)INFINITY : -dot(mpc->direction, mpc->gradient, V) / bends;
	const real length = wanted < room ? wanted : room;
	add_scaled(mpc->plan, length, mpc->direction, V);
	add_scaled(mpc->gradient, length, mpc->hessian_direction, V);
	clip_all(mpc, mpc->plan);
	if (wanted > room && !leaving) { project_gradient(mpc); }
	*goes_on = wanted <= room && !leaving;
	*curvature = bends;
}

/* The residual at the plan. While the steps go on, by the gradient that they have updated, and
 * only where that is `due` or says that all is done by a new one; returns whether it then was. */
static int see_residual(KOOP(mpc) *mpc, KOOP(mpc_result) *result, int goes_on, int due) {
	if (goes_on) {
		result->residual = kkt_residual(mpc, mpc->plan, mpc->gradient);
		if (result->residual > mpc->config.tolerance && !due) { return 0; }
	}
	result->residual = evaluate(mpc, mpc->plan, mpc->gradient);
	return goes_on;
}

/* Whether what is left can be all round-off, and is not half of what the last look saw. */
static int stalls(const KOOP(mpc) *mpc, real residual, real *last) {
	const int stalled = residual < mpc->noise && !(residual < *last / 2);
	*last = residual;
	return stalled;
}

#define MPC_REFRESH 100 /* steps until the gradient is evaluated again, not updated */

OUT_OF_LINE static void descend_projected(KOOP(mpc) *mpc, KOOP(mpc_result) *result) {
	real last = REAL_MAX, curvature;
	int goes_on = 0;
	for (size_t k = 1; k <= KOOP_MPC_MAX_GRADIENT && result->residual > mpc->config.tolerance;
	     k++, result->iterations++) {
		estimate_noise(mpc);
		const int leaving = !goes_on && begin_way(mpc);
		go_along(mpc, leaving, &curvature, &goes_on);
		const int settled = see_residual(mpc, result, goes_on, k % MPC_REFRESH == 0);
		if (settled && stalls(mpc, result->residual, &last)) { break; }
		goes_on = goes_on && !settled && continue_way(mpc, curvature);
	}
}
