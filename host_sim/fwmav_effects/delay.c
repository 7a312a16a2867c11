/* The command that the log holds reaches the wings late by `delay`, as on the DDR. */
#include "fwmav.h"

const tk_effect fwmav_delay = {
    .name = "delay",
    .formula = "u(t) -> u(t - delay)",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"delay", "s", 0, 0.05, 0.01}},
    .history = delay_history,
    .apply = delay_commands,
};
