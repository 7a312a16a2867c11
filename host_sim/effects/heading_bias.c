/* The heading is measured too large by delta: a sensor mounted askew. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->pose[2] += p[0];
}

static void undo(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->pose[2] -= p[0];
}

const tk_effect heading_bias = {
    .name = "heading_bias",
    .formula = "heading measured = heading + delta",
    .block = TK_SENSOR,
    .n_parameters = 1,
    .parameters = {{"delta", "rad", -3.2, 3.2, 0.05}},
    .apply = apply,
    .undo = undo,
};
