/* Commands arrive late by `delay`, which need not be a whole number of steps: a
 * command that is held then changes within a step, and the step's mean drives
 * the robot. Before the first command that one was already held. */
#include <math.h>

#include "effects.h"

/* memory: count of commands so far, then the ring of the latest ones */
static size_t ring_size(const double *p, double dt) {
	return (size_t)fmin(floor(p[0] / dt), 1e12) + 2; /* as much as that is refused */
}

size_t delay_history(const double *p, double dt) {
	return 1 + 2 * ring_size(p, dt);
}

void delay_commands(const double *p, double *memory, tk_signal *signal) {
	const size_t size = ring_size(p, signal->dt), count = (size_t)memory[0];
	const double late = p[0] / signal->dt, part = late - floor(late);
	double *ring = memory + 1;
	for (size_t i = 0; i < 2; i++) {
		for (size_t j = 0; count == 0 && j < size; j++) { ring[2 * j + i] = signal->command[i]; }
		ring[2 * (count % size) + i] = signal->command[i];
		/* the slots that follow hold the oldest commands */
		const double oldest = ring[2 * ((count + 1) % size) + i], next = ring[2 * ((count + 2) % size) + i];
		signal->command[i] = (1 - part) * next + part * oldest;
	}
	memory[0] = (double)(count + 1);
}

const tk_effect transport_delay = {
    .name = "transport_delay",
    .formula = "v(t) -> v(t - delay), omega(t) -> omega(t - delay)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"delay", "s", 0, 2, 0.15}},
    .history = delay_history,
    .apply = delay_commands,
};
