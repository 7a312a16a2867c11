/* Closed loops of robot.h. Prints "run <name>" and then a line a step: the pose and the
 * input that led to it, in hexadecimal, so that a target's run can be compared with the
 * host's bit by bit. */
#include "robot.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static agent a;
static float path[PATH * STATES];
static float psi[N_MAX], psi_next[N_MAX];

static void print_step(const float x[STATES], const float u[INPUTS]) {
	printf("%a %a %a %a %a\n", (double)x[0], (double)x[1], (double)x[2], (double)u[0], (double)u[1]);
}

static void must(int status) {
	if (status != KOOP_OK) {
		printf("%s\n", koopf_status_message(status));
		exit(1);
	}
}

/* One step of the plant under u from psi, learned from; x and psi are then the next ones. */
static void step(double pose[STATES], const float u[INPUTS], size_t k, float x[STATES]) {
	robot_step(pose, u, k);
	robot_measure(pose, x);
	must(koopf_lift(a.config.dictionary, x, psi_next));
	must(koopf_rls_update(&a.rls, psi, u, psi_next, NULL));
	memcpy(psi, psi_next, sizeof psi);
}

static void run(const koopf_dictionary *dictionary, const koopf_regulator *regulator,
                const koopf_form *form) {
	double pose[STATES] = {0, 0, 0};
	float x[STATES], u[INPUTS];
	printf("run %s %s %s\n", dictionary->name, regulator->name, form->name);
	must(agent_start(&a, dictionary, regulator, form, KOOP_CHECK_REFUSE, 0));
	robot_measure(pose, x);
	must(koopf_lift(dictionary, x, psi));
	for (size_t k = 0; k < LEARN; k++) {
		robot_command(k, u);
		step(pose, u, k, x);
	}

	robot_path(pose, path);
	robot_measure(pose, x);
	must(koopf_lift(dictionary, x, psi));
	for (size_t k = 0; k < CONTROL; k++) {
		must(koopf_mpc_solve(&a.mpc, a.rls.theta, psi, path + k * STATES, NULL, u, NULL));
		step(pose, u, LEARN + k, x);
		print_step(x, u);
	}
}

int main(void) {
	run(&koopf_poly_ddr, &koopf_reg_ct, &koopf_form_plain);
	run(&koopf_rbf_ddr, &koopf_reg_ef, &koopf_form_sqrt);
	run(&koopf_rbf_ddr, &koopf_reg_dz_cs, &koopf_form_sqrt);
	return 0;
}
