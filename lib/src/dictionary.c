/* Checks of every dictionary, and parts that several of them share. */

static int dictionary_check(const KOOP(dictionary) *dictionary) {
	if (!dictionary || !dictionary->lift || !dictionary->name) { return KOOP_E_NULL; }
	if (dictionary->n_states < 1 || dictionary->n_lifted < dictionary->n_states ||
	    dictionary->n_lifted > KOOP_MAX_DIM) {
		return KOOP_E_SIZE;
	}
	return KOOP_OK;
}

int KOOP(lift)(const KOOP(dictionary) *dictionary, const real *x, real *psi) {
	const int status = dictionary_check(dictionary);
	if (status != KOOP_OK) { return status; }
	if (!x || !psi) { return KOOP_E_NULL; }
	if (!all_finite(x, dictionary->n_states)) { return KOOP_E_INPUT; }

	dictionary->lift(dictionary, x, psi);
	return all_finite(psi, dictionary->n_lifted) ? KOOP_OK : KOOP_E_OVERFLOW;
}

/* out[4 i + j] = exp(-|(a, b) - (center[i], center[j])|^2 / (2 sigma^2)). A Gaussian of two coordinates is
 * the product of two Gaussians of one, so 8 exponentials give 16 functions. */
static void gaussian_grid_4x4(real a, real b, const real *center, real sigma, real *out) {
	const real factor = 1 / (2 * sigma * sigma);
	real along_a[4], along_b[4];
	for (size_t i = 0; i < 4; i++) {
		along_a[i] = factor * (a - center[i]) * (a - center[i]);
		along_b[i] = factor * (b - center[i]) * (b - center[i]);
	}
	exp_minus_four(along_a);
	exp_minus_four(along_b);
	for (size_t i = 0; i < 4; i++) { scale_four(out + 4 * i, along_a[i], along_b); }
}
