/* Wind of (wx, wy) in the world's axes, from one moment to the next. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->wind[0] += p[0];
	in_flight(signal)->wind[1] += p[1];
}

const tk_effect fwmav_gust = {
    .name = "gust",
    .formula = "wind (wx, wy) in the axes of the world",
    .block = TK_PLANT,
    .n_parameters = 2,
    .parameters =
        {
            {"wx", "m/s", -2, 2, 0.4},
            {"wy", "m/s", -2, 2, 0.2},
        },
    .apply = apply,
};
