/* Commands smaller than the dead zone do nothing, and larger ones lose the dead zone: no jump at its edge. */
#include <math.h>

#include "effects.h"

double shrunk(double value, double dead) {
	return copysign(fmax(fabs(value) - dead, 0), value);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 2; i++) { signal->command[i] = shrunk(signal->command[i], p[i]); }
}

const tk_effect dead_zone_shifted = {
    .name = "dead_zone_shifted",
    .formula = "v -> sign(v) max(|v| - v_db, 0), omega -> sign(omega) max(|omega| - w_db, 0)",
    .family = "dead_band",
    .reported_as = "dead_band",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"v_db", "m/s", 0, 3, 0.1}, {"w_db", "rad/s", 0, 3, 0.08}},
    .apply = apply,
};
