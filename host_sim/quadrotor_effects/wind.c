/* Wind of (wx, wy) in the world's axes. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->wind[0] += p[0];
	in_quadrotor(signal)->wind[1] += p[1];
}

const tk_effect quadrotor_wind = {
    .name = "wind",
    .formula = "wind (wx, wy) in the axes of the world",
    .block = TK_PLANT,
    .n_parameters = 2,
    .parameters =
        {
            {"wx", "m/s", -5, 5, 1},
            {"wy", "m/s", -5, 5, 0.5},
        },
    .apply = apply,
};
