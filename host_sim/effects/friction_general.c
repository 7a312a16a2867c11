/* Friction by any falling curve: each velocity loses a share of itself, `moving` at speed and `extra` more near
 * standstill. Around the speed v0 it falls, faster or slower by n. The yaw rate loses `yaw` times as much as a
 * speed of the same number would. A curve that rises with speed would be a gain that depends on speed. */
#include <math.h>

#include "effects.h"

static double share(const double *p, double x) {
	const double moving = p[0], extra = p[1], v0 = p[2], n = p[3];
	const double near = x != 0 ? exp(-pow(fabs(x) / v0, n)) : 1; /* v0 = 0: nowhere */
	return moving + extra * near;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	double *body = signal->body;
	(void)memory;
	body[0] *= 1 - fmin(share(p, body[0]), 1);
	body[1] *= 1 - fmin(share(p, body[1]), 1);
	body[2] *= 1 - fmin(p[4] * share(p, body[2]), 1);
}

const tk_effect friction_general = {
    .name = "friction_general",
    .formula = "v -> v (1 - mu(v)), omega -> omega (1 - min(yaw mu(omega), 1)); mu(x) = moving + "
               "extra exp(-(|x| / v0)^n)",
    .family = "friction",
    .reported_as = "stribeck_friction",
    .block = TK_PLANT,
    .n_parameters = 5,
    .parameters =
        {
            {"moving", "1", 0, 0.95, 0.15},
            {"extra", "1", 0, 0.95, 0.15},
            {"v0", "m/s", 0, 10, 1},
            {"n", "1", 0, 6, 1.5},
            {"yaw", "1", 0, 3, 0.3},
        },
    .apply = apply,
};
