/* The limits of one solve, copied from the configuration at its start. They may change before the next solve,
 * as rate limits and limits of a battery do. Infinity means no limit. */

/* State of an input in the active set (mpc->set). Multiplied by DROPPED, it is still a row and column of the
 * factor, which then have no effect. */
#define FREE 0
#define HELD 1    /* at its upper limit; -HELD: at its lower limit */
#define DROPPED 2 /* the same sign rule */

/* Clips x to [low, high]; NaN becomes low. */
static real clip(real x, real low, real high) {
	const real at_least_low = x >= low ? x : low;
	return at_least_low > high ? high : at_least_low;
}

/* Index of the input after input j. A remainder would cost a division per element. */
static size_t next_input(size_t j, size_t m) {
	return j + 1 < m ? j + 1 : 0;
}

/* Clips v to the limits. */
static void clip_all(const KOOP(mpc) *mpc, real *v) {
	const size_t m = mpc->config.n_inputs;
	for (size_t q = 0, j = 0; q < mpc->config.horizon * m; q++, j = next_input(j, m)) {
		v[q] = clip(v[q], mpc->u_min[j], mpc->u_max[j]);
	}
}

static int is_nan(real a) {
	return (bits_of(a) & ~SIGN_BIT) > INFINITY_BITS;
}

/* Checks that the limits leave a finite value for each input, and that `safe`, which may be outside, is
 * finite. */
static int limits_check(const real *low, const real *high, const real *safe, size_t m) {
	if (!all_finite(safe, m)) { return KOOP_E_INPUT; }
	for (size_t j = 0; j < m; j++) {
		if (is_nan(low[j]) || is_nan(high[j])) { return KOOP_E_INPUT; }
		if (!(low[j] <= high[j] && low[j] <= REAL_MAX && high[j] >= -REAL_MAX)) { return KOOP_E_RANGE; }
	}
	return KOOP_OK;
}

/* Largest magnitude or range of the limited inputs. */
static void size_box(KOOP(mpc) *mpc) {
	mpc->reach = 0;
	mpc->unlimited = 0;
	for (size_t j = 0; j < mpc->config.n_inputs; j++) {
		const real low = mpc->u_min[j], high = mpc->u_max[j];
		const real size = max_of(high - low, max_of(high, -low));
		if (is_finite(size)) {
			mpc->reach = max_of(mpc->reach, size);
		} else {
			mpc->unlimited = 1;
		}
	}
}

/* A residual below mpc->noise can be round-off alone. The magnitude of unlimited inputs is taken from the
 * plan. */
static void estimate_noise(KOOP(mpc) *mpc) {
	real size = mpc->reach;
	if (mpc->unlimited) {
		size = max_of(size, max_abs(mpc->plan, mpc->config.horizon * mpc->config.n_inputs));
	}
	mpc->noise = 128 * REAL_EPSILON * size;
}

/* Copies the present limits, all or none. Each is read once, since another task may change it meanwhile. */
static int take_limits(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t m = c->n_inputs;
	real *low = mpc->trial, *high = mpc->trial_gradient, *safe = mpc->step;
	copy(low, c->u_min, m);
	copy(high, c->u_max, m);
	copy(safe, c->u_safe, m);
	const int status = limits_check(low, high, safe, m);
	if (status != KOOP_OK) { return status; }
	for (size_t j = 0; j < m; j++) { mpc->u_safe[j] = clip(safe[j], low[j], high[j]); }
	copy(mpc->u_min, low, m);
	copy(mpc->u_max, high, m);
	size_box(mpc);
	return KOOP_OK;
}

/* Replaces a value that only a flipped bit can cause by FREE. */
static signed char known_set(signed char set) {
	return (signed char)(((set >= -DROPPED) & (set <= DROPPED)) * set);
}

/* Moves an input at a limit to the new limit. The input becomes free if that limit is infinite. */
static signed char follow_limit(signed char set, real low, real high, real *u) {
	const real limit = set > 0 ? high : low;
	if (set == FREE || !is_finite(limit)) { return FREE; }
	*u = limit;
	return set;
}
