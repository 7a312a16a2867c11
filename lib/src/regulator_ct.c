/* Constant trace. Paper, section "Constant-Trace Normalization". */

static COLD int check_ct(KOOP(rls) *rls) {
	const KOOP(constant_trace) *own = (const KOOP(constant_trace) *)rls->config.settings;
	if (own->tau0 > 0) { rls->nominal_trace = own->tau0; }
	return rls->nominal_trace < REAL_MAX / 8 ? KOOP_OK : KOOP_E_RANGE;
}

static int decide_ct(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	(void)innovation;
	step->scale = 1; /* the normalisation would cancel 1 / lambda */
	step->trace = rls->nominal_trace;
	return KOOP_OK;
}

static const KOOP(constant_trace) KOOP(ct_defaults) = {0};
static const KOOP(setting) KOOP(ct_settings)[1] = {{"tau0", 0, REAL_MAX / 8}};

const KOOP(regulator) KOOP(reg_ct) = {KOOP(name_ct), 0, decide_ct, 1, KOOP(ct_settings), 1, &KOOP(ct_defaults),
                                         check_ct, NULL};
