/* Dead zones. Paper, section "Error Dead-Zone Gating": while the innovation is at most delta, the model is
 * accurate enough, and P is not inflated. */

static int decide_dz_cs(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	step->update_covariance = innovation > rls->config.delta;
	return KOOP_OK;
}

static int decide_dz_ks(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	step->update_covariance = innovation > rls->config.delta;
	step->update_theta = step->update_covariance;
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_dz_cs) = {"dz_cs", 0, decide_dz_cs, 1};
const KOOP(regulator) KOOP(reg_dz_ks) = {"dz_ks", 0, decide_dz_ks, 1};
