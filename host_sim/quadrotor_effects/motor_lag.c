/* The requests reach the rotors through a further lag of first order, of time constant tau. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	double *asked = in_quadrotor(signal)->asked;
	for (size_t i = 0; i < ROTORS; i++) {
		lag_command(p[0], memory + AXIS_LAG_MEMORY * i, signal->dt, &asked[i]);
	}
}

const tk_effect quadrotor_motor_lag = {
    .name = "motor_lag",
    .formula = "tau x' = m - x, for all rotors, before their own lag",
    .family = "lag",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"tau", "s", 0, 0.1, 0.01}},
    .n_memory = AXIS_LAG_MEMORY * ROTORS,
    .apply = apply,
};
