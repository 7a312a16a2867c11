/* Play in the drive as an angle of the heading, and as a way: the motor turns through the play before it
 * moves the body, so at every reversal a part of the turn, or of the way, is lost.
 *
 * The play sets in taken up in the direction of the first command; in its middle if that is zero. */
#include <math.h>

#include "effects.h"

enum { BEGUN, AHEAD, N_MEMORY = AHEAD + 2 }; /* how far the motor is ahead of the body, of each command */

static double through_play(double half, double *ahead, double moved) {
	const double reached = *ahead + moved;
	*ahead = fmin(fmax(reached, -half), half);
	return reached - *ahead;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	for (size_t i = 0; i < 2; i++) {
		const double half = p[1 - i], command = signal->command[i];
		double *ahead = &memory[AHEAD + i];
		if (!(half > 0)) { continue; }
		if (!memory[BEGUN]) { *ahead = (command > 0) * half - (command < 0) * half; }
		signal->command[i] = through_play(half, ahead, command * signal->dt) / signal->dt;
	}
	memory[BEGUN] = 1;
}

const tk_effect backlash_angle = {
    .name = "backlash_angle",
    .formula = "heading follows the integral of omega only while they differ by half_angle, way that of v "
               "only by half_way",
    .family = "backlash",
    .reported_as = "backlash",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"half_angle", "rad", 0, 1, 0.04}, {"half_way", "m", 0, 1, 0.02}},
    .n_memory = N_MEMORY,
    .apply = apply,
};
