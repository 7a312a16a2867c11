/* How far the library's exp, sine, cosine and atan2 of these two are from long double's.
 *
 *     accuracy <points of each line>
 *
 * Prints lines of
 *     error <precision> <function> <from> <to> <worst error> <where>
 * The points are spaced evenly among the numbers of the precision, in both signs; with them go those next to
 * multiples of pi / 2. The error is in units of the last place of the result, but for far-...: of x. */
#if TEST_DOUBLE
#include "koopd.c"
#define PRECISION "float64"
#define FAR 1000000
#else
#include "koopf.c"
#define PRECISION "float32"
#define FAR 10000
#endif

#include <stdio.h>
#include <stdlib.h>

typedef long double wide;

static const wide PI = 3.14159265358979323846264338327950288L;

static wide unit(wide value) {
	int exponent;
	frexpl(value, &exponent);
	return ldexpl(1, exponent - REAL_DIGITS);
}

static wide distance(real value, wide expected) {
	return fabsl((wide)value - expected);
}

static void angle_of(real x, real *out) {
	KOOP(angle) angle;
	reduce(&angle, x);
	sine_cosine(&angle, out);
	out[2] = wrapped(&angle);
}

static wide error_of_exp(real x) {
	real out[4] = {x, x, x, x};
	const wide expected = expl(-(wide)x);
	if (x < 0 || expected < (wide)REAL_MIN) { return 0; }
	exp_minus_four(out);
	return distance(out[3], expected) / unit(expected);
}

static wide error_of_sine(real x) {
	real out[3];
	angle_of(x, out);
	return distance(out[0], sinl((wide)x)) / unit(sinl((wide)x));
}

static wide error_of_cosine(real x) {
	real out[3];
	angle_of(x, out);
	return distance(out[1], cosl((wide)x)) / unit(cosl((wide)x));
}

static wide error_of_atan2(real x) {
	real out[3];
	angle_of(x, out);
	const wide expected = atan2l((wide)out[0], (wide)out[1]);
	return distance(out[2], expected) / unit(expected);
}

static wide error_of_far_angle(real x) {
	real out[3];
	angle_of(x, out);
	const wide off = fabsl(remainderl((wide)out[2] - (wide)x, 2 * PI));
	return fmaxl(off, fmaxl(distance(out[0], sinl((wide)x)), distance(out[1], cosl((wide)x)))) /
	       unit((wide)x);
}

static const struct {
	const char *name;
	wide (*error)(real x);
	real from, to;
} lines[] = {
    {"exp", error_of_exp, (real)1e-3, REAL_BIAS},
    {"sine", error_of_sine, (real)1e-3, 10},
    {"sine", error_of_sine, 10, FAR},
    {"cosine", error_of_cosine, (real)1e-3, 10},
    {"cosine", error_of_cosine, 10, FAR},
    {"atan2", error_of_atan2, (real)1e-3, 10},
    {"atan2", error_of_atan2, 10, FAR},
    {"far-angle", error_of_far_angle, FAR, ANGLE_MAX},
};

static real real_of(REAL_BITS bits) {
	real x;
	memcpy(&x, &bits, sizeof x);
	return x;
}

typedef struct {
	wide error;
	real at;
} worst;

/* written so that NaN is the worst */
static void look(worst *w, wide (*error)(real), real x) {
	const wide seen = w->error < (wide)INFINITY ? error(x) : 0;
	if (!(seen <= w->error)) {
		w->error = seen == seen ? seen : (wide)INFINITY;
		w->at = x;
	}
}

int main(int argc, char **argv) {
	const REAL_BITS points = argc > 1 ? (REAL_BITS)strtoull(argv[1], NULL, 10) : 1000000;
	for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
		const REAL_BITS from = bits_of(lines[i].from), to = bits_of(lines[i].to);
		const REAL_BITS step = (to - from) / points > 0 ? (to - from) / points : 1;
		worst w = {0, 0};
		for (REAL_BITS bits = from; bits < to; bits += step) {
			look(&w, lines[i].error, real_of(bits));
			look(&w, lines[i].error, -real_of(bits));
		}
		for (wide q = 1; lines[i].to <= FAR && q * PI / 2 < (wide)lines[i].to; q++) {
			const real x = (real)(q * PI / 2);
			if (x >= lines[i].from) { look(&w, lines[i].error, x); }
		}
		printf("error " PRECISION " %s %g %g %.4f %.17g\n", lines[i].name, (double)lines[i].from,
		       (double)lines[i].to, (double)w.error, (double)w.at);
	}
	return 0;
}
