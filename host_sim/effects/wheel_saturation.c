/* Each wheel is cut at a speed of its rim, in both directions: a fast bend gets wider and slower. Zero means
 * no limit. */
#include <math.h>

#include "effects.h"

static double cut(double rim, double limit) {
	return fmin(fmax(rim, -limit), limit);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	if (p[0] > 0) { change_wheels(cut, p[0], p[1], signal); }
}

const tk_effect wheel_saturation = {
    .name = "wheel_saturation",
    .formula = "wheel speed r = v -+ omega track / 2; |r| <= v_max; v_max = 0: no limit",
    .family = "saturation",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"v_max", "m/s", 0, 10, 1.2}, {"track", "m", 0, 2.5, 0.5}},
    .apply = apply,
};
