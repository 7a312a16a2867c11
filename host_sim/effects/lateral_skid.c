/* The robot slides across its heading in a bend: lateral velocity k v omega, outwards if k < 0. */
#include "effects.h"

static void apply(const double *p, double *memory, tk_signal *signal) {
	(void)memory;
	signal->body[1] += p[0] * signal->body[0] * signal->body[2];
}

const tk_effect lateral_skid = {
    .name = "lateral_skid",
    .formula = "sideways velocity = k v omega",
    .block = TK_PLANT,
    .n_parameters = 1,
    .parameters = {{"k", "s", -2, 2, 0.1}},
    .apply = apply,
};
