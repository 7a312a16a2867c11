/* The requests reach the rotors late by `delay`. */
#include "quadrotor.h"

static size_t history(const double *p, double dt) {
	return ROTORS * axis_delay_history(p[0], dt);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	const size_t each = axis_delay_history(p[0], signal->dt);
	double *asked = in_quadrotor(signal)->asked;
	for (size_t i = 0; i < ROTORS; i++) { delay_command(p[0], memory + each * i, signal->dt, &asked[i]); }
}

const tk_effect quadrotor_transport_delay = {
    .name = "transport_delay",
    .formula = "m(t) -> m(t - delay)",
    .family = "lag",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"delay", "s", 0, 0.06, 0.01}},
    .history = history,
    .apply = apply,
};
