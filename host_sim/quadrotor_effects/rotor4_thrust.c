/* The front left rotor gives the share a more thrust, and drags as much more, than it is asked for. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->thrust[3] *= 1 + p[0];
}

const tk_effect quadrotor_rotor4_thrust = {
    .name = "rotor4_thrust",
    .formula = "thrust and torque of rotor 4 -> (1 + a)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"a", "1", -0.6, 0.3, -0.1}},
    .apply = apply,
};
