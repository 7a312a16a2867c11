/* The guard in float32: compile this file beside koopf.c and include tinykoop_guard.h. */
#include "tinykoop_guard.h"

#include <math.h>

#define real float
#define REAL_BITS uint32_t
#define INFINITY_BITS UINT32_C(0x7F800000)
#define MATH(function) function##f
#define KOOP(name) koopf_##name

#include "src/guard.c"
