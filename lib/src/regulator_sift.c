/* Subspace-of-information forgetting of rank one. Paper, section "Subspace-of-Information Forgetting": only
 * the information along zeta is discounted, so directions that are not excited keep their covariance. */

static int decide_sift(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	const KOOP(information_floor) *own = (const KOOP(information_floor) *)rls->config.settings;
	const real *zeta = rls->zeta;
	(void)innovation;
	if (dot(zeta, zeta, rls->n_regressors_padded) < own->eps_sift) {
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
	step->deflate = step->inflate * rls->config.lambda;
	return KOOP_OK;
}

static const KOOP(information_floor) KOOP(sift_defaults) = {(real)1e-10};
static const KOOP(setting) KOOP(sift_settings)[1] = {{"eps_sift", 0, REAL_MAX}};

const KOOP(regulator) KOOP(reg_sift) = {KOOP(name_sift), 1, decide_sift, 0, KOOP(sift_settings), 1, &KOOP(sift_defaults),
                                           NULL, NULL};
