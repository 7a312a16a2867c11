/* Rotors out of balance shake gyro and accelerometer more than usual, by the share a; -1: not at all. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	in_quadrotor(signal)->vibration *= 1 + p[0];
}

const tk_effect quadrotor_vibration = {
    .name = "vibration",
    .formula = "vibration of the sensors -> vibration (1 + a)",
    .block = TK_SENSOR,
    .n_parameters = 1,
    .parameters = {{"a", "1", -1, 5, 1}},
    .apply = apply,
};
