/* A constant yaw rate on top of the commanded one. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[1] += p[0];
}

const tk_effect yaw_bias = {
    .name = "yaw_bias",
    .formula = "omega -> omega + d",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"d", "rad/s", -1, 1, 0.02}},
    .apply = apply,
};
