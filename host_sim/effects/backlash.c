/* Play in the yaw drive: the yaw rate follows its command only once the play is
 * taken up, so it comes late at every reversal. It sets in settled on the first command. */
#include <math.h>

#include "effects.h"

enum { BEGUN, YAW_RATE, N_MEMORY };

static void apply(const double *p, double *memory, tk_signal *signal) {
	const double command = signal->command[1];
	if (!memory[BEGUN]) { memory[YAW_RATE] = command; }
	memory[BEGUN] = 1;
	memory[YAW_RATE] = fmin(fmax(memory[YAW_RATE], command - p[0]), command + p[0]);
	signal->command[1] = memory[YAW_RATE];
}

const tk_effect backlash = {
    .name = "backlash",
    .formula = "yaw rate y follows omega only while |omega - y| > half_width",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"half_width", "rad/s", 0, 2, 0.08}},
    .n_memory = N_MEMORY,
    .apply = apply,
};
