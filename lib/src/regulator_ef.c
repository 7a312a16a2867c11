/* Exponential forgetting, the paper's vanilla: what `step` comes in as. */

static int decide_ef(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	(void)step;
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_ef) = {"ef", 0, decide_ef, 1};
