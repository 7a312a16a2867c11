/* Dead zones. Paper, section "Error Dead-Zone Gating": while the innovation is at most delta, the model is
 * accurate enough, and P is not inflated. */

static int exceeds_dead_zone(const KOOP(rls) *rls, real innovation) {
	const KOOP(dead_zone) *own = (const KOOP(dead_zone) *)rls->config.settings;
	return innovation > own->delta;
}

static int decide_dz_cs(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	step->update_covariance = exceeds_dead_zone(rls, innovation);
	return KOOP_OK;
}

static int decide_dz_ks(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	step->update_covariance = exceeds_dead_zone(rls, innovation);
	step->update_theta = step->update_covariance;
	return KOOP_OK;
}

static const KOOP(dead_zone) KOOP(dead_zone_defaults) = {(real)0.01};
static const KOOP(setting) KOOP(dead_zone_settings)[1] = {{"delta", 0, REAL_MAX}};

const KOOP(regulator) KOOP(reg_dz_cs) = {KOOP(name_dz_cs), 0, decide_dz_cs, 1, KOOP(dead_zone_settings), 1,
                                         &KOOP(dead_zone_defaults), NULL, NULL};

const KOOP(regulator) KOOP(reg_dz_ks) = {KOOP(name_dz_ks), 0, decide_dz_ks, 1, KOOP(dead_zone_settings), 1,
                                         &KOOP(dead_zone_defaults), NULL, NULL};
