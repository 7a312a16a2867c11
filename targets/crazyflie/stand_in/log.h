/* Stand-in for the firmware's header: only what the example needs. */
#pragma once
#include "variable.h"

#define LOG_UINT8 "u8"
#define LOG_UINT16 "u16"
#define LOG_UINT32 "u32"
#define LOG_INT8 "i8"
#define LOG_FLOAT "float"
#define LOG_GROUP_START(GROUP) VARIABLES(log, GROUP)
#define LOG_ADD(TYPE, NAME, ADDRESS) VARIABLE(TYPE, NAME, ADDRESS)
#define LOG_GROUP_STOP(GROUP) VARIABLES_END
