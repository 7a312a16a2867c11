/* Speed and yaw rate go to their commands at a limited rate: a in speed, alpha in yaw rate; zero means no
 * limit.
 *
 * What drives the robot during a step is the mean over the step, exact for a
 * command that is held. The limit sets in settled on the first command. */
#include <math.h>

#include "effects.h"

enum { BEGUN, STATE, N_MEMORY = STATE + 2 }; /* of each command */

/* The mean over a step of what goes from *state to the command by `most` a step at the most. */
static double ramped(double *state, double command, double most) {
	const double begin = *state, left = command - begin;
	if (fabs(left) <= most) {
		*state = command;
		return left == 0 ? command : command - left * fabs(left) / (2 * most);
	}
	*state += copysign(most, left);
	return begin + copysign(most, left) / 2;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	for (size_t i = 0; i < 2; i++) {
		double *state = &memory[STATE + i], *command = &signal->command[i];
		if (!memory[BEGUN]) { *state = *command; }
		if (p[i] > 0) { *command = ramped(state, *command, p[i] * signal->dt); }
	}
	memory[BEGUN] = 1;
}

const tk_effect acceleration_limit = {
    .name = "acceleration_limit",
    .formula = "|v'| <= a, |omega'| <= alpha; 0: no limit",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"a", "m/s2", 0, 20, 0.8}, {"alpha", "rad/s2", 0, 50, 1}},
    .n_memory = N_MEMORY,
    .apply = apply,
};
