/* The supervisor in float64: compile this file beside koopd.c and include tinykoop_supervisor.h. */
#include "tinykoop_supervisor.h"

#include <math.h>

#define real double
#define REAL_BITS uint64_t
#define INFINITY_BITS UINT64_C(0x7FF0000000000000)
#define MATH(function) function
#define KOOP(name) koopd_##name

#include "src/supervisor.c"
