/* Speed and yaw rate approach v_max and w_max smoothly, the more abruptly the larger the sharpness; at 2.6 it
 * is within 3 % of a hyperbolic tangent. Zero means no limit. */
#include <math.h>

#include "effects.h"

/* Powers of the smaller ratio only, so that none is beyond range. */
static double softly(double u, double limit, double sharpness) {
	const double size = fabs(u);
	const double low = fmin(size, limit), high = fmax(size, limit);
	return copysign(low / pow(1 + pow(low / high, sharpness), 1 / sharpness), u);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	for (size_t i = 0; i < 2; i++) {
		if (p[i] > 0 && p[2] > 0) { signal->command[i] = softly(signal->command[i], p[i], p[2]); }
	}
}

const tk_effect saturation_soft = {
    .name = "saturation_soft",
    .formula =
        "u -> u / (1 + |u / u_max|^sharpness)^(1 / sharpness), for v and omega; v_max, w_max = 0: no limit",
    .family = "saturation",
    .reported_as = "saturation",
    .block = TK_ACTUATOR,
    .n_parameters = 3,
    .parameters = {{"v_max", "m/s", 0, 10, 1.5},
                   {"w_max", "rad/s", 0, 10, 0.5},
                   {"sharpness", "1", 0, 20, 4}},
    .apply = apply,
};
