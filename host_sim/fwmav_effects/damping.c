/* The air holds the wings back more than thought, by the share a: all damping, of motion and of turning. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->damping *= 1 + p[0];
}

const tk_effect fwmav_damping = {
    .name = "damping",
    .formula = "damping -> damping (1 + a), of all axes",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.9, 2, 0.3}},
    .apply = apply,
};
