/* Speed and yaw rate follow their commands as first-order systems of time constant tau.
 *
 * What drives the robot during a step is the mean over the step, exact for a
 * command that is held: as tau goes to zero it goes to the command itself. The
 * lag sets in settled on the first command. */
#include <math.h>

#include "effects.h"

enum { BEGUN, STATE, STEPS, GONE }; /* steps per tau, and the share of the way gone in one of them */

void lag_command(double tau, double *memory, double dt, double *command) {
	if (!(tau > 0)) { return; }
	const double steps = dt / tau;
	if (memory[STEPS] != steps) { /* seldom: an exponential costs more than all else here */
		memory[STEPS] = steps;
		memory[GONE] = -expm1(-steps);
	}
	if (!memory[BEGUN]) { memory[STATE] = *command; }
	const double behind = memory[STATE] - *command, gone = memory[GONE];
	*command += behind * gone / steps;
	memory[STATE] -= behind * gone;
	memory[BEGUN] = 1;
}

void lag_commands(const double *p, double *memory, tk_signal *signal) {
	for (size_t i = 0; i < 2; i++) {
		lag_command(p[0], memory + AXIS_LAG_MEMORY * i, signal->dt, &signal->command[i]);
	}
}

const tk_effect actuator_lag = {
    .name = "actuator_lag",
    .formula = "tau x' = command - x, for x = v and x = omega",
    .family = "lag",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"tau", "s", 0, 3, 0.3}},
    .n_memory = LAG_MEMORY,
    .apply = lag_commands,
};
