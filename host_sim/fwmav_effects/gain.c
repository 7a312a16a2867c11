/* The wings answer the command that the log holds more strongly than thought, by the share a. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[0] *= 1 + p[0];
}

const tk_effect fwmav_gain = {
    .name = "gain",
    .formula = "u -> u (1 + a)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.7, 1, -0.2}},
    .apply = apply,
};
