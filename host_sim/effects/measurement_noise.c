/* White Gaussian noise: standard deviation sp of each position, st of the heading.
 *
 * The draws depend on the seed and the number of the step alone, so a run
 * repeats exactly. There is no undoing it: it serves simulation only. */
#include <math.h>
#include <stdint.h>

#include "effects.h"

/* splitmix64, public domain, by Sebastiano Vigna */
static uint64_t mix(uint64_t z) {
	z += 0x9E3779B97F4A7C15u;
	z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
	z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
	return z ^ (z >> 31);
}

/* in (0, 1) */
static double uniform(uint64_t *state) {
	*state = mix(*state);
	return ((double)(*state >> 11) + 0.5) * 0x1p-53;
}

/* Box and Muller */
static double normal(uint64_t *state) {
	const double radius = sqrt(-2 * log(uniform(state)));
	return radius * cos(6.283185307179586 * uniform(state));
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	uint64_t state = mix(mix((uint64_t)p[2]) + (uint64_t)llround(signal->t / signal->dt));
	(void)memory;
	signal->pose[0] += p[0] * normal(&state);
	signal->pose[1] += p[0] * normal(&state);
	signal->pose[2] += p[1] * normal(&state);
}

const tk_effect measurement_noise = {
    .name = "measurement_noise",
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
