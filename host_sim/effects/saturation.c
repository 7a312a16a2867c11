/* Speed and yaw rate are cut at v_max and w_max in both directions. Zero means no limit. */
#include <math.h>

#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 2; i++) {
		if (p[i] > 0) { signal->command[i] = fmin(fmax(signal->command[i], -p[i]), p[i]); }
	}
}

const tk_effect saturation = {
    .name = "saturation",
    .formula = "|v| <= v_max, |omega| <= w_max; 0: no limit",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"v_max", "m/s", 0, 10, 1.5}, {"w_max", "rad/s", 0, 10, 0.5}},
    .apply = apply,
};
