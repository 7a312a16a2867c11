/* Instructions, stack and RAM of lift, update and solve, on the drive of robot.h.
 * Prints lines of
 *     instructions <N> <what> <detail> <median> <worst>
 *     ram <N> <bytes of the learner in square-root form> <bytes of the controller>
 *     stack <function> <bytes> */
#include "counter.h"
#include "mark.h"
#include "robot.h"
#include "stack.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SAMPLES 200 /* of each call: updates from the start, solves around the step where the slip begins */
#define SOLVES_FROM (LEARN + CONTROL / 2 - SAMPLES / 2)

/* What was seen of one function. */
typedef struct series {
	const char *function;
	uint32_t instructions[SAMPLES];
	size_t count;
	uint32_t stack; /* largest */
} series;

static series lifts = {.function = "koopf_lift"};
static series updates = {.function = "koopf_rls_update"};
static series gated_updates = {.function = "koopf_gate_update"};
static series solves = {.function = "koopf_mpc_solve"};

static void must(int status) {
	if (status != KOOP_OK) {
		printf("%s\n", koopf_status_message(status));
		exit(1);
	}
}

static void add(series *s, uint32_t instructions, uint32_t stack) {
	if (s->count < SAMPLES) { s->instructions[s->count++] = instructions; }
	if (stack > s->stack) { s->stack = stack; }
}

#define MEASURE(series, call)                                                                                \
	do {                                                                                                     \
		stack_paint();                                                                                       \
		counter_start();                                                                                     \
		MARK_BEGIN();                                                                                        \
		const int status_ = (call);                                                                          \
		MARK_END();                                                                                          \
		const uint32_t instructions_ = counter_stop();                                                       \
		add(series, instructions_, stack_used());                                                            \
		must(status_);                                                                                       \
	} while (0)

static int ascending(const void *a, const void *b) {
	const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
	return x < y ? -1 : x > y;
}

static void report(series *s, size_t N, const char *what, const char *detail) {
	qsort(s->instructions, s->count, sizeof *s->instructions, ascending);
	printf("instructions %u %s %s %lu %lu\n", (unsigned)N, what, detail,
	       (unsigned long)s->instructions[s->count / 2], (unsigned long)s->instructions[s->count - 1]);
	s->count = 0;
}

static agent a;
static float path[PATH * STATES];
static float psi[N_MAX], psi_next[N_MAX];

static koopf_gate gate;
static float gate_storage[KOOP_GATE_REALS_SQRT(N_MAX, INPUTS) + KOOP_EXTENSION_REALS_SQRT(N_MAX, INPUTS)];

/* A sample that the gate refuses is no failure. */
static int unless_outlier(int status) {
	return status == KOOP_E_OUTLIER ? KOOP_OK : status;
}

/* What a drive measures: one function, so that all calls between two reports are of it. */
enum { NOTHING, LIFTS, UPDATES, GATED_UPDATES };

static void lift(const float x[STATES], int measured) {
	if (measured == LIFTS) {
		MEASURE(&lifts, koopf_lift(a.config.dictionary, x, psi_next));
	} else {
		must(koopf_lift(a.config.dictionary, x, psi_next));
	}
}

static void learn(const float u[INPUTS], int measured) {
	koopf_health health;
	if (measured == UPDATES) {
		MEASURE(&updates, koopf_rls_update(&a.rls, psi, u, psi_next, &health));
	} else if (measured == GATED_UPDATES) {
		MEASURE(&gated_updates, unless_outlier(koopf_gate_update(&gate, &a.rls, psi, u, psi_next, &health)));
	} else {
		must(koopf_rls_update(&a.rls, psi, u, psi_next, &health));
	}
}

/* The open-loop drive of so many steps with an update at each. */
static void drive(size_t steps, int measured) {
	double pose[STATES] = {0, 0, 0};
	float x[STATES], u[INPUTS];
	robot_measure(pose, x);
	must(koopf_lift(a.config.dictionary, x, psi));
	for (size_t k = 0; k < steps; k++) {
		robot_command(k, u);
		robot_step(pose, u, k);
		robot_measure(pose, x);
		lift(x, measured);
		learn(u, measured);
		memcpy(psi, psi_next, sizeof psi);
	}
}

static void measure_updates(const koopf_dictionary *dictionary) {
	static const struct {
		const char *name;
		const koopf_form *form;
		int check;
	} forms[] = {{"sqrt", &koopf_form_sqrt, KOOP_CHECK_REFUSE},
	             {"plain", &koopf_form_plain, KOOP_CHECK_REFUSE},
	             {"plain-diagonal", &koopf_form_plain, KOOP_CHECK_DIAGONAL}};
#define ENTER(name) &koopf_reg_##name,
	static const koopf_regulator *const regulators[] = {KOOP_REGULATORS(ENTER)};
	for (size_t f = 0; f < sizeof forms / sizeof *forms; f++) {
		for (size_t r = 0; r < sizeof regulators / sizeof *regulators; r++) {
			must(agent_start(&a, dictionary, regulators[r], forms[f].form, forms[f].check, 0));
			drive(SAMPLES, UPDATES);
			report(&updates, dictionary->n_lifted, regulators[r]->name, forms[f].name);
		}
	}
	for (size_t r = 0; r < sizeof regulators / sizeof *regulators; r++) {
		must(agent_start(&a, dictionary, regulators[r], &koopf_form_sqrt, KOOP_CHECK_REFUSE, 0));
		must(koopf_gate_init(&gate, NULL, &a.rls, gate_storage, sizeof gate_storage / sizeof *gate_storage));
		drive(SAMPLES, GATED_UPDATES);
		report(&gated_updates, dictionary->n_lifted, regulators[r]->name, "gate");
	}
	for (size_t r = 0; r < sizeof regulators / sizeof *regulators; r++) {
		must(agent_start(&a, dictionary, regulators[r], &koopf_form_sqrt, KOOP_CHECK_REFUSE, 0));
		a.rls.config.checksum = 1;
		must(koopf_rls_reset_covariance(&a.rls, a.rls.config.p0)); /* makes the first checksum */
		drive(SAMPLES, UPDATES);
		report(&updates, dictionary->n_lifted, regulators[r]->name, "checksum");
	}
	must(agent_start(&a, dictionary, &koopf_reg_dz_cs, &koopf_form_sqrt, KOOP_CHECK_REFUSE, 0));
	drive(SAMPLES, LIFTS);
	report(&lifts, dictionary->n_lifted, "lift", "-");
}

#define LOST 0.1 /* m off the path at the end: the counts would be those of a robot that has lost it */

static void must_keep_path(const double pose[STATES], const float reference[STATES]) {
	const double distance = hypot(pose[0] - (double)reference[0], pose[1] - (double)reference[1]);
	if (distance > LOST) {
		printf("the closed loop ends %g m off its path\n", distance);
		exit(1);
	}
}

/* Warm: the closed loop, each solve starts from the last plan. Cold: none does.
 * Condense: none does, and any plan will do, so that what is left is condensing and
 * one look at the plan. */
enum { WARM, COLD, CONDENSE };

/* WARM records its inputs, the other two replay them: all three see the same models,
 * states and references. */
static void measure_solves(const koopf_dictionary *dictionary, int kind) {
	static const char *const names[] = {"warm", "cold", "condense"};
	static float inputs[SAMPLES][INPUTS];
	const float tolerance = kind == CONDENSE ? 1e30f : 0;
	double pose[STATES];
	float x[STATES], u[INPUTS];
	must(agent_start(&a, dictionary, &koopf_reg_dz_cs, &koopf_form_sqrt, KOOP_CHECK_REFUSE, tolerance));
	drive(LEARN, NOTHING);
	robot_path(pose, path);
	robot_measure(pose, x);
	must(koopf_lift(dictionary, x, psi));
	for (size_t k = 0; k < SAMPLES; k++) {
		const float *reference = path + k * STATES;
		if (kind != WARM) { must(koopf_mpc_reset(&a.mpc)); }
		MEASURE(&solves, koopf_mpc_solve(&a.mpc, a.rls.theta, psi, reference, NULL, u, NULL));
		memcpy(kind == WARM ? inputs[k] : u, kind == WARM ? u : inputs[k], sizeof u);
		robot_step(pose, u, SOLVES_FROM + k);
		robot_measure(pose, x);
		must(koopf_lift(dictionary, x, psi_next));
		must(koopf_rls_update(&a.rls, psi, u, psi_next, NULL));
		memcpy(psi, psi_next, sizeof psi);
	}
	must_keep_path(pose, path + (SAMPLES - 1) * STATES);
	report(&solves, dictionary->n_lifted, "mpc", names[kind]);
}

int main(void) {
	static const koopf_dictionary *const dictionaries[] = {&koopf_poly_ddr, &koopf_rbf_ddr};
	static const series *const all[] = {&lifts, &updates, &gated_updates, &solves};
	counter_open();
	for (size_t i = 0; i < sizeof dictionaries / sizeof *dictionaries; i++) {
		measure_updates(dictionaries[i]);
		for (int kind = WARM; kind <= CONDENSE; kind++) { measure_solves(dictionaries[i], kind); }
		const size_t N = dictionaries[i]->n_lifted;
		const size_t learner = sizeof(koopf_rls) + sizeof(float) * KOOP_RLS_REALS_SQRT(N, INPUTS);
		const size_t controller =
		    sizeof(koopf_mpc) + sizeof(float) * KOOP_MPC_REALS_NEWTON(N, STATES, INPUTS, HORIZON);
		printf("ram %u %u %u\n", (unsigned)N, (unsigned)learner, (unsigned)controller);
	}
	for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
		printf("stack %s %lu\n", all[i]->function, (unsigned long)all[i]->stack);
	}
	return 0;
}
