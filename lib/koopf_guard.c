/* The guard in float32: compile this file beside koopf.c and include tinykoop_guard.h. */
#include "tinykoop_guard.h"

#include <math.h>

#define real float
#define MATH(function) function##f
#define KOOP(name) koopf_##name

#include "src/guard.c"
