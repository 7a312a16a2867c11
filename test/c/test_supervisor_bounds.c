/* The supervisor exactly at its bounds and a last place beside them, in numbers that no rounding touches; and
 * what is refused, which leaves everything as it was. */
#include "tinykoop_supervisor.h"

#include "support.h"

enum { N = 2, M = 2, MOST_H = 2, PADDED = KOOP_PAD(N), THETA = (N + M) * PADDED };
enum {
	ONLINE = KOOP_SUPERVISOR_ONLINE,
	LAST_GOOD = KOOP_SUPERVISOR_LAST_GOOD,
	OFFLINE = KOOP_SUPERVISOR_OFFLINE
};
enum {
	SUPERVISOR_REALS = KOOP_SUPERVISOR_REALS(N, N, M, MOST_H),
	MPC_REALS = KOOP_MPC_REALS_NEWTON(N, N, M, MOST_H)
};

/* Offline, x = u at the next step: each input answers for one state. */
typedef struct {
	estimator learner;
	KOOP(mpc) mpc;
	KOOP(supervisor) supervisor;
	real low[M], high[M], safe[M], Q[N * N], R[M * M];
	real offline[THETA], mpc_storage[MPC_REALS], storage[SUPERVISOR_REALS];
	KOOP(mpc_result) result;
} robot;

static robot r;

static real above(real value) {
	return (real)nextafter(value, REAL_MAX);
}

static real below(real value) {
	return (real)nextafter(value, -REAL_MAX);
}

/* Row after row of the learner's Theta, d to a row. */
static void teach(const real *theta) {
	CHECK_STATUS(KOOP_OK, KOOP(rls_set_theta)(&r.learner.rls, theta));
}

static void start_controller(size_t horizon, double tolerance) {
	const KOOP(mpc_config) config = {
	    .n_lifted = N,
	    .n_states = N,
	    .n_inputs = M,
	    .horizon = horizon,
	    .Q = r.Q,
	    .R = r.R,
	    .u_min = r.low,
	    .u_max = r.high,
	    .u_safe = r.safe,
	    .tolerance = (real)tolerance,
	};
	CHECK_STATUS(KOOP_OK, KOOP(mpc_init)(&r.mpc, &config, r.mpc_storage, MPC_REALS));
}

static void prepare(void) {
	static const real same[N * (N + M)] = {0, 0, 1, 0, 0, 0, 0, 1};
	memset(&r, 0, sizeof r);
	for (size_t i = 0; i < N; i++) {
		r.Q[i * N + i] = r.R[i * M + i] = 1;
		r.offline[(N + i) * PADDED + i] = 1;
		r.low[i] = -1;
		r.high[i] = 1;
	}
	estimator_default(&r.learner, N, M, &KOOP(reg_ef), &KOOP(form_sqrt));
	teach(same);
}

/* The online model, which is as the offline one, may be tried at once. */
static void start(size_t horizon, double tolerance, const KOOP(supervisor_config) *config) {
	prepare();
	start_controller(horizon, tolerance);
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&r.supervisor, config, &r.mpc, r.offline, r.storage,
	                                            SUPERVISOR_REALS));
	r.supervisor.wait = 0;
}

/* Which model a step from x is planned on. */
static int model_at(const real *x) {
	static const real reference[MOST_H * N] = {0};
	real u[M];
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_control)(&r.supervisor, &r.learner.rls, &r.mpc, x, reference, NULL,
	                                               u, &r.result));
	return r.supervisor.model;
}

static int model_at_rest(void) {
	static const real rest[N] = {0};
	return model_at(rest);
}

/* ---- what a model answers */

/* What the first input does to the first and to the second state. */
static int model_with_gains(double max_gain, real own, real other) {
	const real theta[N * (N + M)] = {0, 0, own, 0, 0, 0, other, 1};
	start(1, 0, &(KOOP(supervisor_config)){.min_gain = (real)0.5, .max_gain = (real)max_gain});
	teach(theta);
	return model_at_rest();
}

static void test_gain_may_be_as_small_and_as_large_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_gains(2, (real)0.5, 0));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_gains(2, below((real)0.5), 0));
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_gains(2, 2, 0));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_gains(2, above(2), 0));
}

/* The second state is not the first input's to answer for, but counts for its size: 1 + 0.75^2 = 1.25^2. */
static void test_response_of_all_states_may_be_as_large_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_gains(1.25, 1, (real)0.75));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_gains(1.25, 1, above((real)0.75)));
}

/* Over two steps (1, 0) offline, (4, 3) online: the cosine is 0.8. */
static int model_with_cosine(real least) {
	const real theta[N * (N + M)] = {(real)0.75, 0, 4, 0, 0, 0, 0, 1};
	start(2, 0, &(KOOP(supervisor_config)){.min_cosine = least, .max_gain = 8});
	teach(theta);
	return model_at_rest();
}

static void test_direction_may_be_as_far_off_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_cosine((real)0.8));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_cosine(above((real)0.8)));
}

/* Inside the range of the numbers by less than a factor of 2. */
static void test_offline_model_may_answer_as_strongly_as_numbers_allow(void) {
	prepare();
	for (size_t j = 0; j < M; j++) {
		r.low[j] = (real)-0.25;
		r.high[j] = (real)0.25;
	}
	r.offline[N * PADDED + 1] = (real)sqrt(0.7 * (double)REAL_MAX);
	start_controller(1, 0);
	CHECK_STATUS(KOOP_OK,
	             KOOP(supervisor_init)(&r.supervisor, NULL, &r.mpc, r.offline, r.storage, SUPERVISOR_REALS));
	TEST_ASSERT_TRUE(r.supervisor.size[0] > REAL_MAX / 2);
}

/* ---- what a model predicts, and where the robot is */

static int model_with_error(real online) {
	start(1, 0, &(KOOP(supervisor_config)){.max_error_ratio = 4});
	r.supervisor.error[ONLINE] = online;
	r.supervisor.error[OFFLINE] = 1;
	return model_at_rest();
}

static void test_error_may_be_as_large_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_error(16));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_error(above(16)));
}

static int model_away(real distance) {
	const real x[N] = {distance, 0};
	start(1, 0, &(KOOP(supervisor_config)){.max_tracking_ratio = 4});
	r.supervisor.have_target = 1;
	r.supervisor.tracking = 1;
	return model_at(x);
}

static void test_robot_may_be_as_far_off_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_away(4));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_away(above(4)));
}

/* After four steps of trust with a patience of 1, the step after them. */
static int model_instead(real last_good, real offline) {
	start(1, 0, &(KOOP(supervisor_config)){.patience = 1});
	for (int k = 0; k < 4; k++) { TEST_ASSERT_EQUAL_INT(ONLINE, model_at_rest()); }
	TEST_ASSERT_TRUE(r.supervisor.have_last_good);
	r.supervisor.wait = 9;
	r.supervisor.error[LAST_GOOD] = last_good;
	r.supervisor.error[OFFLINE] = offline;
	return model_at_rest();
}

static void test_last_good_model_goes_before_an_offline_model_as_good(void) {
	TEST_ASSERT_EQUAL_INT(LAST_GOOD, model_instead(1, 1));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_instead(above(1), 1));
	TEST_ASSERT_EQUAL_INT(LAST_GOOD, model_instead(0, 0));
}

/* ---- how good a plan is */

/* From where the plan that is at hand leaves a residual within the tolerance, over ranges of 64 and of
 * `second`; `part` of the narrower one is allowed. */
static int model_with_residual(real part, real second) {
	static const real away[N] = {(real)0.25, 0};
	prepare();
	r.offline[0] = 1; /* x = x + u, for the first state */
	const real theta[N * (N + M)] = {1, 0, 1, 0, 0, 0, 0, 1};
	teach(theta);
	r.low[0] = -32;
	r.high[0] = 32;
	r.low[1] = 0;
	r.high[1] = second;
	start_controller(1, 0.25);
	const KOOP(supervisor_config) config = {.max_residual = part};
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&r.supervisor, &config, &r.mpc, r.offline, r.storage,
	                                            SUPERVISOR_REALS));
	r.supervisor.wait = 0;
	return model_at(away);
}

static void test_residual_may_be_as_large_as_set(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_residual(1, 64));
	const real residual = r.result.residual;
	TEST_ASSERT_TRUE(residual > 0 && residual <= (real)0.25 && r.result.iterations == 0);
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_residual(residual / 64, 64));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_residual(below(residual / 64), 64));
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_residual(residual / 64, 128));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_residual(residual / 64, below(64)));
}

/* 200 times what the solver can tell, here the tolerance of 0.25. */
static void test_range_that_the_solver_hardly_sees_is_none(void) {
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_residual(1, 64));
	const real part = r.result.residual / 64;
	TEST_ASSERT_EQUAL_INT(ONLINE, model_with_residual(part, 50));
	TEST_ASSERT_EQUAL_INT(OFFLINE, model_with_residual(part, above(50)));
}

/* ---- what is refused */

static void test_each_setting_is_checked(void) {
	static const double bad[] = {(double)NAN, (double)INFINITY, -1};
	start(1, 0, NULL);
	const KOOP(supervisor) before = r.supervisor;
	for (size_t i = 0; i < 6; i++) {
		for (size_t k = 0; k < sizeof bad / sizeof *bad; k++) {
			KOOP(supervisor_config) config = {0};
			real *const values[] = {&config.min_cosine,   &config.min_gain,
			                        &config.max_gain,     &config.max_error_ratio,
			                        &config.max_residual, &config.max_tracking_ratio};
			*values[i] = (real)bad[k];
			CHECK_STATUS(KOOP_E_RANGE, KOOP(supervisor_init)(&r.supervisor, &config, &r.mpc, r.offline,
			                                                 r.storage, SUPERVISOR_REALS));
			TEST_ASSERT_EQUAL_MEMORY(&before, &r.supervisor, sizeof before);
		}
	}
}

static void test_each_setting_is_taken(void) {
	static const KOOP(supervisor_config) mine = {(real)0.5, (real)0.25, 7, 11, (real)0.125, 13, 17, 19, NULL};
	start(1, 0, &mine);
	TEST_ASSERT_EQUAL_MEMORY(&mine, &r.supervisor.config, sizeof mine);
}

/* A controller that was refused itself, and storage that is too small by one. */
static void test_supervisor_that_is_refused_is_left_alone(void) {
	const size_t reals = KOOP_SUPERVISOR_REALS(N, N, M, 1);
	start(1, 0, NULL);
	const robot before = r;
	CHECK_STATUS(KOOP_E_STORAGE,
	             KOOP(supervisor_init)(&r.supervisor, NULL, &r.mpc, r.offline, r.storage, reals - 1));
	r.mpc.plan = NULL;
	CHECK_STATUS(KOOP_E_NULL,
	             KOOP(supervisor_init)(&r.supervisor, NULL, &r.mpc, r.offline, r.storage, reals));
	TEST_ASSERT_EQUAL_MEMORY(&before.supervisor, &r.supervisor, sizeof r.supervisor);
	TEST_ASSERT_EQUAL_MEMORY(before.storage, r.storage, sizeof r.storage);
}

/* Neither the supervisor nor the health is touched by a gate of a learner of another size, or of none. */
static void test_gate_that_does_not_fit_changes_nothing(void) {
	static KOOP(gate) gate;
	static estimator other;
	enum { REALS = KOOP_GATE_REALS_PLAIN(3, 1) };
	static real gate_storage[REALS];
	const real x[N] = {1, 2}, u[M] = {1, 1};
	KOOP(health) health = {.innovation = 77, .trace = 78, .frozen = 79}, kept = health;
	start(1, 0, &(KOOP(supervisor_config)){.gate = &gate});
	estimator_default(&other, 3, 1, &KOOP(reg_ef), &KOOP(form_plain));
	CHECK_STATUS(KOOP_OK, KOOP(gate_init)(&gate, NULL, &other.rls, gate_storage, REALS));
	const KOOP(supervisor) before = r.supervisor;
	CHECK_STATUS(KOOP_E_SIZE, KOOP(supervisor_update)(&r.supervisor, &r.learner.rls, x, u, x, &health));
	memset(&gate, 0, sizeof gate);
	CHECK_STATUS(KOOP_E_NULL, KOOP(supervisor_update)(&r.supervisor, &r.learner.rls, x, u, x, &health));
	TEST_ASSERT_EQUAL_MEMORY(&before, &r.supervisor, sizeof before);
	TEST_ASSERT_EQUAL_MEMORY(&kept, &health, sizeof kept);
}

/* ---- in a memory whose bits may flip */

/* More than one bit of Theta: that counts as a sample that cannot be learned, until the learner is started
 * again. */
static void test_learner_beyond_mending_is_started_again(void) {
	const real x[N] = {1, 2}, u[M] = {1, 1};
	prepare();
	r.learner.config.checksum = 1;
	estimator_start(&r.learner);
	start_controller(1, 0);
	const KOOP(supervisor_config) config = {.patience = 3};
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_init)(&r.supervisor, &config, &r.mpc, r.offline, r.storage,
	                                            SUPERVISOR_REALS));
	r.learner.rls.theta[0] += 1;
	r.learner.rls.theta[PADDED] += 3;
	for (size_t k = 1; k <= 3; k++) {
		TEST_ASSERT_EQUAL_size_t(0, r.supervisor.resets);
		CHECK_STATUS(KOOP_E_MEMORY, KOOP(supervisor_update)(&r.supervisor, &r.learner.rls, x, u, x, NULL));
	}
	TEST_ASSERT_EQUAL_size_t(1, r.supervisor.resets);
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_update)(&r.supervisor, &r.learner.rls, x, u, x, NULL));
}

/* The plan is forgotten, as after all that leaves none: the next solve starts from the safe input. */
static void test_models_beyond_mending_leave_no_plan(void) {
	static const real away[N] = {(real)0.5, (real)0.25}, reference[MOST_H * N] = {1, 1, 1, 1};
	real u[M], plan[MOST_H * M];
	start(2, 0, NULL);
	CHECK_STATUS(KOOP_OK, KOOP(supervisor_control)(&r.supervisor, &r.learner.rls, &r.mpc, away, reference,
	                                               NULL, u, &r.result));
	TEST_ASSERT_TRUE(u[0] > 0);
	r.supervisor.offline[0] += 1;
	r.supervisor.offline[1] += 3;
	CHECK_STATUS(KOOP_E_MEMORY, KOOP(supervisor_control)(&r.supervisor, &r.learner.rls, &r.mpc, away,
	                                                     reference, NULL, u, &r.result));
	CHECK_STATUS(KOOP_OK, KOOP(mpc_plan)(&r.mpc, plan));
	for (size_t q = 0; q < (size_t)MOST_H * M; q++) { TEST_ASSERT_TRUE(plan[q] >= 0 && plan[q] <= 0); }
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_gain_may_be_as_small_and_as_large_as_set);
	RUN_TEST(test_response_of_all_states_may_be_as_large_as_set);
	RUN_TEST(test_direction_may_be_as_far_off_as_set);
	RUN_TEST(test_offline_model_may_answer_as_strongly_as_numbers_allow);
	RUN_TEST(test_error_may_be_as_large_as_set);
	RUN_TEST(test_robot_may_be_as_far_off_as_set);
	RUN_TEST(test_last_good_model_goes_before_an_offline_model_as_good);
	RUN_TEST(test_residual_may_be_as_large_as_set);
	RUN_TEST(test_range_that_the_solver_hardly_sees_is_none);
	RUN_TEST(test_each_setting_is_checked);
	RUN_TEST(test_each_setting_is_taken);
	RUN_TEST(test_supervisor_that_is_refused_is_left_alone);
	RUN_TEST(test_gate_that_does_not_fit_changes_nothing);
	RUN_TEST(test_learner_beyond_mending_is_started_again);
	RUN_TEST(test_models_beyond_mending_leave_no_plan);
	return UNITY_END();
}
