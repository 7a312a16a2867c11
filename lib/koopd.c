/* TinyKoop in float64: compile this file and include tinykoop.h. */
#include "tinykoop.h"

#include <float.h>
#include <math.h>

#define real double
#define REAL_BITS uint64_t
#define INFINITY_BITS UINT64_C(0x7FF0000000000000)
#define REAL_MAX DBL_MAX
#define REAL_MIN DBL_MIN
#define REAL_EPSILON DBL_EPSILON
#define REAL_DIGITS DBL_MANT_DIG
#define REAL_BIAS (DBL_MAX_EXP - 1)
#define OUTER_WIDTH 12        /* columns updated at a time: they fill six 16-byte registers */
#define MPC_TOLERANCE 1e-9    /* of the KKT residual, by default */
#define SPLIT 0               /* sums are not compensated */
#define ANGLE_MAX 1073741824  /* rad; beyond it, the number of quarter turns exceeds 32 bits */
#define MATH(function) function
#define KOOP(name) koopd_##name

#include "src/all.h"
