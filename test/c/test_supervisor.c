/* The supervisor in closed loop with a robot of its own: faults are planted in the
 * learner, the model in use and the distance from the path are watched. */
#include "tinykoop_supervisor.h"

#include "support.h"

enum { H = TEST_SHARE > 1 ? 20 : 50, M = 2, STATES = 3, MOST_N = 22, D = MOST_N + M };

static const double dt = 0.05;

/* All that a run needs. */
typedef struct {
	const KOOP(dictionary) *dictionary;
	KOOP(rls) rls;
	KOOP(mpc) mpc;
	KOOP(supervisor) supervisor;
	real rls_storage[KOOP_RLS_REALS_PLAIN(MOST_N, M) + KOOP_EXTENSION_REALS_PLAIN(MOST_N, M)];
	real mpc_storage[KOOP_MPC_REALS_NEWTON(MOST_N, STATES, M, H) + KOOP_MPC_REALS_RATE(M, H)];
	real supervisor_storage[KOOP_SUPERVISOR_REALS(MOST_N, STATES, M, H)];
	real offline[D * KOOP_PAD(MOST_N)];
	real Q[STATES * STATES], R[M * M], low[M], high[M], safe[M];
	double x[STATES]; /* true */
	real psi[MOST_N], psi_next[MOST_N], u[M];
	double gain; /* of the robot's speed */
	int stuck;   /* 1: the sensor gives the same reading again */
	int frozen;  /* 1: the learner gets no samples */
	size_t k;
	double error; /* distance from the path, m */
} loop;

static loop l;

/* Straight-line model about 1.5 m/s, which only the tracked states and theta take part in. */
static void write_offline(size_t N) {
	const size_t rows = KOOP_PAD(N);
	memset(l.offline, 0, sizeof l.offline);
	for (size_t i = 0; i < N; i++) { l.offline[i * rows + i] = 1; }
	l.offline[2 * rows + 1] = (real)(1.5 * dt);
	l.offline[N * rows + 0] = (real)dt;
	l.offline[(N + 1) * rows + 2] = (real)dt;
}

static double path(double t, size_t i) {
	const double pace = 0.7, size = 0.4;
	return i == 0 ? 1.5 * t : i == 1 ? size * sin(pace * t) : atan(size * pace / 1.5 * cos(pace * t));
}

static void lift(real *psi) {
	real x[STATES];
	for (size_t i = 0; i < STATES; i++) { x[i] = (real)l.x[i]; }
	CHECK_STATUS(KOOP_OK, KOOP(lift)(l.dictionary, x, psi));
}

static void begin(const KOOP(dictionary) *dictionary, const KOOP(regulator) *regulator,
                  const KOOP(form) *form, int check) {
	memset(&l, 0, sizeof l);
	l.dictionary = dictionary;
	l.gain = 1;
	const real q[] = {20, 20, 3}, r[] = {(real)0.05, (real)0.08};
	for (size_t i = 0; i < STATES; i++) { l.Q[i * (STATES + 1)] = q[i]; }
	for (size_t j = 0; j < M; j++) { l.R[j * (M + 1)] = r[j]; }
	l.high[0] = (real)3.5;
	l.high[1] = (real)1.2;
	l.low[1] = (real)-1.2;
	static const KOOP(dead_zone) zone = {(real)0.01};
	const int has_zone = regulator == &KOOP(reg_dz_cs) || regulator == &KOOP(reg_dz_ks);
	const KOOP(config) config = {
	    .dictionary = dictionary,
	    .n_inputs = M,
	    .regulator = regulator,
	    .settings = has_zone ? &zone : NULL,
	    .form = form,
	    .lambda = (real)0.98,
	    .p0 = 100,
	    .check = check,
	};
	const KOOP(mpc_config) mpc = {
	    .n_lifted = dictionary->n_lifted,
	    .n_states = STATES,
	    .n_inputs = M,
	    .horizon = H,
	    .Q = l.Q,
	    .R = l.R,
	    .u_min = l.low,
	    .u_max = l.high,
	    .u_safe = l.safe,
	};
	CHECK_STATUS(KOOP_OK,
	             KOOP(rls_init)(&l.rls, &config, l.rls_storage, sizeof l.rls_storage / sizeof(real)));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&l.mpc, &mpc, l.mpc_storage, sizeof l.mpc_storage / sizeof(real)));
	write_offline(dictionary->n_lifted);
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&l.supervisor, NULL, &l.mpc, l.offline, l.supervisor_storage,
	                                            KOOP_SUPERVISOR_REALS(dictionary->n_lifted, STATES, M, H)));
	for (size_t i = 0; i < STATES; i++) { l.x[i] = path(0, i); }
	lift(l.psi);
}

/* One control period; returns the model that was used. */
static int step(void) {
	real reference[H * STATES];
	for (size_t h = 0; h < H; h++) {
		for (size_t i = 0; i < STATES; i++) {
			reference[h * STATES + i] = (real)path(dt * (double)(l.k + 1 + h), i);
		}
	}
	KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, l.u, NULL);
	for (size_t j = 0; j < M; j++) {
		CHECK(l.u[j] >= l.low[j] && l.u[j] <= l.high[j], "step %zu: u[%zu] = %g", l.k, j, (double)l.u[j]);
	}
	l.x[0] += dt * l.gain * (double)l.u[0] * cos(l.x[2]);
	l.x[1] += dt * l.gain * (double)l.u[0] * sin(l.x[2]);
	l.x[2] += dt * (double)l.u[1];
	l.k++;
	if (l.stuck) {
		memcpy(l.psi_next, l.psi, sizeof l.psi);
	} else {
		lift(l.psi_next);
	}
	if (!l.frozen) { KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, l.u, l.psi_next, NULL); }
	memcpy(l.psi, l.psi_next, sizeof l.psi);
	l.error = hypot(l.x[0] - path(dt * (double)l.k, 0), l.x[1] - path(dt * (double)l.k, 1));
	return l.supervisor.model;
}

/* Largest distance from the path over some steps, and when the online model was first and last used. */
typedef struct {
	double error;
	size_t first_online, last_online, online; /* counted from 0; `steps` where never */
} watch;

static watch drive(size_t steps) {
	watch w = {0, steps, steps, 0};
	for (size_t k = 0; k < steps; k++) {
		if (step() == KOOP_SUPERVISOR_ONLINE) {
			w.first_online = w.first_online < k ? w.first_online : k;
			w.last_online = k;
			w.online++;
		}
		w.error = fmax(w.error, l.error);
	}
	return w;
}

static const KOOP(dictionary) *dictionaries[2];

static void for_both(void (*test)(const KOOP(dictionary) *)) {
	dictionaries[0] = &KOOP(poly_ddr);
	dictionaries[1] = &KOOP(rbf_ddr);
	for (size_t i = 0; i < 2; i++) { test(dictionaries[i]); }
}

/* SIFt learns from Theta = 0 while the offline model drives, and is in use after. */
static void settle(const KOOP(dictionary) *dictionary, int check) {
	begin(dictionary, &KOOP(reg_sift), &KOOP(form_plain), check);
	const watch w = drive(400);
	CHECK(w.error < 0.15, "%s strays by %g m while learning", dictionary->name, w.error);
	CHECK(w.first_online >= 14, "%s trusted at step %zu", dictionary->name, w.first_online);
	CHECK(l.supervisor.model == KOOP_SUPERVISOR_ONLINE, "%s not in use after 400 steps", dictionary->name);
}

/* After a fault: the path is kept, and the online model is in use again within `back` steps. */
static void recovers(const char *fault, const KOOP(dictionary) *dictionary, size_t back) {
	const watch w = drive(back);
	CHECK(w.error < 0.3, "%s, %s: strays by %g m", fault, dictionary->name, w.error);
	CHECK(w.online > 0, "%s, %s: online model not back after %zu steps", fault, dictionary->name, back);
}

static void not_online(const char *fault, const KOOP(dictionary) *dictionary) {
	const int model = step();
	CHECK(model == KOOP_SUPERVISOR_LAST_GOOD || model == KOOP_SUPERVISOR_OFFLINE, "%s, %s: planned on %d",
	      fault, dictionary->name, model);
}

static void nan_theta(const KOOP(dictionary) *dictionary) {
	settle(dictionary, KOOP_CHECK_REPORT);
	l.rls.theta[1] = (real)NAN;
	not_online("NaN in Theta", dictionary);
	recovers("NaN in Theta", dictionary, 300);
}

static void garbage_theta(const KOOP(dictionary) *dictionary) {
	const size_t N = dictionary->n_lifted;
	const double sizes[] = {0.1, 1, 1e3, 1e30};
	for (size_t s = 0; s < sizeof sizes / sizeof *sizes; s++) {
		random_source random = random_seed(7 + s);
		settle(dictionary, KOOP_CHECK_REPORT);
		random_fill(&random, l.rls.theta, (N + M) * KOOP_PAD(N), -sizes[s], sizes[s]);
		not_online("garbage in Theta", dictionary);
		recovers("garbage in Theta", dictionary, 300);
	}
}

static void flipped_inputs(const KOOP(dictionary) *dictionary) {
	const size_t N = dictionary->n_lifted, rows = KOOP_PAD(N);
	for (size_t j = 0; j < M; j++) {
		settle(dictionary, KOOP_CHECK_REPORT);
		for (size_t i = 0; i < N; i++) { l.rls.theta[(N + j) * rows + i] *= -1; }
		not_online("sign of B", dictionary);
		recovers("sign of B", dictionary, 300);
	}
}

/* P is started again at the next sample; the model may stay in use. */
static void indefinite_covariance(const KOOP(dictionary) *dictionary) {
	settle(dictionary, KOOP_CHECK_REPORT);
	const size_t before = l.supervisor.resets;
	for (size_t i = 0; i < KOOP_SYMMETRIC(l.rls.n_regressors); i++) { l.rls.covariance[i] *= -1; }
	step();
	CHECK(l.supervisor.resets == before + 1, "%s: learner not started again", dictionary->name);
	CHECK(l.rls.positive_definite, "%s: P still indefinite", dictionary->name);
	recovers("indefinite P", dictionary, 300);
}

/* One second without news: no model can help the robot in the meantime, but all must be well after. */
static void stuck_sensor(const KOOP(dictionary) *dictionary) {
	settle(dictionary, KOOP_CHECK_REPORT);
	l.stuck = 1;
	drive(20);
	CHECK(l.supervisor.model != KOOP_SUPERVISOR_ONLINE, "%s: online model still in use", dictionary->name);
	l.stuck = 0;
	drive(300);
	recovers("stuck sensor", dictionary, 300);
}

/* A prediction that drifts off, with inputs that still act as they should. The distance from the path is
 * not to give it away first. */
static void drifting_prediction(const KOOP(dictionary) *dictionary) {
	settle(dictionary, KOOP_CHECK_REPORT);
	l.supervisor.config.max_tracking_ratio = 1000;
	l.rls.config.regulator = &KOOP(reg_none);
	for (size_t i = 0; i < KOOP_SYMMETRIC(l.rls.n_regressors); i++) { l.rls.covariance[i] *= (real)1e-12; }
	l.rls.theta[1] += (real)1e-3; /* of px, some 30 m, in py */
	size_t left = 0;
	while (left < 10 && step() == KOOP_SUPERVISOR_ONLINE) { left++; }
	CHECK(left < 10, "%s: drifting model in use for %zu steps", dictionary->name, left);
	recovers("drifting prediction", dictionary, 400);
}

/* The robot loses half of its speed gain, the learner learns that, stops learning, and the robot is whole
 * again. */
static void frozen_learner(const KOOP(dictionary) *dictionary) {
	settle(dictionary, KOOP_CHECK_REPORT);
	l.gain = 0.5;
	drive(400);
	CHECK(l.supervisor.model == KOOP_SUPERVISOR_ONLINE, "%s: slow robot not learned", dictionary->name);
	for (size_t i = 0; i < KOOP_SYMMETRIC(l.rls.n_regressors); i++) { l.rls.covariance[i] *= (real)1e-12; }
	l.rls.config.regulator = &KOOP(reg_none);
	l.gain = 1;
	size_t left = 0;
	while (left < 60 && step() == KOOP_SUPERVISOR_ONLINE) { left++; }
	CHECK(left < 60, "%s: frozen model in use for %zu steps", dictionary->name, left);
	recovers("frozen learner", dictionary, 400);
}

static void test_nan_theta(void) {
	for_both(nan_theta);
}
static void test_garbage_theta(void) {
	for_both(garbage_theta);
}
static void test_flipped_inputs(void) {
	for_both(flipped_inputs);
}
static void test_indefinite_covariance(void) {
	for_both(indefinite_covariance);
}
static void test_stuck_sensor(void) {
	for_both(stuck_sensor);
}
static void test_drifting_prediction(void) {
	for_both(drifting_prediction);
}
static void test_frozen_learner(void) {
	for_both(frozen_learner);
}

/* Every regulator and form from Theta = 0, 1,500 steps. */
static void keeps_path(const KOOP(dictionary) *dictionary) {
	for (size_t r = 0; r < REGULATORS; r++) {
		for (size_t f = 0; f < FORMS; f++) {
			begin(dictionary, all_regulators[r], all_forms[f], KOOP_CHECK_REPORT);
			const watch w = drive(1500);
			CHECK(w.error < 0.3, "%s %s %s strays by %g m", dictionary->name, all_regulators[r]->name,
			      all_forms[f]->name, w.error);
			CHECK(w.online > 300, "%s %s %s in use for %zu steps", dictionary->name, all_regulators[r]->name,
			      all_forms[f]->name, w.online);
		}
	}
}

static void test_keeps_path(void) {
	for_both(keeps_path);
}

/* A supervisor with settings of its own, around a learner that has learned and is held there. */
static void begin_again(const KOOP(supervisor_config) *config) {
	settle(&KOOP(poly_ddr), KOOP_CHECK_REPORT);
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_init)(&l.supervisor, config, &l.mpc, l.offline, l.supervisor_storage,
	                                   sizeof l.supervisor_storage / sizeof(real)));
	l.frozen = 1;
}

/* The online model is spoilt for one step; how many steps it is then not in use. */
static size_t steps_of_distrust(void) {
	const real kept = l.rls.theta[0];
	l.rls.theta[0] = (real)NAN;
	CHECK(step() != KOOP_SUPERVISOR_ONLINE, "planned on NaN");
	l.rls.theta[0] = kept;
	size_t steps = 1;
	while (steps < 1000 && step() != KOOP_SUPERVISOR_ONLINE) { steps++; }
	return steps;
}

/* Each time that a model is trusted in vain it is not tried for twice as long, up to 16 times the patience;
 * but trust that lasts wipes that out. */
static void test_patience(void) {
	static const size_t waits[] = {2, 4, 8, 16, 32, 32};
	begin_again(&(KOOP(supervisor_config)){.patience = 2, .renewal = 7, .max_tracking_ratio = 1000});
	TEST_ASSERT_TRUE(l.supervisor.config.renewal == 7);
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_OFFLINE, step());
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_ONLINE, step());
	for (size_t i = 0; i < sizeof waits / sizeof *waits; i++) {
		const size_t steps = steps_of_distrust();
		CHECK(steps == waits[i], "time %zu: %zu steps", i, steps);
	}
	TEST_ASSERT_TRUE(drive(32).online == 32);
	TEST_ASSERT_TRUE(steps_of_distrust() == 2);
}

/* Settings: the online model, which would be in use, is not where its plan is to be better than plans can be.
 */
static void test_residual_that_is_not_to_be_had(void) {
	begin_again(&(KOOP(supervisor_config)){.max_residual = (real)0.01});
	TEST_ASSERT_TRUE(drive(40).online > 0);
	begin_again(&(KOOP(supervisor_config)){.max_residual = REAL_MIN});
	TEST_ASSERT_TRUE(drive(40).online == 0);
}

/* A state from which each of the three models predicts beyond range: the safe input, and on the next sample
 * all is well again, but for the last good model. */
static void test_no_model_gives_a_plan(void) {
	real reference[H * STATES] = {0}, huge[MOST_N], u[M] = {7, 7};
	KOOP(mpc_result) result = {7, 7};
	settle(&KOOP(poly_ddr), KOOP_CHECK_REPORT);
	TEST_ASSERT_TRUE(l.supervisor.have_last_good);
	for (size_t i = 0; i < MOST_N; i++) { huge[i] = REAL_MAX / 2; }
	CHECK_STATUS(KOOP_E_OVERFLOW,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, huge, reference, NULL, u, &result));
	for (size_t j = 0; j < M; j++) { TEST_ASSERT_TRUE(u[j] == l.safe[j]); }
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_NONE, l.supervisor.model);
	TEST_ASSERT_TRUE(!l.supervisor.have_last_good);
	TEST_ASSERT_TRUE(result.residual == 0 && result.iterations == 0);
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_OFFLINE, step());
	TEST_ASSERT_TRUE(drive(30).online > 0);
}

/* What rls_update() and mpc_solve() tell comes through, and so does the input-rate penalty. */
static void test_what_is_told(void) {
	real reference[H * STATES] = {0}, S[M * M] = {100, 0, 0, 100}, u[M], covariance[9 * 9];
	const real before[M] = {3, -1};
	KOOP(mpc_result) result = {7, 7};
	KOOP(health) health = {.finite = 0};
	begin(&KOOP(poly_ddr), &KOOP(reg_ef), &KOOP(form_plain), KOOP_CHECK_REFUSE);
	for (size_t h = 0; h < H; h++) { reference[h * STATES] = (real)(0.05 * (double)(h + 1)); }
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, &result));
	TEST_ASSERT_TRUE(result.residual <= l.mpc.config.tolerance && result.iterations > 0);
	const double change = fabs((double)(u[0] - before[0]));

	lift(l.psi_next);
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, u, l.psi_next, &health));
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_covariance)(&l.rls, covariance));
	TEST_ASSERT_TRUE(health.finite && health.positive_definite && !health.frozen);
	CHECK(fabs((double)(health.trace - (real)trace_of(covariance, 9))) <= 1e-4 * (double)health.trace, "%g",
	      (double)health.trace);

	KOOP(mpc_config) config = l.mpc.config;
	config.S = S;
	CHECK_STATUS(KOOP_OK,
	             KOOP(mpc_init)(&l.mpc, &config, l.mpc_storage, sizeof l.mpc_storage / sizeof(real)));
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&l.supervisor, NULL, &l.mpc, l.offline, l.supervisor_storage,
	                                            sizeof l.supervisor_storage / sizeof(real)));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, before, u, NULL));
	CHECK(fabs((double)(u[0] - before[0])) < 0.5 * change, "changed by %g, without penalty by %g",
	      fabs((double)(u[0] - before[0])), change);
}

/* A response that the weights do not see, since it is the same in two states, and whose size is beyond range.
 */
static void test_offline_model_beyond_range(void) {
	enum { n = 2, m = 1, horizon = 3 };
	static real mpc_storage[KOOP_MPC_REALS_NEWTON(n, n, m, horizon)],
	    storage[KOOP_SUPERVISOR_REALS(n, n, m, horizon)];
	const real Q[n * n] = {1, -1, -1, 1}, R[m] = {1}, low[m] = {-1}, high[m] = {1}, safe[m] = {0};
	real offline[(n + m) * KOOP_PAD(n)] = {1, 0, 0, 0, 0, 1};
	KOOP(mpc) mpc;
	KOOP(supervisor) supervisor;
	const KOOP(mpc_config) config = {
	    .n_lifted = n,
	    .n_states = n,
	    .n_inputs = m,
	    .horizon = horizon,
	    .Q = Q,
	    .R = R,
	    .u_min = low,
	    .u_max = high,
	    .u_safe = safe,
	};
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&mpc, &config, mpc_storage, sizeof mpc_storage / sizeof(real)));
	for (size_t i = 0; i < n; i++) { offline[n * KOOP_PAD(n) + i] = 1; }
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&supervisor, NULL, &mpc, offline, storage,
	                                            sizeof storage / sizeof(real)));
	for (size_t i = 0; i < n; i++) { offline[n * KOOP_PAD(n) + i] = (real)(4 * sqrt((double)REAL_MAX)); }
	CHECK_STATUS(KOOP_E_MODEL, KOOP(supervisor_init)(&supervisor, NULL, &mpc, offline, storage,
	                                                 sizeof storage / sizeof(real)));
}

/* Objects that are missing, were never made, or are of other sizes. */
static void test_objects_that_do_not_fit(void) {
	real reference[H * STATES] = {0}, u[M];
	KOOP(supervisor) supervisor;
	KOOP(rls) rls;
	KOOP(mpc) mpc;
	memset(&supervisor, 0, sizeof supervisor);
	memset(&rls, 0, sizeof rls);
	memset(&mpc, 0, sizeof mpc);
	begin(&KOOP(poly_ddr), &KOOP(reg_ef), &KOOP(form_plain), KOOP_CHECK_REFUSE);
	const size_t reals = sizeof l.supervisor_storage / sizeof(real);
	const KOOP(supervisor) before = l.supervisor;

	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_init)(&supervisor, NULL, &mpc, l.offline, l.supervisor_storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&supervisor, &l.rls, l.psi, l.u, l.psi, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&l.supervisor, NULL, l.psi, l.u, l.psi, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&l.supervisor, &rls, l.psi, l.u, l.psi, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, NULL, l.psi, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, l.u, NULL, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, NULL, l.psi, reference, NULL, u, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &mpc, l.psi, reference, NULL, u, NULL));

	size_t *const learner[] = {&l.rls.n_lifted, &l.rls.config.n_inputs};
	for (size_t i = 0; i < sizeof learner / sizeof *learner; i++) {
		--*learner[i];
		CHECK_STATUS(KOOP_E_SIZE, KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, l.u, l.psi, NULL));
		CHECK_STATUS(KOOP_E_SIZE, KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference,
		                                                   NULL, u, NULL));
		++*learner[i];
	}
	size_t *const controller[] = {&l.mpc.config.n_lifted, &l.mpc.config.n_states, &l.mpc.config.n_inputs,
	                              &l.mpc.config.horizon};
	for (size_t i = 0; i < sizeof controller / sizeof *controller; i++) {
		--*controller[i];
		CHECK_STATUS(KOOP_E_SIZE, KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference,
		                                                   NULL, u, NULL));
		++*controller[i];
	}
	TEST_ASSERT_EQUAL_MEMORY(&before, &l.supervisor, sizeof before);
}

/* Samples as large as the range allows, on a model that is garbage: the mean errors stay numbers, else the
 * online model would never be trusted again. */
static void test_wild_samples_are_forgotten(void) {
	settle(&KOOP(poly_ddr), KOOP_CHECK_REPORT);
	const real theta = l.rls.theta[0];
	real wild[MOST_N];
	memcpy(wild, l.psi, sizeof wild);
	wild[0] = (real)sqrt((double)REAL_MAX / 100);
	for (int k = 0; k < 50; k++) {
		l.rls.theta[0] = REAL_MAX / 4;
		l.supervisor.model = KOOP_SUPERVISOR_ONLINE;
		KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, l.u, wild, NULL);
		for (size_t i = 0; i < 3; i++) {
			CHECK(isfinite(l.supervisor.error[i]), "sample %d, model %zu", k, i);
		}
	}
	l.rls.theta[0] = theta;
	drive(1000);
	recovers("wild samples", &KOOP(poly_ddr), 300);
}

/* What is refused leaves supervisor and learner as they were. */
static void test_arguments(void) {
	real reference[H * STATES] = {0}, u[M] = {7, 7};
	KOOP(supervisor) supervisor;
	KOOP(supervisor_config) config = {0};
	settle(&KOOP(poly_ddr), KOOP_CHECK_REFUSE);
	const size_t reals = KOOP_SUPERVISOR_REALS(7, STATES, M, H);
	static real storage[KOOP_SUPERVISOR_REALS(7, STATES, M, H)];
	real *offline = l.offline;

	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_init)(NULL, NULL, &l.mpc, offline, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_init)(&supervisor, NULL, NULL, offline, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_init)(&supervisor, NULL, &l.mpc, NULL, storage, reals));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_init)(&supervisor, NULL, &l.mpc, offline, NULL, reals));
	CHECK_STATUS(KOOP_E_STORAGE,
	             KOOP(supervisor_init)(&supervisor, NULL, &l.mpc, offline, storage, reals - 1));
	config.max_gain = (real)NAN;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(supervisor_init)(&supervisor, &config, &l.mpc, offline, storage, reals));
	config.max_gain = (real)INFINITY;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(supervisor_init)(&supervisor, &config, &l.mpc, offline, storage, reals));
	config.max_gain = -1;
	CHECK_STATUS(KOOP_E_RANGE, KOOP(supervisor_init)(&supervisor, &config, &l.mpc, offline, storage, reals));
	const real kept = offline[0];
	offline[0] = (real)NAN;
	CHECK(KOOP(supervisor_init)(&supervisor, NULL, &l.mpc, offline, storage, reals) < 0,
	      "took a model that is NaN");
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	offline[0] = kept;
	for (size_t i = 0; i < 8; i++) { offline[7 * 8 + i] = 0; }
	CHECK_STATUS(KOOP_E_MODEL, KOOP(supervisor_init)(&supervisor, NULL, &l.mpc, offline, storage, reals));

	const KOOP(supervisor) before = l.supervisor;
	static learned now, then;
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(NULL, &l.rls, l.psi, l.u, l.psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&l.supervisor, &l.rls, NULL, l.u, l.psi_next, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, NULL, reference, NULL, u, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, NULL, NULL, u, NULL));
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, NULL, NULL));
	l.mpc.config.horizon--;
	CHECK_STATUS(KOOP_E_SIZE,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	l.mpc.config.horizon++;
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&l.rls, then.theta));
	real bad[MOST_N];
	memcpy(bad, l.psi, sizeof bad);
	bad[1] = (real)NAN;
	CHECK_STATUS(KOOP_E_INPUT, KOOP(supervisor_update)(&l.supervisor, &l.rls, bad, l.u, l.psi_next, NULL));
	CHECK_STATUS(KOOP_OK, KOOP(rls_get_theta)(&l.rls, now.theta));
	TEST_ASSERT_EQUAL_MEMORY(then.theta, now.theta, 7 * 9 * sizeof(real));
	TEST_ASSERT_EQUAL_MEMORY(&before, &l.supervisor, sizeof before);

	/* a state that is not a number: the safe input, and no model is blamed */
	CHECK_STATUS(KOOP_E_INPUT,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, bad, reference, NULL, u, NULL));
	for (size_t j = 0; j < M; j++) { TEST_ASSERT_TRUE(u[j] == l.safe[j]); }
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_NONE, l.supervisor.model);
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_ONLINE, step());
}

/* ---- limits that move ---------------------------------------------------------------------- */

static void begin_usual(void) {
	begin(&KOOP(poly_ddr), &KOOP(reg_dz_cs), &KOOP(form_sqrt), KOOP_CHECK_REFUSE);
}

static void start_supervisor(const KOOP(supervisor_config) *config) {
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_init)(&l.supervisor, config, &l.mpc, l.offline, l.supervisor_storage,
	                                   KOOP_SUPERVISOR_REALS(7, STATES, M, H)));
}

/* From the start, or later; to the bit, or to what no solver can tell. */
static void test_model_is_trusted_though_an_input_is_fixed(void) {
	static const double widths[] = {0, 1e-6};
	for (size_t i = 0; i < sizeof widths / sizeof *widths; i++) {
		for (int from_start = 0; from_start < 2; from_start++) {
			begin_usual();
			l.safe[0] = l.low[0] = (real)1.55;
			l.high[0] = (real)(1.55 + widths[i]);
			if (from_start) { start_supervisor(NULL); }
			const watch w = drive(400);
			CHECK(w.online > 250, "width %g: online for %zu of 400 steps", widths[i], w.online);
			TEST_ASSERT_TRUE(l.supervisor.resets <= 1); /* that of a learner that begins at nothing */
		}
	}
}

static void test_path_is_kept_with_rate_limits(void) {
	begin_usual();
	size_t online = 0;
	for (int k = 0; k < 400; k++) {
		static const double rate[M] = {0.2, 0.1}, low[M] = {0, -1.2}, high[M] = {3.5, 1.2};
		for (size_t j = 0; j < M; j++) {
			l.low[j] = (real)fmax(low[j], (double)l.u[j] - rate[j]);
			l.high[j] = (real)fmin(high[j], (double)l.u[j] + rate[j]);
		}
		online += step() == KOOP_SUPERVISOR_ONLINE;
	}
	CHECK(online > 250 && l.error < 0.1, "online for %zu of 400 steps, %g m off", online, l.error);
}

static void test_path_is_kept_without_limits(void) {
	begin_usual();
	for (size_t j = 0; j < M; j++) {
		l.low[j] = -(real)INFINITY;
		l.high[j] = (real)INFINITY;
	}
	start_supervisor(NULL);
	const watch w = drive(400);
	CHECK(w.online > 250 && l.error < 0.1, "online for %zu of 400 steps, %g m off", w.online, l.error);
}

/* Crossed limits say nothing of a model: the safe input, and the plan and the trust go on. */
static void test_crossed_limits_are_no_fault_of_the_model(void) {
	real reference[H * STATES] = {0}, u[M] = {7, 7};
	begin_usual();
	TEST_ASSERT_TRUE(drive(200).last_online == 199);
	l.low[0] = 4;
	CHECK_STATUS(KOOP_E_RANGE,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	TEST_ASSERT_TRUE(u[0] >= 0 && u[0] <= 0 && u[1] >= 0 && u[1] <= 0);
	l.low[0] = 0;
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_ONLINE, step());
}

/* ---- the learner behind the supervisor ------------------------------------------------------------ */

static int update_with(real first, KOOP(health) *health) {
	real psi_next[MOST_N];
	lift(psi_next);
	psi_next[0] = first;
	return KOOP(supervisor_update)(&l.supervisor, &l.rls, l.psi, l.u, psi_next, health);
}

static void test_one_huge_sample_costs_nothing(void) {
	static real kept[sizeof l.rls_storage / sizeof(real)];
	begin_usual();
	TEST_ASSERT_TRUE(drive(200).last_online == 199);
	const size_t size = l.rls.kept * sizeof(real); /* what was learned */
	const size_t resets = l.supervisor.resets;
	memcpy(kept, l.rls.theta, size);
	CHECK_STATUS(KOOP_E_OVERFLOW, update_with(REAL_MAX * (real)0.9, NULL));
	TEST_ASSERT_TRUE(memcmp(kept, l.rls.theta, size) == 0);
	TEST_ASSERT_EQUAL_size_t(resets, l.supervisor.resets);
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_ONLINE, step());
	for (size_t k = 1; k <= l.supervisor.config.patience; k++) {
		TEST_ASSERT_EQUAL_size_t(resets, l.supervisor.resets);
		CHECK_STATUS(KOOP_E_OVERFLOW, update_with(REAL_MAX * (real)0.9, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(resets + 1, l.supervisor.resets);
}

/* A hundredth of it is nothing in this precision. */
static void test_learner_of_a_tiny_p0_is_started_again(void) {
	begin_usual();
	l.rls.config.p0 = 50 * REAL_MIN;
	l.supervisor.distrusted = l.supervisor.config.renewal;
	CHECK_STATUS(KOOP_OK, update_with(0, NULL));
	TEST_ASSERT_EQUAL_size_t(1, l.supervisor.resets);
	KOOP(health) health;
	(void)update_with(0, &health);
	TEST_ASSERT_TRUE(health.trace < REAL_MIN * 1000);
	TEST_ASSERT_EQUAL_size_t(1, l.supervisor.resets);
}

static void test_configuration_may_be_the_supervisor_s_own(void) {
	begin_usual();
	l.supervisor.config.patience = 3;
	l.supervisor.config.max_gain = 7;
	start_supervisor(&l.supervisor.config);
	TEST_ASSERT_EQUAL_size_t(3, l.supervisor.config.patience);
	TEST_ASSERT_TRUE(l.supervisor.config.max_gain >= 7 && l.supervisor.config.max_gain <= 7);
}

/* ---- behind a gate ----------------------------------------------------------------------------- */

static KOOP(gate) gate;
static real gate_storage[KOOP_GATE_REALS_SQRT(7, M)];

static void begin_gated(void) {
	begin_usual();
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &l.rls, gate_storage, sizeof gate_storage / sizeof(real)));
	start_supervisor(&(KOOP(supervisor_config)){.gate = &gate});
	TEST_ASSERT_TRUE(drive(300).last_online == 299);
}

static void test_supervisor_learns_through_a_gate(void) {
	static real kept[sizeof l.rls_storage / sizeof(real)];
	begin_gated();
	const size_t size = l.rls.kept * sizeof(real);
	real error[3];
	memcpy(kept, l.rls.theta, size);
	memcpy(error, l.supervisor.error, sizeof error);
	CHECK_STATUS(KOOP_E_OUTLIER, update_with(100, NULL));
	TEST_ASSERT_TRUE(memcmp(kept, l.rls.theta, size) == 0);
	TEST_ASSERT_TRUE(memcmp(error, l.supervisor.error, sizeof error) ==
	                 0); /* an outlier says nothing of a model */
	TEST_ASSERT_EQUAL_INT(KOOP_SUPERVISOR_ONLINE, step());
	TEST_ASSERT_EQUAL_INT(KOOP_DOUBTFUL, KOOP(gate_trust)(&gate));
}

/* A sensor that jumps for a second: with the gate the path is kept on a learner that is whole. */
static void test_gate_and_supervisor_ride_out_a_fault_together(void) {
	begin_gated();
	for (int k = 0; k < 20; k++) {
		(void)update_with(k % 2 ? 50 : -50, NULL);
		(void)step();
	}
	const watch w = drive(300);
	CHECK(w.error < 0.2, "%g m off", w.error);
	TEST_ASSERT_TRUE(w.last_online == 299);
	TEST_ASSERT_TRUE(KOOP(gate_trust)(&gate) != KOOP_REFUSE);
}

static void test_gate_of_another_learner_is_refused(void) {
	static estimator other;
	static real other_storage[KOOP_GATE_REALS_PLAIN(3, 1)];
	KOOP(health) health;
	begin_gated();
	estimator_default(&other, 3, 1, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &other.rls, other_storage,
	                                      sizeof other_storage / sizeof(real)));
	CHECK_STATUS(KOOP_E_SIZE, update_with(0, &health));
	memset(&gate, 0, sizeof gate);
	CHECK_STATUS(KOOP_E_NULL, update_with(0, &health));
}

/* ---- in a memory whose bits may flip -------------------------------------------------------------- */

static void test_flipped_bit_of_the_supervisor_s_models_is_repaired(void) {
	static real kept[sizeof l.supervisor_storage / sizeof(real)];
	begin_usual();
	TEST_ASSERT_TRUE(drive(200).last_online == 199);
	const size_t words = (size_t)(l.supervisor.now - l.supervisor.offline);
	const loop before = l;
	memcpy(kept, l.supervisor_storage, sizeof kept);
	for (size_t i = 0; i < words; i++) {
		l = before;
		((unsigned char *)(l.supervisor.offline + i))[i % sizeof(real)] ^= (unsigned char)(1 << i % 8);
		(void)step();
		CHECK(memcmp(kept, l.supervisor.offline, words * sizeof(real)) == 0, "word %zu", i);
	}
}

static void test_models_beyond_mending_give_the_safe_input(void) {
	real reference[H * STATES] = {0}, u[M] = {7, 7};
	begin_usual();
	l.low[0] = 1; /* so that the safe input is not inside */
	((unsigned char *)l.supervisor.offline)[0] ^= 0x14;
	((unsigned char *)l.supervisor.offline)[9] ^= 0x01;
	CHECK_STATUS(KOOP_E_MEMORY,
	             KOOP(supervisor_control)(&l.supervisor, &l.rls, &l.mpc, l.psi, reference, NULL, u, NULL));
	TEST_ASSERT_TRUE(u[0] >= 0 && u[0] <= 3.5 && u[1] >= 0 && u[1] <= 0);
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_model_is_trusted_though_an_input_is_fixed);
	RUN_TEST(test_path_is_kept_with_rate_limits);
	RUN_TEST(test_path_is_kept_without_limits);
	RUN_TEST(test_crossed_limits_are_no_fault_of_the_model);
	RUN_TEST(test_one_huge_sample_costs_nothing);
	RUN_TEST(test_learner_of_a_tiny_p0_is_started_again);
	RUN_TEST(test_configuration_may_be_the_supervisor_s_own);
	RUN_TEST(test_supervisor_learns_through_a_gate);
	RUN_TEST(test_gate_and_supervisor_ride_out_a_fault_together);
	RUN_TEST(test_gate_of_another_learner_is_refused);
	RUN_TEST(test_flipped_bit_of_the_supervisor_s_models_is_repaired);
	RUN_TEST(test_models_beyond_mending_give_the_safe_input);
	RUN_TEST(test_nan_theta);
	RUN_TEST(test_garbage_theta);
	RUN_TEST(test_flipped_inputs);
	RUN_TEST(test_indefinite_covariance);
	RUN_TEST(test_stuck_sensor);
	RUN_TEST(test_drifting_prediction);
	RUN_TEST(test_frozen_learner);
	RUN_TEST(test_keeps_path);
	RUN_TEST(test_patience);
	RUN_TEST(test_residual_that_is_not_to_be_had);
	RUN_TEST(test_no_model_gives_a_plan);
	RUN_TEST(test_what_is_told);
	RUN_TEST(test_offline_model_beyond_range);
	RUN_TEST(test_objects_that_do_not_fit);
	RUN_TEST(test_wild_samples_are_forgotten);
	RUN_TEST(test_arguments);
	return UNITY_END();
}
