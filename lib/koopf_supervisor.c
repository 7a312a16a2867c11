/* The supervisor in float32: compile this file beside koopf.c and include tinykoop_supervisor.h. */
#include "tinykoop_supervisor.h"

#include <math.h>

#define real float
#define REAL_BITS uint32_t
#define INFINITY_BITS UINT32_C(0x7F800000)
#define MATH(function) function##f
#define KOOP(name) koopf_##name

#include "src/supervisor.c"
