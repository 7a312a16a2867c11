/* Directional forgetting. Kulhavy and Karny, "Tracking of slowly varying parameters by directional forgetting", IFAC
 * World Congress, 1984; Kulhavy, "Restricted exponential forgetting in real-time identification", Automatica 23(5),
 * 1987. With s = zeta' P zeta,
 *
 *     K = P zeta / (1 + s),    P^-1 = P^-1 + (lambda - (1 - lambda) / s) zeta zeta'
 *
 * so that s / (lambda (1 + s)) remains of s: only the information along zeta is forgotten.
 *
 * Guaranteed, whatever the excitation:
 *     zeta' P zeta <= max(its old value, (1 - lambda) / lambda) for the zeta just learned
 *     P <= its old value / lambda; |K| <= sqrt(p) / 2 where P <= p I before the sample, and zeta' K < 1
 *     P v stays for every v with v' P zeta = 0: what is not excited is not forgotten
 *     P stays where |zeta|^2 < min_square, and so without excitation: there is no windup
 * A bound of P that holds for all sequences of regressors is not claimed here. */

static int decide_kulhavy(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	const KOOP(direction) *own = (const KOOP(direction) *)rls->config.settings;
	(void)innovation;
	step->noise = 1;
	step->scale = 1;
	step->update_covariance = !(dot(rls->zeta, rls->zeta, rls->n_regressors_padded) < own->min_square);
	return KOOP_OK;
}

/* The formula in terms of q = lambda (1 + s) - 1: noise = s / q and noise + s = s lambda (1 + s) / q, which `weight`
 * turns into 1 + s for Theta. Where q is round-off, P stays: all that is learned is forgotten. */
static int adjust_kulhavy(KOOP(rls) *rls, real s, KOOP(step) *step) {
	const real lambda = rls->config.lambda, q = lambda * (1 + s) - 1;
	step->update_covariance &= s > 0 && MATH(fabs)(q) > REAL_EPSILON;
	if (!step->update_covariance) { return KOOP_OK; }
	step->noise = s / q;
	step->weight = lambda * MATH(fabs)(step->noise);
	return KOOP_OK;
}

static const KOOP(direction) KOOP(kulhavy_defaults) = {(real)1e-10};
static const KOOP(setting) KOOP(kulhavy_settings)[1] = {{"min_square", 0, REAL_MAX}};
static const KOOP(extension) KOOP(kulhavy_extension) = {&KOOP(reg_engine), NULL, NULL, adjust_kulhavy, NULL};

const KOOP(regulator) KOOP(reg_kulhavy) = {KOOP(name_kulhavy), 0, decide_kulhavy, 0, KOOP(kulhavy_settings), 1,
                                           &KOOP(kulhavy_defaults), NULL, &KOOP(kulhavy_extension)};
