/* Commands smaller than the dead band do nothing; larger ones act in full. */
#include <math.h>

#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 2; i++) {
		if (fabs(signal->command[i]) < p[i]) { signal->command[i] = 0; }
	}
}

const tk_effect dead_band = {
    .name = "dead_band",
    .formula = "v = 0 if |v| < v_db, omega = 0 if |omega| < w_db",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"v_db", "m/s", 0, 3, 0.1}, {"w_db", "rad/s", 0, 3, 0.08}},
    .apply = apply,
};
