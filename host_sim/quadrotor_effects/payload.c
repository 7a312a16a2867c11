/* A weight is fixed to the body at (x, y): it adds mass and inertia, and the centre of mass moves. */
#include "quadrotor.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	double *sums = in_quadrotor(signal)->payload;
	const double x = p[1], y = p[2], terms[6] = {1, x, y, x * x, y * y, x * y};
	for (size_t i = 0; i < 6; i++) { sums[i] += p[0] * terms[i]; }
}

const tk_effect quadrotor_payload = {
    .name = "payload",
    .formula = "a point mass at (x, y, 0) in body axes",
    .block = TK_PLANT,
    .n_parameters = 3,
    .parameters =
        {
            {"mass", "kg", 0, 0.015, 0.003},
            {"x", "m", -0.08, 0.08, -0.02},
            {"y", "m", -0.08, 0.08, 0.02},
        },
    .apply = apply,
};
