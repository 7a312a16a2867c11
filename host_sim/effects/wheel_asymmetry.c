/* Wheels of unequal size: driving straight turns the robot by c rad for every metre. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->command[1] += p[0] * signal->command[0];
}

const tk_effect wheel_asymmetry = {
    .name = "wheel_asymmetry",
    .formula = "omega -> omega + c v",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"c", "rad/m", -1, 1, 0.03}},
    .apply = apply,
};
