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
#if defined(__ARM_FEATURE_MVE) && !defined(__OPTIMIZE_SIZE__)
#define OUTER_WIDTH 12 /* columns updated at a time: Helium has eight 16-byte registers, and more would be spilled */
#else
#define OUTER_WIDTH 24 /* columns updated at a time: they fill six 16-byte registers, or 24 of 32 single ones */
#endif
#define MPC_TOLERANCE 1e-5f /* of the KKT residual, by default */
#define SPLIT 4097          /* 2^12 + 1 splits a mantissa in two halves, for compensated sums */
#define ANGLE_MAX 1048576   /* rad; beyond it, adjacent floats are 1/8 rad apart */
#define MATH(function) function##f
#define KOOP(name) koopf_##name

#include "src/all.h"
