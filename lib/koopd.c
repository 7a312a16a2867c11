/* TinyKoop in float64: compile this file and include tinykoop.h. */
#include "tinykoop.h"

#include <float.h>
#include <math.h>

#define real double
#define REAL_MAX DBL_MAX
#define REAL_MIN DBL_MIN
#define REAL_EPSILON DBL_EPSILON
#define OUTER_WIDTH 12     /* columns updated at a time: what fits six 16-byte registers */
#define MPC_TOLERANCE 1e-9 /* of the KKT residual, by default */
#define SPLIT 0            /* no sum is kept in two parts */
#define MATH(function) function
#define KOOP(name) koopd_##name

#include "src/all.h"
