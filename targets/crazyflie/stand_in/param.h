/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include "variable.h"

#define PARAM_UINT8 "u8"
#define PARAM_FLOAT "float"
#define PARAM_GROUP_START(GROUP) VARIABLES(param, GROUP)
#define PARAM_ADD(TYPE, NAME, ADDRESS) VARIABLE(TYPE, NAME, ADDRESS)
#define PARAM_GROUP_STOP(GROUP) VARIABLES_END
