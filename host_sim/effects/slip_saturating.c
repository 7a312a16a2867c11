/* Wheel slip by few numbers: speed and yaw rate lose the same share, which saturates with the load |v omega|.
 */
#include <math.h>

#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	const double load = fabs(signal->command[0] * signal->command[1]);
	(void)memory;
	if (!(load > 0)) { return; }
	const double loss = -expm1(-load / p[2]); /* s0 = 0: all of it */
	slip_by(p[0] * loss, p[0] * loss, p[1] * loss, signal);
}

const tk_effect slip_saturating = {
    .name = "slip_saturating",
    .formula = "v -> v (1 - loss l), omega -> omega (1 - loss l), sideways velocity = lateral v l "
               "sign(omega); l = 1 - exp(-|v omega| / s0)",
    .family = "slip",
    .reported_as = "pacejka_slip",
    .block = TK_PLANT,
    .n_parameters = 3,
    .parameters = {{"loss", "1", 0, 1, 0.08}, {"lateral", "1", -2, 2, 0.05}, {"s0", "m/s2", 0, 20, 0.5}},
    .apply = apply,
};
