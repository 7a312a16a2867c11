/* Random numbers that are the same on every machine. */
#ifndef RANDOM_H
#define RANDOM_H

#include <math.h>
#include <stdint.h>

/* splitmix64, public domain, by Sebastiano Vigna */
static inline uint64_t random_mix(uint64_t z) {
	z += 0x9E3779B97F4A7C15u;
	z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
	z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
	return z ^ (z >> 31);
}

/* in (0, 1) */
static inline double random_uniform(uint64_t *state) {
	*state = random_mix(*state);
	return ((double)(*state >> 11) + 0.5) * 0x1p-53;
}

/* standard normal; Box and Muller */
static inline double random_normal(uint64_t *state) {
	const double radius = sqrt(-2 * log(random_uniform(state)));
	return radius * cos(6.283185307179586 * random_uniform(state));
}

#endif
