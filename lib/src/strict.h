/* Requests strict arithmetic whatever the command line says: NaN is preserved and sums are not reordered. Flight
 * stacks compile with -ffast-math or parts of it, which would break the checks for NaN and the compensated sums.
 * koopf_self_test() tells whether the request was honoured. */
#if defined(__clang__)
#pragma float_control(precise, on)
#pragma STDC FP_CONTRACT OFF
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "TinyKoop: add -fno-finite-math-only behind -ffast-math; Clang takes NaN from the arguments of functions"
#endif
#elif defined(__GNUC__)
#if (defined(__x86_64__) || defined(__i386__)) && defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "TinyKoop: add -fno-finite-math-only behind -ffast-math; on x86 GCC compares NaN wrongly with it"
#endif
#pragma GCC optimize("no-fast-math", "no-unsafe-math-optimizations", "no-finite-math-only")
#pragma GCC optimize("no-associative-math", "no-reciprocal-math", "signed-zeros", "trapping-math")
#pragma GCC optimize("no-single-precision-constant")
#elif defined(_MSC_VER)
#pragma float_control(precise, on)
#elif defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "TinyKoop needs strict arithmetic: compile its files without -ffast-math and -ffinite-math-only"
#endif
