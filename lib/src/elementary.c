/* The library's own exp, logarithm, sine and cosine. They give the same bits wherever arithmetic is that of IEEE 754.
 * Those of libm differ between machines in the last bit, and a closed loop amplifies the difference.
 *
 * The argument is reduced by multiples of ln 2 or pi / 2. The remainder goes into a Taylor series whose first
 * omitted term is below a tenth of the rounding error. */

#include <string.h>

/* ln 2 and pi / 2 as sums of parts. All parts but the last have so few bits that k times a part is exact: for
 * every exponent k, and for quarter turns up to 10^4 rad in float, 10^6 rad in double. */
#if REAL_DIGITS == 24
#define EXP_TERMS 6
#define SINE_TERMS 4
#define LOGARITHM_TERMS 5
#define LN2 (real)0.693145751953125, (real)1.4286068203094172e-6
#define QUARTER_TURN                                                                                         \
	(real)1.5703125, (real)4.8375129699707031e-4, (real)7.5495336204767227e-8, (real)2.5633441515945189e-12
#define QUARTER_TURN_REST -(real)4.3711390001862428e-8 /* pi / 2 minus its rounded value */
#else
#define EXP_TERMS 12
#define SINE_TERMS 8
#define LOGARITHM_TERMS 11
#define LN2 0.69314718055989033, 5.4979230187083712e-14
#define QUARTER_TURN 1.5707963267341256, 6.077100506303966e-11, 2.0222662487111665e-21, 8.4784276603688996e-32
#define QUARTER_TURN_REST 6.1232339957367659e-17
#endif

static INLINE real inverse_factorial(size_t n) {
	static const real from_2[] = {
		(real)1 / 2,
		(real)1 / 6,
		(real)1 / 24,
		(real)1 / 120,
		(real)1 / 720,
		(real)1 / 5040,
		(real)1 / 40320,
		(real)1 / 362880,
		(real)1 / 3628800,
#if REAL_DIGITS > 24
		(real)1 / 39916800,
		(real)1 / 479001600,
		(real)1 / 6227020800,
		(real)1 / 87178291200,
		(real)1 / 1307674368000,
		(real)1 / 20922789888000,
		(real)1 / 355687428096000,
		(real)1 / 6402373705728000,
#endif
	};
	return from_2[n - 2];
}

/* value = k ln 2 - (high + low), scale = 2^-k */
static INLINE real exp_parts(real value, real *high, real *low) {
	static const real ln2[] = {LN2};
	const real limit = REAL_BIAS * ln2[0], x = value < limit ? value : limit;
	const int32_t k = (int32_t)(x * (real)1.4426950408889634 + (real)0.5);
	/* the bits of 0 for the largest k */
	const REAL_BITS bits = (REAL_BITS)(REAL_BIAS - k) << (REAL_DIGITS - 1);
	real scale;
	(void)memcpy(&scale, &bits, sizeof scale);
	*high = (real)k * ln2[0] - x;
	*low = (real)k * ln2[1];
	return scale;
}

#define EXP_BEGIN(lane)                                                                                      \
	real high##lane, low##lane, sum##lane = 0;                                                               \
	const real scale##lane = exp_parts(x[lane], &high##lane, &low##lane), rest##lane = high##lane + low##lane;
#define EXP_ADD(lane) sum##lane = sum##lane * rest##lane + next;
#define EXP_END(lane)                                                                                        \
	x[lane] = (1 + (high##lane + (low##lane + rest##lane * rest##lane * sum##lane))) * scale##lane;

/* x[i] = exp(-x[i]) for four x[i] >= 0; 0 if the result is below REAL_MIN / 2 */
static void exp_minus_four(real *x) {
	LANES_4(EXP_BEGIN)
	for (size_t n = 2 + EXP_TERMS; n-- > 2;) {
		const real next = inverse_factorial(n);
		LANES_4(EXP_ADD)
	}
	LANES_4(EXP_END)
}

/* quarters * pi / 2 + rest + low */
typedef struct KOOP(angle) {
	real rest, low;
	uint32_t quarters; /* modulo 2^32 */
} KOOP(angle);

/* The remainder is NaN beyond ANGLE_MAX. */
static void reduce(KOOP(angle) *angle, real x) {
	static const real part_of_quarter[] = {QUARTER_TURN};
	const int known = MATH(fabs)(x) <= ANGLE_MAX;
	const int32_t quarters =
	    known ? (int32_t)(x * (real)0.63661977236758134 + (x < 0 ? (real)-0.5 : (real)0.5)) : 0;
	real rest = known ? x : (real)NAN, low = 0;
	for (size_t i = 0; quarters && i < sizeof part_of_quarter / sizeof *part_of_quarter; i++) {
		const real part = (real)quarters * part_of_quarter[i], next = rest - part;
		low += (rest - next) - part; /* rounding error of the difference */
		rest = next;
	}
	angle->rest = rest + low;
	angle->low = low - (angle->rest - rest);
	angle->quarters = (uint32_t)quarters;
}

/* out = sine, cosine. The angle becomes the angle of the rounded pair. */
static void sine_cosine(KOOP(angle) *angle, real *out) {
	const real x = angle->rest, low = angle->low, square = x * x, half = square / 2, leading = 1 - half;
	real of_sine = 0, of_cosine = 0;
	for (size_t n = 3 + 2 * SINE_TERMS; n > 3;) {
		n -= 2;
		of_sine = inverse_factorial(n) - of_sine * square;
		of_cosine = inverse_factorial(n + 1) - of_cosine * square;
	}
	const real sine_low = low * leading - x * square * of_sine;
	const real cosine_low = ((1 - leading) - half) + (square * square * of_cosine - x * low);
	const real sine = x + sine_low, cosine = leading + cosine_low;
	angle->low += sine * ((leading - cosine) + cosine_low) - cosine * ((x - sine) + sine_low);
	const int odd = (angle->quarters & 1) != 0;
	out[0] = odd ? cosine : sine;
	out[1] = odd ? sine : cosine;
	if (angle->quarters & 2) { out[0] = -out[0]; }
	if ((angle->quarters + 1) & 2) { out[1] = -out[1]; }
}

/* The angle in [-pi, pi]. After sine_cosine() it is the atan2() of its results. */
static INLINE real wrapped(const KOOP(angle) *angle) {
	const real quarter = (real)1.5707963267948966;
	const uint32_t quarters = angle->quarters & 3;
	real turn = (real)quarters;
	if (quarters == 3 || (quarters == 2 && angle->rest > 0)) { turn -= 4; }
	return turn * quarter + (angle->rest + (angle->low + turn * QUARTER_TURN_REST));
}

/* ln x for a normal x > 0: x = 2^k m with m in [sqrt(1/2), sqrt(2)), ln m = 2 artanh((m - 1) / (m + 1)). */
static real natural_logarithm(real x) {
	static const real ln2[] = {LN2};
	const REAL_BITS bits = bits_of(x), one = (REAL_BITS)REAL_BIAS << (REAL_DIGITS - 1);
	int32_t k = (int32_t)(bits >> (REAL_DIGITS - 1)) - REAL_BIAS;
	const REAL_BITS mantissa = (bits & (((REAL_BITS)1 << (REAL_DIGITS - 1)) - 1)) | one;
	real m;
	(void)memcpy(&m, &mantissa, sizeof m);
	if (m > (real)1.4142135623730951) {
		m /= 2;
		k++;
	}
	const real s = (m - 1) / (m + 1), square = s * s;
	real sum = 0;
	for (size_t n = 2 * LOGARITHM_TERMS + 1; n > 1; n -= 2) { sum = (sum + 1 / (real)n) * square; }
	return (real)k * ln2[0] + (2 * (s + s * sum) + (real)k * ln2[1]);
}
