/* Body drag with a Stribeck curve, mu(v) = Fc + (Fs - Fc) exp(-(v / vs)^2) + Fv |v|.
 * Paper, section "Non-Stationary Disturbance and Tractive Slip Dynamics". Each
 * body velocity loses the share mu of itself; the yaw rate loses 0.1 mu. The
 * paper leaves that form and the constants open; these reproduce its tables. */
#include <math.h>

#include "effects.h"

static double stribeck(const double *p, double v) {
	const double Fs = p[0], Fc = p[1], Fv = p[2], vs = p[3];
	const double bump = vs > 0 ? exp(-(v / vs) * (v / vs)) : 0;
	return Fc + (Fs - Fc) * bump + Fv * fabs(v);
}

static void apply(const double *p, double *memory, tk_signal *signal) {
	double *body = signal->body;
	(void)memory;
	body[0] *= 1 - stribeck(p, body[0]);
	body[1] *= 1 - stribeck(p, body[1]);
	const double left = fmax(fabs(body[2]) - 0.1 * stribeck(p, body[2]), 0);
	body[2] = copysign(left, body[2]);
}

const tk_effect stribeck_friction = {
    .name = "stribeck_friction",
    .formula = "v -> v (1 - mu(v)), |omega| -> |omega| - 0.1 mu(omega) rad/s; mu(x) = Fc + (Fs - Fc) exp(-(x / vs)^2) + Fv |x|",
    .family = "friction",
    .block = TK_PLANT,
    .n_parameters = 4,
    .parameters =
        {
            {"Fs", "1", 0, 0.9, 0.40},
            {"Fc", "1", 0, 0.9, 0.12},
            {"Fv", "s/m", 0, 0.3, 0.08},
            {"vs", "m/s", 0, 3, 1.0},
        },
    .apply = apply,
};
