/* The controller task: learns at 100 Hz how the vehicle follows its position setpoint, and
 * moves that setpoint as planned. The stock controller flies at all times; while anything
 * is amiss it is given the setpoint as it came. */
#include "controller.h"
#include "controller_pid.h"
#include "handover.h"
#include "log.h"
#include "param.h"
#include "static_mem.h"
#include "supervisor.h"

#include <math.h>
#include <string.h>

enum {
	WARM_UP = 500, /* samples before a plan is flown: 5 s */
	RETURN = 100,  /* ticks without a fault before a plan is flown (again): 1 s */
	PATIENCE = 10  /* refused samples in a row after which the covariance is started again */
};
#define P0 100.0f
#define STEP_SECONDS ((float)HOLD / RATE_100_HZ)
#define FADE 0.01f    /* the errors' means reach back 100 samples */
#define LARGEST 30.0f /* of any state: m, m/s */
#define FARTHEST 0.1f /* that the vehicle can go in a tick (m) */

/* Whether the plan is flown, or why the setpoint goes on as it came. */
enum {
	DISABLED = 0,
	PLANNED = 1,
	NOT_FOLLOWING = 2, /* on the ground, or the setpoint is not a position */
	BAD_STATE = 3,     /* the state estimate or the setpoint is NaN or beyond belief */
	WARMING_UP = 4,
	LEARNER_REFUSED = 5,
	MODEL_POOR = 6, /* predicts worse than "it continues as it moves" */
	PLAN_LATE = 7,
	PLAN_REFUSED = 8,
	RETURNING = 9 /* all is well, but not for long enough */
};

NO_DMA_CCM_SAFE_ZERO_INIT static float storage[KOOP_RLS_REALS_SQRT(N_LIFTED, N_INPUTS)];
NO_DMA_CCM_SAFE_ZERO_INIT static struct {
	koopf_rls rls;
	koopf_health health;
	int8_t status; /* of the learner */
	uint8_t mode;
	uint32_t tick;    /* of 10 ms */
	uint32_t seen;    /* ticks in a row */
	uint32_t well;    /* ticks in a row without a fault */
	uint32_t refused; /* samples in a row */
	float home[N_TRACKED];
	float past[HOLD][N_LIFTED]; /* psi and pull of the last ticks */
	float pulls[HOLD][N_INPUTS];
	float pull[N_INPUTS];      /* of this tick */
	float error, simple_error; /* mean squares: of the model, and of going on as it moves */
	uint32_t samples, skipped; /* learned from; seen, but the regulator left the covariance alone */
	uint16_t refusals, fallbacks, resets;
} learner;
NO_DMA_CCM_SAFE_ZERO_INIT static problem question;
NO_DMA_CCM_SAFE_ZERO_INIT static plan newest;
NO_DMA_CCM_SAFE_ZERO_INIT static setpoint_t moved;

STATIC_MEM_QUEUE_ALLOC(problems, 1, sizeof(problem));
STATIC_MEM_QUEUE_ALLOC(plans, 1, sizeof(plan));
xQueueHandle problems, plans;

/* Parameters: not in CCM, since they do not start as zeros. */
static uint8_t enable = 0;
static uint8_t reset = 0;
static float lambda = 0.99f; /* read when the learner is started; about 1 s of memory */

/* ---- The model ------------------------------------------------------------------ */

static void lift(const koopf_dictionary *self, const float *x, float *psi) {
	const float speed = sqrtf(x[2] * x[2] + x[3] * x[3]);
	(void)self;
	for (int i = 0; i < N_STATES; i++) { psi[i] = x[i]; }
	psi[6] = x[2] * speed;
	psi[7] = x[3] * speed;
	psi[8] = 1;
}

static const koopf_dictionary dictionary = {
    .name = "flight", .n_states = N_STATES, .n_lifted = N_LIFTED, .lift = lift};

/* Forgets everything. */
static void start(void) {
	const koopf_config config = {.dictionary = &dictionary,
	                             .n_inputs = N_INPUTS,
	                             .regulator = &koopf_reg_sift,
	                             .form = &koopf_form_sqrt,
	                             .lambda = lambda,
	                             .p0 = P0};
	memset(&learner, 0, sizeof learner);
	learner.status = (int8_t)koopf_rls_init(&learner.rls, &config, storage, sizeof storage / sizeof *storage);
}

/* psi, or a refusal: the learner believes every number, so outliers must not reach it. */
static int measure(const state_t *state, float *psi) {
	const quaternion_t *q = &state->attitudeQuaternion;
	const float x[N_STATES] = {state->position.x - learner.home[0],
	                           state->position.y - learner.home[1],
	                           state->velocity.x,
	                           state->velocity.y,
	                           2 * (q->x * q->z + q->w * q->y),
	                           2 * (q->y * q->z - q->w * q->x)};
	for (int i = 0; i < N_STATES; i++) {
		if (!(fabsf(x[i]) < LARGEST)) { return KOOP_E_RANGE; }
	}
	const float *last = learner.past[(learner.seen + HOLD - 1) % HOLD];
	for (int i = 0; i < N_TRACKED && learner.seen > 0; i++) {
		if (fabsf(x[i] - last[i]) > FARTHEST) { return KOOP_E_RANGE; }
	}
	return koopf_lift(&dictionary, x, psi);
}

/* ---- Learning --------------------------------------------------------------------- */

/* Mean squares of what the model and what "it continues as it moves" got wrong. */
static void judge(const float *before, const float *now) {
	float square = 0;
	for (int i = 0; i < N_LIFTED; i++) {
		const float drift = i < N_TRACKED ? STEP_SECONDS * before[N_TRACKED + i] : 0;
		const float error = now[i] - before[i] - drift;
		square += error * error;
	}
	learner.simple_error += FADE * (square - learner.simple_error);
	learner.error += FADE * (learner.health.innovation * learner.health.innovation - learner.error);
}

/* A sample at every tick, each over the step that ends now: the steps overlap. */
static void learn(const float *psi) {
	const float *before = learner.past[learner.seen % HOLD];
	float pull[N_INPUTS] = {0, 0};
	if (learner.seen < HOLD) { return; }
	for (int k = 0; k < HOLD; k++) {
		for (int j = 0; j < N_INPUTS; j++) { pull[j] += learner.pulls[k][j] / HOLD; }
	}
	learner.status = (int8_t)koopf_rls_update(&learner.rls, before, pull, psi, &learner.health);
	if (learner.status == KOOP_OK) {
		judge(before, psi);
		learner.samples++;
		learner.skipped += (uint32_t)learner.health.frozen;
		learner.refused = 0;
	} else {
		learner.refusals++;
		if (++learner.refused == PATIENCE) {
			koopf_rls_reset_covariance(&learner.rls, P0);
			learner.refused = 0;
			learner.resets++;
		}
	}
}

/* ---- Flying ------------------------------------------------------------------------- */

/* A position setpoint is followed in the air. */
static int following(const setpoint_t *setpoint) {
	return setpoint->mode.x == modeAbs && setpoint->mode.y == modeAbs && supervisorIsFlying();
}

static void ask(const setpoint_t *setpoint, const float *psi) {
	question.tick = learner.tick;
	memcpy(question.theta, learner.rls.theta, sizeof question.theta);
	memcpy(question.psi, psi, sizeof question.psi);
	memcpy(question.pull, learner.pull, sizeof question.pull);
	question.target[0] = setpoint->position.x - learner.home[0];
	question.target[1] = setpoint->position.y - learner.home[1];
	question.target_velocity[0] = setpoint->velocity.x;
	question.target_velocity[1] = setpoint->velocity.y;
	xQueueOverwrite(problems, &question);
}

/* Steps since the newest plan was asked for. */
static uint32_t plan_age(void) {
	return (learner.tick - newest.tick) / HOLD;
}

/* PLANNED, or what speaks against it. */
static uint8_t judge_plan(void) {
	if (learner.samples < WARM_UP) { return WARMING_UP; }
	if (learner.status != KOOP_OK) { return LEARNER_REFUSED; }
	if (learner.error > learner.simple_error) { return MODEL_POOR; }
	if (plan_age() >= SENT) { return PLAN_LATE; }
	if (newest.status != KOOP_OK || !newest.plausible) { return PLAN_REFUSED; }
	return PLANNED;
}

static float clip(float v) {
	return fminf(fmaxf(v, -MOST_PULL), MOST_PULL);
}

/* From now on the stock controller flies, and the samples so far lead nowhere. */
static void leave(uint8_t mode) {
	learner.mode = mode;
	learner.seen = 0;
	learner.well = 0;
}

/* What pull to give, and why. */
static void choose(const setpoint_t *setpoint, const state_t *state) {
	learner.mode = judge_plan();
	learner.well = learner.mode == PLANNED ? learner.well + 1 : 0;
	if (learner.mode == PLANNED && learner.well < RETURN) { learner.mode = RETURNING; }
	if (!enable) { learner.mode = DISABLED; }
	if (learner.mode == PLANNED) {
		memcpy(learner.pull, newest.pull[plan_age()], sizeof learner.pull);
	} else {
		learner.pull[0] = clip(setpoint->position.x - state->position.x);
		learner.pull[1] = clip(setpoint->position.y - state->position.y);
	}
}

static void tick(const setpoint_t *setpoint, const state_t *state) {
	float psi[N_LIFTED];
	learner.tick++;
	if (reset) {
		const uint32_t now = learner.tick;
		start();
		learner.tick = now;
		reset = 0;
	}
	if (!learner.rls.theta) { /* it did not start: lambda is out of its range */
		leave(LEARNER_REFUSED);
		return;
	}
	if (!following(setpoint)) {
		leave(NOT_FOLLOWING);
		return;
	}
	if (learner.samples == 0 && learner.seen == 0) {
		learner.home[0] = state->position.x;
		learner.home[1] = state->position.y;
	}
	const float target =
	    setpoint->position.x + setpoint->position.y + setpoint->velocity.x + setpoint->velocity.y;
	if (measure(state, psi) != KOOP_OK || !isfinite(target)) {
		leave(BAD_STATE);
		return;
	}
	learn(psi);
	xQueueReceive(plans, &newest, 0);
	choose(setpoint, state);
	if (learner.tick % HOLD == 0) { ask(setpoint, psi); }
	const uint32_t slot = learner.seen++ % HOLD;
	memcpy(learner.past[slot], psi, sizeof psi);
	memcpy(learner.pulls[slot], learner.pull, sizeof learner.pull);
}

/* ---- What the firmware calls ----------------------------------------------------------- */

void controllerOutOfTreeInit(void) {
	controllerPidInit();
	if (!problems) {
		problems = STATIC_MEM_QUEUE_CREATE(problems);
		plans = STATIC_MEM_QUEUE_CREATE(plans);
	}
	start();
}

bool controllerOutOfTreeTest(void) {
	return problems && plans && controllerPidTest();
}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const uint32_t step) {
	if (RATE_DO_EXECUTE(RATE_100_HZ, step)) {
		const uint8_t before = learner.mode;
		tick(setpoint, state);
		learner.fallbacks += before == PLANNED && learner.mode != PLANNED;
		moved = *setpoint;
		moved.position.x = state->position.x + learner.pull[0];
		moved.position.y = state->position.y + learner.pull[1];
	}
	controllerPid(control, learner.mode == PLANNED ? &moved : setpoint, sensors, state, step);
}

/* ---- Log and parameters ------------------------------------------------------------------ */

LOG_GROUP_START(koopman)
LOG_ADD(LOG_UINT8, mode, &learner.mode)
LOG_ADD(LOG_INT8, learn, &learner.status)
LOG_ADD(LOG_FLOAT, innov, &learner.health.innovation)
LOG_ADD(LOG_FLOAT, trace, &learner.health.trace)
LOG_ADD(LOG_FLOAT, error, &learner.error)
LOG_ADD(LOG_FLOAT, simple, &learner.simple_error)
LOG_ADD(LOG_UINT32, samples, &learner.samples)
LOG_ADD(LOG_UINT32, skipped, &learner.skipped)
LOG_ADD(LOG_UINT16, refusals, &learner.refusals)
LOG_ADD(LOG_UINT16, resets, &learner.resets)
LOG_ADD(LOG_UINT16, fallbacks, &learner.fallbacks)
LOG_ADD(LOG_INT8, plan, &newest.status)
LOG_ADD(LOG_UINT8, plausible, &newest.plausible)
LOG_ADD(LOG_UINT16, planUs, &newest.microseconds)
LOG_ADD(LOG_FLOAT, residual, &newest.residual)
LOG_ADD(LOG_FLOAT, pullX, &learner.pull[0])
LOG_ADD(LOG_FLOAT, pullY, &learner.pull[1])
LOG_GROUP_STOP(koopman)

PARAM_GROUP_START(koopman)
PARAM_ADD(PARAM_UINT8, enable, &enable)
PARAM_ADD(PARAM_FLOAT, lambda, &lambda)
PARAM_ADD(PARAM_UINT8, reset, &reset)
PARAM_GROUP_STOP(koopman)
