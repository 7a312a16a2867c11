/* The position is measured at (lx, ly) in the robot's axes instead of at its centre. */
#include <math.h>

#include "effects.h"

static void shift(const double *p, double sign, double *pose) {
	const double c = cos(pose[2]), s = sin(pose[2]);
	pose[0] += sign * (p[0] * c - p[1] * s);
	pose[1] += sign * (p[0] * s + p[1] * c);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	shift(p, 1, signal->pose);
}

static void undo(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	shift(p, -1, signal->pose);
}

const tk_effect sensor_lever_arm = {
    .name = "sensor_lever_arm",
    .formula = "position measured at (lx, ly) in the robot's axes",
    .block = TK_SENSOR,
    .n_parameters = 2,
    .parameters = {{"lx", "m", -3, 3, 0.15}, {"ly", "m", -3, 3, 0.05}},
    .apply = apply,
    .undo = undo,
};
