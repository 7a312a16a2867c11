/* The clock of the log is slow: a step of dt in the log lasts (1 + kappa) dt.
 *
 * Last in its block, so that lag and delay count in the log's time and nothing
 * but the way covered changes. Without effects of the plant it then cannot be
 * told from equal gains on speed and yaw rate. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->dt *= 1 + p[0];
}

const tk_effect clock_scale = {
    .name = "clock_scale",
    .formula = "true time step = (1 + kappa) dt",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"kappa", "1", -0.5, 1, 0.03}},
    .apply = apply,
};
