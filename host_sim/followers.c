/* What follows a command row by row: a gear with play, an actuator that moves at a limited rate, a pole. */
#include <math.h>

#include "tinykoop_sim.h"

void tk_play(size_t rows, double half, const double *u, double *out) {
	double y = rows ? u[0] : 0;
	for (size_t k = 0; k < rows; k++) {
		y = fmin(fmax(y, u[k] - half), u[k] + half);
		out[k] = y;
	}
}

void tk_limited_rate(size_t rows, double most, const double *u, double *out) {
	double y = rows ? u[0] : 0;
	for (size_t k = 0; k < rows; k++) {
		const double left = u[k] - y;
		if (fabs(left) <= most) {
			out[k] = left == 0 ? u[k] : u[k] - left * fabs(left) / (2 * most);
			y = u[k];
		} else {
			const double move = copysign(most, left);
			out[k] = y + move / 2;
			y += move;
		}
	}
}

void tk_pole(size_t rows, const double *pole, const double *u, double *out) {
	double re = 0, im = 0;
	for (size_t k = 0; k < rows; k++) {
		const double turned = pole[0] * re - pole[1] * im;
		im = pole[0] * im + pole[1] * re;
		re = turned + u[k];
		out[2 * k] = re;
		out[2 * k + 1] = im;
	}
}
