/* Checks the arithmetic as compiled and as the processor is configured. Values that the compiler cannot know
 * pass through the library's own functions. */

static COLD int is_beyond(real a, real limit) {
	return !(MATH(fabs)(a) <= limit);
}

/* Returns 1 unless NaN and Inf are computed and recognised. */
static COLD int loses_nan(real zero) {
	const real nan = (1 - 1 / (zero + 1)) / zero, inf = 1 / zero;
	const real mixed[2] = {zero, nan};
	return is_within(nan, -inf, inf) | is_within(inf, zero, REAL_MAX) | is_nonnegative(nan) | !is_nan(nan) |
	       is_finite(nan) | is_finite(inf) | all_finite(mixed, 2) | !(inf > REAL_MAX) |
	       bits_differ(clip(nan, zero, inf), zero) | bits_differ(max_of(zero, -inf), zero);
}

/* Returns 1 unless sums keep their order, divisions are exact divisions, and results are rounded to nearest.
 */
static COLD int rounds_otherwise(real one) {
	const real little = one * REAL_EPSILON * (real)0.375, more = one * REAL_EPSILON * (real)0.75;
	/* first line: a literal is rounded as a quotient is, and to the precision of `real` */
	return bits_differ(3 * one / (10 * one), (real)0.3) | bits_differ(one / (10 * one), (real)0.1) |
	       bits_differ((one + little) - one, 0) | bits_differ((one + more) - one, REAL_EPSILON) |
	       bits_differ((-one - little) + one, 0) | bits_differ((-one - more) + one, -REAL_EPSILON) |
	       bits_differ(one * (one * REAL_MIN), REAL_MIN);
}

/* The rounding error of start + a^2 that a compensated sum keeps. */
static COLD real rest_of_square(real start, real a, real one) {
	real sum = start, rest = 0;
	add_product(&sum, &rest, a, a);
	add_product(&sum, &rest, -sum, one);
	return sum + rest;
}

/* Returns 1 unless compensated sums keep the rounding error: 6 epsilon and -3/8 epsilon here. In double they
 * are not used. */
static COLD int loses_rest(real one) {
	const real of_sum = rest_of_square(one / REAL_EPSILON, one + 3 * REAL_EPSILON, one);
	const real of_square = rest_of_square(0, one + one / 16 + 5 * REAL_EPSILON, one);
	const real limit = REAL_EPSILON / 64;
	return (SPLIT != 0) & (is_beyond(of_sum - 6 * REAL_EPSILON, limit) |
	                       is_beyond(of_square + (real)0.375 * REAL_EPSILON, limit));
}

/* Returns 1 if sine, cosine or exponential is wrong by two units in the last place or more. */
static COLD int misses_elementary(real one) {
	KOOP(angle) angle;
	real turn[2], decay[4] = {one, 0, 0, 0};
	reduce(&angle, 99 + one);
	sine_cosine(&angle, turn);
	exp_minus_four(decay);
	return is_beyond(turn[0] - (real)-0.50636564110975879, REAL_EPSILON) |
	       is_beyond(turn[1] - (real)0.86231887228768393, REAL_EPSILON) |
	       is_beyond(decay[0] - (real)0.36787944117144232, REAL_EPSILON);
}

COLD int KOOP(self_test)(void) {
	const volatile real one = 1, zero = 0;
	return KOOP_E_ARITHMETIC *
	       (loses_nan(zero) | rounds_otherwise(one) | loses_rest(one) | misses_elementary(one));
}
