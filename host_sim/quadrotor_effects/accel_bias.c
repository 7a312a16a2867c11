/* The accelerometer reads (bx, by, bz) too much, in body axes. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 3; i++) { in_quadrotor(signal)->accelerometer[i] += p[i]; }
}

const tk_effect quadrotor_accel_bias = {
    .name = "accel_bias",
    .formula = "accelerometer -> accelerometer + (bx, by, bz)",
    .block = TK_SENSOR,
    .n_parameters = 3,
    .parameters =
        {
            {"bx", "m/s^2", -2, 2, 0.4},
            {"by", "m/s^2", -2, 2, 0.3},
            {"bz", "m/s^2", -2, 2, 0.3},
        },
    .apply = apply,
};
