/* The ground, or the water, moves: a constant velocity in the world's axes. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 2; i++) { signal->drift[i] += p[i]; }
}

const tk_effect world_drift = {
    .name = "world_drift",
    .formula = "velocity -> velocity + (wx, wy), in the axes of the world",
    .block = TK_PLANT,
    .n_parameters = 2,
    .parameters = {{"wx", "m/s", -2, 2, 0.03}, {"wy", "m/s", -2, 2, -0.02}},
    .apply = apply,
};
