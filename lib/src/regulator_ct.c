/* Constant trace. Paper, section "Constant-Trace Normalization". */

static int decide_ct(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)innovation;
	step->scale = 1; /* the normalisation would cancel 1 / lambda */
	step->trace = rls->config.tau0;
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_ct) = {"ct", 0, decide_ct, 1};
