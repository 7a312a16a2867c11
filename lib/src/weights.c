/* Cholesky factors of the controller's weights. Newton's method computes them again at each solve: the
 * weights may change, and a flipped bit does not persist. */

/* Computes column k of L with the largest remaining diagonal element as pivot, if it exceeds `smallest`. */
static COLD int cholesky_column(real *L, const real *M, size_t n, size_t k, real smallest) {
	size_t pivot = n;
	for (size_t i = 0; i < n; i++) {
		const real left = M[i * n + i] - dot(L + i * n, L + i * n, k);
		if (left > smallest) {
			pivot = i;
			smallest = left;
		}
	}
	if (pivot == n) { return 0; }
	for (size_t i = 0; i < n; i++) {
		L[i * n + k] = (M[i * n + pivot] - dot(L + i * n, L + pivot * n, k)) / MATH(sqrt)(smallest);
	}
	return 1;
}

/* L L' = M for a symmetric positive semidefinite M (null: 0), by the Cholesky factorisation with pivoting.
 * Returns 0 if M is not symmetric positive semidefinite. */
static COLD int cholesky(real *L, const real *M, size_t n) {
	real largest = 0;
	size_t k = 0;
	for (size_t i = 0; i < n * n; i++) { L[i] = 0; }
	if (!M) { return 1; }
	for (size_t i = 0; i < n; i++) { largest = max_of(largest, M[i * n + i]); }
	while (k < n && cholesky_column(L, M, n, k, 8 * REAL_EPSILON * largest)) { k++; }
	for (size_t i = 0; i < n * n; i++) {
		const real left = M[i] - dot(L + i / n * n, L + i % n * n, n);
		if (!(MATH(fabs)(left) <= MATH(sqrt)(REAL_EPSILON) * largest)) { return 0; }
	}
	return 1;
}

/* Factors the present R, S and Q. Returns 0 if one is not positive semidefinite. */
static COLD int take_roots(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs;
	return cholesky(mpc->roots, c->R, m) && cholesky(mpc->roots + m * m, c->S, m) &&
	       cholesky(mpc->roots + 2 * m * m, c->Q, n);
}
