/* Bounded-gain forgetting. Slotine and Li, "Applied Nonlinear Control", 1991, section 8.7: the forgetting rate is
 * lambda0 (1 - |P| / k0) in continuous time. Here, with the trace for the norm, which is not smaller,
 *
 *     1 - lambda_k = (1 - lambda) (1 - trace P / k0)
 *
 * Without excitation this is dP/dt = lambda0 (1 - trace P / k0) P sampled without error: the trace follows the
 * logistic curve, trace = trace / (lambda + (1 - lambda) trace / k0).
 *
 * Guaranteed after every sample, whatever the excitation:
 *     trace P <= k0                  also without any excitation: there is no windup
 *     lambda <= lambda_k <= 1
 *     |K| <= sqrt(k0 / lambda) / 2
 * and with |zeta|^2 <= beta, as long as trace P <= T < k0, which persistent excitation sees to:
 *     P >= I / max(1 / p0, beta / ((1 - lambda) (1 - T / k0)))
 * If some direction is not excited, the trace tends to k0, nothing is forgotten any more, and the gain in the other
 * directions vanishes. */

static COLD int check_bgf(KOOP(rls) *rls) {
	const KOOP(bounded_gain) *own = (const KOOP(bounded_gain) *)rls->config.settings;
	const real initial = rls->nominal_trace;
	if (own->k0 > 0) { rls->nominal_trace = own->k0; }
	return rls->nominal_trace >= initial && rls->nominal_trace < REAL_MAX / 8 ? KOOP_OK : KOOP_E_RANGE;
}

static int decide_bgf(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	const real share = trace_of_covariance(rls) / rls->nominal_trace, lambda = rls->config.lambda;
	(void)innovation;
	/* a share below 0 is that of a P that KOOP_CHECK_REPORT let become indefinite */
	step->noise = share < 1 ? lambda + (1 - lambda) * max_of(share, 0) : 1;
	step->scale = 1 / step->noise;
	return KOOP_OK;
}

static const KOOP(bounded_gain) KOOP(bgf_defaults) = {0};
static const KOOP(setting) KOOP(bgf_settings)[1] = {{"k0", 0, REAL_MAX / 8}};

const KOOP(regulator) KOOP(reg_bgf) = {KOOP(name_bgf), 0, decide_bgf, 1, KOOP(bgf_settings), 1, &KOOP(bgf_defaults), check_bgf,
                                       NULL};
