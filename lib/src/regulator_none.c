/* No forgetting: lambda = 1 in the paper's eq. (4). P only shrinks, and the gain tends to 0. */

static int decide_none(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)rls;
	(void)innovation;
	step->noise = 1;
	step->scale = 1;
	return KOOP_OK;
}

const KOOP(regulator) KOOP(reg_none) = {KOOP(name_none), 0, decide_none, 0, NULL, 0, NULL, NULL, NULL};
