/* A wheel that is to turn slower than the dead band at its rim stands still; a faster one turns in full. */
#include <math.h>

#include "effects.h"

void change_wheels(double (*act)(double rim, double limit), double limit, double track, tk_signal *signal) {
	double *v = &signal->command[0], *omega = &signal->command[1];
	const double half = 0.5 * track * *omega;
	const double left = *v - half, right = *v + half;
	const double lost_left = left - act(left, limit), lost_right = right - act(right, limit);
	*v -= 0.5 * (lost_left + lost_right);
	if (track > 0) { *omega -= (lost_right - lost_left) / track; }
}

static double still(double rim, double limit) {
	return fabs(rim) < limit ? 0 : rim;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	if (p[0] > 0) { change_wheels(still, p[0], p[1], signal); }
}

const tk_effect wheel_dead_band = {
    .name = "wheel_dead_band",
    .formula = "wheel speed r = v -+ omega track / 2; r = 0 if |r| < v_db",
    .family = "dead_band",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"v_db", "m/s", 0, 10, 0.2}, {"track", "m", 0, 2.5, 0.5}},
    .apply = apply,
};
