/* The guard in float64: compile this file beside koopd.c and include tinykoop_guard.h. */
#include "tinykoop_guard.h"

#include <math.h>

#define real double
#define MATH(function) function
#define KOOP(name) koopd_##name

#include "src/guard.c"
