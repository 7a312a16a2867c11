/* The supervisor beside a second writing of all that it does, step by step, over random robots with planted
 * faults and moving limits. The second one takes the models' responses from a simulation in wide arithmetic,
 * and asks twins of the learner, the gate and the controller what the supervisor's own have to answer. */
#include "tinykoop_supervisor.h"

#include "support.h"

#include <float.h>

enum { MOST_N = 9, MOST_n = 3, MOST_m = 3, MOST_H = 6, MOST_D = MOST_N + MOST_m };
enum { MOST_PAIRS = MOST_n * MOST_m, ONLINE = KOOP_SUPERVISOR_ONLINE, LAST_GOOD = KOOP_SUPERVISOR_LAST_GOOD };
enum { OFFLINE = KOOP_SUPERVISOR_OFFLINE, NONE = KOOP_SUPERVISOR_NONE, SPARE = 16, STEPS = 300 };
enum { THETA = MOST_D * KOOP_PAD(MOST_N) };
enum { RATE_REALS = KOOP_MPC_REALS_RATE(MOST_m, MOST_H) };
enum { MPC_REALS = KOOP_MPC_REALS_NEWTON(MOST_N, MOST_n, MOST_m, MOST_H) + RATE_REALS };
enum { RLS_REALS = KOOP_RLS_REALS_PLAIN(MOST_N, MOST_m), GATE_REALS = KOOP_GATE_REALS_PLAIN(MOST_N, MOST_m) };
enum { SUPERVISOR_REALS = KOOP_SUPERVISOR_REALS(MOST_N, MOST_n, MOST_m, MOST_H) };

static const double CLOSE = 300 * (double)REAL_EPSILON; /* what rounding can make of a comparison */
static const double NEAR = 4000 * (double)REAL_EPSILON; /* and of a mean */

/* ---- a learner and a controller, for the supervisor and for the second writing -------------------- */

typedef struct {
	KOOP(rls) rls;
	KOOP(gate) gate;
	KOOP(mpc) mpc;
	real rls_storage[RLS_REALS], gate_storage[GATE_REALS], mpc_storage[MPC_REALS];
} pair;

/* ---- the second writing ---------------------------------------------------------------------- */

typedef struct {
	size_t N, n, m, H;
	KOOP(supervisor_config) config; /* without zeros */
	wide weight[MOST_n];
	real online[THETA], last_good[THETA], offline[THETA]; /* as rls.theta */
	wide response[MOST_H * MOST_PAIRS], judged[MOST_PAIRS], size[MOST_m];
	wide target[MOST_n], error[3], tracking;
	int have_target, have_last_good, model;
	size_t wait, delay, trusted, distrusted, failed, resets;
	int unsure; /* a comparison was too close for rounding not to matter */
	pair twin;
} second;

/* a <= b; false where one is not a number */
static int at_most(second *s, wide a, wide b) {
	if (fabs(a - b) < (wide)CLOSE * (fabs(a) + fabs(b))) { s->unsure = 1; }
	return a <= b;
}

/* What one precision would call finite. */
static int fits(wide a) {
	return fabs(a) <= (wide)REAL_MAX;
}

static const real *theta_of(const second *s, int model) {
	return model == ONLINE ? s->online : model == LAST_GOOD ? s->last_good : s->offline;
}

/* Element (i, j) of Theta. */
static wide element(const second *s, int model, size_t i, size_t j) {
	return (wide)theta_of(s, model)[j * KOOP_PAD(s->N) + i];
}

static void take_theta(const second *s, real *to, const real *from) {
	memcpy(to, from, (s->N + s->m) * KOOP_PAD(s->N) * sizeof(real));
}

static wide weigh(const second *s, const wide *v) {
	wide sum = 0;
	for (size_t i = 0; i < s->n; i++) { sum += s->weight[i] * v[i] * v[i]; }
	return sum;
}

/* What a model misses of a sample. */
static wide missed(const second *s, int model, const real *psi, const real *u, const real *psi_next) {
	wide error[MOST_n];
	for (size_t i = 0; i < s->n; i++) {
		wide predicted = 0;
		for (size_t j = 0; j < s->N; j++) { predicted += element(s, model, i, j) * (wide)psi[j]; }
		for (size_t j = 0; j < s->m; j++) { predicted += element(s, model, i, s->N + j) * (wide)u[j]; }
		error[i] = (wide)psi_next[i] - predicted;
	}
	return weigh(s, error);
}

/* What one unit of input j in the first step does to the tracked states of each step of the horizon. */
static void respond(const second *s, int model, size_t j, wide *response) {
	wide v[MOST_N], after[MOST_N];
	for (size_t i = 0; i < s->N; i++) { v[i] = element(s, model, i, s->N + j); }
	for (size_t step = 0; step < s->H; step++) {
		for (size_t i = 0; i < s->n; i++) { response[(step * s->n + i) * s->m + j] = v[i]; }
		for (size_t i = 0; i < s->N; i++) {
			after[i] = 0;
			for (size_t k = 0; k < s->N; k++) { after[i] += element(s, model, i, k) * v[k]; }
		}
		memcpy(v, after, sizeof v);
	}
}

/* Over the horizon, for the pair of state i and input j, of two responses. */
static wide product(const second *s, const wide *a, const wide *b, size_t i, size_t j) {
	wide sum = 0;
	for (size_t step = 0; step < s->H; step++) {
		const size_t at = (step * s->n + i) * s->m + j;
		sum += s->weight[i] * a[at] * b[at];
	}
	return sum;
}

static wide reach(const real *low, const real *high, size_t j) {
	const wide range = (wide)high[j] - (wide)low[j];
	return isfinite(range) ? range : 1;
}

/* Pairs are left out that are a tenth of what the input does, or less, and nine tenths of what is done to the
 * state, or less. */
static int is_judged(second *s, const wide *full, size_t i, size_t j, const real *low, const real *high) {
	wide acting = 0;
	for (size_t k = 0; k < s->m; k++) {
		acting += full[i * s->m + k] * reach(low, high, k) * reach(low, high, k);
	}
	const wide mine = full[i * s->m + j] * reach(low, high, j) * reach(low, high, j);
	const int small_part = !at_most(s, s->size[j] / 10, full[i * s->m + j]);
	return !(small_part && !at_most(s, acting * 9 / 10, mine));
}

static void learn_offline(second *s, const real *low, const real *high) {
	wide full[MOST_PAIRS];
	for (size_t j = 0; j < s->m; j++) {
		respond(s, OFFLINE, j, s->response);
		s->size[j] = 0;
		for (size_t i = 0; i < s->n; i++) {
			full[i * s->m + j] = product(s, s->response, s->response, i, j);
			s->size[j] += full[i * s->m + j];
		}
	}
	for (size_t i = 0; i < s->n; i++) {
		for (size_t j = 0; j < s->m; j++) {
			const int judged = is_judged(s, full, i, j, low, high);
			s->judged[i * s->m + j] = judged ? full[i * s->m + j] : 0;
		}
	}
}

/* ---- samples */

static wide new_mean(wide mean, wide seen, int memory) {
	return isfinite(mean) ? mean * (memory - 1) / memory + seen / memory : seen;
}

/* Wild errors are cut to 100 times what the offline model misses on the average. */
static void judge_models(second *s, const wide *seen) {
	if (!fits(100 * seen[OFFLINE])) { return; }
	s->error[OFFLINE] = new_mean(s->error[OFFLINE], seen[OFFLINE], 20);
	const wide wild = 100 * s->error[OFFLINE];
	for (int model = ONLINE; model < OFFLINE; model++) {
		s->error[model] = new_mean(s->error[model], seen[model] <= wild ? seen[model] : wild, 20);
	}
}

static int next_best(second *s) {
	const int bridges = s->have_last_good && s->distrusted + 1 <= s->config.patience;
	return bridges && at_most(s, s->error[LAST_GOOD], s->error[OFFLINE]) ? LAST_GOOD : OFFLINE;
}

static int is_whole(const second *s, const real *theta) {
	int whole = 1;
	for (size_t i = 0; i < (s->N + s->m) * KOOP_PAD(s->N); i++) { whole = whole && isfinite(theta[i]); }
	return whole;
}

/* What is in use stays, if it is a number. */
static void start_learner_again(second *s) {
	if (s->model != ONLINE || !is_whole(s, s->twin.rls.theta)) {
		int from = s->model == ONLINE ? OFFLINE : next_best(s);
		if (!is_whole(s, theta_of(s, from))) { from = OFFLINE; }
		s->error[ONLINE] = s->error[from];
		CHECK_STATUS(KOOP_OK, KOOP(rls_copy_theta)(&s->twin.rls, theta_of(s, from)));
	}
	CHECK_STATUS(KOOP_OK, KOOP(rls_reset_covariance)(&s->twin.rls, s->twin.rls.config.p0 / 100));
	s->distrusted = s->failed = 0;
	s->resets++;
}

/* Samples in a row that could not be learned; one that is not a number is no sample. */
static void count_failures(second *s, int status) {
	if (status == KOOP_OK) { s->failed = 0; }
	if (status == KOOP_E_OVERFLOW || status == KOOP_E_INDEFINITE) { s->failed++; }
}

static int second_update(second *s, const real *psi, const real *u, const real *psi_next,
                         KOOP(health) *seen) {
	wide error[3];
	pair *twin = &s->twin;
	take_theta(s, s->online, twin->rls.theta);
	for (int model = ONLINE; model <= OFFLINE; model++) { error[model] = missed(s, model, psi, u, psi_next); }
	const int status = s->config.gate ? KOOP(gate_update)(&twin->gate, &twin->rls, psi, u, psi_next, seen)
	                                  : KOOP(rls_update)(&twin->rls, psi, u, psi_next, seen);
	if (status != KOOP_E_OUTLIER) { judge_models(s, error); }
	count_failures(s, status);
	const int broken = status == KOOP_OK && !seen->positive_definite;
	if (broken || s->failed >= s->config.patience || s->distrusted >= s->config.renewal) {
		start_learner_again(s);
	}
	return status;
}

/* ---- control */

/* Waits double while models are trusted in vain. */
static void put_off(second *s) {
	s->wait = s->delay;
	if (s->model == ONLINE && s->delay < 16 * s->config.patience) { s->delay *= 2; }
}

static int went_astray(second *s, const real *psi) {
	wide away[MOST_n];
	const wide most = (wide)s->config.max_tracking_ratio;
	for (size_t i = 0; i < s->n; i++) { away[i] = (wide)psi[i] - s->target[i]; }
	const wide square = weigh(s, away);
	if (!fits(square)) { return 0; }
	if (!(s->tracking > 0)) { s->tracking = square; }
	const int astray = !at_most(s, square, most * most * s->tracking);
	s->tracking += (square - s->tracking) / 100; /* NaN where it was infinite: it starts again */
	return astray;
}

static void look_back(second *s, const real *psi) {
	const size_t longest = 16 * s->config.patience;
	const wide most = (wide)s->config.max_error_ratio;
	if (s->delay > longest) { s->delay = longest; }
	if (s->wait > longest) { s->wait = longest; }
	if (s->wait > 0) { s->wait--; }
	if (s->have_target && went_astray(s, psi)) {
		s->have_last_good = 0;
		put_off(s);
	}
	if (s->wait == 0 && !at_most(s, s->error[ONLINE], most * most * s->error[OFFLINE])) { put_off(s); }
}

/* A part of the narrowest range that is one. */
static int leaves_too_much(second *s, const KOOP(mpc_config) *c, real residual) {
	wide narrowest = (wide)INFINITY;
	for (size_t j = 0; j < s->m; j++) {
		const wide range = (wide)c->u_max[j] - (wide)c->u_min[j];
		const wide told_apart = (wide)s->twin.mpc.noise + (wide)c->tolerance;
		if (!at_most(s, range, 200 * told_apart)) { narrowest = fmin(narrowest, range); }
	}
	return !at_most(s, (wide)residual, (wide)s->config.max_residual * narrowest);
}

static int pair_is_alike(second *s, const wide *response, size_t i, size_t j) {
	const wide least = (wide)s->config.min_gain, most = (wide)s->config.max_gain;
	const wide judged = s->judged[i * s->m + j], square = product(s, response, response, i, j);
	if (!(judged > 0)) { return 1; }
	if (!at_most(s, least * least * judged, square)) { return 0; }
	if (!at_most(s, square, most * most * judged)) { return 0; }
	const wide cosine = product(s, response, s->response, i, j) / sqrt(square) / sqrt(judged);
	return at_most(s, (wide)s->config.min_cosine, cosine);
}

static int input_is_alike(second *s, int model, size_t j) {
	wide response[MOST_H * MOST_PAIRS], all = 0;
	const wide most = (wide)s->config.max_gain;
	respond(s, model, j, response);
	for (size_t i = 0; i < s->n; i++) {
		if (!pair_is_alike(s, response, i, j)) { return 0; }
		all += product(s, response, response, i, j);
	}
	return at_most(s, all, most * most * s->size[j]);
}

/* What the caller hands over, and what comes back. */
typedef struct {
	const real *psi, *reference, *u_before;
	real u[MOST_m];
	KOOP(mpc_result) result;
} call;

static int try_model(second *s, int model, call *c, int *status) {
	*status = KOOP(mpc_solve)(&s->twin.mpc, theta_of(s, model), c->psi, c->reference, c->u_before, c->u,
	                          &c->result);
	if (*status != KOOP_OK) { return 0; }
	if (model == OFFLINE) { return 1; }
	if (leaves_too_much(s, &s->twin.mpc.config, c->result.residual)) { return 0; }
	for (size_t j = 0; j < s->m; j++) {
		if (!input_is_alike(s, model, j)) { return 0; }
	}
	return 1;
}

/* One model after the other, until one is to be trusted or nothing can be blamed on them. */
static int choose_model(second *s, call *c) {
	int status, model = s->wait > 0 ? next_best(s) : ONLINE;
	while (!try_model(s, model, c, &status)) {
		if (model == OFFLINE || status == KOOP_E_INPUT || status == KOOP_E_RANGE) { break; }
		if (model == ONLINE) { put_off(s); }
		if (model == LAST_GOOD) { s->have_last_good = 0; }
		model = next_best(s);
		CHECK_STATUS(KOOP_OK, KOOP(mpc_reset)(&s->twin.mpc));
	}
	s->model = status == KOOP_OK ? model : NONE;
	return status;
}

/* After four patiences of trust, and each one more, the model is kept. */
static void count_trust(second *s) {
	const size_t patience = s->config.patience;
	s->trusted = s->model == ONLINE ? s->trusted + 1 : 0;
	s->distrusted = s->model == ONLINE ? 0 : s->distrusted + 1;
	if (s->model != ONLINE) { return; }
	if (s->trusted >= s->delay) { s->delay = patience; }
	if (s->trusted / patience >= 4 && s->trusted % patience == 0) {
		take_theta(s, s->last_good, s->online);
		s->error[LAST_GOOD] = s->error[ONLINE];
		s->have_last_good = 1;
	}
}

static int second_control(second *s, call *c) {
	take_theta(s, s->online, s->twin.rls.theta);
	look_back(s, c->psi);
	const int status = choose_model(s, c);
	s->have_target = status == KOOP_OK;
	if (status == KOOP_E_INPUT || status == KOOP_E_RANGE) { return status; }
	count_trust(s);
	for (size_t i = 0; i < s->n; i++) { s->target[i] = (wide)c->reference[i]; }
	return status;
}

/* ---- a robot, the supervisor and the second writing ----------------------------------------------- */

typedef struct {
	const char *name;
	size_t N, n, m, H;
	int rate, gated, check;
	const KOOP(form) *form;
	double tolerance, max_residual;
	size_t patience, renewal;
} setting;

typedef struct {
	const setting *is;
	random_source random;
	KOOP(dictionary) dictionary;
	real Q[MOST_n * MOST_n], R[MOST_m * MOST_m], S[MOST_m * MOST_m];
	real low[MOST_m], high[MOST_m], safe[MOST_m];
	real offline[THETA], robot[THETA];
	real psi[MOST_N], psi_next[MOST_N], u[MOST_m], reference[MOST_H * MOST_n];
	pair own;
	KOOP(supervisor_config) config;
	KOOP(supervisor) supervisor;
	real storage[SUPERVISOR_REALS + SPARE];
	second second;
	size_t used[4], step; /* steps on each model */
} world;

static world w;

static void lift(const KOOP(dictionary) *self, const real *x, real *psi) {
	for (size_t i = 0; i < self->n_lifted; i++) { psi[i] = x[i]; }
}

/* Symmetric and positive definite, with elements beside the diagonal, which the supervisor does not look at.
 */
static void random_weights(real *Q, size_t n, double size) {
	for (size_t i = 0; i < n; i++) {
		for (size_t j = 0; j < n; j++) { Q[i * n + j] = (real)(0.1 * size); }
		Q[i * n + i] = random_uniform(&w.random, size, 4 * size);
	}
}

/* A stable model of which each input moves the tracked states. */
static void random_model(real *theta) {
	const size_t N = w.is->N, rows = KOOP_PAD(N);
	const double others = 0.4 / (double)N;
	memset(theta, 0, THETA * sizeof(real));
	for (size_t i = 0; i < N; i++) {
		for (size_t j = 0; j < N; j++) { theta[j * rows + i] = random_uniform(&w.random, -others, others); }
		theta[i * rows + i] = random_uniform(&w.random, 0.5, 0.9);
		for (size_t j = 0; j < w.is->m; j++) {
			const double own = i % w.is->m == j ? 1 : 0.1;
			theta[(N + j) * rows + i] = random_uniform(&w.random, 0.2, 0.5) * (real)own;
		}
	}
}

/* The robot is like the offline model, but for the size of what its inputs do. */
static void change_robot(double least, double most) {
	const size_t N = w.is->N, rows = KOOP_PAD(N);
	memcpy(w.robot, w.offline, sizeof w.robot);
	for (size_t j = 0; j < w.is->m; j++) {
		const real gain = random_uniform(&w.random, least, most);
		for (size_t i = 0; i < N; i++) { w.robot[(N + j) * rows + i] *= gain; }
	}
	for (size_t i = 0; i < N; i++) { w.robot[i * rows + i] += random_uniform(&w.random, -0.1, 0.05); }
}

static void start_pair(pair *p) {
	const setting *is = w.is;
	const KOOP(config) learner = {
	    .dictionary = &w.dictionary,
	    .n_inputs = is->m,
	    .regulator = &KOOP(reg_ef),
	    .form = is->form,
	    .lambda = (real)0.95,
	    .p0 = 100,
	    .check = is->check,
	};
	const KOOP(mpc_config) controller = {
	    .n_lifted = is->N,
	    .n_states = is->n,
	    .n_inputs = is->m,
	    .horizon = is->H,
	    .Q = w.Q,
	    .R = w.R,
	    .S = is->rate ? w.S : NULL,
	    .u_min = w.low,
	    .u_max = w.high,
	    .u_safe = w.safe,
	    .tolerance = (real)is->tolerance,
	};
	CHECK_STATUS(KOOP_OK, KOOP(rls_init)(&p->rls, &learner, p->rls_storage, RLS_REALS));
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&p->gate, NULL, &p->rls, p->gate_storage, GATE_REALS));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&p->mpc, &controller, p->mpc_storage, MPC_REALS));
}

static size_t supervisor_reals(void) {
	return KOOP_SUPERVISOR_REALS(w.is->N, w.is->n, w.is->m, w.is->H);
}

/* One in two is left to the supervisor. */
static real random_setting(double low, double high) {
	const real value = random_uniform(&w.random, low, high);
	return random_below(&w.random, 2) ? value : 0;
}

static void random_config(void) {
	w.config.min_cosine = random_setting(0.3, 0.95);
	w.config.min_gain = random_setting(0.05, 0.6);
	w.config.max_gain = random_setting(1.2, 5);
	w.config.max_error_ratio = random_setting(1.1, 6);
	w.config.max_tracking_ratio = random_setting(1.5, 6);
	w.config.max_residual = (real)w.is->max_residual;
	w.config.patience = w.is->patience;
	w.config.renewal = w.is->renewal;
	w.config.gate = w.is->gated ? &w.own.gate : NULL;
}

static void put_default(real *value, double otherwise) {
	if (!(*value > 0)) { *value = (real)otherwise; }
}

/* As the header says. */
static KOOP(supervisor_config) with_defaults(void) {
	KOOP(supervisor_config) config = w.config;
	put_default(&config.min_cosine, 0.7);
	put_default(&config.min_gain, 0.2);
	put_default(&config.max_gain, 3);
	put_default(&config.max_error_ratio, 4);
	put_default(&config.max_tracking_ratio, 3);
	return config;
}

/* What the storage holds before does not matter; what is behind it is not read, and not written. */
static void start_supervisor(void) {
	for (size_t i = 0; i < SUPERVISOR_REALS + SPARE; i++) { w.storage[i] = (real)NAN; }
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&w.supervisor, &w.config, &w.own.mpc, w.offline, w.storage,
	                                            supervisor_reals()));
}

static void start_second(void) {
	second *s = &w.second;
	s->N = w.is->N;
	s->n = w.is->n;
	s->m = w.is->m;
	s->H = w.is->H;
	s->config = with_defaults();
	for (size_t i = 0; i < s->n; i++) { s->weight[i] = (wide)w.Q[i * s->n + i]; }
	memcpy(s->offline, w.offline, sizeof w.offline);
	s->model = OFFLINE;
	s->wait = s->delay = s->config.patience;
	learn_offline(s, w.low, w.high);
	real zero[MOST_H * MOST_n] = {0},
	                   u[MOST_m]; /* the supervisor has solved once, and forgotten that again */
	CHECK_STATUS(KOOP_OK, KOOP(mpc_solve)(&s->twin.mpc, w.offline, zero, zero, zero, u, NULL));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_reset)(&s->twin.mpc));
}

static void start_limits(void) {
	for (size_t j = 0; j < w.is->m; j++) {
		w.low[j] = random_uniform(&w.random, -3, -1);
		w.high[j] = random_uniform(&w.random, 1, 3);
		w.safe[j] = 0;
	}
}

static void prepare(const setting *is, uint64_t seed) {
	memset(&w, 0, sizeof w);
	w.is = is;
	w.random = random_seed(seed);
	w.dictionary = (KOOP(dictionary)){"identity", is->n, is->N, lift, NULL};
	random_weights(w.Q, is->n, 1);
	random_weights(w.R, is->m, 0.01);
	random_weights(w.S, is->m, 0.01);
	random_config();
	start_limits();
	random_model(w.offline);
}

static void start(void) {
	start_pair(&w.own);
	start_pair(&w.second.twin);
	start_supervisor();
	start_second();
}

/* ---- the two side by side -------------------------------------------------------------------- */

static void check_near(const char *what, size_t i, real mine, wide other, wide scale) {
	if (!isfinite(mine) && !isfinite(other)) { return; }
	CHECK(fabs((wide)mine - other) <= (wide)NEAR * scale, "%s, step %zu: %s[%zu] is %g, should be %g",
	      w.is->name, w.step, what, i, (double)mine, (double)other);
}

static void check_count(const char *what, size_t mine, size_t other) {
	CHECK(mine == other, "%s, step %zu: %s is %zu, should be %zu", w.is->name, w.step, what, mine, other);
}

static void check_counts(void) {
	const KOOP(supervisor) *g = &w.supervisor;
	const second *s = &w.second;
	check_count("model", (size_t)g->model, (size_t)s->model);
	check_count("have_target", g->have_target != 0, s->have_target != 0);
	check_count("have_last_good", g->have_last_good != 0, s->have_last_good != 0);
	check_count("wait", g->wait, s->wait);
	check_count("delay", g->delay, s->delay);
	check_count("trusted", g->trusted, s->trusted);
	check_count("distrusted", g->distrusted, s->distrusted);
	check_count("failed", g->failed, s->failed);
	check_count("resets", g->resets, s->resets);
}

static void check_means(void) {
	for (size_t i = 0; i < 3; i++) {
		check_near("error", i, w.supervisor.error[i], w.second.error[i], w.second.error[i]);
	}
	check_near("tracking", 0, w.supervisor.tracking, w.second.tracking, w.second.tracking);
	for (size_t i = 0; w.supervisor.have_target && i < w.is->n; i++) {
		check_near("target", i, w.supervisor.target[i], w.second.target[i], 0);
	}
}

static void check_models(void) {
	const size_t bytes = (w.is->N + w.is->m) * KOOP_PAD(w.is->N) * sizeof(real);
	const KOOP(rls) *own = &w.own.rls, *twin = &w.second.twin.rls;
	TEST_ASSERT_EQUAL_MEMORY(w.second.offline, w.supervisor.offline, bytes);
	TEST_ASSERT_EQUAL_MEMORY(w.second.last_good, w.supervisor.last_good, bytes);
	CHECK(memcmp(twin->theta, own->theta, own->kept * sizeof(real)) == 0, "%s, step %zu: what was learned",
	      w.is->name, w.step);
}

/* What is known of the offline model, once for all. */
static void check_responses(void) {
	const second *s = &w.second;
	for (size_t j = 0; j < s->m; j++) {
		check_near("size", j, w.supervisor.size[j], s->size[j], s->size[j]);
		for (size_t i = 0; i < s->n; i++) {
			const size_t p = i * s->m + j;
			check_near("judged", p, w.supervisor.judged[p], s->judged[p], s->judged[p]);
			for (size_t at = p; at < s->H * s->n * s->m; at += s->n * s->m) {
				check_near("response", at, w.supervisor.response[at], s->response[at], 1);
			}
		}
	}
}

static void check_spare(void) {
	const real nan = (real)NAN;
	for (size_t i = supervisor_reals(); i < supervisor_reals() + SPARE; i++) {
		CHECK(memcmp(&nan, &w.storage[i], sizeof nan) == 0, "%s: real %zu of the storage", w.is->name, i);
	}
}

static void check_all(void) {
	check_counts();
	check_means();
	check_models();
	check_responses();
	check_spare();
}

/* ---- faults ---------------------------------------------------------------------------------- */

/* Element by element of what both have learned, times a factor. */
static void spoil(size_t from, size_t count, double factor) {
	for (size_t i = from; i < from + count; i++) {
		w.own.rls.theta[i] *= (real)factor;
		w.second.twin.rls.theta[i] *= (real)factor;
	}
}

static void spoil_learner(void) {
	const size_t rows = KOOP_PAD(w.is->N), inputs = w.is->N * rows;
	const size_t input = inputs + random_below(&w.random, w.is->m) * rows;
	switch (random_below(&w.random, 6)) {
	case 0: spoil(1, 1, (double)NAN); break;
	case 1: spoil(0, inputs, 1e3); break;
	case 2: spoil(input, rows, -1); break;
	case 3: spoil(input, rows, 0.05); break;
	case 4: spoil(input, rows, 4); break;
	default: spoil(0, rows, 3); break;
	}
}

/* P of both, of which the plain form says at the next sample that it is not positive definite. */
static void spoil_covariance(void) {
	const size_t count = KOOP_SYMMETRIC(w.own.rls.n_regressors);
	if (w.is->form != &KOOP(form_plain)) { return; }
	for (size_t i = 0; i < count; i++) {
		w.own.rls.covariance[i] *= -1;
		w.second.twin.rls.covariance[i] *= -1;
	}
}

static void flip_mean(void) {
	static const double garbage[] = {(double)NAN, (double)INFINITY, 0, 1e6};
	const size_t model = random_below(&w.random, 4);
	const real value = (real)garbage[random_below(&w.random, 4)];
	*(model < 3 ? &w.supervisor.error[model] : &w.supervisor.tracking) = value;
	*(model < 3 ? &w.second.error[model] : &w.second.tracking) = (wide)value;
}

static void flip_count(void) {
	const size_t value = random_below(&w.random, 3) == 0 ? 1 + random_below(&w.random, 100) : SIZE_MAX / 4;
	const int which = (int)random_below(&w.random, 2);
	*(which ? &w.supervisor.wait : &w.supervisor.delay) = value;
	*(which ? &w.second.wait : &w.second.delay) = value;
}

/* One bit of what the checksum is of, or of that itself; it is repaired before anything is planned. */
static void flip_models(void) {
	const size_t summed = (size_t)(w.supervisor.now - w.supervisor.offline) * sizeof(real);
	const size_t at = random_below(&w.random, summed + sizeof w.supervisor.sum);
	unsigned char *bytes = at < summed ? (unsigned char *)w.supervisor.offline + at
	                                   : (unsigned char *)&w.supervisor.sum + (at - summed);
	*bytes ^= (unsigned char)(1 << random_below(&w.random, 8));
}

static void plant(void) {
	switch (random_below(&w.random, 150)) {
	case 0:
	case 1:
	case 2: spoil_learner(); break;
	case 3: spoil_covariance(); break;
	case 4: flip_mean(); break;
	case 5: flip_count(); break;
	case 6:
	case 7: flip_models(); break;
	default: break;
	}
}

/* ---- limits that move ------------------------------------------------------------------------ */

static void move_limit(size_t j) {
	const double told_apart = 200 * ((double)w.own.mpc.noise + (double)w.own.mpc.config.tolerance);
	const real width = random_uniform(&w.random, 0.3, 3) * (real)told_apart;
	switch (random_below(&w.random, 12)) {
	case 0: w.high[j] = w.low[j]; break;
	case 1: w.high[j] = (real)INFINITY; break;
	case 2:
	case 3: w.high[j] = w.low[j] + width; break;
	case 4:
	case 5: w.high[j] = w.low[j] + random_uniform(&w.random, 0.5, 4); break;
	case 6: w.low[j] = random_uniform(&w.random, -3, -1); break;
	default: break;
	}
	if (!(w.low[j] <= w.high[j])) { w.high[j] = w.low[j]; }
}

static void move_limits(void) {
	for (size_t j = 0; j < w.is->m; j++) { move_limit(j); }
}

/* ---- steps ----------------------------------------------------------------------------------- */

/* A path on which each step has a place of its own, and from which the robot is sometimes far at once. */
static void set_reference(void) {
	const double far = random_below(&w.random, 80) == 0 ? 30 : 1;
	for (size_t h = 0; h < w.is->H; h++) {
		for (size_t i = 0; i < w.is->n; i++) {
			const double phase = 0.4 * (double)(w.step + h) + (double)i;
			w.reference[h * w.is->n + i] = (real)(far * 0.7 * sin(phase));
		}
	}
}

static int same_result(const KOOP(mpc_result) *a, const KOOP(mpc_result) *b) {
	return memcmp(&a->residual, &b->residual, sizeof a->residual) == 0 && a->iterations == b->iterations;
}

static void control(const real *psi) {
	call mine = {psi, w.reference, w.u, {0}, {7, 7}}, other = mine;
	const int status = KOOP(supervisor_control)(&w.supervisor, &w.own.rls, &w.own.mpc, psi, w.reference, w.u,
	                                            mine.u, &mine.result);
	CHECK_STATUS(second_control(&w.second, &other), status);
	if (w.second.unsure) { return; }
	CHECK(memcmp(mine.u, other.u, sizeof mine.u) == 0, "%s, step %zu: input", w.is->name, w.step);
	CHECK(same_result(&mine.result, &other.result), "%s, step %zu: result", w.is->name, w.step);
	memcpy(w.u, mine.u, sizeof w.u);
	w.used[w.supervisor.model]++;
	check_all();
}

/* A state that is not a number, one beyond range, and crossed limits. */
static void control_badly(void) {
	real psi[MOST_N];
	memcpy(psi, w.psi, sizeof psi);
	const size_t kind = random_below(&w.random, 80);
	const real low = w.low[0];
	if (kind == 0) { psi[random_below(&w.random, w.is->N)] = (real)NAN; }
	if (kind == 1) { psi[0] = REAL_MAX / 2; }
	if (kind == 2) { w.low[0] = w.high[0] + 1; }
	if (kind < 2 || (kind == 2 && isfinite(w.low[0]))) { control(psi); }
	w.low[0] = low;
}

static void move_robot(void) {
	const size_t N = w.is->N, rows = KOOP_PAD(N);
	for (size_t i = 0; i < N; i++) {
		double sum = (double)random_uniform(&w.random, -0.02, 0.02);
		for (size_t j = 0; j < N; j++) { sum += (double)w.robot[j * rows + i] * (double)w.psi[j]; }
		for (size_t j = 0; j < w.is->m; j++) {
			sum += (double)w.robot[(N + j) * rows + i] * (double)w.u[j];
		}
		w.psi_next[i] = (real)sum;
	}
}

static int same_health(const KOOP(health) *a, const KOOP(health) *b) {
	const int flags =
	    a->positive_definite == b->positive_definite && a->finite == b->finite && a->frozen == b->frozen;
	return flags && memcmp(&a->innovation, &b->innovation, sizeof a->innovation) == 0 &&
	       memcmp(&a->trace, &b->trace, sizeof a->trace) == 0;
}

static void update(const real *psi_next) {
	KOOP(health) mine, other;
	const int status = KOOP(supervisor_update)(&w.supervisor, &w.own.rls, w.psi, w.u, psi_next, &mine);
	CHECK_STATUS(second_update(&w.second, w.psi, w.u, psi_next, &other), status);
	if (w.second.unsure) { return; }
	CHECK(same_health(&mine, &other), "%s, step %zu: health", w.is->name, w.step);
	check_all();
}

/* Samples that are not numbers, beyond range, or wild. */
static void update_badly(void) {
	static const double wild[] = {(double)NAN, (double)REAL_MAX, 3e2, 1e1};
	const size_t kind = random_below(&w.random, 100);
	real psi_next[MOST_N];
	memcpy(psi_next, w.psi_next, sizeof psi_next);
	if (kind >= sizeof wild / sizeof *wild) { return; }
	psi_next[random_below(&w.random, w.is->N)] = (real)wild[kind];
	const size_t times = 1 + random_below(&w.random, 4);
	for (size_t k = 0; k < times && !w.second.unsure; k++) { update(psi_next); }
}

static void one_step(void) {
	if (random_below(&w.random, 80) == 0) { change_robot(0.1, 2.5); }
	if (random_below(&w.random, 8) == 0) { move_limits(); }
	set_reference();
	plant();
	control_badly();
	if (!w.second.unsure) { control(w.psi); }
	move_robot();
	if (!w.second.unsure) { update_badly(); }
	if (!w.second.unsure && random_below(&w.random, 30) > 0) { update(w.psi_next); }
	memcpy(w.psi, w.psi_next, sizeof w.psi);
}

/* Ends early where rounding decides a comparison: what follows is another story. */
static size_t run(const setting *is, uint64_t seed, size_t steps) {
	prepare(is, seed);
	change_robot(0.5, 2);
	start();
	if (!w.second.unsure) { check_all(); }
	for (w.step = 0; w.step < steps && !w.second.unsure; w.step++) { one_step(); }
	return w.step;
}

/* ---- the tests ------------------------------------------------------------------------------- */

static const setting settings[] = {
    {"one input", 3, 2, 1, 5, 0, 0, KOOP_CHECK_REPORT, &KOOP(form_plain), 0, 0.01, 3, 40},
    {"two inputs", 5, 3, 2, 6, 0, 0, KOOP_CHECK_REPORT, &KOOP(form_plain), 0, 0.01, 2, 12},
    {"three inputs, gated", 5, 3, 3, 4, 0, 1, KOOP_CHECK_REFUSE, &KOOP(form_sqrt), 0, 0.01, 3, 60},
    {"rate penalty, coarse", 4, 3, 2, 5, 1, 0, KOOP_CHECK_REFUSE, &KOOP(form_sqrt), 0.01, 0.002, 3, 25},
    {"one input, coarse", 2, 1, 1, 1, 0, 0, KOOP_CHECK_REFUSE, &KOOP(form_plain), 0.02, 0.003, 2, 9},
    {"many lifted states", 9, 1, 1, 1, 0, 0, KOOP_CHECK_REPORT, &KOOP(form_sqrt), 0.01, 0.005, 2, 30},
    {"plans as fine as can be", 4, 2, 2, 6, 1, 0, KOOP_CHECK_REFUSE, &KOOP(form_sqrt), 1e-12, 0.001, 4, 30},
};

enum { SETTINGS = sizeof settings / sizeof *settings, SEEDS = 10 / TEST_SHARE + (TEST_SHARE > 10) };

static void test_supervisor_does_what_its_second_writing_says(void) {
	size_t steps = 0, resets = 0, used[4] = {0};
	for (size_t i = 0; i < (size_t)SETTINGS * SEEDS; i++) {
		steps += run(&settings[i % SETTINGS], 1 + i, STEPS);
		resets += w.supervisor.resets;
		for (size_t model = 0; model < 4; model++) { used[model] += w.used[model]; }
	}
	const size_t runs = (size_t)SETTINGS * SEEDS; /* and not all of it on the offline model */
	CHECK(steps > runs * STEPS / 2 && resets > runs, "%zu steps, %zu renewals", steps, resets);
	CHECK(used[ONLINE] > 20 * runs && used[LAST_GOOD] > runs, "%zu and %zu steps", used[ONLINE],
	      used[LAST_GOOD]);
}

/* ---- which pairs are judged */

/* Inputs that act on more than their own states, by very different amounts, and limits of all kinds. */
static void mix_inputs(void) {
	const size_t N = w.is->N, rows = KOOP_PAD(N);
	for (size_t j = 0; j < w.is->m; j++) {
		for (size_t i = 0; i < N; i++) {
			w.offline[(N + j) * rows + i] = (real)pow(10, (double)random_uniform(&w.random, -1, 0.5));
		}
		w.safe[j] = w.low[j] = random_uniform(&w.random, -10, 5);
		w.high[j] = random_below(&w.random, 6) ? random_uniform(&w.random, 5, 10) : (real)INFINITY;
	}
}

static size_t judged_pairs(void) {
	size_t count = 0;
	for (size_t p = 0; p < w.is->n * w.is->m; p++) { count += w.supervisor.judged[p] > 0; }
	return count;
}

static void test_pairs_are_judged_that_act_above_all(void) {
	size_t judged = 0, pairs = 0;
	for (uint64_t seed = 0; seed < 300 / TEST_SHARE; seed++) {
		prepare(&settings[seed % SETTINGS], 1000 + seed);
		mix_inputs();
		start();
		if (w.second.unsure) { continue; }
		check_all();
		judged += judged_pairs();
		pairs += w.is->n * w.is->m;
	}
	CHECK(judged < pairs * 9 / 10 && judged > pairs / 2, "%zu of %zu pairs", judged, pairs);
}

/* ---- storage */

typedef struct {
	const real *from;
	size_t count;
} part;

/* Every number has a place of its own, and there is none that is not used. */
static void test_parts_of_the_storage_lie_end_to_end(void) {
	for (size_t i = 0; i < (size_t)SETTINGS; i++) {
		prepare(&settings[i], 1);
		start();
		const KOOP(supervisor) *g = &w.supervisor;
		const size_t theta = (w.is->N + w.is->m) * KOOP_PAD(w.is->N), pairs = w.is->n * w.is->m;
		const part parts[] = {{g->offline, theta},  {g->last_good, theta}, {g->response, w.is->H * pairs},
		                      {g->judged, pairs},   {g->size, w.is->m},    {g->now, pairs},
		                      {g->square, pairs},   {g->along, pairs},     {g->target, w.is->n}};
		const real *at = w.storage;
		for (size_t k = 0; k < sizeof parts / sizeof *parts; k++) {
			CHECK(parts[k].from == at, "%s: part %zu", w.is->name, k);
			at += parts[k].count;
		}
		TEST_ASSERT_TRUE(at == w.storage + supervisor_reals());
	}
}

/* ---- steps without faults */

static void plain_step(void) {
	set_reference();
	control(w.psi);
	move_robot();
	update(w.psi_next);
	memcpy(w.psi, w.psi_next, sizeof w.psi);
	w.step++;
}

/* With a rate penalty the input applied last is an argument: no model is blamed where it is missing. */
static void test_call_without_an_argument_changes_nothing(void) {
	prepare(&settings[3], 5);
	memcpy(w.robot, w.offline, sizeof w.robot);
	start();
	while (w.step < 200 && w.supervisor.trusted < 3) { plain_step(); }
	static world before;
	before = w;
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_control)(&w.supervisor, &w.own.rls, &w.own.mpc, w.psi,
	                                                   w.reference, NULL, w.u, NULL));
	TEST_ASSERT_EQUAL_MEMORY(&before, &w, sizeof before);
}

/* Of a horizon of one step the states that are not tracked say nothing. The learner refuses all samples then,
 * and must not stay so because its model is in use. */
static void test_learner_in_use_that_is_not_finite_is_started_again(void) {
	prepare(&settings[4], 3);
	memcpy(w.robot, w.offline, sizeof w.robot);
	start();
	while (w.step < 200 && w.supervisor.trusted < 3) { plain_step(); }
	TEST_ASSERT_EQUAL_INT(ONLINE, w.supervisor.model);
	spoil(1, 1, (double)NAN);
	for (size_t k = 0; k < w.config.patience; k++) { update(w.psi); }
	TEST_ASSERT_TRUE(is_whole(&w.second, w.own.rls.theta));
	update(w.psi);
	TEST_ASSERT_EQUAL_size_t(0, w.supervisor.failed);
}

/* Nor with a last good model that was taken from it. */
static void test_learner_is_not_started_again_from_what_is_not_finite(void) {
	prepare(&settings[4], 3);
	change_robot(0.7, 0.8);
	start();
	while (w.step < 200 &&
	       (w.supervisor.trusted < 3 || 2 * w.supervisor.error[ONLINE] > w.supervisor.error[OFFLINE])) {
		plain_step();
	}
	spoil(1, 1, (double)NAN);
	for (size_t k = 0; k < 200 && !isnan(w.supervisor.last_good[1]); k++) { control(w.psi); }
	spoil(0, 1, (double)NAN);
	control(w.psi);
	TEST_ASSERT_EQUAL_INT(LAST_GOOD, w.supervisor.model);
	TEST_ASSERT_TRUE(isnan(w.supervisor.last_good[1]));
	const size_t before = w.supervisor.resets;
	for (size_t k = 0; k < w.config.patience; k++) { update(w.psi); }
	TEST_ASSERT_EQUAL_size_t(before + 1, w.supervisor.resets);
	TEST_ASSERT_EQUAL_MEMORY(w.offline, w.own.rls.theta, (w.is->N + w.is->m) * KOOP_PAD(w.is->N) * sizeof(real));
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_supervisor_does_what_its_second_writing_says);
	RUN_TEST(test_pairs_are_judged_that_act_above_all);
	RUN_TEST(test_parts_of_the_storage_lie_end_to_end);
	RUN_TEST(test_call_without_an_argument_changes_nothing);
	RUN_TEST(test_learner_in_use_that_is_not_finite_is_started_again);
	RUN_TEST(test_learner_is_not_started_again_from_what_is_not_finite);
	return UNITY_END();
}
