/* The thrust falls linearly with time, beyond what the logged voltage tells: by the share loss_at_end when
 * the flight (or the effect) ends. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < ROTORS; i++) { in_quadrotor(signal)->thrust[i] *= 1 - p[0] * signal->passed; }
}

const tk_effect quadrotor_battery_sag = {
    .name = "battery_sag",
    .formula = "thrust of all rotors -> thrust (1 - loss_at_end t / t_end)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"loss_at_end", "1", 0, 0.35, 0.1}},
    .needs_end = 1,
    .apply = apply,
};
