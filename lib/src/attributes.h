/* What a compiler is told of a function. */

/* Where a compiler would merge functions, and with them their stack, or make a copy
 * for a constant argument that it then spoils. */
#if defined(__clang__)
#define OUT_OF_LINE __attribute__((noinline))
#elif defined(__GNUC__)
#define OUT_OF_LINE __attribute__((noinline, noclone))
#else
#define OUT_OF_LINE
#endif

/* Of sums in two parts: a product that is rounded must be so everywhere. GCC makes a * b + c one operation where
 * the processor has it, but for -std=c99; Clang is told for all of a file (strict.h). */
#if defined(__GNUC__) && !defined(__clang__)
#define UNCONTRACTED __attribute__((optimize("fp-contract=off")))
#else
#define UNCONTRACTED
#endif

/* COLD: run once, or seldom. INLINE: part of a kernel. */
#if defined(__GNUC__)
#define COLD __attribute__((cold))
#define INLINE inline __attribute__((always_inline))
#define HOT __attribute__((hot))
#else
#define COLD
#define INLINE inline
#define HOT
#endif
