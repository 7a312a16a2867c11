/* A weight hangs on a string from the body at (x, y) and swings. One at a time: the last one counts. */
#include "quadrotor.h"

#include <string.h>

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	if (p[0] > 0 && p[1] > 0) { memcpy(in_quadrotor(signal)->load, p, sizeof in_quadrotor(signal)->load); }
}

const tk_effect quadrotor_slung_load = {
    .name = "slung_load",
    .formula = "a point mass on a taut string from (x, y, 0) in body axes",
    .block = TK_PLANT,
    .n_parameters = 4,
    .parameters =
        {
            {"mass", "kg", 0, 0.01, 0.003},
            {"length", "m", 0, 2, 0.3},
            {"x", "m", -0.08, 0.08, -0.02},
            {"y", "m", -0.08, 0.08, 0.02},
        },
    .apply = apply,
};
