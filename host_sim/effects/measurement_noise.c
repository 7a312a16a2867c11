/* White Gaussian noise: standard deviation sp of each position, st of the heading.
 *
 * The draws depend on the seed and the number of the step alone, so a run
 * repeats exactly. There is no undoing it: it serves simulation only. */
#include <math.h>

#include "effects.h"
#include "random.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	uint64_t state = random_mix(random_mix((uint64_t)p[2]) + (uint64_t)llround(signal->t / signal->dt));
	(void)memory;
	signal->pose[0] += p[0] * random_normal(&state);
	signal->pose[1] += p[0] * random_normal(&state);
	signal->pose[2] += p[1] * random_normal(&state);
}

const tk_effect measurement_noise = {
    .name = "measurement_noise",
    .formula = "white noise of standard deviation sp on px and py, st on theta",
    .block = TK_SENSOR,
    .n_parameters = 3,
    .parameters =
        {
            {"sp", "m", 0, 1, 0.005},
            {"st", "rad", 0, 1, 0.005},
            {"seed", "1", 0, 9e15, 0},
        },
    .apply = apply,
};
