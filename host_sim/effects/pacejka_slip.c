/* Wheel slip after Pacejka's Magic Formula. Paper, section "Non-Stationary
 * Disturbance and Tractive Slip Dynamics": the slip proxy s = 0.18 |v omega|
 * gives an attenuation l in [0, 1] of speed and yaw rate and a skid across.
 *
 * The paper gives 0.18 and 0.45; how strongly l acts on v and omega (0.3, 0.7)
 * and the usual B to E are those that reproduce its tables. */
#include <math.h>

#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	const double B = p[0], C = p[1], D = p[2], E = p[3], lateral = p[4];
	const double v = signal->command[0], omega = signal->command[1];
	(void)memory;

	const double s = B * (0.18 * fabs(v * omega));
	const double curve = D * sin(C * atan(s - E * (s - atan(s))));
	const double loss = fmin(fmax(curve, 0), 1);
	signal->body[0] *= 1 - 0.3 * loss;
	signal->body[1] += (omega > 0) * lateral * v * loss - (omega < 0) * lateral * v * loss;
	signal->body[2] *= 1 - 0.7 * loss;
}

const tk_effect pacejka_slip = {
    .name = "pacejka_slip",
    .formula = "v -> v (1 - 0.3 l), omega -> omega (1 - 0.7 l), sideways velocity = lat v l sign(omega); l = D sin(C atan(s - E (s - atan s))), s = B 0.18 s^2/m |v omega|",
    .family = "slip",
    .block = TK_PLANT,
    .n_parameters = 5,
    .parameters =
        {
            {"B", "1", 0, 30, 10},
            {"C", "1", 0, 3, 1.6},
            {"D", "1", 0, 1, 0.11},
            {"E", "1", -2, 1, 0.3},
            {"lat", "1", 0, 2, 0.45},
        },
    .apply = apply,
};
