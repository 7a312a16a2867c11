/* Dry friction as a loss of constant size, whatever the speed: what is slower than that stands still. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->body[0] = shrunk(signal->body[0], p[0]);
	signal->body[2] = shrunk(signal->body[2], p[1]);
}

const tk_effect friction_coulomb = {
    .name = "friction_coulomb",
    .formula = "v -> sign(v) max(|v| - c_v, 0), omega -> sign(omega) max(|omega| - c_w, 0)",
    .family = "friction",
    .reported_as = "stribeck_friction",
    .block = TK_PLANT,
    .n_parameters = 2,
    .parameters = {{"c_v", "m/s", 0, 3, 0.08}, {"c_w", "rad/s", 0, 3, 0.05}},
    .apply = apply,
};
