/* All rotors give the share a more thrust than they are asked for. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < ROTORS; i++) { in_quadrotor(signal)->thrust[i] *= 1 + p[0]; }
}

const tk_effect quadrotor_thrust_gain = {
    .name = "thrust_gain",
    .formula = "thrust of all rotors -> thrust (1 + a)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.35, 0.5, -0.08}},
    .apply = apply,
};
