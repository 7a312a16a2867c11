/* The rear left rotor gives the share a more thrust, and drags as much more, than it is asked for. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->thrust[2] *= 1 + p[0];
}

const tk_effect quadrotor_rotor3_thrust = {
    .name = "rotor3_thrust",
    .formula = "thrust and torque of rotor 3 -> (1 + a)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.6, 0.3, -0.1}},
    .apply = apply,
};
