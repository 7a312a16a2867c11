/* TinyKoop in float32: compile this file and include tinykoop.h. */
#include "tinykoop.h"

#include <float.h>
#include <math.h>

#define real float
#define REAL_BITS uint32_t
#define INFINITY_BITS UINT32_C(0x7F800000)
#define REAL_MAX FLT_MAX
#define REAL_MIN FLT_MIN
#define REAL_EPSILON FLT_EPSILON
#define REAL_DIGITS FLT_MANT_DIG
#define REAL_BIAS (FLT_MAX_EXP - 1)
#define OUTER_WIDTH FLOAT_COLUMNS /* columns updated at a time */
#define MPC_TOLERANCE 1e-5f /* of the KKT residual, by default */
#define SPLIT 4097          /* 2^12 + 1 splits a mantissa in two halves, for compensated sums */
#define ANGLE_MAX 1048576   /* rad; beyond it, adjacent floats are 1/8 rad apart */
#define MATH(function) function##f
#define KOOP(name) koopf_##name

#include "src/all.h"
