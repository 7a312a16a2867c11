/* The front right rotor gives the share a more thrust, and drags as much more, than it is asked for. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->thrust[0] *= 1 + p[0];
}

const tk_effect quadrotor_rotor1_thrust = {
    .name = "rotor1_thrust",
    .formula = "thrust and torque of rotor 1 -> (1 + a)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.6, 0.3, -0.1}},
    .apply = apply,
};
