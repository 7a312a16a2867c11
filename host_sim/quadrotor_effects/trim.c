/* A constant moment turns the body: a tilted arm or rotor. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 3; i++) { in_quadrotor(signal)->moment[i] += p[i]; }
}

const tk_effect quadrotor_trim = {
    .name = "trim",
    .formula = "moment -> moment + (roll, pitch, yaw) in body axes",
    .block = TK_PLANT,
    .n_parameters = 3,
    .parameters =
        {
            {"roll", "N m", -2e-3, 2e-3, 4e-4},
            {"pitch", "N m", -2e-3, 2e-3, -3e-4},
            {"yaw", "N m", -3e-4, 3e-4, 5e-5},
        },
    .apply = apply,
};
