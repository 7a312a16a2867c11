/* Butterworth low-pass filter of second order, by the bilinear transform with the cut-off frequency
 * prewarped. In transposed direct form II the two state variables per channel are easily set to the steady
 * state of the first sample. */

COLD int KOOP(lowpass_init)(KOOP(lowpass) *filter, size_t n, real cutoff, real rate, real *storage,
                            size_t reals) {
	if (!filter || !storage) { return KOOP_E_NULL; }
	if (n < 1 || n > KOOP_MAX_DIM) { return KOOP_E_SIZE; }
	if (reals < KOOP_LOWPASS_REALS(n)) { return KOOP_E_STORAGE; }
	/* Written so that NaN fails. Below 1e-3, rounding to float32 displaces the poles. The ratio is compared,
	 * since rate * 1e-3 can underflow to 0. */
	const real part = cutoff / rate;
	if (!(rate > 0 && is_finite(rate) && part >= (real)1e-3 && part <= (real)0.45)) { return KOOP_E_RANGE; }
	const real pi = (real)3.14159265358979323846, root2 = (real)1.41421356237309504880;
	KOOP(angle) angle;
	real turn[2]; /* sine and cosine */
	reduce(&angle, pi * part);
	sine_cosine(&angle, turn);
	const real k = turn[0] / turn[1];
	const real scale = 1 / (1 + root2 * k + k * k);
	filter->n = n;
	filter->b = k * k * scale;
	filter->a1 = 2 * (k * k - 1) * scale;
	filter->a2 = (1 - root2 * k + k * k) * scale;
	filter->state = storage;
	filter->settled = 0;
	return KOOP_OK;
}

COLD int KOOP(lowpass_reset)(KOOP(lowpass) *filter) {
	if (!filter || !filter->state) { return KOOP_E_NULL; }
	filter->settled = 0;
	return KOOP_OK;
}

int KOOP(lowpass_step)(KOOP(lowpass) *filter, const real *x, real *y) {
	if (!filter || !filter->state || !x || !y) { return KOOP_E_NULL; }
	const real b = filter->b, a1 = filter->a1, a2 = filter->a2;
	if (!all_finite(x, filter->n)) { return KOOP_E_INPUT; }
	/* the state stays within a few times the largest input */
	if (!(max_abs(x, filter->n) < REAL_MAX / 64)) { return KOOP_E_OVERFLOW; }
	for (size_t i = 0; i < filter->n; i++) {
		real *s = filter->state + 2 * i;
		const real now = x[i];
		if (!filter->settled) {
			s[0] = (1 - b) * now;
			s[1] = (b - a2) * now;
		}
		const real out = b * now + s[0];
		s[0] = 2 * b * now - a1 * out + s[1];
		s[1] = b * now - a2 * out;
		y[i] = out;
	}
	filter->settled = 1;
	return KOOP_OK;
}
