/* Speed and yaw rate follow their commands as second-order systems, such as a motor with a
 * speed controller: time constant tau (one over the natural frequency) and damping ratio zeta.
 *
 * Exact for a command that is held: the deviation from the command and its rate are
 * turned by the matrix exponential exp(A s), s = dt / tau, in time counted in tau. What
 * drives the robot is the mean over the step, by the integral of the equation itself. The
 * lag sets in settled on the first command. */
#include <math.h>

#include "effects.h"

enum { BEGUN, STEPS, DECAY, DEVIATION = DECAY + 2, RATE = DEVIATION + 2, LAST = RATE + 2, N_MEMORY = LAST + 2 };

/* exp(A s) = c I + d (A + zeta I); the exponentials stay bounded for any step. */
static void decay(double zeta, double s, double *c, double *d) {
	const double square = zeta * zeta - 1, w = sqrt(fabs(square));
	if (square < 0) {
		const double size = exp(-zeta * s);
		*c = size * cos(w * s);
		*d = size * sin(w * s) / w;
	} else {
		const double slow = exp(-s / (zeta + w)); /* zeta - w without cancellation */
		*c = 0.5 * slow * (1 + exp(-2 * w * s));
		*d = w > 0 ? -0.5 * slow * expm1(-2 * w * s) / w : slow * s;
	}
}

static void follow(double zeta, double s, const double *decayed, double *deviation, double *rate,
                   double *command) {
	const double e = *deviation, r = *rate, c = decayed[0], d = decayed[1];
	*deviation = c * e + d * (zeta * e + r);
	*rate = c * r - d * (e + zeta * r);
	*command += (r - *rate + 2 * zeta * (e - *deviation)) / s;
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	if (!(p[0] > 0)) { return; }
	const double s = signal->dt / p[0];
	double *last = memory + LAST, *decayed = memory + DECAY; /* commands; the same in every step of one length */
	if (memory[STEPS] != s) {
		memory[STEPS] = s;
		decay(p[1], s, &decayed[0], &decayed[1]);
	}
	for (size_t i = 0; i < 2; i++) {
		const double command = signal->command[i];
		if (memory[BEGUN]) { memory[DEVIATION + i] += last[i] - command; }
		last[i] = command;
		follow(p[1], s, decayed, &memory[DEVIATION + i], &memory[RATE + i], &signal->command[i]);
	}
	memory[BEGUN] = 1;
}

const tk_effect second_order_lag = {
    .name = "second_order_lag",
    .formula = "tau^2 x'' + 2 zeta tau x' = command - x, for x = v and x = omega",
    .family = "lag",
    .reported_as = "actuator_lag",
    .block = TK_ACTUATOR,
    .n_parameters = 2,
    .parameters = {{"tau", "s", 0, 3, 0.15}, {"zeta", "1", 0, 3, 0.8}},
    .n_memory = N_MEMORY,
    .apply = apply,
};
