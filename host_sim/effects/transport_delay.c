/* Commands arrive late by `delay`, which need not be a whole number of steps: a
 * command that is held then changes within a step, and the step's mean drives
 * the robot. Before the first command that one was already held. */
#include <math.h>

#include "effects.h"

/* memory: count of commands so far, then the ring of the latest ones */
static size_t ring_size(double delay, double dt) {
	return (size_t)fmin(floor(delay / dt), 1e12) + 2; /* as much as that is refused */
}

size_t axis_delay_history(double delay, double dt) {
	return 1 + ring_size(delay, dt);
}

size_t delay_history(const double *p, double dt) {
	return 2 * axis_delay_history(p[0], dt);
}

void delay_command(double delay, double *memory, double dt, double *command) {
	const size_t size = ring_size(delay, dt), count = (size_t)memory[0];
	const double late = delay / dt, part = late - floor(late);
	double *ring = memory + 1;
	for (size_t j = 0; count == 0 && j < size; j++) { ring[j] = *command; }
	ring[count % size] = *command;
	/* the slots that follow hold the oldest commands */
	const double oldest = ring[(count + 1) % size], next = ring[(count + 2) % size];
	*command = (1 - part) * next + part * oldest;
	memory[0] = (double)(count + 1);
}

void delay_commands(const double *p, double *memory, tk_signal *signal) {
	const size_t each = axis_delay_history(p[0], signal->dt);
	for (size_t i = 0; i < 2; i++) { delay_command(p[0], memory + each * i, signal->dt, &signal->command[i]); }
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
