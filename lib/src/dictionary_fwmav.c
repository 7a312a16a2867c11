/* Dictionaries of the flapping-wing MAV,
 * x = [gx gy gz (rad/s), ax ay az (m/s^2), pitch roll yaw (rad), yaw rate (rad/s)].
 *
 * The paper names Poly and RBF but defines neither for this vehicle. This is our choice:
 *
 * - Both have sin and cos of pitch and roll, through which gravity enters the accelerometer. Neither has a
 *   function of yaw, since the dynamics do not depend on heading.
 * - poly adds squares and products of the body rates: the gyroscopic torques of Euler's equations and, to
 * first order, the part of the wing drag that is quadratic in the rates.
 * - rbf adds Gaussians of (pitch, roll), the slow pair that distinguishes flight regimes; the Gaussians of
 * the DDR are functions of position. The body rates oscillate with every wing beat, so that Gaussians of the
 * rates would be noise. The grid covers +-0.6 rad: beyond it such vehicles do not recover from hover or slow
 * flight. sigma is 3/4 of the spacing, as for the DDR.
 *
 * The regressor has no constant term: cos(pitch) and cos(roll) replace it. */

static void lift_gravity(const real *x, real *out) {
	KOOP(angle) pitch, roll;
	reduce(&pitch, x[6]);
	reduce(&roll, x[7]);
	sine_cosine(&pitch, out);
	sine_cosine(&roll, out + 2);
}

static void lift_poly_fwmav(const KOOP(dictionary) *self, const real *x, real *psi) {
	(void)self;
	for (size_t i = 0; i < 10; i++) { psi[i] = x[i]; }
	psi[10] = x[0] * x[0];
	psi[11] = x[1] * x[1];
	psi[12] = x[2] * x[2];
	psi[13] = x[0] * x[1];
	psi[14] = x[1] * x[2];
	psi[15] = x[2] * x[0];
	lift_gravity(x, psi + 16);
}

const KOOP(dictionary) KOOP(poly_fwmav) = {"poly", 10, 20, lift_poly_fwmav, NULL};

static void lift_rbf_fwmav(const KOOP(dictionary) *self, const real *x, real *psi) {
	static const real center[4] = {(real)-0.6, (real)-0.2, (real)0.2, (real)0.6}; /* rad */
	(void)self;
	for (size_t i = 0; i < 10; i++) { psi[i] = x[i]; }
	gaussian_grid_4x4(x[6], x[7], center, (real)0.3, psi + 10);
	lift_gravity(x, psi + 26);
}

const KOOP(dictionary) KOOP(rbf_fwmav) = {"rbf", 10, 30, lift_rbf_fwmav, NULL};
