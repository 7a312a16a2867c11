/* Dictionaries of the differential-drive robot, x = [px, py, theta]. */

static void lift_poly_ddr(const KOOP(dictionary) *self, const real *x, real *psi) {
	KOOP(angle) theta;
	(void)self;
	psi[0] = x[0];
	psi[1] = x[1];
	psi[2] = x[2];
	psi[3] = x[0] * x[0];
	psi[4] = x[1] * x[1];
	reduce(&theta, x[2]);
	sine_cosine(&theta, psi + 5);
}

const KOOP(dictionary) KOOP(poly_ddr) = {"poly", 3, 7, lift_poly_ddr, NULL};

static void lift_rbf_ddr(const KOOP(dictionary) *self, const real *x, real *psi) {
	static const real center[4] = {-3, -1, 1, 3}; /* m */
	KOOP(angle) theta;
	(void)self;
	psi[0] = x[0];
	psi[1] = x[1];
	psi[2] = x[2];
	gaussian_grid_4x4(x[0], x[1], center, (real)1.5, psi + 3);
	reduce(&theta, x[2]);
	sine_cosine(&theta, psi + 19);
	psi[21] = wrapped(&theta); /* atan2(sin, cos) */
}

const KOOP(dictionary) KOOP(rbf_ddr) = {"rbf", 3, 22, lift_rbf_ddr, NULL};
