/* Variable-rate forgetting. Bruce, Goel and Bernstein, "Convergence and consistency of recursive least squares with
 * variable-rate forgetting", Automatica 119, 2020: it forgets while the innovation is larger than it has been.
 *
 *     1 / lambda_k = 1 + eta max(0, sqrt(mean of `fast` / mean of `slow` squared innovations) - 1)
 *
 * The paper takes the means over windows, which would be stored. Here a mean over m samples is that of all samples up
 * to the m-th, and a first-order filter with the weight 1 / m from then on. Three reals are remembered.
 *
 * Guaranteed:
 *     config.lambda <= lambda_k <= 1
 *     P does not grow while the faster mean does not exceed the slower, also without excitation
 *     P of none <= P <= P of ef for the same regressors
 *     P <= lambda^(1 - q) / alpha I   if zeta zeta' of the last q samples add up to alpha I or more
 *     |K| <= sqrt(p / lambda) / 2     where P <= p I before the sample
 * Without such excitation P is not bounded: noise alone makes the two means differ, and P grows by 1 / lambda_k
 * then. */

enum { VRF_SAMPLES, VRF_FAST, VRF_SLOW, VRF_REALS };

static COLD size_t memory_vrf(const KOOP(rls) *rls) {
	(void)rls;
	return VRF_REALS;
}

static COLD int check_vrf(KOOP(rls) *rls) {
	const KOOP(variable_rate) *own = (const KOOP(variable_rate) *)rls->config.settings;
	return own->fast < own->slow ? KOOP_OK : KOOP_E_RANGE;
}

static void vrf_average(real *mean, real square, real samples, real window) {
	*mean += (square - *mean) / (samples < window ? samples : window);
}

/* sqrt(fast / slow) - 1, and 0 as long as nothing has been predicted wrongly */
static real vrf_excess(const KOOP(rls) *rls) {
	const real fast = rls->memory[VRF_FAST], slow = rls->memory[VRF_SLOW];
	return fast > slow ? MATH(sqrt)(fast / slow) - 1 : 0;
}

static int decide_vrf(KOOP(rls) *rls, real innovation, KOOP(step) *step) {
	const KOOP(variable_rate) *own = (const KOOP(variable_rate) *)rls->config.settings;
	const real square = innovation / 2 * (innovation / 2); /* in range, and only the ratio of the means counts */
	rls->memory[VRF_SAMPLES] += 1;
	vrf_average(&rls->memory[VRF_FAST], square, rls->memory[VRF_SAMPLES], own->fast);
	vrf_average(&rls->memory[VRF_SLOW], square, rls->memory[VRF_SAMPLES], own->slow);
	step->noise = max_of(1 / (1 + own->eta * vrf_excess(rls)), rls->config.lambda);
	step->scale = 1 / step->noise;
	return KOOP_OK;
}

static const KOOP(variable_rate) KOOP(vrf_defaults) = {10, 100, (real)0.1};
static const KOOP(setting) KOOP(vrf_settings)[3] = {{"fast", 1, 16777216}, {"slow", 1, 16777216}, {"eta", 0, 1000}};
static const KOOP(extension) KOOP(vrf_extension) = {&KOOP(reg_engine), memory_vrf, NULL, NULL, NULL};

const KOOP(regulator) KOOP(reg_vrf) = {KOOP(name_vrf), 0, decide_vrf, 0, KOOP(vrf_settings), 3, &KOOP(vrf_defaults), check_vrf,
                                       &KOOP(vrf_extension)};
