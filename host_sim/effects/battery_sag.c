/* The speed falls linearly with time, by the share loss_at_end when the drive (or the effect) ends. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[0] *= 1 - p[0] * signal->passed;
}

const tk_effect battery_sag = {
    .name = "battery_sag",
    .formula = "v -> v (1 - loss_at_end t / t_end)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"loss_at_end", "1", 0, 0.9, 0.15}},
    .needs_end = 1,
    .apply = apply,
};
