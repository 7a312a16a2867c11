/* Subspace-of-information forgetting of rank one. Paper, section "Subspace-of-Information Forgetting": only
 * the information along zeta is discounted, so directions that are not excited keep their covariance. */

static int decide_sift(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	const real *zeta = rls->zeta;
	(void)innovation;
	if (dot(zeta, zeta, rls->n_regressors_padded) < rls->config.eps_sift) {
		step->update_theta = 0;
		step->update_covariance = 0;
		return KOOP_OK;
	}

	const real information = rls->config.form->information(rls); /* rho */
	if (!is_finite(information)) { return KOOP_E_OVERFLOW; }
	if (!(information > 0)) { return KOOP_E_INDEFINITE; }
	step->noise = 1;
	step->scale = 1;
	step->inflate = (1 - rls->config.lambda) / (rls->config.lambda * information);
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_sift) = {"sift", 1, decide_sift, 0};
