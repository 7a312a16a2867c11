/* The speed follows its command as a first-order system of time constant tau; the yaw rate does not. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	lag_command(p[0], memory, signal->dt, &signal->command[0]);
}

const tk_effect speed_lag = {
    .name = "speed_lag",
    .formula = "tau x' = v - x, v -> x",
    .family = "lag",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"tau", "s", 0, 3, 0.3}},
    .n_memory = AXIS_LAG_MEMORY,
    .apply = apply,
};
