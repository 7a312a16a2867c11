/* The robot drives faster than commanded by the share a: wheels larger than thought. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[0] *= 1 + p[0];
}

const tk_effect speed_gain = {
    .name = "speed_gain",
    .formula = "v -> v (1 + a)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.9, 1, -0.08}},
    .apply = apply,
};
