/* The robot turns faster than commanded by the share b: a narrower track than thought, or skid steering. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[1] *= 1 + p[0];
}

const tk_effect yaw_gain = {
    .name = "yaw_gain",
    .formula = "omega -> omega (1 + b)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"b", "1", -0.9, 1, -0.12}},
    .apply = apply,
};
