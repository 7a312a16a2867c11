/* The wing beat shakes the body more than usual, by the share a; -1 is a body that does not shake. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->vibration *= 1 + p[0];
}

const tk_effect fwmav_vibration = {
    .name = "vibration",
    .formula = "vibration of the sensors -> vibration (1 + a)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -1, 2, 0.5}},
    .apply = apply,
};
