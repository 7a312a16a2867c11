/* Function attributes for the compiler. */

/* Prevents inlining and cloning. Inlining would add up the stacks of merged functions, and a clone for a
 * constant argument is slower here. */
#if defined(__clang__)
#define OUT_OF_LINE __attribute__((noinline))
#elif defined(__GNUC__)
#define OUT_OF_LINE __attribute__((noinline, noclone))
#else
#define OUT_OF_LINE
#endif

/* For compensated sums: every product must be rounded. GCC contracts a * b + c into one operation if the
 * processor has it, unless it gets -std=c99. For Clang, strict.h turns contraction off for the whole file. */
#if defined(__GNUC__) && !defined(__clang__)
#define UNCONTRACTED __attribute__((optimize("fp-contract=off")))
#else
#define UNCONTRACTED
#endif

/* COLD: called once or rarely. INLINE: part of a kernel. */
#if defined(__GNUC__)
#define COLD __attribute__((cold))
#define INLINE inline __attribute__((always_inline))
#define HOT __attribute__((hot))
#else
#define COLD
#define INLINE inline
#define HOT
#endif

/* Columns of floats that are updated at a time: they fill six 16-byte registers, or 24 of 32 single ones. Helium has
 * eight 16-byte registers, and 24 columns would be spilled. */
#if defined(__ARM_FEATURE_MVE) && !defined(__OPTIMIZE_SIZE__)
#define FLOAT_COLUMNS 12
#else
#define FLOAT_COLUMNS 24
#endif
