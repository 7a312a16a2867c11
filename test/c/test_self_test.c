/* The self-test passes here, and notices a processor that rounds otherwise. Builds that it is to refuse are
 * made by `make flags`. */
#include "support.h"

#include <fenv.h>

static void test_arithmetic_is_as_it_should_be(void) {
	CHECK_STATUS(KOOP_OK, KOOP(self_test)());
}

/* Whether the mode applies: not where reals of this width are computed in software. */
static int rounds_otherwise(void) {
	volatile const real one = 1, little = REAL_EPSILON / 8;
	const volatile real above = one + little, below = one - little;
	return above > 1 || below < 1;
}

static void test_another_rounding_is_noticed(void) {
#if defined(FE_UPWARD) && defined(FE_DOWNWARD) && defined(FE_TOWARDZERO)
	static const int others[] = {FE_UPWARD, FE_DOWNWARD, FE_TOWARDZERO};
	for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
		if (fesetround(others[i]) != 0) { continue; } /* the processor, or its software, knows one alone */
		const int other = rounds_otherwise(), status = KOOP(self_test)();
		fesetround(FE_TONEAREST);
		CHECK(!other || status == KOOP_E_ARITHMETIC, "rounding %d: status %d", others[i], status);
	}
#endif
	CHECK_STATUS(KOOP_OK, KOOP(self_test)());
}

int main(void) {
	UNITY_BEGIN();
	RUN_TEST(test_arithmetic_is_as_it_should_be);
	RUN_TEST(test_another_rounding_is_noticed);
	return UNITY_END();
}
