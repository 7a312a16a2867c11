/* The command that the log holds reaches the servos through a further lag of first
 * order, of time constant tau, as on the DDR. */
#include "fwmav.h"

const tk_effect fwmav_lag = {
    .name = "lag",
    .formula = "tau x' = u - x",
    .block = TK_ACTUATOR,
    .n_parameters = 1,
    .parameters = {{"tau", "s", 0, 0.1, 0.015}},
    .n_memory = LAG_MEMORY,
    .apply = lag_commands,
};
