/* The guard: which model the controller plans on. Uses the public interface only. */

#include "strict.h"
#include "attributes.h"

#include "finite.c"
#include "checksum.c"

enum { ONLINE = KOOP_GUARD_ONLINE, LAST_GOOD = KOOP_GUARD_LAST_GOOD, OFFLINE = KOOP_GUARD_OFFLINE };

#define GUARD_ERROR_STEPS 20     /* memory of the one-step errors */
#define GUARD_TRACKING_STEPS 100 /* memory of the tracking error */
#define GUARD_WILD 100           /* a sample counts for at most this times the offline model's mean */
#define GUARD_LONGEST 16         /* a wait grows to at most this times the patience */
#define GUARD_SETTLED 4          /* patiences of trust before a model is kept as last good */
#define GUARD_FIXED 200          /* times what the solver can tell: a narrower range of an input is none */
#define GUARD_KNOWN 100          /* P starts again at p0 over this, since Theta then is a sound one */

static size_t theta_reals(const KOOP(guard) *g) {
	return (g->n_lifted + g->n_inputs) * KOOP_PAD(g->n_lifted);
}

/* y = x */
static void copy(real *y, const real *x, size_t count) {
	for (size_t i = 0; i < count; i++) { y[i] = x[i]; }
}

static real weight(const KOOP(guard) *g, size_t i) {
	return g->Q[i * (g->n_states + 1)];
}

/* ---- What the models are judged by ------------------------------------------ */

/* Square of the one-step error of the tracked states, weighed by the diagonal of Q. */
static real square_error(const KOOP(guard) *g, const real *theta, const real *psi, const real *u,
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

/* What each model misses of a sample, by KOOP_GUARD_.... */
static void see_sample(const KOOP(guard) *g, const real *online, const real *psi, const real *u,
                       const real *psi_next, real *seen) {
	const real *const theta[] = {online, g->last_good, g->offline};
	for (int model = ONLINE; model <= OFFLINE; model++) {
		seen[model] = square_error(g, theta[model], psi, u, psi_next);
	}
}

/* A mean square with one more sample. Only a flipped bit makes it one that is not finite. */
static void judge(real *mean, real seen) {
	if (!is_finite(*mean)) { *mean = seen; }
	*mean += (seen - *mean) / GUARD_ERROR_STEPS;
}

/* The mean squares with one more sample. A wild error, or one that is not a number,
 * is cut, so that it is forgotten again. */
static void judge_sample(KOOP(guard) *g, const real *seen) {
	if (!is_finite(GUARD_WILD * seen[OFFLINE])) { return; }
	judge(&g->error[OFFLINE], seen[OFFLINE]);
	for (int model = ONLINE; model < OFFLINE; model++) {
		const real most = GUARD_WILD * g->error[OFFLINE];
		judge(&g->error[model], seen[model] <= most ? seen[model] : most);
	}
}

static int predicts_well(const KOOP(guard) *g) {
	return g->error[ONLINE] <= g->config.max_error_ratio * g->config.max_error_ratio * g->error[OFFLINE];
}

/* Response of the model planned on last, of each state to each input over the
 * horizon, weighed by Q: its square, and its product with the offline model's. */
static void compare_response(KOOP(guard) *g, const KOOP(mpc) *mpc) {
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

/* Whether it answers input j as the offline model does: the judged pairs in
 * direction and size, all states together in size. */
static int answers_alike(const KOOP(guard) *g, size_t j) {
	const KOOP(guard_config) *c = &g->config;
	const real least = c->min_gain * c->min_gain, most = c->max_gain * c->max_gain;
	real sum = 0;
	for (size_t i = 0; i < g->n_states; i++) {
		const size_t p = i * g->n_inputs + j;
		const real own = g->judged[p], square = g->square[p];
		sum += square;
		if (!(own > 0)) { continue; }
		/* written so that NaN fails */
		if (!(square >= least * own && square <= most * own)) { return 0; }
		if (!(g->along[p] >= c->min_cosine * MATH(sqrt)(square) * MATH(sqrt)(own))) { return 0; }
	}
	return sum <= most * g->size[j];
}

/* Whether the robot is much farther from the reference than it has been. */
static int is_astray(KOOP(guard) *g, const real *psi) {
	real square = 0;
	for (size_t i = 0; i < g->n_states; i++) {
		const real error = psi[i] - g->target[i];
		square += weight(g, i) * error * error;
	}
	if (!is_finite(square)) { return 0; }
	if (!(g->tracking > 0)) { g->tracking = square; }
	const int astray = square > g->config.max_tracking_ratio * g->config.max_tracking_ratio * g->tracking;
	g->tracking += (square - g->tracking) / GUARD_TRACKING_STEPS;
	return astray;
}

/* ---- Which model ------------------------------------------------------------- */

/* The last good model bridges a gap; for longer the offline model is the safer one. */
static int fallback(const KOOP(guard) *g) {
	return g->have_last_good && g->distrusted < g->config.patience && g->error[LAST_GOOD] <= g->error[OFFLINE]
	           ? LAST_GOOD
	           : OFFLINE;
}

/* The online model is not tried for a while; for longer each time it was trusted in vain. */
static void distrust(KOOP(guard) *g) {
	g->wait = g->delay;
	if (g->model == ONLINE && g->delay < GUARD_LONGEST * g->config.patience) { g->delay *= 2; }
}

/* Theta from the last good or the offline model, unless it is in use and finite. */
static void renew_theta(KOOP(guard) *g, KOOP(rls) *rls) {
	const real *const models[] = {NULL, g->last_good, g->offline};
	const int in_use = g->model == ONLINE;
	if (in_use && KOOP(rls_copy_theta)(rls, rls->theta) == KOOP_OK) { return; } /* which refuses what is not finite */
	int from = in_use ? OFFLINE : fallback(g);
	if (KOOP(rls_copy_theta)(rls, models[from]) != KOOP_OK) {
		from = OFFLINE;
		(void)KOOP(rls_copy_theta)(rls, g->offline);
	}
	g->error[ONLINE] = g->error[from];
}

/* Starts the learner again. */
static void renew(KOOP(guard) *g, KOOP(rls) *rls) {
	renew_theta(g, rls);
	/* a p0 that small has nothing below it in this precision */
	if (KOOP(rls_reset_covariance)(rls, rls->config.p0 / GUARD_KNOWN) != KOOP_OK) {
		(void)KOOP(rls_reset_covariance)(rls, rls->config.p0);
	}
	g->distrusted = 0;
	g->failed = 0;
	g->resets++;
}

/* What guard_control() was asked, and what came of it. */
typedef struct KOOP(request) {
	const real *theta[3]; /* by KOOP_GUARD_... */
	const real *psi, *reference, *u_before;
	real *u;
	KOOP(mpc_result) result;
	int status;
} KOOP(request);

/* Of a plan: a part of the narrowest range of an input. An input whose limits leave it hardly more room than
 * the solver can tell is fixed, and not judged. */
static real residual_allowed(const KOOP(guard) *g, const KOOP(mpc) *mpc) {
	const real solved = mpc->noise + mpc->config.tolerance;
	real allowed = (real)INFINITY;
	for (size_t j = 0; j < g->n_inputs; j++) {
		const real range = mpc->u_max[j] - mpc->u_min[j], part = g->config.max_residual * range;
		if (range > GUARD_FIXED * solved && part < allowed) { allowed = part; }
	}
	return allowed;
}

/* Plans on one model; whether the plan is to be trusted. */
static int plan(KOOP(guard) *g, KOOP(mpc) *mpc, int model, KOOP(request) *r) {
	r->status = KOOP(mpc_solve)(mpc, r->theta[model], r->psi, r->reference, r->u_before, r->u, &r->result);
	if (r->status != KOOP_OK || model == OFFLINE) { return r->status == KOOP_OK; }
	if (!(r->result.residual <= residual_allowed(g, mpc))) { return 0; }
	compare_response(g, mpc);
	for (size_t j = 0; j < g->n_inputs; j++) {
		if (!answers_alike(g, j)) { return 0; }
	}
	return 1;
}

/* Not for a state that is not a number, nor for limits that are crossed. */
static int blames_model(int status) {
	return status != KOOP_E_INPUT && status != KOOP_E_RANGE;
}

/* Plans on the best model that gives a plan to be trusted, and says which. */
static int plan_on_best(KOOP(guard) *g, KOOP(mpc) *mpc, KOOP(request) *r) {
	int model = g->wait == 0 ? ONLINE : fallback(g);
	while (!plan(g, mpc, model, r) && model != OFFLINE && blames_model(r->status)) {
		if (model == ONLINE) { distrust(g); }
		if (model == LAST_GOOD) { g->have_last_good = 0; }
		model = fallback(g);
		(void)KOOP(mpc_reset)(mpc);
	}
	return r->status == KOOP_OK ? model : KOOP_GUARD_NONE;
}

/* ---- In a memory whose bits may flip -------------------------------------------- */

/* The offline and the last good model, and what the former answers: all in one piece. */
static size_t models_words(const KOOP(guard) *g) {
	return WORDS(2 * theta_reals(g) + ((g->horizon + 1) * g->n_states + 1) * g->n_inputs);
}

static void seal_models(KOOP(guard) *g) {
	g->sum.words = g->sum.places = 0;
	checksum_add(&g->sum, g->offline, models_words(g));
}

/* Whether they are as they were left, or are again. */
static int models_are_sound(KOOP(guard) *g) {
	koop_checksum now = {0, 0};
	checksum_add(&now, g->offline, models_words(g));
	if (checksum_has_flipped(&g->sum, &now)) { g->sum = now; }
	return checksum_same(&now, &g->sum) || checksum_mend(g->offline, models_words(g), 0, &g->sum, &now);
}

/* How long the online model has been in use or out of it, and the last good one. */
static void keep_book(KOOP(guard) *g, const real *online) {
	if (g->model != ONLINE) {
		g->trusted = 0;
		g->distrusted++;
		return;
	}
	g->distrusted = 0;
	g->trusted++;
	if (g->trusted >= g->delay) { g->delay = g->config.patience; }
	if (g->trusted >= GUARD_SETTLED * g->config.patience && g->trusted % g->config.patience == 0) {
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

static int guard_config_check(const KOOP(guard_config) *c) {
	const real values[] = {c->min_cosine, c->min_gain,    c->max_gain,
	                       c->max_error_ratio,   c->max_residual, c->max_tracking_ratio};
	for (size_t i = 0; i < sizeof values / sizeof *values; i++) {
		if (!(values[i] >= 0 && is_finite(values[i]))) { return KOOP_E_RANGE; }
	}
	return KOOP_OK;
}

static void set_config(KOOP(guard) *g, const KOOP(guard_config) *c) {
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

/* Of an input; 1 where that has no limit. */
static real range_of(const KOOP(mpc) *mpc, size_t j) {
	const real range = mpc->u_max[j] - mpc->u_min[j];
	return is_finite(range) ? range : 1;
}

/* Judged are the states that an input acts on above all, and the inputs that act
 * on a state almost alone: small cross terms differ between sound models. */
static void choose_pairs(KOOP(guard) *g, const KOOP(mpc) *mpc) {
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

/* The response of the offline model, as the controller condenses it. */
static int learn_response(KOOP(guard) *g, KOOP(mpc) *mpc) {
	const size_t n = g->n_states, m = g->n_inputs;
	/* last_good and response are still zero: a robot and a reference at rest */
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

static void set_storage(KOOP(guard) *g, const KOOP(mpc_config) *c, real *storage, size_t needed) {
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

int KOOP(guard_init)(KOOP(guard) *guard, const KOOP(guard_config) *config, KOOP(mpc) *mpc,
                     const real *offline, real *storage, size_t reals) {
	if (!guard || !mpc || !mpc->plan || !offline || !storage) { return KOOP_E_NULL; }
	KOOP(guard_config) own = {0, 0, 0, 0, 0, 0, 0, 0, NULL}; /* a copy: `config` may be the guard's */
	if (config) { own = *config; }
	const int status = guard_config_check(&own);
	if (status != KOOP_OK) { return status; }
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t needed = KOOP_GUARD_REALS(c->n_lifted, c->n_states, c->n_inputs, c->horizon);
	if (reals < needed) { return KOOP_E_STORAGE; }

	(void)memset(guard, 0, sizeof *guard);
	set_config(guard, &own);
	set_storage(guard, c, storage, needed);
	copy(guard->offline, offline, theta_reals(guard));
	guard->model = OFFLINE;
	guard->wait = guard->delay = guard->config.patience;
	const int learned = learn_response(guard, mpc);
	if (learned == KOOP_OK) {
		seal_models(guard);
	} else {
		(void)memset(guard, 0, sizeof *guard);
	}
	return learned;
}

static int learner_check(const KOOP(guard) *g, const KOOP(rls) *rls) {
	if (!g || !g->offline || !rls || !rls->theta) { return KOOP_E_NULL; }
	return rls->n_lifted == g->n_lifted && rls->config.n_inputs == g->n_inputs ? KOOP_OK : KOOP_E_SIZE;
}

/* Whether the learner is to be started again: it holds a P that is not positive definite, or has refused
 * one sample after the other, or has not been trusted for long. A single sample that is refused leaves it as
 * it was. */
static int is_ruined(KOOP(guard) *g, int status, const KOOP(health) *seen) {
	const int refused =
	    (status == KOOP_E_OVERFLOW) | (status == KOOP_E_INDEFINITE) | (status == KOOP_E_MEMORY);
	if (status == KOOP_OK) { g->failed = 0; }
	if (refused) { g->failed++; }
	const int indefinite = status == KOOP_OK && !seen->positive_definite;
	return indefinite || g->failed >= g->config.patience || g->distrusted >= g->config.renewal;
}

static int learn_sample(KOOP(guard) *g, KOOP(rls) *rls, const real *psi, const real *u, const real *psi_next,
                        KOOP(health) *seen) {
	return g->config.gate ? KOOP(gate_update)(g->config.gate, rls, psi, u, psi_next, seen)
	                      : KOOP(rls_update)(rls, psi, u, psi_next, seen);
}

int KOOP(guard_update)(KOOP(guard) *guard, KOOP(rls) *rls, const real *psi, const real *u,
                       const real *psi_next, KOOP(health) *health) {
	KOOP(health) seen;
	int status = learner_check(guard, rls);
	if (status != KOOP_OK) { return status; }
	if (!psi || !u || !psi_next) { return KOOP_E_NULL; }
	real missed[3];
	see_sample(guard, rls->theta, psi, u, psi_next, missed);
	status = learn_sample(guard, rls, psi, u, psi_next, &seen);
	if (status == KOOP_E_NULL || status == KOOP_E_SIZE) { return status; } /* the gate is of another learner */
	if (health) { *health = seen; }
	if (status != KOOP_E_OUTLIER) { judge_sample(guard, missed); }
	if (is_ruined(guard, status, &seen)) { renew(guard, rls); }
	return status;
}

static int controller_check(const KOOP(guard) *g, const KOOP(mpc) *mpc) {
	if (!mpc || !mpc->plan) { return KOOP_E_NULL; }
	const KOOP(mpc_config) *c = &mpc->config;
	const int same_model = c->n_lifted == g->n_lifted && c->n_inputs == g->n_inputs;
	return same_model && c->n_states == g->n_states && c->horizon == g->horizon ? KOOP_OK : KOOP_E_SIZE;
}

/* What the robot's place and the last samples say of the model in use. No wait is longer than GUARD_LONGEST
 * says, unless a bit has flipped. */
static void look_back(KOOP(guard) *g, const real *psi) {
	const size_t longest = GUARD_LONGEST * g->config.patience;
	g->delay = g->delay < longest ? g->delay : longest;
	g->wait = g->wait < longest ? g->wait : longest;
	if (g->wait > 0) { g->wait--; }
	if (g->have_target && is_astray(g, psi)) {
		g->have_last_good = 0;
		distrust(g);
	}
	if (g->wait == 0 && !predicts_well(g)) { distrust(g); }
}

static void plan_step(KOOP(guard) *g, KOOP(mpc) *mpc, KOOP(request) *r) {
	look_back(g, r->psi);
	g->model = plan_on_best(g, mpc, r);
	g->have_target = r->status == KOOP_OK;
	if (blames_model(r->status)) {
		keep_book(g, r->theta[ONLINE]);
		copy(g->target, r->reference, g->n_states);
	}
}

int KOOP(guard_control)(KOOP(guard) *guard, const KOOP(rls) *rls, KOOP(mpc) *mpc, const real *psi,
                        const real *reference, const real *u_before, real *u, KOOP(mpc_result) *result) {
	int status = learner_check(guard, rls);
	if (status == KOOP_OK) { status = controller_check(guard, mpc); }
	if (status != KOOP_OK) { return status; }
	if (!psi || !reference || !u || (mpc->config.S && !u_before)) { return KOOP_E_NULL; }

	KOOP(request) request = {
	    {rls->theta, guard->last_good, guard->offline}, psi, reference, u_before, u, {0, 0}, KOOP_OK,
	};
	if (!models_are_sound(guard)) {
		(void)KOOP(mpc_reset)(mpc);
		copy(u, mpc->u_safe, guard->n_inputs);
		return KOOP_E_MEMORY;
	}
	plan_step(guard, mpc, &request);
	if (result) { *result = request.result; }
	return request.status;
}
