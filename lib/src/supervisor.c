/* The supervisor chooses the model on which the controller plans. It uses the public interface only. */

#include "strict.h"
#include "attributes.h"

#include "finite.c"
#include "checksum.c"

enum {
	ONLINE = KOOP_SUPERVISOR_ONLINE,
	LAST_GOOD = KOOP_SUPERVISOR_LAST_GOOD,
	OFFLINE = KOOP_SUPERVISOR_OFFLINE
};

#define SUPERVISOR_ERROR_STEPS 20     /* memory of the one-step errors */
#define SUPERVISOR_TRACKING_STEPS 100 /* memory of the tracking error */
#define SUPERVISOR_MAX_RATIO 100 /* largest squared error of a sample over the mean of the offline model */
#define SUPERVISOR_MAX_WAIT 16   /* largest wait over config.patience */
#define SUPERVISOR_TRUSTED_FOR                                                                               \
	4 /* steps of trust, over config.patience, until a model is saved as last good */
#define SUPERVISOR_MIN_RANGE                                                                                 \
	200 /* smallest range of an input that is not fixed, over the solver's resolution */
#define SUPERVISOR_P0_DIVISOR                                                                                \
	100 /* p0 over the initial P after a restart, since Theta is then a good model */

static size_t theta_reals(const KOOP(supervisor) *g) {
	return (g->n_lifted + g->n_inputs) * KOOP_PAD(g->n_lifted);
}

/* y = x */
static void copy(real *y, const real *x, size_t count) {
	for (size_t i = 0; i < count; i++) { y[i] = x[i]; }
}

static real weight(const KOOP(supervisor) *g, size_t i) {
	return g->Q[i * (g->n_states + 1)];
}

/* ---- Comparison of the models ------------------------------------------------ */

/* Square of the one-step error of the tracked states, weighted by the diagonal of Q. */
static real square_error(const KOOP(supervisor) *g, const real *theta, const real *psi, const real *u,
                         const real *psi_next) {
	const size_t N = g->n_lifted, rows = KOOP_PAD(N);
	real sum = 0;
	for (size_t i = 0; i < g->n_states; i++) {
		real error = psi_next[i];
		for (size_t j = 0; j < N; j++) { error -= theta[j * rows + i] * psi[j]; }
		for (size_t j = 0; j < g->n_inputs; j++) { error -= theta[(N + j) * rows + i] * u[j]; }
		sum += weight(g, i) * error * error;
	}
	return sum;
}

/* Squared one-step error of each model on a sample, indexed by KOOP_SUPERVISOR_.... */
static void one_step_errors(const KOOP(supervisor) *g, const real *online, const real *psi, const real *u,
                            const real *psi_next, real *seen) {
	const real *const theta[] = {online, g->last_good, g->offline};
	for (int model = ONLINE; model <= OFFLINE; model++) {
		seen[model] = square_error(g, theta[model], psi, u, psi_next);
	}
}

/* Adds a sample to a mean square. Only a flipped bit makes the mean not finite. */
static void update_mean(real *mean, real seen) {
	if (!is_finite(*mean)) { *mean = seen; }
	*mean += (seen - *mean) / SUPERVISOR_ERROR_STEPS;
}

/* Adds a sample to the mean squares. An error that is too large, or NaN, is clipped, so that the mean
 * recovers. */
static void update_errors(KOOP(supervisor) *g, const real *seen) {
	if (!is_finite(SUPERVISOR_MAX_RATIO * seen[OFFLINE])) { return; }
	update_mean(&g->error[OFFLINE], seen[OFFLINE]);
	for (int model = ONLINE; model < OFFLINE; model++) {
		const real high = SUPERVISOR_MAX_RATIO * g->error[OFFLINE];
		update_mean(&g->error[model], seen[model] <= high ? seen[model] : high);
	}
}

static int predicts_well(const KOOP(supervisor) *g) {
	return g->error[ONLINE] <= g->config.max_error_ratio * g->config.max_error_ratio * g->error[OFFLINE];
}

/* Response of each state to each input over the horizon, in the model of the last plan, weighted by Q: its
 * square, and its inner product with the response of the offline model. */
static void compare_response(KOOP(supervisor) *g, const KOOP(mpc) *mpc) {
	const size_t m = g->n_inputs, pairs = g->n_states * m;
	for (size_t p = 0; p < pairs; p++) { g->square[p] = g->along[p] = 0; }
	for (size_t step = 0; step < g->horizon; step++) {
		const real *own = g->response + step * pairs;
		(void)KOOP(mpc_sensitivity)(mpc, step, g->now);
		for (size_t p = 0; p < pairs; p++) {
			g->square[p] += weight(g, p / m) * g->now[p] * g->now[p];
			g->along[p] += weight(g, p / m) * g->now[p] * own[p];
		}
	}
}

/* Returns 1 if the response to input j agrees with that of the offline model: the checked pairs in angle and
 * norm, all states together in norm. */
static int response_agrees(const KOOP(supervisor) *g, size_t j) {
	const KOOP(supervisor_config) *c = &g->config;
	const real low = c->min_gain * c->min_gain, high = c->max_gain * c->max_gain;
	real sum = 0;
	for (size_t i = 0; i < g->n_states; i++) {
		const size_t p = i * g->n_inputs + j;
		const real own = g->judged[p], square = g->square[p];
		sum += square;
		if (!(own > 0)) { continue; }
		/* Written so that NaN fails. */
		if (!(square >= low * own && square <= high * own)) { return 0; }
		if (!(g->along[p] >= c->min_cosine * MATH(sqrt)(square) * MATH(sqrt)(own))) { return 0; }
	}
	return sum <= high * g->size[j];
}

/* Returns 1 if the tracking error far exceeds its recent RMS. */
static int tracking_fails(KOOP(supervisor) *g, const real *psi) {
	real square = 0;
	for (size_t i = 0; i < g->n_states; i++) {
		const real error = psi[i] - g->target[i];
		square += weight(g, i) * error * error;
	}
	if (!is_finite(square)) { return 0; }
	if (!(g->tracking > 0)) { g->tracking = square; }
	const int fails = square > g->config.max_tracking_ratio * g->config.max_tracking_ratio * g->tracking;
	g->tracking += (square - g->tracking) / SUPERVISOR_TRACKING_STEPS;
	return fails;
}

/* ---- Choice of the model ------------------------------------------------------ */

/* The last good model bridges a few steps. After that the offline model is safer. */
static int fallback(const KOOP(supervisor) *g) {
	return g->have_last_good && g->distrusted < g->config.patience && g->error[LAST_GOOD] <= g->error[OFFLINE]
	           ? LAST_GOOD
	           : OFFLINE;
}

/* Excludes the online model for a number of steps, which doubles each time that it fails. */
static void distrust(KOOP(supervisor) *g) {
	g->wait = g->delay;
	if (g->model == ONLINE && g->delay < SUPERVISOR_MAX_WAIT * g->config.patience) { g->delay *= 2; }
}

/* Sets Theta to the last good or the offline model, unless the online model is in use and finite. */
static void restore_theta(KOOP(supervisor) *g, KOOP(rls) *rls) {
	const real *const models[] = {NULL, g->last_good, g->offline};
	const int in_use = g->model == ONLINE;
	/* rls_copy_theta() refuses a model that is not finite */
	if (in_use && KOOP(rls_copy_theta)(rls, rls->theta) == KOOP_OK) { return; }
	int from = in_use ? OFFLINE : fallback(g);
	if (KOOP(rls_copy_theta)(rls, models[from]) != KOOP_OK) {
		from = OFFLINE;
		(void)KOOP(rls_copy_theta)(rls, g->offline);
	}
	g->error[ONLINE] = g->error[from];
}

/* Restarts the learner. */
static void restart_learner(KOOP(supervisor) *g, KOOP(rls) *rls) {
	restore_theta(g, rls);
	/* p0 may be too small to be divided in this precision */
	if (KOOP(rls_reset_covariance)(rls, rls->config.p0 / SUPERVISOR_P0_DIVISOR) != KOOP_OK) {
		(void)KOOP(rls_reset_covariance)(rls, rls->config.p0);
	}
	g->distrusted = 0;
	g->failed = 0;
	g->resets++;
}

/* Arguments and result of supervisor_control(). */
typedef struct KOOP(request) {
	const real *theta[3]; /* by KOOP_SUPERVISOR_... */
	const real *psi, *reference, *u_before;
	real *u;
	KOOP(mpc_result) result;
	int status;
} KOOP(request);

/* The largest residual of an acceptable plan: a fraction of the narrowest range of an input. An input whose
 * range is near the resolution of the solver counts as fixed, and is left out. */
static real residual_allowed(const KOOP(supervisor) *g, const KOOP(mpc) *mpc) {
	const real solved = mpc->noise + mpc->config.tolerance;
	real allowed = (real)INFINITY;
	for (size_t j = 0; j < g->n_inputs; j++) {
		const real range = mpc->u_max[j] - mpc->u_min[j], part = g->config.max_residual * range;
		if (range > SUPERVISOR_MIN_RANGE * solved && part < allowed) { allowed = part; }
	}
	return allowed;
}

/* Plans on one model. Returns 1 if the plan can be trusted. */
static int plan(KOOP(supervisor) *g, KOOP(mpc) *mpc, int model, KOOP(request) *r) {
	r->status = KOOP(mpc_solve)(mpc, r->theta[model], r->psi, r->reference, r->u_before, r->u, &r->result);
	if (r->status != KOOP_OK || model == OFFLINE) { return r->status == KOOP_OK; }
	if (!(r->result.residual <= residual_allowed(g, mpc))) { return 0; }
	compare_response(g, mpc);
	for (size_t j = 0; j < g->n_inputs; j++) {
		if (!response_agrees(g, j)) { return 0; }
	}
	return 1;
}

/* Returns 0 if the arguments caused the status: a state that is not finite, or crossed limits. */
static int blames_model(int status) {
	return status != KOOP_E_INPUT && status != KOOP_E_RANGE;
}

/* Plans on the best model whose plan can be trusted, and returns that model. */
static int plan_on_best(KOOP(supervisor) *g, KOOP(mpc) *mpc, KOOP(request) *r) {
	int model = g->wait == 0 ? ONLINE : fallback(g);
	while (!plan(g, mpc, model, r) && model != OFFLINE && blames_model(r->status)) {
		if (model == ONLINE) { distrust(g); }
		if (model == LAST_GOOD) { g->have_last_good = 0; }
		model = fallback(g);
		(void)KOOP(mpc_reset)(mpc);
	}
	return r->status == KOOP_OK ? model : KOOP_SUPERVISOR_NONE;
}

/* ---- Flipped bits --------------------------------------------------------------- */

/* The offline model, the last good model and the response of the former are contiguous. */
static size_t models_words(const KOOP(supervisor) *g) {
	return WORDS(2 * theta_reals(g) + ((g->horizon + 1) * g->n_states + 1) * g->n_inputs);
}

static void seal_models(KOOP(supervisor) *g) {
	g->sum.words = g->sum.weighted = 0;
	checksum_add(&g->sum, g->offline, models_words(g));
}

/* Verifies and repairs the models. Returns 0 if they cannot be repaired. */
static int models_are_intact(KOOP(supervisor) *g) {
	koop_checksum now = {0, 0};
	checksum_add(&now, g->offline, models_words(g));
	if (checksum_has_flipped(&g->sum, &now)) { g->sum = now; }
	return checksum_same(&now, &g->sum) || checksum_repair(g->offline, models_words(g), 0, &g->sum, &now);
}

/* Counts the steps on and off the online model, and saves the last good one. */
static void count_steps(KOOP(supervisor) *g, const real *online) {
	if (g->model != ONLINE) {
		g->trusted = 0;
		g->distrusted++;
		return;
	}
	g->distrusted = 0;
	g->trusted++;
	if (g->trusted >= g->delay) { g->delay = g->config.patience; }
	if (g->trusted >= SUPERVISOR_TRUSTED_FOR * g->config.patience && g->trusted % g->config.patience == 0) {
		copy(g->last_good, online, theta_reals(g));
		seal_models(g);
		g->error[LAST_GOOD] = g->error[ONLINE];
		g->have_last_good = 1;
	}
}

/* ---- Public ------------------------------------------------------------------ */

static real or_default(real value, real otherwise) {
	return value > 0 ? value : otherwise;
}

static int supervisor_config_check(const KOOP(supervisor_config) *c) {
	const real values[] = {c->min_cosine,      c->min_gain,     c->max_gain,
	                       c->max_error_ratio, c->max_residual, c->max_tracking_ratio};
	for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
		if (!(values[i] >= 0 && is_finite(values[i]))) { return KOOP_E_RANGE; }
	}
	return KOOP_OK;
}

static void set_config(KOOP(supervisor) *g, const KOOP(supervisor_config) *c) {
	g->config.min_cosine = or_default(c->min_cosine, (real)0.7);
	g->config.min_gain = or_default(c->min_gain, (real)0.2);
	g->config.max_gain = or_default(c->max_gain, 3);
	g->config.max_error_ratio = or_default(c->max_error_ratio, 4);
	g->config.max_residual = or_default(c->max_residual, (real)0.01);
	g->config.max_tracking_ratio = or_default(c->max_tracking_ratio, 3);
	g->config.patience = c->patience ? c->patience : 15;
	g->config.renewal = c->renewal ? c->renewal : 100;
	g->config.gate = c->gate;
}

/* Range of an input; 1 if it has no limit. */
static real range_of(const KOOP(mpc) *mpc, size_t j) {
	const real range = mpc->u_max[j] - mpc->u_min[j];
	return is_finite(range) ? range : 1;
}

/* Chooses the pairs of state and input to check: the states on which an input mainly acts, and the inputs
 * that dominate a state. Small cross terms differ between good models. */
static void choose_pairs(KOOP(supervisor) *g, const KOOP(mpc) *mpc) {
	const size_t n = g->n_states, m = g->n_inputs;
	for (size_t i = 0; i < n; i++) {
		real acting = 0;
		for (size_t j = 0; j < m; j++) {
			const real range = range_of(mpc, j);
			acting += g->judged[i * m + j] * range * range;
		}
		for (size_t j = 0; j < m; j++) {
			const real range = range_of(mpc, j), own = g->judged[i * m + j];
			if (own < (real)0.1 * g->size[j] && own * range * range < (real)0.9 * acting) {
				g->judged[i * m + j] = 0;
			}
		}
	}
}

/* Computes the response of the offline model, as the controller condenses it. */
static int compute_response(KOOP(supervisor) *g, KOOP(mpc) *mpc) {
	const size_t n = g->n_states, m = g->n_inputs;
	/* last_good and response are still 0, and serve as a state and a reference at rest */
	const int status =
	    KOOP(mpc_solve)(mpc, g->offline, g->last_good, g->response, g->last_good, g->size, NULL);
	(void)KOOP(mpc_reset)(mpc);
	if (status != KOOP_OK) { return status; }
	for (size_t step = 0; step < g->horizon; step++) {
		KOOP(mpc_sensitivity)(mpc, step, g->response + step * n * m);
	}
	compare_response(g, mpc);
	copy(g->judged, g->square, n * m);
	for (size_t j = 0; j < m; j++) {
		g->size[j] = 0;
		for (size_t i = 0; i < n; i++) { g->size[j] += g->judged[i * m + j]; }
		if (!(g->size[j] > 0 && is_finite(g->size[j]))) { return KOOP_E_MODEL; }
	}
	choose_pairs(g, mpc);
	return KOOP_OK;
}

static void set_storage(KOOP(supervisor) *g, const KOOP(mpc_config) *c, real *storage, size_t needed) {
	const size_t pairs = c->n_states * c->n_inputs;
	for (size_t i = 0; i < needed; i++) { storage[i] = 0; }
	g->n_lifted = c->n_lifted;
	g->n_states = c->n_states;
	g->n_inputs = c->n_inputs;
	g->horizon = c->horizon;
	g->Q = c->Q;
	g->offline = storage;
	g->last_good = g->offline + theta_reals(g);
	g->response = g->last_good + theta_reals(g);
	g->judged = g->response + c->horizon * pairs;
	g->size = g->judged + pairs;
	g->now = g->size + c->n_inputs;
	g->square = g->now + pairs;
	g->along = g->square + pairs;
	g->target = g->along + pairs;
}

int KOOP(supervisor_init)(KOOP(supervisor) *supervisor, const KOOP(supervisor_config) *config, KOOP(mpc) *mpc,
                          const real *offline, real *storage, size_t reals) {
	if (!supervisor || !mpc || !mpc->plan || !offline || !storage) { return KOOP_E_NULL; }
	KOOP(supervisor_config) own = {0, 0, 0, 0, 0, 0, 0, 0, NULL}; /* `config` may point into `supervisor` */
	if (config) { own = *config; }
	const int status = supervisor_config_check(&own);
	if (status != KOOP_OK) { return status; }
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t needed = KOOP_SUPERVISOR_REALS(c->n_lifted, c->n_states, c->n_inputs, c->horizon);
	if (reals < needed) { return KOOP_E_STORAGE; }

	(void)memset(supervisor, 0, sizeof *supervisor);
	set_config(supervisor, &own);
	set_storage(supervisor, c, storage, needed);
	copy(supervisor->offline, offline, theta_reals(supervisor));
	supervisor->model = OFFLINE;
	supervisor->wait = supervisor->delay = supervisor->config.patience;
	const int learned = compute_response(supervisor, mpc);
	if (learned == KOOP_OK) {
		seal_models(supervisor);
	} else {
		(void)memset(supervisor, 0, sizeof *supervisor);
	}
	return learned;
}

static int learner_check(const KOOP(supervisor) *g, const KOOP(rls) *rls) {
	if (!g || !g->offline || !rls || !rls->theta) { return KOOP_E_NULL; }
	return rls->n_lifted == g->n_lifted && rls->config.n_inputs == g->n_inputs ? KOOP_OK : KOOP_E_SIZE;
}

/* Returns 1 if the learner must be restarted: P is not positive definite, too many consecutive samples could
 * not be learned, or it has not been trusted for too long. */
static int must_restart(KOOP(supervisor) *g, int status, const KOOP(health) *seen) {
	const int refused =
	    (status == KOOP_E_OVERFLOW) | (status == KOOP_E_INDEFINITE) | (status == KOOP_E_MEMORY);
	if (status == KOOP_OK) { g->failed = 0; }
	if (refused) { g->failed++; }
	const int indefinite = status == KOOP_OK && !seen->positive_definite;
	return indefinite || g->failed >= g->config.patience || g->distrusted >= g->config.renewal;
}

static int learn_sample(KOOP(supervisor) *g, KOOP(rls) *rls, const real *psi, const real *u,
                        const real *psi_next, KOOP(health) *seen) {
	return g->config.gate ? KOOP(gate_update)(g->config.gate, rls, psi, u, psi_next, seen)
	                      : KOOP(rls_update)(rls, psi, u, psi_next, seen);
}

int KOOP(supervisor_update)(KOOP(supervisor) *supervisor, KOOP(rls) *rls, const real *psi, const real *u,
                            const real *psi_next, KOOP(health) *health) {
	KOOP(health) seen;
	int status = learner_check(supervisor, rls);
	if (status != KOOP_OK) { return status; }
	if (!psi || !u || !psi_next) { return KOOP_E_NULL; }
	real errors[3];
	one_step_errors(supervisor, rls->theta, psi, u, psi_next, errors);
	status = learn_sample(supervisor, rls, psi, u, psi_next, &seen);
	if (status == KOOP_E_NULL || status == KOOP_E_SIZE) {
		return status;
	} /* the gate belongs to another learner */
	if (health) { *health = seen; }
	if (status != KOOP_E_OUTLIER) { update_errors(supervisor, errors); }
	if (must_restart(supervisor, status, &seen)) { restart_learner(supervisor, rls); }
	return status;
}

static int controller_check(const KOOP(supervisor) *g, const KOOP(mpc) *mpc) {
	if (!mpc || !mpc->plan) { return KOOP_E_NULL; }
	const KOOP(mpc_config) *c = &mpc->config;
	const int same_model = c->n_lifted == g->n_lifted && c->n_inputs == g->n_inputs;
	return same_model && c->n_states == g->n_states && c->horizon == g->horizon ? KOOP_OK : KOOP_E_SIZE;
}

/* Checks the tracking error and the one-step errors of the last step. The waits exceed their maximum only
 * after a flipped bit, and are clipped. */
static void check_last_step(KOOP(supervisor) *g, const real *psi) {
	const size_t longest = SUPERVISOR_MAX_WAIT * g->config.patience;
	g->delay = g->delay < longest ? g->delay : longest;
	g->wait = g->wait < longest ? g->wait : longest;
	if (g->wait > 0) { g->wait--; }
	if (g->have_target && tracking_fails(g, psi)) {
		g->have_last_good = 0;
		distrust(g);
	}
	if (g->wait == 0 && !predicts_well(g)) { distrust(g); }
}

static void plan_step(KOOP(supervisor) *g, KOOP(mpc) *mpc, KOOP(request) *r) {
	check_last_step(g, r->psi);
	g->model = plan_on_best(g, mpc, r);
	g->have_target = r->status == KOOP_OK;
	if (blames_model(r->status)) {
		count_steps(g, r->theta[ONLINE]);
		copy(g->target, r->reference, g->n_states);
	}
}

int KOOP(supervisor_control)(KOOP(supervisor) *supervisor, const KOOP(rls) *rls, KOOP(mpc) *mpc,
                             const real *psi, const real *reference, const real *u_before, real *u,
                             KOOP(mpc_result) *result) {
	int status = learner_check(supervisor, rls);
	if (status == KOOP_OK) { status = controller_check(supervisor, mpc); }
	if (status != KOOP_OK) { return status; }
	if (!psi || !reference || !u || (mpc->config.S && !u_before)) { return KOOP_E_NULL; }

	KOOP(request) request = {{rls->theta, supervisor->last_good, supervisor->offline},
	                         psi,
	                         reference,
	                         u_before,
	                         u,
	                         {0, 0},
	                         KOOP_OK};
	if (!models_are_intact(supervisor)) {
		(void)KOOP(mpc_reset)(mpc);
		copy(u, mpc->u_safe, supervisor->n_inputs);
		return KOOP_E_MEMORY;
	}
	plan_step(supervisor, mpc, &request);
	if (result) { *result = request.result; }
	return request.status;
}
