/* Whether numbers are finite, by their bits: no compiler flag does away with that. */

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
