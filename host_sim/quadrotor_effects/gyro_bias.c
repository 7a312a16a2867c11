/* The gyro reads (bx, by, bz) too much, on top of the usual bias of the flight. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 3; i++) { in_quadrotor(signal)->gyro[i] += p[i]; }
}

const tk_effect quadrotor_gyro_bias = {
    .name = "gyro_bias",
    .formula = "gyro -> gyro + (bx, by, bz)",
    .block = TK_SENSOR,
    .n_parameters = 3,
    .parameters =
        {
            {"bx", "rad/s", -0.2, 0.2, 0.04},
            {"by", "rad/s", -0.2, 0.2, 0.04},
            {"bz", "rad/s", -0.2, 0.2, 0.04},
        },
    .apply = apply,
};
