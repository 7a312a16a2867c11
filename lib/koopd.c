/* TinyKoop in float64: compile this file and include tinykoop.h. */
#include "tinykoop.h"

#include <float.h>
#include <math.h>

#define real double
#define REAL_MAX DBL_MAX
#define REAL_EPSILON DBL_EPSILON
#define MATH(function) function
#define KOOP(name) koopd_##name

#include "src/all.h"
