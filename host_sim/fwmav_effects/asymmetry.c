/* Unequal wings: the left one gives the share c more thrust, the right one as much less. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->thrust[0] *= 1 + p[0];
	in_flight(signal)->thrust[1] *= 1 - p[0];
}

const tk_effect fwmav_asymmetry = {
    .name = "asymmetry",
    .formula = "thrust -> thrust (1 + c) of the left wing, (1 - c) of the right",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"c", "1", -0.2, 0.2, 0.05}},
    .apply = apply,
};
