/* Speed and yaw rate follow their commands as first-order systems of time constant tau.
 *
 * What drives the robot during a step is the mean over the step, exact for a
 * command that is held: as tau goes to zero it goes to the command itself. The
 * lag sets in settled on the first command. */
#include <math.h>

#include "effects.h"

enum { BEGUN, STATE }; /* of each command */

void lag_commands(const double *p, double *memory, tk_signal *signal) {
	if (!(p[0] > 0)) { return; }
	const double steps = signal->dt / p[0], gone = -expm1(-steps); /* share of the way gone in a step */
	for (size_t i = 0; i < 2; i++) {
		double *state = memory + STATE + i;
		const double command = signal->command[i];
		if (!memory[BEGUN]) { *state = command; }
		const double behind = *state - command;
		signal->command[i] = command + behind * gone / steps;
		*state -= behind * gone;
	}
	memory[BEGUN] = 1;
}

const tk_effect actuator_lag = {
    .name = "actuator_lag",
    .formula = "tau x' = command - x, for x = v and x = omega",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"tau", "s", 0, 3, 0.3}},
    .n_memory = LAG_MEMORY,
    .apply = lag_commands,
};
