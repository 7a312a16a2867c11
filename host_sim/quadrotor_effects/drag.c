/* The air holds the vehicle back more than thought, by k for each metre per second. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->drag += p[0];
}

const tk_effect quadrotor_drag = {
    .name = "drag",
    .formula = "acceleration -> acceleration - k times the velocity through the air",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"k", "1/s", -0.2, 2, 0.3}},
    .apply = apply,
};
