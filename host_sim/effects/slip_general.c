/* Wheel slip by any monotone curve: the loss grows with the load |v omega| from none to all of its share,
 * faster or slower by n, around the load s0. Speed, yaw rate and sideways velocity have shares of their own.
 */
#include <math.h>

#include "effects.h"

void slip_by(double v_loss, double w_loss, double lateral, tk_signal *signal) {
	const double v = signal->command[0], omega = signal->command[1];
	signal->body[0] *= 1 - v_loss;
	signal->body[1] += (omega > 0) * lateral * v - (omega < 0) * lateral * v;
	signal->body[2] *= 1 - w_loss;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	const double load = fabs(signal->command[0] * signal->command[1]);
	(void)memory;
	if (!(load > 0)) { return; }
	const double loss = -expm1(-pow(load / p[3], p[4])); /* s0 = 0: all of it */
	slip_by(p[0] * loss, p[1] * loss, p[2] * loss, signal);
}

const tk_effect slip_general = {
    .name = "slip_general",
    .formula = "v -> v (1 - v_loss l), omega -> omega (1 - w_loss l), sideways velocity = lateral v l "
               "sign(omega); l = 1 - exp(-(|v omega| / s0)^n)",
    .family = "slip",
    .reported_as = "pacejka_slip",
    .block = TK_PLANT,
    .n_parameters = 5,
    .parameters =
        {
            {"v_loss", "1", 0, 1, 0.05},
            {"w_loss", "1", 0, 1, 0.1},
            {"lateral", "1", -2, 2, 0.05},
            {"s0", "m/s2", 0, 20, 0.5},
            {"n", "1", 0, 6, 1.5},
        },
    .apply = apply,
};
