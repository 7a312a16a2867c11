/* The weights of the controller, as Cholesky factors: again at each solve by Newton's method, so that they
 * may change and a flipped bit does not stay. */

/* Column k of L, on the largest element of the diagonal that is left, if that is above `least`. */
static COLD int cholesky_column(real *L, const real *M, size_t n, size_t k, real least) {
	size_t pivot = n;
	for (size_t i = 0; i < n; i++) {
		const real left = M[i * n + i] - dot(L + i * n, L + i * n, k);
		if (left > least) {
			pivot = i;
			least = left;
		}
	}
	if (pivot == n) { return 0; }
	for (size_t i = 0; i < n; i++) {
		L[i * n + k] = (M[i * n + pivot] - dot(L + i * n, L + pivot * n, k)) / MATH(sqrt)(least);
	}
	return 1;
}

/* L L' = M for a symmetric positive semidefinite M (null: 0), by Cholesky's method with pivots.
 * Returns whether M is one. */
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

/* The roots of R, S and Q as they are now; whether these are positive semidefinite. */
static COLD int take_roots(KOOP(mpc) *mpc) {
	const KOOP(mpc_config) *c = &mpc->config;
	const size_t n = c->n_states, m = c->n_inputs;
	return cholesky(mpc->roots, c->R, m) && cholesky(mpc->roots + m * m, c->S, m) &&
	       cholesky(mpc->roots + 2 * m * m, c->Q, n);
}
