/* One test source, two precisions: TEST_DOUBLE = 0 tests koopf_, 1 tests koopd_. */
#ifndef PRECISION_H
#define PRECISION_H

#include "tinykoop.h"

#include <float.h>
#include <tgmath.h>

#if TEST_DOUBLE
typedef double real;
#define KOOP(name) koopd_##name
#define OTHER(name) koopf_##name
#define REAL_EPSILON DBL_EPSILON
#define REAL_MAX DBL_MAX
#define REAL_MIN DBL_MIN
#define MODEL_BYTES(N, m) KOOPD_MODEL_BYTES(N, m)
#define MODEL_BYTES_P(N, m) KOOPD_MODEL_BYTES_P(N, m)
#else
typedef float real;
#define KOOP(name) koopf_##name
#define OTHER(name) koopd_##name
#define REAL_EPSILON FLT_EPSILON
#define REAL_MAX FLT_MAX
#define REAL_MIN FLT_MIN
#define MODEL_BYTES(N, m) KOOPF_MODEL_BYTES(N, m)
#define MODEL_BYTES_P(N, m) KOOPF_MODEL_BYTES_P(N, m)
#endif

/* The long searches are divided by it where the processor is emulated, or the tests are run many times. */
#ifndef TEST_SHARE
#define TEST_SHARE 1
#endif

/* What the tests compute in on their own, so that their rounding does not count. Beside float32, double
 * does where long double is of more than 64 bits, which takes minutes since it is made in software. */
#if !TEST_DOUBLE && LDBL_MANT_DIG > 64
typedef double wide;
#else
typedef long double wide;
#endif

#endif
