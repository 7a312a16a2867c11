/* The servos' neutral positions are off: of the dihedral by `pitch`, of the wing twist by `yaw`. */
#include "fwmav.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_flight(signal)->trim[0] += p[0];
	in_flight(signal)->trim[1] += p[1];
}

const tk_effect fwmav_trim_bias = {
    .name = "trim_bias",
    .formula = "dihedral -> dihedral + pitch, wing twist -> wing twist + yaw",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters =
        {
            {"pitch", "rad", -0.1, 0.1, 0.03},
            {"yaw", "rad", -0.1, 0.1, 0.03},
        },
    .apply = apply,
};
