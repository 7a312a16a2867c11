/* The battery's voltage, and with it the wing-beat frequency, falls linearly with time on top
 * of the usual sag: by the share loss_at_end when the flight (or the effect) ends. Thrust,
 * and what servos can do with it, goes as its square. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->voltage *= 1 - p[0] * signal->passed;
}

const tk_effect fwmav_battery_sag = {
    .name = "battery_sag",
    .formula = "voltage -> voltage (1 - loss_at_end t / t_end)",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"loss_at_end", "1", 0, 0.3, 0.08}},
    .needs_end = 1,
    .apply = apply,
};
