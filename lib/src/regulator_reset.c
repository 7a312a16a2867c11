/* Covariance resetting. Goodwin, Elliott and Teoh, "Deterministic convergence of a self-tuning regulator with
 * covariance resetting", IEE Proceedings D 130(1), 1983; Goodwin and Sin, "Adaptive Filtering, Prediction and
 * Control", 1984, section 3.3.
 *
 *     P^-1 = P^-1 + zeta zeta', and P = p0 I after `period` samples, or as soon as trace P < min_trace p0 d
 *
 * Guaranteed after every sample, whatever the excitation:
 *     P <= p0 I                               also without any excitation: there is no windup
 *     trace P >= min_trace p0 d               the gain does not vanish in all directions
 *     P >= I / (1 / p0 + period max|zeta|^2)  if period > 0: it vanishes in none
 *     |K| <= sqrt(p0) / 2
 * A reset forgets all that P holds, in directions that are not excited too, so Theta follows noise for some samples
 * after it. With period = 0, a direction that is not excited keeps the trace up, and the gain along the others
 * vanishes as that of `none`. */

enum { RESET_SAMPLES, RESET_REALS };

static COLD size_t memory_resetting(const KOOP(rls) *rls) {
	(void)rls;
	return RESET_REALS;
}

static real trace_of_covariance(KOOP(rls) *rls) {
	real sum = 0;
	rls->config.form->diagonal(rls, rls->work);
	for (size_t i = 0; i < rls->n_regressors; i++) { sum += rls->work[i]; }
	return sum;
}

static int reset_is_due(KOOP(rls) *rls) {
	const KOOP(resetting) *own = (const KOOP(resetting) *)rls->config.settings;
	const int late = own->period > 0 && rls->memory[RESET_SAMPLES] >= own->period;
	return late || trace_of_covariance(rls) < own->min_trace * rls->nominal_trace;
}

static int reshape_resetting(KOOP(rls) *rls) {
	rls->memory[RESET_SAMPLES] += 1;
	if (!reset_is_due(rls)) { return KOOP_OK; }
	rls->config.form->reset(rls, rls->config.p0);
	rls->positive_definite = 1;
	rls->memory[RESET_SAMPLES] = 0;
	return KOOP_OK;
}

static const KOOP(resetting) KOOP(reset_defaults) = {500, (real)0.01};
static const KOOP(setting) KOOP(reset_settings)[2] = {{"period", 0, 16777216}, {"min_trace", 0, 1}};
static const KOOP(extension) KOOP(reset_extension) = {&KOOP(reg_engine), memory_resetting, NULL, NULL, reshape_resetting};

const KOOP(regulator) KOOP(reg_reset) = {KOOP(name_reset), 0, decide_none, 0, KOOP(reset_settings), 2, &KOOP(reset_defaults),
                                         NULL, &KOOP(reset_extension)};
