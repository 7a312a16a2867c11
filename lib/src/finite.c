/* Tests whether a number is finite by its bits, so that no compiler flag can remove the test. */

#include <string.h>

static inline REAL_BITS bits_of(real a) {
	REAL_BITS bits;
	(void)memcpy(&bits, &a, sizeof bits);
	return bits;
}

#define SIGN_BIT ((REAL_BITS)1 << (8 * sizeof(real) - 1))

static inline int is_finite(real a) {
	return (bits_of(a) & INFINITY_BITS) != INFINITY_BITS;
}
