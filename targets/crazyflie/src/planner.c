/* The application task: plans on the model as the controller task hands it over. */
#include "app.h"
#include "handover.h"
#include "stabilizer_types.h"
#include "static_mem.h"
#include "task.h"
#include "usec_time.h"

#include <math.h>

static const float Q[N_TRACKED * N_TRACKED] = {1, 0, 0, 1};
static const float R[N_INPUTS * N_INPUTS] = {0.002f, 0, 0, 0.002f};
static const float S[N_INPUTS * N_INPUTS] = {0.02f, 0, 0, 0.02f};
static const float least[N_INPUTS] = {-MOST_PULL, -MOST_PULL}, most[N_INPUTS] = {MOST_PULL, MOST_PULL};
static const float none[N_INPUTS] = {0, 0};

/* A pull of 1 m for one step, 1 s later: the stock controller makes it about 0.1 m. */
#define LEAST_RESPONSE 0.01f

/* CCM: fast, and not needed for DMA. It starts as zeros; an initial value would be lost. */
#define MPC_REALS                                                                                            \
	(KOOP_MPC_REALS_NEWTON(N_LIFTED, N_TRACKED, N_INPUTS, HORIZON) + KOOP_MPC_REALS_RATE(N_INPUTS, HORIZON))
NO_DMA_CCM_SAFE_ZERO_INIT static float storage[MPC_REALS];
NO_DMA_CCM_SAFE_ZERO_INIT static float reference[HORIZON * N_TRACKED], inputs[HORIZON * N_INPUTS];
NO_DMA_CCM_SAFE_ZERO_INIT static koopf_mpc mpc;
NO_DMA_CCM_SAFE_ZERO_INIT static problem asked;
NO_DMA_CCM_SAFE_ZERO_INIT static plan answer;

static int start(void) {
	const koopf_mpc_config config = {.n_lifted = N_LIFTED,
	                                 .n_states = N_TRACKED,
	                                 .n_inputs = N_INPUTS,
	                                 .horizon = HORIZON,
	                                 .Q = Q,
	                                 .R = R,
	                                 .S = S,
	                                 .u_min = least,
	                                 .u_max = most,
	                                 .u_safe = none,
	                                 .tolerance = 1e-3f, /* 1 mm of pull */
	                                 .method = KOOP_MPC_NEWTON};
	return koopf_mpc_init(&mpc, &config, storage, MPC_REALS);
}

/* The setpoint goes on as it moves now. */
static void preview(void) {
	for (int k = 0; k < HORIZON; k++) {
		const float ahead = (float)((k + 1) * HOLD) / RATE_100_HZ;
		for (int i = 0; i < N_TRACKED; i++) {
			reference[k * N_TRACKED + i] = asked.target[i] + ahead * asked.target_velocity[i];
		}
	}
}

/* Whether each input moves its own axis forward, and more than it moves the other. */
static uint8_t plausible(void) {
	float G[N_TRACKED * N_INPUTS];
	if (koopf_mpc_sensitivity(&mpc, HORIZON - 1, G) != KOOP_OK) { return 0; }
	const float own = fminf(G[0], G[3]), other = fmaxf(fabsf(G[1]), fabsf(G[2]));
	return own > LEAST_RESPONSE && own > other;
}

static void solve(void) {
	const uint64_t begin = usecTimestamp();
	koopf_mpc_result result;
	float first[N_INPUTS];
	preview();
	answer.tick = asked.tick;
	answer.status =
	    (int8_t)koopf_mpc_solve(&mpc, asked.theta, asked.psi, reference, asked.pull, first, &result);
	answer.plausible = answer.status == KOOP_OK && plausible();
	answer.residual = result.residual;
	koopf_mpc_plan(&mpc, inputs);
	for (int k = 0; k < SENT; k++) {
		for (int j = 0; j < N_INPUTS; j++) { answer.pull[k][j] = inputs[k * N_INPUTS + j]; }
	}
	const uint64_t took = usecTimestamp() - begin;
	answer.microseconds = (uint16_t)(took < UINT16_MAX ? took : UINT16_MAX);
}

void appMain(void) {
	while (!plans) { vTaskDelay(M2T(100)); } /* the controller has not started */
	if (start() != KOOP_OK) { return; }      /* no plans: the stock controller flies */
	while (1) {
		if (xQueueReceive(problems, &asked, portMAX_DELAY) == pdTRUE) {
			solve();
			xQueueOverwrite(plans, &answer);
		}
	}
}
