/* Exponential forgetting, vanilla in the paper. It is the initial value of `step`. */

static int decide_ef(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	(void)step;
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_ef) = {KOOP(name_ef), 0, decide_ef, 1, NULL, 0, NULL, NULL, NULL};
